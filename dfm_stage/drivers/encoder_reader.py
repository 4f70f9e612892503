"""A thread that reads an encoder, says when it is lost, and comes back to it unreferenced."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Protocol

from dfm_stage.drivers.device import EncoderDevice, EncoderSample
from dfm_stage.drivers.errors import DriverError

_STEP_S = 0.005


class EncoderListener(Protocol):
    """Who is told, in the reader's thread."""

    def on_sample(self, sample: EncoderSample) -> None:
        """Called with every sample."""

    def on_lost(self, why: str) -> None:
        """Called when samples stopped, once per loss."""

    def on_back(self, identity: str) -> None:
        """Called when the device answers again; its zero is unknown."""

    def on_index(self) -> None:
        """Called when the index that was sought has been passed: its count is now zero."""


class EncoderReader:
    """Reads until `stop`.

    Without a sample for `timeout_s`, or after any error, the device counts as lost: it is closed,
    and opened anew every `retry_s` until it answers.
    """

    def __init__(self, device: EncoderDevice, listener: EncoderListener, timeout_s: float = 0.02,
                 retry_s: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._device = device
        self._listener = listener
        self._timeout_s = timeout_s
        self._retry_s = retry_s
        self._clock = clock
        self._stopping = threading.Event()
        self._seek = False
        self.reconnects = 0
        self.lost = False
        self._thread = threading.Thread(target=self._run, name="encoder", daemon=True)

    def start(self) -> None:
        """Start reading a device that is open."""
        self._thread.start()

    def stop(self) -> None:
        """Stop streaming and reading; the device stays open if it was."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def seek_index(self) -> None:
        """Ask the reading thread to let the next index set the zero."""
        self._seek = True

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._device.start()
                self._read()
                with contextlib.suppress(DriverError):
                    self._device.stop()
            except Exception as error:  # noqa: BLE001 a thread must not die silently
                if not self._come_back(" ".join(str(error).split()) or repr(error)):
                    return

    def _read(self) -> None:
        # the first samples only teach the clock, and are not passed on
        deadline = self._clock() + 1.0 + self._timeout_s
        while not self._stopping.is_set():
            if self._seek:
                self._seek = False
                self._device.seek_index()
            for sample in self._device.read(min(_STEP_S, self._timeout_s)):
                deadline = self._clock() + self._timeout_s
                self._listener.on_sample(sample)
            if self._device.index_found():
                self._listener.on_index()
            if self._clock() > deadline:
                raise DriverError(f"no sample for {self._timeout_s * 1e3:g} ms")

    def _come_back(self, why: str) -> bool:
        """Close, then open until it works; return False when asked to stop meanwhile."""
        self.lost = True
        self._listener.on_lost(why)
        while not self._stopping.is_set():
            self._device.close()
            if self._stopping.wait(self._retry_s):
                break
            try:
                identity = self._device.open()
            except Exception:  # noqa: BLE001 whatever it was: try again
                self.reconnects += 1
                continue
            self.lost = False
            self._listener.on_back(identity)
            return True
        return False
