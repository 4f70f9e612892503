"""An effect as a formula: what a user writes becomes an `Effect` like those of the library.

    name: cable
    force: "-k * max(x - x0, 0)"                    # N; or input: V, or reading: m
    state: {z: "v - abs(v) * z / d"}                # optional: time derivatives, from z = 0
    parameters: {k: {value: 0, unit: N/m, range: [0, 1e4]}, ...}

Variables: position x (m) and speed v (m/s) of the driven point, the command u that acts (V or A,
after dead time and limit), the current i (A; with a voltage drive and no coil_resistance the drive
in V), the time t (s) from the first sample. A force has all of them; an `input` is added to the
command and has u and t; a `reading` is added to the encoder's reading and has x and t.

The text is never run as Python (see `formula_text`). What the simulator compiles are the hooks
that every effect has: a linear force becomes part of the linear part, one of position and speed a
`force`, any other a `flow`; a constant force and dry friction are what they are.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal
from weakref import WeakValueDictionary

import numpy as np

from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import SMALL, STARTS, Effect, Parameter, Parameters, Prior, Values
from dfm_stage.model.formula_kinks import kinks_of, part_friction
from dfm_stage.model.formula_text import (
    CONSTANTS,
    FUNCTIONS,
    FormulaError,
    Node,
    degree,
    parse,
    shown,
    value,
)
from dfm_stage.model.formula_units import (
    PURE,
    Dimension,
    check,
    dimension,
    measure,
    scale,
    times_seconds,
)
from dfm_stage.model.parameter import BASE_BY_NAME

Kind = Literal["force", "input", "reading"]
KINDS: tuple[Kind, ...] = ("force", "input", "reading")
VARIABLES: dict[str, tuple[str, ...]] = {
    "force": ("x", "v", "u", "i", "t"), "input": ("u", "t"), "reading": ("x", "t")}
MOST_PARAMETERS, MOST_STATES = 12, 4
"""More cannot be estimated from a record; and the simulator iterates on all states together."""
MOST_STARTS = 60
"""Starting points of a search: each costs a simulation."""
MOST_TOGETHER = 3
"""Parameters among many that are looked through for those that scale a formula together."""
RELATIVE = (0.1, 0.3, 1.0, 3.0)
"""Starting values above zero, over the size that their unit has in the records."""
SMALLEST = 1e-6
"""A range that begins at zero is usual from this share of its end."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
_RESERVED = {"initial", "coupling", *FUNCTIONS, *CONSTANTS, *VARIABLES["force"]}


@dataclass(frozen=True)
class FormulaParameter:
    """A parameter of a formula; `unit` None is not checked, `range` None has no limits."""

    name: str
    value: float = field(compare=False)
    unit: str | None = None
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Formula:
    """A formula as it was written; `state` are names with their time derivatives.

    Two are equal that differ only in the values of their parameters.
    """

    name: str
    kind: Kind
    text: str
    parameters: tuple[FormulaParameter, ...]
    state: tuple[tuple[str, str], ...] = ()

    def effect(self) -> FormulaEffect:
        """The effect; the same one as long as somebody holds it.

        Raises
        ------
        FormulaError
            If the formula cannot be used: one line with the column.
        """
        key = (self, tuple(p.value for p in self.parameters))
        found = _BUILT.get(key)
        if found is None:
            found = _BUILT[key] = _build(self)
        return found

    def to_dict(self, values: Mapping[str, float]) -> dict[str, Any]:
        """The entry of model.yaml, with `values` of the parameters."""
        return {"name": self.name, self.kind: self.text,
                **({"state": dict(self.state)} if self.state else {}),
                "parameters": {p.name: {
                    "value": values[p.name], **({} if p.unit is None else {"unit": p.unit}),
                    **({} if p.range is None else {"range": list(p.range)})}
                    for p in self.parameters}}


_BUILT: WeakValueDictionary[Any, FormulaEffect] = WeakValueDictionary()


