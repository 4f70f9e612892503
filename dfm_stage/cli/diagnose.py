"""diagnose: which physical effect a model lacks, confirmed on records that were not fitted."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from ruamel.yaml import YAML

from dfm_stage.cli.command import (
    NO_REPORT,
    TONES,
    Options,
    command,
    json_option,
    names_in,
    option,
    output_folder,
    paint,
    write_json,
    write_output,
)
from dfm_stage.cli.progress import steps
from dfm_stage.cli.records import RECORDS, SPLIT, divided, held_names, read_with
from dfm_stage.errors import DfmError
from dfm_stage.model import Model, load_model, save_model
from dfm_stage.model.formula_file import read_formulas
from dfm_stage.model.registry import ALL, effects_of, library_of
from dfm_stage.quantity import format_quantity
from dfm_stage.recording import at_period, shared_period

if TYPE_CHECKING:
    from dfm_stage.diagnosis import Diagnosis

EPILOG = """\
examples:
  ./run diagnose runs/multisine --holdout runs/scan --model found/model.yaml --out diagnosis
  ./run diagnose log.csv --model m.yaml --time t --input iq --output theta --output-unit rad
  ./run diagnose log.csv --model m.yaml --from 2 --to 60 --split 0.75
  ./run diagnose log.csv --model m.yaml --effect cable.yaml   # a formula of yours
  ./run diagnose log.csv --model m.yaml --accept diagnosed/formula_1.yaml --out accepted
  ./run diagnose runs/multisine --model m.yaml --run stage.yaml   # and the next experiment
