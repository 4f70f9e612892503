"""A port without a line: an emulator on the other side, in memory, every byte kept."""

from __future__ import annotations

import time

from dfm_stage.drivers.emulators.pty_port import Emulator
from dfm_stage.drivers.errors import DeviceLostError


class MemoryPort:
    """Stands in for SerialPort. `answers` replaces the emulator by fixed bytes."""


    def __init__(self, path: str, baud: int, emulator: Emulator | None = None,
                 answers: list[bytes] | None = None) -> None:
        self.path = path
        self.baud = baud
        self.sent: list[bytes] = []
        self.emulator = emulator
        self.answers = answers
        self.pending = b""
        self.open = True
        if emulator is not None:
            emulator.connected(time.monotonic())

    def set_baud(self, baud: int) -> None:
        self.sent.append(b"<baud %d>" % baud)
        self.baud = baud

    def send_break(self, _duration_s: float) -> None:
        self.sent.append(b"<break>")
        if self.emulator is not None:
            self.emulator.wrong_baud(time.monotonic())

    def write(self, data: bytes) -> None:
        if not self.open:
            raise DeviceLostError("closed")
        self.sent.append(data)
        if self.answers is not None:
            self.pending += self.answers.pop(0) if self.answers else b""
        elif self.emulator is not None:
            if self.emulator.baud != self.baud:
                self.emulator.wrong_baud(time.monotonic())
            else:
                self.emulator.receive(data, time.monotonic())

    def read(self, timeout_s: float) -> bytes:
        if not self.open:
            raise DeviceLostError("closed")
        if self.emulator is not None:
            now = time.monotonic()
            self.emulator.advance(now)
            self.pending += b"".join(self.emulator.out)
            self.emulator.out.clear()
        data, self.pending = self.pending, b""
        if not data and timeout_s > 0.0:
            time.sleep(min(timeout_s, 0.001))
        return data

    def drain(self, _quiet_s: float, _limit_s: float = 2.0) -> bytes:
        return self.read(0.0)

    def close(self) -> None:
        self.open = False


class Ports:
    """Opens MemoryPorts for a driver and keeps them."""

    def __init__(self, emulator: Emulator | None = None,
                 answers: list[bytes] | None = None) -> None:
        self.emulator, self.answers = emulator, answers
        self.opened: list[MemoryPort] = []

    def __call__(self, path: str, baud: int) -> MemoryPort:
        self.opened.append(MemoryPort(path, baud, self.emulator, self.answers))
        return self.opened[-1]

    @property
    def sent(self) -> list[bytes]:
        return [data for port in self.opened for data in port.sent]


def talk(emulator: Emulator, *commands: bytes, now: float = 0.0) -> list[bytes]:
    """What the emulator says to each command."""
    answers = []
    for command in commands:
        emulator.receive(command, now)
        answers.append(b"".join(emulator.out))
        emulator.out.clear()
    return answers
