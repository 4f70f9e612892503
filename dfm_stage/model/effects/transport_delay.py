"""Transport delay: dead time of computation, bus and amplifier.

    s(t) = u(t - delay)

Any fraction of a sample; added to the base parameter delay. The held input changes at
t_k + delay, and the simulator propagates the pieces before and after exactly.
Source: Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., sec. 4.3.4.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior

EFFECT = Effect(
    name="transport_delay",
    meaning="the command arrives late",
    equation="s(t) = u(t - delay)",
    source="Franklin, Powell and Workman, Digital Control of Dynamic Systems, sec. 4.3.4",
    parameters=(Parameter("delay", 0.0, "s", "dead time", 0.0, 1.0),),
    priors={"delay": Prior(1e-6, 1e-2)},
    side="actuator",
    parity="linear",
    memory=False,
    shown_by="excitation to high frequencies, where the phase is the larger",
    classes=(Equivalence(("transport_delay", "amplifier_bandwidth"),
                         "a band well below the amplifier's corner",
                         "excitation to higher frequencies"),),
    adds_to="delay",
    begins={"delay": ("sample_period", (0.02, 0.3, 1.0, 3.0))},
    late="delay",
)
