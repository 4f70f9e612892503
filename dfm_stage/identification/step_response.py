"""Step response: rise and settling time, overshoot, and what they say of a second-order stage.

Times count from the step of the input and so include delay and lag. Intervals come from repeating
the analysis with the record's own noise added again (a parametric bootstrap, seeded).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.fitting import noise_level, turning_point
from dfm_stage.identification.quantity import Quantity, interval

REPEATS = 60
"""Of the bootstrap: its standard errors are then good to a tenth."""
LEAST_OVERSHOOT, OVERSHOOT_NOISE = 1e-3, 5.0
"""Share of the step, and times the noise, below which there is no overshoot to derive a damping
ratio from."""
RISE = (0.1, 0.9)
"""Shares of the step between which the rise time counts, as the paper has it."""
LEAVES_BAND = 4.0
"""Times the noise by which a sample leaves the band: noise alone does once in 16,000 samples."""
FEWEST_SAMPLES, SAMPLES_BEFORE = 20, 500
"""Needed after the step, and averaged before it to know where it starts from."""


@dataclass(frozen=True)
class StepResponse:
    """What a step shows; times in s from the step of the input, levels in m.

    `rise_time` from 10 to 90 % of the step, `settling_time` until the response stays within
    `band` of it, `overshoot` in % of the step, `damping` and `natural_frequency` (rad/s) from
    overshoot and time of the first peak: zeta = -ln M / sqrt(pi^2 + ln^2 M),
    w = pi / (t_peak sqrt(1 - zeta^2)), which holds for one mode with little delay. NaN where there
    is no overshoot.
    """

    rise_time: Quantity
    settling_time: Quantity
    overshoot: Quantity
    peak_time: Quantity
    initial: Quantity
    final: Quantity
    damping: Quantity
    natural_frequency: Quantity
    band: float
    start: int

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        named = {name: getattr(self, name).to_dict() for name in _UNITS}
        return {**named, "band": self.band}


_UNITS = {"rise_time": "s", "settling_time": "s", "overshoot": "%", "peak_time": "s",
          "initial": "m", "final": "m", "damping": "", "natural_frequency": "rad/s"}


def step_response(command: Array, position: Array, sample_period: float, *, band: float = 0.02,
                  start: int | None = None, final: float | None = None) -> StepResponse:
    """Analyse the answer of `position` (N,) to the last step of `command` (N,).

    `start` is the sample of the step where the command does not tell, `final` (m) the level that
    is settled to, where it is known (the reference of a closed loop); otherwise the record's end
    decides.

    Raises
    ------
    IdentificationError
        If the command does not step, or the record ends before the response is halfway.
    """
    y = np.asarray(position, dtype=float)
    if start is None:
        jumps = np.flatnonzero(np.diff(command))
        if not jumps.size:
            raise IdentificationError("the command never steps: nothing to respond to")
        start = int(jumps[-1]) + 1
    after = y[start:]
    if after.size < FEWEST_SAMPLES:
        raise IdentificationError("the record ends right after the step: record longer")
    noise = noise_level(after[after.size // 2:])
    before = y[max(start - SAMPLES_BEFORE, 0):start + 1]
    values = np.array(_figures(before, after, sample_period, band, final, noise))
    if not math.isfinite(values[0]):
        raise IdentificationError("the response does not rise through 10 and 90 % of the step: "
                                  "record longer")
    rng = np.random.default_rng(0)
    again = np.array([_figures(before + noise * rng.standard_normal(before.size),
                               after + noise * rng.standard_normal(after.size), sample_period,
                               band, final, noise) for _ in range(REPEATS)])
    errors = again.std(axis=0, ddof=1)
    found = {name: Quantity(float(v), unit, interval(float(v), float(e)))
             for (name, unit), v, e in zip(_UNITS.items(), values, errors, strict=True)}
    return StepResponse(**found, band=band, start=start)


def _figures(before: Array, after: Array, period: float, band: float, final: float | None,
             noise: float) -> tuple[float, ...]:
    first = float(np.mean(before))
    last = _resting(after) if final is None else final
    height = last - first
    if height == 0.0:
        return (math.nan,) * len(_UNITS)
    share = (after - first) / height
    low, high = (_crossing(share, level) for level in RISE)
    # Noise must not end the settling late: the band is left by what stands out of it.
    outside = np.flatnonzero(np.abs(share - 1.0) > max(band, LEAVES_BAND * noise / abs(height)))
    settled = 0.0
    if outside.size:
        at = int(outside[-1])
        settled = at + _between(np.abs(share - 1.0), at, band) if at + 1 < share.size else math.nan
    top = int(np.argmax(share))
    overshoot, peak = _peak(share, top)
    ratio = natural = math.nan
    least = max(LEAST_OVERSHOOT, OVERSHOOT_NOISE * noise / abs(height))
    if least < overshoot < 1.0 and peak > 0.0:
        log = math.log(overshoot)
        ratio = -log / math.hypot(math.pi, log)
        natural = math.pi / (peak * period * math.sqrt(1.0 - ratio**2))
    return ((high - low) * period, settled * period, 100.0 * max(overshoot, 0.0), peak * period,
            first, last, ratio, natural)


def _resting(after: Array) -> float:
    """Where it comes to rest: the end under a Hann window, which passes a swing only weakly."""
    tail = after[2 * after.size // 3:]
    weight = np.hanning(tail.size + 2)[1:-1]
    return float(weight @ tail / weight.sum())


def _crossing(share: Array, level: float) -> float:
    """First sample, with its fraction, at which `level` is passed upwards."""
    above = np.flatnonzero(share >= level)
    if not above.size or above[0] == 0:
        return 0.0 if above.size else math.nan
    return float(above[0]) - 1.0 + _between(share, int(above[0]) - 1, level)


def _between(values: Array, at: int, level: float) -> float:
    step = values[at + 1] - values[at]
    return float(np.clip((level - values[at]) / step, 0.0, 1.0)) if step else 0.0


def _peak(share: Array, top: int) -> tuple[float, float]:
    """Return height above one and place (samples) of the peak, from a quartic around it."""
    reach = max(min(top // 5, share.size - 1 - top), 2)
    if top < reach or top + reach >= share.size:
        return float(share[top]) - 1.0, float(top)
    place, height = turning_point(share, top, reach)
    return height - 1.0, place
