"""Files of formulas: one mapping, a list of them, or a list below `effects:`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dfm_stage.model.formula import KINDS, Formula, formula_of
from dfm_stage.model.formula_text import FormulaError, shown
from dfm_stage.yaml_text import YamlError, load_yaml, text_of

YAML_ENDINGS = (".yaml", ".yml")
_KEYS = {"name", "parameters", "state", "origin", *KINDS}


def read_formulas(path: Path) -> list[Formula]:
    """The formulas of a YAML file.

    Raises
    ------
    FormulaError
        If the file cannot be read, or holds something else; each message begins with its name.
    """
    try:
        data: Any = load_yaml(text_of(path))
    except OSError as error:
        raise FormulaError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError:
        raise FormulaError(f"{path}: cannot be read: it is not UTF-8 text") from None
    except YamlError as error:
        raise FormulaError(f"{error.at(path)}: not valid YAML: {error}") from error
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