@dataclass(frozen=True)
class FormulaEffect(Effect):
    """The effect that a formula is; where a search begins follows from units and ranges."""

    formula: Formula = field(kw_only=True)
    tree: Node = field(kw_only=True, repr=False)
    smooth: Node | None = field(default=None, repr=False)
    units: Mapping[str, Dimension | None] = field(default_factory=dict, repr=False)

    def starts(self, at: Conditions) -> list[Parameters]:
        """A grid of what shapes the force, around the sizes in the records and inside the ranges;
        a force of SMALL times the actuator's."""
        shaping = [p for p in self.parameters if self.searched or p.name not in self.sizes]
        grids = [self._values(p, at) for p in shaping]
        while math.prod(map(len, grids)) > MOST_STARTS:
            longest = max(grids, key=len)
            del longest[1::2]
        found = [{**self.defaults, **dict(zip((p.name for p in shaping), values, strict=True))}
                 for values in itertools.product(*grids)]
        return found if self.searched else [
            start for each in found if (start := self._at_size(each, at)) is not None]

    @property
    def instant(self) -> bool:
        """As of any effect; one with kinks is no `force` for the simulator."""
        return self.smooth is not None and not self.states and not {
            "t", "u"} & self.smooth.names and (self.force or self.flow) is not None

    def felt(self, x: float, v: float, actuator: float, p: Values) -> float:
        """As of any effect; a formula may divide by zero, or overflow."""
        if self.smooth is None or not self.instant:
            return 0.0
        return float(value(self.smooth, {
            "x": x, "v": v, "i": actuator,
            **{q.name: own for q, own in zip(self.parameters, p, strict=True)}}))

    def _values(self, parameter: Parameter, at: Conditions) -> list[float]:
        low, high = parameter.low, parameter.high
        unit = self.units.get(parameter.name)
        size = None if unit in (None, PURE) else scale(unit, at)
        if size is not None:
            signs = (1.0,) if low >= 0.0 else (-1.0, 1.0)
            tried = [s * f * size for s in signs for f in RELATIVE] + [0.0] * (low < 0.0)
            tried = sorted(v for v in tried if low <= v <= high)
            if tried:
                return tried
        if math.isinf(low) or math.isinf(high):
            return [parameter.default or 1.0]
        if low > 0.0:
            return [float(v) for v in np.geomspace(low, high, STARTS + 2)[1:-1]]
        return [float(v) for v in np.linspace(low, high, STARTS + 2)[1:-1]]

    def _at_size(self, values: Parameters, at: Conditions) -> Parameters | None:
        """`values` with sizes that make a small force (or input, or reading); None where the
        formula is zero there."""
        unit = {**values, **{n: abs(self.parameter(n).default) or 1.0 for n in self.sizes}}
        name = {"force": "force", "input": "drive", "reading": "noise"}[self.formula.kind]
        size, wanted = self._largest(unit, at), SMALL * getattr(at, name)
        if self.formula.kind == "reading":
            wanted /= SMALL
        if not 0.0 < size < math.inf:
            return None
        sign = -1.0 if self.parameter(self.sizes[0]).high <= 0.0 else 1.0
        return {**unit, **{n: sign * unit[n] * wanted / size for n in self.sizes}}

    def _largest(self, values: Parameters, at: Conditions) -> float:
        """The largest value of the formula at sizes that occur in the records."""
        turns = np.linspace(0.0, 2.0 * math.pi, 40)
        wave, shifted = 1.5 * np.sin(turns), 1.5 * np.cos(turns)
        sizes = {"x": at.motion * wave, "v": at.speed * shifted, "u": at.drive * shifted,
                 "i": at.drive * shifted, "t": at.duration * turns / turns[-1]}
        for state, _ in self.formula.state:
            unit = self.units.get(state)
            sizes[state] = (1.0 if unit is None else scale(unit, at)) * wave
        found = np.abs(value(self.tree, {**sizes, **values}))
        return float(np.max(found, initial=0.0))


