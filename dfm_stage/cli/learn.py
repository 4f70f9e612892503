"""learn: repeat a movement on the node graph, and correct its input after each pass."""

from __future__ import annotations

import argparse
import functools
import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.cli.command import command, new_folder, option, write_json
from dfm_stage.cli.graph_run import run_on_graph
from dfm_stage.cli.learn_report import learning_page
from dfm_stage.cli.progress import Progress
from dfm_stage.cli.tune import identified
from dfm_stage.control import (
    ControlError,
    Learner,
    PidGains,
    design_learning,
    inverse_of,
    neighbours,
    parameter_text,
    pid_with_margin,
    sample_model,
    write_text,
)
from dfm_stage.control.stage import closed_loop_poles, controller_response
from dfm_stage.errors import CheckFailedError, DfmError
from dfm_stage.model import Model, load_model
from dfm_stage.share import door, find_experiment
from dfm_stage.trajectory import Experiment, Reference, load_experiment

REST_M_S = 1e-9
OPTIONS = (
    option("experiment", nargs="?", default="scan_repeat", metavar="EXPERIMENT",
           help="a name in config/experiments or a YAML file whose references start and end at "
           "rest in the same place (default: %(default)s)"),
    option("--model", metavar="FILE",
           help="model.yaml to design on, a path or a name in config/models"),
    option("--bag", metavar="BAG", help="identify that model from a bag first"),
    option("--plant", metavar="FILE",
           help="model the simulated stage runs (default: that of the experiment, else --model)"),
    option("--out", default="learned", metavar="DIR",
           help="new folder for signal, bag and report (default: %(default)s)"),
    option("--passes", type=int, default=25, metavar="N", help="default: %(default)s"),
    option("--gain", type=float, default=0.5, metavar="G",
           help="share of the error taken off per pass, 0 to 1 (default: %(default)s)"),
    option("--cutoff", type=float, metavar="HZ",
           help="learn up to here (default: an eighth of the sample rate)"),
    option("--uncertainty", type=float, default=0.1, metavar="SHARE",
           help="by how much each parameter of the model may be wrong; the passes must converge "
           "for all of that (default: %(default)s)"),
    option("--margin", type=float, default=0.5, metavar="M",
           help="modulus margin of the feedback (default: %(default)s)"),
    option("--no-inverse", action="store_true",
           help="start from nothing instead of the model's inverse"),
    option("--replay", metavar="DIR", help="run what was learnt there once more"),
    option("--seed", type=int, default=0, help="noise of the plant (default: 0)"),
    option("--json", action="store_true", help="print learning.json"),
)
EPILOG = """examples:
  ./run learn scan_repeat --model raster_bench --out learned
  ./run learn scan_repeat --bag bags/multisine --plant raster_bench --out learned
  ./run learn --replay learned --out again
The signal is in learned/<axis>_learned.csv and attached to learned/bag; learned/learned.yaml is an
experiment that replays it with the gains it was learnt with.
"""


class NotConvergingError(CheckFailedError):
    """The convergence condition does not hold; no pass was run."""


@dataclass
class Axis:
    """What one axis learns: its design model, feedback, reference and learner."""

    name: str
    model: Model
    gains: PidGains
    reference: Reference
    learner: Learner
    error: Array
    first_error: Array

    def line_rms(self) -> tuple[float, float]:
        """RMS of the error where the reference is steady, m: of the first and the last pass."""
        steady = self.reference.steady
        return _rms(self.first_error[steady]), _rms(self.error[steady])


@command("learn", __doc__, EPILOG, OPTIONS, lambda _: True)
def main(options: argparse.Namespace) -> int:
    """Learn; 0 when done, 1 if it does not converge, 2 with one line if unusable."""
    result = _replay(options) if options.replay else _learn(options)
    if options.json:
        print(json.dumps(result, indent=1))
    return 0


def _learn(options: argparse.Namespace) -> dict[str, Any]:
    _check(options)
    experiment = load_experiment(find_experiment(options.experiment))
    out = new_folder(options.out)
    try:
        name = options.model or experiment.model
        if options.bag:
            if len(experiment.axes) > 1:
                raise DfmError("--bag identifies one axis; give the model of both with --model")
            name = identified(options.bag, out / "identify", model=options.model)
        if not name:
            raise DfmError("no model: give --model FILE, or --bag BAG to identify one")
        plant = options.plant or experiment.model or name
        axes = [_design(axis, experiment, name, options) for axis in experiment.axes]
        for axis in axes:
            print(f"{axis.name}: convergence holds: the error shrinks to at most "
                  f"{axis.learner.design.contraction:.2f} per pass up to "
                  f"{axis.learner.design.cutoff_hz:g} Hz, with every parameter "
                  f"{options.uncertainty:.0%} off", file=sys.stderr)
        _write_inputs(axes, experiment, plant, out)
        _passes(axes, experiment, plant, out, options)
    except BaseException:
        if not (out / "bag").exists():
            shutil.rmtree(out, ignore_errors=True)
        raise
    return _finish(axes, out, options)


