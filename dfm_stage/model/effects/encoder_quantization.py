"""Encoder quantisation: the reading comes in steps.

    y = step round((x + noise)/step)

The simulated `output` is its mean over the noise, a staircase whose edges the noise rounds off;
`measured` rounds. It acts before the counting of encoder_resolution where both are given.
Source: Widrow and Kollar, Quantization Noise (2008).
"""

from __future__ import annotations

import math

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def encode(reading: float, dither: float, p: Values) -> float:
    """Mean of the rounded reading with normal noise of RMS `dither`, m."""
    step = p[0]
    if dither > step:
        return reading
    if dither <= 0.0:
        return step * math.floor(reading / step + 0.5)
    first = math.floor((reading - 7.0 * dither) / step + 0.5)
    last = math.floor((reading + 7.0 * dither) / step + 0.5)
    mean = float(first)
    for k in range(int(last - first)):
        edge = (first + k + 0.5) * step
        mean += 0.5 * math.erfc((edge - reading) / (math.sqrt(2.0) * dither))
    return step * mean


EFFECT = Effect(
    name="encoder_quantization",
    meaning="the encoder counts in steps that are seen",
    equation="y = step round(x/step)",
    source="Widrow and Kollar, Quantization Noise (2008)",
    parameters=(Parameter("step", 1e-6, "m", "one step of the reading", 1e-12, 1.0),),
    priors={"step": Prior(1e-9, 1e-4)},
    side="sensor",
    parity="none",
    memory=False,
    shown_by="slow motion across many steps, little noise",
    classes=(Equivalence(("encoder_quantization", "noise"),
                         "fast motion or noise above half a step",
                         "slow motion, less noise, or the set of values that occur"),),
    encode=encode,
    begins={"step": ("steps", (1.0,))},
    searched=True,
)
