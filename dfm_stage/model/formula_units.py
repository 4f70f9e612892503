"""Units of a formula: what each part is measured in, and where that cannot be.

A part is a product of powers of m, kg, s and A, or unknown. Numbers such as 2 or 0.5 are pure; one
such as 9.81 or 1e-3 may stand for something with a unit, so that what it touches is unknown, and 0
fits anywhere. A parameter without a unit is unknown, too. What is unknown is not checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction

from dfm_stage.model.conditions import Conditions
from dfm_stage.model.formula_text import COMPARISONS, FormulaError, Node, fail

Dimension = tuple[Fraction, ...]
"""Exponents of m, kg, s and A."""
LARGEST_PURE = 100.0
"""Wholes and halves up to this one are pure numbers."""
_BASE = ("m", "kg", "s", "A")


def _of(*exponents: int) -> Dimension:
    return tuple(map(Fraction, exponents))


PURE = _of(0, 0, 0, 0)
_UNITS: dict[str, Dimension] = {
    "m": _of(1, 0, 0, 0), "kg": _of(0, 1, 0, 0), "s": _of(0, 0, 1, 0), "A": _of(0, 0, 0, 1),
    "N": _of(1, 1, -2, 0), "V": _of(2, 1, -3, -1), "ohm": _of(2, 1, -3, -2),
    "H": _of(2, 1, -2, -2), "W": _of(2, 1, -3, 0), "J": _of(2, 1, -2, 0),
    "Hz": _of(0, 0, -1, 0), "Pa": _of(-1, 1, -2, 0), "K": PURE, "rad": PURE, "1": PURE}
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^(-?\d(?:\.\d)?))?")


def dimension(unit: str) -> Dimension:
    """The dimension of a unit such as `N s^2/m^2`; all behind the first / divides.

    Raises
    ------
    FormulaError
        If it is no product of known units.
    """
    total = PURE
    for place, part in enumerate(unit.strip().split("/")):
        for factor in part.replace("*", " ").strip("() ").split():
            found = _FACTOR.fullmatch(factor)
            if found is None or found[1] not in _UNITS:
                raise FormulaError(f"unit {unit[:40]!r} is not known; SI units as in N s/m: "
                                   f"{', '.join(_UNITS)}")
            power = Fraction(found[2] or "1") * (-1 if place else 1)
            total = _times(total, _UNITS[found[1]], power)
    return total


def _times(a: Dimension, b: Dimension, power: Fraction) -> Dimension:
    return tuple(x + power * y for x, y in zip(a, b, strict=True))


def words(found: Dimension) -> str:
    """A dimension in SI units."""
    for unit, known in _UNITS.items():
        if known == found and unit not in ("K", "rad", "1"):
            return unit
    over = " ".join(_power(u, e) for u, e in zip(_BASE, found, strict=True) if e > 0)
    under = " ".join(_power(u, -e) for u, e in zip(_BASE, found, strict=True) if e < 0)
    if not (over or under):
        return "a pure number"
    return f"{over or '1'}/{under}" if under else over


def _power(unit: str, exponent: Fraction) -> str:
    return unit if exponent == 1 else f"{unit}^{float(exponent):g}"


def check(node: Node, units: Mapping[str, Dimension | None],
          wanted: Dimension | None) -> None:
    """See that a formula is measured in `wanted`.

    Raises
    ------
    FormulaError
        If a sum, a function or the whole cannot be; with the column.
    """
    found = measure(node, units)
    if found is not None and wanted is not None and found != wanted:
        fail(node.column, f"{node.text()[:60]} is in {words(found)}, not in {words(wanted)}; "
             "a number with a unit is a parameter")


def times_seconds(found: Dimension | None, power: int = 1) -> Dimension | None:
    """The unit times s, or times another power of it."""
    return found and _times(found, _UNITS["s"], Fraction(power))


def scale(found: Dimension, at: Conditions) -> float:
    """The size that something of this dimension has in the records.

    In terms of the motion, its time (motion over speed), the force, and the drive for A.
    """
    length, ampere = at.motion, max(at.drive, 1e-300)
    time = length / at.speed
    sizes = (length, at.force * time**2 / length, time, ampere)
    return float(math.prod(size ** float(e) for size, e in zip(sizes, found, strict=True)))


def measure(node: Node, units: Mapping[str, Dimension | None]) -> Dimension | None:
    """What a formula is measured in; None where that is unknown.

    Raises
    ------
    FormulaError
        If a sum or a function has parts that do not fit.
    """
    if node.kind == "number":
        pure = node.number != 0.0 and (2.0 * node.number).is_integer() \
            and abs(node.number) <= LARGEST_PURE
        return PURE if pure else None
    if node.kind == "name":
        return units[node.name]
    found = [measure(part, units) for part in node.parts]
    if node.kind in ("*", "/"):
        first, second = found
        if first is None or second is None:
            return None
        return _times(first, second, Fraction(1 if node.kind == "*" else -1))
    if node.kind == "**":
        return _raised(node, found)
    if node.kind == "sqrt":
        return found[0] and _times(PURE, found[0], Fraction(1, 2))
    if node.kind in ("negative", "abs"):
        return found[0]
    if node.kind == "sign":
        return PURE
    if node.kind in ("+", "-", "min", "max"):
        return _same(node, found)
    if node.kind in COMPARISONS.values():
        _same(node, found)
        return PURE
    if node.kind == "where":
        return _same(Node("where", node.parts[1:], column=node.column), found[1:])
    if found[0] not in (None, PURE):
        fail(node.parts[0].column, f"{node.kind}() takes a pure number, "
             f"not {node.parts[0].text()[:40]} in {words(found[0])}")
    return PURE


def _raised(node: Node, found: list[Dimension | None]) -> Dimension | None:
    base, power = found
    if power not in (None, PURE):
        fail(node.parts[1].column, f"a power is a pure number, not in {words(power)}")
    if base is None or base == PURE:
        return base
    if node.parts[1].kind != "number":
        fail(node.parts[0].column, f"{node.parts[0].text()[:40]} in {words(base)} has a power "
             "that can change; divide it by a parameter of its unit")
    return _times(PURE, base, Fraction(node.parts[1].number).limit_denominator(64))


def _same(node: Node, found: list[Dimension | None]) -> Dimension | None:
    known = [(part, each) for part, each in zip(node.parts, found, strict=True)
             if each is not None]
    if not known:
        return None
    first, its = known[0]
    for part, other in known[1:]:
        if other != its:
            place = "sum" if node.kind in "+-" else node.kind if node.kind.isalpha() \
                else "comparison"
            fail(part.column, f"{part.text()[:40]} is in {words(other)}, "
                 f"but {first.text()[:40]} in {words(its)}; they stand in one {place}")
    return its
