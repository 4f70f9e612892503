"""Where the paper's experiments are done: any stage that takes an experiment and gives a record.

`DirectStage` simulates the model at once, sample for sample what the node graph does in lockstep
(same plant, same controller, same seeds), without nodes, messages and bags.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.control import OPEN_LOOP, Law, LqrSpec, PidGains, law_of
from dfm_stage.model import Model, Plant, Simulator
from dfm_stage.recording import AxisRecord, Provenance, Record
from dfm_stage.trajectory import Experiment, Reference, load_experiment
from dfm_stage.trajectory.limits import uncoupled


class Stage(Protocol):
    """Runs an experiment on a model and returns what was recorded."""

    @property
    def description(self) -> str:
        """What the records come from, for the page."""

    def run(self, experiment: Experiment, model: Model, design: Model | None = None) -> Record:
        """Return the record of every axis; an LQR is designed on `design`, else on `model`."""


def true_position(record: Record) -> Array:
    """Return where the stage of a record with one axis was, (N,), m, or what was measured."""
    axis = record.axis(None)
    return axis.extra.get("plant_position", axis.position)


def reference_of(record: Record) -> Array:
    """Return the reference of a record with one axis, (N,), m; zeros where it has none."""
    reference = record.axis(None).reference
    return np.zeros(len(record)) if reference is None else reference


def tracking_error(record: Record) -> Array:
    """Return true position less reference, (N,), m."""
    return np.asarray(true_position(record) - reference_of(record))


def closed_loop(name: str, reference: Mapping[str, Any], duration_s: float,
                settings: PidGains | LqrSpec) -> Experiment:
    """Return an experiment under PID or LQR, whichever the settings are for."""
    return load_experiment({
        "name": name, "mode": "pid" if isinstance(settings, PidGains) else "lqr",
        "duration_s": duration_s, "axes": {"x": {"reference": dict(reference)}},
        "controller": settings.to_dict()})


@dataclass(frozen=True)
class DirectStage:
    """The simulated stage without a node graph."""

    seed: int = 0

    @property
    def description(self) -> str:
        """What the records come from."""
        return "simulated directly, without the node graph"

    def run(self, experiment: Experiment, model: Model, design: Model | None = None) -> Record:
        """Simulate every axis of the experiment."""
        period = model.sample_period
        axes, parameters = {}, {}
        for index, name in enumerate(experiment.axes):
            one = model.axis(name) if model.axes else model
            other = _neighbour(experiment, model, name)
            seed = self.seed + 1000 * index
            excitation = experiment.excitation(name, period)
            parameters[f"/stage/{name}/trajectory_generator"] = {
                "run": {"excitation": excitation.metadata()}}
            if experiment.mode == OPEN_LOOP:
                found = Simulator(one).run(excitation.voltage, other=other)
                axes[name] = AxisRecord(excitation.voltage, found.measured(seed),
                                        extra={"plant_position": found.position})
            else:
                reference = experiment.reference(name, period)
                given = experiment.controller if isinstance(experiment.controller, Mapping) else {}
                law, _ = law_of({**given, "mode": experiment.mode}, design or one)
                axes[name] = _closed_loop(one, law, reference, excitation.voltage, seed)
        time = np.asarray(np.arange(round(experiment.duration_s / period)) * period)
        return Record(time, period, axes,
                      Provenance("direct simulation", "simulation", parameters=parameters))


def _neighbour(experiment: Experiment, model: Model, name: str) -> Array | None:
    """Return the position of the axis that acts on `name`, itself moved by its input alone."""
    other = next(iter(model.coupling.get(name, {})), None)
    if other is None:
        return None
    voltage = (experiment.excitation(other, model.sample_period).voltage
               if other in experiment.axes else np.zeros(round(experiment.duration_s
                                                               / model.sample_period)))
    return Simulator(uncoupled(model.axis(other))).run(voltage).position


def _closed_loop(model: Model, law: Law, reference: Reference, excitation: Array,
                 seed: int) -> AxisRecord:
    plant = Plant(model, seed=seed)
    count = reference.position.size
    position, truth, volts = np.empty(count), np.empty(count), np.empty(count)
    for k, (r, v, a) in enumerate(zip(reference.position.tolist(), reference.velocity.tolist(),
                                      reference.acceleration.tolist(), strict=True)):
        sample = plant.sample()
        position[k], truth[k] = sample.reading_m, sample.position_m
        volts[k] = law.step(r, sample.reading_m, v, a) + float(excitation[k])
        plant.advance(float(volts[k]))
    return AxisRecord(volts, position, reference=reference.position,
                      extra={"plant_position": truth})
