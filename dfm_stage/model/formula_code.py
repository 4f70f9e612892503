"""Functions made from the checked tree of a formula, for the simulator to compile."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from numba.extending import register_jitable

from dfm_stage.model.formula_text import Node


@register_jitable(error_model="numpy")
def _sign(number: float) -> float:
    return 1.0 if number > 0.0 else -1.0 if number < 0.0 else 0.0


@register_jitable(error_model="numpy")
def _to_the(base: float, power: int) -> float:
    product = 1.0
    for _ in range(abs(power)):
        product *= base
    return product if power >= 0 else 1.0 / product


_CALLS: dict[str, Callable[..., Any]] = {
    "abs": abs, "min": min, "max": max, "sign": _sign, "sqrt": math.sqrt, "exp": math.exp,
    "log": math.log, "sin": math.sin, "cos": math.cos, "tan": math.tan, "atan": math.atan,
    "tanh": math.tanh, "power": math.pow, "whole": _to_the}
"""Function -> what numba compiles for it."""
LARGEST_POWER = 16
"""Whole powers up to this one are products."""


def source(node: Node, place: Mapping[str, str]) -> str:
    """Python text of a tree; `place` tells where the value of each name stands.

    Only operators and functions of the whitelist can come out.
    """
    if node.kind == "number":
        return repr(node.number) if node.number >= 0.0 else f"({node.number!r})"
    if node.kind == "name":
        return place[node.name]
    inner = [source(part, place) for part in node.parts]
    if node.kind == "negative":
        return f"(-{inner[0]})"
    if node.kind == "where":
        return f"({inner[1]} if {inner[0]} else {inner[2]})"
    if node.kind == "**":
        power = node.parts[1]
        if power.kind == "number" and power.number == round(power.number) \
                and abs(power.number) <= LARGEST_POWER:
            return _whole(node.parts[0].kind == "name", inner[0], round(power.number))
        return f"power({inner[0]}, {inner[1]})"
    if node.kind in _CALLS:
        return f"{node.kind}({', '.join(inner)})"
    return f"({inner[0]} {node.kind} {inner[1]})"


def _whole(short: bool, base: str, power: int) -> str:
    """A whole power; of what is `short` written out, which is fastest."""
    if not short:
        return f"whole({base}, {power})"
    product = " * ".join([base] * abs(power)) or "1.0"
    return f"({product})" if power >= 0 else f"(1.0 / ({product}))"


def function(name: str, arguments: Sequence[str], lines: Sequence[str],
             result: str) -> Callable[..., Any]:
    """A function of `source` texts, in a namespace that has nothing but their functions."""
    body = "".join(f"    {line}\n" for line in (*lines, f"return {result}"))
    space: dict[str, Any] = {"__name__": __name__, "__builtins__": {"range": range}, **_CALLS}
    exec(compile(f"def {name}({', '.join(arguments)}):\n{body}",  # noqa: S102 of our own text
                 f"<formula {name}>", "exec"), space)
    made: Callable[..., Any] = space[name]
    return made


def hooks_of(kind: str, tree: Node, states: Mapping[str, Node], parameters: Sequence[str],
             kinks: Sequence[Node]) -> dict[str, Any]:
    """The hooks of an effect that is a formula, as fields of `Effect`; `kinks` are zero where the
    force has one."""
    place = {n: n for n in ("x", "v", "u", "i", "t")}
    place |= {n: f"p[{k}]" for k, n in enumerate(parameters)}
    if kind == "input":
        return {"added": function("added", ("u", "t", "p"), (), source(tree, place))}
    if kind == "reading":
        return {"sense": function("sense", ("x", "t", "other", "p"), (), source(tree, place))}
    moving = ("x", "v", "u", *states)
    if all(_power_in(each, moving) == 1 for each in (tree, *states.values())):
        return {"stamp": _stamp(tree, states, place), "stage": "mechanics"}
    if not states and not kinks and not {"t", "u"} & tree.names:
        return {"force": function("force", ("x", "v", "i", "p"), (), source(tree, place)),
                "by_current": "i" in tree.names}
    place |= {n: f"z[{k}]" for k, n in enumerate(states)}
    rates = [f"rate[{k}] = {source(each, place)}" for k, each in enumerate(states.values())]
    flow = function("flow", ("t", "x", "v", "u", "i", "z", "rate", "p"), rates,
                    source(tree, place))
    hooks: dict[str, Any] = {"flow": flow, "by_current": "i" in tree.names}
    if kinks:
        sides = [f"({2.0**k} if {source(each, place)} > 0.0 else 0.0)"
                 for k, each in enumerate(kinks)]
        hooks["side_of_kinks"] = function("side", ("t", "x", "v", "u", "i", "z", "p"), (),
                                          " + ".join(sides))
    return hooks


def _stamp(tree: Node, states: Mapping[str, Node], place: Mapping[str, str]) -> Callable[..., Any]:
    """The hook of a formula that is linear in the motion: its coefficients are its values where
    one of the variables is one and the others are zero."""
    variables = ("x", "v", "u", *states)

    def coefficient(node: Node, of: str) -> str:
        return source(node, {**place, **{n: "1.0" if n == of else "0.0" for n in variables}})

    lines = ["n = a.shape[0]"]
    for own, each in enumerate((None, *states.values())):
        if each is not None:
            motion = (f"{coefficient(each, 'x')} * rows[0, j] + "
                      f"{coefficient(each, 'v')} * rows[1, j]")
            lines += [f"for j in range(n + 1): a[first + {own - 1}, j] += {motion}",
                      f"a[first + {own - 1}, n] += {coefficient(each, 'u')}"]
            lines += [f"a[first + {own - 1}, first + {k}] += {coefficient(each, n)}"
                      for k, n in enumerate(states)]
    motion = f"{coefficient(tree, 'x')} * rows[0, j] + {coefficient(tree, 'v')} * rows[1, j]"
    force = [f"for j in range(n + 1): a[i, j] += rows[3, i] * ({motion})",
             f"a[i, n] += rows[3, i] * {coefficient(tree, 'u')}",
             *(f"a[i, first + {k}] += rows[3, i] * {coefficient(tree, n)}"
               for k, n in enumerate(states))]
    lines += ["for i in range(n):", *(f"    {line}" for line in force)]
    return function("stamp", ("a", "rows", "first", "p"), lines, "None")


def _power_in(node: Node, moving: Sequence[str]) -> int | None:
    """0 where none of the names `moving` is in it, 1 where it is linear in them (and zero at
    zero), else None."""
    if not node.names & {*moving, "t", "i"}:
        return 0
    if node.kind == "name":
        return 1 if node.name in moving else None
    powers = [_power_in(part, moving) for part in node.parts]
    if node.kind == "negative":
        return powers[0]
    if node.kind in ("+", "-"):
        return 1 if powers == [1, 1] else None
    if node.kind == "*":
        return 1 if sorted(p if p is not None else 2 for p in powers) == [0, 1] else None
    return 1 if node.kind == "/" and powers == [1, 0] else None
