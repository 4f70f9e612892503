"""Blind trials of the diagnosis on the measured-like corpus.

    ./run exec python -m benchmarks.blind.measured --seed 30001 --keep DIR \
        --cases remainder=64 outsider=23 nuisance=19 convention=24

Every case is written as files, read as a user's files are, and answered; answers, with labels in
a folder apart, are kept when they are given, and the figures are made from these files alone.
`--fresh` draws a seed and keeps it in DIR. `--held N` adds N records of a held input, and N of
other conventions, of which only the convention is asked. `--pseudo N` then fits the first N cases
with a remainder, where they are named, to longer records without noise (slow), and judges the
intervals by that; `--longer K` says how many times as long.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.blind.measured_scoring import (
    MeasuredScore,
    Timing,
    judge_measured,
    judge_timing,
    measured_figures,
    measured_report,
)
from benchmarks.blind.trial import answered_before, one_thread_each, timed
from benchmarks.corpus.case_files import write_case, write_whole
from benchmarks.corpus.measured import (
    MeasuredCase,
    MeasuredSpec,
    convention_record,
    held_record,
    make_case,
    measured_plan,
)
from benchmarks.corpus.measured.case import long_records
from benchmarks.corpus.measured.plan import GROUPS
from benchmarks.corpus.measured.plant import HELD
from benchmarks.corpus.measured.truth import make_setup

DEVELOPMENT_SEED = 30_001
CASES = {"remainder": 320, "outsider": 207, "nuisance": 304, "convention": 96}
LONGER = 20
"""Records of pseudo-true values over those of the case."""
TIMING = "timing.json"
Find = Callable[[dict[str, Any], float, Mapping[str, float]], Mapping[str, Any]]
"""From columns, sample period and base parameters to an entry of `conventions`."""


@dataclass(frozen=True)
class MeasuredJob:
    """A case to run, and the folder its answer goes to."""

    spec: MeasuredSpec
    folder: Path
    resume: bool = True
    longer: int = LONGER

    @property
    def name(self) -> str:
        """Of the files of this case."""
        return f"{self.spec.group}_{self.spec.index:05d}.json"

    @property
    def answer_path(self) -> Path:
        """The file of the answer."""
        return self.folder / "answers" / self.name

    @property
    def label_path(self) -> Path:
        """The file of the label."""
        return self.folder / "labels" / self.name

    @property
    def pseudo_path(self) -> Path:
        """The file of the pseudo-true values."""
        return self.folder / "pseudo_true" / self.name


def diagnosed_files(case: MeasuredCase) -> dict[str, Any]:
    """The library's answer, as diagnosis.json holds it, to a case read from its files."""
    from dfm_stage.diagnosis import diagnose
    from dfm_stage.model import load_model
    from dfm_stage.recording import read_record

    with tempfile.TemporaryDirectory(prefix="dfm_case_") as place:
        folder = write_case(case, Path(place), Path(place) / "labels")
        (Path(place) / "labels" / f"{folder.name}.json").unlink()
        runs = [read_record(path) for path in sorted(folder.glob("run_*.csv"))]
        held = [read_record(path) for path in sorted(folder.glob("holdout_*.csv"))]
        result = diagnose(runs, load_model(folder / "model.yaml"), holdout=held)
        text = json.dumps(result.to_dict()).replace(f"{folder}/", "")
    answer: dict[str, Any] = json.loads(text)
    return answer


def run_measured(job: MeasuredJob) -> Path:
    """Answer one case and keep the answer and, apart from it, the label."""
    if job.resume and answered_before(job.answer_path, job.label_path):
        return job.answer_path
    begin = time.process_time()
    case = make_case(job.spec)
    kept: dict[str, Any] = {"spec": job.spec.to_dict(),
                            "generation_s": time.process_time() - begin}
    kept["answer"], kept["seconds"] = timed(lambda: diagnosed_files(case))
    write_whole(job.label_path, json.dumps(case.label, indent=1) + "\n")
    write_whole(job.answer_path, json.dumps(kept, indent=1) + "\n")
    return job.answer_path


def pseudo_true(spec: MeasuredSpec, factor: int = LONGER) -> dict[str, float]:
    """Parameters of the right effect in a fit, by the diagnosis' own estimator, of the right
    model to noise-free records `factor` times as long as the case's."""
    from dfm_stage.diagnosis.observation import observe
    from dfm_stage.identification.model_fit import fit_model
    from dfm_stage.model import model_from_dict
    from dfm_stage.recording import AxisRecord, Provenance, Record

    case = make_case(spec)
    true = case.label["true_effects"][spec.effect]
    document = {**case.model, "base": dict(make_setup(spec)[0].known),
                "effects": [{"name": spec.effect, "parameters": true}]}
    model = model_from_dict(document)
    runs = []
    for number, columns in enumerate(long_records(spec, factor)):
        axis = AxisRecord(columns["input_v"], columns["position_m"])
        record = Record(columns["time_s"], case.sample_period, {"x": axis},
                        Provenance(f"long_{number}.csv", "csv"))
        runs.append(observe(record, model))
    found = fit_model(model, runs).model.effect(spec.effect)
    return {} if found is None else {n: float(v) for n, v in found.parameters.items()}


def can_have_pseudo_true(spec: MeasuredSpec, answer: Mapping[str, Any]) -> bool:
    """Whether the answer is the right effect alone, of held records in open loop."""
    names = [e["name"] for e in answer.get("effects", [])]
    if names != [spec.effect] or answer.get("verdict") not in ("named", "partial"):
        return False
    return all(not run.closed and run.hold == HELD for run in make_setup(spec)[0].train)


