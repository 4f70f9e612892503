"""diagnose_batch: diagnose many bags or files, each by itself, on all cores or on a cluster."""

# Every run is answered by the command `diagnose` itself, in a process of its own, so one that
# fails or grows takes nothing with it.

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dfm_stage.cli.command import command, option, output_folder, write_json
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.errors import DfmError
from dfm_stage.model import load_model
from dfm_stage.processors import usable_cores

EPILOG = """\
examples:
  ./run diagnose_batch runs/* --model found/model.yaml --out diagnosed
  ./run diagnose_batch runs/* --model m.yaml --cluster tcp://10.0.0.1:8786
  ./run diagnose_batch runs/* --model m.yaml --options="--no-report --axis x"
"""
CONNECT_S = 20.0
# the runs are what is parallel; inside each one thread
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                            "NUMBA_NUM_THREADS"), "1")
OPTIONS = (
    option("runs", nargs="+", metavar="RUN", help="bag folders, .mcap, .csv, ..."),
    option("--model", required=True, metavar="FILE", help="as for diagnose"),
    option("--out", default="diagnosed", metavar="DIR",
           help="folder for a folder of each run and batch.json (default: %(default)s)"),
    option("--jobs", type=int, default=usable_cores(), metavar="N",
           help="how many at once on this machine (default: one per core)"),
    option("--cluster", default="", metavar="ADDRESS",
           help="address of a Dask scheduler to use instead"),
    option("--options", default="", metavar="TEXT",
           help="further options of diagnose: --options=\"--axis x\""),
)


@dataclass(frozen=True)
class Job:
    """One run, and the arguments of `diagnose` for it."""

    run: str
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """How one diagnosis ended: exit code, time taken, and its last line of complaint, if any."""

    run: str
    code: int
    seconds: float
    words: str = ""


def work(job: Job) -> Outcome:
    """Diagnose one run, wherever this is called."""
    begun = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "dfm_stage", "diagnose", *job.arguments],
                          stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
                          env={**os.environ, **ONE_THREAD})
    lines = done.stderr.strip().splitlines() if done.returncode else []
    return Outcome(job.run, done.returncode, time.monotonic() - begun, lines[-1] if lines else "")


def run_batch(jobs: Sequence[Job], processes: int, scheduler: str = "") -> Iterator[Outcome]:
    """Do all jobs; yields each outcome as it comes, in any order.

    Parameters
    ----------
    processes : int
        How many at once on this machine.
    scheduler : str
        Address of a Dask scheduler, such as `tcp://10.0.0.1:8786`, to use instead. Its workers
        need this package, and the files under the same paths.

    Raises
    ------
    DiagnosisError
        If the cluster is not there, or the package `distributed`.
    """
    if scheduler:
        yield from _on_cluster(jobs, scheduler)
        return
    with ThreadPoolExecutor(max(1, processes)) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            for future in futures:
                future.cancel()


def _on_cluster(jobs: Sequence[Job], scheduler: str) -> Iterator[Outcome]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise DiagnosisError(f"cluster {scheduler}: Dask is not installed here; pip install "
                             "'dfm_stage[cluster]', or leave --cluster out") from None
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        raise DiagnosisError(f"cluster {scheduler}: cannot be reached ({error}); start a Dask "
                             "scheduler there, or leave --cluster out") from None
    with client:
        for _, outcome in distributed.as_completed(client.map(work, jobs, pure=False),
                                                   with_results=True):
            yield outcome


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
