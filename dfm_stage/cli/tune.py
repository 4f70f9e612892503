"""tune: from a model, or a bag, to a controller's parameters, what they promise, and why."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.errors import DfmError

if TYPE_CHECKING:
    from dfm_stage.control import Tuned, Ultimate
    from dfm_stage.model import Model

METHODS = ("pid", "lqr", "ziegler_nichols")
WAYS = ("raise_gain", "relay")
EPILOG = """examples:
  ./run tune --model paper_stage
  ./run tune --model my/model.yaml --method lqr --margin 0.6 --out lqr.yaml
  ./run tune --bag bags/multisine --out pid.yaml
  ./run tune --model paper_stage --method ziegler_nichols     (on the running node graph)
then:
  ./run controller --ros-args --params-file pid.yaml
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Tune; 0 when done, 1 when the loop could not be tuned, 2 with one line if unusable."""
    parser = argparse.ArgumentParser(prog="tune", description=__doc__, epilog=EPILOG,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", metavar="FILE", help="model.yaml, a path or a name in "
                        "config/models; with --bag, where identification starts from")
    parser.add_argument("--bag", metavar="BAG", help="bag or CSV file the model is identified "
                        "from first")
    parser.add_argument("--axis", metavar="NAME", help="axis, where the model has several; also "
                        "the node's namespace (default: x)")
    parser.add_argument("--method", choices=METHODS, default="pid",
                        help="default: %(default)s, two degrees of freedom with feedforward")
    parser.add_argument("--margin", type=float, default=0.5, metavar="M",
                        help="modulus margin to keep, 0 to 1 (default: %(default)s); "
                        "ziegler_nichols takes what it gets")
    parser.add_argument("--limit", type=float, default=10.0, metavar="V",
                        help="largest output (default: %(default)s V)")
    parser.add_argument("--no-integral", action="store_true", help="lqr without integral action")
    parser.add_argument("--disturbance", action="store_true",
                        help="lqr with an estimate of a drifting force")
    parser.add_argument("--out", metavar="FILE", help="parameter file to write (default: "
                        "<method>.yaml); the identified model goes beside it")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    graph = parser.add_argument_group("ziegler_nichols, on the node graph in lockstep")
    graph.add_argument("--way", choices=(*WAYS, "both", "model"), default="both",
                       help="raise the gain until the loop oscillates, relay feedback, both, or "
                       "only compute on the model (default: %(default)s)")
    graph.add_argument("--voltage", type=float, default=0.5, metavar="V",
                       help="height of relay and kicks (default: %(default)s V)")
    graph.add_argument("--travel", type=float, default=4e-3, metavar="M",
                       help="stop where the stage goes further (default: %(default)s m)")
    graph.add_argument("--gain", type=float, default=100.0, metavar="V/M",
                       help="gain to start from (default: %(default)s V/m)")
    graph.add_argument("--duration", type=float, default=30.0, metavar="S",
                       help="time for each way (default: %(default)s s)")
    options = parser.parse_args(argv)
    try:
        return _tune(options)
    except DfmError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _tune(options: argparse.Namespace) -> int:
    out = Path(options.out or f"{options.method}.yaml")
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise DfmError(f"{out}: cannot write there; give a file in a folder that exists")
    if not options.model and not options.bag:
        raise DfmError("no model: give --model FILE, or --bag BAG to identify one")
    if not 0.0 < options.margin < 1.0:
        raise DfmError(f"--margin {options.margin:g}: give a number between 0 and 1")
    from dfm_stage.control import tune_lqr, tune_pid, tune_ziegler_nichols
    from dfm_stage.model import load_model

    name = options.model
    if options.bag:
        name = _identified(options, out)
    model = load_model(name)
    if model.axes:
        model = model.axis(options.axis)
    if Path(name).is_file():
        name = str(Path(name).resolve())
    found: dict[str, Ultimate] = {}
    if options.method == "pid":
        result = tune_pid(model, options.margin, options.limit)
    elif options.method == "lqr":
        result = tune_lqr(model, name, options.margin, options.limit,
                          lqr_integral=not options.no_integral,
                          lqr_disturbance=options.disturbance)
    else:
        ways = {"both": WAYS, "model": ()}.get(options.way, (options.way,))
        try:
            found = {way: _on_the_graph(way, name, options) for way in ways}
        except TuningFailedError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        result = tune_ziegler_nichols(model, next(iter(found.values()), None), options.limit)
    _write(out, _yaml(result, options.axis or "x", model))
    if options.json:
        print(json.dumps(_plain(result, found), indent=1))
    else:
        _print(result, found, model, out)
    return 0


class TuningFailedError(DfmError):
    """A tuning run on the loop ended without a result; it was stopped safely."""


def _identified(options: argparse.Namespace, out: Path) -> str:
    from dfm_stage.cli import identify

    folder = out.with_suffix("")
    arguments = [options.bag, "--out", str(folder), "--no-report"]
    arguments += ["--model", options.model] if options.model else []
    arguments += ["--axis", options.axis] if options.axis else []
    if identify.main(arguments) != 0:
        raise DfmError(f"{options.bag}: no model could be identified (see above)")
    return str(folder / "model.yaml")


def _on_the_graph(way: str, model: str, options: argparse.Namespace) -> Ultimate:
    """Run one way of tuning on the node graph and return what it found."""
    from dfm_stage.cli.progress import Progress
    from dfm_stage.control import Ultimate
    from dfm_stage.harness import StageGraph
    from dfm_stage.recording import read_bag

    axis = options.axis or "x"
    run = {"name": f"ziegler_nichols_{way}", "mode": "pid", "duration_s": options.duration,
           "axes": {axis: {}},
           "controller": {"tuning": way, "tuning_voltage_v": options.voltage,
                          "tuning_travel_m": options.travel, "tuning_gain_v_m": options.gain,
                          "tuning_time_s": options.duration, "output_limit_v": options.limit}}
    with tempfile.TemporaryDirectory(prefix="dfm_stage_tune_") as folder:
        bag = Path(folder) / "bag"
        with StageGraph(axes=(axis,), model=model, lockstep=True, composed=True, bag=bag) as graph:
            with Progress(f"{way} on the node graph") as progress:
                graph.run(run, progress=progress)
            graph.stop_recording()
        topic = f"/stage/{axis}/controller/config"
        said = [json.loads(text) for text in read_bag(bag, [topic])[topic]["data"]]
    state: Mapping[str, Any] = next((each["tuning"] for each in reversed(said)
                                     if each.get("tuning", {}).get("ended")), {})
    if "ultimate_gain_v_m" not in state:
        reason = state.get("failure") or "no result in time"
        raise TuningFailedError(f"{way}: {reason}; the output went to zero")
    return Ultimate(state["ultimate_gain_v_m"], state["ultimate_period_s"])


def _yaml(result: Tuned, axis: str, model: Model) -> str:
    lines = [f"# {result.method} for model {model.name}, by tune", "#"]
    lines += [f"# {reason}" for reason in result.reasons]
    lines += [f"# {line}" for line in _promises(result)]
    lines += [f"/stage/{axis}/controller:", "  ros__parameters:"]
    parameters = {"sample_period_s": model.sample_period, **result.parameters}
    lines += [f"    {name}: {_scalar(value)}" for name, value in parameters.items()]
    return "\n".join(lines) + "\n"


def _scalar(value: Any) -> str:
    if isinstance(value, float):
        text = repr(value)
        mantissa, e, exponent = text.partition("e")
        return text if "." in mantissa else f"{mantissa}.0{e}{exponent}"
    return json.dumps(value)


def _promises(result: Tuned) -> list[str]:
    m, p = result.margins, result.predicted
    margins = (f"modulus margin {m.modulus:.3f}, gain margin {m.gain:.2f}, phase margin "
               f"{m.phase_deg:.1f} degrees, crossover {m.crossover_hz:.3g} Hz, bandwidth "
               f"{result.bandwidth_hz:.3g} Hz")
    errors = ("predicted on the model: 1 mm step from 5 s on within "
              f"{p['step_1mm_after_5s'] * 1e6:.3g} um, +-1 mm 0.5 Hz sine within "
              f"{p['sine_1mm_half_hz_peak'] * 1e6:.3g} um, {p['at_rest_rms'] * 1e9:.3g} nm RMS at "
              "rest")
    return [margins, errors]


def _plain(result: Tuned, found: Mapping[str, Ultimate]) -> dict[str, Any]:
    m = result.margins
    return {"schema": 1, "method": result.method, "parameters": dict(result.parameters),
            "margins": {"modulus": m.modulus, "gain": m.gain, "phase_deg": m.phase_deg,
                        "crossover_hz": m.crossover_hz},
            "bandwidth_hz": result.bandwidth_hz,
            "predicted": {name: {"value": value, "unit": "m"}
                          for name, value in result.predicted.items()},
            "ultimate": {way: {"gain_v_m": each.gain_v_m, "period_s": each.period_s}
                         for way, each in found.items()},
            "reasons": list(result.reasons)}


def _print(result: Tuned, found: Mapping[str, Ultimate], model: Model, out: Path) -> None:
    from dfm_stage.control import sample_model, ultimate

    for way, each in found.items():
        print(f"{way}: ultimate gain {each.gain_v_m:.5g} V/m, period {each.period_s:.4g} s")
    if found:
        exact = ultimate(sample_model(model))
        print(f"the model's own: {exact.gain_v_m:.5g} V/m, {exact.period_s:.4g} s")
    for name, value in result.parameters.items():
        shown = f"{value:.6g}" if isinstance(value, float) else value
        print(f"  {name:24} {shown}")
    for line in (*result.reasons, *_promises(result)):
        print(f"- {line}")
    print(f"written: {out}")


def _write(path: Path, text: str) -> None:
    try:
        with tempfile.NamedTemporaryFile("w", dir=path.absolute().parent, prefix=".tune_",
                                         delete=False, encoding="utf-8") as file:
            file.write(text)
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except OSError as error:
        raise DfmError(f"{path}: cannot write ({error.strerror})") from error
