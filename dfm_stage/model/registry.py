"""All effects, found by listing the package `dfm_stage.model.effects`."""

from __future__ import annotations

import importlib
import pkgutil

from dfm_stage.model import effects
from dfm_stage.model.effect import Effect


def _discover() -> dict[str, Effect]:
    found = {}
    for module in sorted(pkgutil.iter_modules(effects.__path__), key=lambda m: m.name):
        effect = importlib.import_module(f"{effects.__name__}.{module.name}").EFFECT
        found[effect.name] = effect
    return found


EFFECTS: dict[str, Effect] = _discover()