def _check(options: argparse.Namespace) -> None:
    for name, usable, wanted in (
            ("passes", options.passes >= 1, "at least 1"),
            ("gain", 0.0 < options.gain <= 1.0, "a number above 0, up to 1"),
            ("uncertainty", 0.0 <= options.uncertainty < 0.9, "a number from 0 to 0.9"),
            ("margin", 0.0 < options.margin < 1.0, "a number between 0 and 1")):
        if not usable:
            raise DfmError(f"--{name} {getattr(options, name):g}: give {wanted}")


def _design(axis: str, experiment: Experiment, name: str, options: argparse.Namespace) -> Axis:
    if experiment.axes[axis].excitation is not None:
        raise DfmError(f"{experiment.name}: axis {axis} has an excitation; learning needs that "
                       "place for itself")
    model = load_model(name)
    model = model.axis(axis) if model.axes else model
    h = model.sample_period
    reference = experiment.reference(axis, h)
    _must_repeat(reference, f"{experiment.name}, axis {axis}")
    gains = pid_with_margin(model, options.margin, sample_period_s=h, feedforward=False
                            ).gains.changed({"setpoint_weight": 1.0, "derivative_weight": 1.0})
    around = neighbours(model, options.uncertainty) if options.uncertainty else []
    for each in around:
        if np.max(np.abs(closed_loop_poles(each, gains))) >= 1.0:
            raise NotConvergingError(f"axis {axis}: with a parameter {options.uncertainty:.0%} "
                                     "off the feedback alone is unstable; raise --margin")
    try:
        design = design_learning(sample_model(model), lambda f: controller_response(gains, f, h),
                                 reference.position.size, candidates=around, gain=options.gain,
                                 cutoff_hz=options.cutoff)
    except ControlError as error:
        raise NotConvergingError(f"axis {axis}: {error}") from error
    start = None if options.no_inverse else inverse_of(model, reference.position,
                                                       reference.velocity, reference.acceleration,
                                                       repeats=True)
    nothing = np.zeros(0)
    return Axis(axis, model, gains, reference, Learner(design, start), nothing, nothing)


def _must_repeat(reference: Reference, where: str) -> None:
    x, v = reference.position, reference.velocity
    if abs(x[-1] - x[0]) > 1e-9 or max(abs(v[0]), abs(v[-1])) > REST_M_S:
        raise DfmError(f"{where}: a pass must start and end at rest in the same place, not at "
                       f"{x[0] * 1e3:.4g} and {x[-1] * 1e3:.4g} mm; a raster does with lead_out_s")


def _write_inputs(axes: list[Axis], experiment: Experiment, plant: str, out: Path) -> None:
    """Write the gains, and the experiment that replays what will be learnt."""
    nodes = {f"/stage/{axis.name}/controller": {
        "sample_period_s": axis.model.sample_period, "mode": "pid", **axis.gains.to_dict()}
        for axis in axes}
    write_text(out / "controller.yaml", parameter_text(nodes, (
        "feedback that the signal was learnt with, by learn",)))
    content = {"name": f"{experiment.name}_learned", "mode": "pid",
               "duration_s": experiment.duration_s, "seed": experiment.seed,
               "model": str(Path(plant).resolve()) if Path(plant).is_file() else plant,
               "controller": "controller.yaml",
               "axes": {axis.name: {
                   "reference": dict(experiment.axes[axis.name].reference or {"kind": "hold"}),
                   "excitation": {"kind": "csv", "file": f"{axis.name}_learned.csv"}}
                   for axis in axes}}
    write_text(out / "learned.yaml", json.dumps(content, indent=1) + "\n")


def _write_signals(axes: list[Axis], out: Path) -> None:
    for axis in axes:
        write_text(out / f"{axis.name}_learned.csv", "time_s,learned_v\n" + "".join(
            f"{k * axis.model.sample_period:.9g},{volts!r}\n"
            for k, volts in enumerate(axis.learner.signal.tolist())))


