"""Sec. 3B and 3C: damping, frequency response, Eq. 3, and the beam equation beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.characterisation import DynamicTest
from dfm_stage.identification.paper import PAPER_MODE
from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.ring_down import (
    RingDown,
    damping_ratio,
    damping_ratio_as_printed,
)
from dfm_stage.identification.static import StaticTest
from dfm_stage.identification.step_response import StepResponse, step_response
from dfm_stage.model import Model
from dfm_stage.model.beam import BladeChain, manipulator_chain
from dfm_stage.model.flexure import chosen_manipulator
from dfm_stage.paper.row import PRINTED, Row, derived, ours_only, printed
from dfm_stage.recording import AxisRecord

INTERMEDIATE_KG = 0.15
"""Mass of the intermediate stage: chosen, the paper does not print it."""


def damping_rows(decay: RingDown, test: DynamicTest) -> list[Row]:
    """Return decrement and damping factor by both forms of Eq. 2."""
    d = PRINTED["damping.decrement"].value
    eq3 = PRINTED["eq3.damping"].value / (2.0 * PRINTED["response.natural"].value)
    return [
        printed("damping.decrement", decay.decrement, f"over {decay.cycles:g} cycles of the free "
                "decay, every extreme; the model's damping is that of Eq. 3, whose decrement is "
                f"{2.0 * math.pi * eq3 / math.sqrt(1.0 - eq3**2):.6f}"),
        printed("damping.factor", decay.damping, "by the standard relation; the printed factor "
                "follows from the printed decrement by neither form of Eq. 2, but is that of "
                "Eq. 3"),
        derived("damping.factor_as_printed", "damping factor by Eq. 2 as printed, "
                "sqrt(4 pi^2 - d^2)", "Eq. 2", damping_ratio_as_printed(d),
                decay.damping_as_printed, "", "the sign under the root is wrong in print"),
        derived("damping.factor_standard", "damping factor by the standard relation, "
                "sqrt(4 pi^2 + d^2)", "Eq. 2", damping_ratio(d), decay.damping, "",
                f"from the printed decrement {d:g}"),
        derived("damping.factor_eq3", "damping factor of Eq. 3", "Eq. 3", eq3,
                test.constrained.damping_ratio, "", "from the fitted transfer function"),
        derived("damping.decrement_two_extremes", "decrement by Eq. 1 from two extremes", "Eq. 1",
                d, decay.two_point, "", "ln(X0/Xn)/n between the first and the last whole "
                "cycle"),
    ]


def response_rows(test: DynamicTest, static: StaticTest, decay: RingDown, data: AxisRecord,
                  model: Model) -> list[Row]:
    """Return excitation, natural frequency, Eq. 3 and what follows from them."""
    fit, measured = test.constrained, test.response
    frequency = measured.frequency_hz
    omega, k3 = PRINTED["response.natural"].value, PRINTED["eq3.stiffness"].value
    q_paper = omega / PRINTED["eq3.damping"].value
    amplitude = float(np.max(np.abs(data.input)))
    size = np.abs(measured.response)
    top = int(np.argmax(size))
    peak = amplitude * float(size[top])
    spread = 1.96 * amplitude * math.sqrt(0.5 * float(measured.variance[top]))
    mass = PRINTED["table1.theory"].value / omega**2
    ours_mass = static.stiffness.value / fit.natural_frequency.value**2
    force = fit.numerator.value * ours_mass
    force_spread = fit.numerator.half_width * ours_mass
    ratio = fit.damping_ratio
    quality = 1.0 / (2.0 * ratio.value)
    fitted = "constrained minimisation of the relative misfit of the stepped sine"
    return [
        printed("response.amplitude", amplitude, "largest voltage in the record"),
        printed("response.low", float(frequency[0]), "lowest frequency in the record"),
        printed("response.high", float(frequency[-1]), "highest frequency in the record"),
        printed("response.natural", fit.natural_frequency, f"{fitted}; the paper calls it "
                "'the highest frequency', which it is not: the resonance at 3.9 Hz of 1 to 70 Hz"),
        derived("response.natural_decay", "natural frequency from the free decay", "sec. 3B",
                omega, decay.natural_frequency, "rad/s", "spacing of the extremes"),
        printed("eq3.numerator", fit.numerator, f"{fitted}; read as force constant over mass, "
                "the paper gives no unit"),
        printed("eq3.damping", fit.damping, f"{fitted}; the model's is "
                f"{model.base.get('damping', 0.0) / model.base['mass']:.4f} 1/s"),
        printed("eq3.stiffness", fit.stiffness, f"{fitted}; the model's is "
                f"{model.base.get('stiffness', 0.0) / model.base['mass']:.2f} 1/s^2; 24.51^2 is "
                f"{omega**2:.2f}"),
        derived("derived.force_constant", "force constant, numerator times mass", "Eq. 3", mass,
                Quantity(force, "N/V", (force - force_spread, force + force_spread)), "N/V",
                "unit numerator read in m/V; the amplifier's gain is in it"),
        derived("derived.static_gain", "static gain of G(s)", "Eq. 3", 1.0 / k3, fit.static_gain,
                "m/V", "fitted numerator over fitted stiffness coefficient"),
        derived("derived.quality", "quality factor", "Eq. 3", q_paper,
                Quantity(quality, "", (1.0 / (2.0 * (ratio.value + ratio.half_width)),
                                       1.0 / (2.0 * (ratio.value - ratio.half_width)))), "",
                "one over twice the damping ratio"),
        derived("derived.resonance_amplitude", "motion at resonance under 0.08 V", "sec. 3C",
                PRINTED["response.amplitude"].value * q_paper / k3,
                Quantity(peak, "m", (peak - spread, peak + spread)), "m",
                f"largest measured, at {frequency[top]:g} Hz, the nearest frequency of the test; "
                "well inside the travel of 7.7 mm"),
        ours_only("response.lag", "amplifier lag, identified", "sec. 3C", fit.lag, "s",
                  "Eq. 3 has none, a real loop does"),
        ours_only("response.delay", "delay, identified", "sec. 3C", fit.delay, "s",
                  "Eq. 3 has none, a real loop does"),
        ours_only("response.likelihood", "natural frequency by maximum likelihood instead",
                  "sec. 3C", Quantity(2.0 * math.pi * test.likely.natural_frequency_hz().value,
                                      "rad/s"), "rad/s", "weights by noise, no constraints: a "
                  "cross-check of the minimisation"),
    ]


@dataclass(frozen=True)
class BeamTheory:
    """The beam equation's stage: chosen geometry, the model's mass; modes and answer to a step."""

    chain: BladeChain
    stiffness_n_m: float
    omega: float
    second_hz: float


def beam_theory(model: Model) -> BeamTheory:
    """Return the theory for the stage that weighs what the model does.

    The geometry is the chosen one of 0.65 N/mm, whatever the model's stiffness. Of the moving
    mass, the blades and the intermediate stage take their share by the static shape (Rayleigh);
    the rest is the stage.
    """
    manipulator = chosen_manipulator()
    blade = manipulator.blade.mass_per_length * manipulator.blade.length_m
    square, mean = 13.0 / 35.0, 0.5
    share = 2.0 * blade * 0.25 * square + 2.0 * blade * 0.25 * (1.0 + 2.0 * mean + square)
    chain = manipulator_chain(manipulator, model.base["mass"] - 0.25 * INTERMEDIATE_KG - share,
                              INTERMEDIATE_KG)
    first, second = chain.modes(2)
    return BeamTheory(chain, manipulator.stiffness_n_m(), first.omega,
                      second.frequency_hz)


def theory_rows(theory: BeamTheory, test: DynamicTest, static: StaticTest,
                difference_percent: float) -> list[Row]:
    """Return the beam equation against the identified stage, and the 5 % claim."""
    off_omega = 100.0 * (theory.omega / test.constrained.natural_frequency.value - 1.0)
    off_k = 100.0 * (theory.stiffness_n_m / static.stiffness.value - 1.0)
    worst = max(abs(off_omega), abs(off_k), difference_percent)
    beam = ("Euler-Bernoulli equation, what the paper calls the fourth order wave equation; "
            "geometry chosen, mass weighed")
    return [
        derived("theory.frequency", "natural frequency from the beam equation", "sec. 3C, 7",
                PRINTED["response.natural"].value, theory.omega, "rad/s", beam),
        ours_only("theory.frequency_error", "its deviation from the identified one", "sec. 7",
                  off_omega, "%", "the mass is the model's own, so this tests stiffness and "
                  "beam equation"),
        ours_only("theory.stiffness_error", "deviation of the theory's stiffness", "sec. 3A",
                  off_k, "%", "against the static test"),
        ours_only("theory.step_error", "difference of the step responses, RMS over the step",
                  "Fig. 8", difference_percent, "%", "beam equation with the identified damping, "
                  "lag and delay against the record"),
        printed("theory.agreement", worst, "largest of frequency, stiffness and step response; "
                "the paper's own Table 1 gives 0.2 to 0.8 %, so 5 % must be the dynamics"),
        ours_only("theory.second_mode", "second mode of the beam equation", "sec. 3C",
                  theory.second_hz, "Hz", f"the intermediate stage swinging, {INTERMEDIATE_KG:g} "
                  "kg chosen; the paper's second model has 16 Hz"),
    ]


def unit_step(mode: Mode, time_s: Array) -> Array:
    """Return the answer (N,) of an underdamped mode to a unit step of its input at time zero."""
    rate, damped = 0.5 * mode.damping, math.sqrt(mode.stiffness - 0.25 * mode.damping**2)
    return np.asarray(mode.numerator / mode.stiffness * (1.0 - np.exp(-rate * time_s) * (
        np.cos(damped * time_s) + rate / damped * np.sin(damped * time_s))))


def step_rows(ours: StepResponse, sample_period: float) -> list[Row]:
    """Return rise and settling time and overshoot beside those of Eq. 3."""
    time = np.asarray(np.arange(round(20.0 / sample_period)) * sample_period)
    there = step_response(np.zeros(time.size), unit_step(PAPER_MODE, time), sample_period,
                          start=0, final=LinearPlant((PAPER_MODE,)).static_gain)
    reason = ("the paper names it as a result of the transient test and prints no number; this is "
              "Eq. 3's; ours counts from the command and so has delay and lag in it")
    return [
        derived("step.rise_time", "rise time, 10 to 90 %", "sec. 3B", there.rise_time.value,
                ours.rise_time, "s", reason),
        derived("step.overshoot", "overshoot", "sec. 3B", there.overshoot.value, ours.overshoot,
                "%", reason),
        derived("step.settling_time", "settling time, 2 %", "sec. 3B",
                there.settling_time.value, ours.settling_time, "s", reason),
    ]
