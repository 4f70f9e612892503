"""Bring up a set of nodes from Python, run experiments on it, get the record, leave nothing.

>>> with StageGraph(model="paper_stage", lockstep=True, composed=True, bag="bags/a") as graph:
...     graph.run("multisine")
>>> record = graph.record()

`composed=True` puts every node into the calling process, on one executor that `run` spins;
otherwise each node is a process of its own. Every graph has a ROS domain of its own, unless one is
given, so two at once do not see each other. Nodes are waited for by asking them, not by sleeping.
"""

from dfm_stage.harness.node_set import HarnessError, Launched, NodeSet, NotReachedError
from dfm_stage.harness.stage_graph import RunResult, StageGraph
from dfm_stage.nodes.share import find_experiment

__all__ = ["HarnessError", "Launched", "NodeSet", "NotReachedError", "RunResult", "StageGraph",
           "find_experiment"]
