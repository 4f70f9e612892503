"""demo: the whole way in a minute: node graph, scan, excitation, bags, identification, figures."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from dfm_stage.cli.progress import Progress
from dfm_stage.errors import DfmError

LOOP_NODES = "sim_plant encoder_driver controller amplifier_driver trajectory_generator recorder"
EPILOG = "example: ./run demo --out my_demo"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demonstration; 0 when it worked, 2 with one line when it could not."""
    parser = argparse.ArgumentParser(prog="demo", description=__doc__, epilog=EPILOG)
    parser.add_argument("--out", metavar="DIR", help="new folder for bags and pages "
                        "(default: demo/<date and time>)")
    parser.add_argument("--model", default="paper_stage",
                        help="model.yaml of the simulated stage, a path or a name in "
                        "config/models (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="fixes the noise (default: 0)")
    parser.add_argument("--processes", action="store_true",
                        help="one process per node instead of all in this one")
    options = parser.parse_args(argv)
    out = Path(options.out or f"demo/{datetime.now():%Y%m%d_%H%M%S}")
    try:
        return _demo(out, options.model, options.seed, not options.processes)
    except DfmError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"stopped; what was recorded is in {out}", file=sys.stderr)
        return 130


def _demo(out: Path, model: str, seed: int, composed: bool) -> int:
    from dfm_stage.cli import identify
    from dfm_stage.recording import read_record

    if out.exists() and any(out.iterdir()):
        raise DfmError(f"{out} is not empty; choose another folder with --out")
    where = "in this process" if composed else "in a process each"
    print(f"1. ROS 2 nodes {where}, in lockstep: {LOOP_NODES.replace(' ', ', ')}")
    scan = _record("scan", out / "scan", model, seed, composed)
    shake = _record("multisine", out / "multisine", model, seed, composed)
    print("2. Scan under PID: raster, 5 mm at 12.5 mm/s, 0.1 s turnarounds")
    _show_scan(read_record(scan), out / "scan.png")
    print("3. Identification from the open-loop multisine bag")
    code = identify.main([str(shake), "--out", str(out / "identify")])
    print(f"\nPictures: {out / 'identify' / 'report.html'} and {out / 'scan.png'}")
    print(f"Bags (ros2 bag info, Foxglove, PlotJuggler read them): {scan} and {shake}")
    return code


def _record(experiment: str, bag: Path, model: str, seed: int, composed: bool) -> Path:
    from dfm_stage.harness import StageGraph

    start = time.monotonic()
    with StageGraph(model=model, seed=seed, lockstep=True, composed=composed, bag=bag) as graph:
        with Progress(f"   {experiment}") as progress:
            result = graph.run(experiment, progress=progress)["x"]
        summary = graph.stop_recording()
    samples = result.last_seq - result.first_seq + 1
    speed = samples * 1e-3 / (time.monotonic() - start)
    print(f"   {experiment}: {samples} samples, {speed:.1f} times real time; {summary}")
    return bag


def _show_scan(record: object, picture: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    axis = record.axes["x"]  # type: ignore[attr-defined]
    time_s, error = record.time, axis.position - axis.reference  # type: ignore[attr-defined]
    speed = np.gradient(axis.reference, time_s)
    settled = time_s > 1.5
    line = settled & (np.abs(np.gradient(speed, time_s)) < 1e-3 * np.max(np.abs(speed)))
    turn = settled & ~line
    for name, part in (("line", line), ("turnaround", turn)):
        rms, peak = np.sqrt(np.mean(error[part] ** 2)), np.max(np.abs(error[part]))
        print(f"   error on the {name:10} {rms * 1e6:7.2f} um RMS {peak * 1e6:7.2f} um peak")
    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 4.5), dpi=120,
                                          constrained_layout=True)
    above.plot(time_s, axis.reference * 1e3, label="reference", color="0.6", linewidth=3)
    above.plot(time_s, axis.position * 1e3, label="measured", color="tab:blue", linewidth=1)
    above.set_ylabel("position / mm")
    above.legend(loc="upper right")
    below.plot(time_s, error * 1e6, color="tab:red", linewidth=0.8)
    below.set_ylabel("error / um")
    below.set_xlabel("time / s")
    for each in (above, below):
        each.grid(alpha=0.3)
    figure.savefig(picture)
    plt.close(figure)
