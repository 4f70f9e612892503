"""The real-time priority of a node's process: taken, watched, and given back."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

_SELF = Path("/proc/self")
_SENDER, _SENDER_PRIORITY = "dds.asyn", 1
"""Fast DDS's thread for what did not go out at once, and the lowest real-time priority for it. It
tries the lock of a writer again and again without a pause: at the priority of the loop it kept the
processor from whoever held that lock. Without any, tools that started kept the processor from it
while it held a lock itself, and the loop waited for up to 41 ms."""
_CROWDED = 0.05
_CROWDED_LOOKS = 5
_CROWDED_S = 0.9
"""So much waiting in fewer looks is enough: with two graphs on two cores nodes waited for a third
of the time, and an operator for 16 s."""
_PAUSE_S = 20.0


class RealTime:
    """SCHED_RR for the threads of this process, as long as the processors are enough for it.

    Not SCHED_FIFO: threads of one priority take turns, so that none can wait for ever for a lock
    whose holder has no processor.

    Work at the same or a higher priority is all that such a process waits for. Where it waits for
    more than 5 % of the time (`look`, five times in a row, or 0.9 s in all), the real-time nodes
    together are too much for this machine and everything else on it, the recorder first, gets
    nothing: then the process returns to the normal policy, for 20 s the first time and twice as
    long each further time. On two idle cores, at SCHED_FIFO, one axis waited for 0 to 2 % and two
    axes in processes for 4 to 13 %, which left a recorder at normal priority 4 % of a core.

    For as long as a killed neighbour is still written to, at a price (`shared_memory`), or a topic
    of the loop is silent, the process returns to the normal policy as well: in a fault campaign
    the real-time nodes took 187 % of two cores, and a node that was started hardly got any.

    `words` is what the process runs under now, for diagnostics; `held` whether that is SCHED_RR.
    """

    def __init__(self) -> None:
        self.words = "normal"
        self.held = False
        self._priority = 0
        self._waited_s, self._looked_s = 0.0, 0.0
        self._crowded, self._crowded_s = 0, 0.0
        self._pause_s, self._again_s = _PAUSE_S, 0.0

    @property
    def wanted(self) -> bool:
        """Whether the process has SCHED_RR or takes it back as soon as it can."""
        return bool(self._priority)

    def take(self, priority: int, now_s: float) -> None:
        """Take SCHED_RR where it may be had.

        A process that was given another policy from outside (chrt, systemd) keeps it. Threads
        that start later inherit it. Without the right to it (`rtprio` in limits.conf) all stays
        as it is.
        """
        if not hasattr(os, "sched_setscheduler"):
            self.words = "normal (this system has no SCHED_RR)"
        elif os.sched_getscheduler(0) != os.SCHED_OTHER:
            self.words = "as set from outside"
        elif priority == 0:
            self.words = "normal (realtime_priority is 0)"
        else:
            try:
                _schedule(os.SCHED_RR, priority)
            except OSError as error:
                self.words = (f"normal (SCHED_RR {priority}: {error.strerror}; see rtprio in "
                              "limits.conf)")
            else:
                self.words, self.held = f"SCHED_RR {priority}", True
                self._priority, self._crowded, self._crowded_s = priority, 0, 0.0
                self._waited_s, self._looked_s = _waited_s(), now_s

    def look(self, now_s: float, broken: str = "") -> bool:
        """To be called once a second, with what is `broken` in the loop; True when `held` has
        changed."""
        if broken and self._priority:
            changed = self.held
            self.give_back()
            self.words = f"normal ({broken})"
            return changed
        if not self.held:
            if self._priority and now_s >= self._again_s:
                self.take(self._priority, now_s)
            return self.held
        if now_s <= self._looked_s:
            return False
        waited_s = _waited_s()
        more_s = waited_s - self._waited_s
        share = more_s / (now_s - self._looked_s)
        self._waited_s, self._looked_s = waited_s, now_s
        self._crowded = self._crowded + 1 if share > _CROWDED else 0
        self._crowded_s = self._crowded_s + more_s if share > _CROWDED else 0.0
        if self._crowded < _CROWDED_LOOKS and self._crowded_s < _CROWDED_S:
            return False
        self.give_back()
        self.words = (f"normal (SCHED_RR given back for {self._pause_s:g} s: it waited "
                      f"{share:.0%} of the time for other real-time work)")
        self._again_s = now_s + self._pause_s
        self._pause_s *= 2.0
        return True

    def give_back(self) -> None:
        """Return to the normal policy."""
        if self.held:
            self.words, self.held = "normal", False
            with contextlib.suppress(OSError):
                _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    for thread in (_SELF / "task").iterdir():
        with contextlib.suppress(ProcessLookupError, FileNotFoundError):  # it has ended
            sends = (thread / "comm").read_text("ascii", "replace").startswith(_SENDER)
            own = min(priority, _SENDER_PRIORITY) if sends else priority
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(own))


def _waited_s() -> float:
    """Return how long the main thread has waited for a processor (schedstat's second number)."""
    try:
        return int((_SELF / "schedstat").read_text("ascii").split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return 0.0
