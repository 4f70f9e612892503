"""tune: choose a controller's parameters for a model or a bag, with margins and reasons."""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dfm_stage.cli.command import Options, command, option
from dfm_stage.cli.graph_run import run_on_graph
from dfm_stage.cli.progress import steps
from dfm_stage.cli.records import RECORDS, as_words
from dfm_stage.cli.tune_verify import Tracking, as_experiment, compare
from dfm_stage.control import (
    Tuned,
    Ultimate,
    parameter_text,
    sample_model,
    tune_lqr,
    tune_pid,
    tune_ziegler_nichols,
    ultimate,
    write_text,
)
from dfm_stage.errors import CheckFailedError, DfmError
from dfm_stage.model import Model, load_model
from dfm_stage.recording import read_bag

METHODS = ("pid", "lqr", "ziegler_nichols")
WAYS = ("raise_gain", "relay")
_NO_NOISE_M = 1e-11
EPILOG = """examples:
  ./run tune --model paper_stage
  ./run tune --model my/model.yaml --method lqr --margin 0.6 --out lqr.yaml
  ./run tune --bag bags/multisine --out pid.yaml --verify scan
  ./run tune --model xy_stage --verify scan_xy                  (both axes, one file)
  ./run tune --model paper_stage --method ziegler_nichols     (on the running node graph)
then:
  ./run controller --ros-args --params-file pid.yaml
"""
OPTIONS: Options = (
    option("--model", metavar="FILE",
           help="model.yaml, a path or a name in config/models; with --bag, where "
           "identification starts from"),
    option("--bag", metavar="BAG", help="bag or CSV file the model is identified from first"),
    option("--axis", metavar="NAME",
           help="one axis of a model that has several (default: all of them); also the node's "
           "namespace (default: x)"),
    option("--method", choices=METHODS, default="pid",
           help="default: %(default)s, two degrees of freedom with feedforward"),
    option("--margin", type=float, default=0.5, metavar="M",
           help="modulus margin to keep, 0 to 1 (default: %(default)s); ziegler_nichols takes "
           "what it gets"),
    option("--limit", type=float, default=10.0, metavar="V",
           help="largest output (default: %(default)s V)"),
    option("--no-integral", action="store_true", help="lqr without integral action"),
    option("--disturbance", action="store_true", help="lqr with an estimate of a drifting force"),
    option("--feedforward", choices=("auto", "gains", "model", "inverse"), default="auto",
           help="pid: three gains; the model's own input with its springs, friction and force "
           "constant; or the inverse for the whole reference ahead (default: model where it has "
           "such effects, else gains)"),
    option("--notch", action="store_true",
           help="pid: take the model's highest mode out of the feedback"),
    option("--verify", metavar="EXPERIMENT",
           help="run this experiment with the result on the node graph and show the error beside "
           "the predicted one"),
    option("--plant", metavar="FILE",
           help="model the simulated stage runs for --verify and ziegler_nichols (default: the "
           "model tuned on)"),
    option("--out", metavar="FILE",
           help="parameter file to write (default: <method>.yaml); a page and the identified "
           "model go beside it"),
    option("--json", action="store_true", help="print the result as JSON"),
    option("--no-report", action="store_true",
           help="do not write the page beside the parameter file"),
    ("ziegler_nichols, on the node graph in lockstep", (
        option("--way", choices=(*WAYS, "both", "model"), default="both",
               help="raise the gain until the loop oscillates, relay feedback, both, or only "
               "compute on the model (default: %(default)s)"),
        option("--voltage", type=float, default=0.5, metavar="V",
               help="amplitude of relay and pulses (default: %(default)s V)"),
        option("--travel", type=float, default=0.004, metavar="M",
               help="stop where the stage goes further (default: %(default)s m)"),
        option("--gain", type=float, default=100.0, metavar="V/M",
               help="gain to start from (default: %(default)s V/m)"),
        option("--duration", type=float, default=30.0, metavar="S",
               help="time for each way (default: %(default)s s)"))),
    *RECORDS,
)


class TuningFailedError(CheckFailedError):
    """A tuning run on the loop ended without a result; it was stopped safely."""


@command("tune", __doc__, EPILOG, OPTIONS, lambda options: options.verify or (
    options.method == "ziegler_nichols" and options.way != "model"))
