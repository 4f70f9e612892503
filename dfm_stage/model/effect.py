"""What an effect is: its physics as data, and the compiled pieces the simulator is built from.

Each module of `dfm_stage.model.effects` holds one `EFFECT`. Nothing else has to be edited to add
an effect: the registry finds it, the kernel compiles its hooks in, validation, fitting and the
documentation read its data.

Hooks are plain functions of floats and arrays that numba can compile. `p` is the tuple of the
effect's own parameters, in the order of `parameters`; `x` (m) and `v` (m/s) are position and
velocity of the driven point, `actuator` (N) the force of an actuator of constant force constant.

`force(x, v, actuator, p) -> N`
    A smooth force on the driven point. Where it is `by_current`, `actuator` is the current (A; V
    with a voltage drive and no coil_resistance).
`friction(x, v, actuator, p) -> N`
    The size of a dry friction that varies, never negative. It acts against the motion, and holds
    the point at rest up to what it is there.
`advance(z, dx, v0, v1, p) -> z` with `bristle_force(z, v, p) -> N`
    A force with memory: the state `z` after the point moved by `dx` without reversing, while its
    velocity went from `v0` to `v1`; and the force that goes with it.
`flow(t, x, v, u, i, z, rate, p) -> N` with `states`
    A force that may depend on the time t (s), the command u that acts (V or A), the current i (A)
    and states z of its own, whose time derivatives it stores in `rate`. With
    `side_of_kinks(t, x, v, u, i, z, p)`, a number that is another one on each side of a kink of
    the force, steps end at the kinks.
`stamp(a, rows, first, p)` with `states`
    A linear part whose states begin at index `first`, see `dfm_stage.model.kernel.setup`;
    `start(state, first, p)` gives them initial values.
`added(u, t, p) -> V or A`
    What is added to the command u, given for time t (s), after dead time and limit.
`command(u, z, period, p) -> V or A`
    What the actuator makes of a command u that lasts a period (s), before dead time and limit. `z`
    are `registers` numbers that it keeps from one command to the next, zero at first. Fits give
    it each command as `substeps` equal ones, for what it does within a sample.
`sense(x, t, other, p) -> m`
    What is added to the encoder's reading at time `t` (s); `other` (m) is the position of the
    neighbouring axis.
`encode(reading, dither, p) -> m`
    The mean of the rounded reading when noise of RMS `dither` is added before rounding.
`other_force(p) -> N/m`
    Force per metre of the neighbouring axis.
`adds_to`
    The base parameter that the first parameter is simply added to, or `constant_force` (N),
    `dry_friction` (N), or `command_limit` (V or A), where the smallest counts.

Nothing outside an effect knows its name. Names of its own begin with a dot: the state `.force` of
an effect `shaker` is `shaker.force`, its parameter `.amplitude` is `shaker.amplitude`, and `.`
alone is `shaker`.
"""

from __future__ import annotations

import dis
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.parameter import BASE_BY_NAME, Parameter

__all__ = [
    "PHASOR", "SMALL", "Array", "Conditions", "Effect", "Equivalence", "Parameter", "Parameters",
    "Parity", "Prior", "Reparametrisation", "Side", "Values", "Wave", "reads",
]

Parameters = dict[str, float]

Values = tuple[float, ...]
"""The values of an effect's parameters, as its hooks get them."""
Side = Literal["mechanical", "actuator", "sensor"]
Parity = Literal["linear", "even", "odd", "both", "none"]


@dataclass(frozen=True)
class Prior:
    """Where a parameter usually lies on such stages; `log` when it spans decades."""

    low: float
    high: float
    log: bool = True

    @property
    def typical(self) -> float:
        """The middle of its range; the larger end where it may be zero or negative."""
        return math.sqrt(self.low * self.high) if self.log else max(abs(self.low), abs(self.high))


@dataclass(frozen=True)
class Wave:
    """An effect that is a sine over time or over position: the parameter that is its frequency
    (Hz) or its period (m), and the one that is its phase (rad)."""

    parameter: str
    over: Literal["time", "position"]
    phase: str = "phase"


@dataclass(frozen=True)
class Equivalence:
    """Members that cannot be told apart on the data described by `on`, and what would part them.

    A member is an effect's name, or the name of a base parameter (then the answer is `retune`).
    """

    members: tuple[str, ...]
    on: str
    split_by: str


