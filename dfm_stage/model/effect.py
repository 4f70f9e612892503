"""What an effect is: its physics as data, and the compiled pieces the simulator is built from.

Each module of `dfm_stage.model.effects` holds one `EFFECT`. Nothing else has to be edited to add
an effect: the registry finds it, the kernel compiles its hooks in, validation, fitting and the
documentation read its data.

Hooks are plain functions of floats and arrays that numba can compile. `p` is the tuple of the
effect's own parameters, in the order of `parameters`; `x` (m) and `v` (m/s) are position and
velocity of the driven point, `actuator` (N) the force of an actuator of constant force constant.

`force(x, v, actuator, p) -> N`
    A smooth force on the driven point.
`advance(z, dx, v0, v1, p) -> z` with `bristle_force(z, v, p) -> N`
    A force with memory: the state `z` after the point moved by `dx` without reversing, while its
    velocity went from `v0` to `v1`; and the force that goes with it.
`stamp(a, rows, first, p)` with `states`
    A linear part whose states begin at index `first`, see `dfm_stage.model.kernel.assemble`;
    `start(state, first, p)` gives them initial values.
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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from dfm_stage.model.parameter import Parameter

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

    `names` are the free parameters it replaces, as `Model.parameters` names them, those of the
    effect itself with a leading dot; `forward` and `backward` map arrays of their values, same
    order, to the fitted coordinates `fitted`.
    """

    names: tuple[str, ...]
    fitted: tuple[str, ...]
    forward: Callable[[Any], Any]
    backward: Callable[[Any], Any]


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
    must be given. `frequency` names the parameter (Hz) of a vibration of the effect's own: a
    periodic motion exists only if its period holds whole cycles of it.
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
    adds_to: str | None = None
    frequency: str | None = None
    states: tuple[str, ...] = ()
    stage: Literal["modes", "amplifier", "mechanics"] = "mechanics"
    force: Callable[..., float] | None = field(default=None, repr=False)
    advance: Callable[..., float] | None = field(default=None, repr=False)
    bristle_force: Callable[..., float] | None = field(default=None, repr=False)
    stamp: Callable[..., None] | None = field(default=None, repr=False)
    start: Callable[..., None] | None = field(default=None, repr=False)
    sense: Callable[..., float] | None = field(default=None, repr=False)
    encode: Callable[..., float] | None = field(default=None, repr=False)
    other_force: Callable[..., float] | None = field(default=None, repr=False)

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
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)
