"""From a model to the parameters of a controller, with what they promise and why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.feedforward import EffectInput, feedforward_gains, inverse_of
from dfm_stage.control.gains import PidGains
from dfm_stage.control.law import Law
from dfm_stage.control.learning import neighbours
from dfm_stage.control.lqr import LqrDesign, LqrSpec, design_lqr
from dfm_stage.control.pid_design import (
    Ultimate,
    if_stable,
    pid_with_margin,
    ultimate,
    ziegler_nichols,
)
from dfm_stage.control.stage import (
    Margins,
    command_limit,
    frequency_grid,
    highest_mode,
    loop_gain,
    margins,
    sample_model,
)
from dfm_stage.control.switching import law_of, response_of
from dfm_stage.model import Model

FEEDFORWARD_CHOICES = ("gains", "model", "inverse")
# Integral weight in s, at an error weight of _ERROR_M: its pole is then well below the others.
_INTEGRAL = 0.08
_ERROR_M = 2.5e-4
# Speeds of the filter that are tried, N: from trusting the model to trusting the encoder.
_FORCE_NOISES = (0.03, 0.1, 0.3, 1.0)
# How wrong a parameter of an identified model may be.
_UNCERTAINTY = 0.1


@dataclass(frozen=True)
class Tuned:
    """Parameters of the controller node by name, and what the model says of them.

    `bandwidth_hz` is the highest frequency at which the closed loop L / (1 + L) still follows to
    -3 dB. `predicted` are errors in m on the model, noise included, measured from its true
    position. `generator` are parameters of the trajectory generator, if there are any.
    """

    method: str
    parameters: Mapping[str, Any]
    margins: Margins
    bandwidth_hz: float
    predicted: Mapping[str, float]
    reasons: tuple[str, ...]
    generator: Mapping[str, Any] = field(default_factory=dict)


def tune_pid(model: Model, modulus_margin: float = 0.5, output_limit_v: float = 10.0, *,
             model_name: str = "", feedforward: str = "auto", notch: bool = False) -> Tuned:
    """Return the fastest PID that keeps the modulus margin on the whole model, with feedforward.

    Parameters
    ----------
    model : Model
        One axis.
    modulus_margin : float
        To keep, 0 to 1.
    output_limit_v : float
        Largest output; a saturation of the model lowers it.
    model_name : str
        What the controller node is to load where its feedforward comes from the model.
    feedforward : str
        With "gains", three numbers: the inverse of the model's linear part. With "model", the
        node also counts the effects of `model_name`. With "inverse", none here: the trajectory
        generator inverts the whole reference ahead (`inverse_model`), and the feedback acts on the
        error alone. With "auto", "model" where the model has a name and effects that count, else
        "gains".
    notch : bool
        Take the highest mode out of the feedback.

    Raises
    ------
    ControlError
        If no bandwidth keeps the margin, or feedforward is none of these.
    """
    effects = EffectInput(model)
    feedforward = _chosen(feedforward, effects, model_name)
    limit = command_limit(model, output_limit_v)
    design = pid_with_margin(model, modulus_margin, sample_period_s=model.sample_period,
                             output_limit_v=limit, feedforward=False,
                             notch=highest_mode(model) if notch else None)
    gains, extra, given = design.gains, {}, {}
    reasons = [design.reason, f"the fastest that keeps the modulus margin of {modulus_margin:g}"]
    if limit < output_limit_v:
        reasons.append(f"the model saturates at {limit:g} V: that is the output's limit")
    if feedforward == "inverse":
        gains = gains.changed({"setpoint_weight": 1.0, "derivative_weight": 1.0})
        extra = {"inverse_model": model_name}
        reasons.append("the generator inverts the model for the whole reference ahead; the "
                       "feedback acts on the error alone")
    else:
        position, velocity, acceleration = feedforward_gains(sample_model(model), gains)
        gains = gains.changed({"feedforward_position": position, "feedforward_velocity": velocity,
                               "feedforward_acceleration": acceleration})
        reasons.append("feedforward exact for a reference of constant acceleration, with delay, "
                       "lag and sampling")
    if feedforward == "model":
        given = {"feedforward": "model", "model": model_name}
        reasons.append("the model's own input for the reference"
                       + (f", with {', '.join(effects.covers)}" if effects.any else ""))
    return _tuned("pid", model, {"mode": "pid", **gains.to_dict(), **given},
                  pid_margins(model, gains), reasons, extra)


def _chosen(feedforward: str, effects: EffectInput, model_name: str) -> str:
    """Return the feedforward that is meant, one of FEEDFORWARD_CHOICES."""
    if feedforward not in ("auto", *FEEDFORWARD_CHOICES):
        raise ControlError(f"feedforward must be auto, {', '.join(FEEDFORWARD_CHOICES)}, "
                           f"not {feedforward!r}")
    if feedforward == "auto":
        return "model" if effects.any and model_name else "gains"
    if feedforward != "gains" and not model_name:
        raise ControlError(f"feedforward {feedforward} needs the model's name or file")
    return feedforward


def _tuned(method: str, model: Model, parameters: Mapping[str, Any],
           found: tuple[Margins, float], reasons: Sequence[str],
           generator: Mapping[str, Any] | None = None) -> Tuned:
    """Return the parameters with what the law that they ask for does on the model."""
    law, effects = law_of(parameters, model)
    predicted = predicted_errors(model, law, forward=effects, inverse=bool(generator))
    return Tuned(method, parameters, *found, predicted, tuple(reasons), generator or {})


def tune_ziegler_nichols(model: Model, found: Ultimate | None = None,
                         output_limit_v: float = 10.0) -> Tuned:
    """Return the classic PID, from a measured ultimate gain or the model's own.

    Raises
    ------
    ControlError
        If the model's loop has no ultimate gain.
    """
    where = "measured on the loop" if found else "of the sampled model"
    found = found or ultimate(sample_model(model))
    gains = ziegler_nichols(found, output_limit_v=output_limit_v)
    promised = pid_margins(model, gains)
    if not promised[0].stable:
        raise ControlError(f"ziegler_nichols: the loop with model {model.name} is not stable")
    return _tuned("ziegler_nichols", model, {"mode": "pid", **gains.to_dict()}, promised, (
        f"ultimate gain {found.gain_v_m:.5g} V/m and period {found.period_s:.5g} s, {where}",
        ("kp = 0.6 K_u, ki = kp / (P_u / 2), kd = kp P_u / 8 on the error (Ziegler and Nichols, "
         "1942); derivative filtered with a tenth of its time")))


def tune_lqr(model: Model, model_name: str, modulus_margin: float = 0.5,
             output_limit_v: float = 10.0, **switches: bool) -> Tuned:
    """Return the fastest LQR with Kalman filter that keeps the modulus margin.

    Several speeds of the filter are tried, each with the fastest weights that keep the margin.
    The one is taken that keeps most of it with any parameter of the model 10 % off. A slow filter
    trusts the model, a fast one is near its own limit. `model_name` is what the controller node is
    to load. `switches` are those of `LqrSpec`.

    Raises
    ------
    ControlError
        If no weight between 10 mm and 1 um per volt keeps it.
    """
    around = neighbours(model, _UNCERTAINTY)
    best: LqrDesign | None = None
    least = -1.0
    for noise in _FORCE_NOISES:
        found = _fastest(model, modulus_margin, lqr_force_noise_n=noise, **switches)
        if found is None:
            continue
        worst = min(each.modulus if each.stable else 0.0
                    for each in map(found.margins_on, around))
        if worst > least:
            best, least = found, worst
    if best is None:
        raise ControlError(f"lqr: no weight keeps a modulus margin of {modulus_margin:g}; lower "
                           "it")
    spec = best.spec
    reasons: tuple[str, ...] = (
        (f"an error of {spec.lqr_error_m:.3g} m costs as much as {spec.lqr_effort_v:g} V: the "
        f"fastest that keeps the modulus margin of {modulus_margin:g}"),
        f"integral of the error weighed with {spec.lqr_integral_m_s:.3g} m s" if spec.lqr_integral
        else "no integral action: a force or a wrong model leaves an error of "
             f"{best.steady_error(best.stage, 0.0, 1.0):.3g} m/N",
        (f"{_states_of(model)} are states of the design model; the filter reckons "
        f"with {spec.lqr_force_noise_n:g} N of unknown force, which keeps a modulus margin of "
        f"{least:.2f} with any parameter {_UNCERTAINTY:.0%} off"))
    parameters = {"mode": "lqr", "model": model_name,
                  "output_limit_v": command_limit(model, output_limit_v), **spec.to_dict()}
    covers = EffectInput(model).covers
    if covers and model_name:
        parameters["feedforward"] = "model"
        reasons += (f"the input that {', '.join(covers)} takes for the reference is added",
                    "margins and filter are those of the model's linear part")
    return _tuned("lqr", model, parameters,
                  (best.margins, _bandwidth(*loop_of(parameters, model))), reasons)


def _states_of(model: Model) -> str:
    """Name what is in the design model beside the stage's first mode."""
    *others, last = ["delay", "amplifier lag", *(
        use.name.replace("_", " ") for use in model.effects if use.effect.stamp)]
    return f"{', '.join(others)} and {last}"


