"""A Copley drive that is not there: parameters, states, faults, baud rate, output current."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container

from dfm_stage.drivers.copley_protocol import (
    AMPERE_PER_COUNT,
    FATAL_FAULTS,
    POWER_UP_BAUD,
    STATE_OFF,
    STATE_POSITION,
    STATE_PROGRAMMED_CURRENT,
    Faults,
    Parameter,
    Status,
)
from dfm_stage.drivers.errors import DriverError
from dfm_stage.drivers.transport import LONGEST_LINE

RATES = {9600: 9600, 19200: 19200, 38400: 38400, 57600: 57604, 115200: 115207}
DEFAULTS: dict[int, int] = {
    Parameter.PROGRAMMED_CURRENT: 0, Parameter.PEAK_CURRENT: 200,
    Parameter.CONTINUOUS_CURRENT: 100, Parameter.PEAK_TIME: 1000, Parameter.STATE: STATE_OFF,
    Parameter.CURRENT_RAMP: 0, Parameter.BAUD: POWER_UP_BAUD,
}
# What may be written; the other parameters can only be read.
_ALLOWED: dict[Parameter, Container[int]] = {
    Parameter.PROGRAMMED_CURRENT: range(-32768, 32768), Parameter.PEAK_CURRENT: range(32768),
    Parameter.CONTINUOUS_CURRENT: range(32768), Parameter.PEAK_TIME: range(10001),
    Parameter.CURRENT_RAMP: range(2**31), Parameter.LATCHED_FAULTS: range(2**31),
    Parameter.MOTOR_POSITION: range(-2**31, 2**31), Parameter.BAUD: RATES,
    Parameter.STATE: (STATE_OFF, STATE_PROGRAMMED_CURRENT, STATE_POSITION),
}
_LINE = re.compile(r"(?:(\d+) )?(?:\.(\w) )?(\w)(?: (.*))?", re.ASCII | re.DOTALL)
_NAME = re.compile(r"([rf])(0x[0-9a-fA-F]{1,3}|\d{1,3})")
_NUMBER = re.compile(r"-?(?:\d{1,10}|0x[0-9a-fA-F]{1,8})")
_IN_FLASH = (Parameter.PROGRAMMED_CURRENT, Parameter.PEAK_CURRENT,
             Parameter.CONTINUOUS_CURRENT, Parameter.PEAK_TIME, Parameter.STATE,
             Parameter.CURRENT_RAMP)


class _CommandError(Exception):
    """A command that is refused with an error number."""


def _whole(text: str) -> int:
    return int(text, 16) if "x" in text else int(text)


class CopleyAsciiEmulator:
    """Answers bytes with bytes; times are seconds of any steady clock.

    `on_output` is called with the time, the current in A and whether the output stage is on,
    whenever one of them changes. `flash` are parameters as stored in the drive.
    """

    def __init__(self, on_output: Callable[[float, float, bool], None] | None = None,
                 flash: dict[int, int] | None = None, position: Callable[[float], int]
                 | None = None) -> None:
        self._on_output = on_output
        self._position = position
        self.flash: dict[int, int] = {**DEFAULTS, **(flash or {})}
        self.enable_input = True
        self.out: list[bytes] = []
        self._seen = (0.0, False)
        self.reset(0.0)

    def reset(self, now: float) -> None:
        """Start anew from the flash, as on power-up; says nothing."""
        self.ram = dict(self.flash)
        self.faults = Faults(0)
        self.wrong_baud(now)
        self._from_a, self._from_s = 0.0, now
        self._over_since: float | None = None
        self._output_changed(now)

    # The line

    def connected(self, _now: float) -> None:
        """A host has opened the port; the drive cannot know."""

    def disconnected(self, _now: float) -> None:
        """A host has closed the port; the drive cannot know, the current stays."""

    def wrong_baud(self, _now: float) -> None:
        """Bytes at another rate look like a break: back to 9600 baud. The output stays."""
        self.baud = self.ram[Parameter.BAUD] = POWER_UP_BAUD
        self._rest = b""
        self.silent_until_break = False

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes that have arrived."""
        for byte in data:
            if self.silent_until_break:
                return
            if not self._rest and (byte == 0 or byte >= 0x80):
                self.silent_until_break = True  # binary mode, which nobody here speaks
                return
            if byte != 0x0D:
                self._rest = (self._rest + bytes([byte]))[-LONGEST_LINE:]
                continue
            line, self._rest = self._rest, b""
            if line:
                self._line(line.decode("latin-1"), now)

    def next_event(self) -> float:
        """The drive never speaks first."""
        return math.inf

    def advance(self, now: float) -> None:
        """Let time pass: ramps and the limit of the peak time."""
        self._output_changed(now)

    def inject(self, words: list[str], now: float) -> str:
        """Do what an operator asks: `fault BITS`, `enable on|off`, `reset`."""
        match words:
            case ["fault", bits]:
                self.faults |= Faults(int(bits, 0))
                done = f"latched faults are {int(self.faults):#x}"
            case ["enable", "on" | "off" as state]:
                self.enable_input = state == "on"
                done = f"the enable input is {state}"
            case ["reset"]:
                self.reset(now)
                done = "the drive has restarted"
            case _:
                raise DriverError("copley_ascii knows fault BITS, enable on, enable off and "
                                  f"reset, not {' '.join(words)!r}")
        self._output_changed(now)
        return done

    # Commands

    def _line(self, line: str, now: float) -> None:
        try:
            answer = self._execute(line, now)
        except _CommandError as error:
            answer = f"e {error}"
        if answer:
            self.out.append(answer.encode() + b"\r")

    def _execute(self, line: str, now: float) -> str:
        found = _LINE.fullmatch(line)
        if found is None:
            raise _CommandError(33)
        _, axis, code, rest = found.groups()
        if axis not in (None, "A", "a"):
            raise _CommandError(36)
        if code == "r":
            if rest is not None:
                raise _CommandError(33)
            self.reset(now)
            return ""
        if code in "gs":
            return self._get_or_set(code, rest or "", now)
        raise _CommandError(14 if code in "cti" else 3)

    def _get_or_set(self, code: str, rest: str, now: float) -> str:
        if not rest:
            raise _CommandError(4)
        name, *values = rest.split(" ")
        found = _NAME.fullmatch(name)
        if found is None or any(not _NUMBER.fullmatch(value) for value in values):
            raise _CommandError(33)
        try:
            parameter = Parameter(_whole(found[2]))
        except ValueError:
            raise _CommandError(9) from None
        if code == "g":
            if values:
                raise _CommandError(5)
            return f"v {self._read(parameter, found[1], now)}"
        if len(values) != 1:
            raise _CommandError(5 if values else 4)
        self._write(parameter, found[1], _whole(values[0]), now)
        return "ok"

    def _read(self, parameter: Parameter, bank: str, now: float) -> int:
        if bank == "f":
            if parameter not in _IN_FLASH:
                raise _CommandError(15)
            return self.flash[parameter]
        values: dict[int, int] = {
            Parameter.MOTOR_POSITION: 0, **self.ram, Parameter.BAUD: RATES[self.baud],
            Parameter.BUS_VOLTAGE: 480, Parameter.TEMPERATURE: 31,
            Parameter.STATUS: int(self.status(now)), Parameter.LATCHED_FAULTS: int(self.faults),
            **dict.fromkeys((Parameter.ACTUAL_CURRENT, Parameter.LIMITED_CURRENT,
                             Parameter.COMMANDED_CURRENT),
                            round(self.current(now) / AMPERE_PER_COUNT))}
        if self._position is not None:
            values[Parameter.MOTOR_POSITION] = self._position(now)
        return values[parameter]

    def _write(self, parameter: Parameter, bank: str, value: int, now: float) -> None:
        if parameter not in _ALLOWED:
            raise _CommandError(11)
        if value not in _ALLOWED[parameter]:
            raise _CommandError(10)
        if bank == "f" and parameter not in _IN_FLASH:
            raise _CommandError(15)
        if bank == "f":
            self.flash[parameter] = value
        elif parameter is Parameter.BAUD:
            self.baud = self.ram[parameter] = value
        elif parameter is Parameter.LATCHED_FAULTS:
            self.faults &= ~Faults(value) | FATAL_FAULTS
        else:
            self._from_a, self._from_s = self.current(now), now
            self.ram[parameter] = value
        self._output_changed(now)

    # The power stage

    @property
    def enabled(self) -> bool:
        """Whether the output stage is on."""
        return (self.ram[Parameter.STATE] != STATE_OFF and self.enable_input
                and not self.faults)

    def status(self, now: float) -> Status:
        """Return parameter 0xa0."""
        wanted = abs(self.ram[Parameter.PROGRAMMED_CURRENT] * AMPERE_PER_COUNT)
        limited = (self.enabled and abs(self.current(now)) < wanted and self._limit(now) < wanted)
        bits = {Status.RESET: True, Status.ENABLE_INPUT_INACTIVE: not self.enable_input,
                Status.DISABLED_BY_SOFTWARE: self.ram[Parameter.STATE] == STATE_OFF,
                Status.PWM_DISABLED: not self.enabled, Status.LATCHED_FAULT: bool(self.faults),
                Status.SHORT: bool(self.faults & Faults.SHORT), Status.CURRENT_LIMITED: limited}
        return Status(sum(bit for bit, on in bits.items() if on))

    def _limit(self, now: float) -> float:
        continuous = self.ram[Parameter.CONTINUOUS_CURRENT] * AMPERE_PER_COUNT
        peak = self.ram[Parameter.PEAK_CURRENT] * AMPERE_PER_COUNT
        wanted = abs(self.ram[Parameter.PROGRAMMED_CURRENT]) * AMPERE_PER_COUNT
        if wanted <= continuous or not self.enabled:
            self._over_since = None
            return max(peak, continuous)
        if self._over_since is None:
            self._over_since = now
        return (peak if (now - self._over_since) * 1e3 < self.ram[Parameter.PEAK_TIME]
                else continuous)

    def current(self, now: float) -> float:
        """Return the output current, A."""
        if not self.enabled or self.ram[Parameter.STATE] != STATE_PROGRAMMED_CURRENT:
            return 0.0
        wanted = self.ram[Parameter.PROGRAMMED_CURRENT] * AMPERE_PER_COUNT
        limit = self._limit(now)
        wanted = min(max(wanted, -limit), limit)
        ramp = self.ram[Parameter.CURRENT_RAMP] * 1e-3
        if ramp <= 0.0:
            return wanted
        way = ramp * (now - self._from_s)
        return self._from_a + min(max(wanted - self._from_a, -way), way)

    def _output_changed(self, now: float) -> None:
        seen = (self.current(now), self.enabled)
        if seen != self._seen:
            self._seen = seen
            if self._on_output is not None:
                self._on_output(now, *seen)
