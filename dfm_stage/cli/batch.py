"""Many diagnoses at once: a process for each, on the cores of this machine or of a Dask cluster.

Every run is answered by the command `diagnose` itself, in a process of its own, so one that fails
or grows takes nothing with it.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Any

from dfm_stage.diagnosis.errors import DiagnosisError

CONNECT_S = 20.0
# the runs are what is parallel; inside each one thread
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
                            "NUMBA_NUM_THREADS"), "1")


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
        futures = client.map(work, jobs, pure=False)
        for _, outcome in distributed.as_completed(futures, with_results=True):
            yield outcome
