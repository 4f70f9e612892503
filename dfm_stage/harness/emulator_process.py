"""An emulated device as a process: a pseudo-terminal on one side, on the other a coil and a scale.

Alone it shows a scale at rest (or swinging) and a coil that takes what it gets; with --stage it
stands between a running sim_plant and the drivers. Faults are typed as lines on its input.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

from dfm_stage.drivers.copley_protocol import Parameter
from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
from dfm_stage.drivers.emulators.pty_port import Emulator, PtyPort
from dfm_stage.drivers.emulators.qsb_d import QsbDEmulator
from dfm_stage.errors import DfmError

DEVICES = ("qsb_d", "copley_ascii")
PLANT_S = 5.0
"""How long sim_plant is waited for before the port is there; an announcement takes 0.5 s."""
OPTIONS: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = (
    (("device",), {"choices": DEVICES}),
    (("--link",), {"type": Path, "metavar": "PATH",
                   "help": "where the port is to be found (default /tmp/dfm_<device>)"}),
    (("--stage",), {"metavar": "NAMESPACE",
                    "help": "connect to the sim_plant of this axis, such as /stage/x"}),
    (("--sample-period",), {"type": float, "default": 1e-3, "metavar": "S",
                            "help": "of the simulated model (default 0.001)"}),
    (("--resolution",), {"type": float, "default": 0.0, "metavar": "M",
                         "help": "length of a count of the scale (default: the simulated one's)"}),
    (("--amplitude",), {"type": float, "default": 0.0, "metavar": "COUNTS",
                        "help": "without a stage: the scale swings by this much"}),
    (("--frequency",), {"type": float, "default": 1.0, "metavar": "HZ",
                        "help": "without a stage: and this fast"}),
    (("--index-at",), {"type": int, "metavar": "COUNTS",
                       "help": "qsb_d: where the index mark is"}),
    (("--drift",), {"type": float, "default": 0.0,
                    "help": "qsb_d: how slow its clock is, relative (1e-4 = 0.1 ms per s)"}),
    (("--flash",), {"action": "append", "default": [], "metavar": "0xNN=VALUE",
                    "help": "copley_ascii: a parameter as stored in the drive"}),
    (("--log",), {"type": Path, "metavar": "FILE",
                  "help": "copley_ascii: write every change of the output current"}),
    (("--seed",), {"type": int, "default": 0, "help": "fixes what garbage is"}),
)
"""What the process is started with, as `ArgumentParser.add_argument` takes it."""


class EmulateError(DfmError):
    """The emulator cannot be set up."""


def _flash(items: Sequence[str]) -> dict[int, int]:
    out = {}
    for item in items:
        try:
            name, value = item.split("=")
            out[int(Parameter(int(name, 0)))] = int(value, 0)
        except ValueError as error:
            raise EmulateError(f"--flash {item}: write it as 0x24=1 ({error})") from error
    return out


def _make(options: argparse.Namespace, link: Any, log: TextIO | None) -> Emulator:
    if options.device == "qsb_d":
        turn = 2.0 * math.pi * options.frequency
        return QsbDEmulator(link.counts if link is not None else (
            lambda now: round(options.amplitude * math.sin(turn * now))),
            index_at=options.index_at, drift=options.drift)

    def output(now: float, current_a: float, enabled: bool) -> None:
        """Pass the output current on; the log has lines `steady-clock-ns amperes on|off`."""
        if link is not None:
            link.output(now, current_a, enabled)
        if log is not None:
            print(f"{round(now * 1e9)} {current_a:.6f} {'on' if enabled else 'off'}", file=log,
                  flush=True)

    return CopleyAsciiEmulator(output, _flash(options.flash))


def _connect(options: argparse.Namespace, stop: Sequence[int]) -> Any:
    if not options.stage:
        return None
    from dfm_stage.harness.emulator_link import StageLink

    link = StageLink(options.stage, f"{options.device}_emulator", options.sample_period,
                     options.resolution)
    if options.device == "qsb_d":
        link.read_scale()
    else:
        link.drive_coil()
    link.start()
    if not link.met(PLANT_S, stop) and not stop:
        print(f"emulate: no sim_plant heard in {options.stage} within {PLANT_S:g} s; it is waited "
              "for", file=sys.stderr, flush=True)
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


def _serve(port: PtyPort, stop: list[int]) -> None:
    typed = _Input(sys.stdin.fileno())
    while not stop:
        if not port.step(typed.handles, 0.05):
            continue
        for line in filter(None, typed.lines()):
            if line == "quit":
                return
            try:
                print(f"{time.monotonic_ns()} {port.inject(line)}", flush=True)
            except DfmError as error:
                print(f"emulate: {error}", file=sys.stderr, flush=True)


def run(options: argparse.Namespace) -> int:
    """Emulate the device that the options name until `quit` or a signal.

    Returns
    -------
    int
        Exit code: 0, or 130 after SIGINT.

    Raises
    ------
    DfmError
        If it cannot be set up.
    """
    stop: list[int] = []
    link_path = options.link or Path(f"/tmp/dfm_{options.device}")  # noqa: S108 asked for by name
    with contextlib.ExitStack() as cleanup:
        for number in (signal.SIGINT, signal.SIGTERM):
            cleanup.callback(signal.signal, number, signal.signal(
                number, lambda signum, _frame: stop.append(signum)))
        log = cleanup.enter_context(
            options.log.open("w", encoding="utf-8")) if options.log else None
        stage = _connect(options, stop)
        if stage is not None:
            cleanup.callback(stage.close)
        try:
            port = PtyPort(_make(options, stage, log), link_path, options.seed)
        except OSError as error:
            raise EmulateError(f"cannot put a port at {link_path}: {error.strerror}: name "
                               "another --link") from error
        cleanup.callback(port.close)
        print(f"{options.device} at {link_path}", flush=True)
        _serve(port, stop)
    return 130 if signal.SIGINT in stop else 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the process for whoever started it; 2 with one line when it cannot be set up."""
    parser = argparse.ArgumentParser(description=__doc__)
    for flags, how in OPTIONS:
        parser.add_argument(*flags, **how)
    try:
        return run(parser.parse_args(argv))
    except DfmError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
