"""The kinds of signals as ROS parameters: `reference.kind`, `reference.amplitude_m`, ...

Each setting of each kind becomes one parameter; only those that somebody gave count, the others
follow the chosen kind's own default.
"""

from __future__ import annotations

import array
from collections.abc import Mapping
from typing import Any

from dfm_stage.model.parameter import Parameter
from dfm_stage.nodes.parameters import Setting
from dfm_stage.trajectory import EXCITATION_KINDS, REFERENCE_KINDS

KINDS: Mapping[str, Mapping[str, Any]] = {"reference": REFERENCE_KINDS,
                                          "excitation": EXCITATION_KINDS}


def signal_settings() -> tuple[Setting, ...]:
    """Return the settings of every kind of reference and excitation."""
    out = []
    for part, kinds in KINDS.items():
        out.append(Setting(f"{part}.kind", "hold", f"which {part}: " + "; ".join(
            f"{kind.name} ({kind.description})" for kind in kinds.values()),
            choices=tuple(kinds), live=True))
        for name, entries in _by_name(kinds).items():
            out.append(_setting(f"{part}.{name}", entries))
    return tuple(out)


def specification(part: str, values: Mapping[str, Any], given: set[str]) -> dict[str, Any]:
    """Return the specification of `part` from parameter values, using only what was given."""
    out = {"kind": values[f"{part}.kind"]}
    for name in given:
        owner, _, key = name.partition(".")
        if owner == part and key != "kind":
            value = values[name]
            out[key] = list(value) if isinstance(value, array.array) else value
    return out


def _by_name(kinds: Mapping[str, Any]) -> dict[str, list[tuple[str, Any]]]:
    out: dict[str, list[tuple[str, Any]]] = {}
    for kind in kinds.values():
        for entry in (*kind.parameters, *kind.options):
            out.setdefault(entry.name, []).append((kind.name, entry))
    return out


def _setting(name: str, entries: list[tuple[str, Any]]) -> Setting:
    first = entries[0][1]
    text = f"{first.description} ({', '.join(kind for kind, _ in entries)})"
    if isinstance(first, Parameter):
        return Setting(name, float(first.default), text, first.unit,
                       min(entry.low for _, entry in entries),
                       max(entry.high for _, entry in entries), live=True)
    if isinstance(first.default, tuple):
        return Setting(name, array.array("d", first.default), text, first.unit, live=True)
    return Setting(name, first.default, text, choices=first.choices, live=True)
