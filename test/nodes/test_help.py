"""What a node says of itself is what it really declares, publishes, hears and offers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import dfm_stage
from dfm_stage.commands import NODES, module_of
from dfm_stage.nodes.base import node_class
from dfm_stage.nodes.help import help_text, qos_words

ROOT = Path(__file__).resolve().parents[2]
NAMESPACE = "/stage/x"
OF_ROS = ("/rosout", "/parameter_events")
OF_ROS_SERVICES = ("describe_parameters", "get_parameter_types", "get_parameters",
                   "list_parameters", "set_parameters", "set_parameters_atomically",
                   "get_type_description")
OF_LIFE_CYCLE = ("get_available_states", "get_available_transitions", "get_transition_graph")
BELOW_RCLPY = "~/transition_event"
"""Made by rcl: a node does not know it (test/docs/test_reference.py looks at the graph)."""
EVERYTHING_ON = {"sim_plant": {"model": "current_stage"},
                 "controller": {"amplifier_feedback": "true"},
                 "trajectory_generator": {"wait_for_recorder": "true"}}
"""Parameters with which a node has all its topics."""


def section(text: str, title: str, indent: int) -> list[list[str]]:
    """The rows below a title, in columns."""
    found = re.search(rf"^ *{title}.*\n((?: {{{indent}}}\S.*\n)*)", text, re.MULTILINE)
    assert found, title
    return [re.split(r" {2,}", line.strip()) for line in found[1].splitlines()]


def seen(name: str, node) -> str:
    own = node.get_fully_qualified_name()
    return name.replace(f"{own}/", "~/").replace(f"{NAMESPACE}/", "")


def type_name(kind) -> str:
    package, *_, module, _ = kind.__module__.split(".")
    return f"{package}/{module}/{kind.__name__}"


@pytest.fixture(params=NODES)
def started(request, make):
    node = make(node_class(request.param), **EVERYTHING_ON.get(request.param, {}))
    return node, help_text(type(node))


def test_its_topics_are_those_of_the_node(started):
    node, text = started
    for title, ends in (("publishes", node.publishers), ("subscribes to", node.subscriptions)):
        real = sorted([seen(end.topic_name, node), type_name(end.msg_type),
                       qos_words(end.qos_profile)] for end in ends
                      if end.topic_name not in OF_ROS and "/_action/" not in end.topic_name)
        if node.kind == "recorder" and title == "subscribes to":
            assert real == []
            assert section(text, title, 4) == [[node.listens_to]]
        elif real or title == "publishes":
            assert real == sorted(row for row in section(text, title, 4) if row[0] != BELOW_RCLPY)


def test_its_services_are_those_of_the_node(started):
    node, text = started
    real = sorted([seen(service.service_name, node), type_name(service.srv_type)]
                  for service in node.services
                  if service.service_name.rpartition("/")[2] not in (
                      *OF_ROS_SERVICES, *OF_LIFE_CYCLE))
    said = [row[:2] for row in section(text, "services and actions", 2)]
    assert sorted(row for row in said if "/action/" not in row[1]) == real
    actions = [row[0] for row in said if "/action/" in row[1]]
    assert actions == (["~/run_experiment"] if node.kind == "trajectory_generator" else [])


def test_its_parameters_are_those_that_the_node_declares(started):
    node, text = started
    rows = text[text.index("parameters:"):text.index("\nexample")]
    words = " ".join(rows.split())
    names = re.findall(r"^  ([a-z]\S*)( \*)?  ", rows, re.MULTILINE)
    declared = {name: node.describe_parameter(name) for name in
                node.list_parameters([], 0).names if name in node.settings.values}
    assert sorted(name for name, _ in names) == sorted(declared)
    for name, live in names:
        described = declared[name]
        assert bool(live) != described.read_only
        text_of, _, unit = described.description.removesuffix("]").rpartition(" [")
        assert " ".join((text_of or unit).split()) in words
        row = re.search(rf"^  {re.escape(name)}(?: \*)? +(\S.*)$", rows, re.MULTILINE)
        if text_of and node.settings._table[name].unit:
            assert re.search(rf" {re.escape(unit)}(  |$)", row[1]), row[1]
        for spans in (described.floating_point_range, described.integer_range):
            for span in spans:
                if abs(span.to_value) < 1e15 and abs(span.from_value) < 1e15:
                    assert f"({span.from_value:g} to {span.to_value:g})" in row[1]


def test_its_example_can_be_started(started, tmp_path, monkeypatch, ros):
    node, text = started
    monkeypatch.chdir(tmp_path)
    line = text[text.index("\nexample"):].splitlines()[2]
    command, _, arguments = line.strip().partition(" --ros-args ")
    assert command.endswith(f" {node.kind}")
    again = type(node)(context=ros(), cli_args=["--ros-args", *arguments.replace(
        "'", "").split()])
    again.destroy_node()


@pytest.mark.parametrize("name", NODES)
def test_asking_starts_nothing(name, capsys, monkeypatch):
    from dfm_stage.__main__ import main
    from dfm_stage.nodes import process

    monkeypatch.setattr(process.StopRequest, "install", lambda _: None)
    monkeypatch.setattr(process.rclpy, "init", lambda **_: pytest.fail("DDS was started"))
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    assert main([name, "--help"]) == 0
    said = capsys.readouterr()
    assert said.out.strip() == help_text(node_class(name))
    assert said.err == ""
    assert main([name, "--version", "--ros-args", "-p", "lockstep:=true"]) == 0
    assert capsys.readouterr().out == f"{name} {dfm_stage.__version__} (dfm_stage)\n"
    assert main([name, "--hlep"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: unknown arguments --hlep")
    assert said.err.count("\n") == 1
    assert os.getpriority(os.PRIO_PROCESS, 0) == niceness


def test_asking_does_not_wait_for_the_compiler():
    code = ("import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(name)\n"
            "import dfm_stage.nodes.help\nprint('numba' in sys.modules, 'scipy' in sys.modules)")
    done = subprocess.run([sys.executable, "-c", code, *map(module_of, NODES)], cwd=ROOT,
                          capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
