"""emulate: a serial device that is not there, on a pseudo-terminal, byte for byte.

Alone it shows a scale at rest (or swinging) and a coil that takes what it gets; with --stage it
stands between a running sim_plant and the drivers. Faults are typed as lines on its input.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

from dfm_stage.cli.colour import paint
from dfm_stage.cli.command import command_parser
from dfm_stage.drivers.copley_protocol import Parameter
from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
from dfm_stage.drivers.emulators.pty_port import Emulator, PtyPort
from dfm_stage.drivers.emulators.qsb_d import QsbDEmulator
from dfm_stage.errors import DfmError

DEVICES = ("qsb_d", "copley_ascii")
HELP = """faults, typed as lines:
  silence S        hears and says nothing for S seconds
  garbage N        sends N random bytes
  partial          the next message breaks off half-way
  disconnect S     unplugged for S seconds
  reset            restarts as after a loss of power
  fault BITS       copley_ascii: latches faults (bits of 0xa4, such as 0x4, a short circuit)
  enable on|off    copley_ascii: the enable input
  quit             ends

examples:
  ./run emulate qsb_d --amplitude 1000 --frequency 2
  ./run emulate copley_ascii --stage /stage/x --log out/current.txt
"""


class EmulateError(DfmError):
    """The emulator cannot be set up."""


class OutputLog:
    """The output current over time, as lines `steady-clock-ns amperes on|off`."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def __call__(self, now: float, current_a: float, enabled: bool) -> None:
        """Write one change."""
        self._file.write(f"{round(now * 1e9)} {current_a:.6f} {'on' if enabled else 'off'}\n")
        self._file.flush()


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("emulate", (__doc__ or "").partition("\n")[0], HELP)
    parser.add_argument("device", choices=DEVICES)
    parser.add_argument("--link", type=Path, metavar="PATH",
                        help="where the port is to be found (default /tmp/dfm_<device>)")
    parser.add_argument("--stage", metavar="NAMESPACE",
                        help="connect to the sim_plant of this axis, such as /stage/x")
    parser.add_argument("--sample-period", type=float, default=1e-3, metavar="S",
                        help="of the simulated model (default 0.001)")
    parser.add_argument("--resolution", type=float, default=0.0, metavar="M",
                        help="length of a count of the scale (default: the simulated one's)")
    parser.add_argument("--amplitude", type=float, default=0.0, metavar="COUNTS",
                        help="without a stage: the scale swings by this much")
    parser.add_argument("--frequency", type=float, default=1.0, metavar="HZ",
                        help="without a stage: and this fast")
    parser.add_argument("--index-at", type=int, metavar="COUNTS",
                        help="qsb_d: where the index mark is")
    parser.add_argument("--drift", type=float, default=0.0,
                        help="qsb_d: how slow its clock is, relative (1e-4 = 0.1 ms per s)")
    parser.add_argument("--flash", action="append", default=[], metavar="0xNN=VALUE",
                        help="copley_ascii: a parameter as stored in the drive")
    parser.add_argument("--log", type=Path, metavar="FILE",
                        help="copley_ascii: write every change of the output current")
    parser.add_argument("--seed", type=int, default=0, help="fixes what garbage is")
    return parser


def _flash(items: Sequence[str]) -> dict[int, int]:
    out = {}
    for item in items:
        try:
            name, value = item.split("=")
            out[Parameter(int(name, 0))] = int(value, 0)
        except ValueError as error:
            raise EmulateError(f"--flash {item}: write it as 0x24=1 ({error})") from error
    return {int(key): value for key, value in out.items()}


def _swing(amplitude: float, frequency_hz: float) -> Callable[[float], int]:
    return lambda now: round(amplitude * math.sin(2.0 * math.pi * frequency_hz * now))


def _make(options: argparse.Namespace, link: Any, log: OutputLog | None) -> Emulator:
    if options.device == "qsb_d":
        scale = link.counts if link is not None else _swing(options.amplitude, options.frequency)
        return QsbDEmulator(scale, index_at=options.index_at, drift=options.drift)

    def output(now: float, current_a: float, enabled: bool) -> None:
        if link is not None:
            link.output(now, current_a, enabled)
        if log is not None:
            log(now, current_a, enabled)

    return CopleyAsciiEmulator(output, _flash(options.flash))


def _connect(options: argparse.Namespace) -> Any:
    if not options.stage:
        return None
    from dfm_stage.harness.emulated import StageLink

    link = StageLink(options.stage, f"{options.device}_emulator", options.sample_period,
                     options.resolution)
    if options.device == "qsb_d":
        link.read_scale()
    else:
        link.drive_coil()
    link.start()
    return link


class _Input:
    """Lines of a file descriptor that must not block."""

    def __init__(self, handle: int) -> None:
        self.handles = [handle]
        self._rest = b""

    def lines(self) -> list[str]:
        """Return the lines that have come; at the end of input nothing is listened to."""
        data = os.read(self.handles[0], 4096)
        if not data:
            self.handles.clear()
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines]


def _run(port: PtyPort, stop: list[int]) -> None:
    typed = _Input(sys.stdin.fileno())
    while not stop:
        if not port.step(typed.handles, 0.05):
            continue
        for line in typed.lines():
            if line == "quit":
                return
            if not line:
                continue
            try:
                print(f"{time.monotonic_ns()} {port.inject(line)}", flush=True)
            except DfmError as error:
                print(f"emulate: {error}", file=sys.stderr, flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """0 after quit or a signal, 2 when it cannot be set up."""
    options = _parser().parse_args(argv)
    stop: list[int] = []
    before = {number: signal.signal(number, lambda signum, _frame: stop.append(signum))
              for number in (signal.SIGINT, signal.SIGTERM)}
    link_path = options.link or Path(f"/tmp/dfm_{options.device}")  # noqa: S108 asked for by name
    log_file = options.log.open("w", encoding="utf-8") if options.log else None
    port = stage = None
    try:
        log = OutputLog(log_file) if log_file else None
        stage = _connect(options)
        try:
            port = PtyPort(_make(options, stage, log), link_path, options.seed)
        except OSError as error:
            raise EmulateError(f"cannot put a port at {link_path}: {error.strerror}: name "
                               "another --link") from error
        print(f"{options.device} at {link_path}", flush=True)
        _run(port, stop)
    except DfmError as error:
        print(f"{paint('error:', 'bad', sys.stderr)} {error}", file=sys.stderr)
        return 2
    finally:
        if port is not None:
            port.close()
        if stage is not None:
            stage.close()
        if log_file is not None:
            log_file.close()
        for number, handler in before.items():
            signal.signal(number, handler)
    return 130 if signal.SIGINT in stop else 0


if __name__ == "__main__":
    sys.exit(main())
