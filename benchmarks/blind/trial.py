"""One blind trial: the case is shown, the answer kept; whoever answers never sees the label."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.corpus.case import Case, NoUsableDrawError, Truth, make_truth, shown
from benchmarks.corpus.case_files import write_label, write_whole
from benchmarks.corpus.plan import CaseSpec
from benchmarks.corpus.rivals import pair_separability, separability
from benchmarks.corpus.uncommon import PARAMETERS

Answerer = Callable[[Case], dict[str, Any]]
LONGEST_S = 120
"""Processor time (s), whatever else the machine does, after which a case is kept as a failure."""
SEPARATED_FROM = 3.0


@dataclass(frozen=True)
class Job:
    """A case to run, the folder its answer goes to, and who answers besides the diagnosis. Without
    `rivals` the label does not yet say what the data can tell apart."""

    spec: CaseSpec
    folder: Path
    baselines: bool = True
    resume: bool = True
    rivals: bool = True

    @property
    def answer_path(self) -> Path:
        """The file of the answer."""
        return self.folder / "answers" / f"case_{self.spec.index:05d}.json"

    @property
    def label_path(self) -> Path:
        """The file of the label."""
        return self.folder / "labels" / f"case_{self.spec.index:05d}.json"


def diagnosed(case: Case) -> dict[str, Any]:
    """The library's answer, as diagnosis.json holds it."""
    from benchmarks.blind.as_records import model_of, records_of
    from dfm_stage.diagnosis import diagnose
    from dfm_stage.model import EFFECTS

    library: list[str] | None = None
    without: tuple[str, ...] = ()
    if any(name in PARAMETERS for name in case.remove):
        without = case.remove  # of all effects: the uncommon ones follow the common ones
    elif case.remove:
        library = [name for name in EFFECTS if name not in case.remove]
    result = diagnose(records_of(case, "run"), model_of(case),
                      holdout=records_of(case, "holdout"), library=library, without=without)
    answer: dict[str, Any] = json.loads(json.dumps(result.to_dict()))
    return answer


def run_case(job: Job, answerer: Answerer | None = None) -> Path:
    """Answer one case and keep the answer and, apart from it, the label; return the answer's
    file. With `resume` a case that was answered, or took too long, is left as it is; one that
    ended in another error is run again. One that cannot be made is left out, with a line that says
    so."""
    if job.resume and _answered(job):
        return job.answer_path
    kept: dict[str, Any] = {"spec": job.spec.to_dict()}
    begin = time.perf_counter()
    try:
        truth = make_truth(job.spec)
    except NoUsableDrawError as error:
        print(f"left out: {error}", file=sys.stderr, flush=True)
        return job.answer_path
    case = shown(truth)
    kept["generation_s"] = time.perf_counter() - begin
    answered = answerer or diagnosed
    kept["answer"], kept["seconds"] = timed(lambda: answered(case))
    if job.rivals:
        case.label.update(told_apart(truth, case.label))
    write_label(case, job.folder / "labels")
    if job.baselines:
        from benchmarks.blind.baselines import pysindy_answer, stepwise_answer

        for name, baseline in (("pysindy", pysindy_answer), ("stepwise_bic", stepwise_answer)):
            if name == "pysindy" and find_spec("pysindy") is None:
                continue
            kept[name], kept[f"{name}_seconds"] = timed(partial(baseline, case))
    write_whole(job.answer_path, json.dumps(kept, indent=1) + "\n")
    return job.answer_path


def told_apart(truth: Truth, label: Mapping[str, Any]) -> dict[str, Any]:
    """What the generator's rivals say of a case, for its label."""
    if (truth.spec.kind == "effect" and truth.spec.severity >= SEPARATED_FROM) or (
            "relatives" in label):
        return separability(truth).to_dict()
    return pair_separability(truth) if truth.spec.kind == "pair" else {}


def add_rivals(job: Job) -> Path:
    """Add to the label of an answered case what the generator's rivals say, if it is not there."""
    label = json.loads(job.label_path.read_text("utf-8"))
    if "separable" not in label and job.spec.effects:
        label.update(told_apart(make_truth(job.spec), label))
        write_whole(job.label_path, json.dumps(label, indent=1) + "\n")
    return job.answer_path


def _answered(job: Job) -> bool:
    return answered_before(job.answer_path, job.label_path)


def answered_before(answer_path: Path, label_path: Path) -> bool:
    """Whether a case was answered, or took too long: both files are there and no other error."""
    if not (answer_path.exists() and label_path.exists()):
        return False
    error = json.loads(answer_path.read_text("utf-8"))["answer"].get("error")
    return error is None or error.startswith(TimeoutError.__name__)


def timed(answered: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any], float]:
    """The answer and the processor time it took (s); a failure is an answer, too."""
    begin = time.process_time()
    before = signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        answer = answered()
    except Exception as error:  # noqa: BLE001 - whatever it is, it counts as a wrong answer
        answer = {"error": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return answer, time.process_time() - begin


def _too_long(*_: object) -> None:
    raise TimeoutError(f"no answer in {LONGEST_S} s of processor time")


def one_thread_each() -> None:
    """Set before workers start: every library gets one thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                 "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"