def _fastest(model: Model, modulus_margin: float, **spec: Any) -> LqrDesign | None:
    """Return the design with the smallest error weighed that keeps the margin, None if none."""
    best: LqrDesign | None = None
    low, high = math.log(1e-6), math.log(1e-2)
    for _ in range(14):
        middle = 0.5 * (low + high)
        error = math.exp(middle)
        found = if_stable(design_lqr, model, LqrSpec(
            lqr_error_m=error, **spec,
            lqr_integral_m_s=_INTEGRAL * error * math.sqrt(error / _ERROR_M)))
        if found is not None and found.margins.modulus >= modulus_margin:
            best, high = found, middle
        else:
            low = middle
    return best


def loop_of(parameters: Mapping[str, Any], model: Model) -> tuple[Array, Complex]:
    """Return frequencies (F,), Hz, and the loop gain L (F,) under these parameters, on the
    model."""
    stage = sample_model(model)
    f = frequency_grid(stage)
    return f, stage.response(f) * response_of(parameters, model, f)


def pid_margins(model: Model, gains: PidGains) -> tuple[Margins, float]:
    """Return margins and bandwidth (Hz) of a PID on the whole model."""
    stage = sample_model(model)
    return margins(stage, gains), _bandwidth(*loop_gain(stage, gains))


