"""References and excitations as ROS parameters, and back."""

from __future__ import annotations

import array
from collections.abc import Mapping
from typing import Any

from dfm_stage.model.parameter import Parameter
from dfm_stage.nodes.parameters import Setting
from dfm_stage.trajectory import EXCITATION_KINDS, REFERENCE_KINDS

KINDS: Mapping[str, Mapping[str, Any]] = {"reference": REFERENCE_KINDS,
                                          "excitation": EXCITATION_KINDS}
"""Each setting of each kind is one parameter: `reference.kind`, `reference.amplitude_m`, ...
Only those that somebody gave count, the others follow the chosen kind's own default."""


def signal_settings() -> tuple[Setting, ...]:
    """Return the settings of every kind of reference and excitation."""
    out = []
    for part, kinds in KINDS.items():
        out.append(Setting(f"{part}.kind", "hold", f"which {part}: " + "; ".join(
            f"{kind.name} ({kind.description})" for kind in kinds.values()),
            choices=tuple(kinds), live=True))
        by_name: dict[str, list[tuple[str, Any]]] = {}
        for kind in kinds.values():
            for entry in (*kind.parameters, *kind.options):
                by_name.setdefault(entry.name, []).append((kind.name, entry))
        out += [_setting(f"{part}.{name}", entries) for name, entries in by_name.items()]
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
