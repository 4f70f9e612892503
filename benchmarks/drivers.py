"""The serial drivers on emulated devices: rates, latency, scan error, time to zero current."""

from __future__ import annotations

import math
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import Figure
from benchmarks.zero_current import StandsStillError, moving_stage
from dfm_stage.control import Pid, PidGains
from dfm_stage.drivers.amplifiers.copley_ascii import CopleyAscii
from dfm_stage.drivers.emulators.copley_ascii import CopleyAsciiEmulator
from dfm_stage.drivers.emulators.pty_port import PtyPort
from dfm_stage.drivers.emulators.qsb_d import QsbDEmulator
from dfm_stage.drivers.encoders.qsb_d import QsbD
from dfm_stage.drivers.qsb_protocol import BAUD, TICKS_PER_SECOND
from dfm_stage.drivers.threads import SigmaDelta
from dfm_stage.harness import HarnessError, RunResult
from dfm_stage.harness.emulated import EmulatedGraph, hardware_parameters
from dfm_stage.model import Plant, load_model
from dfm_stage.recording import read_bag
from dfm_stage.trajectory import make_reference

STALE_MS, ALLOWANCE_MS = 20.0, 10.0
LINE_BYTES = 26
SET_BYTES, OK_BYTES, AMPLIFIER_BAUD = len(b"s r0x02 -20\r"), len(b"ok\r"), 115200
RASTER = {"kind": "raster", "line_length_m": 0.002, "line_time_s": 0.8, "turnaround_s": 0.2}
SETTLING_S = 2.0
ATTEMPTS = 4
STUCK_AT_MOST = 5
# the scan is about rates and error; a busy machine holds up even an emulator
PATIENT = {"encoder_driver": {"encoder_timeout_s": 1.0},
           "amplifier_driver": {"stale_timeout_s": 0.5, "measurement_timeout_s": 0.5}}
FAILURES = {"killed_controller": "drivers.zero_current_p99_ms",
            "stalled_controller": "drivers.zero_current_stalled_p99_ms",
            "nan_command": "drivers.zero_current_nan_p99_ms",
            "pulled_encoder": "drivers.zero_current_encoder_p99_ms"}
HOW = {"killed_controller": "SIGKILL to the controller", "stalled_controller": "SIGSTOP to it",
       "nan_command": "a NaN command", "pulled_encoder": "the encoder unplugged"}


def figures(quick: bool = False) -> list[Figure]:
    """Measure: each failure 100 times (quick: 10), a scan of 20 s (6 s), rates of 10 s (2 s)."""
    return [*_zero_current(10 if quick else 100), *_rates(2.0 if quick else 10.0),
            *_scan(6.0 if quick else 20.0)]


def _zero_current(count: int) -> list[Figure]:
    return [each for kind, key in FAILURES.items() for each in _failure(kind, key, count)]


def _failure(kind: str, key: str, count: int) -> list[Figure]:
    times: list[float] = []
    left_out = deaf = stuck = 0
    while len(times) < count:
        with moving_stage() as rig:
            rig.open_publisher()
            try:
                while len(times) < count and len(rig.others) <= count:
                    taken = rig.measure(kind)
                    if not math.isnan(taken):
                        times.append(taken)
            except StandsStillError:
                stuck += 1
                if stuck > STUCK_AT_MOST:
                    raise
        left_out, deaf = left_out + len(rig.others), deaf + rig.deaf
        if left_out > count:
            break
    p99 = float(np.percentile(times, 99, method="higher"))
    return [Figure(
        key.replace("p99", "median"), float(np.median(times)), "ms",
        how=f"{HOW[kind]}, to zero current; of the same {len(times)} times"), Figure(
        key, p99, "ms", STALE_MS + ALLOWANCE_MS, "stale time-out", STALE_MS, p99 / STALE_MS,
        f"{HOW[kind]}, to zero current in the emulated drive at 115200 baud, separate processes; "
        f"{len(times)} times, worst {max(times):.1f}; {left_out} "
        f"left out, in which the driver had cut the output for another cause before; between the "
        f"trials {deaf} times a started controller heard nobody and was started again, {stuck} "
        "times all nodes", bar_kind="at most")]


