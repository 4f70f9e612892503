"""A serial port through pyserial, with its quirks and its errors in one place."""

from __future__ import annotations

import contextlib
import os
import select
import time

import serial

from dfm_stage.drivers.errors import DeviceLostError

_WRITE_TIMEOUT_S = 0.2


class SerialPort:
    """An open port: 8 data bits, no parity, 1 stop bit, no flow control.

    Opening asks the driver for low latency: an FTDI adapter otherwise holds received bytes back
    for 16 ms (pseudo-terminals and some adapters refuse it, `low_latency` tells). Every error of
    the operating system becomes DeviceLostError.

    Raises
    ------
    DeviceLostError
        If the port cannot be opened, is in use, or is gone.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        self._port = self._open(path, baud)
        self.low_latency = True
        try:
            self._port.set_low_latency_mode(True)
        except (ValueError, OSError, NotImplementedError):
            self.low_latency = False

    @staticmethod
    def _open(path: str, baud: int) -> serial.Serial:
        try:
            return serial.Serial(path, baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S,
                                 exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceLostError(f"cannot open {path}: {_short(error)}; is the device plugged "
                                  "in, and may this user read and write it (group dialout)?"
                                  ) from error

    @property
    def baud(self) -> int:
        """Bits per second."""
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        """Change the rate at once."""
        try:
            self._port.baudrate = baud
        except (serial.SerialException, OSError, ValueError) as error:
            raise self._lost(error) from error

    def send_break(self, duration_s: float) -> None:
        """Hold the line low for a time."""
        try:
            self._port.break_condition = True
            time.sleep(duration_s)
            self._port.break_condition = False
        except (serial.SerialException, OSError) as error:
            raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        """Hand all bytes to the operating system."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise self._lost(error) from error

    def read(self, timeout_s: float) -> bytes:
        """Return what is there, at the latest after `timeout_s`; empty if nothing came."""
        try:
            handle = self._port.fileno()
            ready, _, _ = select.select([handle], [], [], max(0.0, timeout_s))
            if not ready:
                return b""
            data = os.read(handle, 4096)
        except (serial.SerialException, OSError, ValueError, TypeError) as error:
            raise self._lost(error) from error
        if not data:
            raise DeviceLostError(f"{self.path}: the device is gone (end of file)")
        return data

    def drain(self, quiet_s: float, limit_s: float = 2.0) -> bytes:
        """Read until nothing came for `quiet_s`, at most for `limit_s`; return what came."""
        deadline = time.monotonic() + limit_s
        out = b""
        while time.monotonic() < deadline:
            data = self.read(quiet_s)
            if not data:
                break
            out += data
        return out

    def close(self) -> None:
        """Give the port back; again is harmless."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()

    def _lost(self, error: Exception) -> DeviceLostError:
        return DeviceLostError(f"{self.path}: the port is gone: {_short(error)}")


def _short(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error).split("\n")[0]
