"""Feedforward from the inverse of a whole model: its linear stage, and its effects beside it.

The linear part is exact for a reference of constant acceleration (`on_reference`, the regulator
equations), delay, amplifier lag, sampling and second mode included; where the whole reference is
known ahead, `inverse_of` is exact for any (`inverse_input`). Effects act at the driven point. With
F the force of an actuator of constant force constant and f_i(x, v, F) those of the effects, all
linear in F, the linear stage feels what it has to if

    F + sum f_i(x, v, F) + f_0 - F_c sgn(v) = m a + c v + k x

which gives F in one step, from where the reference will be once the input has come through delay
and lag: springs, drags, a force constant that changes with position, a constant force, friction.
Friction with memory (pre-sliding) counts with the force it settles to; hysteresis, creep and
disturbances are left to the feedback.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfm_stage.control.feedforward import inverse_input, periodic_input
from dfm_stage.control.gains import PidGains
from dfm_stage.control.lqr import on_reference
from dfm_stage.control.stage import Sampled, linear_stage, sample_model
from dfm_stage.model import EFFECTS, Model

Array = NDArray[np.float64]
_SLOW_M_S = 1e-4    # below this velocity friction is fed forward in proportion, against chatter
_FRICTION = ("coulomb_friction", "presliding_friction")


class EffectInput:
    """What the effects of a model take beyond its linear part, V (or A).

    `any` is false for a linear model. `covers` are the names of the effects that count.
    """

    def __init__(self, model: Model) -> None:
        base = model.effective_base()
        self._m, self._c = base["mass"], base.get("damping", 0.0)
        self._k, self._gain = base.get("stiffness", 0.0), base["force_constant"]
        stage = linear_stage(model)
        self.ahead_s = stage.delay_s + stage.lag_s + 0.5 * model.sample_period
        self._hooks: list[tuple[Any, tuple[float, ...]]] = []
        self._friction = self._constant = 0.0
        covers = []
        for use in model.effects:
            effect = EFFECTS[use.name]
            values = tuple(use.parameters[p.name] for p in effect.parameters)
            if use.name in _FRICTION:
                self._friction += use.parameters["force"]
            elif use.name == "force_offset":
                self._constant += use.parameters["force"]
            elif effect.force is not None:
                self._hooks.append((effect.force, values))
            else:
                continue
            covers.append(use.name)
        self.covers = tuple(covers)

    @property
    def any(self) -> bool:
        """Whether there is anything to add."""
        return bool(self.covers)

    def at(self, position_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Return the input that goes beside the linear one, at this point of the movement."""
        x, v = position_m, velocity_m_s
        linear = self._m * acceleration_m_s2 + self._c * v + self._k * x
        sign = min(1.0, max(-1.0, v / _SLOW_M_S))
        needed, share = linear - self._constant + self._friction * sign, 1.0
        for force, values in self._hooks:
            alone = force(x, v, 0.0, values)
            needed -= alone
            share += force(x, v, 1.0, values) - alone
        return (needed / share - linear) / self._gain

    def ahead(self, position_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Return what to give at this sample, for where the reference is once it acts, V or A."""
        v, a, t = velocity_m_s, acceleration_m_s2, self.ahead_s
        return self.at(position_m + t * (v + 0.5 * t * a), v + t * a, a)


def feedforward_gains(stage: Sampled, gains: PidGains | None = None) -> tuple[float, float, float]:
    """Return the input per position, velocity and acceleration that holds a stage on a reference.

    With a PID beside it, whose proportional and derivative part see the weighted reference, what
    they would take off is included.

    Raises
    ------
    ControlError
        If the stage cannot be held on a reference.
    """
    position, velocity, acceleration = (float(each) for each in on_reference(stage)[1])
    if gains is None:
        return position, velocity, acceleration
    short = gains.kd * (1.0 - gains.derivative_weight)
    late = gains.derivative_filter_s + 0.5 * stage.sample_period_s
    return (position + gains.kp * (1.0 - gains.setpoint_weight), velocity + short,
            acceleration - short * late)


def inverse_of(model: Model, position: ArrayLike, velocity: ArrayLike,
               acceleration: ArrayLike, *, repeats: bool = False) -> Array:
    """Return the input (N,), V (or A), that moves a model along a reference known ahead.

    Position, velocity and acceleration have shape (N,), in SI. They are one period of a movement
    that `repeats`; else the stage has been at rest on the first value before.

    Raises
    ------
    ControlError
        As `inverse_input`.
    """
    x, v, a = (np.asarray(each, dtype=np.float64) for each in (position, velocity, acceleration))
    out = (periodic_input if repeats else inverse_input)(sample_model(model), x)
    effects = EffectInput(model)
    if not effects.any:
        return out
    extra = np.array([effects.at(*each) for each in zip(x.tolist(), v.tolist(), a.tolist(),
                                                        strict=True)])
    t = np.arange(x.size) * model.sample_period
    period = x.size * model.sample_period if repeats else None
    return np.asarray(out + np.interp(t + effects.ahead_s, t, extra, period=period))
