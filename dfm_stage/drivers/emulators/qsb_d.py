"""A QSB-D that is not there: registers, counting, streaming, factory defaults, resets."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from dfm_stage.drivers.errors import DriverError
from dfm_stage.drivers.qsb_protocol import (
    BANNER,
    BAUD,
    FACTORY_FORMAT,
    TICKS_PER_SECOND,
    Format,
    Identity,
    Register,
    Reply,
    Status,
    render_reply,
)
from dfm_stage.drivers.transport import LineBuffer

FACTORY_MODE, FACTORY_PRESET, FACTORY_INTERVAL = 0x4F, 0x1F3, 0xFFFF
IDENTITY = Identity(0x00E5A, "D", 0x2A)
_COMMAND = re.compile(rb"([RWS])([0-9A-F]{2})([0-9A-F]{0,8})")
_HIGHEST = {
    Register.MODE: 3, Register.QUADRATURE: 0xFF, Register.DIRECTION: 0x1FF,
    Register.PRESET: 0xFFFFFFFF, Register.COUNTER_COMMAND: 0xF, Register.LOAD_PRESET: 0xFFFFFFFF,
    Register.THRESHOLD: 0xFFFFFFFF, Register.INTERVAL: 0xFFFF, Register.TIMESTAMP: 1,
    Register.FORMAT: 0xF, Register.STOP_STREAMS: 1,
}
_COMMANDS = (Register.COUNTER_COMMAND, Register.LOAD_PRESET, Register.TIMESTAMP,
             Register.STOP_STREAMS)      # writing these does something and is not kept
_REVERSED = 0x180
_ZERO = 2
_FREE_RUNNING, _MODULO = 0, 3
_RESET_ON_INDEX = 2
_DIVIDER = {0: 4, 1: 4, 2: 2, 3: 1}


class QsbDEmulator:
    """Answers bytes with bytes; times are seconds of any steady clock.

    `scale` gives the x4 count of the scale at a time; `index_at` is the count of its index mark;
    `drift` how much slow the device's clock is, relative.
    """

    baud = BAUD

    def __init__(self, scale: Callable[[float], int] = lambda _now: 0, *,
                 identity: Identity = IDENTITY, index_at: int | None = None,
                 drift: float = 0.0) -> None:
        self._scale = scale
        self._identity = identity
        self._index_at = index_at
        self._tick_s = (1.0 + drift) / TICKS_PER_SECOND
        self.out: list[bytes] = []
        self.reset(0.0, banner=False)

    def reset(self, now: float, banner: bool = True) -> None:
        """Start anew, as on power-up or when DTR toggles."""
        self._lines = LineBuffer()
        self._registers = dict.fromkeys(_HIGHEST, 0)
        self._registers |= {Register.QUADRATURE: FACTORY_MODE, Register.PRESET: FACTORY_PRESET,
                            Register.INTERVAL: FACTORY_INTERVAL,
                            Register.FORMAT: int(FACTORY_FORMAT)}
        self._clock_zero = now
        self._status = Status.COUNT_ENABLED | Status.POWER_LOSS | Status.UP
        self._before = self._scale(now)
        self._offset = self._scaled(self._before)
        self._next_tick = 0
        self._stream: int | None = None
        self._reported: int | None = None
        if banner:
            self.out.append(BANNER)

    # The line

    def connected(self, now: float) -> None:
        """A host has opened the port, and with it toggled DTR."""
        self.reset(now)

    def disconnected(self, _now: float) -> None:
        """A host has closed the port: nobody listens."""
        self._stream = None

    def wrong_baud(self, _now: float) -> None:
        """Bytes came at another rate: the receiver sees noise."""
        self._lines.clear()

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes that have arrived."""
        for line in self._lines.feed(data):
            self._command(line.text, now)

    def next_event(self) -> float:
        """Return when the device will say something by itself; infinite if never."""
        if self._stream is None or self._registers[Register.INTERVAL] == FACTORY_INTERVAL:
            return math.inf
        return self._clock_zero + self._next_tick * self._tick_s

    def advance(self, now: float) -> None:
        """Send the samples that are due."""
        while (due := self.next_event()) <= now:
            self._send_sample(due)
            self._next_tick += max(1, self._registers[Register.INTERVAL])

    def inject(self, words: list[str], now: float) -> str:
        """Do what an operator asks: `reset`."""
        if words == ["reset"]:
            self.reset(now)
            return "the counter has restarted"
        raise DriverError(f"qsb_d knows reset, not {' '.join(words)!r}")

    # Commands

    def _command(self, line: bytes, now: float) -> None:
        found = _COMMAND.fullmatch(line)
        if found is None:
            self._say("x", 0, 0, now)
            return
        letter, register, data = found.groups()
        number = int(register, 16)
        value = int(data or b"0", 16)
        readable = number in (*self._registers, Register.STATUS, Register.COUNT,
                              Register.IDENTITY)
        if not readable or (letter == b"W" and number not in self._registers):
            self._say("x", number, value, now)
        elif letter == b"W":
            self._write(Register(number), value, now)
        elif letter == b"R":
            if number == Register.COUNT:
                self._stream = None
            self._say("r", number, self._read(number, now), now)
        else:
            self._stream, self._reported = number, None
            self._next_tick = self._tick(now) + max(1, self._registers[Register.INTERVAL])
            self._say("s", number, self._read(number, now), now)

    def _write(self, register: Register, value: int, now: float) -> None:
        if value > _HIGHEST[register]:
            self._say("e", register, value, now)
            return
        count = self._count(now)
        if register not in _COMMANDS:
            self._registers[register] = value
        match register:
            case Register.COUNTER_COMMAND if value & _ZERO:
                self._offset = self._scaled(self._before)
            case Register.LOAD_PRESET:
                self._offset = self._scaled(self._before) - self._registers[Register.PRESET]
            case Register.TIMESTAMP if value:
                self._clock_zero, self._next_tick = now, 0
            case Register.STOP_STREAMS:
                self._stream = None
            case Register.QUADRATURE | Register.DIRECTION:
                self._offset = self._scaled(self._before) - count
        self._say("w", register, value, now)

    def _read(self, number: int, now: float) -> int:
        count = self._count(now)
        sign = Status.SIGN if count < 0 else Status(0)
        return {**self._registers, Register.COUNT: count & 0xFFFFFFFF,
                Register.IDENTITY: self._identity.data,
                Register.STATUS: int(self._status | sign)}[Register(number)]

    def _say(self, kind: str, register: int, data: int, now: float) -> None:
        self._send(Reply(kind, register, data & 0xFFFFFFFF, self._tick(now) & 0xFFFFFFFF))

    def _send(self, reply: Reply) -> None:
        self.out.append(render_reply(reply, Format(self._registers[Register.FORMAT])))

    def _send_sample(self, now: float) -> None:
        assert self._stream is not None  # noqa: S101
        value = self._read(self._stream, now)
        if self._reported is not None and abs(
                (value - self._reported + 2**31) % 2**32 - 2**31
                ) < self._registers[Register.THRESHOLD]:
            return
        self._reported = value
        self._send(Reply("s", self._stream, value, self._next_tick & 0xFFFFFFFF))

    # Counting

    def _tick(self, now: float) -> int:
        return int((now - self._clock_zero) / self._tick_s + 1e-6)

    def _scaled(self, scale: int) -> int:
        """The scale's count in this resolution and direction."""
        scaled = scale // _DIVIDER[self._registers[Register.QUADRATURE] & 3]
        return -scaled if self._registers[Register.DIRECTION] & _REVERSED else scaled

    def _track(self, now: float) -> None:
        """Follow the scale to now, past its index mark where that is to set the count."""
        here = self._scale(now)
        before, self._before = self._before, here
        mark = self._index_at
        if mark is None or before == here or not min(before, here) <= mark <= max(before, here):
            return
        self._status |= Status.INDEX
        if self._registers[Register.QUADRATURE] >> 4 & 3 == _RESET_ON_INDEX:
            self._offset = self._scaled(mark)

    def _count(self, now: float) -> int:
        self._track(now)
        count = self._scaled(self._before) - self._offset
        if self._registers[Register.QUADRATURE] >> 2 & 3 == _MODULO:
            return count % (self._registers[Register.PRESET] + 1)
        return (count + 2**31) % 2**32 - 2**31
