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

`inverse_input` is stable inversion: U = R / G on the unit circle. Sampling a stage with more poles
than zeros gives zeros near or outside the unit circle (Astrom, Hagander and Sternby, Automatica
20(1), 1984), so a causal inverse does not exist or grows; the inverse on the circle is bounded and
uses the reference ahead of time instead, delay included (Devasia, Chen and Paden, IEEE Trans.
Autom. Control 41(7), 1996).
Where the reference repeats this is exact. Else it is continued smoothly to rest and held there
until the answer has died out, so that the circle closes without a trace.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PidGains
from dfm_stage.control.lqr import on_reference
from dfm_stage.control.stage import Sampled, linear_stage, sample_model
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.effect import Effect

_DIED_OUT = 1e-7        # share left of the answer: below one count of an encoder
_LONGEST = 2_000_000    # samples: bounds memory and time
_SLOW_M_S = 1e-4    # below this velocity friction is fed forward in proportion, against chatter


def periodic_input(stage: Sampled, reference: ArrayLike) -> Array:
    """Return one period (N,) of the input, V, that makes y the periodic reference (N,), m.

    Raises
    ------
    ControlError
        If the reference is not finite, or the stage does not answer at one of its frequencies.
    """
    r = _checked(reference)
    spectrum = np.fft.rfft(r)
    f = np.asarray(np.fft.rfftfreq(r.size, stage.sample_period_s), dtype=np.float64)
    answer = stage.response(f)
    wanted = np.abs(spectrum) > 1e-12 * np.max(np.abs(spectrum), initial=1e-300)
    silent = wanted & (np.abs(answer) < 1e-9 * np.max(np.abs(answer)))
    silent[-1] = False                            # half the rate: nothing smooth has that
    if np.any(silent) or not np.all(np.isfinite(answer)):
        at = f[int(np.argmax(silent))] if np.any(silent) else 0.0
        raise ControlError(f"feedforward: the stage cannot follow the reference at {at:.3g} Hz; "
                           "give the model a spring, or damping to its modes")
    out = np.where(wanted, spectrum / np.where(wanted, answer, 1.0), 0.0)
    if r.size % 2 == 0:
        out[-1] = 0.0
    return np.asarray(np.fft.irfft(out, r.size))


def inverse_input(stage: Sampled, reference: ArrayLike) -> Array:
    """Return the input (N,), V, that makes y the reference (N,), m, from rest on its first value.

    The input knows the whole reference in advance. Before it the stage has been at rest on its
    first value, so that should start gently; what comes after it is a smooth stop.

    Raises
    ------
    ControlError
        As `periodic_input`, or if the stage's answer dies out too slowly.
    """
    r = _checked(reference)
    h = stage.sample_period_s
    # zeros decay as the inverse, poles as the stage does
    rates = -np.log(np.clip(np.abs(np.concatenate((_zeros(stage), [0.5]))), 1e-12, None))
    length = math.log(1.0 / _DIED_OUT) / max(float(np.min(np.abs(rates))), 1e-12)
    if length > _LONGEST:
        raise ControlError("feedforward: the inverse of this model never dies out; give damping "
                           "to its modes")
    stop = _stop(r, max(2, round(1.0 / h)))
    pause = math.ceil(length)
    back = _smooth(float(stop[-1]), float(r[0]), max(2, round(1.0 / h)))
    whole = np.concatenate((r, stop, np.full(pause, stop[-1]), back, np.full(pause, r[0])))
    return periodic_input(stage, whole)[:r.size]


def _checked(reference: ArrayLike) -> Array:
    r = np.asarray(reference, dtype=np.float64)
    if r.ndim != 1 or r.size < 4 or not np.all(np.isfinite(r)):
        raise ControlError("feedforward: the reference must be at least four finite numbers, "
                           f"not shape {r.shape}")
    return r


def _zeros(stage: Sampled) -> Complex:
    """Return the finite zeros of the sampled stage, shape (q,)."""
    from scipy.linalg import eigvals

    n = stage.b.size
    pencil = np.block([[stage.a, stage.b[:, None]], [stage.c[None], np.zeros((1, 1))]])
    found = eigvals(pencil, np.diag(np.append(np.ones(n), 0.0)))
    return np.asarray(found[np.isfinite(found) & (np.abs(found) < 1e6) & (np.abs(found) > 1e-6)])


def _stop(r: Array, samples: int) -> Array:
    """Return how a movement comes to rest: velocity and acceleration go to zero smoothly."""
    v = (11.0 * r[-1] - 18.0 * r[-2] + 9.0 * r[-3] - 2.0 * r[-4]) / 6.0
    a = 2.0 * r[-1] - 5.0 * r[-2] + 4.0 * r[-3] - r[-4]
    t = np.arange(1, samples + 1, dtype=np.float64)
    u = t / samples
    # r(0), v, a given; zero velocity and acceleration at the end, wherever that is
    fade = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return np.asarray(r[-1] + np.cumsum((v + a * t * (1.0 - u)) * fade))


def _smooth(first: float, last: float, samples: int) -> Array:
    u = np.arange(1, samples + 1, dtype=np.float64) / samples
    return np.asarray(first + (last - first) * u**4 * (35.0 - 84.0 * u + 70.0 * u**2
                                                       - 20.0 * u**3))


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
        used = [(use.effect, tuple(use.parameters[p.name]
                                          for p in use.effect.parameters))
                for use in model.effects]
        self._hooks = [(effect.felt, self._current(base) if effect.by_current else 1.0, values)
                       for effect, values in used if effect.instant]
        self._constant = base.get("constant_force", 0.0)
        self._friction = sum(values[0] for effect, values in used if _rubs(effect))
        self.covers = tuple(effect.name for effect, _ in used if effect.instant or _rubs(effect)
                            or effect.adds_to == "constant_force")

    def _current(self, base: Mapping[str, float]) -> float:
        """The current (A, or V without a resistance) per newton of the actuator."""
        return 1.0 / (self._gain * (base.get("coil_resistance", 0.0) or 1.0))

    @property
    def any(self) -> bool:
        """Whether there is anything to add."""
        return bool(self.covers)

    def at(self, position_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Return the input that goes beside the linear one, at this point of the movement."""
        x, v = position_m, velocity_m_s
        linear = self._m * acceleration_m_s2 + self._c * v + self._k * x
        needed, share = linear - self._constant, 1.0
        needed += self._friction * min(1.0, max(-1.0, v / _SLOW_M_S))
        for force, newton, values in self._hooks:
            alone = force(x, v, 0.0, values)
            needed -= alone
            share += force(x, v, newton, values) - alone
        return (needed / share - linear) / self._gain

    def ahead(self, position_m: float, velocity_m_s: float, acceleration_m_s2: float) -> float:
        """Return what to give at this sample, for where the reference is once it acts, V or A."""
        v, a, t = velocity_m_s, acceleration_m_s2, self.ahead_s
        return self.at(position_m + t * (v + 0.5 * t * a), v + t * a, a)


def _rubs(effect: Effect) -> bool:
    """Whether an effect is dry friction, or cannot be told from it where the motion is large."""
    alike = {effect.name, *(name for each in effect.classes for name in each.members)}
    return any(EFFECTS[name].adds_to == "dry_friction" for name in alike & set(EFFECTS))


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
