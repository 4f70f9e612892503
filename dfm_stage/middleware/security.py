"""DDS security (SROS2): a graph that is asked to run securely runs so or not at all.

ROS 2 itself goes on insecurely where the strategy is Permissive, and dies in a traceback where it
is Enforce, when the middleware was built without security, as the wheels on PyPI are.
"""

from __future__ import annotations

import mmap
import os
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from dfm_stage.errors import DfmError

_PLUGIN = b"DDS:Auth:PKI-DH"
_ENCLAVE_FILES = ("identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem",
                  "governance.p7s", "permissions.p7s")
"""What every enclave of a keystore has (rmw_dds_common, `get_security_files`)."""
OVERRIDE = "ROS_SECURITY_ENCLAVE_OVERRIDE"
OPERATOR, WHOLE_STAGE = "/stage/operator", "/stage"
"""The enclave of programs beside the graph, and that of a process with all nodes."""
_FAST_DDS = re.compile(r"/\S*/libfast(?:rtps|dds)\.so\S*")


class SecurityError(DfmError):
    """Security was asked for and cannot be had."""


def asked() -> bool:
    """Return whether the graph is to be secured."""
    return os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true"


def require_what_was_asked(arguments: Sequence[str] = ()) -> None:
    """Do nothing unless ROS_SECURITY_ENABLE is `true`; then check that it can be kept by a process
    with these arguments.

    Raises
    ------
    SecurityError
        If there is no keystore, it has not the enclave of the process, or the Fast DDS that is
        loaded has no security plugins.
    """
    if not asked():
        return
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE", "")
    if not Path(keystore, "enclaves").is_dir() or not keystore:
        raise SecurityError(f"ROS_SECURITY_ENABLE is true, but ROS_SECURITY_KEYSTORE = "
                            f"{keystore!r} is no keystore: make one with ros2 security, or unset "
                            "ROS_SECURITY_ENABLE")
    _require_enclave(Path(keystore, "enclaves"), enclave_of(arguments))
    if library := built_without():
        raise SecurityError(f"ROS_SECURITY_ENABLE is true, but {library.name} was built without "
                            "DDS security, nothing would be checked or encrypted: use a full "
                            "ROS 2 installation, or unset ROS_SECURITY_ENABLE")


def built_without() -> Path | None:
    """Return the Fast DDS of this process if it was built without DDS security, else None."""
    library = _loaded_fast_dds()
    return None if library is None or _contains(library, _PLUGIN) else library


def enclave_of(arguments: Sequence[str]) -> str:
    """Return the enclave of a process with these ROS arguments, as rcl chooses it."""
    named = [name for flag, name in pairwise(arguments) if flag in ("-e", "--enclave")]
    return os.environ.get(OVERRIDE) or (named[-1] if named else "/")


def enclave_for(full_names: Sequence[str]) -> str:
    """Return the enclave that a process of these nodes is to have.

    One node has its own. Several have that of the namespace which all but the plant share: it
    grants what each of them may do.
    """
    if len(full_names) == 1:
        return full_names[0]
    spaces = [name.rpartition("/")[0] for name in full_names if not name.endswith("/sim_plant")]
    return os.path.commonpath(spaces or [WHOLE_STAGE])


def _require_enclave(enclaves: Path, name: str) -> None:
    folder = enclaves / name.strip("/")
    missing = [file for file in _ENCLAVE_FILES if not (folder / file).is_file()]
    if not missing:
        return
    known = sorted(f"/{each.parent.relative_to(enclaves)}" for each in enclaves.rglob("cert.pem"))
    raise SecurityError(
        f"the enclave {name} has no {', '.join(missing)} in {folder}: name one of "
        f"{', '.join(known) or 'those that ros2 security create_enclave makes'} by --ros-args "
        f"--enclave, or in {OVERRIDE}")


def _loaded_fast_dds() -> Path | None:
    """Return the Fast DDS library of this process, None with another middleware."""
    import rclpy

    rclpy.get_rmw_implementation_identifier()
    found = _FAST_DDS.search(Path("/proc/self/maps").read_text(encoding="utf-8"))
    return Path(found.group()) if found else None


def _contains(file: Path, what: bytes) -> bool:
    with file.open("rb") as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return data.find(what) >= 0
