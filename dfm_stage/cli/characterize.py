"""characterize: static test, free decay, frequency and step response on the node graph."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.cli.command import (
    NO_REPORT,
    PROCESSES,
    SEED,
    Options,
    command,
    dated_folder,
    finite,
    json_option,
    option,
    output_folder,
    write_json,
)
from dfm_stage.cli.graph_run import run_on_graph
from dfm_stage.cli.records import RECORDS, read_with
from dfm_stage.errors import DfmError
from dfm_stage.model import Model, load_model, parse_model
from dfm_stage.recording import Record

if TYPE_CHECKING:
    from dfm_stage.identification.characterisation import Characterisation

KINDS = ("static", "decay", "step", "stepped_sine", "multisine")
EPILOG = """\
examples:
  ./run characterize
  ./run characterize decay --model my_stage.yaml --out tests/decay
  ./run characterize static --bag runs/static
"""
OPTIONS: Options = (
    option("kind", nargs="?", default="all", choices=(*KINDS, "all"),
           help="what to do (default: all)"),
    option("--model", metavar="FILE", help="model.yaml of the simulated stage, a path or a name "
           "in config/models (default: paper_stage; with --bag the bag's own)"),
    option("--experiment", metavar="FILE", help="another experiment of that kind than the one in "
           "config/experiments"),
    option("--bag", metavar="BAG", help="analyse this bag instead of recording one"),
    option("--axis", metavar="NAME", help="axis, where the bag has several"),
    option("--out", metavar="DIR", help="folder for characterize.json, report.html and the bags "
           "(default: characterized/<date and time>)"),
    SEED,
    PROCESSES,
    NO_REPORT,
    *RECORDS,
    json_option("characterize.json"),
)


@command("characterize", __doc__, EPILOG, OPTIONS, lambda options: not options.bag)
def main(options: argparse.Namespace) -> int:
    """Run and analyse characterisation experiments; 0 done, 2 unusable input."""
    if options.kind == "all" and (options.bag or options.experiment):
        raise DfmError("say what the bag or experiment is: characterize "
                       f"{{{','.join(KINDS)}}} --bag BAG")
    from dfm_stage.cli.characterize_report import summary, write_report
    from dfm_stage.identification.characterisation import characterise

    out = dated_folder(options.out, "characterized")
    model = load_model(options.model or "paper_stage") if (
        options.model or not options.bag) else None
    found: dict[str, tuple[Record, Characterisation]] = {}
    for kind in KINDS if options.kind == "all" else (options.kind,):
        record = _record(kind, options, out)
        used = model or _model_of(record)
        result = characterise(kind, record, axis=options.axis,
                              force_constant=used.base.get("force_constant") if used else None)
        found[kind] = record, result
        if not options.json:
            _print(kind, result, summary(kind, result))
    content = {"schema": 1, "model": model.name if model else None,
               "results": {kind: result.to_dict() for kind, (_, result) in found.items()},
               "records": {kind: record.provenance.source for kind, (record, _) in found.items()}}
    folder = output_folder(out)
    text = write_json(folder / "characterize.json", finite(content))
    if not options.no_report:
        write_report(found, folder / "report.html", model)
    if options.json:
        print(text, end="")
        return 0
    print(f"  characterize.json{'' if options.no_report else ', report.html'} in {folder}")
    return 0


def _record(kind: str, options: argparse.Namespace, out: Path) -> Record:
    if options.bag:
        return read_with(options, options.bag, options.axis)
    from dfm_stage.identification.characterisation import EXPERIMENTS

    bag = out / kind
    if bag.exists():
        raise DfmError(f"{bag} is already there; choose another folder with --out")
    return run_on_graph(options.experiment or EXPERIMENTS[kind], bag,
                        model=options.model or "paper_stage", seed=options.seed,
                        composed=not options.processes, label=f"  {kind}")


def _model_of(record: Record) -> Model | None:
    """Return the model that the bag carries, if it does."""
    if not record.provenance.model:
        return None
    model = parse_model(record.provenance.model, record.provenance.source)
    return model.axis(next(iter(record.axes))) if model.axes else model


def _print(kind: str, result: Any, told: Iterable[tuple[str, Any]]) -> None:
    print(kind.replace("_", " "))
    for name, q in told:
        print(f"  {name:<34} {q}")
    if kind == "decay":
        print(f"  over {result.cycles:g} cycles; from two extremes alone "
              f"{result.two_point:.6f}")
    if kind in ("stepped_sine", "multisine"):
        print(f"  misfit of one mode {100 * result.constrained.misfit:.2f} % RMS at "
              f"{result.response.omega.size} frequencies")
        if len(result.likely.plant.modes) > 1:
            print("  a second mode stands out at "
                  f"{result.likely.plant.modes[1].natural_frequency_hz:.3f} Hz")

