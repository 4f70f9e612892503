"""The QSB-D driver and its emulator: start-up on the wire, streaming, loss, index."""

from __future__ import annotations

import itertools
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_port import Ports, talk

from dfm_stage.drivers.emulators.qsb_d import QsbDEmulator
from dfm_stage.drivers.encoders import qsb_d
from dfm_stage.drivers.encoders.qsb_d import QsbD
from dfm_stage.drivers.errors import DeviceLostError, DriverError, IdentityError
from dfm_stage.drivers.qsb_protocol import Identity

START_UP = [b"W161\r", b"W15F\r", b"R14\r", b"W000\r", b"W0303\r", b"W040\r", b"W0B0\r",
            b"W0C1\r", b"W0D1\r", b"R06\r"]


def driver(emulator=None, answers=None, **options):
    ports = Ports(emulator, answers)
    return QsbD("port", open_port=ports, settling_s=0.0, reset_s=0.01, **options), ports


def read_until(device, count, limit_s=30.0):
    samples, deadline = [], time.monotonic() + limit_s
    while len(samples) < count and time.monotonic() < deadline:
        samples += device.read(0.01)
    return samples


# The emulator says what the maker's list says


def test_factory_defaults_count_modulo_500_in_the_long_form_without_stream():
    here = [0]
    emulator = QsbDEmulator(lambda _now: here[0])
    here[0] = 501
    assert talk(emulator, b"R0E\r", b"R03\r", b"R08\n", b"R0C\r\n", b"R15\r") == [
        b"r 0E 00000001 !\r\n", b"r 03 0000004F !\r\n", b"r 08 000001F3 !\r\n",
        b"r 0C 0000FFFF !\r\n", b"r 15 0000000B !\r\n"]
    here[0] = -1
    assert talk(emulator, b"R0E\r") == [b"r 0E 000001F3 !\r\n"]
    assert talk(emulator, b"S0E\r") == [b"s 0E 000001F3 !\r\n"]
    emulator.advance(100.0)
    assert emulator.out == []


def test_the_new_form_holds_from_its_own_acknowledgement_on():
    assert talk(QsbDEmulator(), b"W15F\r", b"W155\r") == [
        b"w 15 0000000F 00000000 !\r\n", b"w150000000500000000!\n"]


def test_short_data_is_extended_by_zeros_and_negative_takes_eight_digits():
    emulator = QsbDEmulator()
    assert talk(emulator, b"W0303\r", b"W08FFFFFF9C\r", b"W0A0\r", b"R0E\r")[-1] == (
        b"r 0E FFFFFF9C !\r\n")
    assert talk(emulator, b"W089C\r", b"W0A0\r", b"R0E\r")[-1] == b"r 0E 0000009C !\r\n"
    assert talk(emulator, b"W092\r", b"R0E\r")[-1] == b"r 0E 00000000 !\r\n"


def test_bad_values_and_unknown_registers():
    assert talk(QsbDEmulator(), b"W15FF\r", b"R15\r", b"R77\r", b"W0E5\r", b"hello\r") == [
        b"e 15 000000FF !\r\n", b"r 15 0000000B !\r\n", b"x 77 00000000 !\r\n",
        b"x 0E 00000005 !\r\n", b"x 00 00000000 !\r\n"]


def test_a_stream_comes_on_the_grid_of_the_clock_until_it_is_stopped():
    emulator = QsbDEmulator(lambda now: round(1000 * now))
    talk(emulator, b"W155\r", b"W0303\r", b"W0C2\r", b"W0D1\r", now=1.0)
    assert talk(emulator, b"S0E\r", now=1.0) == [b"s0E0000000000000000!\n"]
    emulator.advance(1.0 + 10 / 512)
    stamps = [int(line[11:19], 16) for line in emulator.out]
    counts = [int(line[3:11], 16) for line in emulator.out]
    assert stamps == [2, 4, 6, 8, 10]
    assert counts == [round(1000 * (1.0 + stamp / 512)) - 1000 for stamp in stamps]
    emulator.out.clear()
    talk(emulator, b"R0E\r", now=1.1)
    emulator.advance(2.0)
    assert emulator.out == []


