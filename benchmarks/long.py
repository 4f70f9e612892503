"""An hour at 1 kHz, diagnosed from the file: is the answer right, how long, how much memory.

The stage is `paper_stage`, with something missing in its model or nothing. Bursts of 20 s of a
multisine of 1 to 70 Hz, of six amplitudes in turn, stand 40 s apart; in between the input is zero.
The records come from the library's own simulator. `diagnose` runs as a command, with reading,
writing and its page.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import Figure
from benchmarks.synthetic_bag import START_NS, TOPICS, layout, schema_text
from dfm_stage.model import Simulator, load_model
from dfm_stage.recording import AxisRecord, BagWriter, Provenance, QosProfile, Record, write_csv
from dfm_stage.recording.message_definitions import parse_schema

Array = NDArray[np.float64]

HOUR_S, QUICK_S = 3600.0, 400.0
PERIOD_S = 1e-3
EVERY_S, BURST_S, CYCLE_S = 60.0, 20.0, 8.0
AMPLITUDES_V = (0.1, 0.8, 0.3, 0.5, 0.05, 1.0)
MISSING: Mapping[str, Mapping[str, float]] = {
    "cubic_stiffness": {"k3": 3e6}, "coulomb_friction": {"force": 0.02}, "": {}}
SECONDS_BAR, GIB_BAR = 300.0, 4.0
TOPICS_READ = ("measurement", "command", "amplifier", "reference", "excitation", "plant")


def drive(seconds: float, seed: int = 1) -> Array:
    """Return the input (N,) in V."""
    rng = np.random.default_rng(seed)
    out = np.zeros(round(seconds / PERIOD_S))
    cycle, burst = round(CYCLE_S / PERIOD_S), round(BURST_S / PERIOD_S)
    lines = np.arange(round(CYCLE_S), round(70.0 * CYCLE_S))
    for k, start in enumerate(range(10_000, out.size, round(EVERY_S / PERIOD_S))):
        spectrum = np.zeros(cycle // 2 + 1, dtype=complex)
        spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
        wave = np.fft.irfft(spectrum, cycle)
        wave *= AMPLITUDES_V[k % len(AMPLITUDES_V)] / np.max(np.abs(wave))
        out[start:start + burst] = np.resize(wave, burst)[:out.size - start]
    return out


def record(effect: str, seconds: float) -> tuple[Array, Array]:
    """Return input (V) and reading (m) of the stage with an effect, or with none."""
    stage = load_model("paper_stage")
    if effect:
        stage = stage.with_effect(effect, dict(MISSING[effect]))
    volts = drive(seconds)
    return volts, Simulator(stage).run(volts).measured(1)


def write_bag(folder: Path, volts: Array, reading: Array) -> None:
    """Write input and reading as one axis of the graph leaves them."""
    stamps = START_NS + np.round(np.arange(volts.size) * PERIOD_S * 1e9).astype(np.int64)
    with BagWriter(folder, backlog_bytes=1 << 32) as bag:
        topics = []
        for name in TOPICS_READ:
            kind = f"dfm_interfaces/msg/{TOPICS[name]}"
            text = schema_text(TOPICS[name])
            topics.append((bag.add_topic(f"/stage/x/{name}", kind, [QosProfile()],
                                         "RIHS01_" + "0" * 64, text),
                           layout(parse_schema(text, kind), kind, b"x")))
        for start in range(0, volts.size, 5000):
            part = slice(start, start + 5000)
            values = {"seq": np.arange(volts.size)[part], "voltage": volts[part],
                      "position": reading[part], "enabled": True, "header.frame_id#": 2,
                      "header.frame_id": b"x"}
            values["measurement_seq"] = values["seq"]
            for place in ("header.stamp", "measurement_stamp"):
                values[f"{place}.sec"], values[f"{place}.nanosec"] = divmod(stamps[part], 10**9)
            for number, dtype in topics:
                _write(bag, number, dtype, values, stamps[part])


def _write(bag: BagWriter, number: int, dtype: np.dtype[np.void], values: Mapping[str, object],
           stamps: NDArray[np.int64]) -> None:
    rows = np.zeros(stamps.size, dtype)
    rows.view(np.uint8).reshape(stamps.size, -1)[:, 1] = 1
    for name in dtype.names or ():
        if name in values:
            rows[name] = values[name]
    data, size = rows.tobytes(), dtype.itemsize
    for k, now in enumerate(stamps.tolist()):
        bag.write(number, data[k * size:(k + 1) * size], now, now, k)


def diagnosed(file: Path, out: Path) -> tuple[float, float, float]:
    """Return wall time (s), processor time (s) and peak memory (GiB) of `diagnose` on a file."""
    begun = time.monotonic()
    child = subprocess.Popen(
        [sys.executable, "-m", "dfm_stage", "diagnose", str(file), "--model", "paper_stage",
         "--out", str(out)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise subprocess.CalledProcessError(child.returncode, "diagnose")
    return time.monotonic() - begun, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20


def is_right(effect: str, out: Path) -> bool:
    """Whether the answer in a folder is the effect, with its size in the interval, or none."""
    found = json.loads((out / "diagnosis.json").read_text("utf-8"))
    if [each["name"] for each in found["effects"]] != [effect] * bool(effect):
        return False
    if not effect:
        return bool(found["verdict"] == "none")
    parameters = found["effects"][0]["parameters"]
    return all(parameters[name]["ci95"][0] <= size <= parameters[name]["ci95"][1]
               for name, size in MISSING[effect].items())


def figures(quick: bool = False) -> list[Figure]:
    """Diagnose three records as CSV, and one of them as a bag."""
    seconds = QUICK_S if quick else HOUR_S
    found = []
    with tempfile.TemporaryDirectory(prefix="dfm_long_") as folder:
        for number, effect in enumerate(MISSING):
            volts, reading = record(effect, seconds)
            file = Path(folder) / "run.csv"
            write_csv(Record(np.asarray(PERIOD_S * np.arange(volts.size), np.float64), PERIOD_S,
                             {"x": AxisRecord(volts, reading)}, Provenance("run", "csv")), file)
            found += _figures(effect, "csv", file, seconds)
            if number == 0:
                bag = Path(folder) / "bag"
                write_bag(bag, volts, reading)
                found += _figures(effect, "bag", bag, seconds)
    return found


def _figures(effect: str, kind: str, file: Path, seconds: float) -> list[Figure]:
    out = file.parent / "out"
    wall, processor, gib = diagnosed(file, out)
    key = f"long.{effect or 'nothing'}_{kind}"
    size = sum(f.stat().st_size for f in (file.glob("*.mcap") if file.is_dir() else [file]))
    how = f"{seconds / PERIOD_S:.0f} samples, {size / 2**20:.0f} MiB"
    return [
        Figure(f"{key}.right", float(is_right(effect, out)), "1 = yes", 1.0, how=how,
               bar_kind="at least"),
        Figure(f"{key}.seconds", wall, "s", SECONDS_BAR, bar_kind="at most",
               how=how),
        Figure(f"{key}.processor_s", processor, "s", how=how),
        Figure(f"{key}.peak_gib", gib, "GiB", GIB_BAR, how=how, bar_kind="at most")]


if __name__ == "__main__":
    for each in figures():
        print(f"{each.key:40s} {each.value:9.3f} {each.unit} met {each.met}  {each.how}")
