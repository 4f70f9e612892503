"""Unit suffixes of column names: `position_um` is a length and becomes metres."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Unit:
    """`factor` times a value in this unit is the value in `base`; other units are carried."""

    base: str
    factor: float = 1.0


def _scaled(base: str, **names: float) -> dict[str, Unit]:
    return {name: Unit(base, factor) for name, factor in names.items()}


UNITS: dict[str, Unit] = {
    **_scaled("s", s=1.0, sec=1.0, ms=1e-3, us=1e-6, ns=1e-9),
    **_scaled("m", m=1.0, cm=1e-2, mm=1e-3, um=1e-6, nm=1e-9, pm=1e-12),
    **_scaled("V", v=1.0, kv=1e3, mv=1e-3, uv=1e-6),
    **_scaled("A", a=1.0, ma=1e-3, ua=1e-6),
    **{name: Unit(name) for name in ("rad", "mrad", "urad", "deg", "arcsec", "counts")},
}
CASED = {"N": Unit("N"), "mN": Unit("N", 1e-3), "Nm": Unit("N m")}


def unit_of(name: str) -> Unit | None:
    """Return the unit of that name (`um`, `μm`, `mV`, ...), None if it is not known."""
    plain = name.strip().replace("µ", "u").replace("μ", "u")
    return CASED.get(plain) or UNITS.get(plain.lower())


def suffix_of(column: str) -> tuple[str, Unit | None]:
    """Split a column name into (rest, unit): `x_position_um` or `position [um]`."""
    bracket = re.fullmatch(r"(.*?)\s*[\[(]([^\])]+)[\])]\s*", column)
    rest, _, suffix = column.rpartition("_")
    if bracket:
        rest, suffix = bracket[1], bracket[2]
    unit = unit_of(suffix) if rest else None
    return (rest.strip(), unit) if unit else (column.strip(), None)