def test_a_reset_says_the_banner_and_forgets_everything():
    emulator = QsbDEmulator()
    talk(emulator, b"W155\r", b"W0303\r", b"W0C1\r", b"S0E\r")
    emulator.inject(["reset"], 5.0)
    assert emulator.out == [b"QSB-D  0E!\r\n"]
    emulator.out.clear()
    emulator.advance(10.0)
    assert emulator.out == []
    assert talk(emulator, b"R03\r") == [b"r 03 0000004F !\r\n"]


def test_resolution_direction_and_threshold():
    here = [0]
    emulator = QsbDEmulator(lambda _now: here[0])
    talk(emulator, b"W155\r", b"W0301\r", b"W04100\r", b"W0B5\r", b"W0C1\r", b"W0D1\r",
         b"S0E\r")
    here[0] = 8
    emulator.advance(1.0 / 512)
    assert [line[3:11] for line in emulator.out] == [b"FFFFFFFE"]
    emulator.out.clear()
    here[0] = 12
    emulator.advance(2.0 / 512)
    assert emulator.out == []
    here[0] = 28
    emulator.advance(3.0 / 512)
    assert [line[3:11] for line in emulator.out] == [b"FFFFFFF9"]


# The driver


def test_start_up_on_the_wire():
    device, ports = driver(QsbDEmulator())
    assert device.open() == "QSB-D serial 00E5A firmware 2A"
    assert ports.sent == START_UP
    device.start()
    assert ports.sent[-1] == b"S0E\r"
    device.stop()
    assert ports.sent[-1] == b"W161\r"
    assert device.counters == {"malformed_lines": 0, "retries": 0, "resets_seen": 0}


def test_the_stream_interval_is_set():
    device, ports = driver(QsbDEmulator(), interval=16)
    device.open()
    assert b"W0C10\r" in ports.sent
    assert device.sample_period_s == 16 / 512


def test_samples_are_numbered_dated_and_not_wrapped():
    device, _ = driver(QsbDEmulator())
    device.open()
    device.start()
    before = time.time_ns()
    samples = read_until(device, 50)
    after = time.time_ns()
    assert [sample.seq for sample in samples] == list(range(samples[0].seq,
                                                            samples[0].seq + len(samples)))
    assert all(sample.elapsed_s == 1 / 512 for sample in samples[1:])
    assert all(before - 10**9 < sample.stamp_ns <= after for sample in samples)
    assert {sample.counts for sample in samples} == {0}


@pytest.mark.parametrize("raws", [
    [0x7FFFFFFE, 0x7FFFFFFF, 0x80000000, 0x80000001], [2, 1, 0, 0xFFFFFFFF, 0xFFFFFFFE]])
def test_a_count_wraps_without_a_jump(raws):
    device, ports = driver(QsbDEmulator())
    device.open()
    port = ports.opened[0]
    port.emulator = None
    counts = []
    for tick, raw in enumerate(raws, start=1000):
        port.pending = b"s 0E %08X %08X !\r\n" % (raw, tick)
        counts += [sample.counts for sample in device.read(0.0)]
    assert [b - a for a, b in itertools.pairwise(counts)] in (
        [1] * (len(counts) - 1), [-1] * (len(counts) - 1))


def test_a_lost_line_is_a_gap_and_a_bad_one_is_counted():
    device, ports = driver(QsbDEmulator())
    device.open()
    port = ports.opened[0]
    port.emulator = None
    port.pending = (b"s 0E 00000001 00000001 !\r\ns 0E 00000002 00000002 !\r\n"
                    b"s 0E 0000#003 00000003 !\r\ns 0E 00000004 00000004 !\r\n")
    samples = device.read(0.0)
    assert [sample.seq for sample in samples] == [1, 3]
    assert samples[1].elapsed_s == 2 / 512
    assert device.counters["malformed_lines"] == 1


@pytest.mark.parametrize("line", [b"QSB-D  0E!\r\n", b"s 0E 00000005 00000001 !\r\n"])
def test_a_restart_is_seen_by_the_banner_and_by_the_clock(line):
    device, ports = driver(QsbDEmulator())
    device.open()
    port = ports.opened[0]
    port.emulator = None
    port.pending = b"s 0E 00000005 00001000 !\r\n" + line
    with pytest.raises(DeviceLostError, match="restarted"):
        device.read(0.0)
    assert device.counters["resets_seen"] == 1