def formula_of(data: Mapping[str, Any]) -> Formula:
    """The formula in a mapping as a file has it; keys beside those of a formula are ignored.

    Raises
    ------
    FormulaError
        If an entry is missing or malformed.
    """
    kinds = [kind for kind in KINDS if data.get(kind) is not None]
    name = data.get("name")
    where = f"{name[:40] if isinstance(name, str) else shown(name)}: "
    if not isinstance(name, str) or not _NAME.fullmatch(name) \
            or name in {*_RESERVED, *BASE_BY_NAME}:
        raise FormulaError(f"name: {shown(name)} cannot be the name of a formula; take another "
                           "word of letters, digits and _")
    if len(kinds) != 1:
        raise FormulaError(f"{where}give exactly one of force (N), input (V) and reading (m)")
    parameters, state = data.get("parameters") or {}, data.get("state") or {}
    if not isinstance(parameters, Mapping) or not isinstance(state, Mapping):
        raise FormulaError(f"{where}parameters and state are mappings of names")
    if len(parameters) > MOST_PARAMETERS or len(state) > MOST_STATES:
        raise FormulaError(f"{where}more than {MOST_PARAMETERS} parameters or "
                           f"{MOST_STATES} states")
    if not parameters:
        raise FormulaError(f"{where}a formula needs a parameter, so that it can be estimated")
    for own in (*parameters, *state):
        if not isinstance(own, str) or not _NAME.fullmatch(own) or own in _RESERVED \
                or (own in parameters and own in state):
            raise FormulaError(f"{where}{shown(own)} cannot be the name of a parameter or state; "
                               "it must be another word than variables and functions")
    return Formula(name, kinds[0], _text(data[kinds[0]], f"{where}{kinds[0]}: "),
                   tuple(_parameter(p, given, where) for p, given in parameters.items()),
                   tuple((n, _text(rate, f"{where}state {n}: ")) for n, rate in state.items()))