def main(options: argparse.Namespace) -> int:
    """Tune; 0 when done, 1 when the loop could not be tuned, 2 with one line if unusable."""
    out = Path(options.out or f"{options.method}.yaml")
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise DfmError(f"{out}: cannot write there; give a file in a folder that exists")
    if not options.model and not options.bag:
        raise DfmError("no model: give --model FILE, or --bag BAG to identify one")
    if not 0.0 < options.margin < 1.0:
        raise DfmError(f"--margin {options.margin:g}: give a number between 0 and 1")
    name = options.model
    if options.bag:
        name = identified(options.bag, out.with_suffix(""), *as_words(options, *RECORDS),
                          model=options.model, axis=options.axis)
    model = load_model(name)
    if Path(name).is_file():
        name = str(Path(name).resolve())
    names = [options.axis] if options.axis or not model.axes else list(model.axes)
    axes = {axis or "x": model.axis(axis) if model.axes else model for axis in names}
    results: dict[str, Tuned] = {}
    found: dict[str, dict[str, Ultimate]] = {}
    for axis, each in axes.items():
        with steps("tune", options.json or options.method == "ziegler_nichols") as step:
            step(f"axis {axis}")
            results[axis], found[axis] = _tuned(axis, each, name, options)
    write_text(out, _yaml(results, axes))
    verified = _verify(out, results, axes, options.plant or name, options)
    page = out.with_suffix(".html")
    if not options.no_report:
        from dfm_stage.cli.tune_report import write_report

        write_report(page, results, axes, found, verified,
                     {"Model": name, "Bag": options.bag or "none", "Parameters": out})
    if options.json:
        plain = {axis: _plain(results[axis], found[axis], verified.get(axis)) for axis in axes}
        print(json.dumps({"schema": 1, "axes": plain} if len(plain) > 1 else
                         next(iter(plain.values())), indent=1))
    else:
        for axis, each in axes.items():
            if len(axes) > 1:
                print(f"axis {axis}")
            _print(results[axis], found[axis], each, verified.get(axis))
        print(f"written: {out}" + ("" if options.no_report else f", {page}"))
    return 0


def _tuned(axis: str, model: Model, name: str,
           options: argparse.Namespace) -> tuple[Tuned, dict[str, Ultimate]]:
    if options.method == "pid":
        return tune_pid(model, options.margin, options.limit, model_name=name,
                        feedforward=options.feedforward, notch=options.notch), {}
    if options.method == "lqr":
        return tune_lqr(model, name, options.margin, options.limit,
                        lqr_integral=not options.no_integral,
                        lqr_disturbance=options.disturbance), {}
    ways = {"both": WAYS, "model": ()}.get(options.way, (options.way,))
    found = {way: _on_the_graph(way, axis, options.plant or name, options) for way in ways}
    return tune_ziegler_nichols(model, next(iter(found.values()), None), options.limit), found


def identified(bag: str, folder: Path, *words: str, **given: str | None) -> str:
    """Identify a model from a bag and return its file; `words` and `given` are options of
    identify."""
    from dfm_stage.cli import identify

    further = [word for name, value in given.items() if value for word in (f"--{name}", value)]
    if identify.main([bag, "--out", str(folder), "--no-report", *words, *further]) != 0:
        raise DfmError(f"{bag}: no model could be identified (see above)")
    return str(folder / "model.yaml")


def _on_the_graph(way: str, axis: str, model: str, options: argparse.Namespace) -> Ultimate:
    """Run one way of tuning on the node graph and return what it found."""
    run = {"name": f"ziegler_nichols_{way}", "mode": "pid", "duration_s": options.duration,
           "axes": {axis: {}},
           "controller": {"tuning": way, "tuning_voltage_v": options.voltage,
                          "tuning_travel_m": options.travel, "tuning_gain_v_m": options.gain,
                          "tuning_time_s": options.duration, "output_limit_v": options.limit}}
    with tempfile.TemporaryDirectory(prefix="dfm_stage_tune_") as folder:
        bag = Path(folder) / "bag"
        run_on_graph(run, bag, model=model, axes=(axis,), label=f"{way} on the node graph")
        topic = f"/stage/{axis}/controller/config"
        said = [json.loads(text) for text in read_bag(bag, [topic])[topic]["data"]]
    state: Mapping[str, Any] = next((each["tuning"] for each in reversed(said)
                                     if each.get("tuning", {}).get("ended")), {})
    if "ultimate_gain_v_m" not in state:
        raise TuningFailedError(f"{way}: {state.get('failure') or 'no result in time'}; the "
                                "output went to zero")
    return Ultimate(state["ultimate_gain_v_m"], state["ultimate_period_s"])


