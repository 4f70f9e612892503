"""What no law may do: drive the stage out of its travel, or swing between its limits for ever."""

from __future__ import annotations

import math
from collections import deque

from dfm_stage.control.law import checked
from dfm_stage.model.parameter import Parameter

GUARD_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("travel_limit_m", 7e-3, "m",
              "the guard trips where the stage would coast beyond this; 0 = no guard", 0.0, 1e3),
    Parameter("coast_time_s", 0.04, "s",
              "distance coasted per velocity; 1 / (2 pi f) of a stage on a spring", 0.0, 1e3),
    Parameter("divergence_window_s", 0.5, "s",
              "six swings from limit to limit within this time are a diverging loop; 0 = never",
              0.0, 1e3),
)
_SWINGS = 6         # from limit to limit within the window: no step of the reference takes so many
_IN_A_ROW = 4       # one wrong reading shows in the velocity of three samples
_AHEAD = 7.0        # samples: those four, and the delay of the loop


class Guard:
    """Watches one axis; `tripped` is empty, or says why the output has to be zero until `reset`.

    A stage on a spring that is let go with position x and velocity v gets no further than
    sqrt(x^2 + (v / w)^2): moving outwards with that beyond the travel limit on four samples in a
    row, the guard trips. One wrong reading does not do it, nor a fast movement inwards, which the
    law is still to brake. v is taken seven samples ahead, for these four and the loop's delay. A
    loop that diverges at a higher frequency first swings between the output's limits: six swings
    within the window trip it too. With no output, spring and damper bring the stage to rest.

    Raises
    ------
    ControlError
        If a number is not finite or not in its range.
    """

    __slots__ = ("_before", "_coast", "_limit", "_moved", "_outside", "_side", "_squared",
                 "_swings", "_time", "_window", "tripped")

    def __init__(self, sample_period_s: float, travel_limit_m: float = 7e-3,
                 coast_time_s: float = 0.04, divergence_window_s: float = 0.5) -> None:
        limit, coast, window = checked(GUARD_PARAMETERS, {
            "travel_limit_m": travel_limit_m, "coast_time_s": coast_time_s,
            "divergence_window_s": divergence_window_s}, "guard").values()
        self._limit, self._squared = limit, limit * limit
        self._coast = coast / sample_period_s
        self._window = round(window / sample_period_s)
        self.reset()

    def reset(self) -> None:
        """Allow output again."""
        self.tripped = ""
        self._before = self._moved = math.nan
        self._outside = self._side = self._time = 0
        self._swings: deque[int] = deque(maxlen=_SWINGS)

    def check(self, position_m: float, output_v: float, output_limit_v: float,
              samples: int = 1) -> bool:
        """Return whether `output_v` may go out; `samples` have passed since the last call."""
        if self.tripped:
            return False
        self._time += samples
        moved = (position_m - self._before) / samples
        self._before = position_m
        if self._limit:
            reach = (moved + _AHEAD * (moved - self._moved)) * self._coast
            self._moved = moved
            if reach != reach or reach * position_m < 0.0:
                reach = 0.0
            if position_m * position_m + reach * reach > self._squared:
                self._outside += 1
                if self._outside >= _IN_A_ROW:
                    self.tripped = (f"at {position_m * 1e3:.3g} mm and "
                                    f"{reach * 1e3:.3g} mm to coast it would leave the travel of "
                                    f"{self._limit * 1e3:.3g} mm")
                    return False
            else:
                self._outside = 0
        if self._window and (output_v >= output_limit_v or output_v <= -output_limit_v):
            side = 1 if output_v > 0.0 else -1
            if side == -self._side:
                self._swings.append(self._time)
                if (len(self._swings) == _SWINGS
                        and self._time - self._swings[0] <= self._window):
                    self.tripped = "the output swings from limit to limit: the loop diverges"
                    return False
            self._side = side
        return True
