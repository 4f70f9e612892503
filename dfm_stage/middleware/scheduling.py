"""The real-time priority of a node's process: taken, watched, and given back."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

_SELF = Path("/proc/self")
LOOP_PRIORITY = 20
"""SCHED_RR priority of the nodes of the loop, where no other is set."""
_THREADS = "dds."
"""What the names of Fast DDS's threads begin with. They run at least at the priority of the loop,
also those of a recorder below it: one that could not empty its socket was sent everything again,
and got nothing done for 10 s."""
_SENDER, _SENDER_PRIORITY = "dds.asyn", 1
"""Fast DDS's thread for what did not go out at once, and the lowest real-time priority for it. It
tries the lock of a writer again and again without a pause: at the priority of the loop it kept the
processor from whoever held that lock. Without any, tools that started kept the processor from it
while it held a lock itself, and the loop waited for up to 41 ms."""
ROOM = 0.75
"""Share of the processors that real-time work may take. Recorders, tools and operators live on
the rest: with two graphs on two cores, which took 95 %, an operator waited for 16 s."""
_WAITS = 0.05
"""A process that waits less for a processor has no need to look at what the others take. On two
idle cores one axis waited for 0 to 2 % of the time."""
_MEASURED_S = 0.5
"""For how long the work is measured: /proc counts in steps of 10 ms."""
LOOK_S = 0.2
"""How often to look, s. What is too much is given back within 1 s, and a writer of the loop keeps
messages for 2 s at 1 kHz."""
_PAUSE_S = 20.0
_RESET_ON_FORK = 0x40000000


Process = tuple[int, int]
"""When it began, in ticks since the machine did, and its number."""


class RealTime:
    """SCHED_RR for the threads of this process, as long as the processors are enough for it.

    Not SCHED_FIFO: threads of one priority take turns, so that none can wait for ever for a lock
    whose holder has no processor.

    Work at the same or a higher priority is all that such a process waits for. Where it waits, and
    the real-time work of this machine takes more than `ROOM` of the processors, everything else on
    it gets too little, recorders first. Then the processes that began last return to the normal
    policy, so that those before them keep theirs: for 20 s the first time, and twice as long each
    further time.

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
        self._work: tuple[float, dict[Process, float]] | None = None
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
                self._priority, self._work = priority, None
                self._waited_s, self._looked_s = _waited_s(), now_s

    def look(self, now_s: float, broken: str = "") -> bool:
        """To be called each `LOOK_S`, with what is `broken` in the loop; True when `held` has
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
        taken = self._taken_up_to_here(now_s)
        if taken is None or taken <= ROOM * (os.cpu_count() or 1):
            return False
        self.give_back()
        self.words = (f"normal (SCHED_RR given back for {self._pause_s:g} s: with what began "
                      f"before it, it needs {taken:.1f} of {os.cpu_count()} processors)")
        self._again_s = now_s + self._pause_s
        self._pause_s *= 2.0
        return True

    def _taken_up_to_here(self, now_s: float) -> float | None:
        """Return how many processors the real-time processes take, from the first to begin to this
        one; None while this one hardly waits, or that is not measured yet."""
        waited_s = _waited_s()
        share = (waited_s - self._waited_s) / (now_s - self._looked_s)
        self._waited_s, self._looked_s = waited_s, now_s
        if share <= _WAITS:
            self._work = None
            return None
        work = _real_time_work()
        if self._work is None:
            self._work = now_s, work
            return None
        since_s, before = self._work
        if now_s - since_s < _MEASURED_S:
            return None
        self._work = now_s, work
        own = next((each for each in work if each[1] == os.getpid()), None)
        return None if own is None else sum(
            used_s - before.get(each, 0.0) for each, used_s in work.items()
            if each <= own) / (now_s - since_s)

    def give_back(self) -> None:
        """Return to the normal policy."""
        if self.held:
            self.words, self.held = "normal", False
            with contextlib.suppress(OSError):
                _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    for thread in (_SELF / "task").iterdir():
        with contextlib.suppress(ProcessLookupError, FileNotFoundError):  # it has ended
            name = (thread / "comm").read_text("ascii", "replace")
            own = priority if policy == os.SCHED_OTHER or not name.startswith(_THREADS) else (
                _SENDER_PRIORITY if name.startswith(_SENDER) else max(priority, LOOP_PRIORITY))
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(own))


def _waited_s() -> float:
    """Return how long the main thread has waited for a processor (schedstat's second number)."""
    try:
        return int((_SELF / "schedstat").read_text("ascii").split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return 0.0


def _real_time_work() -> dict[Process, float]:
    """Return how much processor time each real-time process of this machine has used, s."""
    work = {}
    ticks = os.sysconf("SC_CLK_TCK")
    for name in os.listdir("/proc"):
        if name.isdigit():
            with contextlib.suppress(OSError, ValueError, IndexError):  # it has ended
                if os.sched_getscheduler(int(name)) & ~_RESET_ON_FORK in {
                        os.SCHED_FIFO, os.SCHED_RR}:
                    # proc_pid_stat(5): utime, stime and starttime, after the name in brackets
                    fields = Path(f"/proc/{name}/stat").read_text("ascii", "replace").rpartition(
                        ")")[2].split()
                    work[int(fields[19]), int(name)] = (int(fields[11]) + int(fields[12])) / ticks
    return work
