"""diagnose_batch: diagnose many bags or files, each by itself, on all cores or on a cluster."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from dfm_stage.cli.batch import Job, Outcome, run_batch
from dfm_stage.cli.command import command, option, output_folder, write_json
from dfm_stage.errors import DfmError
from dfm_stage.model import load_model

EPILOG = """\
examples:
  ./run diagnose_batch runs/* --model found/model.yaml --out diagnosed
  ./run diagnose_batch runs/* --model m.yaml --cluster tcp://10.0.0.1:8786
  ./run diagnose_batch runs/* --model m.yaml --options="--no-report --axis x"
"""
OPTIONS = (
    option("runs", nargs="+", metavar="RUN", help="bag folders, .mcap, .csv, ..."),
    option("--model", required=True, metavar="FILE", help="as for diagnose"),
    option("--out", default="diagnosed", metavar="DIR",
           help="folder for a folder of each run and batch.json (default: %(default)s)"),
    option("--jobs", type=int, default=len(os.sched_getaffinity(0)), metavar="N",
           help="how many at once on this machine (default: one per core)"),
    option("--cluster", default="", metavar="ADDRESS",
           help="address of a Dask scheduler to use instead"),
    option("--options", default="", metavar="TEXT",
           help="further options of diagnose: --options=\"--axis x\""),
)


@command("diagnose_batch", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Diagnose each run; 0 all were answered, 1 some were not, 2 unusable input."""
    load_model(options.model)
    if options.jobs < 1:
        raise DfmError(f"--jobs {options.jobs}: give at least 1")
    names = [Path(run).resolve().name for run in options.runs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise DfmError(f"{twice[0]}: two runs have this name, and their results would share a "
                       "folder; rename one")
    out = output_folder(options.out)
    model = Path(options.model)
    named = str(model.resolve()) if model.is_file() else options.model
    jobs = [Job(run, (str(Path(run).resolve()), "--model", named, "--out",
                      str((out / name).resolve()), *options.options.split()))
            for run, name in zip(options.runs, names, strict=True)]
    outcomes: list[Outcome] = []
    for outcome in run_batch(jobs, options.jobs, options.cluster):
        outcomes.append(outcome)
        print(f"[{len(outcomes)}/{len(jobs)}] {outcome.run}: "
              f"{outcome.words or 'diagnosed'} ({outcome.seconds:.1f} s)", file=sys.stderr)
    outcomes.sort(key=lambda each: options.runs.index(each.run))
    write_json(out / "batch.json", [vars(each) for each in outcomes])
    failed = sum(each.code != 0 for each in outcomes)
    print(f"{len(outcomes) - failed} of {len(outcomes)} diagnosed; {out / 'batch.json'}")
    return 1 if failed else 0
