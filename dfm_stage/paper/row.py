"""What the paper prints, as data, and one line of the comparison with it.

Shewale, Razban, Deshmukh, Mulik and Patange, Characterization and System Identification of XY
Flexural Mechanism using Double Parallelogram Manipulator for High Precision Scanning. `PRINTED`
holds values, units and places as they stand there; a `Row` is such a value, ours, the deviation
and the reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.quantity import Quantity


@dataclass(frozen=True)
class Printed:
    """One number in SI units, what it is and where it stands."""

    value: float
    unit: str
    what: str
    where: str


PRINTED = {name: Printed(value, unit, what, where) for name, value, unit, what, where in (
    ("table1.theory", 650.0, "N/m", "stiffness, theory", "Table 1"),
    ("table1.error", 1.0, "%", "largest error of theory against experiment", "sec. 3A"),
    ("damping.decrement", 0.218308, "", "logarithmic decrement", "sec. 3B"),
    ("damping.factor", 0.034785, "", "damping factor", "sec. 3B"),
    ("response.amplitude", 0.08, "V", "amplitude of the sine", "sec. 3C"),
    ("response.low", 1.0, "Hz", "lowest frequency", "sec. 3C"),
    ("response.high", 70.0, "Hz", "highest frequency", "sec. 3C"),
    ("response.natural", 24.51, "rad/s", "natural frequency", "sec. 3C"),
    ("eq3.numerator", 1.0, "m/V/s^2", "numerator of G(s)", "Eq. 3"),
    ("eq3.damping", 1.705, "1/s", "damping coefficient of G(s)", "Eq. 3"),
    ("eq3.stiffness", 600.7, "1/s^2", "stiffness coefficient of G(s)", "Eq. 3"),
    ("theory.agreement", 5.0, "%", "agreement of theory and experiment", "abstract"),
    ("pid.accuracy", 5e-6, "m", "positioning accuracy under PID", "abstract"),
    ("encoder.resolution", 50e-6, "m", "positioning resolution of the encoder", "sec. 3"),
    ("quasistatic.limit", 3.0, "", "frequency of a static test over the natural one", "sec. 3A"),
    ("xy.load", 35.0, "N", "largest load", "sec. 6"),
    ("xy.travel", 7.5e-3, "m", "largest displacement", "sec. 6"),
    ("xy.increment", 0.025, "kg", "increment of the load", "sec. 6"),
    ("xy.gauge", 10e-6, "m", "resolution of the dial gauges", "sec. 6"),
    ("xy.range", 25e-3, "m", "range of the dial gauges", "sec. 6"),
    ("xy.cross", 25e-6, "m", "motion in X while Y is driven", "sec. 6"),
)}

# Table 1: load (N), deflection in theory and in practice (mm), stiffness in practice (N/mm),
# error (%)
TABLE_1: tuple[tuple[float, float, float, float, float], ...] = (
    (-5.0, -7.692, -7.73, 0.6468, 0.49),
    (-2.5, -3.846, -3.874, 0.6453, 0.724),
    (2.5, 3.846, 3.877, 0.6448, 0.802),
    (5.0, 7.692, 7.711, 0.6484, 0.243),
)

# Sec. 5, as printed.
LQR_A: Array = np.array([[0.0, -1.07e4, 0.0, -5.8e6],
                         [1.0, 0.0, 0.0, 0.0],
                         [0.0, 1.0, 0.0, 0.0],
                         [0.0, 0.0, 1.0, 0.0]])
LQR_B: Array = np.array([1.0, 0.0, 0.0, 0.0])
LQR_C: Array = np.array([0.0, 58.67, 0.0, 5.55e5])

STANDARD_GRAVITY = 9.80665

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
    value, limits = (ours.value, ours.ci95) if isinstance(ours, Quantity) else (ours, None)
    return Row(name, what, place, paper,
               float(value) if value is not None and math.isfinite(value) else None, unit, reason,
               kind, limits if limits is not None and all(map(math.isfinite, limits)) else None)


def as_json(rows: list[Row], extra: Mapping[str, Any]) -> dict[str, Any]:
    """Return paper.json."""
    return {"schema": 1, **extra, "rows": [row.to_dict() for row in rows]}
