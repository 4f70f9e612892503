"""example: write records of a stage and a model that lacks an effect, to try the commands on."""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np

from dfm_stage.cli.command import command, option, output_folder, write_output
from dfm_stage.model import Simulator, load_model, save_model
from dfm_stage.recording import AxisRecord, Provenance, Record, write_csv, write_mat
from dfm_stage.trajectory import make_excitation

STAGE, MODEL = "demo_stage", "paper_stage"
DURATION_S = 16.0
SHAKE = {"kind": "multisine", "amplitude_v": 0.8, "low_hz": 1.0, "high_hz": 70.0,
         "period_s": 8.0, "odd": True, "detection_lines": True}
SWEEP = {"kind": "chirp", "amplitude_v": 0.1, "low_hz": 1.0, "high_hz": 40.0,
         "period_s": DURATION_S}
FORMATS = ("csv", "mat", "dspace")
EPILOG = """\
examples:
  ./run example                                 # multisine.csv, sweep.csv, model.yaml
  ./run example exports --format dspace         # the same as dSPACE ControlDesk exports .mat
then:
  ./run diagnose example/multisine.csv --holdout example/sweep.csv --model example/model.yaml
"""
OPTIONS = (
    option("folder", nargs="?", default="example", metavar="DIR",
           help="folder to write to (default: %(default)s)"),
    option("--format", choices=FORMATS, default="csv",
           help="CSV, MATLAB .mat, or .mat as dSPACE exports it (default: %(default)s)"),
    option("--seed", type=int, default=1, help="fixes the noise (default: 1)"),
)


@command("example", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Write the files; 0 done, 2 where they cannot be written."""
    folder = output_folder(options.folder)
    write, suffix = {"csv": (write_csv, "csv"), "mat": (write_mat, "mat"),
                     "dspace": (_write_dspace, "mat")}[options.format]
    for number, (name, excitation) in enumerate((("multisine", SHAKE), ("sweep", SWEEP))):
        write(example_record(excitation, options.seed + number), folder / f"{name}.{suffix}")
    save_model(load_model(MODEL), folder / "model.yaml")
    print(f"multisine.{suffix}, sweep.{suffix} and model.yaml in {folder}")
    return 0


def example_record(excitation: dict[str, object], seed: int) -> Record:
    """Return what an open-loop run of the example's stage measures, 16 s at 1 kHz."""
    stage = load_model(STAGE)
    period = stage.sample_period
    volts = make_excitation(excitation, sample_period_s=period, duration_s=DURATION_S,
                            seed=seed).voltage
    reading = Simulator(stage).run(volts).measured(seed)
    time = np.arange(len(volts), dtype=np.float64) * period
    return Record(time, period, {"x": AxisRecord(volts, reading)},
                  Provenance(str(excitation["kind"]), "simulated"))


def _write_dspace(record: Record, path: Path) -> None:
    """Write a capture as ControlDesk exports it: X the time, Y the signals by block path."""
    import scipy.io

    axis = record.axis()
    signals = [{"Name": f'"Model Root/Stage/{name}"', "Data": values}
               for name, values in (("Voltage", axis.input), ("Position", 1e6 * axis.position))]
    content = io.BytesIO()
    scipy.io.savemat(content, {path.stem: {"X": {"Name": "Time", "Data": record.time},
                                           "Y": signals}})
    write_output(path, content.getvalue())
