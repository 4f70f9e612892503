"""The base parameters of one axis: mass, spring, damper, coil, amplifier and encoder.

The plant they describe, with `u` the held command, `e` the drive and `y` the reading:

    s(t) = clip(u(t - delay))                          dead time, then the limit
    amplifier_time_constant * a' = s - a               amplifier
    (coil_inductance / coil_resistance) * e' = a - back_emf * x' - e        coil
    mass * x'' + damping * x' + stiffness * x = force_constant * e
    y = x + encoder_zero + noise, rounded to encoder_resolution

An absent parameter is zero: no spring, no dead time, no lag, no noise.
"""

from __future__ import annotations

from dfm_stage.model.parameter import Parameter

BASE_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("mass", 1.0, "kg", "moving mass", 1e-6, 1e6),
    Parameter("damping", 0.0, "N s/m", "viscous damping", 0.0, 1e9),
    Parameter("stiffness", 0.0, "N/m", "linear stiffness", 0.0, 1e12),
    Parameter("force_constant", 1.0, "N/V", "static force per unit of command", -1e6, 1e6),
    Parameter("amplifier_time_constant", 0.0, "s", "first-order lag of the amplifier", 0.0, 10.0),
    Parameter("delay", 0.0, "s", "dead time between command and amplifier", 0.0, 1.0),
    Parameter("encoder_resolution", 0.0, "m", "one encoder count; 0 = no rounding", 0.0, 1.0),
    Parameter("noise", 0.0, "m", "RMS of the white noise of the reading", 0.0, 1.0),
    Parameter("encoder_zero", 0.0, "m", "reading at the spring's rest position", -1e3, 1e3),
    Parameter("coil_resistance", 0.0, "ohm", "resistance of the coil", 0.0, 1e6),
    Parameter("coil_inductance", 0.0, "H", "inductance of the coil", 0.0, 1e3),
    Parameter("back_emf", 0.0, "V s/m", "voltage induced per unit of speed", 0.0, 1e6),
)

BASE_BY_NAME: dict[str, Parameter] = {p.name: p for p in BASE_PARAMETERS}
