"""One graph on three hosts: plant and drivers, controller, recorder; slow, lossy and cut links."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.figure import Figure
from benchmarks.hosts import Hosts
from dfm_stage.errors import DfmError
from dfm_stage.recording import Bag, read_bag

HOSTS = ("plant", "control", "store")
STALE_S = 0.1
UP_S, AFTER_CUT_S = 120.0, 3.0
GENERATOR = ("reference.kind:=raster", "reference.line_length_m:=1.0e-3", "duration_s:=4.0",
             "repeat:=true", "wait_for_recorder:=true")
CONTROLLER = ("kp:=600.0", "ki:=4000.0", "kd:=30.0", "output_limit_v:=2.0",
              "feedforward_position:=600.7", "feedforward_velocity:=1.705",
              "feedforward_acceleration:=1.0")
NODES = {"plant": {"encoder_driver": (), "amplifier_driver": (f"stale_timeout_s:={STALE_S}",),
                   "sim_plant": ("model:=paper_stage",)},
         "control": {"controller": CONTROLLER, "trajectory_generator": GENERATOR}}
REARM = """
import rclpy
from std_srvs.srv import Trigger
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

rclpy.init()
node = rclpy.create_node("operator", namespace="/stage/x")
for kind, name, request in (
        (SetParameters, "controller/set_parameters", SetParameters.Request(
            parameters=[Parameter("mode", value="pid").to_parameter_msg()])),
        (Trigger, "amplifier_driver/clear", Trigger.Request()),
        (Trigger, "amplifier_driver/arm", Trigger.Request()),
        (Trigger, "trajectory_generator/start", Trigger.Request())):
    client = node.create_client(kind, name)
    if not client.wait_for_service(20.0):
        raise SystemExit(f"{name} is not there")
    answer = client.call_async(request)
    rclpy.spin_until_future_complete(node, answer, timeout_sec=20.0)
    if not answer.done():
        raise SystemExit(f"{name} does not answer")
"""
TOPICS = ("measurement", "reference", "command", "amplifier", "plant")


@dataclass(frozen=True)
class Phase:
    """A state of the control host's cable, both ways, and when it held (ns since the epoch)."""

    name: str
    delay_ms: float
    loss_percent: float
    start_ns: int = 0
    end_ns: int = 0


PHASES = (Phase("clean", 0.0, 0.0), Phase("delay", 2.0, 0.0), Phase("loss", 0.0, 2.0))


@dataclass
class Seen:
    """What the recorders at the plant (`near`) and on the third host (`far`) have."""

    near: Bag
    far: Bag
    phases: list[Phase]
    cut_ns: int


def figures(quick: bool = False) -> list[Figure]:
    """Measure 10 s (quick: 3 s) each of a clean, a slow and a lossy link, then cut it."""
    with tempfile.TemporaryDirectory(prefix="dfm_machines_") as folder:
        seen = run(Path(folder), 3.0 if quick else 10.0)
    out = [figure for phase in seen.phases for figure in _phase(seen, phase)]
    return [*out, *_cut(seen)]


def run(folder: Path, phase_s: float) -> Seen:
    """Run the graph through the phases and the cut; return what was recorded."""
    with Hosts(HOSTS) as hosts:
        for host, name in (("plant", "near"), ("store", "far")):
            _start(hosts, host, "recorder", (f"bag:={folder / name}",), folder, f"/stage/{name}")
        for host, nodes in NODES.items():
            for name, settings in nodes.items():
                _start(hosts, host, name, settings, folder)
        _wait_for_a_scan(folder)
        time.sleep(2.0)
        done = []
        for phase in PHASES:
            for host in ("plant", "control"):
                hosts.shape(host, phase.delay_ms, phase.loss_percent)
            start_ns = time.time_ns()
            time.sleep(phase_s)
            done.append(Phase(phase.name, phase.delay_ms, phase.loss_percent, start_ns,
                              time.time_ns()))
        for host in ("plant", "control"):
            hosts.shape(host)
        log = folder / "operator.log"
        if hosts.start("control", ["-c", REARM], log).wait(UP_S):
            raise DfmError(f"the output could not be armed again: {log.read_text().strip()}")
        time.sleep(1.0)
        cut_ns = time.time_ns()
        hosts.pull("control")
        time.sleep(AFTER_CUT_S)
    return Seen(read_bag(folder / "near"), read_bag(folder / "far"), done, cut_ns)


