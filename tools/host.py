"""What the machine offers: a ROS 2 installation that is sourced, a compiler, Python's headers."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from console import SetupError, read_stamp, write_stamp

DISTRIBUTION = "jazzy"
PRIVATE_MARK = "dfm_private_environment"


@dataclass(frozen=True)
class Host:
    """The Python to build on and, when ROS 2 is installed and sourced, where."""

    python: str
    version: str  # "3.11"
    ros_prefix: str | None
    remark: str = ""  # why an installation that is sourced is not used

    @property
    def tag(self) -> str:
        """Name of this combination's folder inside the private folder."""
        return f"{'ros' if self.ros_prefix else 'private'}-py{self.version}"


def base_python() -> str:
    """The interpreter behind any virtual environment that this one belongs to."""
    return str(getattr(sys, "_base_executable", None) or sys.executable)


def find_host(environ: Mapping[str, str], cache: Path) -> Host:
    """The installation that is sourced, if rclpy can be imported from it, else this Python."""
    own_version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    prefix, version = _sourced_rclpy(environ)
    if prefix:
        python = (
            sys.executable if version == own_version else shutil.which(f"python{version}")
        )
        if python and _imports_rclpy(python, prefix, environ, cache):
            return Host(python, version, prefix)
        remark = f"rclpy of {prefix} does not import with {python or 'python' + version}"
        return Host(base_python(), own_version, None, remark)
    return Host(base_python(), own_version, None)


def _sourced_rclpy(environ: Mapping[str, str]) -> tuple[str, str]:
    if environ.get("ROS_DISTRO") != DISTRIBUTION:
        return "", ""
    for prefix in filter(None, environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        if os.path.exists(os.path.join(prefix, PRIVATE_MARK)):
            continue
        for pattern in ("lib/python3.*/site-packages", "local/lib/python3.*/dist-packages"):
            for folder in sorted(Path(prefix).glob(f"{pattern}/rclpy")):
                return prefix, folder.parents[1].name.removeprefix("python")
    return "", ""


def _imports_rclpy(python: str, prefix: str, environ: Mapping[str, str], cache: Path) -> bool:
    seen = "\n".join(
        [
            python,
            prefix,
            *(
                environ.get(name, "")
                for name in ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH")
            ),
        ]
    )
    key = hashlib.sha256(seen.encode()).hexdigest()
    known = read_stamp(cache)
    if known.get("key") == key:
        return bool(known["imports"])
    imports = (
        subprocess.run(
            [python, "-c", "import rclpy, rosidl_adapter"],
            env=dict(environ),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,
        ).returncode
        == 0
    )
    write_stamp(cache, {"key": key, "imports": imports})
    return imports


def check(host: Host) -> None:
    """SetupError with the package to install unless everything to build with is there."""
    if not sys.platform.startswith("linux"):
        raise SetupError(f"this needs Linux, not {sys.platform}: use a Linux machine")
    if not host.ros_prefix and platform.machine() != "x86_64":
        raise SetupError(
            f"the ROS wheels exist for x86_64, not for {platform.machine()}: "
            "install ROS 2 Jazzy and source its setup.bash"
        )
    for language, variable, names in (
        ("C", "CC", ("cc", "gcc", "clang")),
        ("C++", "CXX", ("c++", "g++", "clang++")),
    ):
        wanted = os.environ.get(variable, "").split()[:1]
        if not any(shutil.which(name) for name in wanted or names):
            looked_for = f"{variable}={wanted[0]}" if wanted else ", ".join(names)
            raise SetupError(
                f"no {language} compiler ({looked_for}): install g++ "
                "(Debian, Ubuntu: apt-get install g++; Fedora: dnf install gcc-c++)"
            )
    header, has_venv = _python_offers(host)
    package = _package_stem(host)
    if not os.path.exists(header):
        raise SetupError(
            f"Python's headers are missing ({header}): install {package}-dev "
            f"(Debian, Ubuntu: apt-get install {package}-dev; Fedora: dnf install python3-devel)"
        )
    if not has_venv:
        raise SetupError(
            f"{host.python} has no venv module: install {package}-venv "
            f"(apt-get install {package}-venv)"
        )


def _package_stem(host: Host) -> str:
    """The distribution's name for this Python: python3 for its own, else python3.11 and so on."""
    own = os.path.realpath("/usr/bin/python3") == os.path.realpath(host.python)
    return "python3" if own else f"python{host.version}"


def _python_offers(host: Host) -> tuple[str, bool]:
    """Path of Python.h and whether venv and ensurepip are there, as `host.python` sees it."""
    code = (
        "import json, sysconfig, importlib.util as u;"
        "print(json.dumps([sysconfig.get_path('include') + '/Python.h',"
        "bool(u.find_spec('venv') and u.find_spec('ensurepip'))]))"
    )
    header, has_venv = json.loads(subprocess.check_output([host.python, "-I", "-c", code]))
    return str(header), bool(has_venv)
