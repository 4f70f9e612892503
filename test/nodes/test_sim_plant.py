"""The plant in real time takes a sample a period, late ones at once, and counts what it missed."""

from __future__ import annotations

import numpy as np
import pytest

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
    node._due_ns = 0
    taken, missed = [], []
    begin = node.seq
    for now[0] in (0.9, 1.1, 2.1, 3.8, 4.1, 6.3, 6.9, 7.95, 8.05, 9.0):
        node._on_timer()
        taken.append(node.seq - begin)
        missed.append(node.counters.get("deadlines_missed", 0))
    assert taken == [0, 1, 2, 3, 4, 6, 6, 7, 8, 9]
    assert missed == [0, 0, 0, 0, 0, 1, 1, 1, 1, 1]


def test_a_period_that_is_no_whole_number_of_nanoseconds_misses_nothing(make, monkeypatch):
    """The middleware cuts the fraction off: over a minute at 1.5 kHz this makes 0.06 ms."""
    node = make(SimPlant)
    period_ns = 666_666
    late = np.random.default_rng(1).uniform(5e3, 2e4, 90_000).astype(int).tolist()
    now = [BEGIN_NS]
    monkeypatch.setattr(sim_plant.time, "monotonic_ns", lambda: now[0])
    monkeypatch.setattr(type(node._timer), "timer_period_ns", period_ns)
    monkeypatch.setattr(node, "_period_ns", 666_667)
    for name in ("_advance", "_publish_samples"):
        monkeypatch.setattr(node, name, lambda *_: None)
    node._due_ns = BEGIN_NS
    for k, each in enumerate(late, 1):
        now[0] = BEGIN_NS + k * period_ns + each
        next_s = node._tick()
    assert node.counters.get("deadlines_missed", 0) == 0
    assert next_s == pytest.approx(1e-9 * (BEGIN_NS + (len(late) + 1) * period_ns), abs=1e-9)


def test_what_passes_between_two_clocks_makes_no_sample_late(make, monkeypatch):
    node = make(SimPlant)
    now, passes = [0], [3e4, 7e5, 0, 2e5, 9e5]

    def left():
        now[0] += round(passes.pop(0))
        return -now[0] % PERIOD_NS

    monkeypatch.setattr(sim_plant.time, "monotonic_ns", lambda: BEGIN_NS + now[0])
    monkeypatch.setattr(node._timer, "time_until_next_call", left)
    due_ns = node._first_due_ns()
    assert due_ns % PERIOD_NS == 0
    assert 0 <= BEGIN_NS + now[0] - due_ns < PERIOD_NS