def _start(hosts: Hosts, host: str, name: str, settings: tuple[str, ...], folder: Path,
           namespace: str = "/stage/x") -> None:
    arguments = ["-m", "dfm_stage", name, "--ros-args", "-r", f"__ns:={namespace}"]
    for setting in settings:
        arguments += ["-p", setting]
    hosts.start(host, arguments, folder / f"{host}_{name}.log")


def _wait_for_a_scan(folder: Path) -> None:
    """Wait until the reference that the plant's side has recorded moves."""
    deadline = time.monotonic() + UP_S
    while time.monotonic() < deadline:
        time.sleep(1.0)
        try:
            reference = read_bag(folder / "near", ["/stage/x/reference"])["/stage/x/reference"]
        except DfmError:
            continue
        if reference.message_count and np.ptp(reference["position"]) > 0.0:
            return
    words = " | ".join(f"{log.stem}: {log.read_text(errors='replace').strip()[-200:]}"
                       for log in sorted(folder.glob("*.log")))
    raise DfmError(f"no scan within {UP_S:g} s: {words}")


def _phase(seen: Seen, phase: Phase) -> list[Figure]:
    inside = seen.near["/stage/x/amplifier"]
    stamp = inside["header.stamp"]
    now = (stamp > phase.start_ns) & (stamp < phase.end_ns)
    measured = dict(zip(seen.near["/stage/x/measurement"]["seq"].tolist(),
                        seen.near["/stage/x/measurement"]["header.stamp"].tolist(), strict=True))
    ages = np.array([(at - measured[seq]) * 1e-6 for at, seq in zip(
        stamp[now].tolist(), inside["measurement_seq"][now].tolist(), strict=True)
        if seq in measured])
    samples = round((phase.end_ns - phase.start_ns) * 1e-6)
    answered = 100.0 * len(np.unique(inside["measurement_seq"][now])) / samples
    off = int(np.sum(~inside["enabled"][now]))
    lost = sum(missing(seen, topic, phase.start_ns, phase.end_ns) for topic in TOPICS)
    how = (f"controller on another host, {phase.delay_ms:g} ms delay and "
           f"{phase.loss_percent:g} % loss each way, {samples * 1e-3:.0f} s")
    key = f"machines.{phase.name}"
    return [
        Figure(f"{key}_age_p99_ms", float(np.percentile(ages, 99)) if len(ages) else np.nan, "ms",
               how=f"measurement to output, median {np.median(ages):.2f}; {how}"),
        Figure(f"{key}_answered_percent", answered, "%",
               how=f"of the samples; the output was off in {off} messages; {how}"),
        Figure(f"{key}_messages_lost", float(lost), "messages", 0.0, bar_kind="at most",
               how=f"in the bag of the plant's host and not in that of the third; {how}"),
    ]


def missing(seen: Seen, topic: str, start_ns: int, end_ns: int) -> int:
    """Return how many messages of a stretch the far recorder lacks."""
    name = f"/stage/x/{topic}"
    have = set(seen.far[name]["seq"].tolist())
    stamp = seen.near[name]["header.stamp"]
    inside = (stamp > start_ns) & (stamp < end_ns)
    return sum(seq not in have for seq in seen.near[name]["seq"][inside].tolist())


def zero_after_s(seen: Seen) -> float:
    """Return how long after the cut the output was at zero for good, s; infinite if never."""
    amplifier = seen.near["/stage/x/amplifier"]
    after = amplifier["header.stamp"] > seen.cut_ns
    on = after & (amplifier["enabled"] | (amplifier["voltage"] != 0.0))
    if not after.any() or on[-1]:
        return float("inf")
    last = np.flatnonzero(on)
    at = amplifier["header.stamp"][last[-1] + 1 if len(last) else np.flatnonzero(after)[0]]
    return float(at - seen.cut_ns) * 1e-9


def _cut(seen: Seen) -> list[Figure]:
    plant, amplifier = seen.near["/stage/x/plant"], seen.near["/stage/x/amplifier"]
    before = amplifier["header.stamp"] < seen.cut_ns
    was = "on" if before.any() and amplifier["enabled"][before][-1] else "off"
    after = plant["header.stamp"] > seen.cut_ns
    return [
        Figure("machines.cut_to_zero_ms", 1e3 * zero_after_s(seen), "ms", None, "stale time-out",
               1e3 * STALE_S, zero_after_s(seen) / STALE_S,
               "cable of the controller's host pulled, to the output at zero and latched; the "
               f"output was {was} when it was pulled"),
        Figure("machines.cut_travel_mm", 1e3 * float(np.max(np.abs(plant["position"][after]))),
               "mm", 7.7, bar_kind="at most", how="largest excursion in 3 s after the cut"),
    ]
