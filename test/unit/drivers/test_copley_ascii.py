"""The Copley driver and its emulator: start-up, arming, refusals, faults, all on the wire."""

from __future__ import annotations

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_port import Ports, talk

from dfm_stage.drivers.amplifiers import copley_ascii
from dfm_stage.drivers.amplifiers.copley_ascii import CopleyAscii
from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
from dfm_stage.drivers.errors import DeviceLostError, DriverError, IdentityError, RefusedError

OPEN = [b"<break>", b"s r0x02 0\r", b"s r0x24 0\r", b"g r0x24\r", b"g f0x24\r", b"g f0x02\r",
        b"s r0x90 115200\r", b"<baud 115200>", b"g r0x90\r", b"g r0x90\r"]
ARM = [b"s r0x02 0\r", b"s r0x24 0\r", b"g r0xa4\r", b"g r0x21\r", b"g r0x22\r", b"g r0x23\r",
       b"s r0x6a 0\r", b"s r0x24 1\r", b"g r0xa0\r"]
DISARM = [b"s r0x02 0\r", b"s r0x24 0\r"]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Wait for nothing that only a wire needs."""
    monkeypatch.setattr(copley_ascii.copley, "BAUD_SETTLING_S", 0.0)
    monkeypatch.setattr(copley_ascii, "ENABLE_S", 0.02)


def driver(emulator=None, answers=None, baud=115200, **limits):
    ports = Ports(emulator, answers)
    limits = {"peak_limit_a": 2.0, "continuous_limit_a": 1.0, **limits}
    return CopleyAscii("port", baud, open_port=ports, **limits), ports


# The emulator


def test_the_examples_of_the_maker():
    emulator = CopleyAsciiEmulator()
    assert talk(emulator, b"s r0x24 1\r", b"s r0x02 -20\r", b"g r0x0c\r", b"r 0x30\r",
                b"g r 0x30\r") == [b"ok\r", b"ok\r", b"v -20\r", b"e 33\r", b"e 33\r"]
    assert emulator.current(0.0) == pytest.approx(-0.2)
    assert talk(emulator, b"r\r") == [b""]
    assert emulator.current(0.0) == 0.0


@pytest.mark.parametrize(("command", "answer"), [
    (b"q\r", b"e 3\r"), (b"s\r", b"e 4\r"), (b"s r0x02\r", b"e 4\r"),
    (b"s r0x02 1 2\r", b"e 5\r"), (b"g r0x0c 1\r", b"e 5\r"), (b"g r0x7f\r", b"e 9\r"),
    (b"s r0x02 99999\r", b"e 10\r"), (b"s r0x24 7\r", b"e 10\r"), (b"s r0x0c 1\r", b"e 11\r"),
    (b"t 1\r", b"e 14\r"), (b"g f0xa0\r", b"e 15\r"), (b"s r0x02 x\r", b"e 33\r"),
    (b"\ns r0x02 1\r", b"e 33\r"), (b".Q s r0x02 1\r", b"e 36\r"), (b".A s r0x02 1\r", b"ok\r"),
    (b"1 g r0x20\r", b"v 31\r"), (b"s r0x02 -007\r", b"ok\r"), (b"g r032\r", b"v 31\r"),
    (b"s r0x90 4242\r", b"e 10\r"), (b"g r0x02\r", b"v 0\r"),
    (b"\r", b""),
])
def test_error_replies(command, answer):
    assert talk(CopleyAsciiEmulator(), command) == [answer]


def test_the_rate_changes_with_its_own_acknowledgement_and_noise_takes_it_back():
    emulator = CopleyAsciiEmulator()
    assert emulator.baud == 9600
    talk(emulator, b"s r0x24 1\r", b"s r0x02 50\r", b"s r0x90 115200\r")
    assert emulator.baud == 115200
    assert talk(emulator, b"g r0x90\r") == [b"v 115207\r"]
    emulator.wrong_baud(0.0)
    assert emulator.baud == 9600
    assert emulator.current(0.0) == 0.5, "nothing but the rate is lost: the current stays"


@pytest.mark.parametrize("first", [b"\x00", b"\x80", b"\xff"])
def test_a_first_byte_starts_binary_mode_until_a_break(first):
    emulator = CopleyAsciiEmulator()
    assert talk(emulator, first + b"\r", b"g r0x20\r") == [b"", b""]
    emulator.wrong_baud(0.0)
    assert talk(emulator, b"g r0x20\r") == [b"v 31\r"]


def test_faults_and_the_enable_input_take_the_current_and_only_the_input_gives_it_back():
    seen = []
    emulator = CopleyAsciiEmulator(lambda now, amperes, on: seen.append((now, amperes, on)))
    talk(emulator, b"s r0x24 1\r", b"s r0x02 50\r")
    emulator.inject(["enable", "off"], 1.0)
    assert talk(emulator, b"g r0xa0\r") == [b"v %d\r" % (1 << 11 | 1 << 15 | 1 << 20)]
    emulator.inject(["enable", "on"], 2.0)
    emulator.inject(["fault", "0x4"], 3.0)
    assert talk(emulator, b"g r0xa4\r") == [b"v 4\r"]
    assert talk(emulator, b"s r0xa4 4\r", b"g r0xa4\r") == [b"ok\r", b"v 0\r"]
    assert [(amperes, on) for _, amperes, on in seen] == [
        (0.0, True), (0.5, True), (0.0, False), (0.5, True), (0.0, False), (0.5, True)]


def test_a_ramp_and_the_limits_of_the_drive():
    emulator = CopleyAsciiEmulator()
    talk(emulator, b"s r0x6a 1000\r", b"s r0x24 1\r", b"s r0x02 100\r")
    assert emulator.current(0.25) == pytest.approx(0.25)
    assert emulator.current(5.0) == pytest.approx(1.0)
    talk(emulator, b"s r0x6a 0\r", b"s r0x02 300\r", now=10.0)
    assert emulator.current(10.0) == pytest.approx(2.0)
    assert emulator.current(11.5) == pytest.approx(1.0)


# The driver


def test_opening_on_the_wire_leaves_zero_and_off_and_writes_no_flash():
    emulator = CopleyAsciiEmulator()
    device, ports = driver(emulator)
    assert device.open() == "Copley drive at 115207 baud"
    assert ports.sent == OPEN
    assert not emulator.enabled
    assert not any(b"f0x" in data for data in ports.sent if data.startswith(b"s"))


def test_a_drive_left_with_current_at_the_working_rate_is_zeroed():
    emulator = CopleyAsciiEmulator()
    talk(emulator, b"s r0x24 1\r", b"s r0x02 50\r", b"s r0x90 115200\r")
    device, _ = driver(emulator)
    device.open()
    assert emulator.current(time.monotonic()) == 0.0
    assert not emulator.enabled


def test_at_9600_there_is_no_change_of_rate():
    device, ports = driver(CopleyAsciiEmulator(), baud=9600)
    device.open()
    assert not any(b"0x90 " in data for data in ports.sent)


def test_arming_setting_and_disarming_on_the_wire():
    emulator = CopleyAsciiEmulator()
    device, ports = driver(emulator)
    device.open()
    before = len(ports.sent)
    device.arm()
    device.set_counts(-20)
    assert ports.sent[before:] == [*ARM, b"s r0x02 -20\r"]
    assert emulator.current(time.monotonic()) == pytest.approx(-0.2)
    before = len(ports.sent)
    device.disarm()
    assert ports.sent[before:] == DISARM
    assert not emulator.enabled


@pytest.mark.parametrize("flash", [{0x24: 1, 0x02: 30}, {0x24: 21}])
def test_a_flash_that_would_energise_the_coil_is_refused(flash):
    device, _ = driver(CopleyAsciiEmulator(flash=flash))
    with pytest.raises(RefusedError, match="power-up"):
        device.open()


@pytest.mark.parametrize(("flash", "words"), [
    ({0x21: 201}, "peak current"), ({0x22: 101}, "continuous current"), ({0x23: 1001}, "time")])
def test_a_drive_with_higher_limits_is_not_armed(flash, words):
    emulator = CopleyAsciiEmulator(flash=flash)
    device, _ = driver(emulator)
    device.open()
    with pytest.raises(RefusedError, match=words):
        device.arm()
    assert not emulator.enabled


def test_latched_faults_are_cleared_by_an_operator_only():
    emulator = CopleyAsciiEmulator()
    device, ports = driver(emulator)
    device.open()
    emulator.inject(["fault", "0x404"], 0.0)
    with pytest.raises(RefusedError, match="short, overcurrent"):
        device.arm()
    assert not any(data.startswith(b"s r0xa4") for data in ports.sent)
    assert device.clear_faults() == "short, overcurrent"
    assert ports.sent[-1] == b"s r0xa4 1028\r"
    device.arm()
    emulator.inject(["fault", "0x1"], 0.0)
    with pytest.raises(RefusedError, match="fatal"):
        device.clear_faults()


def test_without_enable_input_it_does_not_arm():
    emulator = CopleyAsciiEmulator()
    device, _ = driver(emulator)
    device.open()
    emulator.inject(["enable", "off"], 0.0)
    with pytest.raises(RefusedError, match="enable input inactive"):
        device.arm()
    emulator.inject(["enable", "on"], 0.0)
    assert not emulator.enabled


def ask_all(device):
    seen = {"current": [], "trouble": [], "limit": [], "notes": {}}
    for _ in range(60):
        status = device.status()
        seen["current"] += [] if status.current_a is None else [status.current_a]
        seen["trouble"] += [] if not status.trouble else [status.trouble]
        seen["notes"] |= status.notes or {}
    return seen


def test_questions_bring_current_temperature_voltage_and_faults():
    emulator = CopleyAsciiEmulator()
    device, _ = driver(emulator)
    device.open()
    device.arm()
    device.set_counts(30)
    seen = ask_all(device)
    assert set(seen["current"]) == {0.3}
    assert seen["trouble"] == []
    assert seen["notes"] == {"baud": "115207", "drive status": "reset", "latched faults": "none",
                             "drive temperature": "31 degC", "bus voltage": "48 V"}
    emulator.inject(["fault", "0x20"], 0.0)
    assert any("latched" in words for words in ask_all(device)["trouble"])


def test_garbled_and_missing_replies_are_asked_again_and_counted():
    device, ports = driver(answers=[b"\x90\x13k\r", b"", b"ok\r"])
    device._opened = ports("port", 115200)
    device.set_counts(5)
    assert ports.sent == [b"s r0x02 5\r"] * 3
    assert device.counters == {"malformed_lines": 1, "retries": 2, "error_replies": 0}


def test_a_late_reply_is_not_taken_for_the_next_one():
    device, ports = driver(answers=[b"v 7\r"])
    port = device._opened = ports("port", 115200)
    port.pending = b"v 99\rok\r"
    assert device.request(b"g r0x20\r").value == 7
    assert device.counters["malformed_lines"] == 2


def test_an_answer_to_an_earlier_question_acknowledges_nothing():
    device, ports = driver(answers=[b"v 1085440\rok\r", b"ok\rv 3\r"])
    device._opened = ports("port", 115200)
    device.set_counts(0)
    assert device.request(b"g r0x20\r").value == 3
    assert device.counters["malformed_lines"] == 2


def test_silence_is_a_lost_drive():
    device, ports = driver(answers=[])
    with pytest.raises(DeviceLostError, match="no answer to s r0x02 0 at 9600"):
        device.open()
    assert ports.sent == [b"<break>", *[b"s r0x02 0\r"] * 3]


def test_what_answers_otherwise_is_no_drive():
    device, _ = driver(answers=[b"e 3\r"] * 9)
    with pytest.raises(IdentityError, match="not a Copley drive"):
        device.open()


def test_on_a_real_serial_stack_with_its_faults(plug_in, monkeypatch):
    monkeypatch.setattr(copley_ascii.copley, "BAUD_SETTLING_S", 0.2)
    monkeypatch.setattr(copley_ascii, "ENABLE_S", 0.5)
    emulator = CopleyAsciiEmulator()
    port = plug_in(emulator)
    device = CopleyAscii(port.path, peak_limit_a=2.0, continuous_limit_a=1.0)
    assert "115207" in device.open()
    device.arm()
    for counts in range(20):
        device.set_counts(counts)
    assert emulator.current(time.monotonic()) == pytest.approx(0.19)
    port.inject("partial")
    device.set_counts(1)
    assert device.counters["retries"] >= 1
    port.inject("silence 0.3")
    with pytest.raises(DeviceLostError):
        device.set_counts(2)
    device.close()
    time.sleep(0.3)
    device.open()
    assert emulator.current(time.monotonic()) == 0.0
    device.close()


VALUES = [b"ok\r", b"v 0\r", b"v 99999\r", b"v -5\r", b"e 14\r", b"", b"\x00", b"ok\rok\r",
          b"v 1\rv 2\r", b"v\r", b"v 4096\r"]


@settings(max_examples=80)
@given(st.lists(st.one_of(st.binary(max_size=30), st.sampled_from(VALUES)), max_size=40))
def test_no_replies_crash_the_driver_or_move_the_output(answers):
    monkey = pytest.MonkeyPatch()
    monkey.setattr(copley_ascii, "_LINE_BITS", 0)
    try:
        device, ports = driver(answers=list(answers), reply_s=0.0005)
        for action in (device.open, device.arm, device.status, device.status,
                       device.clear_faults, device.disarm):
            try:
                action()
            except DriverError:
                continue
    finally:
        monkey.undo()
    outputs = {data for data in ports.sent if data.startswith(b"s r0x02")}
    assert outputs <= {b"s r0x02 0\r"}


@settings(max_examples=100)
@given(st.lists(st.binary(max_size=40), max_size=12))
def test_no_bytes_crash_the_emulator(chunks):
    emulator = CopleyAsciiEmulator()
    for index, chunk in enumerate(chunks):
        emulator.receive(chunk, index * 0.01)
        emulator.advance(index * 0.01)
