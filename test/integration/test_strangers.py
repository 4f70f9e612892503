"""Who may see the graph and who may do what: discovery, security, ports, pages, models."""

from __future__ import annotations

import copy
import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)
from rclpy.action import ActionClient
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import Trigger
from type_description_interfaces.srv import GetTypeDescription

from dfm_interfaces.action import RunExperiment
from dfm_stage import __main__
from dfm_stage.commands import NODES, module_of
from dfm_stage.errors import DfmError
from dfm_stage.harness import StageGraph
from dfm_stage.harness.fork_server import ForkServer
from dfm_stage.harness.taps import Taps
from dfm_stage.middleware import security
from dfm_stage.model import load_model
from dfm_stage.nodes.process import Helper
from dfm_stage.nodes.wiring import interface as get_message
from dfm_stage.reporting import Page

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "config" / "sros2" / "policy.xml"
RIGHTS = ("publish", "subscribe", "reply", "request", "execute", "call")
Rights = dict[str, set[str]]
ACTION_PARTS = "/_action/"
XINCLUDE = "{http://www.w3.org/2001/XInclude}include"
LIFE_CYCLE = ((ChangeState, "change_state"), (GetState, "get_state"),
              (GetAvailableStates, "get_available_states"),
              (GetAvailableTransitions, "get_available_transitions"),
              (GetAvailableTransitions, "get_transition_graph"))


