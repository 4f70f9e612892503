"""Lag of the sensor: the reading follows the position with a first-order lag.

    time_constant y' = x - y

On a linear stage it cannot be told from a lag of the amplifier: both stand in one chain from the
command to the reading.
Source: Franklin, Powell and Emami-Naeini, Feedback Control of Dynamic Systems, sec. 2.3; Fraden,
Handbook of Modern Sensors (2016), ch. 3.
"""

from __future__ import annotations

from dfm_stage.model.effect import Array, Effect, Equivalence, Parameter, Prior, Values


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Row 5 is the reading."""
    for j in range(a.shape[0]):
        a[first, j] = rows[5, j] / p[0]
        rows[5, j] = 0.0
    a[first, first] -= 1.0 / p[0]
    rows[5, first] = 1.0


EFFECT = Effect(
    name="sensor_lag",
    meaning="the reading follows the position with a first-order lag",
    equation="time_constant y' = x - y",
    source="Fraden, Handbook of Modern Sensors (2016), ch. 3",
    parameters=(Parameter("time_constant", 1e-3, "s", "1 / (2 pi bandwidth)", 1e-9, 10.0),),
    priors={"time_constant": Prior(1e-5, 1e-2)},
    side="sensor",
    parity="linear",
    memory=False,
    shown_by="excitation up to the sensor's corner frequency, and a current record",
    classes=(
        Equivalence(("sensor_lag", "amplifier_bandwidth"), "a linear stage without a current "
                    "record", "a current record, which the amplifier's lag is in, or a second "
                    "sensor"),
        Equivalence(("sensor_lag", "transport_delay"), "a band well below 1 / (2 pi "
                    "time_constant)", "excitation to higher frequencies"),
    ),
    states=(".",),
    stage="sensor",
    stamp=stamp,
    begins={"time_constant": ("sample_period", (0.1, 0.3, 1.0, 3.0, 10.0))},
    late="lag",
)
