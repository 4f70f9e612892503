"""DDS security (SROS2): a graph that is asked to run securely runs so or not at all.

ROS 2 itself goes on insecurely where the strategy is Permissive, and dies in a traceback where it
is Enforce, when the middleware was built without security, as the wheels on PyPI are.
"""

from __future__ import annotations

import mmap
import os
import re
from pathlib import Path

from dfm_stage.errors import DfmError

_PLUGIN = b"DDS:Auth:PKI-DH"
_FAST_DDS = re.compile(r"/\S*/libfast(?:rtps|dds)\.so\S*")


class SecurityError(DfmError):
    """Security was asked for and cannot be had."""


def require_what_was_asked() -> None:
    """Do nothing unless ROS_SECURITY_ENABLE is `true`; then check that it can be kept.

    Raises
    ------
    SecurityError
        If there is no keystore, or the Fast DDS that is loaded has no security plugins.
    """
    if os.environ.get("ROS_SECURITY_ENABLE", "").lower() != "true":
        return
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE", "")
    if not Path(keystore, "enclaves").is_dir() or not keystore:
        raise SecurityError(f"ROS_SECURITY_ENABLE is true, but ROS_SECURITY_KEYSTORE = "
                            f"{keystore!r} is no keystore: make one with ros2 security, or unset "
                            "ROS_SECURITY_ENABLE")
    library = _loaded_fast_dds()
    if library is not None and not _contains(library, _PLUGIN):
        raise SecurityError(f"ROS_SECURITY_ENABLE is true, but {library.name} was built without "
                            "DDS security, nothing would be checked or encrypted: use a full "
                            "ROS 2 installation, or unset ROS_SECURITY_ENABLE")


def _loaded_fast_dds() -> Path | None:
    """Return the Fast DDS library of this process, None with another middleware."""
    import rclpy

    rclpy.get_rmw_implementation_identifier()
    found = _FAST_DDS.search(Path("/proc/self/maps").read_text(encoding="utf-8"))
    return Path(found.group()) if found else None


def _contains(file: Path, what: bytes) -> bool:
    with file.open("rb") as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return data.find(what) >= 0