def _passes(axes: list[Axis], experiment: Experiment, plant: str, out: Path,
            options: argparse.Namespace) -> None:
    """Run the passes and leave the signals that were best, with one more pass that uses them."""
    from dfm_stage.harness import StageGraph

    with StageGraph(axes=tuple(experiment.axes), model=plant, seed=options.seed, lockstep=True,
                    composed=True, bag=out / "bag") as graph:
        heard = {axis.name: graph.listen(axis.name, "measurement") for axis in axes}
        # What was measured before anyone listened is over after this.
        graph.run({"name": "rest", "mode": "pid", "duration_s": 0.1,
                   "axes": {axis.name: {} for axis in axes}})
        with Progress(f"{options.passes} passes of {experiment.name}") as progress:
            for k in range(options.passes + 1):
                _one_pass(axes, graph, out, heard)
                progress(k / options.passes)
                # The first pass starts from rest, all others from a pass: it teaches nothing.
                if k and _learnt(axes, first=k == 1):
                    break
        for axis in axes:
            axis.learner.signal = axis.learner.best
        _one_pass(axes, graph, out, heard)
        graph.stop_recording()


def _learnt(axes: list[Axis], first: bool) -> bool:
    """Learn from the errors of a pass; return whether learning is over on all axes."""
    for axis in axes:
        if first:
            axis.first_error = axis.error
        axis.learner.update(axis.error)
    return all(axis.learner.stopped for axis in axes)


def _one_pass(axes: list[Axis], graph: Any, out: Path, heard: dict[str, Any]) -> None:
    """Run one pass with the signals as they are; leave the error of each axis, r - y, m."""
    _write_signals(axes, out)
    results = graph.run(str(out / "learned.yaml"))
    for axis in axes:
        result, messages = results[axis.name], heard[axis.name]
        graph.spin_until(functools.partial(_complete, messages, result.last_seq), 10.0,
                         f"the measurements of axis {axis.name}")
        found = [m.position for m in messages
                 if result.first_seq <= m.seq <= result.last_seq]
        messages[:] = [m for m in messages if m.seq > result.last_seq]
        if len(found) != axis.reference.position.size:
            raise DfmError(f"axis {axis.name}: a pass has {len(found)} measurements, not "
                           f"{axis.reference.position.size}")
        axis.error = axis.reference.position - np.array(found)


def _complete(messages: list[Any], last_seq: int) -> bool:
    return bool(messages) and messages[-1].seq >= last_seq


def _finish(axes: list[Axis], out: Path, options: argparse.Namespace) -> dict[str, Any]:
    result: dict[str, Any] = {"schema": 1, "experiment": options.experiment, "axes": {}}
    for axis in axes:
        d = axis.learner.design
        line = dict(zip(("first", "learned"), axis.line_rms(), strict=True))
        result["axes"][axis.name] = {
            "passes": len(axis.learner.errors), "stopped": axis.learner.stopped,
            "contraction": d.contraction, "cutoff_hz": d.cutoff_hz, "gain": options.gain,
            "uncertainty": options.uncertainty,
            "error_rms_m": axis.learner.errors,
            "line_rms_m": line,
            "signal": f"{axis.name}_learned.csv"}
        print(f"{axis.name}: error on the line {line['first'] * 1e9:.4g} nm RMS in the first "
              f"pass, {line['learned'] * 1e9:.4g} nm with what {len(axis.learner.errors)} passes "
              "taught" + (f"; stopped: {axis.learner.stopped}" if axis.learner.stopped else ""),
              file=sys.stderr)
    write_json(out / "learning.json", result)
    learning_page(axes, out, options)
    print(f"written: {out}/learned.yaml (replay it with {door()} learn --replay {out} --out "
          f"{out}_again), {out}/report.html, {out}/bag", file=sys.stderr)
    return result


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _replay(options: argparse.Namespace) -> dict[str, Any]:
    folder = Path(options.replay)
    if not (folder / "learned.yaml").is_file():
        raise DfmError(f"{folder}: nothing was learnt there (no learned.yaml)")
    experiment = load_experiment(folder / "learned.yaml")
    out = new_folder(options.out)
    # Twice: what was learnt is for a movement that repeats.
    record = run_on_graph(str((folder / "learned.yaml").resolve()), out / "bag",
                          model=options.plant or experiment.model, seed=options.seed,
                          axes=tuple(experiment.axes), times=2)
    result: dict[str, Any] = {"schema": 1, "experiment": experiment.name, "axes": {}}
    for name in experiment.axes:
        axis = record.axes[name]
        steady = experiment.reference(name, record.sample_period).steady
        if axis.reference is None:
            raise DfmError(f"{out / 'bag'}: no reference was recorded")
        learned = _rms((axis.reference - axis.position)[-steady.size:][steady])
        result["axes"][name] = {"line_rms_m": {"learned": learned}}
        print(f"{name}: error on the line {learned * 1e9:.4g} nm RMS", file=sys.stderr)
    return result