@pytest.fixture(autouse=True)
def signals_as_they_were():
    """A node takes the signals for good: its process ends with it."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def policy_in_full(file: Path) -> ET.Element:
    """A policy with what it includes of itself, as `ros2 security` reads it."""
    root = ET.parse(file).getroot()  # noqa: S314 a file of our own
    for parent in list(root.iter("profiles")):
        for place, each in reversed(list(enumerate(parent))):
            if each.tag != XINCLUDE:
                continue
            what = re.fullmatch(r"xpointer\(/policy/(.+)\)", each.attrib["xpointer"])
            assert what
            found = root.findall(what[1])
            assert len(found) >= 1, each.attrib
            parent[place:place + 1] = copy.deepcopy(found)
    return root


@cache
def enclaves() -> dict[str, list[ET.Element]]:
    """The profiles of every enclave of the policy, those it includes among them."""
    return {each.attrib["path"]: list(each.iter("profile"))
            for each in policy_in_full(POLICY).iter("enclave")}


def allowed() -> dict[str, Rights]:
    """The rights of every node in the policy, names written out."""
    out = {}
    for profiles in enclaves().values():
        for profile in profiles:
            namespace, node = profile.attrib["ns"], profile.attrib["node"]
            rights: Rights = {right: set() for right in RIGHTS}
            for group in profile:
                for right in group.attrib:
                    assert group.attrib[right] == "ALLOW"
                    rights[right] |= {written_out(item.text, namespace, node) for item in group}
            out[f"{namespace.rstrip('/')}/{node}"] = rights
    return out


def written_out(name: str | None, namespace: str, node: str) -> str:
    """A name of the policy in full, as the templates of sros2 (permissions.xsl) write it."""
    assert name
    space = f"{namespace.rstrip('/')}/"
    if name.startswith("~/"):
        return f"{space}{node}/{name[2:]}"
    return name if name.startswith("/") else f"{space}{name}"


SIDES = {"publish": ("publish",), "subscribe": ("subscribe",), "reply": ("publish", "subscribe"),
         "request": ("subscribe", "publish")}


def on_the_wire(right: str, name: str) -> list[tuple[str, str]]:
    """What a right to a ROS name is in DDS: sides and topics, as in permissions.xsl."""
    if right in ("execute", "call"):
        topic, service = ("publish", "reply") if right == "execute" else ("subscribe", "request")
        return [*(each for part in ("feedback", "status")
                  for each in on_the_wire(topic, f"{name}{ACTION_PARTS}{part}")),
                *(each for part in ("cancel_goal", "get_result", "send_goal")
                  for each in on_the_wire(service, f"{name}{ACTION_PARTS}{part}"))]
    topics = (f"rt{name}",) if len(SIDES[right]) == 1 else (f"rr{name}Reply", f"rq{name}Request")
    return list(zip(SIDES[right], topics, strict=True))


def permissions() -> dict[str, set[tuple[str, str]]]:
    """What every enclave may do in DDS; topics may have wildcards."""
    rights = allowed()
    return {path: {entry for name in names_of(profiles) for right, granted in rights[name].items()
                   for each in granted for entry in on_the_wire(right, each)}
            for path, profiles in enclaves().items()}


def names_of(profiles: list[ET.Element]) -> list[str]:
    return [f"{each.attrib['ns'].rstrip('/')}/{each.attrib['node']}" for each in profiles]


def refused(node: Any, granted: set[tuple[str, str]]) -> list[tuple[str, str]]:
    """What a node does in DDS and its enclave may not; Fast DDS matches with fnmatch, too."""
    name, namespace = node.get_name(), node.get_namespace()
    does = {entry for right, look in looks(node).items() for each, _ in look(name, namespace)
            for entry in on_the_wire(right, each)}
    assert does
    return sorted((side, topic) for side, topic in does if not any(
        side == other and fnmatchcase(topic, pattern) for other, pattern in granted))


def looks(node: Any) -> dict[str, Any]:
    return {"publish": node.get_publisher_names_and_types_by_node,
            "subscribe": node.get_subscriber_names_and_types_by_node,
            "reply": node.get_service_names_and_types_by_node,
            "request": node.get_client_names_and_types_by_node}


def real(node: Any) -> Rights:
    """What a node really does, actions by their own name."""
    name, namespace = node.get_name(), node.get_namespace()
    out: Rights = {right: set() for right in RIGHTS}
    for right, look in looks(node).items():
        for each, _ in look(name, namespace):
            action, part, _ = each.partition(ACTION_PARTS)
            side = "execute" if right in ("publish", "reply") else "call"
            out[side if part else right].add(action)
    return out


def test_the_policy_is_what_the_nodes_really_do_and_no_more(tmp_path):
    seen: dict[str, Rights] = {}
    granted = permissions()

    def look(node: Any) -> None:
        rights = seen.setdefault(f"{node.get_namespace()}/{node.get_name()}",
                                 {right: set() for right in RIGHTS})
        for right, names in real(node).items():
            rights[right] |= names

    for lockstep, model in ((True, "paper_stage"), (False, "current_stage")):
        with StageGraph(axes=("x", "y"), composed=True, lockstep=lockstep, model=model,
                        bag=tmp_path / model, start_timeout_s=120.0,
                        parameters={"controller": {"amplifier_feedback": True}}) as graph:
            for each in graph.launched:
                look(each.node)
                for enclave in (each.full_name, enclave_of_axis(each), "/stage"):
                    assert refused(each.node, granted[enclave]) == []
                if each.kind == "recorder":
                    graph.spin_until(lambda tap=each.node._tap: "/diagnostics" in {
                        name for name, _ in tap.get_subscriber_names_and_types_by_node(
                            "recorder_tap", "/stage")}, 10.0, "a recorded topic of all nodes")
                    look(each.node._tap)
                    assert refused(each.node._tap, granted["/stage/recorder"]) == []
            taps = Taps(graph._client_node)
            for node in (graph._client_node, taps._node):
                for enclave in ("/stage/operator", "/stage"):
                    assert refused(node, granted[enclave]) == []
            taps.close()
    with StageGraph(composed=True, model="current_stage", nodes=("sim_plant",)) as graph:
        for axis in ("x", "y"):
            plant = graph.launch("sim_plant", f"/stage/{axis}", {"model": "current_stage"}).node
            look(plant)
            assert refused(plant, granted[f"/stage/{axis}"]) == []
    policy = allowed()
    operator = policy.pop("/stage/harness")
    for name in ("/stage/recorder_tap", "/stage/harness_tap", "/stage/view", "/_ros2cli_*"):
        assert policy.pop(name)["subscribe"] == {"/*"}
    assert seen.pop("/stage/recorder_tap")["publish"] == {"/parameter_events"}
    assert seen == policy
    offered = {right: {name for each in seen.values() for name in each[right]}
               for right in RIGHTS}
    assert operator["request"] <= offered["reply"]
    assert operator["call"] == offered["execute"]


def enclave_of_axis(launched: Any) -> str:
    """The enclave of a process with the nodes of its axis; the recorder is never in one."""
    return {"/stage": "/stage/x"}.get(launched.namespace, launched.namespace) if (
        launched.kind != "recorder") else "/stage/recorder"


def test_ros2_security_finds_nothing_but_enclaves():
    """It takes all that stands in `enclaves` for one, a comment as well, and ends."""
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314 of our own
    listed = ET.parse(POLICY, parser).getroot().find("enclaves")  # noqa: S314 of our own
    assert listed is not None
    assert {each.tag for each in listed} == {"enclave"}


def test_our_governance_lets_nobody_in_and_protects_every_message_once():
    root = ET.parse(POLICY.with_name("governance.xml")).getroot()  # noqa: S314 of our own
    said = {each.tag: each.text for each in root.iter() if each.text and each.text.strip()}
    assert len(list(root.iter("domain_rule"))) == len(list(root.iter("topic_rule"))) == 1
    assert said == {
        "min": "0", "max": "232", "topic_expression": "*",
        "allow_unauthenticated_participants": "false", "enable_join_access_control": "true",
        "enable_discovery_protection": "true", "enable_liveliness_protection": "true",
        "enable_read_access_control": "true", "enable_write_access_control": "true",
        "discovery_protection_kind": "ENCRYPT", "liveliness_protection_kind": "ENCRYPT",
        "rtps_protection_kind": "ENCRYPT", "metadata_protection_kind": "NONE",
        "data_protection_kind": "NONE"}


def test_a_process_of_several_nodes_has_their_rights_and_no_more():
    full = {path: set(names_of(profiles)) for path, profiles in enclaves().items()}
    assert len({path.lower() for path in full}) == len(full)
    for axis in ("x", "y"):
        alone = {path for path in full if path.startswith(f"/stage/{axis}/")}
        assert len(alone) == 4
        assert full[f"/stage/{axis}"] == alone | {"/stage/sim_plant", f"/stage/{axis}/sim_plant"}
    others = {"/stage/recorder_tap", "/stage/harness", "/stage/harness_tap"}
    assert full["/stage"] == others | {path for path in full if path not in (
        "/stage", "/stage/x", "/stage/y", "/stage/operator")}


@pytest.mark.parametrize(("nodes", "enclave"), [
    (["/stage/x/controller"], "/stage/x/controller"),
    (["/stage/sim_plant"], "/stage/sim_plant"),
    (["/stage/sim_plant", "/stage/x/encoder_driver", "/stage/x/controller"], "/stage/x"),
    (["/stage/y/sim_plant", "/stage/y/encoder_driver"], "/stage/y"),
    (["/stage/recorder", "/stage/sim_plant", "/stage/x/controller"], "/stage"),
    (["/stage/sim_plant", "/stage/x/controller", "/stage/y/controller"], "/stage")])
def test_every_process_has_an_enclave_of_the_policy(nodes, enclave):
    assert security.enclave_for(nodes) == enclave
    assert set(nodes) <= set(names_of(enclaves()[enclave]))


def test_an_operator_may_do_what_the_ros2_command_does_and_nothing_on_the_loop():
    granted = permissions()["/stage/operator"]
    with StageGraph(composed=True, lockstep=True) as graph:
        # for ros2 param, lifecycle, topic echo, and, with parameter services, service and action
        node = rclpy.create_node("_ros2cli_4711", context=graph._context)
        for each in graph.launched:
            AsyncParameterClient(node, each.full_name)
            node.create_client(GetTypeDescription, f"{each.full_name}/get_type_description")
            if each.kind.endswith("driver"):
                for kind, name in LIFE_CYCLE:
                    node.create_client(kind, f"{each.full_name}/{name}")
        for name in ("amplifier_driver/arm", "amplifier_driver/clear", "encoder_driver/home",
                     "trajectory_generator/start"):
            node.create_client(Trigger, f"/stage/x/{name}")
        ActionClient(node, RunExperiment, "/stage/x/trajectory_generator/run_experiment")
        for name, types in node.get_topic_names_and_types():
            if ACTION_PARTS in name:
                continue
            node.create_subscription(get_message(types[0]), name, print, 1)
        graph.spin_until(lambda: len(node.get_client_names_and_types_by_node(
            node.get_name(), "/")) > 40, 10.0, "the clients")
        assert refused(node, granted) == []
        node.destroy_node()
        loop = [name for name, _ in graph._client_node.get_topic_names_and_types()
                if name.startswith("/stage/")]
    assert len(loop) > 8
    for name in (*loop, "/clock", "/diagnostics"):
        assert not any(side == "publish" and fnmatchcase(f"rt{name}", pattern)
                       for side, pattern in granted), name


@pytest.fixture
def keystore(tmp_path, monkeypatch):
    """Keys for two enclaves, and a Fast DDS that looks as if it had security."""
    for name in ("stage/x/controller", "stage/recorder"):
        folder = tmp_path / "keys" / "enclaves" / name
        folder.mkdir(parents=True)
        for file in security._ENCLAVE_FILES:
            (folder / file).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(security, "_loaded_fast_dds", lambda: None)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / "keys"))
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Permissive")
    return tmp_path / "keys"


def said_by(name: str, *arguments: str, capfd: Any) -> str:
    """The one line that a node has left to say."""
    assert __main__.main([name, "--ros-args", *arguments]) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if "SECURITY" not in line[:40]]
    assert len(lines) == 1, lines
    return lines[0]


def test_a_wrong_or_absent_enclave_is_one_line(keystore, monkeypatch, capfd):
    said = said_by("controller", capfd=capfd)
    assert "the enclave / has no identity_ca.cert.pem" in said
    assert "name one of /stage/recorder, /stage/x/controller by --ros-args --enclave" in said
    said = said_by("controller", "--enclave", "/stage/x/controler", capfd=capfd)
    assert "the enclave /stage/x/controler has no" in said
    (keystore / "enclaves/stage/x/controller/permissions.p7s").unlink()
    said = said_by("controller", "--enclave", "/stage/x/controller", capfd=capfd)
    assert "the enclave /stage/x/controller has no permissions.p7s in" in said
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/stage/elsewhere")
    said = said_by("controller", "--enclave", "/stage/recorder", capfd=capfd)
    assert "the enclave /stage/elsewhere has no" in said
    with pytest.raises(DfmError, match="the enclave /stage/elsewhere has no"):
        StageGraph(composed=True).bring_up()
    with pytest.raises(DfmError, match="the enclave /stage/elsewhere has no"):
        Helper("view", "/stage")


def test_every_layout_asks_for_the_enclaves_that_the_policy_has(keystore):
    for graph, missing in ((StageGraph(composed=True), "/stage"),
                           (StageGraph(layout="per_axis"), "/stage/operator")):
        with pytest.raises(DfmError, match=f"the enclave {missing} has no"):
            graph.bring_up()
    with pytest.raises(DfmError, match="the enclave /stage/operator has no"):
        Helper("view", "/stage")


@pytest.mark.parametrize(("layout", "expected"), [
    ("per_axis", ["/stage/recorder", "/stage/x", "/stage/y"]),
    ("processes", ["/stage/recorder", "/stage/sim_plant", "/stage/x/encoder_driver",
                   "/stage/y/encoder_driver"])])
def test_every_process_is_started_with_an_enclave_of_the_policy(layout, expected, tmp_path,
                                                                monkeypatch):
    start, started = ForkServer.start, []

    def note(server: Any, kind: str, arguments: list[str], *rest: Any) -> Any:
        started.append(security.enclave_of(arguments))
        return start(server, kind, arguments, *rest)

    monkeypatch.setattr(ForkServer, "start", note)
    kinds = None if layout == "per_axis" else ("recorder", "sim_plant", "encoder_driver")
    with StageGraph(axes=("x", "y"), layout=layout, nodes=kinds, bag=tmp_path / "bag"):
        assert sorted(started) == expected
    assert set(expected) <= set(enclaves())


def test_a_right_that_its_enclave_lacks_is_one_line(keystore, monkeypatch, capfd):
    from dfm_stage.nodes import process

    class Controller:
        kind, niceness = "controller", 0

        def __init__(self) -> None:
            raise rclpy_implementation.RCLError(
                "Failed to create publisher: rt/stage/x/command topic not found in allow rule.\n,"
                " at ./src/rmw_publisher.cpp:10, at ./src/rcl/publisher.c:116")

    monkeypatch.setattr(process, "_join", lambda _: None)
    monkeypatch.setattr("dfm_stage.nodes.controller.Controller", Controller)
    said = said_by("controller", "--enclave", "/stage/recorder", capfd=capfd)
    assert said == ("error: controller: the middleware refused: Failed to create publisher: "
                    "rt/stage/x/command topic not found in allow rule.; has its enclave "
                    "/stage/recorder the right to it, in this ROS_DOMAIN_ID?")


def test_keys_of_another_domain_are_one_line_for_programs_beside_the_graph(monkeypatch):
    def refuse(*_: Any, **__: Any) -> None:
        raise rclpy_implementation.RCLError(
            "error creating node: could not create data writer, at ./src/publisher.cpp:275")

    monkeypatch.setattr(rclpy, "create_node", refuse)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/stage/operator")
    monkeypatch.setattr("dfm_stage.nodes.process.require_what_was_asked", lambda _: None)
    with pytest.raises(DfmError, match=r"^view: .* could not create data writer; has its enclave "
                       r"/stage/operator the right to it, in this ROS_DOMAIN_ID\?$"):
        Helper("view", "/stage")


@pytest.mark.parametrize("name", ["controller", "recorder"])
def test_a_graph_asked_to_be_secure_refuses_where_it_cannot(name, tmp_path, monkeypatch, capfd):
    from dfm_stage.__main__ import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", "")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Permissive")
    assert main([name]) == 2
    assert "is no keystore" in capfd.readouterr().err
    folder = tmp_path / "keys" / "enclaves"
    for place in (folder, folder / "stage"):
        place.mkdir(parents=True)
        for file in security._ENCLAVE_FILES:
            (place / file).touch()
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path / "keys"))
    library = tmp_path / "libfastrtps.so.2"
    monkeypatch.setattr(security, "_loaded_fast_dds", lambda: library)
    library.write_bytes(b"nothing of the kind")
    assert main([name]) == 2
    said = capfd.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("error: ROS_SECURITY_ENABLE is true, but libfastrtps.so.2 was built ")
    with pytest.raises(DfmError, match="without DDS security"):
        StageGraph(composed=True).bring_up()
    library.write_bytes(b"...DDS:Auth:PKI-DH:1.0...")
    security.require_what_was_asked()
    assert not (tmp_path / "bags").exists()


IMPORT_EACH = """
import importlib, os, sys
for module in sys.argv[2:]:
    os.environ.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)
    if sys.argv[1]:
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = sys.argv[1]
    for name in [name for name in sys.modules if name.startswith("dfm_stage")]:
        del sys.modules[name]
    importlib.import_module(module)
    print(os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"])
"""


@pytest.mark.parametrize(("given", "expected"), [("", "LOCALHOST"), ("SUBNET", "SUBNET")])
def test_what_ros2_run_and_launch_files_start_stays_on_this_machine(given, expected):
    modules = [*map(module_of, NODES), "dfm_stage.harness", "dfm_stage.harness.emulator_link"]
    done = subprocess.run([sys.executable, "-c", IMPORT_EACH, given, *modules], cwd=ROOT,
                          text=True, check=True, stdout=subprocess.PIPE)
    assert done.stdout.split() == [expected] * len(modules)


def test_a_page_escapes_everything():
    bad = "<script>alert(1)</script>\"'&<img src=x onerror=alert(1)>"
    page = Page(bad).lead(bad, bad).section(bad, bad).text(bad).note(bad)
    page.table([bad, "b"], [[bad, 1.0], [None, bad]], bad).provenance({bad: bad})
    html = page.html()
    assert "<script>alert" not in html
    assert "<img" not in html
    assert html.count("&lt;script&gt;") >= 12


@pytest.mark.parametrize("text", [
    "!!python/object/apply:os.system ['touch {marker}']",
    "dfm_model: 1\nname: !!python/object/apply:os.system ['touch {marker}']\n",
    "dfm_model: 1\nname: \"x = __import__('os').system('touch {marker}')\"\nbase: {{}}\n",
    "dfm_model: 1\nname: a\nbase: {{mass: \"__import__('os').system('touch {marker}')\"}}\n",
])
def test_a_model_runs_no_code(text, tmp_path):
    marker, file = tmp_path / "marker", tmp_path / "model.yaml"
    file.write_text(text.format(marker=marker), encoding="utf-8")
    with pytest.raises(DfmError):
        load_model(file)
    assert not marker.exists()


def test_no_port_listens_and_nobody_is_called_from_outside():
    with StageGraph(nodes=("sim_plant",)) as graph:
        pid = graph.launched[0].process.pid
        multicast = 7400 + 250 * graph._domain_id
        assert ports(pid, "tcp", state="0A") == []
        assert ports(pid, "udp")
        assert multicast not in ports(pid, "udp")


def ports(pid: int, kind: str, state: str | None = None) -> list[int]:
    """Local ports of the sockets of a process, IPv4 and IPv6."""
    own = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            own.add(os.readlink(entry))
        except OSError:
            continue
    out = []
    for table in (kind, f"{kind}6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text("utf-8").splitlines()[1:]:
            fields = line.split()
            if f"socket:[{fields[9]}]" in own and state in (None, fields[3]):
                out.append(int(fields[1].rpartition(":")[2], 16))
    return out
