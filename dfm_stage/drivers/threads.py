"""The threads that own a device: each is the only one that talks to it.

The encoder's thread says when the counter is lost and comes back to it unreferenced. The
amplifier's runs apart from whatever brings commands, so that it notices by itself when they stop.
Between commands it asks the drive how it is. Anything unexpected ends in zero current, then output
off, then, if the line is dead, reconnecting to a drive that stays off.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any, Protocol

from dfm_stage.drivers.device import (
    AmplifierDevice,
    AmplifierStatus,
    EncoderDevice,
    EncoderSample,
)
from dfm_stage.drivers.errors import DeviceLostError, DriverError, RefusedError
from dfm_stage.drivers.interlock import Cause, Interlock

_STEP_S = 0.005
_MIN_SLACK_S = 0.004    # a question is asked only if no command is due within this time
_NO_ANSWER = "the drive does not answer"


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
        self._seek = self.lost = False
        self.reconnects = 0
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
                self._come_back(_in_one_line(error))

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

    def _come_back(self, why: str) -> None:
        """Close, then open until it works, or until asked to stop."""
        self.lost = True
        self._listener.on_lost(why)
        self._device.close()
        while not self._stopping.wait(self._retry_s):
            try:
                identity = self._device.open()
            except Exception:  # noqa: BLE001 whatever it was: try again
                self.reconnects += 1
                self._device.close()
                continue
            self.lost = False
            self._listener.on_back(identity)
            return


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or repr(error)


class SigmaDelta:
    """First-order noise shaping of a value that can only be sent in whole counts.

    The mean of what is sent is the value asked for; the error of one step is pushed to
    frequencies near the rate of sending, where a stage with mass does not follow. Without
    `shaped` it is plain rounding.
    """

    def __init__(self, count: float, shaped: bool = True) -> None:
        self._count = count
        self._shaped = shaped
        self._owed = 0.0

    def __call__(self, value: float) -> int:
        """Return the counts to send for `value`."""
        wanted = value / self._count + self._owed
        counts = round(wanted)
        if self._shaped:
            self._owed = wanted - counts
        return counts

    def reset(self) -> None:
        """Owe nothing."""
        self._owed = 0.0


class AmplifierListener(Protocol):
    """Who is told, in the worker's thread."""

    def on_output(self, counts: int, answered: Any) -> None:
        """Called when the drive has acknowledged an output; `answered` is the command's tag."""

    def on_status(self, status: AmplifierStatus) -> None:
        """Called with every answer to a question."""


