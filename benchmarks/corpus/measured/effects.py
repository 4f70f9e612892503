"""Effects of the library and effects that are in none, drawn to the size of a stage's motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corpus.measured.stage import Stage
from benchmarks.corpus.plan import class_of

Fields = dict[str, float]
FRICTION = class_of("coulomb_friction")
LAGS = class_of("transport_delay")
EVEN = class_of("quadratic_stiffness")
ODD = class_of("cubic_stiffness")


@dataclass(frozen=True)
class Scales:
    """RMS of a linear run: x (m), v (m/s), u (V), force of the motor (N); peak (m), last (s), and
    pace: angular frequency of the motion (rad/s)."""

    x: float
    v: float
    u: float
    force: float
    peak: float
    last: float
    pace: float
    inputs: Any

    @classmethod
    def of(cls, stage: Stage, position: Any, command: Any) -> Scales:
        """From the linear motion of a run."""
        x, v, u = (float(np.std(a)) for a in (
            position, np.gradient(position, stage.period), command))
        return cls(x, v, u, stage.base["force_constant"] * u, float(np.max(np.abs(position))),
                   stage.period * len(command), v / x, np.sort(np.abs(command)))


Draw = Callable[[np.random.Generator, Scales, float], Fields]
"""Fields of the plant at a strength: the share of the motor's force that the effect makes."""


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _presliding(rng: np.random.Generator, a: Scales, s: float) -> Fields:
    force = s * a.force
    return {"lugre_force": force, "lugre_stiffness": force / (a.x * rng.uniform(0.05, 0.2)),
            "lugre_ratio": 1.0 + rng.uniform(0.0, 0.5), "lugre_speed": a.v * rng.uniform(0.1, 0.5),
            "lugre_damping": rng.uniform(0.0, 0.1) * force / a.v}


def _hysteresis(rng: np.random.Generator, a: Scales, s: float) -> Fields:
    bend = a.x * rng.uniform(0.05, 0.5)
    return {"wen_stiffness": s * a.force / bend, "wen_yield": bend,
            "wen_shape": rng.uniform(0.5, 1.0), "wen_exponent": rng.uniform(1.0, 2.0)}


def _mode(rng: np.random.Generator, a: Scales, s: float) -> Fields:
    return {"share": 0.3 * s, "mode_hz": a.pace / 2.0 / math.pi * rng.uniform(1.8, 5.0),
            "mode_zeta": rng.uniform(0.005, 0.04)}


LIBRARY: dict[str, Draw] = {
    "cubic_stiffness": lambda r, a, s: {"k3": _sign(r) * s * a.force / a.x**3},
    "quadratic_stiffness": lambda r, a, s: {"k2": _sign(r) * s * a.force / a.x**2},
    "coulomb_friction": lambda _r, a, s: {"coulomb": s * a.force},
    "presliding_friction": _presliding,
    "hysteresis": _hysteresis,
    "quadratic_damping": lambda _r, a, s: {"drag": s * a.force / a.v**2},
    "eddy_current_damping": lambda r, a, s: {
        "eddy": 2.0 * s * a.force / a.v, "eddy_speed": a.v * r.uniform(0.4, 1.5)},
    "force_offset": lambda r, a, s: {"offset": _sign(r) * s * a.force},
    "amplifier_bandwidth": lambda _r, a, s: {"lag": s / a.pace},
    "transport_delay": lambda _r, a, s: {"delay": s / a.pace},
    "saturation": lambda _r, a, s: {
        "limit": float(a.inputs[int((1.0 - 0.5 * s) * (a.inputs.size - 1))])},
    "force_constant_slope": lambda r, a, s: {"slope": _sign(r) * s / a.x},
    "force_constant_droop": lambda _r, a, s: {"droop": s * 0.5 / a.x**2},
    "second_mode": _mode,
    "creep": lambda r, a, s: {"creep_stiffness": s * a.force / a.x,
                              "creep_time": r.uniform(0.03, 0.3) * a.last},
    "periodic_disturbance": lambda r, a, s: {
        "shake": 1.4 * s * a.force, "shake_hz": a.pace / 2.0 / math.pi * r.uniform(0.3, 3.0),
        "shake_phase": r.uniform(-3.0, 3.0)},
}
CLOSED_LOOP = ("coulomb_friction", "presliding_friction", "quadratic_damping",
               "eddy_current_damping", "force_constant_slope", "force_constant_droop")
"""Library effects of runs in closed loop, whose gap is a force along the motion."""

