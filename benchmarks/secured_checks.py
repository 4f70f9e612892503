"""What a secured graph must let pass and must refuse, tried on running graphs."""

from __future__ import annotations

import contextlib
import copy
import json
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fault_scene import CONTROLLER
from benchmarks.secured_stranger import FORGED_V, RATE_HZ
from dfm_stage.errors import DfmError
from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.node_set import NotInTimeError
from dfm_stage.harness.stage_graph import AXIS_NODES
from dfm_stage.middleware.discovery import PROFILES
from dfm_stage.middleware.security import OPERATOR, OVERRIDE
from dfm_stage.recording import read_bag
from dfm_stage.share import config_folder

POLICY = config_folder() / "sros2" / "policy.xml"
ONCE = POLICY.with_name("governance.xml")
"""Protects each message once; `ros2 security` writes one that does so three times."""
LIMITED, SHORT = "/stage/limited", "/stage/short"
STRANGER = Path(__file__).with_name("secured_stranger.py")
TOOLS_PERIOD_S = 0.004
"""Slower than a scan of the bench: two cores have to start a tool beside the secured graph."""
TOPICS = ("reference", "measurement", "command", "amplifier", "plant")
STARTS_S, TOOL_ENDS_S, MEETS_S, FORGES_S = 60.0, 90.0, "5", 5.0
SHORT_OF_A_RIGHT = "topic not found in allow rule"
NOISE = re.compile(r"\x1b\[[0-9;]*m| \(/\S+:\d+\)")
"""Colours, and where in the sources of Fast DDS a line was written."""
STILL_M = 1e-7
"""Two counts of the encoder."""


@dataclass(frozen=True)
class Check:
    """Something tried: its key, whether it went as it must, and what was seen."""

    key: str
    passed: bool
    seen: str


@contextlib.contextmanager
def secured(keys: Path | None, enclave: str = "") -> Iterator[dict[str, str]]:
    """Have nodes and tools started inside run under Enforce; without keys, unsecured.

    With an `enclave`, tools have that one. Nodes and what starts them choose their own.
    """
    names = ("ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY", "ROS_SECURITY_KEYSTORE", OVERRIDE)
    before = {name: os.environ.pop(name, None) for name in names}
    if keys is not None:
        os.environ.update(zip(names, ("true", "Enforce", str(keys), enclave), strict=True))
    try:
        yield dict(os.environ)
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def make_keys(folder: Path, governance: Path | None = None) -> Path:
    """Make keys of our policy, for ROS_DOMAIN_ID, with two enclaves that lack a right.

    `governance` says how messages are protected; by default `ros2 security` does.
    """
    root = ET.parse(POLICY)  # noqa: S314 a file of our own
    enclaves = root.getroot().find("enclaves")
    assert enclaves is not None
    for path, new, lacks in ((OPERATOR, LIMITED, "x/amplifier_driver/arm"),
                             ("/stage/x/controller", f"{SHORT}/controller", "command")):
        made = copy.deepcopy(next(each for each in enclaves if each.attrib["path"] == path))
        made.attrib["path"] = new
        for group in made.iter():
            if new != LIMITED and "ns" in group.attrib:
                group.attrib["ns"] = SHORT
            for item in [each for each in group if each.text == lacks]:
                group.remove(item)
        enclaves.append(made)
    policy = folder.with_suffix(".xml")
    root.write(policy)
    if governance is not None:
        (folder / "enclaves").mkdir(parents=True)
        shutil.copy(governance, folder / "enclaves")
    for words in (("create_keystore", str(folder)),
                  ("generate_artifacts", "-k", str(folder), "-p", str(policy))):
        done = subprocess.run(["ros2", "security", *words], capture_output=True, text=True,
                              check=False)
        if done.returncode:
            raise DfmError(f"ros2 security {words[0]} fails: {done.stderr.strip()[-300:]}")
    return folder


def scan(duration_s: float, *axes: str) -> dict[str, Any]:
    """Return an experiment: lines of 1 mm on every axis."""
    return {"name": "secured", "mode": "pid", "duration_s": duration_s, "axes": {
        axis: {"reference": {"kind": "raster", "line_length_m": 1e-3}} for axis in axes}}


def lost(bag: Path, axes: tuple[str, ...]) -> tuple[int, int]:
    """Return how many messages a bag has, and how many its sequence numbers miss."""
    numbers = [np.sort(topic["seq"]).astype(np.int64) for topic in read_bag(bag, [
        f"/stage/{axis}/{name}" for axis in axes for name in TOPICS]).values()]
    return (sum(int(each.size) for each in numbers),
            sum(int(np.sum(np.diff(each) - 1)) for each in numbers))


