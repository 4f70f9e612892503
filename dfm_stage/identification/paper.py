"""The transfer function printed in the paper, to compare with.

Eq. 3 of Shewale, Razban, Deshmukh, Mulik and Patange: G(s) = 1 / (s^2 + 1.705 s + 600.7), volts
to position; its unit numerator is read as metres per volt and second squared (force constant over
moving mass).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dfm_stage.identification.plant import Mode
from dfm_stage.identification.quantity import Quantity

PAPER_MODE = Mode(numerator=1.0, damping=1.705, stiffness=600.7)
OTHER_STAGE = 2.0
"""Ratio of a coefficient to the paper's, or its inverse, above which the stage is another one."""


@dataclass(frozen=True)
class PaperRow:
    """One coefficient of G(s): the paper's and ours with its interval."""

    name: str
    symbol: str
    paper: float
    ours: Quantity

    @property
    def deviation_percent(self) -> float:
        """How far ours is from the paper's, in percent of the paper's."""
        return 100.0 * (self.ours.value - self.paper) / self.paper

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.name, "symbol": self.symbol, "paper": self.paper,
                "ours": self.ours.to_dict(), "deviation_percent": self.deviation_percent}


def compare_with_paper(numerator: Quantity, damping: Quantity,
                       stiffness: Quantity) -> tuple[PaperRow, ...]:
    """Set the three coefficients of numerator / (s^2 + damping s + stiffness) beside Eq. 3; none
    where one of them says that it is another stage."""
    rows = (PaperRow("numerator", "b", PAPER_MODE.numerator, numerator),
            PaperRow("damping coefficient", "c/m", PAPER_MODE.damping, damping),
            PaperRow("stiffness coefficient", "k/m", PAPER_MODE.stiffness, stiffness))
    same = all(1.0 / OTHER_STAGE <= row.ours.value / row.paper <= OTHER_STAGE for row in rows)
    return rows if same else ()
