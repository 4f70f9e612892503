"""What comes with the package, and how it came here."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from dfm_stage.errors import DfmError


def config_folder() -> Path:
    """Return the folder of models, experiments and node parameters that comes with the package."""
    return Path(str(files("dfm_stage"))) / "config"


def door() -> str:
    """Return what is typed here before the name of a command."""
    package = Path(str(files("dfm_stage"))).resolve()
    if (package.parent / "run").is_file():
        return "./run"
    if any((folder / "share" / package.name / "package.xml").is_file()
           for folder in package.parents):
        return f"ros2 run {package.name}"
    return "dfm-stage"


def needs_ros(what: str) -> str:
    """Return the line that refuses `what`, a node or a run of nodes, where there is no ROS 2."""
    return (f"{what} needs ROS 2 Jazzy, which is not here: start it as ./run {what} in a clone of "
            "the repository, which brings its own, or source the workspace's install/setup.bash")


def find_experiment(name: str) -> Path:
    """Return the file of an experiment given by path or by its name in config/experiments.

    Raises
    ------
    DfmError
        If there is no such file; the message lists the names there are.
    """
    path = Path(name)
    folder = config_folder() / "experiments"
    named = folder / f"{name}.yaml"
    try:
        if path.suffix in {".yaml", ".yml"} or path.is_file():
            return path
        there = named.is_file()
    except OSError:         # a name that no file can have
        there = False
    if not there:
        names = ", ".join(sorted(each.stem for each in folder.glob("*.yaml"))) or "none yet"
        raise DfmError(f"there is no experiment {name!r}; known: {names}; or give a .yaml file")
    return named
