"""Handing over within a process, held against what the same nodes hear by DDS."""

from __future__ import annotations

import itertools
import threading
import time

import pytest
import rclpy
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from dfm_interfaces.msg import Measurement
from dfm_stage.middleware import hand_over
from dfm_stage.middleware.hand_over import (
    Receiver,
    Sender,
    handing_over,
    in_a_turn,
    in_spare_time,
    keep_time,
)
from dfm_stage.middleware.wire import codec, encode_joint_state
from dfm_stage.nodes.process import make_executor
from dfm_stage.nodes.wiring import LOCKSTEP_QOS, PUBLISHER_QOS, SUBSCRIBER_QOS

NUMBERS = itertools.count()  # what a test before left on DDS is a listener, too
DATA = [codec(Measurement, "x").encode(k, k, 0.5, 7, 0) for k in range(200)]


class Process:
    """Two nodes on one executor."""

    def __init__(self, context):
        self.context = context
        self.one, self.two = (rclpy.create_node(name, context=context) for name in ("one", "two"))
        self.executor = make_executor(context)
        for node in (self.one, self.two):
            self.executor.add_node(node)
        self.heard = []
        self.topic = f"topic_{next(NUMBERS)}"

    def sender(self, topic=None, qos=LOCKSTEP_QOS):
        return Sender(self.one, Measurement, topic or self.topic, qos)

    def receiver(self, callback=None, topic=None, qos=LOCKSTEP_QOS):
        return Receiver(self.two, Measurement, topic or self.topic,
                        callback or self.heard.append, qos)

    def spin(self, times=40):
        for _ in range(times):
            self.executor.spin_once(0.005)


@pytest.fixture(params=["events", "default"])
def process(request, monkeypatch, ros):
    monkeypatch.setenv("DFM_EXECUTOR", request.param)
    context = ros()
    made = Process(context)
    with handing_over(context, made.executor):
        yield made
    for node in (made.one, made.two):
        made.executor.remove_node(node)
        node.destroy_node()
    context.try_shutdown()
    assert context not in hand_over._open


@pytest.fixture
def on_the_wire(monkeypatch):
    """What senders put on DDS."""
    sent, real = [], Sender.to_dds
    monkeypatch.setattr(Sender, "to_dds",
                        lambda self, data: (sent.append(data), real(self, data)))
    return sent


def test_nothing_goes_to_dds_where_nobody_else_listens(process, on_the_wire):
    process.receiver()
    sender = process.sender()
    sender.put(DATA[0])
    assert process.heard == []  # never from within the call
    assert not sender.delivered()
    process.spin()
    assert process.heard == DATA[:1]
    assert sender.delivered()
    assert on_the_wire == []


def test_a_plain_subscription_hears_all_and_a_receiver_nothing_twice(process, on_the_wire):
    plain = []
    process.receiver()
    sender = process.sender()
    sender.put(DATA[0])
    listening = process.two.create_subscription(Measurement, process.topic, plain.append,
                                                LOCKSTEP_QOS, raw=True)
    for data in DATA[1:100]:
        sender.put(data)
    process.spin(300)
    process.two.destroy_subscription(listening)
    process.spin()
    alone = sender.ros.get_subscription_count() == 1  # the default executor keeps what it spun
    for data in DATA[100:]:
        sender.put(data)
    process.spin(300)
    assert process.heard == DATA
    assert plain == DATA[1:100]
    assert on_the_wire == DATA[1:100 if alone else None]


def test_a_plain_publisher_reaches_a_receiver_between_what_is_handed_over(process):
    process.receiver()
    sender = process.sender()
    foreign = process.two.create_publisher(Measurement, process.topic, LOCKSTEP_QOS)
    process.two.create_subscription(Measurement, process.topic, len, LOCKSTEP_QOS, raw=True)
    for k in range(0, 100, 2):
        sender.put(DATA[k])
        foreign.handle.publish_raw(DATA[k + 1])
    process.spin(500)
    assert sorted(process.heard) == sorted(DATA[:100])
    assert [each for each in process.heard if each in DATA[:100:2]] == DATA[:100:2]
    assert [each for each in process.heard if each in DATA[1:100:2]] == DATA[1:100:2]


