"""compare: several models with the same records, in one table and one plot."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dfm_stage.cli.command import (
    NO_REPORT,
    Options,
    command,
    json_option,
    option,
    output_folder,
    write_json,
)
from dfm_stage.cli.models import AXIS, columns, read_all, said
from dfm_stage.cli.records import RECORDS
from dfm_stage.model import load_model

if TYPE_CHECKING:
    from dfm_stage.comparison import Simulation

EPILOG = """\
examples:
  ./run compare first.yaml better.yaml --record sweep.csv
"""
OPTIONS: Options = (
    option("models", nargs="+", metavar="MODEL",
           help="model.yaml, a path or a name in config/models"),
    option("--record", action="append", required=True, metavar="RECORD",
           help="bag folder, .mcap, .csv, .npz or .mat; may be repeated"),
    option("--initial", type=int, metavar="N", help="as simulate --initial"),
    option("--out", default="compared", metavar="DIR",
           help="folder for comparison.json, report.html and the responses as CSV "
           "(default: %(default)s)"),
    AXIS,
    *RECORDS,
    json_option("comparison.json"),
    NO_REPORT,
)


@command("compare", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Compare; 0 done, 2 unusable input."""
    models = [load_model(path) for path in options.models]
    out = output_folder(options.out)
    records = read_all(options, models, options.record)
    from dfm_stage.comparison import simulate

    found = {name: [simulate(model, record, axis=options.axis, initial=options.initial, name=name)
                    for model in models] for name, record in records.items()}
    text = write_json(out / "comparison.json", {"schema": 1, "records": [
        {"record": name, "models": [{"model": path, **each.to_dict()} for path, each in
                                    zip(options.models, row, strict=True)]}
        for name, row in found.items()]})
    labels = _labels(options.models)
    for index, (name, row) in enumerate(found.items(), 1):
        columns(out / f"responses_{index}_{Path(name).stem}.csv", row[0].time,
                {"measured": row[0].measured, **{label: each.simulated for label, each in
                                                 zip(labels, row, strict=True)}}, row[0].unit)
    if not options.no_report:
        _report(found, labels, out / "report.html")
    if options.json:
        print(text, end="")
        return 0
    wide = max(map(len, labels))
    for name, row in found.items():
        print(name)
        for label, each in zip(labels, row, strict=True):
            print(f"  {label:<{wide}}  {said(each)}")
    print(f"  comparison.json{'' if options.no_report else ', report.html'} and the responses in "
          f"{out}")
    return 0


def _labels(paths: Sequence[str]) -> list[str]:
    """Short names that differ: of the files, else with their folder, else numbered."""
    names = [Path(path).stem for path in paths]
    for other in ([f"{Path(path).parent.name}/{name}" for path, name in
                   zip(paths, names, strict=True)],
                  [f"{name} ({number})" for number, name in enumerate(names, 1)]):
        names = [other[i] if names.count(name) > 1 else name for i, name in enumerate(names)]
    return names


def _report(found: dict[str, list[Simulation]], labels: Sequence[str], path: Path) -> None:
    from dfm_stage.reporting import Page, format_quantity, time_figure

    page = Page("Models beside records")
    for name, row in found.items():
        best = min(zip(labels, row, strict=True), key=lambda pair: pair[1].rms)
        page.section(name, f"{best[0]} comes nearest: it leaves "
                     f"{format_quantity(best[1].rms, best[1].unit)} RMS.")
        page.table(("Model", "RMS", "Fit (%)"), [
            (label, format_quantity(each.rms, each.unit), each.fit_percent)
            for label, each in zip(labels, row, strict=True)])
        first, unit = row[0], row[0].unit
        page.figure(time_figure(first.time[first.skipped:], [
            (first.measures, unit, {"measured": first.measured[first.skipped:], **{
                label: each.simulated[each.skipped:] for label, each in
                zip(labels, row, strict=True)}}),
            ("left over", unit, {label: each.residual for label, each in
                                 zip(labels, row, strict=True)})]),
            f"{name}: measured and simulated, and what each model leaves")
    page.provenance({"Models": ", ".join(labels), "Records": ", ".join(found)})
    page.write(path)
