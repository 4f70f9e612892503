"""diagnose_batch: diagnose many bags or files, each by itself, on all cores or on a cluster.

The summary tells how often each effect was found, and how parameters change over time.
"""

# Every run is answered by the command `diagnose` itself, in a process of its own, so one that
# fails or grows takes nothing with it.

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
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
  ./run diagnose_batch runs/* --model m.yaml --resume       # after an interruption
  ./run diagnose_batch runs/* --model m.yaml --options="--no-report --axis x"
"""
CONNECT_S = 20.0
FILES = ("summary.html", "summary.json", "summary.csv")
# the runs are what is parallel; inside each one thread
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                            "NUMBA_NUM_THREADS"), "1")
OPTIONS = (
    option("runs", nargs="+", metavar="RUN", help="bag folders, .mcap, .csv, ..."),
    option("--model", required=True, metavar="FILE", help="as for diagnose"),
    option("--out", default="diagnosed", metavar="DIR",
           help="folder for a folder of each run, summary.html, summary.json, summary.csv and "
           "batch.json (default: %(default)s)"),
    option("--resume", action="store_true",
           help="keep what an earlier batch in --out answered of the same runs"),
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
    lines = done.stderr.strip().splitlines()
    words = "" if done.returncode == 0 else f"ended by signal {-done.returncode}" \
        if done.returncode < 0 else lines[-1].removeprefix("error: ") if lines \
        else f"exit code {done.returncode}"
    return Outcome(job.run, done.returncode, time.monotonic() - begun, words)


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


def folders(runs: Sequence[Path]) -> list[str]:
    """A folder's name for each run: its own, with those of the folders it lies in as far as others
    have the same, and a number where that is still taken."""
    found: list[str] = []
    for run in runs:
        rivals = {other.parts[::-1] for other in runs if other.name == run.name and other != run}
        own = run.parts[::-1]
        depth = 1
        while depth < len(own) - 1 and any(own[:depth] == each[:depth] for each in rivals):
            depth += 1
        name = base = "_".join(own[:depth][::-1])
        number = 1
        while name in found:
            number += 1
            name = f"{base}_{number}"
        found.append(name)
    return found


def kept(out: Path, jobs: Mapping[str, Job]) -> list[Outcome]:
    """What an earlier batch in the same folder answered, of the same runs by the same options."""
    try:
        known = json.loads((out / "batch.json").read_text("utf-8"))
    except (OSError, ValueError):
        return []
    return [Outcome(each["run"], 0, each["seconds"]) for each in known
            if each["code"] == 0 and each["run"] in jobs
            and each.get("arguments") == list(jobs[each["run"]].arguments)
            and (out / each["folder"] / "diagnosis.json").exists()]


def summarised(outcomes: Sequence[Outcome], names: Mapping[str, str], out: Path,
               model: str) -> str:
    """Write the summary of a batch, and return it in a sentence."""
    from dfm_stage.cli.batch_summary import write_summary
    from dfm_stage.diagnosis.history import Answer, history

    answers, failed = [], []
    for each in outcomes:
        answer = out / names[each.run] / "diagnosis.json"
        if each.code == 0 and answer.exists():
            content = json.loads(answer.read_text("utf-8"))
            recorded = content["recorded_ns"][0]
            answers.append(Answer(names[each.run], content, None if recorded is None
                                  else recorded * 1e-9, Path(each.run).stat().st_mtime))
        else:
            failed.append({"run": each.run, "words": each.words or f"{answer} is not there"})
    return write_summary(history(answers), failed, out, model)


@command("diagnose_batch", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """Diagnose each run; 0 all were answered, 1 some were not, 2 unusable input."""
    load_model(options.model)
    if options.jobs < 1:
        raise DfmError(f"--jobs {options.jobs}: give at least 1")
    runs: dict[Path, str] = {}
    for run in options.runs:                        # one that is named twice is answered once
        runs.setdefault(Path(run).resolve(), run)
    names = dict(zip(runs.values(), folders(list(runs)), strict=True))
    out = output_folder(options.out)
    model = Path(options.model)
    named = str(model.resolve()) if model.is_file() else options.model
    jobs = {run: Job(run, (str(path), "--model", named, "--out",
                           str((out / names[run]).resolve()), *options.options.split()))
            for path, run in runs.items()}
    outcomes = {each.run: each for each in (kept(out, jobs) if options.resume else [])}
    left = [job for run, job in jobs.items() if run not in outcomes]
    for outcome in run_batch(left, options.jobs, options.cluster):
        outcomes[outcome.run] = outcome
        print(f"[{len(outcomes)}/{len(jobs)}] {outcome.run}: "
              f"{outcome.words or 'diagnosed'} ({outcome.seconds:.1f} s)", file=sys.stderr)
        _keep(out, outcomes, jobs, names)
    _keep(out, outcomes, jobs, names)
    in_order = [outcomes[run] for run in jobs]
    print(f"{summarised(in_order, names, out, options.model)}\n"
          f"{', '.join((*FILES, 'batch.json'))} in {out}")
    return 1 if any(each.code != 0 for each in in_order) else 0


def _keep(out: Path, outcomes: Mapping[str, Outcome], jobs: Mapping[str, Job],
          names: Mapping[str, str]) -> None:
    """Write batch.json: what is answered so far, in the order of the runs."""
    write_json(out / "batch.json", [
        {**vars(outcomes[run]), "folder": names[run], "arguments": list(job.arguments)}
        for run, job in jobs.items() if run in outcomes])
