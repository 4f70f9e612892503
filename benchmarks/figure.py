"""One measured figure, beside what was promised and what a peer did in the same run."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from dfm_stage.cli.bench_runs import judged

BarKind = Literal["at least", "at most", "between"]


@dataclass(frozen=True)
class Figure:
    """A figure as ./run bench prints and writes it.

    `bar` is what was promised, None where nothing was; `bar_kind` says on which side of it the
    value must lie ("between" goes from `bar` to `bar_to`). Without a kind the bar is shown and not
    judged. `how` is one line: what was done, how often, which statistic. `low` and `high` are an
    interval, and `interval` says which ("95 %", "5 runs"); `runs` is how often it was measured.
    """

    key: str
    value: float
    unit: str
    bar: float | None = None
    peer: str | None = None
    peer_value: float | None = None
    ratio: float | None = None
    how: str = ""
    bar_kind: BarKind | None = None
    bar_to: float | None = None
    low: float | None = None
    high: float | None = None
    interval: str | None = None
    runs: int = 1

    def __post_init__(self) -> None:
        if self.bar_kind == "between" and (self.bar is None or self.bar_to is None):
            raise ValueError(f"{self.key}: a bar 'between' needs bar and bar_to")

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None where there is nothing to judge. NaN meets no bar."""
        return judged(self.value, self.bar, self.bar_kind, self.bar_to)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, with `met`; a number that is not finite becomes null."""
        plain = {**asdict(self), "met": self.met}
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in plain.items()
        }