"""
OPTIONS: Options = (
    option("runs", nargs="+", metavar="RUN",
           help="bag folder, .mcap, .csv, .npz or .mat; several are fitted together"),
    option("--model", required=True, metavar="FILE",
           help="the model that should explain them: model.yaml or a name in config/models"),
    option("--holdout", action="append", default=[], metavar="RUN",
           help="a record to predict and never to fit, best of another kind; without one, the "
           "last 30 %% of each record"),
    option("--out", default="diagnosed", metavar="DIR",
           help="folder for diagnosis.json, model.yaml, report.html, next_experiment.yaml, "
           "missing_force.csv and formulas (default: %(default)s)"),
    option("--effect", action="append", default=[], metavar="FILE",
           help="formulas (.yaml) or an effect (.py) that may be named beside the library, or a "
           "folder of such files"),
    option("--accept", action="append", default=[], metavar="FILE",
           help="add an offered formula (formula_1.yaml) to the model, and show what it does to "
           "the gap; repeatable"),
    option("--axis", metavar="NAME", help="axis, where a record has several"),
    *(option(name, action="append", default=[], metavar="NAME[,NAME]", help=words)
      for name, words in (
          ("--library", "effects that may be named, or all (default: common, then uncommon)"),
          ("--without", "effects that may not be named"),
          ("--free", "re-estimate these as well, for instance mass"),
          ("--fix", "hold these at the model's values"))),
    option("--run", metavar="STAGE",
           help="perform the next experiment on the node graph, with this model.yaml as the "
           "stage, and diagnose again with the new bag"),
    option("--rounds", type=int, default=1, metavar="N",
           help="how often --run does so (default: %(default)s)"),
    option("--seed", type=int, default=0, help="fixes what is shuffled (default: 0)"),
    SPLIT,
    *RECORDS,
    json_option("diagnosis.json"),
    NO_REPORT,
)


ACCEPT = "to add one to the model: the same command with --accept {}, and another --out"


@command("diagnose", __doc__, EPILOG, OPTIONS, lambda options: options.run)
def main(options: argparse.Namespace) -> int:
    """Diagnose bags or CSV files; 0 a verdict was reached, 2 unusable input."""
    with effects_of(options.effect):
        return _rounds(options)


def _rounds(options: argparse.Namespace) -> int:
    """Diagnose, and again with each further experiment."""
    model = load_model(options.model)
    out = output_folder(options.out)
    given = Path(options.model)
    replaced = given.read_bytes() if given.resolve() == (out / "model.yaml").resolve() else None
    fitted, held = list(options.runs), list(options.holdout)
    found = _once(options, model, fitted, held, out, replaced)
    for number in range(1, options.rounds + 1 if options.run else 0):
        if found.next_experiment is None:
            break
        bag = out / f"round_{number}"
        _perform(options, found, bag)
        fitted.append(str(bag))
        found = _once(options, model, fitted, held, out)
    return 0


GIVEN = "model_given{}.yaml"
"""A model that was given, where the one to go on with takes its place; from the second on with a
number."""


def _keep_given(content: bytes, out: Path) -> None:
    places = (out / GIVEN.format("" if number == 1 else f"_{number}") for number in count(1))
    path = next(p for p in places if not p.exists() or p.read_bytes() == content)
    write_output(path, content)
    print(f"diagnose: model.yaml in {out} is replaced by the model to go on with; the one given "
          f"is kept as {path.name}", file=sys.stderr)


def _once(options: argparse.Namespace, model: Model, fitted: Sequence[str], held: Sequence[str],
          out: Path, replaced: bytes | None = None) -> Diagnosis:
    """Diagnose once; `replaced` is the content of the model file that the answer replaces."""
    from dfm_stage.diagnosis import diagnose
    from dfm_stage.diagnosis.formula_offer import accepted_in
    from dfm_stage.identification.model_fit import default_free

    library = names_in(options.library) or None
    for name in names_in(options.without):
        if name not in (among := library_of(library or [ALL])):
            raise DfmError(f"--without {name}: there is no such effect among "
                           f"{', '.join(among)}")
    accepted = [f for path in options.accept for f in read_formulas(Path(path))]
    one = accepted_in(model.axis(model.usual_axis(options.axis)), accepted)
    with steps("diagnose", options.json) as step:
        step("reading")
        read = [[read_with(options, path) for path in paths] for paths in (fitted, held)]
        period = shared_period(read[0], model.sample_period)
        records, holdout = divided(options, *([at_period(record, period) for record in records]
                                              for records in read))
        names = [Path(path).name or path for path in fitted]
        names += held_names(options, names, [Path(path).name or path for path in held])
        found = diagnose(records, replace(model, sample_period=period), holdout=holdout,
                         axis=options.axis, library=library, without=names_in(options.without),
                         free=[*default_free(one), *names_in(options.free)],
                         fixed=names_in(options.fix),
                         names=names, seed=options.seed, accept=accepted, step=step)
        if period != model.sample_period:
            found = replace(found, warnings=(*found.warnings, (
                f"fitted at the records' own period of {period:.9g} s, not at the model's "
                f"{model.sample_period:.9g} s")))
        step("writing")
        text = write_json(out / "diagnosis.json", {
            **found.to_dict(), "records": list(fitted), "holdout": list(held),
            "recorded_ns": [each.provenance.start_ns for each in records]})
        if replaced is not None:
            _keep_given(replaced, out)
        save_model(replace(_with_gap(found), sample_period=model.sample_period),
                   out / "model.yaml")
        _next(found, out / "next_experiment.yaml")
        _surface(found, out)
        _formulas(found, out, [*options.accept, *options.effect])
    # the answer first: the page takes as long to draw as a short record to diagnose
    if options.json:
        print(text, end="", flush=True)
    else:
        _print(found, out, not options.no_report)
    if not options.no_report:
        with steps("diagnose", options.json) as step:
            step("report.html")
            from dfm_stage.cli.diagnose_report import write_report

            write_report(found, out / "report.html",
                         [each.provenance.words for each in (*records, *holdout)], options.model)
    return found


def _with_gap(found: Diagnosis) -> Model:
    """The model with the gap that it leaves on held-out records, where whole ones were judged."""
    from dfm_stage.comparison import with_gap

    gap = found.gap
    if gap.judged != "position" or gap.window_s is not None:
        return found.model
    return with_gap(found.model, gap.held_out[2], gap.unit)


def _next(found: Diagnosis, path: Path) -> None:
    if found.next_experiment is None:
        path.unlink(missing_ok=True)
        return
    text = StringIO()
    YAML().dump(dict(found.next_experiment), text)
    write_output(path, text.getvalue())


def _surface(found: Diagnosis, out: Path) -> None:
    from dfm_stage.diagnosis.surface import FILE

    if found.surface is None:
        (out / FILE).unlink(missing_ok=True)
        return
    write_output(out / FILE, found.surface.to_csv())


def _formulas(found: Diagnosis, out: Path, given: Sequence[str]) -> None:
    """One file for each formula that is offered, and none of an earlier answer but the `given`."""
    kept = {Path(path).resolve() for path in given}
    for path in out.glob("formula_[1-9].yaml"):
        if path.resolve() not in kept:
            path.unlink()
    for offer in found.formulas:
        text = StringIO()
        text.write(f"# Offered by diagnose: {offer.share:.0%} of the held-out gap.\n"
                   f"# diagnose --accept {offer.file} adds it to the model.\n")
        yaml = YAML()
        yaml.default_flow_style = None  # one line a parameter
        yaml.dump({"effects": [offer.formula.to_dict(
            {p.name: p.value for p in offer.formula.parameters})]}, text)
        write_output(out / offer.file, text.getvalue())


def _perform(options: argparse.Namespace, found: Diagnosis, bag: Path) -> None:
    from dfm_stage.cli.graph_run import run_on_graph

    experiment = dict(found.next_experiment or {})
    if bag.exists():
        raise DfmError(f"{bag} is there already; choose another folder with --out")
    print(f"  {experiment['name']} on the node graph, stage {options.run}")
    axis = options.axis or "x"
    experiment["axes"] = {axis: next(iter(experiment["axes"].values()))}
    run_on_graph(experiment, bag, model=options.run, seed=options.seed, axes=(axis,))


def _print(found: Diagnosis, out: Path, report: bool) -> None:
    from dfm_stage.diagnosis.surface import FILE
    from dfm_stage.diagnosis.wording import NO_FORMULA, formula, missing_force
    from dfm_stage.identification.convention import sentences

    print(f"{paint(found.verdict, TONES[found.verdict])}: {found.sentence}")
    for effect in found.effects:
        print(f"  {' or '.join(effect.members)}  ({effect.gap_share:.0%} of the gap)")
        for name, q in effect.parameters.items():
            print(f"    {name}: {format_quantity(q.value, q.unit, q.ci95)}")
    gap, unit = found.gap, found.gap.unit
    words = ("before", "retuned", "after")
    for what, values in (("fitted", gap.fit), ("held out", gap.held_out)):
        print(f"  RMS {what}: " + ", ".join(f"{w} {format_quantity(v, unit)}" for w, v in
                                            zip(words, values, strict=True)))
    print(f"  noise floor {format_quantity(gap.noise_floor, unit)} (from "
          f"{gap.noise_floor_from})")
    if found.surface is not None:
        print(f"  {missing_force(found.surface)}")
        for offer in found.formulas:
            print(f"  {formula(offer)}")
        print(f"  {ACCEPT.format(out / found.formulas[0].file)}" if found.formulas
              else f"  {NO_FORMULA}")
    if found.next_experiment is not None:
        print(f"  next experiment: {found.next_experiment['description']}")
    for said in sentences(found.conventions):
        print(f"  {said}")
    for warning in found.warnings:
        print(f"  note: {warning}")
    files = ["diagnosis.json", "model.yaml", *(["report.html"] if report else []),
             *(["next_experiment.yaml"] if found.next_experiment is not None else []),
             *(offer.file for offer in found.formulas),
             *([FILE] if found.surface is not None else [])]
    print(f"  {', '.join(files)} in {out}", flush=True)
