"""Faults during a scan, the short form of `./run bench faults`, and what nodes say of them."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest

from benchmarks.fault_campaign import Campaign
from benchmarks.fault_outcome import Fault
from dfm_stage.harness import StageGraph
from dfm_stage.recording import read_bag

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


@pytest.mark.real_time
@pytest.mark.slow
def test_a_recorder_that_stands_still_holds_nobody_up(tmp_path):
    """Taken for dead after a second, its ports were made anew: the whole graph stood still 2 s."""
    with StageGraph(bag=tmp_path / "bag") as graph:
        plant = graph.listen("x", "plant", lossy=True)
        graph.spin_until(lambda: len(plant) > 500, 10.0, "the plant")
        for _ in range(3):
            graph.signal_node("/stage/recorder", signal.SIGSTOP)
            graph.spin(1.9)
            graph.signal_node("/stage/recorder", signal.SIGCONT)
            graph.spin(2.0)
        graph.stop_recording()
    stamps = np.array([each.stamp_ns for each in plant])
    assert np.max(np.diff(stamps)) < 0.5e9
    there = read_bag(tmp_path / "bag")["/stage/x/plant"]["header.stamp"]
    assert not set(stamps[:-2000].tolist()) - set(there.tolist())


@pytest.mark.real_time
@pytest.mark.slow
def test_a_recorder_in_place_of_a_killed_one_is_ready_when_it_misses_nothing(tmp_path):
    """The killed one's endpoints still look matched; the next was called ready 4 s too soon."""
    with StageGraph(bag=tmp_path / "first") as graph:
        heard = {topic: graph.listen("x", topic, lossy=True) for topic in ("measurement", "plant")}
        graph.spin(1.0)
        graph.signal_node("/stage/recorder", signal.SIGKILL)
        graph.restart_node("/stage/recorder", {"bag": str(tmp_path / "second")})
        ready_ns = time.time_ns()
        graph.spin(3.0)
        graph.stop_recording()
        ended_ns = time.time_ns()
    bag = read_bag(tmp_path / "second")
    for topic, messages in heard.items():
        mine = {each.stamp_ns for each in messages if ready_ns < each.stamp_ns < ended_ns - 10**8}
        assert len(mine) > 1000
        assert not mine - set(bag[f"/stage/x/{topic}"]["header.stamp"].tolist())
