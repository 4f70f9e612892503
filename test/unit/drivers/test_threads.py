"""The threads that own the devices: what ends in zero, what comes back, and what never does."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import pytest
from memory_port import Ports

from dfm_stage.drivers.amplifiers import copley_ascii
from dfm_stage.drivers.amplifiers.copley_ascii import CopleyAscii
from dfm_stage.drivers.device import EncoderSample, create_amplifier, create_encoder, names
from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
from dfm_stage.drivers.errors import DeviceLostError, DriverError, RefusedError
from dfm_stage.drivers.interlock import Cause, Interlock
from dfm_stage.drivers.threads import AmplifierWorker, EncoderReader


def eventually(condition, what="it"):
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not happen"
        time.sleep(0.001)


class Listener:
    def __init__(self):
        self.outputs, self.statuses = [], []
        self.broken = False

    def on_output(self, counts, answered):
        self.outputs.append((counts, answered))
        if self.broken and counts:
            raise ZeroDivisionError("a bug")

    def on_status(self, status):
        self.statuses.append(status)


class Rig:
    """A worker on the real driver on the emulator, in memory."""

    def __init__(self, stale_s=10.0, **options):
        self.emulator = CopleyAsciiEmulator()
        self.ports = Ports(self.emulator)
        self.device = CopleyAscii("port", open_port=self.ports, peak_limit_a=2.0,
                                  continuous_limit_a=1.0, reply_s=0.005)
        self.device.open()
        self.interlock = Interlock(2.0, stale_s, on_trip=lambda *_: self.worker.nudge())
        self.listener = Listener()
        self.seq = 0
        self.worker = AmplifierWorker(self.device, self.interlock, self.listener,
                                      current_limit_a=1.0, retry_s=0.01,
                                      question_period_s=0.002, **options)
        self.worker.start()

    def command(self, amperes, tag=None):
        self.seq += 1
        message = SimpleNamespace(voltage=amperes, seq=self.seq, saturated=False,
                                  measurement_stamp_ns=0)
        value = self.interlock.accept(message, time.monotonic(), 0)
        if self.interlock.armed:
            self.worker.command(value, tag)

    def run(self, amperes=0.5):
        self.worker.arm()
        self.command(amperes)
        eventually(lambda: self.current() == pytest.approx(amperes), "current")

    def current(self):
        return self.emulator.current(time.monotonic())

    def assert_off_for_good(self, cause):
        eventually(lambda: not self.emulator.enabled and self.current() == 0.0, "zero")
        eventually(lambda: not self.worker._energised)
        assert self.interlock.causes == cause
        self.command(0.5)
        with pytest.raises(RefusedError):
            self.worker.arm()
        time.sleep(0.02)
        assert not self.emulator.enabled
        assert self.listener.outputs[-1][0] == 0


@pytest.fixture
def rig(monkeypatch):
    monkeypatch.setattr(copley_ascii.copley, "BAUD_SETTLING_S", 0.0)
    made = []

    def make(**options):
        made.append(Rig(**options))
        return made[-1]

    yield make
    for each in made:
        each.worker.stop()
        assert not each.emulator.enabled
        assert not each.worker._thread.is_alive()


def test_commands_go_out_with_their_tag_and_stop_is_off(rig):
    stage = rig()
    stage.worker.arm()
    stage.command(0.2, "first")
    eventually(lambda: (20, "first") in stage.listener.outputs)
    stage.worker.stop()
    assert not stage.emulator.enabled
    assert stage.interlock.causes == Cause.SHUTDOWN


def test_nothing_goes_out_before_arm_or_after_disarm(rig):
    stage = rig()
    stage.command(0.5)
    stage.worker.command(0.5, None)
    time.sleep(0.02)
    assert not stage.emulator.enabled
    stage.run()
    stage.worker.disarm()
    assert not stage.emulator.enabled
    assert stage.current() == 0.0
    stage.run(-0.3)


def test_commands_that_stop(rig):
    stage = rig(stale_s=0.05)
    stage.run()
    stage.assert_off_for_good(Cause.STALE_COMMAND)
    assert "stale command" in stage.worker.clear()
    assert not stage.emulator.enabled
    stage.run(0.1)


def test_a_trip_from_elsewhere(rig):
    stage = rig()
    stage.run()
    stage.interlock.trip(Cause.ENCODER, "lost")
    stage.assert_off_for_good(Cause.ENCODER)


@pytest.mark.parametrize("fault", [["fault", "0x4"], ["enable", "off"]])
def test_the_drive_s_own_troubles(rig, fault):
    stage = rig()
    stage.run()
    stage.emulator.inject(fault, time.monotonic())
    stage.assert_off_for_good(Cause.DRIVE)
    stage.emulator.inject(["enable", "on"], time.monotonic())
    time.sleep(0.02)
    assert stage.current() == 0.0, "the enable input alone brings nothing back"
    stage.worker.clear()
    stage.run()


def test_too_much_current_measured(rig):
    stage = rig()
    stage.run(0.9)
    stage.device.set_counts = lambda counts, real=stage.device.set_counts: real(
        150 if counts else 0)
    stage.command(0.8)
    stage.assert_off_for_good(Cause.CURRENT)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_target_that_is_no_number(rig, value):
    stage = rig()
    stage.run()
    stage.worker.command(value, None)
    stage.assert_off_for_good(Cause.NOT_FINITE)


def test_an_exception_anywhere_is_zero(rig):
    stage = rig()
    stage.run(0.1)
    stage.listener.broken = True
    stage.command(0.4)
    stage.assert_off_for_good(Cause.INTERNAL)
    stage.listener.broken = False


def test_an_order_that_fails_by_a_bug_is_no_success(rig, monkeypatch):
    def broken():
        raise ZeroDivisionError("a bug")

    stage = rig()
    monkeypatch.setattr(stage.device, "clear_faults", broken)
    with pytest.raises(DriverError, match="a bug"):
        stage.worker.clear()


def test_a_drive_that_comes_back_stays_off_and_is_asked_for_again(rig):
    stage = rig()
    stage.run()
    stage.ports.opened[-1].close()
    stage.worker.nudge()
    stage.command(0.6)
    eventually(lambda: len(stage.ports.opened) > 1 and stage.worker.connected, "reconnection")
    assert stage.ports.opened[-1].sent[:3] == [b"<break>", b"s r0x02 0\r", b"s r0x24 0\r"]
    stage.assert_off_for_good(Cause.LINK)
    stage.worker.clear()
    stage.run(0.2)


def test_while_it_is_gone_orders_are_refused(rig, monkeypatch):
    stage = rig()
    stage.run()

    def gone(path, baud):
        raise DeviceLostError("no port")

    stage.device._open_port = gone
    stage.ports.opened[-1].close()
    stage.worker.nudge()
    eventually(lambda: not stage.worker.connected)
    with pytest.raises(RefusedError, match="does not answer"):
        stage.worker.arm()
    stage.device._open_port = stage.ports
    eventually(lambda: stage.worker.connected)


def test_a_refused_arm_leaves_it_off(rig):
    stage = rig()
    stage.emulator.inject(["fault", "0x4"], 0.0)
    with pytest.raises(RefusedError, match="short"):
        stage.worker.arm()
    assert not stage.emulator.enabled
    assert not stage.interlock.armed
    stage.worker.clear()
    stage.run()


# Encoder


class Counter:
    """A device by script: lists of samples, or an error, for each read."""

    sample_period_s = 1 / 512

    def __init__(self, *reads):
        self.reads = list(reads)
        self.calls = []
        self.counters = {}
        self.failing_opens = 0

    def open(self):
        self.calls.append("open")
        if self.failing_opens:
            self.failing_opens -= 1
            raise DeviceLostError("not yet")
        return "a counter"

    def start(self):
        self.calls.append("start")

    def stop(self):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")

    def seek_index(self):
        self.calls.append("seek_index")

    def index_found(self):
        return False

    def read(self, _timeout_s):
        time.sleep(0.001)
        what = self.reads.pop(0) if self.reads else []
        if isinstance(what, Exception):
            raise what
        return what


class Heard:
    def __init__(self):
        self.events = []

    def on_sample(self, sample):
        self.events.append(sample.seq)

    def on_lost(self, why):
        self.events.append(f"lost: {why}")

    def on_back(self, identity):
        self.events.append(f"back: {identity}")

    def on_index(self):
        self.events.append("index")


def sample(seq):
    return EncoderSample(seq, seq, seq, 1 / 512)


@pytest.mark.parametrize("error", [DeviceLostError("pulled"), ZeroDivisionError("a bug")])
def test_an_encoder_that_is_lost_is_reported_and_looked_for(error):
    counter, heard = Counter([sample(1)], error), Heard()
    counter.failing_opens = 2
    reader = EncoderReader(counter, heard, timeout_s=5.0, retry_s=0.001)
    reader.start()
    eventually(lambda: "back: a counter" in heard.events)
    eventually(lambda: counter.calls.count("start") == 2)
    reader.stop()
    assert heard.events == [1, f"lost: {error}", "back: a counter"]
    assert counter.calls[:8] == ["start", "close", "open", "close", "open", "close", "open",
                                 "start"]
    assert reader.reconnects == 2


def test_samples_that_stop_are_a_lost_encoder():
    heard = Heard()
    reader = EncoderReader(Counter([sample(1)], [sample(2)]), heard, timeout_s=0.03,
                           retry_s=10.0)
    reader.start()
    eventually(lambda: reader.lost)
    reader.stop()
    assert heard.events == [1, 2, "lost: no sample for 30 ms"]


def test_stopping_stops_the_stream():
    counter = Counter()
    reader = EncoderReader(counter, Heard(), timeout_s=30.0)
    reader.start()
    reader.seek_index()
    eventually(lambda: "seek_index" in counter.calls)
    reader.stop()
    assert counter.calls == ["start", "seek_index", "stop"]


# Finding drivers


def test_a_driver_is_found_by_the_name_of_its_file():
    assert names("encoders") == ("qsb_d",)
    assert names("amplifiers") == ("copley_ascii",)
    assert type(create_encoder("qsb_d", "/dev/x", stream_interval=4)).__name__ == "QsbD"
    assert type(create_amplifier("copley_ascii", "/dev/x", peak_limit_a=1.0,
                                 continuous_limit_a=1.0)).__name__ == "CopleyAscii"
    with pytest.raises(DriverError, match="needs the parameter port"):
        create_encoder("qsb_d", "")
    with pytest.raises(DriverError, match="no driver 'abacus' among encoders: qsb_d"):
        create_encoder("abacus", "/dev/x")
