"""Where the force of a formula jumps with the speed, it can stick: what may be done about it.

A term `- f * sign(v)` is dry friction, which the simulator knows: it locates every reversal and
breakaway. Any other jump is refused, because a point that rests on a jump has no motion that steps
of time could follow. Jumps are looked for where they can be: at rest, and where the argument of a
sign or both sides of a comparison meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.formula_text import COMPARISONS, Node, fail, value

TRIALS, SPEEDS = 24, 61
"""Motions at which jumps are looked for, and the speeds along each of them."""
HALVINGS = 200
"""Of an interval of speeds that has a jump in it, down to neighbouring numbers."""
AT_REST = 1e-200
"""m/s: a speed so small that what is continuous has not changed from zero."""
JUMP = 1e-6
"""A change over the largest value of a term that is a jump, far above rounding."""
Given = Mapping[str, tuple[float, tuple[float, float] | None]]
"""Parameter -> its value and its range."""


def part_friction(tree: Node, given: Given) -> tuple[Node | None, str]:
    """A force without its dry friction (None where nothing is left), and the parameter that is
    the friction, or nothing.

    Raises
    ------
    FormulaError
        If the force jumps with the speed in another way.
    """
    rest: Node | None = None
    rubs = ""
    for sign, term in _terms(tree):
        found = _dry(sign, term, given)
        if found and rubs:
            fail(term.column, "a second sign(v); add the two frictions to one parameter")
        if found:
            rubs = found
            continue
        if "v" in term.names and _jumps(term, given):
            fail(term.column, f"{term.text()[:60]} jumps with the speed, and may stick there: "
                 "friction that sticks is a term - f * sign(v) of one parameter f; else let it "
                 "change smoothly, as in tanh(v / v0)")
        rest = _sum(rest, sign, term)
    return (tree if not rubs else rest), rubs


def _terms(node: Node, sign: float = 1.0) -> Iterator[tuple[float, Node]]:
    """The terms of a sum, each with its sign."""
    if node.kind in ("+", "-"):
        yield from _terms(node.parts[0], sign)
        yield from _terms(node.parts[1], sign if node.kind == "+" else -sign)
    elif node.kind == "negative":
        yield from _terms(node.parts[0], -sign)
    else:
        yield sign, node


def _sum(rest: Node | None, sign: float, term: Node) -> Node:
    if rest is None:
        return term if sign > 0.0 else Node("negative", (term,), column=term.column)
    return Node("+" if sign > 0.0 else "-", (rest, term), column=term.column)


def _dry(sign: float, term: Node, given: Given) -> str:
    """The parameter f of a term - f sign(v); empty where it is none."""
    factor, names, signs = sign, [], 0
    for part in _factors(term):
        if part.kind == "number":
            factor *= part.number
        elif part.kind == "negative":
            factor = -factor
        elif part.kind == "name" and part.name in given:
            names.append(part.name)
        elif part.kind == "sign" and part.parts[0].kind == "name" and part.parts[0].name == "v":
            signs += 1
        else:
            return ""
    return names[0] if (factor, len(names), signs) == (-1.0, 1, 1) else ""


def _factors(node: Node) -> Iterator[Node]:
    """The factors of a product; a minus before one of them stands for itself."""
    if node.kind == "*":
        for part in node.parts:
            yield from _factors(part)
    elif node.kind == "negative":
        yield Node("negative")
        yield from _factors(node.parts[0])
    else:
        yield node


def _jumps(term: Node, given: Given) -> bool:
    """Whether a term jumps at some speed."""
    rng = np.random.default_rng(0)
    at = {name: _drawn(rng, *given.get(name, (0.0, None)))[:, None] for name in term.names}
    speeds = np.geomspace(1e-6, 1.0, SPEEDS // 2) * 3.0
    v = np.tile(np.concatenate((-speeds[::-1], [0.0], speeds)), (TRIALS, 1))
    largest = np.nanmax(np.where(np.isfinite(found := np.abs(value(term, {**at, "v": v})) + 0.0 * v),
                                 found, 0.0))

    def differs(low: Array, high: Array, rows: Array) -> bool:
        own = {name: each[rows] for name, each in at.items()}
        change = value(term, {**own, "v": high}) - value(term, {**own, "v": low})
        change = np.abs(change[np.isfinite(change)])
        return bool(np.any(change > JUMP * largest))

    every = np.arange(TRIALS)
    rest = np.full((TRIALS, 1), AT_REST)
    if differs(-rest, rest, every):
        return True
    for gap in _gaps(term):
        side = value(gap, {**at, "v": v}) + 0.0 * v > 0.0
        rows, places = np.nonzero(side[:, 1:] != side[:, :-1])
        if rows.size == 0:
            continue
        low, high = v[rows, places][:, None], v[rows, places + 1][:, None]
        own = {name: each[rows] for name, each in at.items()}
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            same = (value(gap, {**own, "v": middle}) > 0.0) == side[rows, places][:, None]
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        if differs(low, high, rows):
            return True
    return False


def _gaps(term: Node) -> Iterator[Node]:
    """What is zero where a sign() or a comparison changes with the speed."""
    for node in term.walk():
        if node.kind == "sign" and "v" in node.names:
            yield node.parts[0]
        elif node.kind in COMPARISONS.values() and "v" in node.names:
            yield Node("-", node.parts)


def _drawn(rng: np.random.Generator, held: float, limits: tuple[float, float] | None) -> Array:
    """Values (TRIALS,) of a parameter in its range, or of a variable around zero."""
    if limits is not None:
        return np.asarray(rng.uniform(*limits, TRIALS))
    size = abs(held) or 10.0 ** rng.uniform(-3.0, 1.0, TRIALS)
    return np.asarray(size * rng.uniform(0.5, 1.5, TRIALS) * (
        1.0 if held > 0.0 else -1.0 if held < 0.0 else rng.choice([-1.0, 1.0], TRIALS)))
