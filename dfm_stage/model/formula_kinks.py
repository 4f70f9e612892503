"""Kinks and jumps of a formula: where steps must end, and where the force can stick.

Where a force jumps with the speed, the point can stick there. A term `- f * sign(v)` is dry
friction, which the simulator knows: it locates every reversal and breakaway. Any other such jump
is refused, because a point that rests on a jump has no motion that steps of time could follow.
Jumps are looked for where they can be: at rest, and where the argument of a sign or both sides of
a comparison meet.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.model.formula_text import COMPARISONS, Node, fail, value

TRIALS, PLACES = 24, 61
"""Draws of all other variables and parameters, and values of one along each of them."""
HALVINGS = 100
"""Of an interval that has a jump in it, down to neighbouring numbers."""
AT_REST = 1e-200
"""m/s: a speed so small that what is continuous has not changed from zero."""
JUMP = 1e-6
"""A change over the largest value of a term that is a jump, far above rounding."""
MOST_PIECES = 30
"""Places where a formula may change from one piece to another: each is looked at by itself."""
NEAR, BEND = 1e-3, 1e-5
"""Share of a value over which a slope is taken, and change of the slope over the largest value
that is a kink: |v| v has none at rest."""
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
    trial = _Trial(term, "v", given)
    rest = np.full((TRIALS, 1), AT_REST)
    return trial.jumps(-rest, rest, np.arange(TRIALS)) or any(
        trial.jumps(*found) for gap in _gaps(term) if "v" in gap.names
        for found in trial.roots(gap))


def kinks_of(nodes: Sequence[Node], given: Given, states: Sequence[str]) -> list[Node]:
    """What is zero where force or rates have a kink or a jump along the motion.

    Of a force with states that at rest is left out: no step crosses a reversal there.
    """
    found: dict[str, Node] = {}
    gaps = [(node, gap) for node in nodes for gap in _gaps(node)]
    if len(gaps) > MOST_PIECES:
        fail(gaps[MOST_PIECES][1].column, f"more than {MOST_PIECES} places where abs, sign, min, "
             "max and where change sides")
    for node, gap in gaps:
        if gap.kind == "name" and gap.name == "v" and states:
            continue
        for name in sorted({"x", "v", *states} & gap.names):
            trial = _Trial(node, name, given)
            if any(trial.bends(*root) for root in trial.roots(gap)):
                found[gap.text()] = gap
    return [*found.values()]


class _Trial:
    """A formula along one of its variables, the others drawn at random."""

    def __init__(self, node: Node, name: str, given: Given) -> None:
        rng = np.random.default_rng(0)
        self.node, self.name = node, name
        self.at = {n: _drawn(rng, *given.get(n, (0.0, None)))[:, None] for n in sorted(
            {"x", "v", *node.names})}
        half = 3.0 * np.geomspace(1e-6, 1.0, PLACES // 2)
        self.places = np.tile(np.concatenate((-half[::-1], [0.0], half)), (TRIALS, 1))
        every = np.abs(self.value(node, self.places))
        self.largest = float(np.max(every[np.isfinite(every)], initial=0.0))

    def value(self, node: Node, places: Array, rows: Lines | slice = slice(None)) -> Array:
        """(r, n) at values (r, n) of the variable, in some of the trials."""
        own = {name: each[rows] for name, each in self.at.items()}
        return np.asarray(value(node, {**own, self.name: places}) + 0.0 * places)

    def roots(self, gap: Node) -> Iterator[tuple[Array, Array, Lines]]:
        """Neighbouring numbers (r, 1) between which a gap changes its sign, and the trials."""
        side = self.value(gap, self.places) > 0.0
        rows, column = np.nonzero(side[:, 1:] != side[:, :-1])
        if not rows.size:
            return
        low, high = self.places[rows, column][:, None], self.places[rows, column + 1][:, None]
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            same = (self.value(gap, middle, rows) > 0.0) == side[rows, column][:, None]
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        yield low, high, rows

    def change(self, low: Array, high: Array, rows: Lines) -> Array:
        """By how much the formula grows between two numbers; NaN where it has no value."""
        with np.errstate(all="ignore"):
            return self.value(self.node, high, rows) - self.value(self.node, low, rows)

    def jumps(self, low: Array, high: Array, rows: Lines) -> bool:
        """Whether the formula jumps between two numbers."""
        change = np.abs(self.change(low, high, rows))
        return bool(np.any(change[np.isfinite(change)] > JUMP * self.largest))

    def bends(self, low: Array, high: Array, rows: Lines) -> bool:
        """Whether its slope changes between two numbers, or the formula jumps."""
        size = np.maximum(np.abs(low), NEAR)
        step = NEAR * size
        after = self.change(high, high + step, rows)
        before = self.change(low - step, low, rows)
        with np.errstate(all="ignore"):
            change = np.abs(after - before) / step * size
        return self.jumps(low, high, rows) or bool(
            np.any(change[np.isfinite(change)] > BEND * self.largest))


def _gaps(node: Node) -> Iterator[Node]:
    """What is zero where one of its pieces gives way to another."""
    for part in node.walk():
        if part.kind in ("sign", "abs"):
            yield part.parts[0]
        elif part.kind in ("min", "max"):
            for pair in itertools.combinations(part.parts, 2):
                yield Node("-", pair)
        elif part.kind in COMPARISONS.values():
            yield Node("-", part.parts)


def _drawn(rng: np.random.Generator, held: float, limits: tuple[float, float] | None) -> Array:
    """Values (TRIALS,) of a parameter in its range, or of a variable around zero."""
    if limits is not None:
        return np.asarray(rng.uniform(*limits, TRIALS))
    size = abs(held) or 10.0 ** rng.uniform(-3.0, 1.0, TRIALS)
    return np.asarray(size * rng.uniform(0.5, 1.5, TRIALS) * (
        1.0 if held > 0.0 else -1.0 if held < 0.0 else rng.choice([-1.0, 1.0], TRIALS)))
