"""Where configuration lives: in a source tree or installed beside the package."""

from __future__ import annotations

from pathlib import Path

from dfm_stage.errors import DfmError


def config_folder() -> Path:
    """Return the folder `config` of the source tree, or the installed one.

    Raises
    ------
    DfmError
        If there is neither.
    """
    tree = Path(__file__).resolve().parents[1] / "config"
    if tree.is_dir():
        return tree
    try:
        from ament_index_python.packages import get_package_share_directory

        installed = Path(get_package_share_directory("dfm_stage")) / "config"
    except (ImportError, LookupError):
        installed = tree
    if not installed.is_dir():
        raise DfmError("dfm_stage's config folder is not found; build the package with colcon "
                       "or run from its source tree")
    return installed


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
