"""The registry of control laws: one file per law, here or beside a user's experiments.

A law is a class derived from `Law`; the parameter `mode` takes its name. Those of this folder are
in `LAWS`. `laws_with` adds those of other files without changing `LAWS`, so that two nodes of one
process may know different ones.
"""

from __future__ import annotations

import importlib.util
import inspect
import os
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from dfm_stage.control.errors import ControlError
from dfm_stage.control.law import Law
from dfm_stage.control.laws.lqr import Lqg
from dfm_stage.control.laws.pid import Pid

__all__ = ["DEFAULT_LAW", "LAWS", "OPEN_LOOP", "Law", "LawFileError", "Laws", "Lqg", "Pid",
           "laws_with", "modes"]

Laws = Mapping[str, type[Law]]
LAWS: Laws = {kind.name: kind for kind in (Pid, Lqg)}
DEFAULT_LAW = Pid.name
# The mode in which no law is in force.
OPEN_LOOP = "open_loop"


class LawFileError(ControlError):
    """A file is not a control law that can be used here."""


def modes(laws: Laws = LAWS) -> tuple[str, ...]:
    """Return what the parameter `mode` may be."""
    return (OPEN_LOOP, *laws)


def laws_with(files: str) -> dict[str, type[Law]]:
    """Return the laws that are here and those of files, separated as the entries of PATH are.

    Raises
    ------
    LawFileError
        If a file cannot be run, has no law, or one that would be mistaken for another.
    """
    laws = dict(LAWS)
    for file in filter(None, files.split(os.pathsep)):
        path = Path(file).expanduser()
        if not path.is_file():
            raise LawFileError(f"{file}: there is no such file of a control law")
        for kind in _laws_of(path.absolute(), path.stat().st_mtime_ns):
            if not kind.name.isidentifier() or kind.name in modes(laws):
                raise LawFileError(f"{file}: the law {kind.__name__} needs a name of its own such "
                                   f"as lead_lag, not {kind.name!r}")
            strange = [each.name for each in kind.parameters
                       if not each.name.startswith(f"{kind.name}_")]
            if strange:
                raise LawFileError(f"{file}: parameters of the law {kind.name} must begin with "
                                   f"{kind.name}_, unlike {', '.join(strange)}")
            laws[kind.name] = kind
    return laws


@lru_cache(maxsize=64)
def _laws_of(file: Path, _changed_ns: int) -> tuple[type[Law], ...]:
    """Run a file and return the laws that it defines, in their order; once until it changes."""
    name = f"dfm_stage_law_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise LawFileError(f"{file}: a control law is a Python file, its name ends in .py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:              # whatever a user's file does wrong, in one line
        raise LawFileError(f"{file}: {type(error).__name__}: {error}") from error
    found = tuple(
        each for each in vars(module).values() if isinstance(each, type)
        and issubclass(each, Law) and each.__module__ == name and not inspect.isabstract(each))
    if not found:
        raise LawFileError(f"{file}: defines no class derived from Law, with all of its methods")
    return found