DOCUMENTED = {
    "cubic_stiffness": {"k3": "k3"}, "quadratic_stiffness": {"k2": "k2"},
    "coulomb_friction": {"force": "coulomb"},
    "presliding_friction": {"force": "lugre_force", "stiffness": "lugre_stiffness",
                            "breakaway_ratio": "lugre_ratio", "stribeck_velocity": "lugre_speed",
                            "damping": "lugre_damping"},
    "hysteresis": {"stiffness": "wen_stiffness", "yield_displacement": "wen_yield",
                   "shape": "wen_shape", "exponent": "wen_exponent"},
    "quadratic_damping": {"coefficient": "drag"},
    "eddy_current_damping": {"damping": "eddy", "critical_velocity": "eddy_speed"},
    "force_offset": {"force": "offset"}, "amplifier_bandwidth": {"time_constant": "lag"},
    "transport_delay": {"delay": "delay"}, "saturation": {"limit": "limit"},
    "force_constant_slope": {"slope": "slope"}, "force_constant_droop": {"droop": "droop"},
    "second_mode": {"share": "share", "frequency": "mode_hz", "damping_ratio": "mode_zeta"},
    "creep": {"stiffness": "creep_stiffness", "time_constant": "creep_time"},
    "periodic_disturbance": {"amplitude": "shake", "frequency": "shake_hz",
                             "phase": "shake_phase"},
}
"""Documented parameters of each effect, and the plant's fields."""


@dataclass(frozen=True)
class Outside:
    """An effect that is none of the common ones. relatives: effects that it behaves like in part,
    and why; to be `partial` with them is right, to be certain of them is not. own: uncommon
    effects of the library that it is, or that no data here part from it; to be certain of these is
    right. dry: a dry friction; force: it acts along the motion, so that closed loops can have it;
    spring: it needs one."""

    draw: Draw
    relatives: frozenset[str]
    reason: str
    own: frozenset[str] = frozenset()
    remainder: bool = True
    alone: bool = True
    dry: bool = False
    force: bool = True
    spring: bool = False


