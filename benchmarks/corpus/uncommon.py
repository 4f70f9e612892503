"""The uncommon effects as equations of the corpus's own, called by `plant`.

A field is named `effect.parameter`, as the documents name them. Commands: a dead zone and the
plays of a piezo change a held command once; slew limit, sag and heating have states and are
integrated. A lag of the sensor is solved along a cubic through each step, so that it may be far
faster than a step. Where a piecewise force changes its piece within a step, `plant` halves the
step finer (`zone` tells the piece).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

PARAMETERS: dict[str, tuple[str, ...]] = {
    "dead_zone": ("width",), "slew_limit": ("rate",), "supply_sag": ("sag", "time_constant"),
    "coil_heating": ("rise", "time_constant"), "end_stop": (
        "stiffness", "position", "dissipation"), "backlash": ("stiffness", "gap", "centre"),
    "stribeck_friction": ("force", "sliding_ratio", "stribeck_velocity", "exponent"),
    "directional_friction": ("difference",),
    "position_dependent_friction": ("force", "length", "centre"),
    "load_dependent_friction": ("force", "load"), "cogging": ("amplitude", "period", "phase"),
    "gravity": ("weight", "length", "tilt"), "one_sided_cable": ("stiffness", "slack"),
    "structural_damping": ("loss_stiffness",), "stiffness_drift": ("rate",),
    "sensor_clipping": ("limit", "centre"), "sensor_lag": ("time_constant",),
    "sensor_mount": ("frequency", "damping_ratio"),
    "hardening_hysteresis": ("stiffness", "distance", "shape"),
    "prandtl_ishlinskii": ("weight", "range")}
UNCOMMON = tuple(PARAMETERS)
FIELDS = tuple(f"{name}.{parameter}" for name, own in PARAMETERS.items() for parameter in own)
(ZONE_WIDTH, SLEW_RATE, SAG, SAG_TIME, RISE, RISE_TIME, STOP, STOP_AT, STOP_LOSS, LINK, LINK_GAP,
 LINK_CENTRE, BREAK, BREAK_RATIO, BREAK_SPEED, BREAK_SHAPE, DIFFERENCE, PLACE, PLACE_LENGTH,
 PLACE_CENTRE, LOADED, LOADED_AT, COG, COG_PERIOD, COG_PHASE, WEIGHT, ARM, TILT, CABLE, SLACK,
 LOSS, SOFTENS, CLIP, CLIP_CENTRE, SENSOR_LAG, MOUNT_HZ, MOUNT_ZETA, LOOP, LOOP_LENGTH,
 LOOP_SHAPE, PLAY_WEIGHT, PLAY_RANGE) = range(len(FIELDS))
SLEWED, SLOPE, LOAD, HEAT, LOOPED, LAGGED, MOUNT, MOUNT_V, RELAXED = range(9)
RELAXATIONS, PLAYS = 8, 6
STATES = RELAXED + RELAXATIONS
"""States, counted behind those of the common effects."""


@njit(cache=True)
def shaped(u: float, plays: Any, q: Any) -> float:
    """The held command u behind a dead zone and the plays (PLAYS,) of a piezo, which it moves."""
    if q[ZONE_WIDTH] > 0.0:
        u = math.copysign(max(abs(u) - q[ZONE_WIDTH], 0.0), u)
    if q[PLAY_WEIGHT] > 0.0:
        mean = 0.0
        for i in range(PLAYS):
            reach = q[PLAY_RANGE] * (i + 1.0) / PLAYS
            if plays[i] > u + reach:
                plays[i] = u + reach
            elif plays[i] < u - reach:
                plays[i] = u - reach
            mean += plays[i] / PLAYS
        u = (1.0 - q[PLAY_WEIGHT]) * u + q[PLAY_WEIGHT] * mean
    return u


@njit(cache=True)
def commanded(u: float, z: Any, q: Any, d: Any) -> float:
    """The command behind slew limit, sagging supply and warming coil; fills their derivatives."""
    if q[SLEW_RATE] > 0.0:
        d[SLEWED] = z[SLOPE]
        u = z[SLEWED]
    if q[SAG] > 0.0:
        d[LOAD] = (abs(u) - z[LOAD]) / q[SAG_TIME]
        u *= max(1.0 - q[SAG] * z[LOAD], 0.0)
    if q[RISE] > 0.0:
        resistance = 1.0 + z[HEAT]
        d[HEAT] = (q[RISE] * u * u / resistance - z[HEAT]) / q[RISE_TIME]
        u /= resistance
    return u


@njit(cache=True)
def static_force(t: float, x: float, v: float, q: Any) -> float:
    """Forces of position, speed and time (N)."""
    force = -q[DIFFERENCE] * abs(v) - q[SOFTENS] * t * x
    if q[STOP] > 0.0:
        side = math.copysign(1.0, q[STOP_AT])
        depth = side * (x - q[STOP_AT])
        if depth > 0.0:
            force -= side * q[STOP] * depth * max(1.0 + q[STOP_LOSS] * side * v, 0.0)
    if q[LINK] > 0.0:
        away = abs(x - q[LINK_CENTRE]) - 0.5 * q[LINK_GAP]
        force -= q[LINK] * math.copysign(max(away, 0.0), x - q[LINK_CENTRE])
    if q[COG] > 0.0:
        force += q[COG] * math.sin(2.0 * math.pi * x / q[COG_PERIOD] + q[COG_PHASE])
    if q[WEIGHT] > 0.0:
        force -= q[WEIGHT] * math.sin(x / q[ARM] + q[TILT])
    if q[CABLE] > 0.0:
        force -= q[CABLE] * max(x - q[SLACK], 0.0)
    elif q[CABLE] < 0.0:
        force -= q[CABLE] * max(q[SLACK] - x, 0.0)
    return force


@njit(cache=True)
def forces(t: float, x: float, v: float, z: Any, q: Any, d: Any) -> float:
    """All forces on the stage but dry friction (N); fills the derivatives of the states."""
    force = static_force(t, x, v, q)
    if q[LOSS] > 0.0:
        rate, share = 2.0 * math.pi * 0.02, 2.0 * math.log(5.0) / math.pi * q[LOSS]
        for i in range(RELAXED, RELAXED + RELAXATIONS):
            force -= share * (x - z[i])
            d[i] = rate * (x - z[i])
            rate *= 5.0
    if q[LOOP] > 0.0:
        w = z[LOOPED]
        force -= q[LOOP] * q[LOOP_LENGTH] * w
        back = 0.0 if v * w > 0.0 else 2.0 * q[LOOP_SHAPE]
        d[LOOPED] = v / q[LOOP_LENGTH] * (1.0 + abs(w) * (1.0 + back))
    if q[MOUNT_HZ] > 0.0:
        omega = 2.0 * math.pi * q[MOUNT_HZ]
        d[MOUNT] = z[MOUNT_V]
        d[MOUNT_V] = omega * (omega * (x - z[MOUNT]) + 2.0 * q[MOUNT_ZETA] * (v - z[MOUNT_V]))
    return force


@njit(cache=True)
def level(x: float, v: float, motor: float, q: Any) -> float:
    """What these effects make of dry friction (N)."""
    found = 0.0
    if q[BREAK] > 0.0:
        falls = math.exp(-(abs(v) / q[BREAK_SPEED]) ** q[BREAK_SHAPE])
        found += q[BREAK] * (q[BREAK_RATIO] + (1.0 - q[BREAK_RATIO]) * falls)
    if q[PLACE] > 0.0:
        off = (x - q[PLACE_CENTRE]) / q[PLACE_LENGTH]
        found += q[PLACE] * (1.0 + off * off)
    if q[LOADED] > 0.0:
        found += q[LOADED] * (1.0 + abs(motor) / q[LOADED_AT])
    return found


@njit(cache=True)
def zone(x: float, v: float, q: Any) -> int:
    """The piece of the piecewise forces at a place and speed, as a number."""
    found = 0
    if q[STOP] > 0.0:
        found += int(x > q[STOP_AT])
    if q[LINK] > 0.0:
        off = x - q[LINK_CENTRE]
        found += 2 * (int(off > 0.5 * q[LINK_GAP]) - int(off < -0.5 * q[LINK_GAP]) + 1)
    if q[CABLE] != 0.0:
        found += 8 * int(x > q[SLACK])
    if q[DIFFERENCE] != 0.0:
        found += 16 * int(v > 0.0)
    if q[LOOP] > 0.0:
        found += 32 * int(v > 0.0)
    return found


@njit(cache=True)
def followed(z: float, h: float, tau: float, x0: float, v0: float, x1: float, v1: float) -> float:
    """A first-order lag of the sensor after a step h from z, along the cubic between two places
    and speeds: tau z' = x - z has the solution x - tau x' + tau^2 x'' - ... and what decays."""
    mean = (x1 - x0) / h
    bend = 2.0 * (3.0 * mean - 2.0 * v0 - v1) / h
    end = 2.0 * (v0 + 2.0 * v1 - 3.0 * mean) / h
    jerk = (end - bend) / h
    before = x0 - tau * (v0 - tau * (bend - tau * jerk))
    after = x1 - tau * (v1 - tau * (end - tau * jerk))
    return after + (z - before) * math.exp(-h / tau)


@njit(cache=True)
def seen(x: float, z: Any, q: Any) -> float:
    """The position as the sensor has it (m)."""
    if q[MOUNT_HZ] > 0.0:
        x = z[MOUNT]
    if q[SENSOR_LAG] > 0.0:
        x = z[LAGGED]
    if q[CLIP] > 0.0:
        x = min(max(x, q[CLIP_CENTRE] - q[CLIP]), q[CLIP_CENTRE] + q[CLIP])
    return x


@njit(cache=True)
def longest(v: float, q: Any) -> float:
    """Step (s) that these effects allow at a speed."""
    step = 1.0
    if q[LOSS] > 0.0:
        step = 2e-5  # the fastest relaxation takes 1e-4 s
    if q[LOOP] > 0.0 and v != 0.0:
        step = min(step, 0.1 * q[LOOP_LENGTH] / ((1.0 + 2.0 * q[LOOP_SHAPE]) * abs(v)))
    if q[COG] > 0.0 and v != 0.0:
        step = min(step, 0.02 * q[COG_PERIOD] / abs(v))
    return step


@njit(cache=True)
def is_dry(q: Any) -> bool:
    """Whether one of these is a dry friction."""
    return q[BREAK] > 0.0 or q[PLACE] > 0.0 or q[LOADED] > 0.0


@njit(cache=True)
def moves_command(q: Any) -> bool:
    """Whether a held command does not stay held."""
    return q[SLEW_RATE] > 0.0 or q[SAG] > 0.0 or q[RISE] > 0.0


@njit(cache=True)
def begin(x: float, z: Any) -> None:
    """States of a stage that has been at rest at x."""
    z[:] = 0.0
    z[LAGGED] = x
    z[MOUNT] = x
    z[RELAXED:] = x


def at_rest(q: Any, stiffness: float) -> float:
    """Where these forces hold a stage at rest that was let go at 0 (m)."""
    x, softest = 0.0, 0.0
    if q[COG] > 0.0:
        softest += q[COG] * 2.0 * math.pi / q[COG_PERIOD]
    if q[WEIGHT] > 0.0:
        softest += q[WEIGHT] / q[ARM]
    step = 1.0 / (stiffness + q[STOP] + q[LINK] + abs(q[CABLE]) + softest)
    for _ in range(2000):
        pull = float(static_force(0.0, x, 0.0, q)) - stiffness * x
        x += step * pull
        if abs(step * pull) < 1e-15 + 1e-12 * abs(x):
            break
    return x


def packed(values: dict[str, float]) -> Any:
    """The parameters as an array by FIELDS; what is not named is zero."""
    filled = np.zeros(len(FIELDS))
    for name, value in values.items():
        filled[FIELDS.index(name)] = value
    return filled
