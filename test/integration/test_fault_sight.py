"""How the fault campaign sees that a graph is safe: alike through a witness and in a bag."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.fault_campaign import Campaign, Fault, Outcome, _Struck
from benchmarks.fault_sight import WITNESSED, heard, recorded

NOW_NS = 10_000_000_000
LAST = {"enabled": True, "voltage": 0.5, "current": 0.1, "position": 1e-3}


def seen(age_s: float, **last):
    """What a witness has and a bag of the same; every topic's newest message is `age_s` old."""
    stamps = NOW_NS - int(age_s * 1e9) - np.arange(5)[::-1] * 1_000_000
    values = {**LAST, **last}
    messages = {topic: [SimpleNamespace(stamp_ns=int(stamp), **values) for stamp in stamps]
                for topic in WITNESSED}
    bag = {f"/stage/x/{topic}": {"header.stamp": stamps,
                                 **{name: np.full(5, value) for name, value in values.items()}}
           for topic in WITNESSED}
    return messages, bag


def sights(age_s: float, **last):
    messages, bag = seen(age_s, **last)
    return heard(messages, 0, NOW_NS), recorded(bag, 0, NOW_NS)


@pytest.mark.parametrize(("last", "age_s", "node", "safe"), [
    ({}, 0.01, "x/controller", True),
    ({}, 0.5, "x/controller", False),
    ({"voltage": 0.0}, 0.5, "x/controller", True),
    ({"enabled": False}, 0.01, "x/controller", False),
    ({"enabled": False, "current": 0.0}, 0.01, "x/controller", True),
    ({}, 0.5, "recorder", True),
    ({"enabled": False}, 0.01, "x/trajectory_generator", True),
    ({}, 0.5, "x/trajectory_generator", False),
    ({"position": -8e-3}, 0.01, "recorder", False),
])
def test_a_bag_and_a_witness_judge_alike(last, age_s, node, safe):
    for sight in sights(age_s, **last):
        assert sight.safe_after(node) is safe
        assert max(sight.ages.values()) == pytest.approx(age_s)


def test_a_bag_is_looked_at_at_a_time_and_may_lack_topics():
    sight = recorded({}, 0, NOW_NS)
    assert not sight.works
    assert sight.safe_after("x/controller")  # nothing ever came: no output either
    (_, later) = sights(-1.0)
    assert min(later.ages.values()) == float("inf")


@pytest.mark.parametrize(("age_s", "last", "recovered", "safe"), [
    (0.01, {}, True, True),
    (0.5, {}, False, True),
    (0.01, {"enabled": False}, False, True),
    (0.01, {"position": 8e-3}, True, False),  # also while it was repaired
])
def test_where_the_operator_was_starved_the_bag_decides(tmp_path, age_s, last, recovered, safe):
    campaign = Campaign(tmp_path)
    outcome = Outcome(Fault("/stage/x/controller", "pause", 0.5), safe=True)
    campaign._struck = [_Struck(outcome, NOW_NS - 2_000_000_000, end_ns=NOW_NS)]
    campaign._judge_again(seen(age_s, **last)[1])
    assert (outcome.recovered, outcome.recovered_by_bag) == (recovered, recovered)
    assert outcome.safe is safe
