"""Driver of Copley Controls amplifiers in programmed current mode, by their ASCII protocol."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from dfm_stage.drivers import copley_protocol as copley
from dfm_stage.drivers.copley_protocol import Parameter, words
from dfm_stage.drivers.device import AmplifierStatus
from dfm_stage.drivers.errors import (
    DeviceLostError,
    IdentityError,
    ProtocolError,
    RefusedError,
)
from dfm_stage.drivers.transport import Line, LineDevice, SerialPort

ATTEMPTS = 3
ENABLE_S = 0.5
REPLY_S = 0.01
_LINE_BITS = 400
_BAUD_TOLERANCE = 0.02
_QUESTIONS = (Parameter.STATUS, Parameter.ACTUAL_CURRENT) * 8
_LIMITS = ((Parameter.PEAK_CURRENT, "peak current", "A", copley.AMPERE_PER_COUNT),
           (Parameter.CONTINUOUS_CURRENT, "continuous current", "A", copley.AMPERE_PER_COUNT),
           (Parameter.PEAK_TIME, "peak time", "s", 1e-3))
_SLOW_QUESTIONS = (Parameter.LATCHED_FAULTS, Parameter.TEMPERATURE, Parameter.BUS_VOLTAGE)


class CopleyAscii(LineDevice):
    """See AmplifierDevice.

    Parameters
    ----------
    port : str
        Path of the serial port.
    baud : int
        Rate to work at; after power-up and break the drive is at 9600.
    peak_limit_a, continuous_limit_a, peak_time_s : float
        What the drive itself must be limited to. A drive that would let more through is refused.
    ramp_a_per_s : float
        Slope of the output in the drive; 0 is a step.
    reply_s : float
        How long the drive may take to answer, besides the time on the wire.
    """

    count_a = copley.AMPERE_PER_COUNT

    def __init__(self, port: str, baud: int = 115200, *, peak_limit_a: float,
                 continuous_limit_a: float, peak_time_s: float = 1.0, ramp_a_per_s: float = 0.0,
                 reply_s: float = REPLY_S,
                 open_port: Callable[[str, int], SerialPort] = SerialPort) -> None:
        super().__init__(port, b"\r", open_port)
        self._baud = baud
        self._limits = (peak_limit_a, continuous_limit_a, peak_time_s)
        self._ramp_ma = round(1000.0 * ramp_a_per_s)
        self._reply_s = reply_s
        self.counters = {"malformed_lines": 0, "retries": 0, "error_replies": 0}
        self._asked = 0
        self._notes: dict[str, str] = {}

    # Exchange

    def request(self, command: bytes, attempts: int = ATTEMPTS) -> copley.Reply:
        """Send a command and return the reply.

        Repeated when nothing, or nothing that makes sense, comes back. What is still under way
        from an earlier exchange is thrown away first.

        Raises
        ------
        DeviceLostError
            When no attempt was answered, or the port is gone.
        """
        port = self._port
        for attempt in range(attempts):
            if attempt:
                self.counters["retries"] += 1
                port.drain(0.004, 0.02)
            elif stray := port.read(0.0):
                self.counters["malformed_lines"] += stray.count(b"\r") or 1
            self._lines.clear()
            port.write(command)
            replies = (self._understood(line, command) for line in
                       self._received(_LINE_BITS / port.baud + self._reply_s))
            if reply := next(filter(None, replies), None):
                if attempt:  # the answer to the other attempt may still be under way
                    port.drain(0.004, 0.02)
                return reply
        raise DeviceLostError(f"{self._path}: no answer to {command.strip().decode()} at "
                              f"{port.baud} baud; has the drive power, is the cable in?")

    def _understood(self, line: Line, command: bytes) -> copley.Reply | None:
        """Return the reply in a line, None for noise and for an answer to an earlier command."""
        try:
            reply = copley.parse_reply(line.text)
        except ProtocolError:
            reply = None
        if reply is None or (reply.error is None
                             and bool(reply.values) != command.startswith(b"g")):
            self.counters["malformed_lines"] += 1
            return None
        self.counters["error_replies"] += reply.error is not None
        return reply

    def _done(self, command: bytes, what: str) -> copley.Reply:
        """Return the reply to a command that the drive has carried out."""
        reply = self.request(command)
        if reply.error is not None:
            raise RefusedError(f"{self._path}: {what}: {reply.text}")
        return reply

    def _get(self, parameter: Parameter, bank: str = "r") -> int:
        return self._done(copley.get(parameter, bank),
                          f"reading parameter {int(parameter):#04x}").value

    def _set(self, parameter: Parameter, value: int) -> None:
        self._done(copley.set_ram(parameter, value),
                   f"setting parameter {int(parameter):#04x} to {value}")

    # Life

    def open(self) -> str:
        """Open, break, output to zero and off, change to the working rate, check the flash.

        Raises
        ------
        DeviceLostError
            If there is no port or no drive.
        IdentityError
            If what answers is no such drive.
        RefusedError
            If the settings in its flash would energise the coil at power-up.
        """
        port = self._connect(copley.POWER_UP_BAUD)
        port.send_break(copley.BREAK_S)
        port.drain(0.02, 0.3)
        try:
            self._set(Parameter.PROGRAMMED_CURRENT, 0)
            self._set(Parameter.STATE, copley.STATE_OFF)
            if self._get(Parameter.STATE) != copley.STATE_OFF:
                raise IdentityError(f"{self._path}: the drive does not switch off")
            state, current = self._get(Parameter.STATE, "f"), self._get(
                Parameter.PROGRAMMED_CURRENT, "f")
        except RefusedError as error:
            raise IdentityError(f"{self._path}: what answers is not a Copley drive in this "
                                f"protocol: {error}") from error
        if state != copley.STATE_OFF and (state != copley.STATE_PROGRAMMED_CURRENT or current):
            raise RefusedError(
                f"{self._path}: at power-up this drive enters state {state} with "
                f"{current * self.count_a:g} A from its flash and would energise the coil; set "
                "f0x24 to 0 and f0x02 to 0 with the maker's software")
        if self._baud != copley.POWER_UP_BAUD:
            self._change_baud()
        self._notes = {"baud": str(self._get(Parameter.BAUD))}
        return f"Copley drive at {self._notes['baud']} baud"

    def _change_baud(self) -> None:
        """The answer comes at the new rate, so it is thrown away unread."""
        port = self._port
        port.write(copley.set_ram(Parameter.BAUD, self._baud))
        time.sleep(copley.BAUD_SETTLING_S)
        port.set_baud(self._baud)
        port.drain(0.01, 0.1)
        self._lines.clear()
        found = self._get(Parameter.BAUD)
        if abs(found - self._baud) > _BAUD_TOLERANCE * self._baud:
            raise IdentityError(f"{self._path}: asked for {self._baud} baud, the drive says "
                                f"{found}")

    def arm(self) -> None:
        """Switch on at zero current.

        Raises
        ------
        RefusedError
            With latched faults, with limits above the configured ones, or when the drive does
            not switch on; it is then off.
        """
        self.disarm()
        faults = copley.Faults(self._get(Parameter.LATCHED_FAULTS))
        if faults:
            raise RefusedError(f"the drive has latched: {words(faults)}; clear it")
        self._check_limits()
        self._set(Parameter.CURRENT_RAMP, self._ramp_ma)
        self._set(Parameter.STATE, copley.STATE_PROGRAMMED_CURRENT)
        deadline = time.monotonic() + ENABLE_S
        while True:
            status = copley.Status(self._get(Parameter.STATUS))
            if not status & copley.OUTPUT_OFF:
                return
            if time.monotonic() > deadline:
                self.disarm()
                raise RefusedError("the drive does not switch its output on: "
                                   f"{words(status & copley.OUTPUT_OFF)}")

    def _check_limits(self) -> None:
        for (parameter, what, unit, scale), may in zip(_LIMITS, self._limits, strict=True):
            has = self._get(parameter) * scale
            if has > may * (1.0 + 1e-9):
                raise RefusedError(f"the drive's {what} limit is {has:g} {unit}, above the "
                                   f"configured {may:g} {unit}; lower it in the drive")

    def set_counts(self, counts: int) -> None:
        """Set the programmed current in units of 10 mA."""
        self._set(Parameter.PROGRAMMED_CURRENT, counts)

    def disarm(self) -> None:
        """Zero current, then off; off even where the drive refuses the zero."""
        try:
            self._set(Parameter.PROGRAMMED_CURRENT, 0)
        finally:
            self._set(Parameter.STATE, copley.STATE_OFF)

    # Questions

    def status(self) -> AmplifierStatus:
        """Ask for status and current in turn, now and then for the rest."""
        self._asked += 1
        turn, index = divmod(self._asked, len(_QUESTIONS) + 1)
        question = (*_QUESTIONS, _SLOW_QUESTIONS[turn % len(_SLOW_QUESTIONS)])[index]
        value = self._get(question)
        if question is Parameter.ACTUAL_CURRENT:
            return AmplifierStatus(current_a=value * self.count_a)
        if question is Parameter.STATUS:
            bits = copley.Status(value)
            self._notes["drive status"] = words(bits)
            trouble, limit = bits & copley.TRIPPING, bits & copley.LIMIT_SWITCHES
            return AmplifierStatus(trouble=words(trouble) if trouble else "",
                                   travel_limit=words(limit) if limit else "",
                                   notes=dict(self._notes))
        if question is Parameter.LATCHED_FAULTS:
            faults = copley.Faults(value)
            self._notes["latched faults"] = words(faults)
            return AmplifierStatus(notes=dict(self._notes),
                                   trouble=f"latched: {words(faults)}" if faults else None)
        if question is Parameter.TEMPERATURE:
            self._notes["drive temperature"] = f"{value} degC"
        else:
            self._notes["bus voltage"] = f"{value * copley.VOLT_PER_COUNT:g} V"
        return AmplifierStatus(notes=dict(self._notes))

    def clear_faults(self) -> str:
        """Clear what the drive latched and return it.

        Raises
        ------
        RefusedError
            If a fault is fatal: only a power cycle, or the maker, clears it.
        """
        faults = copley.Faults(self._get(Parameter.LATCHED_FAULTS))
        if faults & copley.FATAL_FAULTS:
            raise RefusedError(f"the drive has a fatal fault: {words(faults)}; it needs a power "
                               "cycle or repair")
        if faults:
            self._set(Parameter.LATCHED_FAULTS, int(faults))
        return words(faults)


def create(port: str, **options: Any) -> CopleyAscii:
    """Return the driver; `baud`, `peak_limit_a`, `continuous_limit_a`, `peak_time_s`, ..."""
    return CopleyAscii(port, **options)
