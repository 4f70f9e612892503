"""simulate: the response of a model to recorded inputs, its RMS error and its fit."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from dfm_stage.cli.command import Options, command, json_option, option, output_folder, write_json
from dfm_stage.cli.models import AXIS, RECORD_NAMES, columns, read_all, said
from dfm_stage.cli.records import RECORDS
from dfm_stage.model import load_model

if TYPE_CHECKING:
    from dfm_stage.comparison import Simulation

EPILOG = """\
examples:
  ./run simulate my_model.yaml sweep.csv
  ./run simulate my_model.yaml train.csv test.csv --initial 50    # state from the first 50 samples
"""
OPTIONS: Options = (
    option("model", metavar="MODEL", help="model.yaml, a path or a name in config/models"),
    RECORD_NAMES,
    option("--initial", type=int, metavar="N",
           help="find state and offset from the first N samples and leave those out of the "
           "figures (default: fit them to the whole record, as diagnose does)"),
    option("--out", default="simulated", metavar="DIR",
           help="folder for simulation.json and the response as CSV (default: %(default)s)"),
    AXIS,
    *RECORDS,
    json_option("simulation.json"),
)


@command("simulate", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Simulate; 0 done, 2 unusable input."""
    model = load_model(options.model)
    out = output_folder(options.out)
    records = read_all(options, [model], options.records)
    from dfm_stage.comparison import pooled, simulate

    found = [simulate(model, record, axis=options.axis, initial=options.initial, name=name)
             for name, record in records.items()]
    files = [_file(each, index, len(found)) for index, each in enumerate(found, 1)]
    for each, file in zip(found, files, strict=True):
        columns(out / file, each.time, {"measured": each.measured, "simulated": each.simulated},
                each.unit)
    content = {"schema": 1, "model": model.name, **pooled(found), "records": [
        {"record": each.record, "response": file, **each.to_dict()}
        for each, file in zip(found, files, strict=True)]}
    text = write_json(out / "simulation.json", content)
    if options.json:
        print(text, end="")
        return 0
    for each in found:
        print(f"{each.record}: {said(each)}")
    print(f"  simulation.json, {', '.join(files)} in {out}")
    return 0


def _file(found: Simulation, index: int, count: int) -> str:
    """Name of the file with one response."""
    return "response.csv" if count == 1 else f"response_{index}_{Path(found.record).stem}.csv"