def test_what_a_callback_puts_comes_after_it_and_in_order(process):
    first, second = process.sender("first"), process.sender("second")
    order, inside = [], []

    def relay(data):
        inside.append(True)
        assert len(inside) == 1
        second.put(data)
        order.append(("first", data))
        inside.pop()

    process.receiver(relay, "first")
    process.receiver(lambda data: order.append(("second", data)), "second")
    for data in DATA[:3]:
        first.put(data)
    process.spin()
    assert order == [(topic, data) for topic in ("first", "second") for data in DATA[:3]]


def test_what_a_callback_raises_reaches_whoever_spins_and_nothing_is_lost(process):
    def refuse(data):
        if data == DATA[1]:
            raise ValueError("refused")
        process.heard.append(data)

    process.receiver(refuse)
    sender = process.sender()
    for data in DATA[:4]:
        sender.put(data)
    with pytest.raises(ValueError, match="refused"):
        process.spin()
    process.spin()
    assert process.heard == [DATA[0], *DATA[2:4]]


@pytest.mark.parametrize(("qos", "expected"), [
    (LOCKSTEP_QOS, DATA[:5]), (PUBLISHER_QOS, DATA[:5]), (SUBSCRIBER_QOS, DATA[4:5])])
def test_a_receiver_keeps_as_many_as_its_subscription_would(process, qos, expected):
    by_dds = []
    process.receiver(qos=qos)
    process.two.create_subscription(Measurement, process.topic, by_dds.append, qos, raw=True)
    sender = process.sender()
    for data in DATA[:5]:
        sender.put(data)
    process.spin(100)
    assert process.heard == by_dds == expected


def test_one_that_has_left_hears_no_more_by_call(process):
    receiver = process.receiver()
    sender = process.sender()
    sender.put(DATA[0])
    receiver.leave()
    process.two.destroy_subscription(receiver.ros)
    sender.put(DATA[1])
    process.spin()
    assert process.heard == []


def test_a_node_that_another_executor_spins_hears_there_and_nowhere_else(process):
    process.receiver()
    sender = process.sender()
    sender.put(DATA[0])
    process.executor.remove_node(process.two)
    for data in DATA[1:50]:
        sender.put(data)
    process.spin()
    assert process.heard == []
    assert sender.delivered()
    other = make_executor(process.context)
    other.add_node(process.two)
    for _ in range(100):
        other.spin_once(0.005)
    assert process.heard == DATA[1:50]
    other.remove_node(process.two)
    process.executor.add_node(process.two)
    for data in DATA[50:]:
        sender.put(data)
    process.spin(300)
    assert process.heard == DATA[1:]


def test_timers_have_their_turn_where_messages_never_end(process):
    sender, ticks = process.sender(), []
    process.receiver(sender.put)
    process.one.create_timer(0.005, lambda: ticks.append(1),
                             clock=Clock(clock_type=ClockType.STEADY_TIME))
    sender.put(DATA[0])
    until = time.monotonic() + 5.0
    while len(ticks) < 10 and time.monotonic() < until:
        process.executor.spin_once(0.01)
    assert len(ticks) >= 10


def test_a_message_of_another_thread_is_received_in_the_one_that_spins(process):
    threads = []
    process.receiver(lambda _: threads.append(threading.get_ident()))
    sender = process.sender()
    other = threading.Thread(target=sender.put, args=(DATA[0],))
    other.start()
    other.join()
    process.spin()
    assert threads == [threading.get_ident()]


def test_names_are_told_apart_by_namespace_and_context(process, domain_of):
    elsewhere = domain_of.create_node("elsewhere")
    stranger = []
    process.receiver(topic="/a/t")
    ears = Receiver(elsewhere, Measurement, "/t", stranger.append, LOCKSTEP_QOS)
    sender = process.sender("/t")
    until = time.monotonic() + 10.0
    while not (sender.ros.get_subscription_count() and ears.ros.get_publisher_count()):
        assert time.monotonic() < until
        process.spin(1)
    for data in DATA:
        sender.put(data)
    while len(stranger) < len(DATA) and time.monotonic() < until:
        domain_of.executor.spin_once(0.01)
    assert stranger == DATA
    assert process.heard == []


