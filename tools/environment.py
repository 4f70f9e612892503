"""The Python environment in the private folder: ROS wheels, or a complement to an installation."""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import subprocess
from collections.abc import Mapping
from pathlib import Path

from console import SetupError, Steps, read_stamp, remove_tree, write_stamp, write_whole
from host import DISTRIBUTION, PRIVATE_MARK, Host

REVISION = 1  # raise it when what this module does to an environment changes
PARTS = 2
SOURCE_ONLY = "empy"  # no wheel exists; built with the pinned setuptools
PIP_SETTINGS_OF_OTHERS = (
    "PIP_TARGET",
    "PIP_PREFIX",
    "PIP_ROOT",
    "PIP_USER",
    "PIP_REQUIREMENT",
    "PIP_CONSTRAINT",
    "PIP_NO_BINARY",
    "PIP_REQUIRE_VIRTUALENV",
)
WHEEL_BUILDERS_PYTHON = re.compile(
    r"/opt/python/[^/;\"]+/(?P<headers>include/python3\.\d+t?)"
    r"|/opt/python/[^/;\"]+/lib/python3\.\d+t?/site-packages/(?P<numpy>numpy/_core/include)"
)


def lock_file(root: Path, host: Host) -> Path:
    """The pinned list for this host."""
    return root / "requirements" / ("installed.txt" if host.ros_prefix else "private.txt")


def key(root: Path, host: Host, folder: Path) -> str:
    """What the environment was made from; another key, another environment."""
    parts = "\n".join((str(REVISION), host.version, host.ros_prefix or "", str(folder)))
    return hashlib.sha256(parts.encode() + lock_file(root, host).read_bytes()).hexdigest()


def is_ready(root: Path, host: Host, folder: Path) -> bool:
    """Whether the stamp vouches for the environment and its interpreter still exists."""
    stamp = read_stamp(folder / "environment.json")
    return stamp.get("key") == key(root, host, folder) and os.path.exists(
        folder / "env/bin/python"
    )


def build(root: Path, host: Host, folder: Path, steps: Steps, environ: Mapping[str, str]) -> None:
    """Make the environment from nothing; the stamp is written last."""
    stamp = folder / "environment.json"
    stamp.unlink(missing_ok=True)
    env = folder / "env"
    outside = {
        name: value
        for name, value in environ.items()
        if name not in PIP_SETTINGS_OF_OTHERS and not name.startswith("PYTHON")
    }
    outside.update(PYTHONNOUSERSITE="1", _ROS_WHEELS_BOOTSTRAP_COMPLETE="1")
    if host.ros_prefix and "PYTHONPATH" in environ:
        outside["PYTHONPATH"] = environ["PYTHONPATH"]
    kind = "beside the installed ROS 2" if host.ros_prefix else "private"
    with steps.step(f"Python {host.version} environment, {kind}"):
        remove_tree(env)
        site = ["--system-site-packages"] if host.ros_prefix else []
        steps.call([host.python, "-m", "venv", *site, env], env=outside, what="python -m venv")
    python = env / "bin/python"
    lines = [
        line for line in lock_file(root, host).read_text(encoding="utf-8").splitlines() if line
    ]
    if host.ros_prefix:
        lines = [line for line in lines if not _keeps_installed_numpy(line, python, outside)]
    pip: list[str | os.PathLike[str]] = [
        python,
        "-m",
        "pip",
        "install",
        "--no-deps",
        "--no-compile",
        "--no-input",
        "--progress-bar",
        "off",
        "--disable-pip-version-check",
        "--no-warn-script-location",
        "--only-binary",
        ":all:",
    ]
    builder = next(line for line in lines if line.startswith("setuptools=="))
    sources = ["--no-binary", SOURCE_ONLY, "--no-build-isolation", "--use-pep517"]
    with steps.step(f"{len(lines)} pinned packages"):
        steps.call([*pip, builder], env=outside, what="pip install setuptools")
        # unpacking keeps one processor busy; with --no-deps the parts do not need each other
        lines.remove(builder)
        commands = ([*pip, *sources, *lines[part::PARTS]] for part in range(PARTS))
        steps.call(*commands, env=outside, what="pip install")
    if not host.ros_prefix:
        repair_exports(env, host.version)
        write_setup_files(env)
        write_whole(env / PRIVATE_MARK, "made by ./run; not a ROS 2 installation\n")
    write_stamp(stamp, {"key": key(root, host, folder)})


def _keeps_installed_numpy(line: str, python: Path, environ: Mapping[str, str]) -> bool:
    """Whether `line` pins numpy and the installation, compiled against its own, brings one."""
    if not re.match(r"numpy\W", line):
        return False
    found = subprocess.run(
        [python, "-c", "import numpy"], env=dict(environ), capture_output=True, check=False
    )
    return found.returncode == 0


def repair_exports(env: Path, version: str) -> int:
    """Point the wheels' CMake exports at this environment; the count of files changed.

    They name folders that exist only where the wheels were made. A second call changes nothing.
    """
    site = env / f"lib/python{version}/site-packages"
    code = "import sysconfig; print(sysconfig.get_path('include'))"
    headers = subprocess.run(
        [env / "bin/python", "-I", "-S", "-c", code], capture_output=True, check=True, text=True
    ).stdout.strip()
    numpy_headers = str(site / "numpy/_core/include")
    changed = 0
    for path in sorted(env.glob("share/*/cmake/*.cmake")):
        text = path.read_text(encoding="utf-8")
        repaired = WHEEL_BUILDERS_PYTHON.sub(
            lambda found: headers if found["headers"] else numpy_headers, text
        )
        if repaired != text:
            write_whole(path, repaired)
            changed += 1
        if "/opt/python/" in repaired:
            raise SetupError(
                f"a path of the wheels' makers is left in {path}: tools/environment.py"
            )
    return changed


def library_folders(env: Path, version: str) -> list[str]:
    """Folders of the wheels' shared libraries, in a fixed order."""
    bundled = sorted((env / f"lib/python{version}/site-packages").glob("ros_*.libs"))
    return [str(env / "lib"), *map(str, bundled)]


def settings(env: Path) -> dict[str, str]:
    """Variables that a private environment always has."""
    return {
        "VIRTUAL_ENV": str(env),
        "ROS_DISTRO": DISTRIBUTION,
        "ROS_VERSION": "2",
        "ROS_PYTHON_VERSION": "3",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "CMAKE_GENERATOR": "Ninja",
        "PYTHONNOUSERSITE": "1",
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def write_setup_files(env: Path) -> None:
    """local_setup.sh and .bash, which colcon's own setup files chain to; the wheels bring none."""
    version = next((env / "lib").glob("python3.*")).name.removeprefix("python")
    paths = {
        "PATH": [str(env / "bin")],
        "AMENT_PREFIX_PATH": [str(env)],
        "CMAKE_PREFIX_PATH": [str(env)],
        "LD_LIBRARY_PATH": library_folders(env, version),
    }
    lines = ["# written at set-up; sourced by install/setup.bash of a workspace built on this one"]
    for name, value in settings(env).items():
        lines.append(f"export {name}={shlex.quote(value)}")
    for name, folders in paths.items():
        for folder in reversed(folders):
            quoted = shlex.quote(folder)
            lines.append(
                f'case ":${{{name}-}}:" in *:{quoted}:*) ;; '
                f'*) export {name}={quoted}"${{{name}:+:${name}}}" ;; esac'
            )
    text = "\n".join(lines) + "\n"
    for suffix in ("sh", "bash"):
        write_whole(env / f"local_setup.{suffix}", text)
        write_whole(env / f"setup.{suffix}", text)
