"""colcon build of this repository into the private folder, and the variables to run it with."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import environment
from console import Steps, read_stamp, remove_tree, write_stamp, write_whole
from host import Host

REVISION = 1  # raise it when the way of building changes
LONGEST_INTERPRETER = 125
# the second line is a command to sh and the begin of a string to Python
THROUGH_SH = """#!/bin/sh
'''exec' "{python}" "$0" "$@"
' '''
"""
INTERFACES, STAGE = "dfm_interfaces", "dfm_stage"


def sources(root: Path) -> dict[str, tuple[list[Path], list[Path]]]:
    """For each package the files whose contents decide the build, and those whose names do.

    The Python modules are neither, and config and launch files only by name: they are linked into
    the build, so an edit takes effect without one.
    """
    stage = [root / name for name in ("package.xml", "setup.py", "setup.cfg")]
    stage += [root / "dfm_stage" / name for name in ("__init__.py", "commands.py")]
    folders = ("resource", "dfm_stage/config", "launch")
    linked = [path for name in folders for path in _files(root / name)]
    return {INTERFACES: (_files(root / INTERFACES), []), STAGE: (stage, linked)}


def _files(folder: Path) -> list[Path]:
    found: list[Path] = []
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        found += [
            Path(where, name) for name in sorted(names) if not name.endswith((".pyc", ".swp", "~"))
        ]
    return found


def fingerprint(paths: Iterable[Path]) -> str:
    """Hash over names and contents; a missing file counts as such."""
    digest = hashlib.sha256(str(REVISION).encode())
    for path in paths:
        digest.update(f"\0{path}\0".encode())
        try:
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        except OSError:
            digest.update(b"missing")
    return digest.hexdigest()


def stale(root: Path, folder: Path) -> dict[str, dict[str, object]]:
    """For each package that must be built: the stamp that vouches for it afterwards."""
    environment_key = read_stamp(folder / "environment.json").get("key")
    out: dict[str, dict[str, object]] = {}
    for package, (read, linked) in sources(root).items():
        wanted: dict[str, object] = {
            "environment": environment_key,
            "files": [str(path.relative_to(root)) for path in (*read, *linked)],
            "fingerprint": fingerprint(read),
        }
        installed = folder / "install" / package / "share" / package / "package.xml"
        if read_stamp(folder / f"{package}.json") != wanted or not installed.exists():
            out[package] = wanted
    return out


def build(root: Path, folder: Path, steps: Steps, environ: Mapping[str, str]) -> None:
    """Build what is stale; each package's stamp goes before and comes back after."""
    todo = stale(root, folder)
    for package, wanted in todo.items():
        stamp = folder / f"{package}.json"
        before = read_stamp(stamp)
        stamp.unlink(missing_ok=True)
        same = all(before.get(name) == wanted[name] for name in ("environment", "files"))
        if package == STAGE or not same:
            remove_tree(folder / "build" / package)
            remove_tree(folder / "install" / package)
    remove_tree(folder / "log")
    python = folder / "env/bin/python"
    command: list[str | os.PathLike[str]] = [
        python,
        "-m",
        "colcon",
        "--log-base",
        folder / "log",
        "build",
        "--base-paths",
        root,
        root / INTERFACES,
        "--build-base",
        folder / "build",
        "--install-base",
        folder / "install",
        "--packages-select",
        *todo,
        "--symlink-install",
        "--event-handlers",
        "console_direct+",
        "--cmake-args",
        "-GNinja",
        "-DCMAKE_BUILD_TYPE=Release",
        f"-DPython3_EXECUTABLE={python}",
        f"-DPYTHON_EXECUTABLE={python}",
        "-DBUILD_TESTING=OFF",
    ]
    with steps.step(f"colcon build {' '.join(todo)}"):
        # nobody's colcon settings, and not colcon's load limit: it starves on a busy machine
        own = {
            "COLCON_HOME": str(folder / "colcon"),
            "COLCON_DEFAULTS_FILE": os.devnull,
            "MAKEFLAGS": f"-j{os.cpu_count() or 1}",
        }
        steps.call(command, env={**environ, **own}, what="colcon build", cwd=root)
    make_startable(folder / "install" / STAGE / "lib" / STAGE, python)
    for package, wanted in todo.items():
        write_stamp(folder / f"{package}.json", wanted)


def make_startable(scripts: Path, python: Path) -> None:
    """Start scripts through sh where the kernel cannot read the interpreter's path.

    It stops reading at a space, and at 127 characters.
    """
    if " " not in str(python) and len(str(python)) < LONGEST_INTERPRETER:
        return
    for script in scripts.glob("*"):
        first, _, rest = script.read_text(encoding="utf-8").partition("\n")
        if first.startswith("#!") and first != "#!/bin/sh":
            write_whole(script, THROUGH_SH.format(python=python) + rest)
            script.chmod(0o755)


FOREIGN = ("PYTHONHOME", "PYTHONPLATLIBDIR", "PYTHONDONTWRITEBYTECODE", "COLCON_PREFIX_PATH")


def variables(host: Host, folder: Path, environ: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the built packages run; nothing of another environment leaks in."""
    env, install = folder / "env", folder / "install"
    site = f"lib/python{host.version}/site-packages"
    out = dict(environ)
    for name in FOREIGN:
        out.pop(name, None)
    # compiled once, not by every node; in our own folder, so that the checkout stays clean
    out["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
    ours = [str(install / STAGE), str(install / INTERFACES)]
    python_path = [
        str(folder / "build" / STAGE),
        str(install / STAGE / site),
        str(install / INTERFACES / site),
    ]
    libraries = [str(install / INTERFACES / "lib")]
    first = {"PATH": [str(env / "bin")], "LD_LIBRARY_PATH": libraries}
    if host.ros_prefix:
        out["VIRTUAL_ENV"] = str(env)
        first |= {"AMENT_PREFIX_PATH": ours, "CMAKE_PREFIX_PATH": ours, "PYTHONPATH": python_path}
    else:
        foreign = [
            entry
            for name in ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "VIRTUAL_ENV")
            for entry in environ.get(name, "").split(os.pathsep)
            if entry
        ]
        for name in ("PATH", "LD_LIBRARY_PATH"):
            out[name] = _without(out.get(name, ""), foreign)
        prefixes = os.pathsep.join([*ours, str(env)])
        out |= environment.settings(env)
        out |= {"AMENT_PREFIX_PATH": prefixes, "CMAKE_PREFIX_PATH": prefixes}
        out["PYTHONPATH"] = os.pathsep.join(python_path)
        libraries += environment.library_folders(env, host.version)
    for name, entries in first.items():
        _prepend(out, name, entries)
    out.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    out.setdefault("NUMBA_CACHE_DIR", str(folder / "numba"))
    return out


def _prepend(variables_: dict[str, str], name: str, entries: list[str]) -> None:
    old = [
        entry
        for entry in variables_.get(name, "").split(os.pathsep)
        if entry and entry not in entries
    ]
    variables_[name] = os.pathsep.join([*entries, *old])


def _without(value: str, prefixes: Iterable[str]) -> str:
    """The path list without the entries that lie in one of the prefixes."""
    roots = tuple(prefix.rstrip("/") + "/" for prefix in prefixes)
    return os.pathsep.join(
        entry
        for entry in value.split(os.pathsep)
        if entry and not f"{entry}/".startswith(roots or ("\0",))
    )