class _Runner:
    """A port that a thread runs."""

    def __init__(self, emulator: Any, link: Path) -> None:
        self._port = PtyPort(emulator, link)
        self._stop = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop:
            self._port.step([], 0.01)

    def close(self) -> None:
        self._stop = True
        self._thread.join()
        self._port.close()


def _rates(duration_s: float) -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "port"
        runner = _Runner(QsbDEmulator(), link)
        counter = QsbD(str(link))
        counter.open()
        counter.start()
        begin, samples = time.monotonic(), 0
        while not samples:
            samples = len(counter.read(0.1))
            begin = time.monotonic()
        while time.monotonic() - begin < duration_s:
            samples += len(counter.read(0.1))
        encoder_hz = samples / (time.monotonic() - begin)
        counter.close()
        runner.close()
        runner = _Runner(CopleyAsciiEmulator(), link)
        drive = CopleyAscii(str(link), peak_limit_a=2.0, continuous_limit_a=1.0)
        drive.open()
        drive.arm()
        begin, sets = time.monotonic(), 0
        while time.monotonic() - begin < duration_s:
            drive.set_counts(-20)
            sets += 1
        amplifier_hz = sets / (time.monotonic() - begin)
        drive.disarm()
        drive.close()
        runner.close()
    encoder_wire = BAUD / 10 / LINE_BYTES
    amplifier_wire = AMPLIFIER_BAUD / 10 / (SET_BYTES + OK_BYTES)
    return [
        Figure("drivers.encoder_hz", encoder_hz, "Hz", 0.99 * TICKS_PER_SECOND,
               "wire: 26 bytes at 230400 baud", encoder_wire, encoder_hz / encoder_wire,
               f"samples of the counter, whose fastest stream is {TICKS_PER_SECOND} Hz, through "
               f"the real driver on a pseudo-terminal, {duration_s:g} s; "
               f"{counter.counters['malformed_lines']} malformed", bar_kind="at least"),
        Figure("drivers.amplifier_hz", amplifier_hz, "Hz", float(TICKS_PER_SECOND),
               "wire: 12 + 3 bytes at 115200 baud", amplifier_wire,
               amplifier_hz / amplifier_wire,
               f"current set and acknowledged, one after the other, {duration_s:g} s; the bar is "
               "the counter's rate", bar_kind="at least"),
    ]


def _scan(duration_s: float) -> list[Figure]:
    experiment = {"name": "scan", "mode": "pid", "duration_s": duration_s,
                  "axes": {"x": {"reference": RASTER}}}
    cuts: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        while True:
            bag = Path(folder) / f"bag{len(cuts)}"
            with EmulatedGraph(bag=bag, parameters=PATIENT) as graph:
                graph.bring_to_life()
                result = graph.run(experiment)["x"]
                cut = graph.cut()
                graph.stop_recording()
            if not cut:
                break
            cuts.append(cut)
            if len(cuts) == ATTEMPTS:
                raise HarnessError(f"no scan out of {ATTEMPTS} came to its end: {cuts}")
        found = _evaluate(bag, result)
    rms = {name: _simulated(name, duration_s) for name in ("none", "rounded", "shaped")}
    seconds = f"raster of 2 mm under PID at {TICKS_PER_SECOND} Hz, {duration_s:g} s"
    return [
        Figure("drivers.scan_error_um", found["error"], "um", None,
               "the same loop simulated, 10 mA steps and nothing else", rms["shaped"],
               found["error"] / rms["shaped"],
               f"RMS tracking error through both emulators; {seconds}, {len(cuts)} before it "
               "cut short; simulated without steps "
               f"{rms['none']:.2f}, rounded {rms['rounded']:.2f}, shaped {rms['shaped']:.2f} um"),
        Figure("drivers.step_cost_um", _cost(duration_s, "shaped"), "um", None,
               "rounded instead of shaped", _cost(duration_s, "rounded"), None,
               "RMS difference that 10 mA steps make to the simulated motion, by themselves"),
        Figure("drivers.scan_output_hz", found["output_hz"], "Hz", None, "commands",
               float(TICKS_PER_SECOND), found["output_hz"] / TICKS_PER_SECOND,
               f"currents acknowledged by the drive during the scan; {seconds}"),
        Figure("drivers.latency_ms", found["latency"], "ms", None, "wire alone",
               1e3 * 10 * (LINE_BYTES / BAUD + (SET_BYTES + OK_BYTES) / AMPLIFIER_BAUD), None,
               f"sample of the scale to current acknowledged, median; {seconds}"),
        Figure("drivers.latency_p99_ms", found["latency_p99"], "ms", how="the same, 99 % within"),
        Figure("drivers.scan_samples_lost", found["lost"], "samples", None, None, None, None,
               f"gaps in the numbers of the measurements; {seconds}"),
    ]


