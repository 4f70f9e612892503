"""Who may see the graph and who may do what: discovery, security, ports, pages, models."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from dfm_stage.commands import NODES, module_of
from dfm_stage.errors import DfmError
from dfm_stage.harness import StageGraph
from dfm_stage.model import load_model
from dfm_stage.reporting import Page

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "config" / "sros2" / "policy.xml"
RIGHTS = ("publish", "subscribe", "reply", "request", "execute", "call")
Rights = dict[str, set[str]]
ACTION_PARTS = "/_action/"


@pytest.fixture(autouse=True)
def signals_as_they_were():
    """A node takes the signals for good: its process ends with it."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def allowed() -> dict[str, Rights]:
    """The rights of every node in the policy, names written out."""
    out = {}
    for enclave in ET.parse(POLICY).getroot().iter("enclave"):  # noqa: S314 a file of our own
        for profile in enclave.iter("profile"):
            namespace, node = profile.attrib["ns"], profile.attrib["node"]
            rights: Rights = {right: set() for right in RIGHTS}
            for group in profile:
                for right in group.attrib:
                    assert group.attrib[right] == "ALLOW"
                    rights[right] |= {written_out(item.text, namespace, node) for item in group}
            out[f"{namespace}/{node}"] = rights
    return out


def written_out(name: str | None, namespace: str, node: str) -> str:
    assert name
    if name == "*":
        return name
    if name.startswith("~/"):
        return f"{namespace}/{node}/{name[2:]}"
    return name if name.startswith("/") else f"{namespace}/{name}"


def real(node: Any) -> Rights:
    """What a node really does, actions by their own name."""
    name, namespace = node.get_name(), node.get_namespace()
    looks = {"publish": node.get_publisher_names_and_types_by_node,
             "subscribe": node.get_subscriber_names_and_types_by_node,
             "reply": node.get_service_names_and_types_by_node,
             "request": node.get_client_names_and_types_by_node}
    out: Rights = {right: set() for right in RIGHTS}
    for right, look in looks.items():
        for each, _ in look(name, namespace):
            action, part, _ = each.partition(ACTION_PARTS)
            side = "execute" if right in ("publish", "reply") else "call"
            out[side if part else right].add(action)
    return out


def test_the_policy_is_what_the_nodes_really_do_and_no_more(tmp_path):
    seen: dict[str, Rights] = {}

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
                if each.kind == "recorder":
                    look(each.node._tap)
    policy = allowed()
    operator = policy.pop("/stage/harness")
    assert policy.pop("/stage/recorder_tap")["subscribe"] == {"*"}
    assert seen.pop("/stage/recorder_tap")["publish"] == {"/parameter_events"}
    assert seen == policy
    offered = {right: {name for each in seen.values() for name in each[right]}
               for right in RIGHTS}
    assert operator["request"] <= offered["reply"]
    assert operator["call"] == offered["execute"]


@pytest.mark.parametrize("name", ["controller", "recorder"])
def test_a_graph_asked_to_be_secure_refuses_where_it_cannot(name, tmp_path, monkeypatch, capfd):
    from dfm_stage.__main__ import main
    from dfm_stage.middleware import security

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", "")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Permissive")
    assert main([name]) == 2
    assert "is no keystore" in capfd.readouterr().err
    (tmp_path / "keys" / "enclaves").mkdir(parents=True)
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
    assert "<script" not in html
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
