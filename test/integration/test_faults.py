"""Faults during a scan, the short form of `./run bench faults`, and what nodes say of them."""

from __future__ import annotations

import pytest

from benchmarks.fault_campaign import KINDS, NODES, Campaign, Fault, draw
from dfm_stage.harness import HarnessError, StageGraph

FAULTS = (Fault("/stage/x/controller", "kill"), Fault("/stage/x/encoder_driver", "pause", 0.7))


@pytest.mark.slow
@pytest.mark.real_time
def test_the_graph_survives_and_every_message_is_kept(tmp_path):
    tally = Campaign(tmp_path).run(FAULTS)
    assert [each.fault for each in tally.outcomes] == list(FAULTS)
    for each in tally.outcomes:
        assert each.safe, each
        assert each.explained is not False, each
        assert each.recovered, each
    assert tally.outcomes[0].cut
    assert "no command for" in tally.outcomes[0].words
    assert tally.lost == 0, tally.lost_words
    assert tally.witnessed > 3000


def test_every_kind_of_fault_meets_every_node_equally_often():
    faults = draw(2 * len(KINDS) * len(NODES), seed=4)
    assert {(each.node, each.kind): 2 for each in faults} == {
        (node, kind): sum(each.node == node and each.kind == kind for each in faults)
        for node in NODES for kind in KINDS}
    assert faults == draw(len(faults), seed=4) != draw(len(faults), seed=5)


def test_a_node_is_not_restarted_while_it_runs():
    for composed, words in ((True, "no process of this graph"), (False, "still runs")):
        with StageGraph(nodes=("sim_plant",), composed=composed) as graph, pytest.raises(
                HarnessError, match=words):
            graph.restart_node("/stage/sim_plant")