NO_RELATIVE: frozenset[str] = frozenset()
OUTSIDE: dict[str, Outside] = {
    "position_damping": Outside(
        lambda r, a, s: {"damping_x": _sign(r) * s * a.force / a.x / a.v}, NO_RELATIVE,
        "odd in the position: no effect of the library brakes on one side and drives on another"),
    "position_damping_even": Outside(
        lambda _r, a, s: {"damping_x2": s * a.force / a.x**2 / a.v},
        frozenset({"quadratic_damping", "position_dependent_friction"}),
        "damping that grows with the amplitude, as a friction does that grows with the position"),
    "directional_damping": Outside(
        lambda r, a, s: {"damping_direction": _sign(r) * s * a.force / a.v}, NO_RELATIVE,
        "|v|: even in the speed, and all dampers of the library are odd",
        own=frozenset({"directional_friction"})),
    "stribeck_curve": Outside(
        lambda r, a, s: {"bump": 2.0 * s * a.force, "bump_speed": a.v * r.uniform(0.2, 0.8)},
        FRICTION, "dry friction near standstill; alone it is a stiff presliding friction",
        alone=False, dry=True,
        own=frozenset({"stribeck_friction"})),
    "odd_force_constant": Outside(
        lambda r, a, s: {"motor_wave": 1.4 * s, "motor_length": a.peak / r.uniform(2.5, 4.0)},
        EVEN, "the slope at the middle, and what a slope is mistaken for"),
    "backlash": Outside(
        lambda r, a, s: {"play_stiffness": 3.0 * s * a.force / a.x,
                         "play_width": a.x * r.uniform(0.3, 0.8)},
        FRICTION, "a play loaded by a spring is a loop; alone it is nearly a hysteresis",
        alone=False,
        own=frozenset({"backlash"})),
    "stiffness_drift": Outside(
        lambda r, a, s: {"stiffness_rate": 2.0 * _sign(r) * s * a.force / a.x / a.last},
        NO_RELATIVE, "a coefficient that changes with time; drifts of the library add",
        spring=True,
        own=frozenset({"stiffness_drift"})),
    "structural_damping": Outside(
        lambda r, a, s: {"maxwell_stiffness": s * a.force / a.x,
                         "maxwell_time": r.uniform(0.1, 0.4) / a.pace},
        frozenset({"creep"}), "creep is one of its relaxations", spring=True, force=False,
        own=frozenset({"structural_damping"})),
    "load_dependent_gain": Outside(
        lambda _r, a, s: {"soft_gain": s / a.u}, frozenset({"saturation"}),
        "a gain that falls with the command",
        own=frozenset({"supply_sag", "coil_heating"})),
    "root_drag": Outside(
        lambda _r, a, s: {"root_drag": s * a.force / math.sqrt(a.v)},
        FRICTION | {"eddy_current_damping"}, "sqrt(|v|) lies between dry and viscous friction, "
        "as an eddy-current brake does below its critical speed"),
    "sensor_even": Outside(
        lambda r, a, s: {"distortion_even": 0.3 * _sign(r) * s / a.x}, EVEN,
        "below the resonance a curved reading is a curved spring", force=False),
    "sensor_odd": Outside(
        lambda r, a, s: {"distortion_odd": 0.2 * _sign(r) * s / a.x**2},
        ODD | {"sensor_clipping"}, "below the resonance a curved reading is a curved spring; one "
        "that gains less at its ends is in part a range that ends", force=False),
    "gain_noise": Outside(
        lambda _r, _a, s: {"gain_noise": s}, NO_RELATIVE, "multiplies; disturbances add"),
    "dead_zone": Outside(
        lambda _r, a, s: {"dead_zone": s * a.u}, NO_RELATIVE,
        "loses the small commands; saturation loses the large ones",
        own=frozenset({"dead_zone"})),
    "cogging": Outside(
        lambda r, a, s: {"cogging": 1.4 * s * a.force, "cogging_phase": r.uniform(-3.0, 3.0),
                         "cogging_length": a.peak * r.uniform(0.3, 0.8)},
        NO_RELATIVE, "several periods within the motion",
        own=frozenset({"cogging", "gravity"})),
    "end_stop": Outside(
        lambda r, a, s: {"stop_gap": a.peak * r.uniform(0.4, 0.7),
                         "stop_stiffness": 8.0 * s * a.force / a.x},
        frozenset({"cubic_stiffness"}), "hardens on both sides; two elastic stops are the law of "
        "a play", remainder=False,
        own=frozenset({"backlash"})),
    "end_stop_one_sided": Outside(
        lambda r, a, s: {"stop_gap": a.peak * r.uniform(0.4, 0.7), "stop_one_sided": 1.0,
                         "stop_stiffness": 8.0 * s * a.force / a.x},
        frozenset({"cubic_stiffness", "quadratic_stiffness"}), "hardens, on one side; without "
        "loss it has the law of a cable", remainder=False,
        own=frozenset({"end_stop", "one_sided_cable"})),
    "one_sided_cable": Outside(
        lambda _r, a, s: {"cable": 2.0 * s * a.force / a.x}, EVEN,
        "|x| is the even half of it", remainder=False,
        own=frozenset({"one_sided_cable", "end_stop"})),
    "sine_gravity": Outside(
        lambda r, a, s: {"gravity": 1.4 * s * a.force, "gravity_length": a.peak / r.uniform(
            2.0, 4.0)}, ODD, "softens with the motion", remainder=False,
        own=frozenset({"gravity", "cogging"})),
    "supply_sag": Outside(
        lambda r, a, s: {"sag": 0.5 * s / a.u**2, "sag_time": r.uniform(0.5, 5.0) / a.pace},
        frozenset({"saturation"}), "the gain falls where much is asked", remainder=False,
        own=frozenset({"supply_sag", "coil_heating"})),
    "slew_limit": Outside(
        lambda _r, a, s: {"slew": 0.3 * a.u * a.pace / s}, LAGS | {"saturation"},
        "a drive that comes late, the more the more is asked", remainder=False, force=False,
        own=frozenset({"slew_limit"})),
    "position_dependent_friction": Outside(
        lambda r, a, s: {"level_wave": s * a.force, "level_length": a.peak / r.uniform(1.5, 3.0)},
        FRICTION, "half of it is constant", remainder=False, dry=True,
        own=frozenset({"position_dependent_friction", "load_dependent_friction"})),
    "load_dependent_friction": Outside(
        lambda _r, _a, s: {"load_friction": s}, FRICTION, "dry friction, of a level that varies",
        remainder=False, dry=True,
        own=frozenset({"load_dependent_friction", "position_dependent_friction"})),
}
LIKE: dict[str, frozenset[str]] = {
    "coulomb_friction": frozenset({"stribeck_friction", "position_dependent_friction",
                                   "load_dependent_friction"}),
    "hysteresis": frozenset({"hardening_hysteresis", "prandtl_ishlinskii", "backlash"}),
    "cubic_stiffness": frozenset({"gravity", "cogging"}),
    "quadratic_stiffness": frozenset({"one_sided_cable", "end_stop"}),
    "saturation": frozenset({"supply_sag", "coil_heating"}),
    "transport_delay": frozenset({"sensor_lag", "slew_limit"}),
    "second_mode": frozenset({"sensor_mount"}),
    "creep": frozenset({"structural_damping"}),
    "force_offset": frozenset({"one_sided_cable"})}
"""Uncommon effects that a common one is a case of, or that some data do not part from it."""


def with_like(names: frozenset[str]) -> frozenset[str]:
    """The names, and the uncommon effects that are like them."""
    return names.union(*(LIKE.get(name, frozenset()) for name in names))


REMAINDERS = tuple(name for name, kind in OUTSIDE.items() if kind.remainder)
OUTSIDERS = tuple(name for name, kind in OUTSIDE.items() if kind.alone)


def can_meet(effect: str, remainder: str) -> bool:
    """Dry friction and a second mode are not simulated together, a remainder that the effect
    itself describes is none, and an effect with its own relative is one effect."""
    if effect == "second_mode" and OUTSIDE[remainder].dry:
        return False
    return effect not in OUTSIDE[remainder].relatives
