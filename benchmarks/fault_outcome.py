"""How faults ended, and what became of the messages: plain data that files keep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any


@dataclass(frozen=True)
class Fault:
    """What is done to which node, or to what else; `pause_s` is how long it lasts, s."""

    node: str
    kind: str
    pause_s: float = 0.0


@dataclass
class Outcome:
    """How one fault ended; `explained` is None where there was nothing to explain.

    `by_bag`: the witness was behind and had not seen that all was safe, or at work; the bag shows
    it, at that very time. `recovered_by_bag`: the same of the scan at work after the repair.
    `answered_s` is the longest that the operator waited for an answer.
    """

    fault: Fault
    safe: bool = False
    cut: bool = False
    explained: bool | None = None
    recovered: bool = False
    safe_s: float = 0.0
    took_s: float = 0.0
    answered_s: float = 0.0
    words: str = ""
    by_bag: bool = False
    recovered_by_bag: bool = False


@dataclass
class Tally:
    """What became of all faults, and of the messages.

    `deaf`: how often a fault cut off the witness itself, in whose process the operator sits. The
    bag shows that the graph went on, the fault is repeated on another. `travelled` is the furthest
    in all bags, m. `lost_at_kill` were published from 5 ms before their publisher was killed until
    it had ended, `lost_while_paused` while the recorder was stopped, and `lost_of_seconds` by a
    second node of a name, which the witness met before the recorder did; none are in `lost`.
    """

    outcomes: list[Outcome] = field(default_factory=list)
    witnessed: int = 0
    lost: int = 0
    lost_at_kill: int = 0
    lost_while_paused: int = 0
    lost_of_seconds: int = 0
    deaf: int = 0
    travelled: float = 0.0
    lost_words: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Tally:
        """Return what `to_dict` was made of; KeyError, TypeError where it is something else."""
        outcomes = [Outcome(**{**each, "fault": Fault(**each["fault"])})
                    for each in plain["outcomes"]]
        return cls(**{**plain, "outcomes": outcomes})

    @classmethod
    def of_all(cls, tallies: Sequence[Tally]) -> Tally:
        """Return several as one."""
        out = cls()
        for each in tallies:
            for entry in fields(cls):
                before, more = getattr(out, entry.name), getattr(each, entry.name)
                setattr(out, entry.name, max(before, more) if entry.name == "travelled"
                        else before + more)
        return out
