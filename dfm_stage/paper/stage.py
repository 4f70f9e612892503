"""Where the paper's experiments are done: any stage that takes an experiment and gives a record.

`DirectStage` simulates the model at once, sample for sample what the node graph does in lockstep
(same plant, same controller, same seeds), without nodes, messages and bags.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dfm_stage.control import Pid, PidGains
from dfm_stage.model import Model, Plant, Simulator
from dfm_stage.recording import AxisRecord, Provenance, Record
from dfm_stage.trajectory import Experiment

Array = NDArray[np.float64]


class Stage(Protocol):
    """Runs an experiment on a model and returns what was recorded."""

    @property
    def description(self) -> str:
        """What the records come from, for the page."""

    def run(self, experiment: Experiment, model: Model) -> Record:
        """Return the record of every axis of the experiment."""


@dataclass(frozen=True)
class DirectStage:
    """The simulated stage without a node graph."""

    seed: int = 0

    @property
    def description(self) -> str:
        """What the records come from."""
        return "simulated directly, without the node graph"

    def run(self, experiment: Experiment, model: Model) -> Record:
        """Simulate every axis of the experiment."""
        period = model.sample_period
        axes, parameters = {}, {}
        for index, name in enumerate(experiment.axes):
            one = model.axis(name) if model.axes else model
            seed = self.seed + 1000 * index
            excitation = experiment.excitation(name, period)
            parameters[f"/stage/{name}/trajectory_generator"] = {
                "run": {"excitation": excitation.metadata()}}
            if experiment.mode == "open_loop":
                axes[name] = _open_loop(one, excitation.voltage, seed)
            else:
                gains = gains_of(experiment)
                reference = experiment.reference(name, period)
                axes[name] = _closed_loop(one, gains, reference, excitation.voltage, seed)
        count = round(experiment.duration_s / period)
        return Record(np.asarray(np.arange(count) * period), period, axes,
                      Provenance("direct simulation", "simulation", parameters=parameters))


def gains_of(experiment: Experiment) -> PidGains:
    """Return the PID gains that an experiment brings along."""
    given = experiment.controller if isinstance(experiment.controller, Mapping) else {}
    known = {field.name for field in fields(PidGains)}
    return PidGains.from_mapping({name: value for name, value in given.items() if name in known})


def _open_loop(model: Model, voltage: Array, seed: int) -> AxisRecord:
    result = Simulator(model).run(voltage)
    return AxisRecord(voltage, result.measured(seed), extra={"plant_position": result.position})


def _closed_loop(model: Model, gains: PidGains, reference: Any, excitation: Array,
                 seed: int) -> AxisRecord:
    plant, law = Plant(model, seed=seed), Pid(gains, model.sample_period)
    count = reference.position.size
    position, truth, volts = np.empty(count), np.empty(count), np.empty(count)
    limit = gains.output_limit_v
    for k, (r, v, a) in enumerate(zip(reference.position.tolist(), reference.velocity.tolist(),
                                      reference.acceleration.tolist(), strict=True)):
        sample = plant.sample()
        position[k], truth[k] = sample.reading_m, sample.position_m
        u = law.step(r, sample.reading_m, v, a) + float(excitation[k])
        volts[k] = min(limit, max(-limit, u))
        plant.advance(float(volts[k]))
    return AxisRecord(volts, position, reference=reference.position,
                      extra={"plant_position": truth})
