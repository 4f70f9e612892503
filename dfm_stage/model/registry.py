"""All effects: those of the package `dfm_stage.model.effects`, and those registered at run time.

Whoever needs an effect looks it up here when it is needed, so that one that is registered later,
or replaced, counts from then on. What is listed here is what a diagnosis looks for first. Two
kinds are found by their name and are no members: those of `effects.uncommon`, which are loaded
when they
are first asked for, and a formula that a model holds, as long as somebody holds the formula.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import itertools
import os
import pkgutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakValueDictionary

from dfm_stage.model import effects
from dfm_stage.model.effect import Effect
from dfm_stage.model.effects import uncommon
from dfm_stage.model.formula import FormulaEffect
from dfm_stage.model.formula_file import YAML_ENDINGS, read_formulas
from dfm_stage.model.parameter import ModelError

UNCOMMON = sorted(module.name for module in pkgutil.iter_modules(uncommon.__path__))
"""Effects that are found by their name, and not listed."""
ALL = "all"
"""Stands for every effect where effects are named."""


class Effects(dict[str, Effect]):
    """The effects by name; uncommon ones, and formulas of models, are found and not listed."""

    def __init__(self) -> None:
        super().__init__()
        self._of_models: WeakValueDictionary[str, Effect] = WeakValueDictionary()

    def hold(self, effect: Effect) -> None:
        """Find an effect by its name as long as somebody holds it; of two the newer one."""
        self._of_models[effect.name] = effect

    def __missing__(self, name: str) -> Effect:
        if name in UNCOMMON:
            return _loaded(uncommon, name)
        return self._of_models[name]

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or name in UNCOMMON or name in self._of_models

    def get(self, name: str, default: Any = None) -> Any:
        """As of any mapping."""
        return self[name] if name in self else default  # noqa: SIM401 that would be this


EFFECTS = Effects()


def library_of(names: Iterable[str] | None = None) -> list[str]:
    """The effects that a diagnosis looks for first: those that are listed, or `names`, of which
    ALL stands for these and the uncommon ones."""
    if names is None:
        return list(EFFECTS)
    return list(dict.fromkeys(itertools.chain.from_iterable(
        (*EFFECTS, *UNCOMMON) if name == ALL else (name,) for name in names)))


def register(effect: Effect) -> Effect:
    """Add an effect, in the place of one of the same name, and return it."""
    EFFECTS[effect.name] = effect
    return effect


def load_effects(path: str | os.PathLike[str]) -> list[Effect]:
    """Register the effects of a file, or of all files of a folder, and return them.

    A Python file holds one `EFFECT`; a YAML file formulas, see `formula_file`.

    Raises
    ------
    ModelError
        If there is none, or one of them cannot be used.
    """
    place = Path(path).expanduser()
    files = sorted(each for each in place.iterdir() if each.suffix in (".py", *YAML_ENDINGS)) \
        if place.is_dir() else [place]
    if not files:
        raise ModelError(f"{path}: the folder has no .yaml and no .py file")
    found: list[Effect] = []
    for file in files:
        if file.suffix == ".py":
            found.append(load_effect(file))
            continue
        for formula in read_formulas(file):
            library = EFFECTS.get(formula.name)
            if isinstance(library, Effect) and not isinstance(library, FormulaEffect):
                raise ModelError(f"{file}: {formula.name} is an effect of the library; give the "
                                 "formula another name")
            found.append(register(formula.effect()))
    return found


@contextlib.contextmanager
def effects_of(paths: Sequence[str | os.PathLike[str]]) -> Iterator[list[Effect]]:
    """The effects of files, registered while the context lasts.

    Raises
    ------
    ModelError
        As `load_effects`.
    """
    before = dict(EFFECTS)
    try:
        yield [effect for path in paths for effect in load_effects(path)]
    finally:
        EFFECTS.clear()
        EFFECTS.update(before)


def load_effect(path: str | os.PathLike[str]) -> Effect:
    """Register the `EFFECT` of a Python file outside the package, and return it.

    Raises
    ------
    ModelError
        If the file cannot be run, or holds no effect.
    """
    spec = importlib.util.spec_from_file_location(f"effect_{Path(path).stem}", path)
    if spec is None or spec.loader is None:
        raise ModelError(f"{path}: an effect is a Python file; name one that ends in .py")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ModelError(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise ModelError(f"{path}: holds no effect; it needs EFFECT = Effect(...)")
    return register(effect)


def coupling_effect() -> Effect:
    """The effect by which one axis acts on another: the first to which the other axis counts.

    Raises
    ------
    ModelError
        If none is registered.
    """
    for effect in EFFECTS.values():
        if effect.couples:
            return effect
    raise ModelError("no effect is registered by which one axis acts on another")


def _loaded(package: ModuleType, name: str) -> Effect:
    """The effect of a module of a package."""
    effect: Effect = importlib.import_module(f"{package.__name__}.{name}").EFFECT
    return effect


for _module in sorted(pkgutil.iter_modules(effects.__path__), key=lambda m: m.name):
    if not _module.ispkg:
        register(_loaded(effects, _module.name))