def test_another_device_is_not_taken_for_it():
    device, ports = driver(QsbDEmulator(identity=Identity(1, "S", 1)))
    with pytest.raises(IdentityError, match="QSB-S"):
        device.open()
    assert not [data for data in ports.sent if data.startswith(b"S")]


def test_an_encoder_without_power_is_not_taken():
    emulator = QsbDEmulator()
    device, _ = driver(emulator)
    emulator.reset = lambda _now, banner=True: None
    emulator._status &= ~8
    with pytest.raises(IdentityError, match="does not count"):
        device.open()


def test_silence_is_a_lost_device_after_three_tries(monkeypatch):
    monkeypatch.setattr(qsb_d, "REPLY_S", 0.01)
    device, ports = driver(answers=[])
    with pytest.raises(DeviceLostError, match="no answer to W15F"):
        device.open()
    assert ports.sent == [b"W161\r", *[b"W15F\r"] * 3]
    assert device.counters["retries"] == 2


def test_the_index_sets_the_zero_and_is_switched_off_again(monkeypatch):
    monkeypatch.setattr(qsb_d, "INDEX_POLL_S", 0.0)
    here = [0]
    device, ports = driver(QsbDEmulator(lambda _now: here[0], index_at=300))
    device.open()
    device.start()
    here[0] = 100
    assert read_until(device, 5)[-1].counts == 100
    device.seek_index()
    here[0] = 250
    read_until(device, 5)
    assert not device.index_found()
    here[0] = 320
    deadline = time.monotonic() + 5.0
    while not device.index_found() and time.monotonic() < deadline:
        device.read(0.01)
    assert device.index_found()
    assert read_until(device, 2)[-1].counts == 20
    tail = [data for data in ports.sent if data != b"R06\r"][len(START_UP) - 1:]
    assert tail == [b"S0E\r", b"W0363\r", b"W0303\r"]
    here[0] = 290
    read_until(device, 3)
    here[0] = 310
    assert read_until(device, 5)[-1].counts == 10


# On a pseudo-terminal


def test_on_a_real_serial_stack_with_its_faults(plug_in):
    port = plug_in(QsbDEmulator(lambda _now: 7))
    device = QsbD(port.path, settling_s=0.0)
    assert "QSB-D" in device.open()
    device.start()
    assert len(read_until(device, 100)) >= 100
    port.inject("garbage 60")
    port.inject("partial")
    assert len(read_until(device, 50)) >= 50
    assert device.counters["malformed_lines"] >= 1
    port.inject("disconnect 0.05")
    with pytest.raises(DeviceLostError):
        read_until(device, 10_000)
    device.close()
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        try:
            device.open()
            break
        except DeviceLostError:
            time.sleep(0.02)
    device.start()
    assert len(read_until(device, 10)) >= 10
    device.close()


def test_a_port_that_is_not_there():
    with pytest.raises(DeviceLostError, match="cannot open /dev/nowhere"):
        QsbD("/dev/nowhere").open()


@settings(max_examples=60)
@given(st.lists(st.one_of(
    st.binary(max_size=60),
    st.sampled_from([b"s 0E 00000001 00000001 !\r\n", b"QSB-D  0E!\r\n", b"r 06 00000010 !\r\n",
                     b"s 0E FFFFFFFF FFFFFFFF !\r\n", b"e 0E 00000000 !\r\n", b"\r", b"!"])),
    max_size=12), st.booleans())
def test_no_bytes_crash_the_driver(chunks, seeking):
    device, ports = driver(QsbDEmulator())
    device.open()
    port = ports.opened[0]
    port.emulator = None
    if seeking:
        device.seek_index()
    for chunk in chunks:
        port.pending = chunk
        try:
            samples = device.read(0.0)
        except DriverError:
            return
        assert all(-2**63 < sample.counts < 2**63 and sample.elapsed_s > 0.0
                   for sample in samples)


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=40), max_size=12))
def test_no_bytes_crash_the_emulator(chunks):
    emulator = QsbDEmulator()
    for index, chunk in enumerate(chunks):
        emulator.receive(chunk, index * 0.01)
        emulator.advance(index * 0.01)
