"""What takes an output to zero, and keeps it there until an operator has cleared it.

The interlock decides; who owns the output asks it for every command and obeys. It knows no
device and no ROS. Bits and names are those of dfm_interfaces/msg/AmplifierState.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import IntFlag
from typing import Any

from dfm_stage.drivers.errors import RefusedError

SWINGS = 6
_MASK = 0xFFFFFFFF
_NONE_YET = -2


class Cause(IntFlag):
    """Why the output is zero. All but DISARMED latch."""

    STALE_COMMAND = 1
    NOT_FINITE = 2
    OUT_OF_RANGE = 4
    DRIVE = 8
    DISARMED = 16
    ENCODER = 32
    TRAVEL = 64
    CURRENT = 128
    DIVERGING = 256
    OTHER_PUBLISHER = 512
    LINK = 1024
    INTERNAL = 2048
    SHUTDOWN = 4096


class Interlock:
    """Armed or not, and which causes are latched.

    Parameters
    ----------
    limit : float
        Commands beyond plus or minus this are refused.
    stale_s : float
        Longest time between commands once the first has come; 0 in lockstep, where time waits.
    measurement_age_s : float
        Longest age of the measurement that a command answers; 0 = any. One that is stamped as far
        ahead of the clock, which was set back, may be of any age, and is no better.
    age_lasts_s : float
        How long commands may answer older ones, with 0 in their place, before that latches; one
        that does not say which (stamp 0, sent by hand) is obeyed then. 0 = not at all.
    divergence_window_s : float
        SWINGS saturated commands of alternating sign within this time are a diverging loop;
        0 = never.
    on_trip : callable
        Called with cause and words when a cause latches for the first time, in whatever thread.
    """

    def __init__(self, limit: float, stale_s: float = 0.02, measurement_age_s: float = 0.0,
                 divergence_window_s: float = 0.5, age_lasts_s: float = 0.0,
                 on_trip: Callable[[Cause, str], None] | None = None) -> None:
        self.limit = limit
        self.stale_s = stale_s
        self._age_ns = measurement_age_s * 1e9
        self._age_lasts_s = age_lasts_s
        self.too_old = 0
        self._window_ns = divergence_window_s * 1e9
        self._on_trip = on_trip
        self.reasons: dict[Cause, str] = {}
        self.clear()

    def _forget(self) -> None:
        self.last_command_s = math.inf
        self._seq = _NONE_YET
        self._old_since_s: float | None = None
        self._side = 0.0
        self._swings: deque[int] = deque(maxlen=SWINGS)

    # The operator

    def arm(self) -> None:
        """Let commands through.

        Raises
        ------
        RefusedError
            While a cause is latched.
        """
        if self.causes:
            raise RefusedError(f"clear first: {self.words()}")
        self._forget()
        self.armed = True

    def disarm(self) -> None:
        """Let nothing through."""
        self.armed = False
        self._forget()

    def clear(self) -> str:
        """Forget what was latched; the output stays disarmed. Return what it was."""
        was = self.words()
        self.disarm()
        self.causes = Cause(0)
        self.reasons.clear()
        return was

    def words(self) -> str:
        """Return the latched causes with their reasons."""
        return "; ".join(f"{str(cause.name).lower().replace('_', ' ')}: {why}"
                         for cause, why in list(self.reasons.items()))

    # What happens

    def trip(self, cause: Cause, why: str) -> None:
        """Latch a cause and disarm. While nothing is armed it is no event: arming checks."""
        if not self.armed:
            return
        self.armed = False
        self.causes |= cause
        self.reasons[cause] = why
        if self._on_trip is not None:
            self._on_trip(cause, why)

    def accept(self, command: Any, now_s: float, now_ns: int) -> float:
        """Return what may go out for a command: its value, or 0.

        `command` has `voltage`, `seq`, `saturated` and `measurement_stamp_ns`; `now_s` is on the
        clock of `stale`, `now_ns` on the clock of the stamps.
        """
        if not self.armed:
            return 0.0
        value: float = command.voltage
        if not math.isfinite(value):
            self.trip(Cause.NOT_FINITE, f"a command is {value}")
            return 0.0
        if not -self.limit <= value <= self.limit:
            self.trip(Cause.OUT_OF_RANGE,
                      f"a command of {value:g} is beyond the limit of {self.limit:g}")
            return 0.0
        seq = command.seq
        if seq - self._seq != 1 and self._out_of_turn(seq):
            return 0.0
        self._seq = seq
        if command.saturated and self._window_ns and self._diverges(value, now_ns):
            return 0.0
        self.last_command_s = now_s
        if self._age_ns and (command.measurement_stamp_ns or not self._age_lasts_s):
            age_ns = now_ns - command.measurement_stamp_ns
            if abs(age_ns) > self._age_ns:
                self._on_old_measurement(age_ns * 1e-6, now_s)
                return 0.0
            self._old_since_s = None
        return value

    def _on_old_measurement(self, age_ms: float, now_s: float) -> None:
        """Trip if it lasts: a loop that is behind pushes the stage the wrong way."""
        self.too_old += 1
        if self._old_since_s is None:
            self._old_since_s = now_s
        if now_s - self._old_since_s >= self._age_lasts_s:
            self.trip(Cause.ENCODER, f"a command answers a measurement {age_ms:.1f} ms old"
                      if age_ms > 0.0 else "a command answers a measurement stamped "
                      f"{-age_ms:.1f} ms ahead of the clock: was it set back?")

    def _out_of_turn(self, seq: int) -> bool:
        """Trip if a command's number does not come after the last; 0 is no number."""
        if self._seq == _NONE_YET or not seq or 0 < ((seq - self._seq) & _MASK) < 0x80000000:
            return False
        self.trip(Cause.OTHER_PUBLISHER, f"command number {seq} came after {self._seq}: two "
                  "publishers, or one that was restarted")
        return True

    def _diverges(self, value: float, now_ns: int) -> bool:
        side = math.copysign(1.0, value)
        if side == -self._side:
            self._swings.append(now_ns)
            if len(self._swings) == SWINGS and now_ns - self._swings[0] <= self._window_ns:
                self.trip(Cause.DIVERGING, f"{SWINGS} swings from limit to limit in "
                          f"{(now_ns - self._swings[0]) * 1e-9:.3f} s")
                return True
        self._side = side
        return False

    def stale(self, now_s: float) -> bool:
        """Trip if commands have stopped; return whether they have, just now."""
        age = now_s - self.last_command_s
        if self.armed and self.stale_s and age > self.stale_s:
            self.trip(Cause.STALE_COMMAND, f"no command for {age * 1e3:.1f} ms")
            return True
        return False

    def time_left(self, now_s: float) -> float:
        """Return how long until commands would be stale, s; infinite while none is due."""
        if not self.armed or not self.stale_s:
            return math.inf
        return self.last_command_s + self.stale_s - now_s
