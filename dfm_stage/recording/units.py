"""Units by the names that columns and options give them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, TypeAlias

Measured: TypeAlias = Literal["position", "velocity", "acceleration"]
_RATE = re.compile(r"(?P<unit>.+?)[/_]s(?P<square>2|\^2|²)?")


@dataclass(frozen=True)
class Unit:
    """`factor` times a value in this unit is the value in `base`; other units are carried."""

    base: str
    factor: float = 1.0


def _scaled(base: str, **names: float) -> dict[str, Unit]:
    return {name: Unit(base, factor) for name, factor in names.items()}


_TRAVEL = {
    **_scaled("m", m=1.0, cm=1e-2, mm=1e-3, um=1e-6, nm=1e-9, pm=1e-12),
    **{name: Unit(name) for name in ("rad", "mrad", "urad", "deg", "arcsec", "counts")},
}
UNITS: dict[str, Unit] = {
    **_scaled("s", s=1.0, sec=1.0, ms=1e-3, us=1e-6, ns=1e-9),
    **_TRAVEL,
    **_scaled("V", v=1.0, kv=1e3, mv=1e-3, uv=1e-6),
    **_scaled("A", a=1.0, ma=1e-3, ua=1e-6),
}
CASED = {"N": Unit("N"), "mN": Unit("N", 1e-3), "Nm": Unit("N m"), "N m": Unit("N m")}
FORCES = {**_scaled("N", n=1.0, kn=1e3, mn=1e-3), **_scaled("N m", nm=1.0, mnm=1e-3)}
"""What an input may be in whatever the case: nobody's input is a length in nanometres."""


def unit_of(name: str, *, of_input: bool = False) -> Unit | None:
    """Return the unit of that name (`um`, `μm`, `mV`, `mm/s`, `rad_s`), None if it is not known.

    Of an input, `n` and `nm` are newtons and newton metres.
    """
    plain = name.strip().replace("µ", "u").replace("μ", "u")
    found = CASED.get(plain) or (FORCES.get(plain.lower()) if of_input else None)
    found = found or UNITS.get(plain.lower())
    rate = _RATE.fullmatch(plain.lower())
    if found is None and rate and (travel := _TRAVEL.get(rate["unit"])):
        return Unit(f"{travel.base}/s{'^2' if rate['square'] else ''}", travel.factor)
    return found


def suffix_of(column: str, *, of_input: bool = False) -> tuple[str, Unit | None]:
    """Split a column name into (rest, unit): `x_position_um`, `velocity_mm_s`, `position [um]`."""
    bracket = re.fullmatch(r"(.*?)\s*[\[(]([^\])]+)[\])]\s*", column)
    if bracket:
        splits = [(bracket[1], bracket[2])]
    else:
        parts = column.split("_")
        splits = [("_".join(parts[:-k]), "_".join(parts[-k:])) for k in (2, 1)]
    for rest, suffix in splits:
        unit = unit_of(suffix, of_input=of_input) if rest else None
        if unit:
            return rest.strip(), unit
    return column.strip(), None


def measured(unit: str) -> tuple[str, Measured]:
    """Split the unit of an output into that of travel and what is measured: (`m`, `velocity`)."""
    if unit.endswith("/s^2"):
        return unit.removesuffix("/s^2"), "acceleration"
    if unit.endswith("/s"):
        return unit.removesuffix("/s"), "velocity"
    return unit, "position"


def column_unit(unit: str) -> str:
    """Return a unit as the suffix of a column: `m/s` as `m_s`."""
    return unit.replace(" ", "").replace("^", "").replace("/", "_").lower()
