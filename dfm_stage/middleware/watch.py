"""What a node keeps of what it heard, and what it notices once a second: topics that stopped, and
its own standstill."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

SILENT_S = 1.0
HELD_UP_S = 0.5
T = TypeVar("T")


class Recent(dict[int, T]):
    """The newest `most` entries by their number, for messages that belong together and come one by
    one; older ones are forgotten."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    def keep(self, number: int, entry: T) -> None:
        """Add an entry."""
        self[number] = entry
        if len(self) > self.most:
            del self[next(iter(self))]


class Notices(dict[str, str]):
    """What there is to say now, by what it is about."""

    def put(self, about: str, words: str) -> bool:
        """Say it from now on, or where `words` is empty no longer; return whether it is new."""
        new = bool(words) and about not in self
        if words:
            self[about] = words
        else:
            self.pop(about, None)
        return new


class Counting(Protocol):
    """What counts the messages that came."""

    received: int


class Input:
    """What came on one loop topic."""

    def __init__(self, name: str, publisher: str, receiver: Counting) -> None:
        self.name = name
        self.publisher = publisher
        self._receiver = receiver
        self._before = 0
        self._silent_since = 0.0

    def silent_s(self, now: float) -> float:
        """Return for how long nothing has come, s; 0 before the first message."""
        received = self._receiver.received
        if received != self._before or not received:
            self._before, self._silent_since = received, now
        return now - self._silent_since


class Watch:
    """Puts words into `warnings` and takes them out again; `silent` is whether a topic stopped.

    `count` and `log` are called when something begins; times are on one steady clock, s.
    """

    def __init__(self, warnings: Notices, count: Callable[[str], None],
                 log: Callable[[str], object], now: float) -> None:
        self.inputs: list[Input] = []
        self._warnings = warnings
        self._count = count
        self._log = log
        self._last_look = now
        self.silent = False

    def look(self, now: float) -> None:
        """Look once, a second after the last time."""
        late, self._last_look = now - self._last_look - 1.0, now
        held_up = late > HELD_UP_S
        self._warnings.put("held up",
                           f"this process stood still for {late:.1f} s" if held_up else "")
        if held_up:
            self._count("held_up")
        self.silent = False
        for each in self.inputs:
            silent, source = each.silent_s(now), f"{each.name} from {each.publisher}"
            lost = silent >= SILENT_S
            self.silent |= lost
            if self._warnings.put(f"silent {each.name}",
                                  f"nothing on {source} for {silent:.0f} s" if lost else ""):
                self._count("inputs_lost")
                self._log(f"nothing more on {source}")