def _verify(file: Path, results: Mapping[str, Tuned], axes: Mapping[str, Model], plant: str,
            options: argparse.Namespace) -> dict[str, Tracking]:
    """Run the experiment on the graph with the file and return errors beside the predicted."""
    if not options.verify:
        return {}
    experiment = as_experiment(
        options.verify, next(iter(results.values())).parameters["mode"], file, tuple(axes))
    with tempfile.TemporaryDirectory(prefix="dfm_stage_tune_") as folder:
        record = run_on_graph(experiment, Path(folder) / "bag", model=plant, axes=tuple(axes),
                              label=f"{options.verify} on the node graph")
    return {axis: compare(record, axis, experiment, axes[axis], results[axis]) for axis in axes}


def _yaml(results: Mapping[str, Tuned], axes: Mapping[str, Model]) -> str:
    comments, nodes = [], {}
    for axis, result in results.items():
        comments += [f"{result.method} for model {axes[axis].name}, by tune", "",
                     *result.reasons, *_promises(result)]
        nodes[f"/stage/{axis}/controller"] = {"sample_period_s": axes[axis].sample_period,
                                              **result.parameters}
        if result.generator:
            nodes[f"/stage/{axis}/trajectory_generator"] = dict(result.generator)
    return parameter_text(nodes, comments)


def _promises(result: Tuned) -> list[str]:
    m, p = result.margins, result.predicted
    margins = (f"modulus margin {m.modulus:.3f}, gain margin {m.gain:.2f}, phase margin "
               f"{m.phase_deg:.1f} degrees, crossover {m.crossover_hz:.3g} Hz, bandwidth "
               f"{result.bandwidth_hz:.3g} Hz")
    errors = ("predicted on the model: 1 mm step from 5 s on within "
              f"{p['step_1mm_after_5s'] * 1e6:.3g} um, +-1 mm 0.5 Hz sine within "
              f"{p['sine_1mm_half_hz_peak'] * 1e6:.3g} um, {p['at_rest_rms'] * 1e9:.3g} nm RMS at "
              "rest")
    if p["at_rest_rms"] < _NO_NOISE_M:
        errors += "; the model has no noise, add that of the encoder"
    return [margins, errors]


def _plain(result: Tuned, found: Mapping[str, Ultimate],
           verified: Tracking | None) -> dict[str, Any]:
    m = result.margins
    plain = {"schema": 1, "method": result.method, "parameters": dict(result.parameters),
             "trajectory_generator": dict(result.generator),
             "margins": {"modulus": m.modulus, "gain": m.gain, "phase_deg": m.phase_deg,
                         "crossover_hz": m.crossover_hz},
             "bandwidth_hz": result.bandwidth_hz,
             "predicted": {name: {"value": value, "unit": "m"}
                           for name, value in result.predicted.items()},
             "ultimate": {way: {"gain_v_m": each.gain_v_m, "period_s": each.period_s}
                          for way, each in found.items()},
             "reasons": list(result.reasons)}
    return plain if verified is None else {**plain, "verified": verified.plain()}


def _print(result: Tuned, found: Mapping[str, Ultimate], model: Model,
           verified: Tracking | None) -> None:
    for way, each in found.items():
        print(f"{way}: ultimate gain {each.gain_v_m:.5g} V/m, period {each.period_s:.4g} s")
    if found:
        exact = ultimate(sample_model(model))
        print(f"the model's own: {exact.gain_v_m:.5g} V/m, {exact.period_s:.4g} s")
    for name, value in {**result.parameters, **result.generator}.items():
        print(f"  {name:24} {f'{value:.6g}' if isinstance(value, float) else value}")
    for line in (*result.reasons, *_promises(result)):
        print(f"- {line}")
    if verified is not None:
        print(f"- {verified}")