def lockstep_scan(keys: Path, layout: str, bag: Path, domain_id: int, duration_s: float
                  ) -> Iterator[Check]:
    """Start two axes in a layout, and scan in lockstep, recorded."""
    axes, key = ("x", "y"), layout if layout != "processes" else "lockstep"
    try:
        with secured(keys), StageGraph(axes=axes, lockstep=True, layout=layout, bag=bag,
                                       domain_id=domain_id, start_timeout_s=STARTS_S) as graph:
            if layout == "processes":
                yield Check("nodes_start", len(graph.launched) == 2 + len(axes) * len(AXIS_NODES),
                            f"{len(graph.launched)} nodes in processes of their own start and "
                            f"meet within {STARTS_S:g} s")
            graph.run(scan(duration_s, *axes))
            said = graph.stop_recording()
    except HarnessError as error:
        if isinstance(error, NotInTimeError) and layout == "processes":
            yield Check("nodes_start", False, str(error))
        yield Check(f"{key}_scan", False, str(error))
        return
    count, missing = lost(bag, axes)
    yield Check(f"{key}_scan", missing == 0 and count > 0,
                f"two axes, {duration_s:g} s, success; {said.partition(' in ')[0]} in the bag, "
                f"{missing} of {count} of the loop missing")


def real_time_scan(graph: StageGraph) -> Check:
    """Scan in real time and close the bag."""
    try:
        graph.run(scan(4.0, "x"))
        said = graph.stop_recording()
    except HarnessError as error:
        return Check("real_time_scan", False, str(error))
    assert graph.bag is not None
    count, missing = lost(graph.bag, ("x",))
    return Check("real_time_scan", missing == 0 and count > 0,
                 f"4 s at {1 / TOOLS_PERIOD_S:g} Hz, success; {said.partition(' in ')[0]} in the "
                 f"bag, {missing} of {count} of the loop missing")