@dataclass(frozen=True)
class Reparametrisation:
    """Coordinates in which a fit is well conditioned.

    `names` are the free parameters it replaces: base parameters, or with a dot in front the
    effect's own. `forward` and `backward` map arrays of their values, same order, to the fitted
    coordinates `fitted`, which are named alike.
    """

    names: tuple[str, ...]
    fitted: tuple[str, ...]
    forward: Callable[[Any], Any]
    backward: Callable[[Any], Any]


def _to_phasor(values: Array) -> Array:
    amplitude, phase = values
    return np.array([amplitude * np.cos(phase), amplitude * np.sin(phase)])


def _from_phasor(fitted: Array) -> Array:
    in_phase, quadrature = fitted
    return np.array([np.hypot(in_phase, quadrature), np.arctan2(quadrature, in_phase)])


PHASOR = Reparametrisation((".amplitude", ".phase"), (".in_phase", ".quadrature"), _to_phasor,
                           _from_phasor)
"""The coordinates of a sine: its phase means nothing while the amplitude is near zero."""


@cache
def reads(hook: Callable[..., Any] | None, argument: int) -> bool:
    """Whether a hook makes use of its argument number `argument`."""
    if hook is None:
        return False
    code = getattr(hook, "py_func", hook).__code__
    name = code.co_varnames[argument]
    return name in code.co_cellvars or any(
        step.opname.startswith("LOAD_FAST") and name in np.atleast_1d(step.argval)
        for step in dis.get_instructions(code))


