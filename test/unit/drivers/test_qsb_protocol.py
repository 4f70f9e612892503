"""QSB-D: the exact bytes of every command and reply."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dfm_stage.drivers import qsb_protocol as qsb
from dfm_stage.drivers.errors import ProtocolError
from dfm_stage.drivers.qsb_protocol import Format, Reply


def test_every_command_on_the_wire():
    assert qsb.STOP_STREAMS == b"W161\r"
    assert qsb.SET_FORMAT == b"W15F\r"
    assert qsb.READ_IDENTITY == b"R14\r"
    assert qsb.QUADRATURE_MODE == b"W000\r"
    assert qsb.FREE_RUNNING == b"W0303\r"
    assert qsb.RESET_ON_INDEX == b"W0363\r"
    assert qsb.COUNT_UP == b"W040\r"
    assert qsb.NO_THRESHOLD == b"W0B0\r"
    assert qsb.set_interval(1) == b"W0C1\r"
    assert qsb.set_interval(512) == b"W0C200\r"
    assert qsb.RESET_TIMESTAMP == b"W0D1\r"
    assert qsb.STREAM_COUNT == b"S0E\r"
    assert qsb.READ_STATUS == b"R06\r"


@pytest.mark.parametrize(("line", "reply"), [
    (b"r 0E 000001F4 !", Reply("r", 0x0E, 500)),
    (b"s 0E FFFFFF9C 0000002A !", Reply("s", 0x0E, 0xFFFFFF9C, 42)),
    (b"s0E000001F40000002A!", Reply("s", 0x0E, 500, 42)),
    (b"w 15 0000000F 00000000 !", Reply("w", 0x15, 15, 0)),
    (b"r1400E5A02A!", Reply("r", 0x14, 0x00E5A02A)),
    (b"e 03 00000100 !", Reply("e", 3, 256)),
    (b"x 7F 00000000 !", Reply("x", 0x7F, 0)),
])
def test_replies(line, reply):
    assert qsb.parse_reply(line) == reply


def test_a_reply_can_be_a_refusal():
    assert not qsb.parse_reply(b"r 0E 7FFFFFFF !").refused
    assert qsb.parse_reply(b"e 03 00000100 !").refused


@pytest.mark.parametrize("line", [
    b"", b"!", b"r 0E 000001F4", b"r 0E 00001F4 !", b"r 0e 000001f4 !", b"R 0E 000001F4 !",
    b"r 0E 000001F4! ", b"r0E 000001F4 !", b"s 0E FFFFFF9C 0000002A 00000000 !",
    b"s 0E FFFFFF9C 0000002A !s 0E FFFFFF9C 0000002B !", b"\xff" * 20, b"QSB-D  0E!",
])
def test_what_is_not_a_reply(line):
    with pytest.raises(ProtocolError):
        qsb.parse_reply(line)


def test_the_banner_is_known():
    assert qsb.BANNER == b"QSB-D  0E!\r\n"
    assert qsb.is_banner(b"QSB-D  0E!")
    assert not qsb.is_banner(b"r 0E 000001F4 !")


def test_the_three_forms_have_the_bytes_the_maker_gives():
    assert qsb.render_reply(Reply("r", 0x0E, 500), Format(0xB)) == b"r 0E 000001F4 !\r\n"
    assert qsb.render_reply(Reply("s", 0x0E, 0xFFFFFF9C, 42), Format(0xF)) == (
        b"s 0E FFFFFF9C 0000002A !\r\n")
    assert qsb.render_reply(Reply("s", 0x0E, 500, 42), Format(0x5)) == b"s0E000001F40000002A!\n"
    sizes = [len(qsb.render_reply(Reply("s", 0x0E, 0, 0), Format(form))) for form in (11, 15, 5)]
    assert sizes == [17, 26, 21]


@given(st.sampled_from("rwsex"), st.integers(0, 255), st.integers(0, 2**32 - 1),
       st.integers(0, 2**32 - 1), st.integers(1, 15))
def test_every_reply_comes_back_whatever_its_form(kind, register, data, stamp, form):
    reply = Reply(kind, register, data, stamp if form & Format.TIMESTAMP else None)
    line = qsb.render_reply(reply, Format(form)).rstrip(b"\r\n")
    assert qsb.parse_reply(line) == reply


def test_identity():
    identity = qsb.Identity.of(0x00E5A02A)
    assert (identity.serial, identity.type, identity.firmware) == (0xE5A, "D", 0x2A)
    assert identity.data == 0x00E5A02A
    assert qsb.Identity.of(0x12345201).type == "S"
    assert qsb.Identity.of(0x12345901).type == "?9"


@pytest.mark.parametrize("ticks", [0, -1, 65536])
def test_an_interval_out_of_range_is_refused(ticks):
    with pytest.raises(ProtocolError):
        qsb.set_interval(ticks)
