"""A serial port through pyserial, with its quirks and its errors in one place."""

from __future__ import annotations

import contextlib
import os
import re
import select
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import serial

from dfm_stage.drivers.errors import DeviceLostError

LONGEST_LINE = 256
_WRITE_TIMEOUT_S = 0.2
_PORT_ERRORS = (serial.SerialException, OSError, ValueError, TypeError)


class SerialPort:
    """An open port: 8 data bits, no parity, 1 stop bit, no flow control.

    Opening asks the driver for low latency: an FTDI adapter otherwise holds received bytes back
    for 16 ms (pseudo-terminals and some adapters refuse it). Every error of the operating system
    becomes DeviceLostError.

    Raises
    ------
    DeviceLostError
        If the port cannot be opened, is in use, or is gone.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S,
                                       exclusive=True)
        except _PORT_ERRORS as error:
            raise DeviceLostError(f"cannot open {path}: {_short(error)}; is the device plugged "
                                  "in, and may this user read and write it (group dialout)?"
                                  ) from error
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            self._port.set_low_latency_mode(True)

    @contextlib.contextmanager
    def _present(self) -> Iterator[None]:
        """Turn what the system raises when a port is gone into DeviceLostError."""
        try:
            yield
        except _PORT_ERRORS as error:
            raise DeviceLostError(f"{self.path}: the port is gone: {_short(error)}") from error

    @property
    def baud(self) -> int:
        """Bits per second."""
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        """Change the rate at once."""
        with self._present():
            self._port.baudrate = baud

    def send_break(self, duration_s: float) -> None:
        """Hold the line low for a time."""
        with self._present():
            self._port.break_condition = True
            time.sleep(duration_s)
            self._port.break_condition = False

    def write(self, data: bytes) -> None:
        """Hand all bytes to the operating system."""
        with self._present():
            self._port.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Return what is there, at the latest after `timeout_s`; empty if nothing came."""
        with self._present():
            handle = self._port.fileno()
            if not select.select([handle], [], [], max(0.0, timeout_s))[0]:
                return b""
            data = os.read(handle, 4096)
        if not data:
            raise DeviceLostError(f"{self.path}: the device is gone (end of file)")
        return data

    def drain(self, quiet_s: float, limit_s: float = 2.0) -> None:
        """Read until nothing came for `quiet_s`, at most for `limit_s`, and throw it away."""
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline and self.read(quiet_s):
            pass

    def close(self) -> None:
        """Give the port back; again is harmless."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()


def _short(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error).split("\n")[0]


class Line(NamedTuple):
    """One line without its end; `after` bytes of the same `feed` came after that."""

    text: bytes
    after: int


class LineBuffer:
    """Splits a byte stream at any of `ends`; empty lines are dropped.

    A line longer than LONGEST_LINE is noise and is thrown away up to its end.
    """

    def __init__(self, ends: bytes = b"\r\n") -> None:
        self._end = re.compile(b"[" + re.escape(ends) + b"]")
        self._rest = b""

    def feed(self, data: bytes) -> list[Line]:
        """Return the lines that are complete now."""
        lines, begin = [], 0
        for end in self._end.finditer(data):
            text = self._rest + data[begin:end.start()]
            begin, self._rest = end.end(), b""
            if 0 < len(text) <= LONGEST_LINE:
                lines.append(Line(text, len(data) - begin))
        # One byte more than a line may have is enough to know noise by when its end comes.
        self._rest = (self._rest + data[begin:])[:LONGEST_LINE + 1]
        return lines

    def clear(self) -> None:
        """Forget an unfinished line."""
        self._rest = b""


class LineDevice:
    """A device that answers in lines: its port, which may be closed, and what it sends.

    Parameters
    ----------
    path : str
        Of the serial port.
    ends : bytes
        Bytes of which any ends a line.
    open_port : callable
        Opens the port at a path and a rate.
    """

    def __init__(self, path: str, ends: bytes, open_port: Callable[[str, int], SerialPort]
                 ) -> None:
        self._path = path
        self._open_port = open_port
        self._opened: SerialPort | None = None
        self._lines = LineBuffer(ends)

    @property
    def _port(self) -> SerialPort:
        """The open port; raises DeviceLostError without one."""
        if self._opened is None:
            raise DeviceLostError(f"{self._path} is not open")
        return self._opened

    def _connect(self, baud: int) -> SerialPort:
        """Open the port anew."""
        self.close()
        self._opened = self._open_port(self._path, baud)
        self._lines.clear()
        return self._opened

    def _received(self, limit_s: float) -> Iterator[Line]:
        """Yield the lines that come within `limit_s`."""
        deadline = time.monotonic() + limit_s
        while (left := deadline - time.monotonic()) > 0.0:
            yield from self._lines.feed(self._port.read(left))

    def close(self) -> None:
        """Give the port back; the device keeps doing what it was told last."""
        if self._opened is not None:
            self._opened.close()
            self._opened = None
