"""Bring up a set of nodes from Python, run experiments on it, get the record, leave nothing.

>>> with StageGraph(model="paper_stage", lockstep=True, composed=True, bag="bags/a") as graph:
...     graph.run("multisine")
>>> record = graph.record()

`composed=True` puts every node into the calling process, on one executor that `run` spins;
otherwise each node is a process of its own. Every graph has a ROS domain of its own, unless one is
given, so two at once do not see each other. Nodes are waited for by asking them, not by sleeping.

Names are loaded on first use, so that claiming a domain does not wait for ROS.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dfm_stage.middleware.discovery import keep_to_this_machine
from dfm_stage.share import find_experiment

if TYPE_CHECKING:
    from dfm_stage.harness.emulated import EmulatedGraph
    from dfm_stage.harness.node_set import (
        HarnessError,
        Launched,
        NodeSet,
        NotInTimeError,
        RunFailedError,
    )
    from dfm_stage.harness.stage_graph import RunResult, StageGraph

__all__ = ["EmulatedGraph", "HarnessError", "Launched", "NodeSet", "NotInTimeError",
           "RunFailedError", "RunResult", "StageGraph", "find_experiment"]

_LAZY = {"EmulatedGraph": "emulated", "HarnessError": "node_set", "Launched": "node_set",
         "NodeSet": "node_set", "NotInTimeError": "node_set",
         "RunFailedError": "node_set", "RunResult": "stage_graph",
         "StageGraph": "stage_graph"}

keep_to_this_machine()


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