@pytest.fixture
def domain_of(ros):
    """A context of its own in the same domain, as another process has one."""
    class Elsewhere:
        context = ros()

        def create_node(self, name):
            self.node = rclpy.create_node(name, context=self.context)
            self.executor = make_executor(self.context)
            self.executor.add_node(self.node)
            return self.node

    made = Elsewhere()
    yield made
    made.executor.remove_node(made.node)
    made.node.destroy_node()


@pytest.mark.parametrize("name", ["", "x", "xy", "abc", "abcd", "axis_12"])
def test_a_joint_state_is_that_of_rclpy(name):
    from rclpy.serialization import deserialize_message

    header = Header()
    header.stamp.sec, header.stamp.nanosec = 5, 7
    assert deserialize_message(encode_joint_state(5_000_000_007, name.encode(), -1.25e-3),
                               JointState) == JointState(header=header, name=[name],
                                                         position=[-1.25e-3])


def test_who_keeps_arrivals_gets_them_in_order_beside_who_is_called(process):
    arrivals = []
    process.receiver()
    for number, topic in enumerate((process.topic, process.topic + "_other")):
        Receiver(process.two, Measurement, topic, None, LOCKSTEP_QOS, arrivals=arrivals,
                 number=number)
    senders = [process.sender(), process.sender(process.topic + "_other")]
    for index, data in enumerate(DATA[:4]):
        senders[index % 2].put(data)
    assert [(number, data) for number, data, _ in arrivals] == [
        (index % 2, DATA[index]) for index in range(4)]
    assert sorted(when for _, _, when in arrivals) == [when for _, _, when in arrivals]
    process.spin()
    assert process.heard == DATA[0:4:2]


@pytest.mark.parametrize("outside", [False, True])
def test_who_wants_fields_gets_them_decoded_or_as_they_were_put(process, outside):
    measurement = codec(Measurement, "x")
    sender, order = process.sender(), []
    Receiver(process.two, Measurement, process.topic, order.append, LOCKSTEP_QOS,
             decode=measurement.decode)
    receiver = process.receiver(order.append)
    if outside:
        process.two.create_subscription(Measurement, process.topic, len, LOCKSTEP_QOS, raw=True)
    data, fields = measurement.pair(5, 6, 0.5, 7, 0)
    sender.put(data, fields)
    sender.put(DATA[1])
    process.spin()
    assert order == [fields, data, measurement.decode(DATA[1]), DATA[1]]
    assert order[0] is fields
    assert receiver.received == 2
    process.two.create_publisher(Measurement, process.topic, LOCKSTEP_QOS).handle.publish_raw(data)
    process.spin()
    assert sorted(order[4:], key=len) == [fields, data]


def test_who_joins_in_a_turn_hears_from_the_next_one_on(process, on_the_wire):
    sender, joined = process.sender(), []

    def join(data):
        process.heard.append(data)
        if data == DATA[0]:
            sender.put(DATA[1])
            joined.append(process.two.create_subscription(
                Measurement, process.topic, len, LOCKSTEP_QOS, raw=True))
            while sender.ros.get_subscription_count() < 2:
                time.sleep(0.001)
            sender.put(DATA[2])

    process.receiver(join)
    sender.put(DATA[0])
    process.spin()
    assert joined
    sender.put(DATA[3])
    process.spin()
    assert process.heard == DATA[:4]
    assert on_the_wire == DATA[3:4]


def test_who_is_outside_is_sent_to_when_all_in_the_process_have_been_called(process, monkeypatch):
    order = []
    monkeypatch.setattr(Sender, "to_dds", lambda _, data: order.append(("outside", data)))
    first, second = process.sender(process.topic), process.sender(process.topic + "_2")
    process.receiver(lambda data: (order.append(("one", data)), second.put(data)))
    process.receiver(lambda data: order.append(("two", data)), process.topic + "_2")
    for name in ("", "_2"):
        process.two.create_subscription(Measurement, process.topic + name, len, LOCKSTEP_QOS,
                                        raw=True)
    in_a_turn(process.one, lambda: first.put(DATA[0]))()
    assert order == [(who, DATA[0]) for who in ("one", "two", "outside", "outside")]
    other = threading.Thread(target=first.put, args=(DATA[1],))
    other.start()
    other.join()  # outside a turn, and so at once
    assert order[4:] == [("outside", DATA[1])]


