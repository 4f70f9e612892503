"""One line of the comparison: the paper's value, ours, the deviation and the reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dfm_stage.identification.quantity import Quantity
from dfm_stage.paper.printed import PRINTED

CONTRADICTIONS = frozenset((
    "damping.factor", "damping.factor_as_printed", "encoder.resolution", "encoder.coarse",
    "lqr.damping_1", "lqr.end_weight", "lqr.error_sign", "lqr.gain_ratio", "lqr.modes",
    "lqr.solvable_moving", "lqr.state_names", "lqr.steady_error_plain", "pid.accuracy_sine",
    "quasistatic.limit", "response.natural", "xy.blocks", "xy.load", "zn.without_delay",
))
"""Rows in which the source contradicts itself, or what it says cannot be so."""


@dataclass(frozen=True)
class Row:
    """`paper` is None where the paper gives no number, `ours` where there is no finite one.

    `kind` says what stands under `paper`: "printed", "derived" (follows from printed numbers by
    arithmetic) or "none". `place` is where in the paper.
    """

    id: str
    what: str
    place: str
    paper: float | None
    ours: float | None
    unit: str
    reason: str
    kind: str = "printed"
    ci95: tuple[float, float] | None = None

    @property
    def deviation_percent(self) -> float | None:
        """Ours against the paper's, in percent of the paper's; None without either or with 0."""
        if self.paper is None or self.ours is None or self.paper == 0.0:
            return None
        return 100.0 * (self.ours - self.paper) / abs(self.paper)

    @property
    def contradicts(self) -> bool:
        """Whether the source contradicts itself here."""
        return self.id in CONTRADICTIONS

    def to_dict(self) -> dict[str, Any]:
        """As paper.json keeps it."""
        return {"id": self.id, "paper": self.paper, "ours": self.ours, "unit": self.unit,
                "deviation_percent": self.deviation_percent, "reason": self.reason,
                "what": self.what, "place": self.place, "kind": self.kind,
                "contradicts": self.contradicts,
                "ci95": list(self.ci95) if self.ci95 is not None else None}


def printed(name: str, ours: Quantity | float | None, reason: str) -> Row:
    """Return the row of a printed number."""
    entry = PRINTED[name]
    return _row(name, entry.what, entry.where, entry.value, ours, entry.unit, reason, "printed")


def derived(name: str, what: str, place: str, paper: float, ours: Quantity | float | None,
            unit: str, reason: str) -> Row:
    """Return the row of a number that follows from printed ones."""
    return _row(name, what, place, float(paper), ours, unit, reason, "derived")


def ours_only(name: str, what: str, place: str, ours: Quantity | float | None, unit: str,
              reason: str) -> Row:
    """Return the row of a number that the paper lacks."""
    return _row(name, what, place, None, ours, unit, reason, "none")


def _row(name: str, what: str, place: str, paper: float | None, ours: Quantity | float | None,
         unit: str, reason: str, kind: str) -> Row:
    """Return a row; what is not finite counts as not known."""
    value = ours.value if isinstance(ours, Quantity) else ours
    limits = ours.ci95 if isinstance(ours, Quantity) else None
    return Row(name, what, place, paper,
               float(value) if value is not None and math.isfinite(value) else None, unit, reason,
               kind, limits if limits is not None and all(map(math.isfinite, limits)) else None)


def as_json(rows: list[Row], extra: Mapping[str, Any]) -> dict[str, Any]:
    """Return paper.json."""
    return {"schema": 1, **extra, "rows": [row.to_dict() for row in rows]}
