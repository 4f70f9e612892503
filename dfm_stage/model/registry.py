"""All effects: those of the package `dfm_stage.model.effects`, and those registered at run time.

Whoever needs an effect looks it up here when it is needed, so that one that is registered later,
or replaced, counts from then on.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import sys
from pathlib import Path

from dfm_stage.model import effects
from dfm_stage.model.effect import Effect
from dfm_stage.model.parameter import ModelError

EFFECTS: dict[str, Effect] = {}


def register(effect: Effect) -> Effect:
    """Add an effect, in the place of one of the same name, and return it."""
    EFFECTS[effect.name] = effect
    return effect


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


for _module in sorted(pkgutil.iter_modules(effects.__path__), key=lambda m: m.name):
    register(importlib.import_module(f"{effects.__name__}.{_module.name}").EFFECT)
