"""Files of formulas: one mapping, a list of them, or a list below `effects:`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from dfm_stage.model.formula import KINDS, Formula, formula_of
from dfm_stage.model.formula_text import FormulaError, shown

YAML_ENDINGS = (".yaml", ".yml")
LARGEST_BYTES = 1_000_000
_KEYS = {"name", "parameters", "state", "origin", *KINDS}


def read_formulas(path: Path) -> list[Formula]:
    """The formulas of a YAML file.

    Raises
    ------
    FormulaError
        If the file cannot be read, or holds something else; each message begins with its name.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise FormulaError(f"{path}: larger than {LARGEST_BYTES / 1e6:g} MB")
        data: Any = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FormulaError(f"{path}: cannot be read: {error.strerror}") from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise FormulaError(f"{path}: not valid YAML: "
                           f"{' '.join(str(error).split())[:200]}") from error
    listed = data.get("effects") if isinstance(data, Mapping) and "effects" in data else data
    entries = listed if isinstance(listed, list) else [listed]
    found = [_formula(path, entry) for entry in entries]
    names = [formula.name for formula in found]
    for name in names:
        if names.count(name) > 1:
            raise FormulaError(f"{path}: {name} stands there {names.count(name)} times")
    return found


def _formula(path: Path, entry: Any) -> Formula:
    if not isinstance(entry, Mapping):
        raise FormulaError(f"{path}: a formula needs name, force and parameters, "
                           f"not {shown(entry)}")
    strange = [key for key in entry if key not in _KEYS]
    if strange:
        raise FormulaError(f"{path}: {shown(strange[0])} is no key of a formula; known are "
                           f"{', '.join(sorted(_KEYS))}")
    try:
        formula = formula_of(entry)
        formula.effect()
    except FormulaError as error:
        raise FormulaError(f"{path}: {error}") from None
    return formula
