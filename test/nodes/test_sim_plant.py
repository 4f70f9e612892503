"""The plant in real time takes a sample a period, late ones at once, and counts what it missed."""

from __future__ import annotations

from dfm_stage.nodes import sim_plant
from dfm_stage.nodes.sim_plant import SimPlant

BEGIN_NS, PERIOD_NS = 10**12, 10**6


def test_late_samples_are_taken_at_once_and_only_whole_periods_are_missed(make, monkeypatch):
    node = make(SimPlant)
    now = [0.0]
    monkeypatch.setattr(sim_plant.time, "monotonic_ns",
                        lambda: BEGIN_NS + round(now[0] * PERIOD_NS))
    monkeypatch.setattr(node._timer, "time_until_next_call",
                        lambda: round(-now[0] % 1 * PERIOD_NS))
    node._due_ns = None
    taken, missed = [], []
    begin = node.seq
    for now[0] in (0.9, 1.1, 2.1, 3.8, 4.1, 6.3, 6.9, 7.95, 8.05, 9.0):
        node._tick()
        taken.append(node.seq - begin)
        missed.append(node.counters.get("deadlines_missed", 0))
    assert taken == [0, 1, 2, 3, 4, 6, 6, 7, 8, 9]
    assert missed == [0, 0, 0, 0, 0, 1, 1, 1, 1, 1]