@dataclass(frozen=True)
class Effect:
    """One physical effect; see the module docstring for the hooks.

    Parameters named in `optional` take their default where a model leaves them out; the others
    must be given.
    """

    name: str
    meaning: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    priors: Mapping[str, Prior]
    side: Side
    parity: Parity
    memory: bool
    shown_by: str
    optional: tuple[str, ...] = ()
    classes: tuple[Equivalence, ...] = ()
    fit: Reparametrisation | None = None
    replaces: tuple[str, Callable[[float, Mapping[str, float]], Parameters]] | None = None
    """A base parameter that may be at its lower limit beside the effect, because a linear model
    takes one for the other; and a function of its value and of the effect's parameters that gives
    those of the effect that make up for it."""
    adds_to: str | None = None
    states: tuple[str, ...] = ()
    stage: Literal["modes", "amplifier", "mechanics", "sensor"] = "mechanics"
    registers: int = 0
    substeps: int = 1
    force: Callable[..., float] | None = field(default=None, repr=False)
    friction: Callable[..., float] | None = field(default=None, repr=False)
    advance: Callable[..., float] | None = field(default=None, repr=False)
    bristle_force: Callable[..., float] | None = field(default=None, repr=False)
    by_current: bool = False
    flow: Callable[..., float] | None = field(default=None, repr=False)
    side_of_kinks: Callable[..., float] | None = field(default=None, repr=False)
    added: Callable[..., float] | None = field(default=None, repr=False)
    command: Callable[..., float] | None = field(default=None, repr=False)
    stamp: Callable[..., None] | None = field(default=None, repr=False)
    start: Callable[..., None] | None = field(default=None, repr=False)
    sense: Callable[..., float] | None = field(default=None, repr=False)
    encode: Callable[..., float] | None = field(default=None, repr=False)
    other_force: Callable[..., float] | None = field(default=None, repr=False)
    size: tuple[str, ...] = ()
    """Parameters that grow with the size of the effect; by default the first one."""
    begins: Mapping[str, tuple[str, tuple[float, ...]]] = field(default_factory=dict)
    """Parameter -> where a search begins: a quantity of `Conditions`, and factors of it. Where
    the quantity has several values, each counts."""
    wave: Wave | None = None
    searched: bool = False
    """The response is linear in no parameter: the screen tries the starting values as they are."""
    per_run: tuple[str, ...] = ()
    """Fitted coordinates, with a dot in front, that differ from run to run."""
    freed_last: Mapping[str, float | None] = field(default_factory=dict)
    """Parameters that are freed once the others have been fitted, and the value at which they
    begin then; None for where they are."""
    refinements: tuple[str, ...] = ()
    """Parameters that stay at their default, and are no parameter of a fit, unless the model has
    another value or freeing them pays as a further effect must."""
    by_input: tuple[str, ...] = ()
    """Parameters that only an input shows. In a free motion the effect's states begin at unknown
    values: more of smaller states is the same reading."""
    distance: str = ""
    """The fitted coordinate that is the distance (m) after a reversal within which the force
    changes. Far below the noise it cannot be told from dry friction, and is slow to simulate."""
    late: Literal["lag", "delay", "coil"] | None = None
    """How the first parameter makes the force late: a first-order lag or a dead time in s, or an
    inductance in H. All act alike to first order."""
    retuned_by: str = ""
    """The base parameter of whose kind the effect is a second one. Beside it a wrong number is
    likelier, and the effect is looked for among the uncommon ones only."""
    twins: Mapping[str, Callable[[Mapping[str, float]], Parameters]] = field(default_factory=dict)
    """Effects that are the same motion in a limit, with their parameters there from ours: a
    linear screen seldom leads from one to the other."""
    brakes: int | None = None
    """The power of the speed that, times the first parameter, is its force against the motion;
    None where it is no such force."""
    gives_way_to: tuple[str, ...] = ()
    """Effects that many machines have, where few have this one. Where held-out blocks do not part
    it from one of them, that one is told without it."""
    doubt: Callable[[Mapping[str, float]], str | None] | None = None
    """Why values (SI, of a stage that moves in m) are none that a machine has, in a few words;
    None where they may be."""

    @property
    def defaults(self) -> dict[str, float]:
        """Name -> default value of each parameter."""
        return {p.name: p.default for p in self.parameters}

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of all states: those of the linear part, or that of a force with memory."""
        return tuple(map(self.address, self.states if self.advance is None else (".",)))

    @property
    def coordinates(self) -> Reparametrisation | None:
        """`fit` with the addresses as a model knows them."""
        return self.fit and replace(self.fit, names=tuple(map(self.address, self.fit.names)),
                                    fitted=tuple(map(self.address, self.fit.fitted)))

    @property
    def couples(self) -> bool:
        """Whether the motion of the neighbouring axis counts."""
        return self.other_force is not None or reads(self.sense, 2)

    def address(self, name: str) -> str:
        """The full form of a name that may begin with a dot."""
        return f"{self.name}{name.rstrip('.')}" if name.startswith(".") else name

    def parameter(self, name: str) -> Parameter:
        """The parameter called `name`; KeyError if there is none."""
        return {parameter.name: parameter for parameter in self.parameters}[name]

    # -- what fitting, screening and naming need to know ----------------------------------------

    @property
    def curves(self) -> bool:
        """Whether it is a force that makes the motion nonlinear."""
        return self.adds_to == "dry_friction" or any(
            hook is not None for hook in (self.force, self.friction, self.advance, self.flow))

    @property
    def on_the_clock(self) -> bool:
        """Whether the motion depends on the time itself, so that none under it is periodic."""
        return reads(self.flow, 0) or reads(self.added, 1)

    @property
    def rounds(self) -> bool:
        """Whether it rounds the reading: a fit's criterion has steps in its parameters then."""
        return self.encode is not None

    @property
    def frequency(self) -> str | None:
        """The parameter (Hz) of a vibration of the effect's own; None where it has none."""
        return self.wave.parameter if self.wave is not None and self.wave.over == "time" else None

    @property
    def sizes(self) -> tuple[str, ...]:
        """Parameters that grow with the size of the effect."""
        return self.size or (self.parameters[0].name,)

    @property
    def one_sided(self) -> bool:
        """Whether the size cannot be negative."""
        return self.parameter(self.sizes[0]).low >= 0.0

    def fittable(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Parameters that a fit may free where they have `values`; those of a rounding are found
        by search."""
        return () if self.rounds else self.told(values)

    def told(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Parameters that say something where they have `values`."""
        lost = self.without_meaning(values)
        return tuple(n for n in self.needed(values) if n not in lost)

    def needed(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """All parameters but the refinements that `values` do not make use of."""
        return tuple(p.name for p in self.parameters
                     if p.name not in self.refinements or values[p.name] != p.default)

    def without_meaning(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Parameters that change nothing near `values`, nor at their defaults beside the others,
        because a term is off."""
        return ()

    @property
    def wrong_number_of(self) -> str:
        """The base parameter whose wrong value does the same; empty if there is none."""
        return self.retuned_by or (self.adds_to if self.adds_to in BASE_BY_NAME else "") or ""

    def hidden_because(self, at: Conditions) -> str | None:
        """Why the runs cannot show the effect, in words; None where they can."""
        return None

    def starts(self, at: Conditions) -> list[Parameters]:
        """Parameters at which a search may begin, at a size small enough to be linear in.

        By default those of `begins`; without it a force of SMALL times the actuator's for the
        sizes, and a grid over the usual range of what shapes the response.
        """
        if self.begins:
            grids = [[float(value) * factor for value in np.atleast_1d(getattr(at, quantity))
                      for factor in factors] for quantity, factors in self.begins.values()]
            return [{**self.defaults, **dict(zip(self.begins, values, strict=True))}
                    for values in itertools.product(*grids)]
        shaping = [p.name for p in self.parameters
                   if p.name not in (*self.sizes, *self.optional) and p.name in self.priors]
        shared = {**self.defaults, **{n: self.priors[n].typical for n in self.sizes
                                      if n in self.priors}}
        grids = [_grid(self.priors[n]) for n in shaping]
        return [self._small({**shared, **dict(zip(shaping, values, strict=True))}, at)
                for values in itertools.product(*grids)]

    def _small(self, values: Parameters, at: Conditions) -> Parameters:
        """`values` with the sizes scaled to a small force, where that can be told."""
        wanted, first = SMALL * at.force, self.sizes[0]
        if self.parameter(first).unit == "N":
            return {**values, first: wanted}
        if self.force is None:
            return {**values, **{n: SMALL * values[n] for n in self.sizes}}
        unit = tuple(1.0 if p.name in self.sizes else values[p.name] for p in self.parameters)
        felt = abs(self.felt(at.motion, at.speed, at.force, unit))
        return {**values, **dict.fromkeys(self.sizes, wanted / felt if felt else 0.0)}

    @property
    def instant(self) -> bool:
        """Whether it is a force that `felt` gives: one of position, speed and actuator alone."""
        return self.force is not None

    def felt(self, x: float, v: float, actuator: float, p: Values) -> float:
        """The smooth force, N, as a plain number; NaN or infinite where it has none."""
        return 0.0 if self.force is None else float(self.force(x, v, actuator, p))

    def scaled(self, parameters: Parameters, factor: float) -> Parameters:
        """`parameters` at `factor` times the size."""
        if self.searched:
            return dict(parameters)
        return {n: v * factor if n in self.sizes else v for n, v in parameters.items()}

    def is_linear(self, values: Mapping[str, float]) -> bool:
        """Whether the force is proportional to the size up to that of `values`."""
        return True

    def directions(self, parameters: Parameters, at: Conditions) -> list[Parameters]:
        """Parameter sets whose responses span what the effect can do at any small size."""
        if self.wave is None:
            return [parameters]
        return [parameters, {**parameters, self.wave.phase: 0.5 * math.pi}]

    def combined(self, directions: Sequence[Parameters], multiples: Array) -> Parameters:
        """The effect that is the sum of `multiples` (c,) of the first c `directions`."""
        if self.wave is None:
            return self.scaled(directions[0], float(multiples[0]))
        turned = complex(*(*multiples, 0.0)[:2])
        return {**self.scaled(directions[0], abs(turned)),
                self.wave.phase: float(np.angle(turned)) if multiples.size > 1 else 0.0}

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Where a parameter or fitted coordinate is searched, inside its limits; at the upper end
        the effect has become another one."""
        return (INVISIBLE * at.noise if parameter == self.distance else -math.inf), math.inf

    def difference_step(self, parameter: str, value: float, at: Conditions) -> float | None:
        """The relative step of a difference by a parameter; None for the usual one."""
        if self.wave is None or parameter != self.wave.parameter:
            return None
        if self.wave.over == "time":
            return TURNED / (at.duration * max(abs(value), 1e-9))
        return TURNED * min(1.0, abs(value) / (at.travel or 1.0))

    def yields_within(self, parameters: Mapping[str, float]) -> float:
        """The value of `distance`; infinite where there is none."""
        if not self.distance or self.fit is None:
            return math.inf
        fitted = self.fit.forward([parameters[name.lstrip(".")] for name in self.fit.names])
        return float(fitted[self.fit.fitted.index(f".{self.distance}")])

    def is_rounding(self, parameters: Mapping[str, float], step: float) -> bool:
        """Whether it is but a harmonic of a reading that counts in `step`."""
        if self.wave is None or self.wave.over != "position":
            return False
        order = step / parameters[self.wave.parameter]
        return round(order) > 0 and abs(order - round(order)) < HARMONIC * max(order, 1.0)


SMALL = 1e-3
"""Size of a nonlinear force in units of the actuator's, for sensitivities."""
TURNED = 1e-3
"""Turns of a wave over the record or the travel that a difference may take."""
INVISIBLE = 0.1
"""Distance over the noise below which a force that yields over it is dry friction."""
HARMONIC = 0.02
"""Relative distance from a whole number of periods within which a pattern is a harmonic."""
STARTS = 4
"""Starting values of a parameter that shapes the response, where the effect names none."""


def _grid(prior: Prior) -> list[float]:
    spaced = np.geomspace if prior.log else np.linspace
    return [float(v) for v in spaced(prior.low, prior.high, STARTS + 2)[1:-1]]
