"""paper: repeat the paper's experiments on the simulated stage, its numbers beside ours."""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.cli.command import (
    PROCESSES,
    SEED,
    command,
    dated_folder,
    json_option,
    new_folder,
    option,
    write_json,
)
from dfm_stage.cli.graph_run import run_on_graph
from dfm_stage.model import Model, load_model, save_model
from dfm_stage.quantity import format_number, format_quantity
from dfm_stage.recording import Record
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import Experiment, load_experiment

if TYPE_CHECKING:
    from dfm_stage.paper.row import Row
    from dfm_stage.paper.workflow import Comparison

EPILOG = """\
examples:
  ./run paper
  ./run paper --quick --out quick
  ./run paper --model my_stage.yaml
"""
OPTIONS = (
    *(option(name, default=default, metavar="FILE", help=f"model.yaml of {what}, a path or a name "
             "in config/models (default: %(default)s)") for name, default, what in (
        ("--model", "paper_stage", "the stage"),
        ("--two-mode-model", "paper_two_mode", "the stage of the LQR section"),
        ("--xy-model", "xy_stage", "the XY stage"))),
    option("--out", metavar="DIR", help="new folder for paper.json, report.html and the bags "
           "(default: paper/<date and time>)"),
    SEED,
    option("--quick", action="store_true", help="simulate the stage directly instead of through "
           "the node graph: same signals and analysis, no bags"),
    PROCESSES,
    json_option("paper.json"),
)


@command("paper", __doc__, EPILOG, OPTIONS, lambda options: not options.quick)
def main(options: argparse.Namespace) -> int:
    """Compare with the paper; 0 done, 2 unusable input."""
    from dfm_stage.paper.report import write_page
    from dfm_stage.paper.row import as_json
    from dfm_stage.paper.stage import DirectStage
    from dfm_stage.paper.workflow import NAMES, STEPS, Models, compare

    models = Models(load_model(options.model), load_model(options.two_mode_model),
                    load_model(options.xy_model))
    experiments = {name: load_experiment(find_experiment(name)) for name in NAMES}
    folder = new_folder(dated_folder(options.out, "paper"))
    stage = (DirectStage(options.seed) if options.quick else
             GraphStage(folder, options.seed, not options.processes))
    started = time.monotonic()
    numbers = itertools.count(1)

    def step(name: str) -> None:
        print(f"[{next(numbers):2d}/{STEPS}, {time.monotonic() - started:4.0f} s] {name}",
              file=sys.stderr, flush=True)

    # Half as many elements per blade are 0.4 % stiffer.
    found = compare(stage, models, experiments, step, elements=32 if options.quick else 96)
    seconds = time.monotonic() - started
    used = {"model": models.stage.name, "two_mode_model": models.two_mode.name,
            "xy_model": models.xy.name, "records": stage.description}
    text = write_json(folder / "paper.json", as_json(found.rows, used))
    write_page(found, folder / "report.html",
               {**used, "Seed": options.seed, "Took": f"{seconds:.0f} s"})
    if options.json:
        print(text, end="")
        return 0
    _print(found, seconds)
    print(f"paper.json, report.html{'' if options.quick else ' and the bags'} in {folder}")
    return 0


@dataclass
class GraphStage:
    """Runs every experiment on a node graph of its own, in lockstep, into a bag."""

    folder: Path
    seed: int = 0
    composed: bool = True

    @property
    def description(self) -> str:
        """What the records come from."""
        return "bags of the node graph in lockstep" + ("" if self.composed else
                                                       ", one process per node")

    def run(self, experiment: Experiment, model: Model, design: Model | None = None) -> Record:
        """Run the experiment on `model` and return the record of its bag."""
        controller: dict[str, Any] = (dict(experiment.controller)
                                      if not isinstance(experiment.controller, str) else {})
        if experiment.mode == "lqr":
            controller["model"] = self._saved(design or model)
        content = {
            "name": experiment.name, "mode": experiment.mode, "seed": experiment.seed,
            "duration_s": experiment.duration_s, "controller": controller,
            "axes": {axis: {part: dict(signal) for part, signal in (
                ("reference", spec.reference), ("excitation", spec.excitation))
                if signal is not None} for axis, spec in experiment.axes.items()}}
        return run_on_graph(content, self._free(experiment.name), model=self._saved(model),
                            seed=self.seed, axes=tuple(experiment.axes), composed=self.composed)

    def _free(self, name: str) -> Path:
        """Return a folder for a bag that is not there yet."""
        path = next(path for path in _numbered(self.folder / "bags", name) if not path.exists())
        path.parent.mkdir(exist_ok=True)
        return path

    def _saved(self, model: Model) -> str:
        """Write a model beside the bags, once for each different one, and return its path."""
        bare, models = replace(model, document=None), self.folder / "models"
        models.mkdir(exist_ok=True)
        path = next(path for path in _numbered(models, model.name, ".yaml") if not path.exists()
                    or replace(load_model(path), document=None) == bare)
        if not path.exists():
            save_model(bare, path)
        return str(path.resolve())


def _numbered(folder: Path, name: str, suffix: str = "") -> Iterator[Path]:
    """Yield name, name_2, name_3 and so on in a folder."""
    return (folder / f"{name}{'' if number == 1 else f'_{number}'}{suffix}"
            for number in itertools.count(1))


def _print(found: Comparison, seconds: float) -> None:
    from dfm_stage.paper.report import tally

    def shown(value: float | None, unit: str) -> str:
        return "-" if value is None else format_quantity(value, unit)

    def line(row: Row) -> str:
        off = row.deviation_percent
        deviation = "" if off is None else f"{format_number(off, 3)} %"
        paper = shown(row.paper, row.unit) + ("*" if row.kind == "derived" else "")
        return f"{row.id:<30} {paper:>16} {shown(row.ours, row.unit):>16} {deviation:>11}"

    print(f"{'row':<30} {'paper':>16} {'ours':>16} {'deviation':>11}   reason")
    for row in found.rows:
        print(f"{line(row)}   {row.reason}")
    within, outside, without = tally(found.rows)
    print(f"* follows from printed numbers. {len(found.rows)} rows: {within} within 1 %, "
          f"{outside} further off, {without} without a number in the paper; {seconds:.0f} s")