class AmplifierWorker:
    """Drives `device` as `interlock` allows.

    Parameters
    ----------
    current_limit_a : float
        Measured current beyond this trips.
    shaped : bool
        Shape the last count (SigmaDelta) instead of rounding.
    question_period_s : float
        One question to the drive each; it costs an exchange.

    Attributes
    ----------
    connected : whether the drive answers
    outputs, reconnects : how many there were
    identity : of the drive, where it had to be opened anew
    """

    def __init__(self, device: AmplifierDevice, interlock: Interlock,
                 listener: AmplifierListener, *, current_limit_a: float, shaped: bool = True,
                 question_period_s: float = 0.02, retry_s: float = 1.0,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._device = device
        self._interlock = interlock
        self._listener = listener
        self._current_limit_a = current_limit_a
        self._quantiser = SigmaDelta(device.count_a, shaped)
        self._question_period_s = question_period_s
        self._retry_s = retry_s
        self._clock = clock
        self._wake = threading.Condition()
        self._target: tuple[float, Any] | None = None
        self._orders: list[tuple[Callable[[], str], Future[str]]] = []
        self._stopping = self._energised = False
        self.connected = True
        self.outputs = self.reconnects = 0
        self.identity = ""
        self._thread = threading.Thread(target=self._run, name="amplifier", daemon=True)

    def start(self) -> None:
        """Start with a device that is open, its output off."""
        self._thread.start()

    def command(self, current_a: float, tag: Any) -> None:
        """Set the output as soon as the line is free; of several waiting, the last counts."""
        with self._wake:
            self._target = (current_a, tag)
            self._wake.notify()

    def nudge(self) -> None:
        """Look at the interlock now."""
        with self._wake:
            self._wake.notify()

    def arm(self, timeout_s: float = 3.0) -> None:
        """Switch the output on at zero current.

        Raises
        ------
        RefusedError
            With the reason; the output is then off.
        """
        self._order(self._arm, timeout_s)

    def disarm(self, timeout_s: float = 3.0) -> None:
        """Zero, then off."""
        self._interlock.disarm()
        self._order(self._make_safe, timeout_s)

    def clear(self, timeout_s: float = 3.0) -> str:
        """Clear faults of the drive, then the interlock; return what they were."""
        self._interlock.disarm()
        return self._order(self._clear, timeout_s)

    def stop(self) -> None:
        """Output to zero and off, then end the thread."""
        self._interlock.trip(Cause.SHUTDOWN, "the driver ends")
        with self._wake:
            self._stopping = True
            self._wake.notify()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _order(self, action: Callable[[], str], timeout_s: float) -> str:
        answer: Future[str] = Future()
        with self._wake:
            self._orders.append((action, answer))
            self._wake.notify()
        if not wait((answer,), timeout_s).done:
            raise RefusedError(_NO_ANSWER)
        return answer.result()

    # The thread

    def _arm(self) -> str:
        if not self.connected:
            raise RefusedError(_NO_ANSWER)
        if self._interlock.causes:
            raise RefusedError(f"clear first: {self._interlock.words()}")
        self._target = None
        self._quantiser.reset()
        self._energised = True  # from here on there is something to make safe
        try:
            self._device.arm()
        except RefusedError:
            self._make_safe()
            raise
        self._interlock.arm()
        return "armed"

    def _make_safe(self) -> str:
        self._target = None
        self._quantiser.reset()
        self._device.disarm()
        self._energised = False
        self._listener.on_output(0, None)
        return "output at zero and off"

    def _clear(self) -> str:
        self._make_safe()
        cleared = self._device.clear_faults()
        was = self._interlock.clear()
        return f"cleared: {was or 'nothing latched'}; drive: {cleared}"

    def _run(self) -> None:
        next_question = self._clock() + self._question_period_s
        while True:
            try:
                if self._turn(next_question):
                    next_question = self._clock() + self._question_period_s
                if self._stopping and not self._energised:
                    return
            except DeviceLostError as error:
                self._lost(Cause.LINK, error)
            except Exception as error:  # noqa: BLE001 whatever it was: zero
                self._lost(Cause.INTERNAL, error)
            if self._stopping and not self.connected:
                return

    def _turn(self, next_question: float) -> bool:
        """Wait for something to do and do it; return whether a question was asked."""
        interlock = self._interlock
        with self._wake:
            now = self._clock()
            left = interlock.time_left(now)
            pause = left if left <= _MIN_SLACK_S else min(next_question - now, left)
            urgent = self._orders or self._target or self._stopping
            if not urgent and pause > 0.0 and (interlock.armed or not self._energised):
                self._wake.wait(pause)
            target, self._target = self._target, None
            order = self._orders.pop(0) if self._orders else None
        interlock.stale(self._clock())
        if self._energised and not interlock.armed:
            self._make_safe()
        if order is not None:
            self._obey(*order)
            return False
        if target is not None and interlock.armed:
            self._put_out(*target)
        now = self._clock()
        if now >= next_question and interlock.time_left(now) > _MIN_SLACK_S:
            self._ask()
            return True
        return False

    def _put_out(self, current_a: float, tag: Any) -> None:
        if not math.isfinite(current_a):
            self._interlock.trip(Cause.NOT_FINITE, f"a current of {current_a}")
            return
        counts = self._quantiser(current_a)
        self._device.set_counts(counts)
        self.outputs += 1
        self._listener.on_output(counts, tag)

    def _ask(self) -> None:
        status = self._device.status()
        current = status.current_a or 0.0
        for cause, why in (
                (Cause.CURRENT, f"the drive measures {current:g} A, the limit is "
                                f"{self._current_limit_a:g} A"
                 if abs(current) > self._current_limit_a else ""),
                (Cause.DRIVE, status.trouble), (Cause.TRAVEL, status.travel_limit)):
            if why:
                self._interlock.trip(cause, why)
        self._listener.on_status(status)

    @staticmethod
    def _obey(action: Callable[[], str], answer: Future[str]) -> None:
        """Do what was asked, and say how it went; a refusal alone is no trouble for the thread."""
        try:
            answer.set_result(action())
        except DriverError as error:
            answer.set_exception(error)
            if isinstance(error, DeviceLostError):
                raise
        except Exception as error:
            answer.set_exception(DriverError(f"the driver failed: {error!r}"))
            raise

    def _lost(self, cause: Cause, error: Exception) -> None:
        """Trip; try for zero; where the drive does not answer, come back to it, off."""
        self._interlock.trip(cause, _in_one_line(error))
        if cause is not Cause.LINK:
            with contextlib.suppress(Exception):  # where it fails, by reconnecting
                self._make_safe()
                return
        self.connected = False
        while True:
            self._device.close()
            try:
                self.identity = self._device.open()
                break
            except Exception:  # noqa: BLE001 whatever it was: try again
                self.reconnects += 1
            with self._wake:
                orders, self._orders = self._orders, []
            for _, answer in orders:
                answer.set_exception(RefusedError(_NO_ANSWER))
            if self._stopping:
                return
            with self._wake:
                if not self._orders:
                    self._wake.wait(self._retry_s)
        self._target = None
        self._energised, self.connected = False, True
        with contextlib.suppress(Exception):
            self._listener.on_output(0, None)
