"""Copley ASCII: the exact bytes of every command and reply."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dfm_stage.drivers import copley_protocol as copley
from dfm_stage.drivers.copley_protocol import Faults, Parameter, Reply, Status
from dfm_stage.drivers.errors import ProtocolError


@pytest.mark.parametrize(("parameter", "value", "wire"), [
    (Parameter.PROGRAMMED_CURRENT, -20, b"s r0x02 -20\r"),
    (Parameter.PROGRAMMED_CURRENT, 0, b"s r0x02 0\r"),
    (Parameter.STATE, 1, b"s r0x24 1\r"),
    (Parameter.STATE, 0, b"s r0x24 0\r"),
    (Parameter.CURRENT_RAMP, 1000, b"s r0x6a 1000\r"),
    (Parameter.BAUD, 115200, b"s r0x90 115200\r"),
    (Parameter.LATCHED_FAULTS, 4, b"s r0xa4 4\r"),
])
def test_every_command_that_sets(parameter, value, wire):
    assert copley.set_ram(parameter, value) == wire


@pytest.mark.parametrize(("parameter", "bank", "wire"), [
    (Parameter.ACTUAL_CURRENT, "r", b"g r0x0c\r"),
    (Parameter.STATUS, "r", b"g r0xa0\r"),
    (Parameter.LATCHED_FAULTS, "r", b"g r0xa4\r"),
    (Parameter.TEMPERATURE, "r", b"g r0x20\r"),
    (Parameter.BUS_VOLTAGE, "r", b"g r0x1e\r"),
    (Parameter.PEAK_CURRENT, "r", b"g r0x21\r"),
    (Parameter.CONTINUOUS_CURRENT, "r", b"g r0x22\r"),
    (Parameter.PEAK_TIME, "r", b"g r0x23\r"),
    (Parameter.BAUD, "r", b"g r0x90\r"),
    (Parameter.STATE, "f", b"g f0x24\r"),
    (Parameter.PROGRAMMED_CURRENT, "f", b"g f0x02\r"),
])
def test_every_command_that_asks(parameter, bank, wire):
    assert copley.get(parameter, bank) == wire


@pytest.mark.parametrize(("line", "reply"), [
    (b"ok", Reply()),
    (b"v -19", Reply((-19,))),
    (b"v 115207", Reply((115207,))),
    (b"v 1 2 -3", Reply((1, 2, -3))),
    (b"e 33", Reply(error=33)),
])
def test_replies(line, reply):
    assert copley.parse_reply(line) == reply


@pytest.mark.parametrize("line", [
    b"", b"o", b"OK", b"okay", b"v", b"v ", b"v x", b"v 1.5", b"v --1", b"e", b"e x", b"e -1",
    b"\x00ok", b"v 12345678901", b"ok ok", b"v  1",
])
def test_what_is_not_a_reply(line):
    with pytest.raises(ProtocolError):
        copley.parse_reply(line)


@given(st.lists(st.integers(-2**31, 2**31 - 1), min_size=1, max_size=4))
def test_values_come_back(values):
    line = b"v " + b" ".join(b"%d" % value for value in values)
    assert copley.parse_reply(line).values == tuple(values)


def test_replies_in_words():
    assert copley.parse_reply(b"e 33").text == "error 33, cannot be parsed"
    assert copley.parse_reply(b"e 200").text == "error 200, see the maker manual"
    with pytest.raises(ProtocolError, match="one value"):
        _ = copley.parse_reply(b"ok").value


def test_bits_are_where_the_maker_puts_them():
    assert int(copley.OUTPUT_OFF) == 1 << 11 | 1 << 12 | 1 << 15 | 1 << 22
    assert Status(1 << 20) == Status.RESET
    assert Status(1 << 7 | 1 << 8) == Status.CURRENT_LIMITED | Status.VOLTAGE_LIMITED
    assert int(copley.LIMIT_SWITCHES) == 1 << 9 | 1 << 10 | 1 << 16 | 1 << 17
    assert int(copley.FATAL_FAULTS) == 3
    assert Faults(1 << 18) == Faults.STO
    assert Faults(1 << 12) == Faults.COMMAND_LOST
    assert copley.words(Faults(0)) == "none"
    assert copley.words(Faults(1 << 2 | 1 << 10)) == "short, overcurrent"
    assert "0x8" in copley.words(Status(1 << 3 | 1 << 27)) or "undervoltage" in copley.words(
        Status(1 << 3 | 1 << 27))
