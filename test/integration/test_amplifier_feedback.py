"""amplifier_feedback on the graph: lockstep waits for it; what is as asked changes nothing."""

from __future__ import annotations

import numpy as np

from dfm_stage.harness import StageGraph
from dfm_stage.recording import read_bag

MOVE = {"name": "move", "mode": "pid", "duration_s": 1.5, "axes": {"x": {"reference": {
    "kind": "point_to_point", "points_m": [0.0, 5e-4], "dwell_s": 0.2}}}}


def test_what_was_given_as_asked_changes_no_command(tmp_path):
    commands = []
    for told in (False, True):
        bag = tmp_path / str(told)
        with StageGraph(lockstep=True, composed=True, bag=bag,
                        parameters={"controller": {"amplifier_feedback": told}}) as graph:
            graph.run(MOVE)
            graph.stop_recording()
        commands.append(read_bag(bag, ["/stage/x/command"])["/stage/x/command"]["voltage"])
    assert len(commands[0]) == 1500
    assert np.array_equal(*commands)
