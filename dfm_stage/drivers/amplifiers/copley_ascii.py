"""Driver of Copley Controls amplifiers in programmed current mode, by their ASCII protocol."""

from __future__ import annotations

import time
from collections.abc import Callable

from dfm_stage.drivers import copley_protocol as copley
from dfm_stage.drivers.copley_protocol import Parameter, words
from dfm_stage.drivers.device import AmplifierStatus
from dfm_stage.drivers.errors import (
    DeviceLostError,
    IdentityError,
    ProtocolError,
    RefusedError,
)
from dfm_stage.drivers.lines import LineBuffer
from dfm_stage.drivers.transport import SerialPort

ATTEMPTS = 3
ENABLE_S = 0.5
REPLY_S = 0.01
_LINE_BITS = 400
_BAUD_TOLERANCE = 0.02
_QUESTIONS = (Parameter.STATUS, Parameter.ACTUAL_CURRENT) * 8
_SLOW_QUESTIONS = (Parameter.LATCHED_FAULTS, Parameter.TEMPERATURE, Parameter.BUS_VOLTAGE)


class CopleyAscii:
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
        self._path = port
        self._baud = baud
        self._limits = (peak_limit_a, continuous_limit_a, peak_time_s)
        self._ramp_ma = round(1000.0 * ramp_a_per_s)
        self._reply_s = reply_s
        self._open_port = open_port
        self._port: SerialPort | None = None
        self._lines = LineBuffer(b"\r")
        self.counters = {"malformed_lines": 0, "retries": 0, "error_replies": 0}
        self._asked = 0
        self._notes: dict[str, str] = {}

    # Exchange

    def _opened(self) -> SerialPort:
        if self._port is None:
            raise DeviceLostError(f"{self._path} is not open")
        return self._port

    def request(self, command: bytes, attempts: int = ATTEMPTS) -> copley.Reply:
        """Send a command and return the reply.

        Repeated when nothing, or nothing that makes sense, comes back. What is still under way
        from an earlier exchange is thrown away first.

        Raises
        ------
        DeviceLostError
            When no attempt was answered, or the port is gone.
        """
        port = self._opened()
        for attempt in range(attempts):
            if attempt:
                self.counters["retries"] += 1
                port.drain(0.004, 0.02)
            elif stray := port.read(0.0):
                self.counters["malformed_lines"] += stray.count(b"\r") or 1
            self._lines.clear()
            port.write(command)
            deadline = time.monotonic() + _LINE_BITS / port.baud + self._reply_s
            while (left := deadline - time.monotonic()) > 0.0:
                for line in self._lines.feed(port.read(left)):
                    try:
                        reply = copley.parse_reply(line.text)
                    except ProtocolError:
                        self.counters["malformed_lines"] += 1
                        continue
                    if reply.error is None and bool(reply.values) != (command[:1] == b"g"):
                        self.counters["malformed_lines"] += 1  # it answers an earlier command
                        continue
                    self.counters["error_replies"] += reply.error is not None
                    if attempt:  # the answer to the other attempt may still be under way
                        port.drain(0.004, 0.02)
                    return reply
        raise DeviceLostError(f"{self._path}: no answer to {command.strip().decode()} at "
                              f"{port.baud} baud; has the drive power, is the cable in?")

    def _get(self, parameter: Parameter, bank: str = "r") -> int:
        reply = self.request(copley.get(parameter, bank))
        if reply.error is not None:
            raise RefusedError(f"{self._path}: reading parameter {int(parameter):#04x}: "
                               f"{reply.text}")
        return reply.value

    def _set(self, parameter: Parameter, value: int) -> None:
        reply = self.request(copley.set_ram(parameter, value))
        if reply.error is not None:
            raise RefusedError(f"{self._path}: setting parameter {int(parameter):#04x} to "
                               f"{value}: {reply.text}")

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
        self.close()
        port = self._port = self._open_port(self._path, copley.POWER_UP_BAUD)
        port.send_break(copley.BREAK_S)
        port.drain(0.02, 0.3)
        try:
            self._set(Parameter.PROGRAMMED_CURRENT, 0)
            self._set(Parameter.STATE, copley.STATE_OFF)
            if self._get(Parameter.STATE) != copley.STATE_OFF:
                raise IdentityError(f"{self._path}: the drive does not switch off")
            at_power_up = self._get(Parameter.STATE, "f"), self._get(
                Parameter.PROGRAMMED_CURRENT, "f")
        except RefusedError as error:
            raise IdentityError(f"{self._path}: what answers is not a Copley drive in this "
                                f"protocol: {error}") from error
        state, current = at_power_up
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
        port = self._opened()
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
        peak_a, continuous_a, time_s = self._limits
        found = (self._get(Parameter.PEAK_CURRENT) * self.count_a,
                 self._get(Parameter.CONTINUOUS_CURRENT) * self.count_a,
                 self._get(Parameter.PEAK_TIME) * 1e-3)
        for what, has, may, unit in zip(("peak current", "continuous current", "peak time"),
                                        found, (peak_a, continuous_a, time_s), ("A", "A", "s"),
                                        strict=True):
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
        index = self._asked % (len(_QUESTIONS) + 1)
        if index < len(_QUESTIONS):
            question = _QUESTIONS[index]
        else:
            question = _SLOW_QUESTIONS[self._asked // (len(_QUESTIONS) + 1)
                                       % len(_SLOW_QUESTIONS)]
        value = self._get(question)
        if question is Parameter.ACTUAL_CURRENT:
            return AmplifierStatus(current_a=value * self.count_a)
        if question is Parameter.STATUS:
            return self._judged(copley.Status(value))
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

    def _judged(self, status: copley.Status) -> AmplifierStatus:
        trouble = status & copley.TRIPPING
        limit = status & copley.LIMIT_SWITCHES
        self._notes["drive status"] = words(status)
        return AmplifierStatus(trouble=words(trouble) if trouble else "",
                               travel_limit=words(limit) if limit else "",
                               notes=dict(self._notes))

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

    def close(self) -> None:
        """Give the port back; the drive keeps doing what it was told last."""
        if self._port is not None:
            self._port.close()
            self._port = None


def create(port: str, **options: float) -> CopleyAscii:
    """Return the driver; `baud`, `peak_limit_a`, `continuous_limit_a`, `peak_time_s`, ..."""
    return CopleyAscii(port, int(options.get("baud", 115200)),
                       peak_limit_a=options["peak_limit_a"],
                       continuous_limit_a=options["continuous_limit_a"],
                       peak_time_s=options.get("peak_time_s", 1.0),
                       ramp_a_per_s=options.get("ramp_a_per_s", 0.0),
                       reply_s=options.get("reply_s", REPLY_S))
