"""Serial devices that say anything: both drivers in the threads that own them, without a line.

An input is what the device sends, cut at SEPARATOR: one piece for each time the driver waits for
an answer. An empty piece is silence; GONE is a port that is lost and can be opened again. Time is
that of the wire: it passes where a driver waits, and nowhere else.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from random import Random
from typing import Any
from unittest.mock import patch

from benchmarks.bytes_damage import TEXTS, damaged
from dfm_stage.drivers import threads, transport
from dfm_stage.drivers.amplifiers import copley_ascii
from dfm_stage.drivers.device import AmplifierStatus, EncoderSample
from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
from dfm_stage.drivers.emulators.qsb_d import QsbDEmulator
from dfm_stage.drivers.encoders import qsb_d
from dfm_stage.drivers.errors import DeviceLostError, DriverError
from dfm_stage.drivers.interlock import Interlock

SEPARATOR, GONE = b"\xa7", b"\xa9"
PIECES = 60
"""Answers of a session in a seed."""
COMMAND_A, LIMIT_A = 0.5, 2.0
SETS_CURRENT, SETS_STATE = b"s r0x02 ", b"s r0x24 "
COPLEY_WORDS = (*TEXTS, b"ok\r", b"v 0\r", b"v 1\r", b"v -1\r", b"v 4294967295\r",
                b"v 9999999999\r", b"v 4194304\r",
                b"v 1 2\r", b"v\r", b"e 3\r", b"e 33\r", b"e -1\r", b"e 9999\r",
                b"v " + b"9" * 300 + b"\r", b"ok\r" * 100, b"v 21\r", b"v 400000\r", b"v 115200\r",
                SEPARATOR, SEPARATOR * 3, SEPARATOR + GONE + SEPARATOR)
QSB_WORDS = (*TEXTS, b"QSB-D  0E!\r\n", b"s0E00000000FFFFFFFF!\r\n", b"s0E8000000000000001!\r\n",
             b"s0EFFFFFFFF00000000!\r\n", b"e1400000000!\r\n", b"x1400000000!\r\n",
             b"r1400000000!\r\n", b"r0600000018!\r\n", b"r0600000008!\r\n", b"s 0E 00000001 !\r\n",
             b"s0e00000000ffffffff!\r\n", b"F" * 300, SEPARATOR, SEPARATOR * 3,
             SEPARATOR + GONE + SEPARATOR)


class UnsafeError(Exception):
    """A driver did what it must never do; no error of ours, so that it counts as a finding."""


class WireTime:
    """Stands in for the module `time` inside the drivers."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        """Seconds."""
        return self.now

    def time_ns(self) -> int:
        """Nanoseconds."""
        return round(self.now * 1e9)

    def sleep(self, duration_s: float) -> None:
        """Let time pass."""
        self.now += duration_s


class ScriptedPort:
    """Stands in for SerialPort; `answer` gives the next piece, None when there is no more."""

    def __init__(self, baud: int, time: WireTime, answer: Callable[[bytes], bytes | None],
                 sent: Callable[[bytes], None]) -> None:
        self.baud, self.time = baud, time
        self._answer, self._sent = answer, sent
        self._pending = self._last = b""

    def write(self, data: bytes) -> None:
        """Send."""
        self._sent(data)
        self._last += data

    def read(self, timeout_s: float) -> bytes:
        """What is there, else the next piece if it may wait for it."""
        data, self._pending = self._pending, b""
        if not data and timeout_s > 0.0:
            found = self._answer(self._last)
            self._last = b""
            if found is None or found == GONE:
                raise DeviceLostError("the port is gone")
            data = found
            self.time.sleep(1e-3 if data else timeout_s)
        return data

    def drain(self, _quiet_s: float, _limit_s: float = 2.0) -> None:
        """Throw away what is there."""
        self._pending = b""

    def set_baud(self, baud: int) -> None:
        """Change the rate."""
        self.baud = baud

    def send_break(self, duration_s: float) -> None:
        """A break."""
        self.time.sleep(duration_s)
        self._sent(b"<break>")

    def close(self) -> None:
        """Nothing to give back."""


@contextlib.contextmanager
def wire_time() -> Iterator[WireTime]:
    """Let the drivers live in the time of the wire."""
    time = WireTime()
    with patch.object(transport, "time", time), patch.object(copley_ascii, "time", time), \
            patch.object(qsb_d, "time", time):
        yield time


class Watched:
    """A device as its thread sees it; keeps what it raises that is no DriverError, and tells of
    every error."""

    def __init__(self, device: Any, on_error: Callable[[], None]) -> None:
        self._device, self._on_error = device, on_error
        self.raised: Exception | None = None

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._device, name)
        if not callable(found):
            return found

        def call(*given: Any) -> Any:
            try:
                return found(*given)
            except Exception as error:
                self._on_error()
                if not isinstance(error, DriverError):
                    self.raised = self.raised or error
                raise

        return call


class AmplifierSession:
    """An amplifier in its worker: armed, commanded and asked until the device says no more.

    Whether a current may go out is judged here, without the interlock: only after an order to arm
    that was carried out, and no longer after any error or anything wrong that the drive has told.
    """

    def __init__(self, answer: Callable[[bytes], bytes | None], time: WireTime) -> None:
        self.sent: list[bytes] = []
        self._answer, self._time = answer, time
        self.interlock = Interlock(10.0, stale_s=0.0)
        self.device = Watched(copley_ascii.CopleyAscii(
            "port", peak_limit_a=20.0, continuous_limit_a=10.0, open_port=self._open),
            self._forbid)
        self.worker = threads.AmplifierWorker(
            self.device, self.interlock, self, current_limit_a=LIMIT_A, question_period_s=0.0,
            retry_s=0.0, clock=time.monotonic)
        self._ended = self._arming = self._allowed = False
        self._orders = 0

    def run(self) -> None:
        """Open and run; raises UnsafeError, or what the driver raised beside its own errors."""
        try:
            self.device.open()
            self._order(self._arm)
            self.worker._run()
        except DriverError:
            pass
        if self.device.raised is not None:
            raise self.device.raised

    def _arm(self) -> str:
        self._arming = True
        try:
            said = self.worker._arm()
            self._allowed = True
            return said
        finally:
            self._arming = False

    def _forbid(self) -> None:
        self._allowed = False

    def _order(self, action: Callable[[], str]) -> None:
        if not self._ended:
            self.worker._orders.append((action, Future()))

    def _open(self, _path: str, baud: int) -> Any:
        if self._ended:
            raise DeviceLostError("the port is gone")
        return ScriptedPort(baud, self._time, self._next, self._watch)

    def _next(self, command: bytes) -> bytes | None:
        found = None if self._ended else self._answer(command)
        if found is None:
            self._ended = True
            self.interlock.disarm()
            self.worker._stopping = True
        return found

    def _watch(self, data: bytes) -> None:
        self.sent.append(data)
        if data.startswith(SETS_CURRENT):
            amps = int(data[len(SETS_CURRENT):]) * copley_ascii.CopleyAscii.count_a
            if amps and not self._allowed:
                raise UnsafeError(f"{data!r} while the output must be zero")
            if abs(amps) > COMMAND_A + copley_ascii.CopleyAscii.count_a:
                raise UnsafeError(f"{data!r} for a command of {COMMAND_A} A")
        elif data.startswith(SETS_STATE) and int(data[len(SETS_STATE):]) and not self._arming:
            raise UnsafeError(f"{data!r} without an order to arm")

    def on_output(self, counts: int, _answered: Any) -> None:
        """Command the next current."""
        if counts == 0 and not self.interlock.armed:
            return
        self.worker._target = (COMMAND_A if counts <= 0 else -COMMAND_A, None)

    def on_status(self, status: AmplifierStatus) -> None:
        """Command while armed; else clear and arm again."""
        if status.trouble or status.travel_limit or abs(status.current_a or 0.0) > LIMIT_A:
            self._forbid()
        if self.interlock.armed:
            self.on_output(1, None)
            return
        self._orders += 1
        self._order(self.worker._clear if self._orders % 2 else self._arm)


class EncoderSession:
    """An encoder in its reader until the device says no more."""

    def __init__(self, answer: Callable[[bytes], bytes | None], time: WireTime) -> None:
        self._answer, self._time = answer, time
        self.device = Watched(qsb_d.QsbD("port", settling_s=0.0, open_port=self._open),
                              lambda: None)
        self.reader = threads.EncoderReader(self.device, self, timeout_s=0.02, retry_s=0.0,
                                            clock=time.monotonic)
        self.samples = 0

    def run(self) -> None:
        """Open and read; raises UnsafeError, or what the driver raised beside its own errors."""
        try:
            self.device.open()
            self.reader.seek_index()
            self.reader._run()
        except DriverError:
            pass
        if self.device.raised is not None:
            raise self.device.raised

    def _open(self, _path: str, baud: int) -> Any:
        if self.reader._stopping.is_set():
            raise DeviceLostError("the port is gone")
        return ScriptedPort(baud, self._time, self._next, lambda _data: None)

    def _next(self, command: bytes) -> bytes | None:
        found = self._answer(command)
        if found is None:
            self.reader._stopping.set()
        return found

    def on_sample(self, sample: EncoderSample) -> None:
        """Check it."""
        self.samples += 1
        if not (sample.elapsed_s > 0.0 and 0 <= sample.seq < 2**32
                and isinstance(sample.counts, int) and isinstance(sample.stamp_ns, int)):
            raise UnsafeError(f"{sample} is no sample")

    def on_lost(self, why: str) -> None:
        """It comes back, or the input ends."""

    def on_back(self, _identity: str) -> None:
        """It came back."""

    def on_index(self) -> None:
        """It passed the index."""


def transcript(session: type[AmplifierSession | EncoderSession]) -> bytes:
    """What an emulated device answers in a session: a seed."""
    pieces: list[bytes] = []
    with wire_time() as time:
        copley = session is AmplifierSession
        emulator: Any = CopleyAsciiEmulator() if copley else QsbDEmulator(
            lambda now: int(1e4 * now), index_at=50)
        emulator.reset(time.now)

        def answer(command: bytes) -> bytes | None:
            if len(pieces) == PIECES:
                return None
            if command:
                emulator.receive(command.replace(b"<break>", b""), time.now)
            emulator.advance(time.now)
            pieces.append(b"".join(emulator.out))
            emulator.out.clear()
            return pieces[-1]

        session(answer, time).run()
    return SEPARATOR.join(pieces)


def spoilt_session(rng: Random, seeds: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    """A session with answers damaged, lost, doubled, swapped, late or made up."""
    pieces = rng.choice(seeds).split(SEPARATOR)
    for _ in range(rng.choice((1, 1, 2, 4, 20))):
        # most of what is decided is decided at the start
        at = min(int(len(pieces) * rng.random() ** 3), len(pieces) - 1)
        kind = rng.randrange(9)
        if kind == 0:
            pieces[at] = damaged(rng, pieces[at], pieces[:20], words)
        elif kind == 1:
            pieces[at] = rng.choice(words)
        elif kind == 2:
            pieces[at] = b""
        elif kind == 3:
            pieces.insert(at, rng.choice(pieces))
        elif kind == 4:
            other = rng.randrange(len(pieces))
            pieces[at], pieces[other] = pieces[other], pieces[at]
        elif kind == 5:
            cut = rng.randrange(len(pieces[at]) + 1)
            pieces[at:at + 1] = pieces[at][:cut], pieces[at][cut:]
        elif kind == 6:
            pieces[at] = GONE
        elif kind == 7 and len(pieces) > 1:
            del pieces[at:at + rng.choice((1, 1, 5))]
        else:
            pieces[at] += rng.choice(words)
        pieces = pieces or [b""]
    if rng.random() < 0.5:
        del pieces[rng.randrange(len(pieces)) + 1:]
    return SEPARATOR.join(pieces)


def drive(session: type[AmplifierSession | EncoderSession], data: bytes) -> None:
    """Run a session with the answers of an input."""
    pieces = iter(data.split(SEPARATOR))
    with wire_time() as time:
        session(lambda _command: next(pieces, None), time).run()
