"""identify: estimate a model, natural frequency, damping and gain, with 95 % intervals."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from dfm_stage.cli.command import (
    NO_REPORT,
    Options,
    command,
    finite,
    json_option,
    names_in,
    option,
    output_folder,
    write_json,
)
from dfm_stage.cli.progress import steps
from dfm_stage.cli.records import RECORDS, SPLIT, divided, held_names, read_with
from dfm_stage.errors import CheckFailedError, DfmError
from dfm_stage.model import Model, load_model, save_model
from dfm_stage.quantity import format_number, format_quantity
from dfm_stage.recording import Record

if TYPE_CHECKING:
    from dfm_stage.identification import Identification, Source

EPILOG = """\
examples:
  ./run identify runs/multisine
  ./run identify train.csv --holdout scan.csv --model config/models/paper_stage.yaml --out found
  ./run identify log.csv --time t --input iq --output theta --input-unit A --output-unit rad
  ./run identify robot_bag --input /joint_states.effort[0] --output /joint_states.position[0]
"""
FEWEST_SAMPLES = 100
"""A shorter record is refused: it holds too little of a stage's motion to fit a noise model to."""
OPTIONS: Options = (
    option("bags", nargs="*", metavar="RUN",
           help="bag folder, .mcap, .csv, .npz or .mat; several are fitted together"),
    option("--record", action="append", default=[], metavar="RUN",
           help="one more record to fit, as RUN"),
    option("--holdout", action="append", default=[], metavar="RUN",
           help="a record to predict and not to fit; without one, the last quarter of the first "
           "record"),
    option("--out", default="identified", metavar="DIR",
           help="folder for identify.json, model.yaml and report.html (default: %(default)s)"),
    option("--axis", metavar="NAME", help="axis, where a record has several"),
    option("--model", metavar="FILE",
           help="model.yaml to start from, a path or a name in config/models (default: second "
           "order behind amplifier lag and delay)"),
    option("--free", action="append", default=[], metavar="NAME[,NAME]",
           help="estimate these as well: a parameter (mass, cubic_stiffness.k3) or an effect"),
    option("--only", action="append", default=[], metavar="NAME[,NAME]",
           help="estimate these and nothing else"),
    option("--fix", action="append", default=[], metavar="NAME[=VALUE]",
           help="hold a parameter, at VALUE if given"),
    option("--noise", choices=("auto", "white"), default="auto",
           help="noise model: an autoregression of fitting order, or white"),
    option("--skip", type=float, default=0.0, metavar="SECONDS",
           help="leave out the start of each record"),
    SPLIT,
    *RECORDS,
    json_option("identify.json"),
    NO_REPORT,
)


