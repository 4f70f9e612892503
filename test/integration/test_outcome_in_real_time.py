"""What came of a run against the clock: a file apart, so that the other outcomes run beside other
tests."""

from __future__ import annotations

import signal
import threading

import pytest

from dfm_stage.harness import RunFailedError, StageGraph

PUSH = {"name": "push", "mode": "open_loop", "duration_s": 0.3, "axes": {"x": {
    "excitation": {"kind": "steps", "levels_v": [0.0, 0.1], "dwell_s": 0.1}}}}


@pytest.mark.real_time
@pytest.mark.parametrize("after_s", [0.5, 1.9])
def test_an_amplifier_that_is_killed_on_the_way_is_no_success(after_s):
    """The second is killed in the last tenth of the run, and nothing but its silence tells."""
    push = {**PUSH, "duration_s": 2.0}
    with StageGraph() as graph:
        graph.run(PUSH)
        kill = threading.Timer(after_s, graph.signal_node, ("/stage/x/amplifier_driver",
                                                            signal.SIGKILL))
        kill.start()
        with pytest.raises(RunFailedError, match="nothing is heard of the amplifier for"):
            graph.run(push)
        kill.join()
