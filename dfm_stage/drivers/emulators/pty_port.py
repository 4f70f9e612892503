"""An emulated device on a pseudo-terminal, with the wire's time and the wire's faults.

Bytes take their time: ten bits each at the device's rate, in both directions. The master of a
pseudo-terminal sees neither breaks nor modem lines, but it sees the client's rate (bytes at
another than the device's are noise to it, as a break is) and that the client has closed.
"""

from __future__ import annotations

import contextlib
import heapq
import math
import os
import pty
import random
import select
import termios
import time
import tty
from pathlib import Path
from typing import Protocol

from dfm_stage.drivers.errors import DriverError

_BITS = 10
_POLL_S = 0.002
_SPEEDS = {getattr(termios, name): int(name[1:]) for name in dir(termios)
           if name[0] == "B" and name[1:].isdigit()}


class Emulator(Protocol):
    """What a device does with bytes and time; `out` collects what it says."""

    out: list[bytes]

    @property
    def baud(self) -> int:
        """Its rate now."""

    def connected(self, now: float, /) -> None:
        """A host has opened the port."""

    def disconnected(self, now: float, /) -> None:
        """It has closed it."""

    def wrong_baud(self, now: float, /) -> None:
        """Bytes came at another rate."""

    def receive(self, data: bytes, now: float, /) -> None:
        """Bytes have arrived."""

    def next_event(self) -> float:
        """When it will do something by itself."""

    def advance(self, now: float, /) -> None:
        """Let time pass."""

    def inject(self, words: list[str], now: float, /) -> str:
        """Do what an operator asks; return what was done."""


class PtyPort:
    """Runs one emulator; `link` is a path that always leads to the current pseudo-terminal."""

    def __init__(self, emulator: Emulator, link: Path, seed: int = 0) -> None:
        self._emulator = emulator
        self.link = link
        self._random = random.Random(seed)
        self._master: int | None = None
        self._present = False
        self._arriving: list[tuple[float, int, bytes, int]] = []
        self._leaving: list[tuple[float, int, bytes, int]] = []
        self._number = 0
        self._in_free = self._out_free = self._silent_until = self._away_until = 0.0
        self._cut_next = False
        self._plug_in()

    def _plug_in(self) -> None:
        master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        name = os.ttyname(slave)
        os.close(slave)
        temporary = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(name)
        temporary.replace(self.link)
        self._master = master
        self._present = False

    def _pull_out(self, now: float) -> None:
        if self._master is not None:
            os.close(self._master)
            self._master = None
        self.link.unlink(missing_ok=True)
        self._hang_up(now)

    def _hang_up(self, now: float) -> None:
        """Forget what is on the wire; tell the device if a client was there."""
        self._arriving.clear()
        self._leaving.clear()
        if self._present:
            self._present = False
            self._emulator.disconnected(now)

    def close(self) -> None:
        """Unplug for good."""
        self._pull_out(time.monotonic())

    # Faults

    def inject(self, text: str) -> str:
        """Do what an operator asks, in words; return what was done.

        `silence S` (hears and says nothing for S seconds), `garbage N` (N random bytes),
        `partial` (the next message breaks off half-way), `disconnect S` (unplugged for S
        seconds), and what the device adds.
        """
        now = time.monotonic()
        words = text.split()
        try:
            if words[:1] == ["silence"]:
                self._silent_until = now + float(words[1])
                return f"silent for {words[1]} s"
            if words[:1] == ["garbage"]:
                self._leave(self._random.randbytes(int(words[1])), self._emulator.baud, now)
                return f"{words[1]} random bytes"
            if words == ["partial"]:
                self._cut_next = True
                return "the next message breaks off"
            if words[:1] == ["disconnect"]:
                self._away_until = now + float(words[1])
                self._pull_out(now)
                return f"unplugged for {words[1]} s"
            return self._emulator.inject(words, now)
        except (ValueError, IndexError) as error:
            raise DriverError(f"{text!r}: {error}; silence S, garbage N, partial, "
                              "disconnect S, or what the device knows") from error

    # Running

    def step(self, others: list[int], longest_s: float = 0.1) -> list[int]:
        """Do what is due, wait for the next thing; return which of `others` can be read."""
        now = time.monotonic()
        self._emulator.advance(now)
        self._collect(now)
        self._deliver(now)
        due = min(self._emulator.next_event(), *(
            queue[0][0] for queue in (self._arriving, self._leaving) if queue), math.inf)
        wait = min(longest_s, due - time.monotonic())
        handles = list(others)
        if self._master is None:
            wait = min(wait, self._away_until - now)
            if now >= self._away_until:
                self._plug_in()
        elif self._hung_up():
            wait = min(wait, _POLL_S)
            if self._present:
                self._hang_up(now)
        else:
            if not self._present:
                self._present = True
                self._emulator.connected(now)
                self._collect(now)
                wait = 0.0
            handles.append(self._master)
        ready, _, _ = select.select(handles, [], [], max(0.0, wait))
        if self._master in ready:
            self._take(time.monotonic())
        return [handle for handle in ready if handle in others]

    def _hung_up(self) -> bool:
        poll = select.poll()
        poll.register(self._master or 0, select.POLLIN)
        return any(flags & select.POLLHUP and not flags & select.POLLIN
                   for _, flags in poll.poll(0))

    def _take(self, now: float) -> None:
        """Read what the client wrote; it arrives when its last bit does."""
        assert self._master is not None  # noqa: S101
        try:
            data = os.read(self._master, 4096)
        except OSError:
            data = b""
        if not data or now < self._silent_until:
            return
        rate = self._client_baud()
        begin = max(self._in_free, now)
        self._in_free = begin + len(data) * _BITS / rate
        # each line is acted on when its own last bit has come
        done = 0
        for line in data.splitlines(keepends=True) or [data]:
            done += len(line)
            self._number += 1
            heapq.heappush(self._arriving,
                           (begin + done * _BITS / rate, self._number, line, rate))

    def _client_baud(self) -> int:
        try:
            return _SPEEDS.get(termios.tcgetattr(self._master or 0)[5], 0) or 9600
        except termios.error:
            return 9600

    def _collect(self, now: float) -> None:
        baud = self._emulator.baud
        messages, self._emulator.out[:] = list(self._emulator.out), []
        for message in messages:
            self._leave(message[:len(message) // 2] if self._cut_next else message, baud, now)
            self._cut_next = False

    def _leave(self, data: bytes, baud: int, now: float) -> None:
        if not self._present or now < self._silent_until:
            return
        self._out_free = max(self._out_free, now) + len(data) * _BITS / baud
        self._number += 1
        heapq.heappush(self._leaving, (self._out_free, self._number, data, baud))

    def _deliver(self, now: float) -> None:
        while self._arriving and self._arriving[0][0] <= now:
            when, _, data, rate = heapq.heappop(self._arriving)
            if rate != self._emulator.baud:
                self._emulator.wrong_baud(when)
            else:
                self._emulator.receive(data, when)
                self._collect(when)
        while self._leaving and self._leaving[0][0] <= now:
            self._write(*heapq.heappop(self._leaving)[2:])

    def _write(self, data: bytes, baud: int) -> None:
        if self._master is None:
            return
        if self._client_baud() != baud:
            data = bytes(self._random.randrange(0x80, 0x100) for _ in data)
        with contextlib.suppress(OSError):
            os.write(self._master, data)
