"""The faults that `./run bench faults` draws, and what a graph refuses to start again."""

from __future__ import annotations

import pytest

from benchmarks.fault_kinds import KINDS, draw
from dfm_stage.harness import HarnessError, StageGraph


def test_every_kind_of_fault_meets_every_target_equally_often():
    every = [(target, kind.name) for kind in KINDS.values() for target in kind.targets]
    faults = draw(2 * len(every), seed=4)
    assert sorted((each.node, each.kind) for each in faults) == sorted(2 * every)
    assert faults == draw(len(faults), seed=4) != draw(len(faults), seed=5)
    assert faults[:7] == draw(7, seed=4)  # so that a longer run goes on with the blocks of it
    assert {each.kind for each in draw(9, seed=4, only="pause")} == {"pause"}


def test_a_node_is_not_restarted_while_it_runs():
    for composed, words in ((True, "no process of this graph"), (False, "still runs")):
        with StageGraph(nodes=("sim_plant",), composed=composed) as graph, pytest.raises(
                HarnessError, match=words):
            graph.restart_node("/stage/sim_plant")
