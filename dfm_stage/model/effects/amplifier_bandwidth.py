"""Amplifier bandwidth: a first-order lag between command and drive.

    time_constant a' = s - a,      bandwidth = 1 / (2 pi time_constant)

In series with the base parameter amplifier_time_constant where that is given too.
Source: Franklin, Powell and Emami-Naeini, Feedback Control of Dynamic Systems, sec. 2.3;
Schmidt, Schitter and Rankers, The Design of High Performance Mechatronics (2014), ch. 6.
"""

from __future__ import annotations

from dfm_stage.model.effect import Array, Effect, Equivalence, Parameter, Prior, Values


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Row 2 is the drive."""
    for j in range(rows.shape[1]):
        a[first, j] = rows[2, j] / p[0]
        rows[2, j] = 0.0
    a[first, first] -= 1.0 / p[0]
    rows[2, first] = 1.0


EFFECT = Effect(
    name="amplifier_bandwidth",
    meaning="the amplifier follows its command with a first-order lag",
    equation="time_constant a' = s - a",
    source="Schmidt et al., The Design of High Performance Mechatronics (2014), ch. 6",
    parameters=(Parameter("time_constant", 1e-3, "s", "1 / (2 pi bandwidth)", 1e-9, 10.0),),
    priors={"time_constant": Prior(1e-5, 1e-2)},
    side="actuator",
    parity="linear",
    memory=False,
    shown_by="excitation up to the amplifier's corner frequency, or a current record",
    classes=(
        Equivalence(("amplifier_bandwidth", "transport_delay"),
                    "a band well below 1 / (2 pi time_constant)",
                    "excitation to higher frequencies"),
        Equivalence(("amplifier_bandwidth", "coil_inductance"), "no current record",
                    "a current record while the stage is blocked"),
    ),
    states=(".",),
    stage="amplifier",
    stamp=stamp,
    begins={"time_constant": ("sample_period", (0.1, 0.3, 1.0, 3.0, 10.0))},
    late="lag",
    retuned_by="amplifier_time_constant",
)
