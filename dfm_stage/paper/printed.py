"""What the paper prints, as data: values, units, places. Nothing here is computed.

Shewale, Razban, Deshmukh, Mulik and Patange, Characterization and System Identification of XY
Flexural Mechanism using Double Parallelogram Manipulator for High Precision Scanning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array


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
