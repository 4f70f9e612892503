"""A ROS domain of one's own, so that two graphs on one machine do not see each other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path
from types import TracebackType

from dfm_stage.errors import DfmError

# Linux's ephemeral ports begin where the ports of domain 102 do.
_DOMAINS = range(101, 0, -1)


class DomainLock:
    """Holds one ROS domain id that no other holder of a DomainLock has, until it is released.

    The lock is the operating system's on a file, so it ends with the process in any case.
    """

    def __init__(self) -> None:
        folder = Path(tempfile.gettempdir()) / f"dfm_stage_domains_{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        for domain in _DOMAINS:
            handle = os.open(folder / str(domain), os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(handle)
                continue
            self.domain_id = domain
            self._handle: int | None = handle
            return
        raise DfmError(f"all {len(_DOMAINS)} ROS domains are in use by other graphs of this "
                       f"user; end some of them (locks are in {folder})")

    def release(self) -> None:
        """Give the domain back."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def __enter__(self) -> DomainLock:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.release()