def keep_pseudo_true(job: MeasuredJob) -> Path | None:
    """Keep the pseudo-true values of an answered case, where they make sense."""
    if job.pseudo_path.exists():
        return job.pseudo_path
    if not job.answer_path.exists():
        return None
    answer = json.loads(job.answer_path.read_text("utf-8"))["answer"]
    if job.spec.group != "remainder" or not can_have_pseudo_true(job.spec, answer):
        return None
    try:
        found = pseudo_true(job.spec, job.longer)
    except ValueError:  # one of the other runs hits the ends of the travel
        found = {}
    write_whole(job.pseudo_path, json.dumps(found, indent=1) + "\n")
    return job.pseudo_path


def convention_by_library(columns: Mapping[str, Any], period: float,
                          base: Mapping[str, float]) -> Mapping[str, Any]:
    """What the library says of the input of one record, as an entry of `conventions`."""
    from benchmarks.blind.as_records import record_of
    from dfm_stage.diagnosis.observation import alike, observe
    from dfm_stage.diagnosis.other_convention import late_samples
    from dfm_stage.model import Model

    model = Model("believed", period, dict(base))
    seen, = alike([observe(record_of(columns, "run", period), model)], late_samples(model))
    return seen.convention.to_dict(seen.record)


def timing_rates(cases: int, seed: int, find: Find) -> dict[str, tuple[int, int]]:
    """Hits and cases of `held` (timing corrected in vain), `found` (conventions found where lag
    and delay are below 0.2 sample) and `untold` (found elsewhere), by records alone."""
    hits: dict[str, list[bool]] = {"held": [], "found": [], "untold": []}
    for index in range(cases):
        columns, truth = held_record(index, seed)
        said = find(columns, truth["sample_period"], truth["base"])
        hits["held"].append(judge_timing(truth, said)[1])
        columns, truth = convention_record(index, seed)
        said = find(columns, truth["sample_period"], truth["base"])
        place = "found" if truth["must_be_found"] else "untold"
        hits[place].append(judge_timing(truth, said)[0])
    return {name: (sum(found), len(found)) for name, found in hits.items()}


def jobs_of(cases: Mapping[str, int], seed: int, folder: Path,
            resume: bool) -> list[MeasuredJob]:
    """The jobs of every group."""
    return [MeasuredJob(spec, folder, resume) for group in GROUPS
            for spec in measured_plan(group, cases.get(group, 0), seed)]


def read_measured(folder: Path) -> list[MeasuredScore]:
    """Judge the kept answers of a folder by the labels beside them."""
    scores = []
    for path in sorted((folder / "answers").glob("*.json")):
        kept = json.loads(path.read_text("utf-8"))
        label = json.loads((folder / "labels" / path.name).read_text("utf-8"))
        pseudo = folder / "pseudo_true" / path.name
        values = json.loads(pseudo.read_text("utf-8")) if pseudo.exists() else None
        scores.append(judge_measured(label, kept["answer"], kept["seconds"], values))
    return scores


def read_timing(folder: Path) -> Timing:
    """The kept `timing_rates` of a folder; none where they were not asked for."""
    path = folder / TIMING
    return json.loads(path.read_text("utf-8")) if path.exists() else {}


def in_processes(work: Callable[[MeasuredJob], Any], todo: Sequence[MeasuredJob],
                 workers: int) -> None:
    """Do every job; progress goes to stderr."""
    one_thread_each()
    begin = time.monotonic()
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(work, job) for job in todo]
        try:
            for number, done in enumerate(as_completed(waiting), start=1):
                done.result()
                if number % 10 == 0 or number == len(todo):
                    print(f"{number} of {len(todo)} cases, {time.monotonic() - begin:.0f} s",
                          file=sys.stderr, flush=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, judge, and write report.txt and figures.json."""
    options = _options().parse_args(arguments)
    cases = CASES if not options.cases else {
        name: int(count) for name, _, count in (item.partition("=") for item in options.cases)}
    seed = _fresh(options.keep) if options.fresh else options.seed
    folder = options.keep / f"seed_{seed}"
    todo = jobs_of(cases, seed, folder, options.resume)
    in_processes(run_measured, todo, options.jobs)
    if options.pseudo:
        in_processes(keep_pseudo_true, [
            replace(job, longer=options.longer) for job in todo
            if job.spec.group == "remainder"][:options.pseudo], options.jobs)
    if options.held:
        write_whole(folder / TIMING, json.dumps(
            timing_rates(options.held, seed, convention_by_library), indent=1) + "\n")
    scores, timing = read_measured(folder), read_timing(folder)
    text = f"seed {seed}, {len(scores)} cases\n\n{measured_report(scores, timing)}\n"
    write_whole(folder / "report.txt", text)
    write_whole(folder / "figures.json", json.dumps(
        [figure.to_dict() for figure in measured_figures(scores, timing)], indent=1) + "\n")
    print(text)
    return 0


def _fresh(keep: Path) -> int:
    path = keep / "fresh_seed.json"
    if not path.exists():
        write_whole(path, f"{secrets.randbelow(2**31)}\n")
    return int(json.loads(path.read_text("utf-8")))


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.measured",
                                     description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--fresh", action="store_true", help="a seed drawn once, kept in DIR")
    parser.add_argument("--keep", type=Path, required=True, metavar="DIR")
    parser.add_argument("--cases", nargs="*", metavar="GROUP=N", default=[],
                        help=f"default: {' '.join(f'{n}={c}' for n, c in CASES.items())}")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--resume", action="store_true", help="keep what was answered")
    parser.add_argument("--held", type=int, default=0, metavar="N")
    parser.add_argument("--pseudo", type=int, default=0, metavar="N")
    parser.add_argument("--longer", type=int, default=LONGER, metavar="K")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
