"""How the fault campaign sees that a graph is safe: alike through a witness and in a bag."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import faults
from benchmarks.fault_campaign import Campaign, _Struck
from benchmarks.fault_ledger import Ledger
from benchmarks.fault_outcome import Fault, Outcome, Tally
from benchmarks.fault_sight import WITNESSED, heard, recorded

NOW_NS = 10_000_000_000
COST = "no real-time priority: normal (killed and still written to: /stage/x/controller)"
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


@pytest.mark.parametrize(("said", "explained"), [
    (f"/stage/sim_plant: {COST}", False),
    ("/stage/x/amplifier_driver: output at zero until clear and arm: stale command", True),
    (f"/stage/x/amplifier_driver: {COST}; waiting for controller", True),
])
def test_what_a_killed_node_costs_the_others_is_no_explanation(tmp_path, said, explained):
    campaign = Campaign(tmp_path)
    campaign._scene = SimpleNamespace(said=[(0.0, said)])
    dead = "/stage/x/controller"
    assert campaign._explained(Fault(dead, "kill"), [dead]) is explained


@pytest.mark.parametrize(("last", "age_s", "node", "safe"), [
    ({}, 0.01, "x/controller", True),
    ({}, 0.5, "x/controller", False),
    ({"voltage": 0.0}, 0.5, "x/controller", True),
    ({"enabled": False}, 0.01, "x/controller", False),
    ({"enabled": False, "current": 0.0}, 0.01, "x/controller", True),
    ({"enabled": False, "current": 0.1 * math.exp(-170.0)}, 0.01, "x/controller", True),
    ({"enabled": False, "current": -1e-3}, 0.01, "x/controller", False),
    ({}, 0.5, "recorder", True),
    ({"enabled": False}, 0.01, "x/trajectory_generator", True),
    ({}, 0.5, "x/trajectory_generator", False),
    ({"position": -8e-3}, 0.01, "recorder", False),
])
def test_a_bag_and_a_witness_judge_alike(last, age_s, node, safe):
    for sight in sights(age_s, **last):
        assert sight.safe_after(node) is safe
        assert max(sight.ages.values()) == pytest.approx(age_s)


def test_the_stamps_of_a_bag_need_not_rise():
    """After the clock was set by a minute, and back."""
    _, bag = seen(0.01)
    for topic in bag.values():
        order = np.array([0, 4, 1, 2, 3])
        topic["header.stamp"] = topic["header.stamp"][order] + np.array([0, 0, 60, 0, -60]) * 10**9
        topic["enabled"] = np.array([False, True, False, False, False])
    assert recorded(bag, 0, NOW_NS).enabled


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


def message(stamp_ms: int) -> SimpleNamespace:
    return SimpleNamespace(stamp_ns=NOW_NS + stamp_ms * 10**6, seq=stamp_ms)


def test_what_is_lost_is_counted_by_its_cause():
    ledger = Ledger(Tally())
    ledger.heard = {"command": [message(each) for each in range(1, 101)], "plant": [message(50)]}
    sent_ns, ended_ns = NOW_NS + 60 * 10**6 + 1, NOW_NS + 61 * 10**6 + 1
    ledger.killed = [("/stage/x/controller", sent_ns, ended_ns)]
    ledger.paused = [(NOW_NS + 80 * 10**6, NOW_NS + 82 * 10**6)]
    ledger.seconds = [(NOW_NS, {"command": 3})]
    gone = {2, 40, 54, 56, 58, 61, 62, 80, 81, 90, 95}
    there = [each for each in range(1, 101) if each not in gone]
    bag = {"/stage/x/command": {"header.stamp": NOW_NS + np.array(there) * 10**6,
                                "seq": np.array(there)}}
    ledger.compare([bag], "bag", until_ns=NOW_NS + 95 * 10**6)
    tally = ledger.tally
    assert tally.witnessed == 95
    assert tally.lost_at_kill == 3  # from 5 ms before the signal, until the controller had ended
    assert tally.lost_while_paused == 2
    assert tally.lost_of_seconds == 1  # 2, the first one of this name being at 3
    assert tally.lost == 5  # 40, 54, 62, 90, and that of the plant, which nobody killed


def test_blocks_of_faults_are_kept_and_taken_up_again(tmp_path, monkeypatch):
    run = []

    def run_block(block, answer):
        run.append(answer.name)
        tally = Tally([Outcome(each, safe=True, recovered=True, answered_s=0.1, took_s=0.2)
                       for each in block], witnessed=10)
        answer.write_text(json.dumps(tally.to_dict()))
        return tally

    monkeypatch.setattr(faults, "run_block", run_block)
    monkeypatch.setattr(faults, "BLOCK", 4)
    monkeypatch.setattr(faults, "_orphans", lambda: 0)   # other tests have some
    monkeypatch.setattr(faults, "private_mounts", lambda: ("unshare",))
    monkeypatch.setenv(faults.PRIVATE, "1")

    def values(cases, **options):
        run.clear()
        return {each.key: each.value for each in faults.figures(
            cases=cases, keep=tmp_path, only="pause", **options)}

    first = values(6)
    assert run == ["block_pause_000.json", "block_pause_001.json"]
    assert (first["faults.injected"], first["faults.unsafe"]) == (6, 0)
    assert values(6, resume=True) == first
    assert run == []
    assert values(9, resume=True)["faults.injected"] == 9   # a block cut short is run again
    assert run == ["block_pause_001.json", "block_pause_002.json"]
    values(6, resume=True, seed=2)
    assert len(run) == 2


def test_runs_of_several_seeds_are_added_up(tmp_path):
    for seed, safe, lost in ((7, True, 2), (8, False, 1)):
        (folder := tmp_path / "kept" / f"seed_{seed}").mkdir(parents=True)
        tally = Tally([Outcome(Fault("/stage/recorder", "kill"), safe=safe, recovered=True)])
        tally.lost = lost
        (folder / "block_000.json").write_text(json.dumps(tally.to_dict()))
        (tmp_path / f"{seed}.json").write_text(json.dumps({
            "machine": {}, "commands": [f"seed {seed}"], "failed": [], "figures": [
                {"key": "faults.orphans", "value": 1.0}]}))
    faults.main([str(tmp_path / name) for name in ("kept", "sum.json", "7.json", "8.json")])
    found = json.loads((tmp_path / "sum.json").read_text())
    told = {each["key"]: (each["value"], each["met"]) for each in found["figures"]}
    assert told["faults.injected"] == (2.0, None)
    assert told["faults.unsafe"] == (1.0, False)       # the median would be 0.5, of three seeds 0
    assert told["faults.messages_lost"] == (3.0, False)
    assert told["faults.orphans"] == (2.0, False)
    assert found["commands"] == ["seed 7", "seed 8"]
