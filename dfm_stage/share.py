"""Where configuration lives: in a source tree or installed beside the package."""

from __future__ import annotations

import os
from pathlib import Path

from dfm_stage.errors import DfmError


def config_folder() -> Path:
    """Return the folder `config` of the source tree, or the installed one.

    Raises
    ------
    DfmError
        If there is neither.
    """
    package = Path(__file__).resolve().parent
    prefixes = map(Path, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
    for folder in (package.parent, *(prefix / "share" / "dfm_stage"
                                     for prefix in (*package.parents, *prefixes))):
        if (folder / "config" / "experiments").is_dir():
            return folder / "config"
    raise DfmError("dfm_stage's config folder is not found; build the package with colcon or run "
                   "from its source tree")


def find_experiment(name: str) -> Path:
    """Return the file of an experiment given by path or by its name in config/experiments.

    Raises
    ------
    DfmError
        If there is no such file; the message lists the names there are.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} or path.is_file():
        return path
    folder = config_folder() / "experiments"
    named = folder / f"{name}.yaml"
    if not named.is_file():
        names = ", ".join(sorted(each.stem for each in folder.glob("*.yaml"))) or "none yet"
        raise DfmError(f"there is no experiment {name!r}; known: {names}; or give a .yaml file")
    return named
