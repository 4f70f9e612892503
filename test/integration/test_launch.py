"""The launch files, where launch is installed (it is not part of the private environment)."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

LAUNCH = Path(__file__).resolve().parents[2] / "launch"


@pytest.mark.parametrize(("name", "nodes"), [("one_axis", 6), ("two_axes", 10)])
def test_launch_file_describes_the_nodes(name, nodes):
    pytest.importorskip("launch_ros", reason="launch_ros is not installed")
    spec = importlib.util.spec_from_file_location(name, LAUNCH / f"{name}.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    from launch_ros.actions import Node

    from launch import LaunchContext

    arguments = [each.name for each in module.generate_launch_description().entities
                 if hasattr(each, "default_value")]
    assert arguments == ["parameters", "sample_period_s", "record"]
    context = LaunchContext()
    context.launch_configurations.update(parameters="", sample_period_s="", record="false")
    entities = module.nodes(context)
    assert sum(isinstance(entity, Node) for entity in entities) == nodes