def _text(given: object, where: str) -> str:
    """The text of a formula; YAML reads one of a single number as that number."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return repr(given)
    if not isinstance(given, str):
        raise FormulaError(f"{where}a formula is a text, not {shown(given)}")
    return str(given)


def _parameter(name: str, given: Any, where: str) -> FormulaParameter:
    where = f"{where}parameter {name}: "
    if not isinstance(given, Mapping) or not {"value"} <= {*given} <= {"value", "unit", "range"}:
        raise FormulaError(f"{where}give {{value: ..., unit: ..., range: [..., ...]}}")
    unit, limits = given.get("unit"), given.get("range")
    if limits is not None:
        if not isinstance(limits, (list, tuple)) or len(limits) != 2:
            raise FormulaError(f"{where}range is [lowest, highest]")
        limits = _finite(limits[0], where), _finite(limits[1], where)
        if not limits[0] < limits[1]:
            raise FormulaError(f"{where}range is [lowest, highest]")
    found = _finite(given["value"], where)
    if limits is not None and not limits[0] <= found <= limits[1]:
        raise FormulaError(f"{where}value {found:g} is outside its range "
                           f"[{limits[0]:g}, {limits[1]:g}]")
    if unit is not None and not isinstance(unit, (str, int)):
        raise FormulaError(f"{where}unit is a text such as N/m, not {shown(unit)}")
    return FormulaParameter(name, found, None if unit is None else str(unit), limits)


def _finite(given: object, where: str) -> float:
    try:
        found = math.nan if isinstance(given, bool) else float(given)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found):
        raise FormulaError(f"{where}{shown(given)} is no finite number")
    return found


def _build(formula: Formula) -> FormulaEffect:
    from dfm_stage.model.formula_code import hooks_of  # needs numba, which takes a second

    tree, states, units = _trees(formula)
    given = {p.name: p for p in formula.parameters}
    ranges = {n: p.range or (-math.inf, math.inf) for n, p in given.items()}
    spread = {n: (p.value, p.range) for n, p in given.items()}
    with _about(formula, formula.kind):
        rest, rubs = part_friction(tree, spread) if formula.kind == "force" else (tree, "")
        kinks = [] if rest is None or formula.kind != "force" else kinks_of(
            (rest, *states.values()), spread, list(states))
    if rubs:
        if ranges[rubs][0] < 0.0 and given[rubs].range is not None:
            raise FormulaError(f"{formula.name}: {rubs} is a friction; its range cannot go below "
                               "zero")
        ranges[rubs] = max(ranges[rubs][0], 0.0), ranges[rubs][1]
    constant = not rubs and not states and rest is not None and rest.kind == "name" \
        and rest.name in given
    first = rubs or (rest.name if constant and rest is not None else "")
    order = sorted(given, key=lambda n: n != first)         # what is added to a slot comes first
    sizes = _sizes(tree, states, order)
    return FormulaEffect(
        name=formula.name, meaning="a formula", equation=f"{formula.kind} = {formula.text}"
        + "".join(f";  {n}' = {rate}" for n, rate in formula.state),
        source="a formula of the user's",
        parameters=tuple(Parameter(n, given[n].value, given[n].unit or "", "", *ranges[n])
                         for n in order),
        priors={n: _prior(*limits) for n, limits in ranges.items()
                if all(map(math.isfinite, limits))},
        side="sensor" if formula.kind == "reading" else "actuator"
        if formula.kind == "input" or {"u", "i"} & tree.names else "mechanical",
        parity="both", memory=bool(states), shown_by="motion on which the formula changes",
        adds_to="dry_friction" if rubs else "constant_force" if constant else None,
        states=tuple(f".{n}" for n in states), size=sizes, searched=not sizes,
        **({} if constant or rest is None
           else hooks_of(formula.kind, rest, states, order, kinks)),
        formula=formula, tree=tree, smooth=rest, units=units)


def _trees(formula: Formula) -> tuple[Node, dict[str, Node], dict[str, Dimension | None]]:
    """The formula and the rates of its states, parsed and measured."""
    if formula.state and formula.kind != "force":
        raise FormulaError(f"{formula.name}: state: only a force has states of its own")
    own = [p.name for p in formula.parameters]
    known = [*VARIABLES[formula.kind], *own, *(n for n, _ in formula.state)]
    tree = _parsed(formula, formula.kind, formula.text, known)
    states = {n: _parsed(formula, f"state {n}", rate, known) for n, rate in formula.state}
    used = frozenset().union(tree.names, *(s.names for s in states.values()))
    for name in (*own, *states):
        if name not in used:
            raise FormulaError(f"{formula.name}: {name} is not used in the formula")
    units = _units(formula)
    reasons: list[FormulaError] = []
    for drive in ("V", "A"):            # whether u is a voltage is known to the model alone
        measured = {**units, "u": dimension(drive), "i": dimension("A")}
        try:
            return tree, states, _measured(formula, tree, states, measured)
        except FormulaError as error:
            reasons.append(error)
    raise reasons[0]


def _measured(formula: Formula, tree: Node, states: Mapping[str, Node],
              units: dict[str, Dimension | None]) -> dict[str, Dimension | None]:
    """The units of all names; those of states follow from their rates."""
    units = {**units, **dict.fromkeys(states)}
    if formula.kind == "force":
        units["i"] = None                   # V where there is no coil_resistance
    for name, rate in states.items():
        with _about(formula, f"state {name}"):
            units[name] = times_seconds(measure(rate, units))
    for name, rate in states.items():
        with _about(formula, f"state {name}"):
            check(rate, units, times_seconds(units[name], -1))
    with _about(formula, formula.kind):
        check(tree, units, {"force": dimension("N"), "input": units["u"],
                            "reading": dimension("m")}[formula.kind])
    return units


def _units(formula: Formula) -> dict[str, Dimension | None]:
    """Those of the variables and parameters, as far as they are given."""
    units: dict[str, Dimension | None] = {
        "x": dimension("m"), "v": dimension("m/s"), "t": dimension("s")}
    for parameter in formula.parameters:
        with _about(formula, f"parameter {parameter.name}"):
            given = parameter.unit
            units[parameter.name] = None if given is None or "V or A" in given \
                else dimension(given)
    return units


def _parsed(formula: Formula, part: str, text: str, known: Sequence[str]) -> Node:
    with _about(formula, part):
        return parse(text, known)


@contextlib.contextmanager
def _about(formula: Formula, part: str) -> Iterator[None]:
    """Begin what is said of a part with the names of formula and part."""
    try:
        yield
    except FormulaError as error:
        raise FormulaError(f"{formula.name}: {part}: {error}") from None


def _sizes(tree: Node, states: Mapping[str, Node], names: Sequence[str]) -> tuple[str, ...]:
    """The fewest parameters that the formula is proportional to; empty where there are none."""
    for count in sorted({*range(1, MOST_TOGETHER + 1), len(names)}):
        for chosen in itertools.combinations(names, count):
            if degree(tree, chosen) == 1.0 and all(
                    degree(rate, chosen) == 0.0 or not {*chosen} & rate.names
                    for rate in states.values()):
                return tuple(chosen)
    return ()


def _prior(low: float, high: float) -> Prior:
    """The usual range of a parameter: where it may be."""
    if low > 0.0:
        return Prior(low, high)
    return Prior(SMALLEST * high, high) if low == 0.0 else Prior(low, high, log=False)
