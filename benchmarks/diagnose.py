"""Blind trials of the diagnosis, with frozen seeds and with fresh ones.

The cases come from `benchmarks.corpus`, which shares no code with the library. Every answer is
kept as a file when it is given, the labels in a folder beside; the figures are made from these
files alone. `./run bench diagnose --cases N --seed S --resume --keep DIR`.
"""

from __future__ import annotations

import json
import os
import secrets
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from benchmarks.blind.rates import beside, figures_of, report
from benchmarks.blind.scoring import Score, judge
from benchmarks.blind.trial import Job, diagnosed, one_thread_each, run_case
from benchmarks.corpus import case_plan, make_case
from benchmarks.corpus.case_files import write_whole
from benchmarks.figure import Figure

SEED = 20_261_121
CASES, QUICK_CASES = 107, 12
KEEP = Path(__file__).resolve().parents[1] / ".dfm" / "bench" / "diagnose"
LONG_SAMPLES = 60_000
BASELINES = ("pysindy", "stepwise_bic")


def run_all(todo: Sequence[Job], jobs: int, run: Callable[[Job], Path] = run_case) -> list[Path]:
    """Run cases in processes; return the files of the answers, none of a case left out."""
    one_thread_each()
    begin = time.monotonic()
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(run, job) for job in todo]
        try:
            for number, done in enumerate(as_completed(waiting), start=1):
                done.result()
                if number % 10 == 0 or number == len(todo):
                    print(f"seed {todo[0].spec.seed}: {number} of {len(todo)} cases, "
                          f"{time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [job.answer_path for job in todo if job.answer_path.exists()]


def read_scores(answers: Sequence[Path], whose: str = "answer") -> list[Score]:
    """Judge kept answers, ours or a baseline's, by the labels beside them."""
    scores = []
    for path in answers:
        kept = json.loads(path.read_text("utf-8"))
        label = json.loads((path.parents[1] / "labels" / path.name).read_text("utf-8"))
        if whose in kept:
            seconds = kept["seconds" if whose == "answer" else f"{whose}_seconds"]
            scores.append(judge(label, kept[whose], seconds))
    return scores


def measured(cases: int, seed: int, keep: Path, resume: bool, jobs: int,
             suffix: str) -> list[Figure]:
    """Figures of one seed; its report is printed and kept as `report.txt`."""
    folder = keep / f"seed_{seed}"
    begin = time.monotonic()
    answers = run_all([Job(spec, folder, resume=resume) for spec in case_plan(cases, seed)], jobs)
    scores = read_scores(answers)
    others = {name: read_scores(answers, name) for name in BASELINES}
    text = report(scores, others)
    text += f"\n\n{len(scores)} cases of seed {seed}, {time.monotonic() - begin:.0f} s\n"
    write_whole(folder / "report.txt", text)
    print(text, flush=True)
    ours = figures_of(scores, suffix)
    return ours if suffix else beside(ours, others)


def long_record() -> Figure:
    """Wall time of one diagnosis of 60 s records with the whole library, all cores."""
    spec = next(s for s in case_plan(CASES, SEED) if s.kind == "pair")
    case = make_case(spec, LONG_SAMPLES)
    begin = time.monotonic()
    verdict = diagnosed(case)["verdict"]
    return Figure("diagnose.seconds", time.monotonic() - begin, "s", 120.0, how=(
        f"one case, {len(case.records)} records of 60 s and {len(case.holdout)} held out, "
        f"{'+'.join(spec.effects)}: {verdict}; {len(os.sched_getaffinity(0))} cores"),
        bar_kind="at most")


def figures(quick: bool = False, *, cases: int | None = None, seed: int | None = None,
            resume: bool = False, keep: Path | None = None,
            jobs: int | None = None) -> list[Figure]:
    """Rates of the frozen seed, of a fresh one, and (not if quick) the time of a long record.

    `keep` is the folder of the answers. With `resume` cases answered there are not run again, and
    the fresh seed is the one drawn there before.
    """
    count = cases or (QUICK_CASES if quick else CASES)
    folder = keep or KEEP
    workers = jobs or len(os.sched_getaffinity(0))
    found = [] if quick else [long_record()]
    found += measured(count, SEED if seed is None else seed, folder, resume, workers, "")
    return found + measured(count, _fresh_seed(folder, resume), folder, resume, workers,
                            ".fresh")


def _fresh_seed(folder: Path, resume: bool) -> int:
    path = folder / "fresh_seed.json"
    if resume and path.exists():
        return int(json.loads(path.read_text("utf-8")))
    drawn = secrets.randbelow(2**31)
    write_whole(path, f"{drawn}\n")
    return drawn
