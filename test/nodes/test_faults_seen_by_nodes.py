"""What a node makes of a source that starts anew, falls silent, or of its own standstill."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from dfm_stage.nodes import base, each_second
from dfm_stage.nodes.amplifier_driver import AmplifierDriver
from dfm_stage.nodes.controller import Controller
from dfm_stage.nodes.each_second import PIECES
from dfm_stage.nodes.encoder_driver import EncoderDriver
from dfm_stage.nodes.sim_plant import SimPlant
from dfm_stage.nodes.trajectory_generator import TrajectoryGenerator


def measurement(seq):
    return SimpleNamespace(seq=seq, stamp_ns=seq * 10**6, position=0.0)


def test_measurements_that_start_anew_end_the_run(make):
    node = make(TrajectoryGenerator, reference__kind="sine", reference__amplitude_m=1e-3,
                reference__frequency_hz=1.0, autostart=False)
    node._run = node._make_run()
    for seq in (500, 501, 502):
        node._on_measurement(measurement(seq))
    assert node._run.done == 3
    held = node._hold
    node._on_measurement(measurement(0))
    assert node._run is None
    assert (node.counters["source_restarts"], node._hold) == (1, held)
    assert "started anew" in node.warnings_active["run"]  # said until the next run
    node._start()
    assert "run" not in node.warnings_active


def test_numbers_that_wrap_around_are_no_restart(make):
    node = make(TrajectoryGenerator, reference__kind="sine", reference__amplitude_m=1e-3,
                reference__frequency_hz=1.0, autostart=False)
    node._run = node._make_run()
    for seq in (2**32 - 2, 2**32 - 1, 0, 1):
        node._on_measurement(measurement(seq))
    assert node._run.done == 4


def test_an_encoder_that_starts_anew_has_lost_no_four_billion_samples(make):
    node = make(EncoderDriver)
    for seq in (7, 8, 10, 0, 1):
        node._on_counts(SimpleNamespace(seq=seq, stamp_ns=seq * 10**6, counts=0, resolution=1e-9))
    assert node.counters["samples_lost"] == 1
    assert node.counters["source_restarts"] == 1


def test_counts_of_two_plants_take_the_output_to_zero(make):
    """Each of their positions in turn would be a stage that jumps."""
    node = make(EncoderDriver)
    sent = []
    node._out.send = lambda *values: sent.append(values[1])
    for seq in (700, 0, 701):
        node._on_counts(SimpleNamespace(seq=seq, stamp_ns=10**12 + seq, counts=0, resolution=1e-9))
    assert not node._alarms
    node._on_counts(SimpleNamespace(seq=1, stamp_ns=10**12 + 1, counts=0, resolution=1e-9))
    assert "two sources" in node._alarms["sources"]
    assert sent == [700, 0, 701]
    list(node.each_second())
    list(node.each_second())
    node._on_counts(SimpleNamespace(seq=2, stamp_ns=10**12 + 2, counts=0, resolution=1e-9))
    assert sent[3:] == [2]


def test_a_topic_that_stops_is_named_until_it_comes_back(make, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(base.time, "monotonic", lambda: now[0])
    node = make(EncoderDriver)
    source = node._receivers[0]
    for second, received, silent in ((101, 0, False), (102, 5, False), (103, 9, False),
                                     (104, 9, True), (105, 9, True), (106, 10, False)):
        now[0], source.received = float(second), received
        list(node.each_second())
        words = list(node.warnings_active.values())
        assert any(text.startswith("nothing on sim/position_counts from sim_plant")
                   for text in words) == silent, second
        assert node._watch.silent == silent
    assert node.counters["inputs_lost"] == 1


def test_a_recorder_that_dies_before_it_said_anything_is_reported(make, monkeypatch):
    """In one of 1002 faults nobody said that nothing was recorded."""
    now = [100.0]
    monkeypatch.setattr(base.time, "monotonic", lambda: now[0])
    node = make(TrajectoryGenerator, wait_for_recorder=True)
    seen = []
    for second in range(1, 15):
        now[0] = 100.0 + second
        if second == 5:
            for publisher in node.publishers_of_links:  # the recorder's subscriptions are there
                publisher.is_open = True
        if second == 12:
            node._on_diagnostics(b"/stage/recorder\0")
        list(node.each_second())
        seen.append("recorder" in node.warnings_active)
    assert seen == [second in (8, 9, 10, 11) for second in range(1, 15)]


def test_nodes_of_one_name_say_so_and_one_that_was_killed_does_not_count(make, monkeypatch):
    first, second = make(EncoderDriver), make(EncoderDriver)
    deadline = time.monotonic() + 10.0
    while first.count_publishers("encoder_driver/config") < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    list(first.each_second())
    words = "2 nodes are called /stage/x/encoder_driver: end all but one"
    assert first.errors_active["name"] == first._alarms["name"] == words
    with monkeypatch.context() as patched:
        gone = first.get_publishers_info_by_topic("encoder_driver/config")[1].endpoint_gid
        patched.setattr(each_second, "killed_endpoints", lambda: (bytes(gone),))
        list(first.each_second())
        assert "name" not in first.errors_active
        list(first.each_second())
        assert "name" not in first._alarms
    second.destroy_publisher(second._config)
    while first.count_publishers("encoder_driver/config") > 1 and time.monotonic() < deadline:
        time.sleep(0.01)
    list(first.each_second())
    assert "name" not in first.errors_active


def test_a_node_signs_with_its_own_endpoint_beside_one_of_a_killed_namesake(make, monkeypatch):
    node = make(EncoderDriver)
    own = node.get_publishers_info_by_topic("encoder_driver/config")[0].endpoint_gid
    of_another = [*own[:4], own[4] ^ 1, *own[5:]]
    monkeypatch.setattr(node, "get_publishers_info_by_topic", lambda _topic: [
        SimpleNamespace(endpoint_gid=each) for each in (of_another, own)])
    assert node.an_endpoint() == list(own)


@pytest.mark.parametrize("kind", [AmplifierDriver, Controller])
def test_the_output_is_not_on_while_there_are_two_of_a_name(make, monkeypatch, kind):
    node = make(kind)
    told = []
    node._trip = lambda cause, why: told.append(why)
    for topic in [each for each in node.publishers if each.topic_name.endswith("loop_health")]:
        topic.publish = lambda status: told.append(status.message)
    monkeypatch.setattr(node, "_namesakes", lambda: "2 nodes are called so")
    list(node.each_second())
    assert len(told) == 1
    assert "2 nodes are called so" in told[0]


def test_an_amplifier_that_stood_still_does_not_go_on_by_itself(make):
    node = make(AmplifierDriver, stale_timeout_s=0.2)
    node._checked_s = time.monotonic() - 0.7  # the other nodes of its process were starting
    node._check_stale()
    assert node._interlock.armed
    node._interlock.last_command_s = time.monotonic()
    node._checked_s = time.monotonic() - 0.3
    node._check_stale()
    assert node._interlock.armed
    node._checked_s = time.monotonic() - 0.7
    node._check_stale()
    assert not node._interlock.armed
    assert "this process stood still for 0.7" in node._interlock.words()


def test_commands_of_a_loop_that_is_behind_are_not_obeyed(make):
    """One such command may come of a short standstill; where they last, the output stays off."""
    node = make(AmplifierDriver)
    sent = []
    node._state = SimpleNamespace(send=lambda *values: sent.append(values))

    def command(seq, age_s):
        node._on_command(SimpleNamespace(
            seq=seq, voltage=1.0, saturated=False, measurement_seq=seq,
            measurement_stamp_ns=time.time_ns() - int(age_s * 1e9)))
        return sent[-1][3], sent[-1][5]

    assert [command(1, 0.0), command(2, 0.05), command(3, 0.0)] == [
        (1.0, True), (0.0, True), (1.0, True)]
    assert command(4, 0.05) == (0.0, True)
    time.sleep(0.03)
    assert command(5, 0.05) == (0.0, False)
    assert node.counters["commands_too_old"] == 3
    assert "answers a measurement 50" in node.errors_active["output"]


@pytest.mark.parametrize(("watchdog_s", "kept"), [(0.05, 0.0), (0.0, 1.5)])
def test_the_plants_watchdog_cuts_a_drive_that_nobody_renews(make, watchdog_s, kept):
    node = make(SimPlant, drive_watchdog_s=watchdog_s)
    axis = node._axes[0]
    axis._on_drive(SimpleNamespace(measurement_seq=0, enabled=True, voltage=1.5))
    for _ in range(50):
        node._advance()
    assert axis.stage.inputs == [1.5]
    for _ in range(10):
        node._advance()
    assert axis.stage.inputs == [kept]


@pytest.mark.parametrize(("leaving_s", "asked"), [(0.0, 0), (0.05, 1)])
def test_a_node_that_ends_waits_for_its_last_messages(make, monkeypatch, leaving_s, asked):
    waited = []
    monkeypatch.setattr(base.Publisher, "delivered",
                        lambda self, within_s=0.0: waited.append((self.link.topic, within_s)))
    node = make(EncoderDriver)
    node.leaving_s = leaving_s
    topics = [publisher.link.topic for publisher in node.publishers_of_links]
    node.destroy_node()
    assert [topic for topic, _ in waited] == asked * topics
    assert all(0.0 < within_s <= leaving_s for _, within_s in waited)


def test_samples_before_the_recorder_listens_cost_no_look_into_the_graph(make, monkeypatch):
    """One a sample took so much of two processors that the recorder never came to listen."""
    node, looks, listeners, out = make(SimPlant, wait_for_recorder=True), [], [], []
    monkeypatch.setattr(base.Publisher, "missing", lambda self, names: looks.append(names) or [
        name for name in names if name not in listeners])
    monkeypatch.setattr(base.Publisher, "put", lambda self, data, named: out.append(data))
    for _ in range(50):
        node._on_timer()
        node._publish_samples(node.now_ns())
    assert (looks, out) == ([], [])
    node._open_links()
    assert not node.links_open
    assert len(looks) == len(node.publishers_of_links)  # none waits for another
    listeners += looks[0]
    node._open_links()
    node._on_timer()
    assert node.links_open
    assert out


@pytest.mark.parametrize("kind", [EncoderDriver, TrajectoryGenerator, AmplifierDriver, SimPlant])
def test_what_is_done_each_second_is_done_once_and_in_pieces(make, monkeypatch, kind):
    node, done = make(kind), []
    monkeypatch.setattr(node._watch, "look", lambda _: done.append("look"))
    monkeypatch.setattr(node, "_look_for_namesakes", lambda: done.append("namesakes"))
    monkeypatch.setattr(node, "_diagnostics", SimpleNamespace(publish=lambda data: done.extend(
        each.name for each in deserialize_message(data, DiagnosticArray).status)))
    clock = SimpleNamespace(monotonic=lambda: clock.now_s, now_s=100.0)
    monkeypatch.setattr(each_second, "time", clock)
    pieces = []
    for _ in range(2 * PIECES):
        before = len(done)
        node._next_piece()
        pieces.append(done[before:])
        clock.now_s += 1.0 / PIECES
    assert done == 2 * ["look", "namesakes", node.get_fully_qualified_name()]
    assert max(map(len, pieces)) == 1
    assert pieces[:PIECES] == pieces[PIECES:]
    done.clear()
    for _ in range(5):  # asked late, it does what is due by then
        node._next_piece()
        clock.now_s += 0.5
    assert done == 2 * ["look", "namesakes", node.get_fully_qualified_name()]


def test_a_round_of_too_many_pieces_takes_longer_than_a_second(make, monkeypatch):
    node, ends = make(EncoderDriver), []

    def many():
        yield from range(PIECES + 3)
        ends.append(clock.now_s)

    clock = SimpleNamespace(monotonic=lambda: clock.now_s, now_s=0.0)
    monkeypatch.setattr(each_second, "time", clock)
    monkeypatch.setattr(node, "each_second", many)
    while clock.now_s < 5.0:
        node._next_piece()
        clock.now_s += 1.0 / PIECES
    assert len(ends) == 3