def test_what_begins_a_turn_is_handed_over_without_another(process):
    process.receiver()
    sender = process.sender()
    in_a_turn(process.one, lambda: [sender.put(data) for data in DATA[:3]])()
    assert process.heard == DATA[:3]
    sender.put(DATA[3])  # what was due before such a turn goes with it
    in_a_turn(process.one, lambda: sender.put(DATA[4]))()
    assert process.heard == DATA[:5]
    process.spin()
    assert process.heard == DATA[:5]


class Jobs:
    """Two jobs of a node that say when they were done."""

    def __init__(self, done):
        self.done = done

    def one(self):
        self.done.append("one")

    def two(self):
        self.done.append("two")


def test_jobs_beside_the_loop_come_at_the_end_of_a_turn_and_one_at_least(process, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(hand_over.time, "monotonic", lambda: now[0])
    done = []
    jobs = Jobs(done)
    one, two = (in_spare_time(process.one, each) for each in (jobs.one, jobs.two))
    turn = in_a_turn(process.one, lambda: done.append("turn"))
    one()
    assert done == ["one"]  # there are no turns
    turn()
    for job in (one, two, one):
        job()
    assert done == ["one", "turn"]
    for _ in range(3):
        turn()
    assert done == ["one", "turn", "turn", "one", "turn", "two", "turn"]
    for job in (one, two):
        job()
    now[0] += 1e-3  # the time since the last turn is enough for both
    turn()
    assert done[7:] == ["turn", "one", "two"]
    two()
    now[0] += 1.0  # the turns have ended
    one()
    assert done[10:] == ["two", "one"]


def test_a_node_that_ends_has_no_more_jobs(process):
    done = []
    jobs, others = Jobs(done), Jobs(done)
    turn = in_a_turn(process.one, lambda: None)
    turn()
    in_spare_time(process.one, jobs.one)()
    in_spare_time(process.one, others.two)()
    hand_over.forget(jobs)
    turn()
    turn()
    assert done == ["two"]


class Clocked:
    """A node's clock that is due every period (s)."""

    def __init__(self, period_s):
        self.period_s = period_s
        self.due_s = time.monotonic()
        self.ticks = []

    def tick(self):
        now = time.monotonic()
        self.ticks.append(now - self.due_s)
        if now >= self.due_s:
            self.due_s += self.period_s
        return self.due_s


def test_a_fast_clock_ticks_when_it_is_due_and_leaves_others_their_turn(process):
    clock, other, timers = Clocked(2e-4), Clocked(3e-4), []
    sender = process.sender()
    process.receiver()
    timer = process.two.create_timer(2e-3, lambda: timers.append(sender.put(DATA[0])),
                                     clock=Clock(clock_type=ClockType.STEADY_TIME))
    assert all(keep_time(process.one, each.tick, each.period_s) for each in (clock, other))
    give_up = time.monotonic() + 20.0
    while (min(len(clock.ticks), len(other.ticks), 25 * len(timers)) < 500
           and time.monotonic() < give_up):
        process.executor.spin_once(0.01)
    timer.cancel()
    for each in (clock, other):
        assert len(each.ticks) >= 500
        assert min(each.ticks) >= 0.0  # never before its time
    assert len(timers) >= 20
    assert len(process.heard) >= len(timers) - 1


def test_the_clock_of_a_node_that_ends_stands_still_and_another_one_starts(process):
    ended, other = Clocked(2e-4), Clocked(2e-4)
    keep_time(process.one, ended.tick, ended.period_s)
    process.spin(5)
    hand_over.forget(ended)
    ticks = len(ended.ticks)
    process.spin(5)
    assert ticks == len(ended.ticks)
    keep_time(process.one, other.tick, other.period_s)
    process.spin(20)
    assert len(other.ticks) > 20


def test_a_clock_that_is_not_fast_is_left_to_its_timer(process):
    clock = Clocked(1e-3)
    assert not keep_time(process.one, clock.tick, clock.period_s)
    process.spin(5)
    assert clock.ticks == []
