"""Finding the ultimate gain on the running loop: by raising the gain, or with a relay.

Both are laws like any other, one sample per call, so that they run where the loop runs and can
stop within a sample. Both end by themselves: `outcome` is then the result, or `failure` says why
there is none; from then on the output is zero.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.control.errors import ControlError
from dfm_stage.control.law import checked, require_known
from dfm_stage.control.pid_design import (
    Oscillation,
    Ultimate,
    oscillation,
    ultimate_from_relays,
)
from dfm_stage.model.parameter import Parameter

TUNING_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("tuning_gain_v_m", 100.0, "V/m", "proportional gain that raising starts from",
              1e-9, 1e12),
    Parameter("tuning_factor", 1.25, "", "by how much the gain is raised each time", 1.001, 10.0),
    Parameter("tuning_voltage_v", 0.5, "V", "amplitude of the relay and of the pulses", 1e-9, 1e6),
    Parameter("tuning_travel_m", 4e-3, "m", "tuning ends where the stage goes further than this "
              "from where it was at rest", 1e-9, 1e3),
    Parameter("tuning_time_s", 120.0, "s", "longest duration of a tuning run", 1e-3, 1e6),
)
_PULSE_S = 0.01         # long against a sample, short against the stage's period
_REST_S = 0.1           # over this the position at rest is averaged
_SWINGS = 14            # turning points per gain: enough for a line through their logarithms
_SKIPPED = 3            # the first ones belong to the pulse
_STEADY_GROWTH = 1e-3   # growth per period at which the swings count as constant
_REFINEMENTS = 8        # interpolations between two gains; each gains about a digit


Level = tuple[float, float, float]
"""Gain (V/m), growth of the swings (1/s) and their period (s)."""


class TuningRun:
    """What both ways have in common; parameters as in `TUNING_PARAMETERS`.

    Raises
    ------
    ControlError
        If a parameter is not a finite number in its range.
    """

    def __init__(self, sample_period_s: float, **parameters: float) -> None:
        require_known(parameters, (each.name for each in TUNING_PARAMETERS), "tuning")
        self._gain: float
        self._volts: float
        (self._gain, self._factor, self._volts, self._travel,
         self._time_s) = checked(TUNING_PARAMETERS, parameters, "tuning").values()
        self._h = sample_period_s
        self._k, self._zero = 0, 0.0
        self._rest: list[float] = []
        self.outcome: Ultimate | None = None
        self.failure = ""

    @property
    def ended(self) -> bool:
        """Whether it is over, in success or not."""
        return self.outcome is not None or bool(self.failure)

    def step(self, position_m: float) -> float:
        """Return the output for one sample, V, about where the stage was at rest."""
        if self.ended:
            return 0.0
        if not math.isfinite(position_m):
            self.failure = "the measurement is not a finite number"
            return 0.0
        self._k += 1
        if self._k * self._h <= _REST_S or not self._rest:
            self._rest.append(position_m)
            self._zero = sum(self._rest) / len(self._rest)
            return 0.0
        y = position_m - self._zero
        if abs(y) > self._travel:
            self._too_far(y)
        elif self._k * self._h > self._time_s:
            self.failure = (f"no result within {self._time_s:g} s; allow more time or start "
                            "from a higher gain")
        return 0.0 if self.ended else self._law(y)

    def _too_far(self, y: float) -> None:
        self.failure = (f"the stage went {abs(y) * 1e3:.3g} mm from rest, "
                        f"{self._travel * 1e3:.3g} mm are allowed; lower tuning_voltage_v or "
                        "raise tuning_travel_m")

    def _law(self, y: float) -> float:
        raise NotImplementedError


class GainRaising(TuningRun):
    """Raises a proportional gain until the loop oscillates, as the paper does.

    At each gain the stage gets a pulse if it moves too little, and the growth of its swings is
    measured. Once they grow the gain is between the last two; it is then moved to where a straight
    line through the two growths is zero, until a period changes the swings by less than 0.1 %.
    """

    def __init__(self, sample_period_s: float, **parameters: float) -> None:
        super().__init__(sample_period_s, **parameters)
        self._pulse_samples = self._pulse = max(1, round(_PULSE_S / sample_period_s))
        self._levels: list[Level] = []
        self._refined = 0
        self._begin()

    def _begin(self) -> None:
        self._extreme, self._at, self._rising = math.nan, 0, True
        self._extremes: list[tuple[int, float]] = []
        self._since = self._k

    def _law(self, y: float) -> float:
        if self._pulse > 0:
            self._pulse -= 1
            if self._pulse == 0:
                self._begin()
            return self._volts - self._gain * y
        self._watch(y)
        quiet = self._k - self._since > 2.0 / self._h
        if quiet and not self._extremes:
            self._pulse = self._pulse_samples
        elif len(self._extremes) >= _SWINGS or (quiet and len(self._extremes) < 4):
            self._evaluate()
        return 0.0 if self.ended else -self._gain * y

    def _watch(self, y: float) -> None:
        """Collect turning points; a turn counts once it went back by a tenth of a swing."""
        if math.isnan(self._extreme):
            self._extreme, self._at = y, self._k
        if (y > self._extreme) == self._rising:
            self._extreme, self._at = y, self._k
            return
        swing = abs(self._extreme - (self._extremes[-1][1] if self._extremes else 0.0))
        if abs(y - self._extreme) > max(0.1 * swing, 1e-6):
            self._extremes.append((self._at, self._extreme))
            self._rising = not self._rising
            self._extreme, self._at = y, self._k

    def _growth(self) -> tuple[float, float] | None:
        """Return growth rate (1/s) and period (s) at this gain, if there were enough swings."""
        if len(self._extremes) < _SKIPPED + 5:
            return None
        at, y = np.array(self._extremes[_SKIPPED:], dtype=np.float64).T
        swings = np.abs(np.diff(y))
        times = 0.5 * (at[1:] + at[:-1]) * self._h
        if np.min(swings) <= 0.0:
            return None
        growth = float(np.polyfit(times - times[0], np.log(swings), 1)[0])
        return growth, 2.0 * float(at[-1] - at[0]) * self._h / (at.size - 1)

    def _evaluate(self) -> None:
        measured, swing = self._growth(), 0.0
        if measured is None:                        # died out too fast to be measured
            self._gain *= self._factor
        else:
            growth, period = measured
            self._levels.append((self._gain, growth, period))
            if abs(growth) * period < _STEADY_GROWTH:
                self.outcome = Ultimate(self._gain, period)
                return
            self._refine()
            swing = abs(self._extremes[-1][1] - self._extremes[-2][1])
        self._begin()
        if swing < 0.05 * self._travel:
            self._pulse = self._pulse_samples

    def _refine(self) -> None:
        """Go between the last gain at which swings shrank and the first at which they grew."""
        grown = min((each for each in self._levels if each[1] > 0.0), default=None)
        shrunk = max((each for each in self._levels if each[1] <= 0.0), default=None)
        if grown is None:
            self._gain *= self._factor
        elif shrunk is None:
            self.failure = (f"the loop oscillates at {self._gain:g} V/m already; start from a "
                            "lower tuning_gain_v_m")
        else:
            found = _steady_between(shrunk, grown)
            self._gain = found.gain_v_m
            self._refined += 1
            if self._refined > _REFINEMENTS:
                self.outcome = found

    def _too_far(self, y: float) -> None:
        measured = self._growth()
        shrunk = max((each for each in self._levels if each[1] <= 0.0), default=None)
        if measured is None or measured[0] <= 0.0 or shrunk is None:
            super()._too_far(y)
        else:   # growing was the answer sought; the gain lies between this one and the last
            self.outcome = _steady_between(shrunk, (self._gain, *measured))


def _steady_between(low: Level, high: Level) -> Ultimate:
    """Return where a straight line through the growth at two gains is zero."""
    share = low[1] / (low[1] - high[1])
    return Ultimate(low[0] + share * (high[0] - low[0]), low[2] + share * (high[2] - low[2]))


class RelayRun(TuningRun):
    """Lets a relay drive the stage, switching on the sample, a sample early, a sample late."""

    def __init__(self, sample_period_s: float, **parameters: float) -> None:
        super().__init__(sample_period_s, **parameters)
        self._found: list[Oscillation] = []
        self._early = [0.0, 1.0, -1.0]
        self._positions: list[float] = []
        self._outputs: list[float] = []
        self._before, self._periods_seen = 0.0, 0

    def _law(self, y: float) -> float:
        ahead = y + self._early[0] * (y - self._before)
        fell = self._before > 0.0 >= y
        self._before = y
        output = -self._volts if ahead > 0.0 else self._volts
        self._positions.append(y)
        self._outputs.append(output)
        if fell:
            self._periods_seen += 1
            if self._periods_seen >= 16 and self._periods_seen % 4 == 0:
                self._evaluate()
        return 0.0 if self.ended else output

    def _evaluate(self) -> None:
        y, u = np.array(self._positions), np.array(self._outputs)
        try:
            found = oscillation(y, u, self._h, periods=8)
            last = round(4.0 * found.period_s / self._h)
            before = oscillation(y[:-last], u[:-last], self._h, periods=8)
            steady = abs(found.gain_v_m - before.gain_v_m) < 0.005 * found.gain_v_m
        except ControlError:
            steady = False
        if steady:
            self._found.append(found)
        if steady or self._periods_seen > 400:
            self._early.pop(0)
            self._positions.clear()
            self._outputs.clear()
            self._periods_seen = 0
            if not self._early:
                try:
                    self.outcome = ultimate_from_relays(self._found)
                except ControlError as error:
                    self.failure = str(error)
