"""What came lately, by its number: for messages that belong together and come one by one."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


class Recent(dict[int, T]):
    """The newest `most` entries; older ones are forgotten."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    def keep(self, number: int, entry: T) -> None:
        """Add an entry."""
        self[number] = entry
        if len(self) > self.most:
            del self[next(iter(self))]