def _ended(graph: StageGraph, command: list[str], environment: Mapping[str, str]
           ) -> tuple[int, str]:
    """Run a program beside the graph; return its exit code and what it printed."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          env=environment) as process:
        try:
            graph.spin_until(lambda: process.poll() is not None, TOOL_ENDS_S, command[0])
        except HarnessError:
            process.kill()
        assert process.stdout is not None
        out = process.stdout.read()
    return process.returncode, out


def _ros2(graph: StageGraph, keys: Path, enclave: str, *words: str) -> tuple[int, str]:
    waits = [] if words[:2] in {("service", "call"), ("action", "send_goal"), ("topic", "pub")} \
        else ["--no-daemon", "--spin-time", MEETS_S]
    with secured(keys, enclave) as environment:
        return _ended(graph, ["ros2", *words[:2], *waits, *words[2:]],
                      {**environment, "PYTHONUNBUFFERED": "1"})


def operators(graph: StageGraph, keys: Path, folder: Path) -> Iterator[Check]:
    """Work with the ros2 command as an operator, and as one without the right to arm."""
    experiment = folder / "experiment.yaml"
    experiment.write_text(json.dumps(scan(2.0, "x")))
    amplifier, controller = "/stage/x/amplifier_driver", "/stage/x/controller"
    trigger = "std_srvs/srv/Trigger"
    for key, expected, *words in (
            ("lists_nodes", controller, "node", "list"),
            ("lists_topics", "/stage/x/command", "topic", "list"),
            ("echoes", "voltage", "topic", "echo", "--once", "/stage/x/command"),
            ("sets", "successful", "param", "set", controller, "kp", "650.0"),
            ("gets", "650.0", "param", "get", controller, "kp"),
            ("state", "active", "lifecycle", "get", amplifier),
            ("disarms", "success=True", "service", "call", f"{amplifier}/disarm", trigger),
            ("clears", "success=True", "service", "call", f"{amplifier}/clear", trigger),
            ("arms", "success=True", "service", "call", f"{amplifier}/arm", trigger),
            ("sets_mode", "successful", "param", "set", controller, "mode", "pid"),
            ("runs", "SUCCEEDED", "action", "send_goal",
             "/stage/x/trajectory_generator/run_experiment",
             "dfm_interfaces/action/RunExperiment", f"{{experiment: {experiment}}}")):
        code, out = _ros2(graph, keys, OPERATOR, *words)
        yield Check(f"operator_{key}", code == 0 and expected in out,
                    _said(f"ros2 {' '.join(words[:2])}", code, out, expected))
    yield from refused_a_right(graph, keys)


def refused_a_right(graph: StageGraph, keys: Path, prefix: str = "") -> Iterator[Check]:
    """Try what an operator, and one without the right to arm, must not do and may do."""
    amplifier, trigger = "/stage/x/amplifier_driver", "std_srvs/srv/Trigger"
    for key, enclave, expected, *words in (
            ("operator_forges", OPERATOR, SHORT_OF_A_RIGHT, "topic", "pub", "--times", "3",
             "/stage/x/command", "dfm_interfaces/msg/Command"),
            ("limited_arms", LIMITED, SHORT_OF_A_RIGHT, "service", "call", f"{amplifier}/arm",
             trigger),
            ("limited_clears", LIMITED, "Trigger_Response", "service", "call",
             f"{amplifier}/clear", trigger),
            ("limited_gets", LIMITED, "Double value", "param", "get", "/stage/x/controller",
             "kp")):
        code, out = _ros2(graph, keys, enclave, *words)
        refused = expected == SHORT_OF_A_RIGHT
        yield Check(prefix + key, (code != 0) == refused and expected in out,
                    _said(f"ros2 {' '.join(words[:2])} as {enclave}", code, out, expected))


def _said(what: str, code: int, out: str, expected: str) -> str:
    plain = NOISE.sub("", out).splitlines()
    lines = [line for line in plain if expected in line] or plain[-1:]
    return f"{what}: exit code {code}, {lines[0].strip()[:200] if lines else 'it said nothing'}"


def node_without_a_right(keys: Path) -> Check:
    """Start a controller whose enclave may not publish commands."""
    with secured(keys, "") as environment:
        done = subprocess.run(
            [sys.executable, "-m", "dfm_stage", "controller", "--ros-args", "-r",
             f"__ns:={SHORT}", "--enclave", f"{SHORT}/controller"], env=environment,
            capture_output=True, text=True, check=False, timeout=TOOL_ENDS_S)
    errors = re.findall("error: controller: .*", done.stderr)  # Fast DDS writes between lines
    passed = done.returncode == 2 and len(errors) == 1 and (
        f"rt{SHORT}/command {SHORT_OF_A_RIGHT}" in done.stderr)
    return Check("node_without_a_right", passed,
                 f"exit code {done.returncode}, {errors[0] if errors else done.stderr[-300:]}")


def strangers(graph: StageGraph, visitors: Mapping[str, tuple[str, Path | None]]
              ) -> dict[str, dict[str, float]]:
    """Let strangers forge commands on an armed axis at rest, one after the other.

    `visitors` are, by their key, the name of their node and their keys, None without security.
    Returns by key (`nobody` without any) what each found, how far the stage moved, m, and how
    often its output was off.
    """
    plant, amplifier = graph.listen("x", "plant"), graph.listen("x", "amplifier")
    graph.set_parameters("/stage/x/controller", {"mode": "open_loop"})
    graph._rearm("x")
    graph.spin(FORGES_S / 2)
    out: dict[str, dict[str, float]] = {}
    for key, visitor in {"nobody": None, **visitors}.items():
        plant.clear()
        amplifier.clear()
        found: dict[str, float] = {}
        if visitor is None:
            graph.spin(FORGES_S)
        else:
            name, keys = visitor
            with secured(keys, "/stage/x/controller") as environment:
                plain = {each: value for each, value in environment.items() if each != PROFILES}
                code, said = _ended(graph, [sys.executable, str(STRANGER), name, str(FORGES_S)],
                                    plain)
            answer = [line for line in said.splitlines() if line.startswith("{")]
            if code or not answer:
                raise DfmError(f"the stranger ended with code {code}: {said[-500:]}")
            found = json.loads(answer[-1])
        out[key] = {**found, "moved_m": max(abs(each.position) for each in plant),
                    "off": sum(not each.enabled for each in amplifier)}
        graph.spin(FORGES_S / 2)
    graph.set_parameters("/stage/x/controller", {"mode": "pid"})
    return out


def kept_out(secret: Mapping[str, Mapping[str, float]], open_: Mapping[str, float]
             ) -> Iterator[Check]:
    """Judge what strangers found in a secured graph, beside what one found in an open one."""
    nobody = secret["nobody"]["moved_m"]
    for key, found in secret.items():
        if key == "nobody":
            continue
        yield Check(f"{key}_lists_nothing", found["listed"] == 0 < open_["listed"],
                    f"{found['listed']} nodes and topics; of the unsecured graph "
                    f"{open_['listed']}")
        yield Check(f"{key}_reads_nothing", found["read"] == 0 < open_["read"],
                    f"{found['read']} measurements; of the unsecured graph {open_['read']}")
        yield Check(f"{key}_moves_nothing",
                    found["matched"] == 0 == found["off"] and open_["off"] > 0
                    and found["moved_m"] <= nobody + STILL_M,
                    f"furthest {1e9 * found['moved_m']:.0f} nm under {found['sent']} commands of "
                    f"{FORGED_V:g} V at {RATE_HZ:g} Hz, {1e9 * nobody:.0f} nm without; armed all "
                    f"the time; the unsecured graph latched off, and moved "
                    f"{1e9 * open_['moved_m']:.0f} nm")


def visited(domain_id: int, bag: Path | None = None) -> StageGraph:
    """Return a graph to be visited, at a rate that leaves tools the processor."""
    nodes = ("sim_plant", *AXIS_NODES, *(("recorder",) if bag else ()))
    return StageGraph(nodes=nodes, bag=bag, domain_id=domain_id, sample_period_s=TOOLS_PERIOD_S,
                      start_timeout_s=STARTS_S, parameters={"controller": CONTROLLER})
