"""Emulated devices on pseudo-terminals in this process."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dfm_stage.drivers.emulators.pty_port import Emulator, PtyPort

sys.path.insert(0, str(Path(__file__).parent))


class RunningPort:
    """A PtyPort that a thread runs; `inject` is done between its steps."""

    def __init__(self, emulator: Emulator, link: Path) -> None:
        self.emulator = emulator
        self.path = str(link)
        self._port = PtyPort(emulator, link)
        self._asked: list[tuple[str, threading.Event]] = []
        self._stop = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def inject(self, text: str) -> None:
        done = threading.Event()
        self._asked.append((text, done))
        assert done.wait(5.0)

    def _run(self) -> None:
        while not self._stop:
            while self._asked:
                text, done = self._asked.pop(0)
                self._port.inject(text)
                done.set()
            self._port.step([], 0.005)

    def close(self) -> None:
        self._stop = True
        self._thread.join(5.0)
        self._port.close()


@pytest.fixture
def plug_in(tmp_path: Path) -> Iterator[Callable[[Emulator], RunningPort]]:
    """Give an emulator a pseudo-terminal and run it."""
    ports: list[RunningPort] = []

    def make(emulator: Emulator) -> RunningPort:
        ports.append(RunningPort(emulator, tmp_path / f"port{len(ports)}"))
        return ports[-1]

    yield make
    for port in ports:
        port.close()