def _bandwidth(f: Array, loop: Complex) -> float:
    following = np.flatnonzero(np.abs(loop / (1.0 + loop)) >= math.sqrt(0.5))
    return float(f[following[-1]]) if following.size else 0.0


def predicted_errors(model: Model, controller: Law, seed: int = 0, *,
                     forward: EffectInput | None = None,
                     inverse: bool = False) -> dict[str, float]:
    """Return errors of the true position on the model, m: `step_1mm_after_5s` (largest from 5 s
    on), `sine_1mm_half_hz_peak` (after two of its periods) and `at_rest_rms`.

    `forward` and `inverse` (for the sine) as in `run_on_model`.
    """
    h = model.sample_period
    t = np.arange(round(8.0 / h)) * h
    step = run_on_model(model, controller, np.full(t.size, 1e-3), seed=seed, forward=forward)
    w = math.pi
    ramp = np.clip(t / 2.0, 0.0, 1.0)
    rise = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    slope = 30.0 * ramp**2 * (1.0 - ramp)**2 / 2.0
    bend = 60.0 * ramp * (1.0 - ramp) * (1.0 - 2.0 * ramp) / 4.0
    s, c = np.sin(w * t), np.cos(w * t)
    sine = 1e-3 * rise * s
    velocity = 1e-3 * (slope * s + rise * w * c)
    acceleration = 1e-3 * (bend * s + 2.0 * slope * w * c - rise * w * w * s)
    follow = run_on_model(model, controller, sine, velocity, acceleration, seed=seed,
                          forward=forward, inverse=inverse)
    return {"step_1mm_after_5s": float(np.max(np.abs(step[t >= 5.0] - 1e-3))),
            "sine_1mm_half_hz_peak": float(np.max(np.abs((follow - sine)[t >= 4.0]))),
            "at_rest_rms": float(np.std(step[t >= 6.0]))}


def run_on_model(model: Model, controller: Law, position: Array,
                 velocity: Array | None = None, acceleration: Array | None = None,
                 added: Array | None = None, seed: int = 0, *,
                 forward: EffectInput | None = None, inverse: bool = False) -> Array:
    """Return the true position (N,), m, of the model under a controller, which is reset first.

    `position`, `velocity`, `acceleration` (N,) are the reference, `added` (N,) V what is added to
    the controller's output. `forward` is what effects take for the reference; `inverse` adds the
    model's inverse of the whole reference.
    """
    zero = np.zeros(position.size)
    reference = np.column_stack([each if each is not None else zero for each in (
        position, velocity, acceleration, added)])
    if inverse:
        reference[:, 3] += inverse_of(model, *reference[:, :3].T)
    from dfm_stage.model import Plant  # with numba, which a controller node can do without

    plant = Plant(model, seed=seed)
    limit = command_limit(model, 1e6)
    controller.reset()
    out = np.empty(position.size)
    for k, (r, v, a, extra) in enumerate(reference.tolist()):
        sample = plant.sample()
        out[k] = sample.position_m
        effects = forward.ahead(r, v, a) if forward is not None else 0.0
        asked = controller.step(r, sample.reading_m, v, a, 0.0, effects)
        total = min(limit, max(-limit, asked + extra))
        controller.observe(total - effects)
        plant.advance(total)
    return out
