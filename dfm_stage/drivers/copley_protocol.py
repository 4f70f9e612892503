"""What a Copley Controls amplifier says and understands in its ASCII protocol.

A command is one of the letters s g c r t i, a parameter as bank (r RAM, f flash) and hexadecimal
number, and decimal values, ended by CR; the reply is `ok`, `v <values>` or `e <number>`, ended by
CR. Sources: the maker's ASCII Programmer's Guide and fielded drivers; what neither settles is
marked [?].
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from dfm_stage.drivers.errors import ProtocolError

POWER_UP_BAUD = 9600
BREAK_S = 0.05
BAUD_SETTLING_S = 0.2
AMPERE_PER_COUNT = 0.01
VOLT_PER_COUNT = 0.1
STATE_OFF, STATE_PROGRAMMED_CURRENT, STATE_POSITION = 0, 1, 21


class Parameter(IntEnum):
    """Parameters that the driver uses."""

    PROGRAMMED_CURRENT = 0x02
    ACTUAL_CURRENT = 0x0C
    COMMANDED_CURRENT = 0x15
    BUS_VOLTAGE = 0x1E
    TEMPERATURE = 0x20
    PEAK_CURRENT = 0x21
    CONTINUOUS_CURRENT = 0x22
    PEAK_TIME = 0x23
    STATE = 0x24
    LIMITED_CURRENT = 0x25
    MOTOR_POSITION = 0x32
    CURRENT_RAMP = 0x6A
    BAUD = 0x90
    STATUS = 0xA0
    LATCHED_FAULTS = 0xA4


class Status(IntFlag):
    """Bits of parameter 0xa0."""

    SHORT = 1 << 0
    DRIVE_OVERTEMPERATURE = 1 << 1
    OVERVOLTAGE = 1 << 2
    UNDERVOLTAGE = 1 << 3
    MOTOR_TEMPERATURE = 1 << 4
    FEEDBACK = 1 << 5
    CURRENT_LIMITED = 1 << 7
    VOLTAGE_LIMITED = 1 << 8
    POSITIVE_LIMIT_SWITCH = 1 << 9
    NEGATIVE_LIMIT_SWITCH = 1 << 10
    ENABLE_INPUT_INACTIVE = 1 << 11
    DISABLED_BY_SOFTWARE = 1 << 12
    PWM_DISABLED = 1 << 15
    POSITIVE_SOFT_LIMIT = 1 << 16
    NEGATIVE_SOFT_LIMIT = 1 << 17
    RESET = 1 << 20
    LATCHED_FAULT = 1 << 22


OUTPUT_OFF = (Status.ENABLE_INPUT_INACTIVE | Status.DISABLED_BY_SOFTWARE | Status.PWM_DISABLED
              | Status.LATCHED_FAULT)
TRIPPING = (OUTPUT_OFF | Status.SHORT | Status.DRIVE_OVERTEMPERATURE | Status.OVERVOLTAGE
            | Status.UNDERVOLTAGE | Status.MOTOR_TEMPERATURE | Status.FEEDBACK)
LIMIT_SWITCHES = (Status.POSITIVE_LIMIT_SWITCH | Status.NEGATIVE_LIMIT_SWITCH
                  | Status.POSITIVE_SOFT_LIMIT | Status.NEGATIVE_SOFT_LIMIT)


class Faults(IntFlag):
    """Bits of parameter 0xa4, the latched faults; written back, a one clears its bit."""

    FLASH_CRC = 1 << 0
    INTERNAL = 1 << 1
    SHORT = 1 << 2
    DRIVE_OVERTEMPERATURE = 1 << 3
    MOTOR_OVERTEMPERATURE = 1 << 4
    OVERVOLTAGE = 1 << 5
    UNDERVOLTAGE = 1 << 6
    FEEDBACK = 1 << 7
    FOLLOWING = 1 << 9
    OVERCURRENT = 1 << 10
    COMMAND_LOST = 1 << 12
    SAFETY_CIRCUIT = 1 << 14
    CURRENT_UNCONTROLLED = 1 << 15
    WIRING = 1 << 16
    STO = 1 << 18


FATAL_FAULTS = Faults.FLASH_CRC | Faults.INTERNAL

ERROR_TEXTS = {
    1: "too much data", 3: "unknown command", 4: "too little data", 5: "too much data",
    9: "unknown parameter", 10: "out of range", 11: "read only", 14: "not in this axis state",
    15: "wrong page", 33: "cannot be parsed", 36: "bad axis letter",
}


def get(parameter: int, bank: str = "r") -> bytes:
    """Return the command that reads a parameter from RAM (`r`) or flash (`f`)."""
    return b"g %s0x%02x\r" % (bank.encode(), parameter)


def set_ram(parameter: int, value: int) -> bytes:
    """Return the command that writes a parameter in RAM; the flash is never written."""
    return b"s r0x%02x %d\r" % (parameter, value)


@dataclass(frozen=True)
class Reply:
    """One reply: done, values or an error number."""

    values: tuple[int, ...] = ()
    error: int | None = None

    @property
    def value(self) -> int:
        """The only value.

        Raises
        ------
        ProtocolError
            If the reply is not one value.
        """
        if len(self.values) != 1:
            raise ProtocolError(f"the drive answered {self.text} where one value was expected")
        return self.values[0]

    @property
    def text(self) -> str:
        """The reply in words."""
        if self.error is not None:
            return f"error {self.error}, {ERROR_TEXTS.get(self.error, 'see the maker manual')}"
        return f"values {self.values}" if self.values else "ok"


_VALUES = re.compile(rb"v((?: -?[0-9]{1,10})+)")
_ERROR = re.compile(rb"e ([0-9]{1,4})")


def parse_reply(line: bytes) -> Reply:
    """Return the meaning of one line, its CR already removed.

    Raises
    ------
    ProtocolError
        If it is none of the three replies.
    """
    if line == b"ok":
        return Reply()
    if found := _VALUES.fullmatch(line):
        return Reply(tuple(int(each) for each in found[1].split()))
    if found := _ERROR.fullmatch(line):
        return Reply(error=int(found[1]))
    raise ProtocolError(f"not a reply of a Copley drive: {line[:40]!r}")


def words(flags: IntFlag) -> str:
    """Return set bits in words; bits without a name as their number."""
    named = [member for member in type(flags) if member in flags]
    rest = int(flags) & ~sum(int(member) for member in named)
    texts = [str(member.name).lower().replace("_", " ") for member in named]
    return ", ".join([*texts, *([f"bits {rest:#x}"] if rest else [])]) or "none"
