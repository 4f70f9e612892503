"""Driver of the US Digital QSB-D: a quadrature counter that streams dated counts over USB."""

from __future__ import annotations

import time
from collections.abc import Callable

from dfm_stage.drivers import qsb_protocol as qsb
from dfm_stage.drivers.clock_map import ClockMap, Unwrap
from dfm_stage.drivers.device import EncoderSample
from dfm_stage.drivers.errors import DeviceLostError, IdentityError, ProtocolError
from dfm_stage.drivers.transport import Line, LineDevice, SerialPort

RESET_S = 1.5
REPLY_S = 0.2
INDEX_POLL_S = 0.05
_STREAM_LINE_BYTES = 26
_SETUP = (
    qsb.QUADRATURE_MODE,   # count a quadrature signal
    qsb.FREE_RUNNING,      # x4, all 32 bits, index off; from the factory it wraps modulo 500
    qsb.COUNT_UP,
    qsb.NO_THRESHOLD,      # report every sample, moved or not
)


class QsbD(LineDevice):
    """See EncoderDevice. `interval` is the stream interval in ticks of 1/512 s.

    The counter dates its samples in ticks; ClockMap brings them to system time. Samples of the
    first `settling_s` teach the map and are not passed on.
    """

    def __init__(self, port: str, interval: int = 1, settling_s: float = 0.25,
                 reset_s: float = RESET_S,
                 open_port: Callable[[str, int], SerialPort] = SerialPort) -> None:
        super().__init__(port, b"\r\n", open_port)
        self._interval = interval
        self._settling_ticks = round(settling_s * qsb.TICKS_PER_SECOND)
        self._reset_s = reset_s
        self.sample_period_s = interval / qsb.TICKS_PER_SECOND
        self.counters = {"malformed_lines": 0, "retries": 0, "resets_seen": 0}
        self._clock = ClockMap(1.0 / qsb.TICKS_PER_SECOND, _STREAM_LINE_BYTES * 10 / qsb.BAUD)
        self._ticks = Unwrap()
        self._counts = Unwrap()
        self._begin()

    def _begin(self) -> None:
        self._clock.restart()
        self._ticks.restart()
        self._counts.restart()
        self._first_tick: int | None = None
        self._last_tick = 0
        self._seeking = self._found = False
        self._index_before: bool | None = None
        self._next_poll_s = 0.0

    # Start-up

    def open(self) -> str:
        """Open the port, which resets the counter; check its identity; set it up.

        Raises
        ------
        DeviceLostError
            If there is no port, or nothing answers.
        IdentityError
            If what answers is not a quadrature counter of this family.
        """
        port = self._connect(qsb.BAUD)
        self._begin()
        any(qsb.is_banner(line.text) for line in self._received(self._reset_s))
        port.write(qsb.STOP_STREAMS)
        port.drain(0.05)
        self._lines.clear()
        self._command(qsb.SET_FORMAT)
        identity = qsb.Identity.of(self._command(qsb.READ_IDENTITY).data)
        if identity.type != "D":
            raise IdentityError(f"{self._path}: {identity} answers where a QSB-D is expected")
        for command in (*_SETUP, qsb.set_interval(self._interval), qsb.RESET_TIMESTAMP):
            self._command(command)
        status = qsb.Status(self._command(qsb.READ_STATUS).data & 0xFF)
        if not status & qsb.Status.COUNT_ENABLED:
            raise IdentityError(f"{self._path}: {identity} does not count: its status is "
                                f"{int(status):#04x}; check that the encoder has power")
        return str(identity)

    def _command(self, command: bytes) -> qsb.Reply:
        """Send and await the reply to this register, three times at most."""
        register = int(command[1:3], 16)
        for attempt in range(3):
            self.counters["retries"] += attempt > 0
            self._port.write(command)
            for reply in map(self._understood, self._received(REPLY_S)):
                if reply is not None and reply.register == register:
                    if reply.refused:
                        raise IdentityError(f"{self._path}: the device refuses "
                                            f"{command.strip().decode()}: is it a QSB-D?")
                    return reply
        raise DeviceLostError(f"{self._path}: no answer to {command.strip().decode()}; is it a "
                              "QSB-D, and at 230400 baud?")

    def _understood(self, line: Line) -> qsb.Reply | None:
        try:
            return qsb.parse_reply(line.text)
        except ProtocolError:
            if qsb.is_banner(line.text):
                self.counters["resets_seen"] += 1
                raise DeviceLostError(f"{self._path}: the counter has restarted") from None
            self.counters["malformed_lines"] += 1
            return None

    # Streaming

    def start(self) -> None:
        """Start streaming; the acknowledgement is itself a sample."""
        self._port.write(qsb.STREAM_COUNT)

    def stop(self) -> None:
        """Stop streaming."""
        self._port.write(qsb.STOP_STREAMS)
        self._port.drain(0.02, 0.2)
        self._lines.clear()

    def read(self, timeout_s: float) -> list[EncoderSample]:
        """Return the samples that came.

        Raises
        ------
        DeviceLostError
            If the port is gone, or the counter restarted (its clock went back, or its banner).
        """
        data = self._port.read(timeout_s)
        arrival_ns = time.time_ns()
        samples = []
        for line in self._lines.feed(data):
            reply = self._understood(line)
            if reply is None:
                continue
            if reply.register == qsb.Register.COUNT and reply.timestamp is not None:
                # what came behind this line in the same read was still on the wire
                sample = self._sample(reply, arrival_ns - line.after * 10**10 // qsb.BAUD)
                if sample is not None:
                    samples.append(sample)
            elif reply.register == qsb.Register.STATUS and self._seeking:
                self._on_status(qsb.Status(reply.data & 0xFF))
        if self._seeking:
            self._poll_index()
        return samples

    def _sample(self, reply: qsb.Reply, arrival_ns: int) -> EncoderSample | None:
        tick = self._ticks(reply.timestamp or 0)
        try:
            stamp_ns = self._clock(tick, arrival_ns)
        except ProtocolError as error:
            self.counters["resets_seen"] += 1
            raise DeviceLostError(f"{self._path}: {error}") from error
        counts = self._counts(reply.data)
        if self._first_tick is None:
            self._first_tick = self._last_tick = tick
        elapsed = (tick - self._last_tick) / qsb.TICKS_PER_SECOND
        self._last_tick = tick
        if elapsed <= 0.0 or tick - self._first_tick < self._settling_ticks:
            return None
        return EncoderSample((tick - self._first_tick) // self._interval & 0xFFFFFFFF, stamp_ns,
                             counts, elapsed)

    # Index

    def seek_index(self) -> None:
        """Let the next index mark set the count to zero."""
        self._found = False
        self._index_before = None
        self._seeking = True
        self._port.write(qsb.RESET_ON_INDEX)

    def _poll_index(self) -> None:
        now = time.monotonic()
        if now >= self._next_poll_s:
            self._next_poll_s = now + INDEX_POLL_S
            self._port.write(qsb.READ_STATUS)

    def _on_status(self, status: qsb.Status) -> None:
        passed = bool(status & qsb.Status.INDEX)
        if self._index_before is None:
            self._index_before = passed
        elif passed and not self._index_before:
            self._port.write(qsb.FREE_RUNNING)
            self._seeking = False
            self._found = True
        self._index_before = passed

    def index_found(self) -> bool:
        """Return whether the index was passed since seek_index."""
        return self._found


def create(port: str, **options: float) -> QsbD:
    """Return the driver; `stream_interval` in ticks of 1/512 s."""
    return QsbD(port, int(options.get("stream_interval", 1)))
