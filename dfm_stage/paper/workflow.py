"""Everything the paper did, done on a stage, and the rows that come out of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.errors import DfmError
from dfm_stage.identification.characterisation import (
    EXPERIMENTS,
    DynamicTest,
    characterise,
)
from dfm_stage.identification.ring_down import RingDown
from dfm_stage.identification.static import StaticTest
from dfm_stage.identification.step_response import StepResponse
from dfm_stage.model import Model
from dfm_stage.paper import dynamics, lqr, pid, static, xy
from dfm_stage.paper.row import PRINTED, TABLE_1, Row
from dfm_stage.paper.stage import Stage
from dfm_stage.recording import Record
from dfm_stage.trajectory import Experiment

XY_EXPERIMENTS: Mapping[str, str] = {"x": "xy_static_x", "y": "xy_static_y"}
NAMES: tuple[str, ...] = (*(EXPERIMENTS[kind] for kind in ("static", "decay", "step",
                                                           "stepped_sine")),
                          *XY_EXPERIMENTS.values())
"""The experiments of config/experiments that are needed."""
STEPS = 17
Analysis = TypeVar("Analysis", StaticTest, RingDown, StepResponse, DynamicTest)


class PaperError(DfmError):
    """The comparison cannot be made with this model."""


@dataclass(frozen=True)
class Models:
    """The stages: one DFM, the DFM with the mode of sec. 5, the XY stage."""

    stage: Model
    two_mode: Model
    xy: Model

    def __post_init__(self) -> None:
        for model in (self.stage, self.two_mode):
            missing = [name for name in ("stiffness", "damping", "force_constant")
                       if not model.base.get(name, 0.0) > 0.0]
            if model.axes or missing:
                what = "has several axes" if model.axes else f"lacks {', '.join(missing)}"
                raise PaperError(f"model {model.name} {what}; the paper's stage is one axis with "
                                 "spring, damper and force constant")
        if set(self.xy.axes) != {"x", "y"}:
            raise PaperError(f"model {self.xy.name} must have the axes x and y for sec. 6")


@dataclass(frozen=True)
class Findings:
    """The records and what was found in them.

    `transient` is time (s), record, beam equation and identified G(s) after the step, (4, N).
    """

    records: Mapping[str, Record]
    static: StaticTest
    decay: RingDown
    step: StepResponse
    response: DynamicTest
    theory: dynamics.BeamTheory
    transient: Array
    pid: pid.PidTest
    two_mode: DynamicTest
    convergence: lqr.Convergence
    regulation: lqr.Regulation
    xy: xy.XYTest


@dataclass(frozen=True)
class Comparison:
    """All rows, in the order of the paper, and the findings for the figures."""

    rows: list[Row]
    findings: Findings
    source: str


def compare(stage: Stage, models: Models, experiments: Mapping[str, Experiment],
            step: Callable[[str], None] = lambda _: None, elements: int = 48) -> Comparison:
    """Do everything on `stage`; `experiments` holds those of `NAMES`, by name.

    `step` is called with the name of each of `STEPS` steps as it begins; `elements` per blade are
    used for the XY mechanism.

    Raises
    ------
    DfmError
        If an experiment fails or a record does not hold what it should.
    """
    model = models.stage
    records: dict[str, Record] = {}

    def run(kind: str, name: str, on: Model) -> Record:
        step(name.replace("_", " "))
        records[kind] = stage.run(experiments[name], on)
        return records[kind]

    def analysed(kind: str, what: type[Analysis], on: Model = model, name: str = "") -> Analysis:
        record = run(name or kind, EXPERIMENTS[kind], on)
        result = characterise(kind, record, force_constant=on.base["force_constant"])
        if not isinstance(result, what):
            raise PaperError("a characterisation gave another result than its own")
        return result

    largest = max(abs(load) for load, *_ in TABLE_1)
    experiments = {**experiments, "static": loaded_to(
        experiments["static"], "x", largest / model.base["force_constant"])}
    for axis, name in XY_EXPERIMENTS.items():
        experiments[name] = loaded_to(experiments[name], axis, PRINTED["xy.load"].value
                                      / models.xy.axis(axis).base["force_constant"])

    held, decay = analysed("static", StaticTest), analysed("decay", RingDown)
    stepped = analysed("step", StepResponse)
    response = analysed("stepped_sine", DynamicTest)
    tuned = pid.run_pid(stage, model, step)
    two = analysed("stepped_sine", DynamicTest, models.two_mode, "two_mode")
    convergence, gain = lqr.riccati()
    regulation = lqr.regulate(stage, models.two_mode, step)
    plane = {axis: run(name, name, models.xy) for axis, name in XY_EXPERIMENTS.items()}
    step("finite elements")
    theory = dynamics.beam_theory(model)
    found = Findings(records, held, decay, stepped, response, theory,
                     _transient(records["step"], stepped, response, theory, model), tuned, two,
                     convergence, regulation, xy.xy_test(models.xy, plane, elements))
    return Comparison(_rows(found, models, gain), found, stage.description)


def loaded_to(experiment: Experiment, axis: str, volts: float) -> Experiment:
    """Return a staircase whose largest level on `axis` is `volts`, the others in proportion.

    The files are for force constants of 1.082 and 5 N/V; the paper's loads are in newtons.
    """
    spec = experiment.axes[axis]
    signal = dict(spec.excitation or {})
    peak = float(np.max(np.abs(experiment.excitation(axis, 1e-3).voltage)))
    if signal.get("kind") != "steps" or peak == 0.0:
        raise PaperError(f"experiment {experiment.name}: axis {axis} must have an excitation of "
                         "kind steps")
    if math.isclose(peak, abs(volts), rel_tol=1e-6):
        return experiment
    for key in ("start_v", "step_v", "levels_v"):
        if key in signal:
            signal[key] = (np.asarray(signal[key]) * (volts / peak)).tolist()
    return replace(experiment, axes={**experiment.axes, axis: replace(spec, excitation=signal)})


def _rows(found: Findings, models: Models, gain: Array) -> list[Row]:
    model, fit = models.stage, found.response.constrained
    _, measured, theory, _ = found.transient
    difference = 100.0 * float(np.sqrt(np.mean((theory - measured)**2))) / abs(measured[-1])
    return [
        *static.table_rows(found.static, model),
        *static.quasistatic_rows(fit.natural_frequency.value, fit.damping_ratio.value,
                                 _fastest(found), found.static.travel_m),
        *static.geometry_rows(),
        *dynamics.damping_rows(found.decay, found.response),
        *dynamics.response_rows(found.response, found.static, found.decay,
                                found.records["stepped_sine"].axis(None), model),
        *static.mass_and_damping_rows(found.static.stiffness, fit.natural_frequency, fit.damping,
                                      model),
        *dynamics.step_rows(found.step, model.sample_period),
        *dynamics.theory_rows(found.theory, found.response, found.static, difference),
        *pid.pid_rows(found.pid, model),
        *lqr.plant_rows(found.two_mode), *lqr.riccati_rows(found.convergence),
        *lqr.error_dynamics_rows(gain), *lqr.regulation_rows(found.regulation),
        *xy.xy_rows(found.xy),
    ]


def _fastest(found: Findings) -> float:
    """Largest mean speed between two levels of the static test, m/s."""
    period = found.records["static"].sample_period
    return max(abs(b.position_m - a.position_m) / (max(b.start - a.stop, 1) * period)
               for a, b in pairwise(found.static.levels))


def _transient(record: Record, stepped: StepResponse, response: DynamicTest,
               theory: dynamics.BeamTheory, model: Model) -> Array:
    """Return time, record, beam equation and identified G(s) after the step (Fig. 8), (4, N)."""
    data = record.axis(None)
    fit = response.constrained
    late = fit.lag.value + fit.delay.value
    start = stepped.start
    time = record.time[start:] - record.time[start]
    volts = float(data.input[start] - data.input[start - 1])
    beam = theory.chain.step_response(time - late, volts * model.base["force_constant"],
                                      fit.damping_ratio.value)
    identified = volts * dynamics.unit_step(fit.plant.modes[0], np.maximum(time - late, 0.0))
    return np.array((time, data.position[start:] - stepped.initial.value, beam, identified))