def _evaluate(bag: Path, result: RunResult) -> dict[str, float]:
    topics = read_bag(bag)
    measurement, reference = (topics[f"/stage/x/{name}"] for name in ("measurement", "reference"))
    first = result.first_seq + round(SETTLING_S * TICKS_PER_SECOND)
    wanted = dict(zip(reference["seq"].tolist(), reference["position"].tolist(), strict=True))
    error = np.array([position - wanted[seq] for seq, position in zip(
        measurement["seq"].tolist(), measurement["position"].tolist(), strict=True)
        if first <= seq <= result.last_seq and seq in wanted])
    stamps = dict(zip(measurement["seq"].tolist(), measurement["header.stamp"].tolist(),
                      strict=True))
    amplifier = topics["/stage/x/amplifier"]
    inside = [(seq, stamp) for seq, stamp, enabled in zip(
        amplifier["measurement_seq"].tolist(), amplifier["header.stamp"].tolist(),
        amplifier["enabled"].tolist(), strict=True)
        if enabled and first <= seq <= result.last_seq and seq in stamps]
    latency = np.array([(stamp - stamps[seq]) * 1e-6 for seq, stamp in inside])
    span_s = (inside[-1][1] - inside[0][1]) * 1e-9
    gaps = np.diff(np.sort(measurement["seq"]).astype(np.int64)) - 1
    return {"error": 1e6 * float(np.sqrt(np.mean(error**2))),
            "latency": float(np.median(latency)), "latency_p99": float(np.percentile(latency, 99)),
            "output_hz": len(inside) / span_s, "lost": float(np.sum(gaps))}


def _run(steps: str, duration_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same law on the same plant, sample by sample, without wires: motion and error."""
    period_s = 1.0 / TICKS_PER_SECOND
    plant = Plant(replace(load_model("current_stage"), sample_period=period_s))
    given = hardware_parameters(Path(), Path())["controller"]
    pid = Pid(PidGains(**given), period_s)
    wanted = make_reference(RASTER, sample_period_s=period_s, duration_s=duration_s, seed=0)
    quantise = SigmaDelta(CopleyAscii.count_a, shaped=steps == "shaped")
    position = np.empty(len(wanted.position))
    for index, (place, speed, acceleration) in enumerate(zip(
            wanted.position.tolist(), wanted.velocity.tolist(), wanted.acceleration.tolist(),
            strict=True)):
        measured = plant.sample().reading_m
        position[index] = measured
        current = pid.step(place, measured, speed, acceleration, period_s)
        plant.advance(current if steps == "none" else quantise(current) * CopleyAscii.count_a)
    first = round(SETTLING_S * TICKS_PER_SECOND)
    return position[first:], (position - wanted.position)[first:]


def _simulated(steps: str, duration_s: float) -> float:
    return 1e6 * float(np.sqrt(np.mean(_run(steps, duration_s)[1] ** 2)))


def _cost(duration_s: float, steps: str) -> float:
    without, with_steps = _run("none", duration_s)[0], _run(steps, duration_s)[0]
    return 1e6 * float(np.sqrt(np.mean((with_steps - without) ** 2)))
