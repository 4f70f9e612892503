"""The terms of which formulas for a missing force are made.

Every term is one force shape with one size. Where it bends, how wide it is, or how long a period
is, are its shape parameters; a search begins them at multiples of the standard deviations of
position and speed, so that the dictionary has no units. The families: powers and their products
(springs, drags), hinges (what touches, pulls or slips beyond a point), saturations and bumps
(magnets, brakes), sines over position (cogging), directions (friction, also where it varies with
position), and the drive times position (an actuator whose gain varies).
Sources: Brunton, Proctor and Kutz, PNAS 113 (2016) 3932 (a sparse choice from a dictionary);
Friedman, Annals of Statistics 19 (1991) 1 (hinges).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.formula import Formula, formula_of
from dfm_stage.model.formula_text import Node, parse, value

Over = Literal["x", "v", "1"]
DRY = "sign(v)"
"""The term that sticks, as `coulomb_friction` does."""


@dataclass(frozen=True)
class Shape:
    """A parameter that shapes a term: where a search begins it and its range, as multiples of the
    standard deviation of what it is `over`."""

    name: str
    over: Over
    begin: tuple[float, ...]
    low: float
    high: float

    @property
    def unit(self) -> str:
        """SI."""
        return {"x": "m", "v": "m/s", "1": "1"}[self.over]


AT_X = Shape("x0", "x", (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5), -4.0, 4.0)
SEVERAL_X = Shape("x0", "x", (-1.2, -0.6, 0.0, 0.6, 1.2), -4.0, 4.0)
WIDE_X = Shape("d", "x", (0.3, 0.8), 0.05, 10.0)
AT_V = Shape("v0", "v", (-1.0, -0.5, 0.0, 0.5, 1.0), -4.0, 4.0)
WIDE_V = Shape("s", "v", (0.1, 0.3, 0.8), 0.05, 10.0)     # steeper ones are sign(v)
SLIP = Shape("s", "v", (0.05,), 0.02, 0.3)
PERIOD = Shape("p", "x", (0.2, 0.3, 0.4, 0.55, 0.75, 1.0, 1.3, 1.7, 2.3, 3.0, 4.0), 0.05, 8.0)
PHASE = Shape("q", "1", tuple(k * math.pi / 4.0 for k in range(4)), -2.0 * math.pi,
              2.0 * math.pi)


@dataclass(frozen=True)
class Term:
    """A force -size times `text`, of x (m), v (m/s), i (A or V) and the `shapes`."""

    text: str
    size: str
    unit: str
    shapes: tuple[Shape, ...] = ()

    @cached_property
    def tree(self) -> Node:
        """The text, parsed."""
        return parse(self.text, ["x", "v", "i", *(s.name for s in self.shapes)])

    def begins(self, scales: Mapping[Over, float]) -> list[tuple[float, ...]]:
        """Values of the shapes to begin with, SI."""
        return list(itertools.product(*(
            [scales[s.over] * b for b in s.begin] for s in self.shapes)))

    def values(self, signals: Mapping[str, Any], shapes: Sequence[float]) -> Array:
        """The term (N,) along a motion; its sign(v) is `direction`, a mean over noise."""
        if self.text == DRY:
            return np.asarray(signals["direction"])
        named = {s.name: v for s, v in zip(self.shapes, shapes, strict=True)}
        return np.asarray(value(self.tree, {**signals, **named}))


TERMS: tuple[Term, ...] = (
    Term("x**2", "k", "N/m^2"), Term("x**3", "k", "N/m^3"), Term("x**4", "k", "N/m^4"),
    Term("x**5", "k", "N/m^5"), Term("x * abs(x)", "k", "N/m^2"),
    Term("max(x - x0, 0)", "k", "N/m", (AT_X,)),
    Term("tanh((x - x0) / d)", "f", "N", (SEVERAL_X, WIDE_X)),
    Term("exp(-((x - x0) / d)**2)", "f", "N", (SEVERAL_X, WIDE_X)),
    Term("sin(2 * pi * x / p + q)", "f", "N", (PERIOD, PHASE)),
    Term("v**2", "c", "N s^2/m^2"), Term("v**3", "c", "N s^3/m^3"),
    Term("v * abs(v)", "c", "N s^2/m^2"),
    Term("max(v - v0, 0)", "c", "N s/m", (AT_V,)),
    Term("tanh(v / s)", "f", "N", (WIDE_V,)),
    Term("v / (1 + (v / s)**2)", "c", "N s/m", (WIDE_V,)),
    Term(DRY, "f", "N"),
    Term("x * v", "c", "N s/m^2"), Term("abs(x) * v", "c", "N s/m^2"),
    Term("x**2 * v", "c", "N s/m^3"), Term("x * v**2", "c", "N s^2/m^3"),
    Term("x * tanh(v / s)", "f", "N/m", (SLIP,)),
    Term("abs(x) * tanh(v / s)", "f", "N/m", (SLIP,)),
    Term("x**2 * tanh(v / s)", "f", "N/m^2", (SLIP,)),
    Term("x * i", "g", ""), Term("x**2 * i", "g", ""), Term("i * abs(i)", "g", ""))
"""All terms. What is linear in x, v and i alone is the stage's own."""


@dataclass(frozen=True)
class Part:
    """A term with its size and the values of its shapes."""

    term: Term
    size: float
    shapes: tuple[float, ...] = ()


def formula_from(name: str, parts: Sequence[Part], scales: Mapping[Over, float]) -> Formula:
    """The parts as a formula, with ranges about their values."""
    texts, parameters = [], {}
    wanted = [letter for p in parts
              for letter in (p.term.size, *(s.name for s in p.term.shapes))]
    used: dict[str, int] = {}
    for part in parts:
        text = part.term.text
        for shape, own in zip(part.term.shapes, part.shapes, strict=True):
            called = _called(shape.name, wanted, used)
            text = re.sub(rf"\b{shape.name}\b", called, text)
            low, high = shape.low * scales[shape.over], shape.high * scales[shape.over]
            parameters[called] = {"value": _digits(own), "unit": shape.unit, "range": [
                min(_digits(low, 3), _digits(own)), max(_digits(high, 3), _digits(own))]}
        size = _called(part.term.size, wanted, used)
        most = 10.0 ** math.ceil(math.log10(max(10.0 * abs(part.size), 1e-300)))
        parameters[size] = {
            "value": _digits(part.size), **({"unit": part.term.unit} if part.term.unit else {}),
            "range": [0.0 if part.term.text == DRY else -most, most]}
        texts.append(f"- {size} * {text}")
    return formula_of({"name": name, "force": " ".join(texts).replace("- ", "-", 1),
                       "parameters": dict(sorted(parameters.items(), key=lambda p: p[0]))})


def _called(letter: str, wanted: Sequence[str], used: dict[str, int]) -> str:
    """The letter, numbered where it is needed more than once."""
    if wanted.count(letter) == 1:
        return letter
    used[letter] = used.get(letter, 0) + 1
    return f"{letter}{used[letter]}" if letter[-1].isalpha() else f"{letter}_{used[letter]}"


def _digits(number: float, count: int = 7) -> float:
    return float(f"{number:.{count}g}")
