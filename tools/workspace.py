"""colcon build of this repository into the private folder, and the variables that make it visible."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import environment
from console import Steps, read_stamp, remove_tree, say, write_stamp
from host import Host

REVISION = 1  # raise it when the way of building changes
INTERFACES, STAGE = "dfm_interfaces", "dfm_stage"


def sources(root: Path) -> dict[str, list[Path]]:
    """Files that decide how each package is built and what is installed.

    The Python modules are not among them: they are linked, an edit takes effect without a build.
    """
    stage = [root / name for name in ("package.xml", "setup.py", "setup.cfg")]
    stage += [root / "dfm_stage" / name for name in ("__init__.py", "commands.py")]
    for folder in ("resource", "config", "launch"):
        stage += _files(root / folder)
    return {INTERFACES: _files(root / INTERFACES), STAGE: stage}


def _files(folder: Path) -> list[Path]:
    found: list[Path] = []
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if name != "__pycache__")
        found += [Path(where, name) for name in sorted(names)
                  if not name.endswith((".pyc", ".swp", "~"))]
    return found


def fingerprint(paths: Iterable[Path]) -> str:
    """Hash over names, permissions to execute and contents; a missing file counts as empty."""
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
    for package, paths in sources(root).items():
        wanted: dict[str, object] = {
            "environment": environment_key,
            "files": [str(path.relative_to(root)) for path in paths],
            "fingerprint": fingerprint(paths),
        }
        if read_stamp(folder / f"{package}.json") != wanted:
            out[package] = wanted
    return out


def build(root: Path, host: Host, folder: Path, steps: Steps, environ: Mapping[str, str]) -> None:
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
    python = folder / "env/bin/python"
    command = [
        python, "-m", "colcon", "--log-base", folder / "log", "build",
        "--base-paths", root, root / INTERFACES,
        "--build-base", folder / "build", "--install-base", folder / "install",
        "--packages-select", *todo, "--symlink-install",
        "--event-handlers", "console_direct+",
        "--cmake-args", "-GNinja", "-DCMAKE_BUILD_TYPE=Release", f"-DPython3_EXECUTABLE={python}",
        f"-DPYTHON_EXECUTABLE={python}", "-DBUILD_TESTING=OFF",
    ]
    with steps.step(f"colcon build {' '.join(todo)}"):
        colcon_home = {"COLCON_HOME": str(folder / "colcon"), "COLCON_DEFAULTS_FILE": os.devnull}
        steps.call(command, {**environ, **colcon_home}, "colcon build", cwd=root)
    for package, wanted in todo.items():
        write_stamp(folder / f"{package}.json", wanted)


def variables(host: Host, folder: Path, environ: Mapping[str, str]) -> dict[str, str]:
    """The environment in which the built packages run; nothing of another environment leaks in."""
    env, install = folder / "env", folder / "install"
    site = f"lib/python{host.version}/site-packages"
    out = dict(environ)
    for name in ("PYTHONHOME", "PYTHONPLATLIBDIR", "COLCON_PREFIX_PATH"):
        out.pop(name, None)
    ours = [str(install / STAGE), str(install / INTERFACES)]
    python_path = [str(folder / "build" / STAGE), str(install / STAGE / site),
                   str(install / INTERFACES / site)]
    libraries = [str(install / INTERFACES / "lib")]
    path = [str(env / "bin")]
    if host.ros_prefix:
        out["VIRTUAL_ENV"] = str(env)
        _prepend(out, "AMENT_PREFIX_PATH", ours)
        _prepend(out, "CMAKE_PREFIX_PATH", ours)
        _prepend(out, "PYTHONPATH", python_path)
    else:
        foreign = [entry for name in ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "VIRTUAL_ENV")
                   for entry in environ.get(name, "").split(os.pathsep) if entry]
        for name in ("PATH", "LD_LIBRARY_PATH"):
            out[name] = _without(out.get(name, ""), foreign)
        wanted_rmw = environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
        out.update(environment.settings(env, host.version))
        if wanted_rmw != out["RMW_IMPLEMENTATION"]:
            say(f"run: RMW_IMPLEMENTATION={wanted_rmw} is not in the private environment, "
                "rmw_fastrtps_cpp is used: source a ROS 2 installation that has it")
        out["AMENT_PREFIX_PATH"] = os.pathsep.join([*ours, str(env)])
        out["CMAKE_PREFIX_PATH"] = os.pathsep.join([*ours, str(env)])
        out["PYTHONPATH"] = os.pathsep.join(python_path)
        libraries += environment.library_folders(env, host.version)
    _prepend(out, "PATH", path)
    _prepend(out, "LD_LIBRARY_PATH", libraries)
    out.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    out.setdefault("NUMBA_CACHE_DIR", str(folder / "numba"))
    out["DFM_STAGE_ROOT"] = str(folder.parent.parent)
    return out


def _prepend(variables_: dict[str, str], name: str, entries: list[str]) -> None:
    old = [entry for entry in variables_.get(name, "").split(os.pathsep)
           if entry and entry not in entries]
    variables_[name] = os.pathsep.join([*entries, *old])


def _without(value: str, prefixes: Iterable[str]) -> str:
    """The path list without the entries that lie in one of the prefixes."""
    roots = tuple(prefix.rstrip("/") + "/" for prefix in prefixes)
    return os.pathsep.join(entry for entry in value.split(os.pathsep)
                           if entry and not f"{entry}/".startswith(roots or ("\0",)))
