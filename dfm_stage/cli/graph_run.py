"""Running one experiment on the simulated node graph, into a bag, and reading it back."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dfm_stage.cli.progress import Progress
from dfm_stage.recording import Record, read_record


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
    from dfm_stage.harness import NotInTimeError, StageGraph

    name = experiment if isinstance(experiment, str) else str(experiment["name"])

    def run() -> None:
        with StageGraph(model=model, seed=seed, axes=axes, lockstep=True, composed=composed,
                        bag=bag) as graph:
            with Progress(label or f"  {name}") as progress:
                for _ in range(times):
                    graph.run(experiment, progress=progress)
            graph.stop_recording()

    try:
        run()
    except NotInTimeError as error:
        print(f"  once more: {error}", file=sys.stderr)
        shutil.rmtree(bag, ignore_errors=True)
        run()
    return read_record(bag)
