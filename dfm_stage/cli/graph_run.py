"""Running one experiment on the simulated node graph, into a bag, and reading it back.

Every graph gets a process of its own: rclpy does not give a participant's threads back before the
process ends, and a process that brought up half a dozen graphs slows down.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.cli.progress import Progress
from dfm_stage.errors import DfmError

if TYPE_CHECKING:
    from dfm_stage.recording import Record

_DID_NOT_MEET = ("not there after", "is not ready", "does not answer")
"""What the harness says when nodes do not find each other, as happens on a busy machine."""


_PR_SET_PDEATHSIG = 1


class GraphRunError(DfmError):
    """An experiment could not be run on the node graph."""


def run_on_graph(experiment: str | Mapping[str, Any], bag: Path, *, model: str, seed: int = 0,
                 axes: Sequence[str] = ("x",), composed: bool = True,
                 label: str = "", times: int = 1) -> Record:
    """Run an experiment in lockstep on a graph of its own, several times without a pause if asked,
    and return the record of its bag.

    Where the nodes do not find each other it is tried once more.

    Raises
    ------
    DfmError
        If the graph does not come up, the experiment fails or the bag cannot be read.
    """
    from dfm_stage.recording import read_record

    job = {"experiment": experiment if isinstance(experiment, str) else dict(experiment),
           "bag": str(bag), "model": model, "seed": seed, "axes": list(axes),
           "composed": composed, "label": label, "times": times}
    error = _in_a_process(job)
    if error and any(words in error for words in _DID_NOT_MEET):
        print(f"  once more: {error}", file=sys.stderr)
        shutil.rmtree(bag, ignore_errors=True)
        error = _in_a_process(job)
    if error:
        raise GraphRunError(error)
    return read_record(bag)


def _in_a_process(job: Mapping[str, Any]) -> str:
    """Run the job and return what went wrong, empty for nothing."""
    # The child runs this very package, wherever the caller stands.
    here = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    process = subprocess.Popen(
        [sys.executable, "-m", "dfm_stage.cli.graph_run"], stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"})
    try:
        said, _ = process.communicate(json.dumps(job))
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT)
        process.wait()
        raise
    if process.returncode == 130:
        raise KeyboardInterrupt
    if process.returncode == 0:
        return ""
    lines = said.strip().splitlines()
    return lines[-1] if lines else f"the node graph ended with code {process.returncode}"


def main() -> int:
    """Run the job on stdin; 0 done, 2 with one line on stdout, 130 after Ctrl-C."""
    from dfm_stage.harness import StageGraph

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    job = json.load(sys.stdin)
    experiment = job["experiment"]
    name = experiment if isinstance(experiment, str) else str(experiment["name"])
    try:
        with StageGraph(model=job["model"], seed=job["seed"], axes=job["axes"], lockstep=True,
                        composed=job["composed"], bag=job["bag"]) as graph:
            with Progress(job["label"] or f"  {name}") as progress:
                for _ in range(job["times"]):
                    graph.run(experiment, progress=progress)
            graph.stop_recording()
    except DfmError as error:
        print(error)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