@command("identify", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Identify from bags or CSV files; 0 done, 1 no model found, 2 unusable input."""
    paths = [*options.bags, *options.record]
    if not paths:
        raise DfmError("no record given: name a bag or a CSV file (identify --help)")
    fixed = dict(_fixed(item) for item in options.fix)
    out = output_folder(options.out)
    with steps("identify", options.json) as step:
        step("reading")
        from dfm_stage.identification import identify

        model = load_model(options.model).axis(options.axis) if options.model else None
        names = [*paths, *options.holdout]
        records = _read(options, names, model)
        fitted, held = divided(options, records[:len(paths)], records[len(paths):])
        labels = [Path(path).name or path for path in names]
        apart = held_names(options, labels[:len(paths)], labels[len(paths):])
        found = identify(
            [_source(*each, options) for each in zip(labels, fitted, strict=False)], model=model,
            free=_free(options, model), fixed=fixed, noise=options.noise, step=step,
            holdout=[_source(*each, options) for each in zip(apart, held, strict=True)])
        step("report")
        text = write_json(out / "identify.json", {**finite(found.to_dict()), "records": names})
        save_model(_signed(found, paths), out / "model.yaml")
        if not options.no_report:
            from dfm_stage.cli.identify_report import write_report

            write_report(found, out / "report.html",
                         [record.provenance.words for record in records])
    if options.json:
        print(text, end="")
    else:
        _print(found, out, not options.no_report)
    if not found.estimate.ok:
        raise CheckFailedError(found.estimate.message)
    return 0


def _read(options: argparse.Namespace, names: Sequence[str],
          model: Model | None) -> list[Record]:
    """Read the records at one period: the model's, without a model that of the first record."""
    records: list[Record] = []
    period = None if model is None else model.sample_period
    for path in names:
        record = read_with(options, path, options.axis, period)
        period = record.sample_period if period is None else period
        records.append(_without_start(path, record, options))
    return records


def _without_start(path: str, record: Record, options: argparse.Namespace) -> Record:
    skip = round(options.skip / record.sample_period)
    if len(record) < FEWEST_SAMPLES:
        raise DfmError(f"{path}: {len(record)} samples are too few to identify from: record "
                       f"{FEWEST_SAMPLES} or more")
    if skip < 0 or len(record) - skip < FEWEST_SAMPLES:
        raise DfmError(f"{path}: --skip {options.skip:g} leaves {len(record) - skip} of "
                       f"{len(record)} samples: skip between 0 and "
                       f"{(len(record) - FEWEST_SAMPLES) * record.sample_period:g} s")
    return record.slice(skip) if skip else record


def _source(name: str, record: Record, options: argparse.Namespace) -> Source:
    from dfm_stage.identification import Source

    return Source.of(record, options.axis, name)


def _free(options: argparse.Namespace, model: Model | None) -> list[str] | None:
    only, more = names_in(options.only), names_in(options.free)
    if only:
        return [*only, *more]
    if not more:
        return None
    from dfm_stage.identification.model_fit import DYNAMIC, default_free

    return [*(default_free(model) if model is not None else DYNAMIC), *more]


def _fixed(item: str) -> tuple[str, float | None]:
    name, equals, text = item.partition("=")
    if not equals:
        return name.strip(), None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DfmError(f"--fix {item}: {text!r} is not a number; write --fix mass=1.082")
    return name.strip(), value


def _signed(found: Identification, paths: Sequence[str]) -> Model:
    """Return the model with where it comes from and how well its parameters are known."""
    from dfm_stage.comparison import with_gap
    from dfm_stage.identification.convention import origin_of

    axis = found.sources[0].axis
    gap = max(each.fit.rms for each in found.held_out or found.evaluations)
    return with_gap(replace(found.model, origin={
        "identified_from": [Path(p).name for p in paths], **origin_of(found.conventions),
        "input_unit": axis.input_unit,
        "ci95": {name: [finite(float(x)) for x in q.ci95]
                 for name, q in found.estimate.quantities().items() if q.ci95 is not None}}),
        gap, axis.output_unit)


def _print(found: Identification, out: Path, report: bool) -> None:
    from dfm_stage.identification.convention import sentences

    rows = {**found.headline, **found.estimate.quantities()}
    wide = max(map(len, rows))
    for name, q in rows.items():
        if math.isfinite(q.value):
            print(f"  {name:<{wide}}  {q}")
    for name, value in found.estimate.held.items():
        print(f"  {name:<{wide}}  {format_quantity(value, found.model.parameter(name).unit)} "
              "(held)")
    unit = found.sources[0].axis.output_unit
    for evaluation in (*found.evaluations, *found.held_out):
        what = "held out" if evaluation in found.held_out else "fit"
        percent = evaluation.fit_percent
        said = "at rest" if percent is None else f"{percent:.2f} %"
        print(f"  {what}: {evaluation.source}: {said}, RMS "
              f"{format_quantity(evaluation.fit.rms, unit)}, noise floor "
              f"{format_quantity(evaluation.floor.rms, unit)} "
              f"(from {evaluation.floor.known_from})")
    if found.paper:
        print("  beside the paper's G(s) = 1/(s^2 + 1.705 s + 600.7):")
        for row in found.paper:
            print(f"    {row.symbol:<4} {row.ours}, paper {row.paper:g}, "
                  f"{format_number(row.deviation_percent)} %")
    for test in found.tests:
        print(f"  residual {test.name.replace('_', ' ')}: {test.text} (p = {test.p_value:.2g})")
    for said in sentences(found.conventions):
        print(f"  {said}")
    for warning in found.warnings:
        print(f"  note: {warning}")
    print(f"  identify.json, model.yaml{', report.html' if report else ''} in {out}")

