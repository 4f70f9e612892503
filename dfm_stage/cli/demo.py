"""demo: the whole way in a minute: node graph, scan, bags, model, better scan, and a diagnosis."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.cli.command import (
    PROCESSES,
    SEED,
    command,
    dated_folder,
    new_folder,
    option,
)
from dfm_stage.cli.progress import Progress
from dfm_stage.errors import DfmError
from dfm_stage.model import load_model
from dfm_stage.recording import read_record
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import load_experiment

LOOP_NODES = ("sim_plant, encoder_driver, controller, amplifier_driver, trajectory_generator, "
              "recorder")
BANDWIDTH_HZ = 10.0
SETTLED_S = 1.5
STIFFENING_STAGE = "demo_stage"
LARGE_MULTISINE = {
    "name": "large_multisine", "mode": "open_loop", "duration_s": 24.0, "seed": 2,
    "axes": {"x": {"excitation": {
        "kind": "multisine", "amplitude_v": 0.8, "low_hz": 1.0, "high_hz": 70.0, "period_s": 8.0,
        "odd": True, "detection_lines": True}}}}
EPILOG = "example:\n  ./run demo --out my_demo"
OPTIONS = (
    option("--out", metavar="DIR", help="new folder for bags and pages (default: demo/<date and "
           "time>)"),
    option("--model", default="paper_stage", help="model.yaml of the simulated stage, a path or a "
           "name in config/models (default: %(default)s)"),
    SEED,
    PROCESSES,
)


@command("demo", __doc__, EPILOG, OPTIONS, lambda _: True)
def main(options: argparse.Namespace) -> int:
    """Run the demonstration; 0 when it worked, 2 with one line when it could not."""
    out = dated_folder(options.out, "demo")
    try:
        return _demo(out, options.model, options.seed, not options.processes)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; what was recorded is in {out}") from None


def _demo(out: Path, model: str, seed: int, composed: bool) -> int:
    from dfm_stage.cli import identify

    load_model(model)
    new_folder(out)
    print(f"1. ROS 2 nodes in {'this process' if composed else 'a process each'}, in lockstep: "
          f"{LOOP_NODES}")
    before = _record("scan", out / "scan", model, seed, composed)
    shake = _record("multisine", out / "multisine", model, seed, composed)
    print("2. Identification from the open-loop multisine bag")
    if code := identify.main([str(shake), "--out", str(out / "identify")]):
        return code
    print("3. The same scan with gains and feedforward from the identified model")
    gains = _gains(out / "identify" / "model.yaml")
    after = _record(_scan("scan_tuned", gains), out / "scan_tuned", model, seed, composed)
    _show_scans({"default gains": before, "from the model": after}, out / "scan.png")
    print("4. Another stage: its spring stiffens, which the model does not know")
    if code := _diagnosed(out, gains, seed, composed):
        return code
    pictures = ("identify/report.html", "scan.png", "diagnosis/report.html", "scan_diagnosed.png")
    print(f"\nPictures: {', '.join(str(out / picture) for picture in pictures)}")
    print(f"Bags, for ros2 bag, Foxglove, PlotJuggler: in {out}")
    return 0


def _diagnosed(out: Path, gains: dict[str, Any], seed: int, composed: bool) -> int:
    """Scan a stage that the model does not describe, have it diagnosed, scan with the result."""
    from dfm_stage.cli import diagnose

    def scan(name: str, model: Path) -> Path:
        feedback = {key: value for key, value in gains.items() if "feedforward" not in key}
        return _record(_scan(name, {**feedback, "feedforward": "model",
                                    "model": str(model.resolve())}),
                       out / name, STIFFENING_STAGE, seed, composed)

    simple, extended = out / "identify" / "model.yaml", out / "diagnosis" / "model.yaml"
    before = scan("scan_before_diagnosis", simple)
    shake = _record(LARGE_MULTISINE, out / "large_multisine", STIFFENING_STAGE, seed, composed)
    print("5. Diagnosis of the multisine bag, judged on the scan")
    if code := diagnose.main([str(shake), "--holdout", str(before), "--model", str(simple),
                              "--out", str(extended.parent)]):
        return code
    print("6. The same scan, feedforward from the diagnosed model")
    after = scan("scan_after_diagnosis", extended)
    _show_scans({"identified model": before, "diagnosed model": after}, out / "scan_diagnosed.png")
    return 0


def _scan(name: str, controller: dict[str, Any]) -> dict[str, Any]:
    scan = load_experiment(find_experiment("scan"))
    return {"name": name, "mode": "pid", "duration_s": scan.duration_s, "controller": controller,
            "axes": {"x": {"reference": dict(scan.axes["x"].reference or {})}}}


def _record(experiment: str | dict[str, Any], bag: Path, model: str, seed: int,
            composed: bool) -> Path:
    from dfm_stage.harness import StageGraph

    name = experiment if isinstance(experiment, str) else experiment["name"]
    start = time.monotonic()
    with StageGraph(model=model, seed=seed, lockstep=True, composed=composed, bag=bag) as graph:
        with Progress(f"   {name}") as progress:
            result = graph.run(experiment, progress=progress)["x"]
        summary = graph.stop_recording()
    samples = result.last_seq - result.first_seq + 1
    print(f"   {name}: {samples} samples, {samples * 1e-3 / (time.monotonic() - start):.1f} times "
          f"real time; {summary}")
    return bag


def _gains(model: Path) -> dict[str, float | str]:
    from dfm_stage.control.pid_design import pid_for

    identified = load_model(model)
    design = pid_for(identified.base, BANDWIDTH_HZ, sample_period_s=identified.sample_period)
    print(f"   {design.reason}")
    return design.gains.to_dict()


def _show_scans(bags: dict[str, Path], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), dpi=120, layout="constrained")
    axes = figure.subplots(1 + len(bags), 1, sharex=True)
    print(f"   {'tracking error':24} {'line RMS':>12} {'line peak':>12} {'turn peak':>12}   um")
    for index, (label, bag) in enumerate(bags.items()):
        record = read_record(bag)
        axis = record.axes["x"]
        if axis.reference is None:
            raise DfmError(f"{bag}: no reference was recorded")
        time_s, error = record.time, axis.position - axis.reference
        speed = np.gradient(axis.reference, time_s)
        settled = time_s > SETTLED_S
        line = settled & (np.abs(np.gradient(speed, time_s)) < 1e-3 * np.max(np.abs(speed)))
        figures = (np.sqrt(np.mean(error[line] ** 2)), np.max(np.abs(error[line])),
                   np.max(np.abs(error[settled & ~line])))
        print(f"   {label:24} " + " ".join(f"{value * 1e6:12.2f}" for value in figures))
        if index == 0:
            axes[0].plot(time_s, axis.reference * 1e3, color="0.6", linewidth=3,
                         label="reference")
        axes[0].plot(time_s, axis.position * 1e3, linewidth=1, label=label)
        axes[1 + index].plot(time_s, error * 1e6, color=f"C{index}", linewidth=0.8)
        axes[1 + index].set_ylabel(f"error / um\n{label}")
    axes[0].set_ylabel("position / mm")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1,
                   frameon=False)
    axes[-1].set_xlabel("time / s")
    for each in axes:
        each.grid(alpha=0.3)
    figure.savefig(picture)
