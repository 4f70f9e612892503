"""Coverage-guided fuzzing of the drivers; not part of the test suite.

    pip install atheris                        # CPython 3.11 to 3.13, Linux
    PYTHONPATH=. python test/fuzz/fuzz_drivers.py qsb_d -max_total_time=300
    PYTHONPATH=. python test/fuzz/fuzz_drivers.py copley_ascii -max_total_time=300
    PYTHONPATH=. python test/fuzz/fuzz_drivers.py emulators -max_total_time=300

The input is cut into what the device sends, read by read. Whatever that is, a driver may raise
nothing but DriverError, and the only output it may ever set by itself is zero.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["dfm_stage.drivers"]):
    from dfm_stage.drivers.amplifiers import copley_ascii
    from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
    from dfm_stage.drivers.emulators.qsb_d import QsbDEmulator
    from dfm_stage.drivers.encoders import qsb_d
    from dfm_stage.drivers.errors import DeviceLostError, DriverError

copley_ascii.copley.BAUD_SETTLING_S = 0.0
copley_ascii.ENABLE_S = 0.0
copley_ascii._LINE_BITS = 0
qsb_d.REPLY_S = 1e-5
qsb_d.INDEX_POLL_S = 0.0
SETS_CURRENT = b"s r0x02"
ZERO = b"s r0x02 0\r"


class Port:
    """Answers every read with the next piece of the input; at its end the device is gone."""

    def __init__(self, pieces: list[bytes]) -> None:
        self.baud = 115200
        self.sent: list[bytes] = []
        self._pieces = pieces

    def read(self, _timeout_s: float) -> bytes:
        if not self._pieces:
            raise DeviceLostError("end of input")
        return self._pieces.pop()

    def drain(self, _quiet_s: float, _limit_s: float = 0.0) -> bytes:
        return self.read(0.0)

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def set_baud(self, baud: int) -> None:
        self.baud = baud

    def send_break(self, _duration_s: float) -> None:
        self.sent.append(b"<break>")

    def close(self) -> None:
        self._pieces = []


def pieces_of(data: bytes) -> list[bytes]:
    """Cut at every 0xA7; reversed, so that `pop` gives them in order."""
    return data.split(b"\xa7")[::-1]


def fuzz_qsb_d(data: bytes) -> None:
    device = qsb_d.QsbD("port", settling_s=0.0, reset_s=1e-5,
                        open_port=lambda _path, _baud: Port(pieces_of(data)))
    try:
        device.open()
        device.start()
        device.seek_index()
        while True:
            for sample in device.read(0.0):
                assert sample.elapsed_s > 0.0
                assert 0 <= sample.seq < 2**32
    except DriverError:
        return


def fuzz_copley_ascii(data: bytes) -> None:
    ports: list[Port] = []

    def open_port(_path: str, _baud: int) -> Port:
        ports.append(Port(pieces_of(data)))
        return ports[-1]

    device = copley_ascii.CopleyAscii("port", peak_limit_a=2.0, continuous_limit_a=1.0,
                                      reply_s=1e-5, open_port=open_port)
    for action in (device.open, device.arm, *[device.status] * 40, device.clear_faults,
                   device.disarm):
        try:
            action()
        except DriverError:
            continue
    for port in ports:
        assert all(each == ZERO for each in port.sent if each.startswith(SETS_CURRENT))


def fuzz_emulators(data: bytes) -> None:
    counter, drive = QsbDEmulator(lambda now: int(now * 1e4), index_at=50), CopleyAsciiEmulator()
    for index, piece in enumerate(reversed(pieces_of(data))):
        for emulator in (counter, drive):
            emulator.receive(piece, index * 0.01)
            emulator.advance(index * 0.01)


TARGETS = {"qsb_d": fuzz_qsb_d, "copley_ascii": fuzz_copley_ascii, "emulators": fuzz_emulators}


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        sys.exit(f"usage: fuzz_drivers.py {'|'.join(TARGETS)} [libFuzzer options]")
    atheris.Setup([sys.argv[0], *sys.argv[2:]], TARGETS[sys.argv[1]])
    atheris.Fuzz()
