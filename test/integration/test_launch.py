"""The launch files, where launch is installed (it is not part of the private environment)."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from dfm_stage.nodes.wiring import LINKS

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "launch"
EXAMPLE = ROOT / "examples/one_axis_launch_test.py"


@pytest.mark.parametrize(("name", "layout", "processes"), [
    ("one_axis", "processes", 6), ("one_axis", "per_axis", 2), ("one_axis", "composed", 1),
    ("two_axes", "processes", 10), ("two_axes", "per_axis", 3), ("two_axes", "composed", 1)])
def test_launch_file_describes_the_nodes(name, layout, processes):
    pytest.importorskip("launch_ros", reason="launch_ros is not installed")
    spec = importlib.util.spec_from_file_location(name, LAUNCH / f"{name}.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    from launch_ros.actions import Node

    from dfm_stage.harness.launch_files import nodes
    from launch import LaunchContext

    arguments = [each.name for each in module.generate_launch_description().entities
                 if hasattr(each, "default_value")]
    assert arguments == ["parameters", "sample_period_s", "record", "layout"]
    context = LaunchContext()
    context.launch_configurations.update(parameters="", sample_period_s="", record="false",
                                         layout=layout)
    entities = nodes(context, ("x",) if name == "one_axis" else ("x", "y"))
    assert sum(isinstance(entity, Node) for entity in entities) == processes


def test_the_example_of_a_launch_test_names_what_there_is():
    tree = ast.parse(EXAMPLE.read_text("utf-8"))
    assert {"generate_test_description", "TestTheLoop", "TestTheEnd"} <= {
        each.name for each in tree.body if isinstance(each, (ast.FunctionDef, ast.ClassDef))}
    texts = {each.value for each in ast.walk(tree)
             if isinstance(each, ast.Constant) and isinstance(each.value, str)}
    files = {text for text in texts if text.endswith(".launch.py")}
    assert len(files) == 1
    assert files <= {path.name for path in LAUNCH.iterdir()}
    topic = next(text for text in texts if text.startswith("/stage/x/")).removeprefix("/stage/x/")
    fields = LINKS[topic].type.get_fields_and_field_types()
    used = {each.attr for each in ast.walk(tree) if isinstance(each, ast.Attribute)
            and isinstance(each.value, ast.Name) and each.value.id == "each"}
    assert used
    assert used <= set(fields)
    imported = {alias.name for each in tree.body if isinstance(each, ast.ImportFrom)
                and each.module == "dfm_interfaces.msg" for alias in each.names}
    assert imported == {LINKS[topic].type.__name__}


@pytest.mark.real_time
def test_the_example_of_a_launch_test_passes(tmp_path):
    pytest.importorskip("launch_testing", reason="launch_testing is not installed")
    done = subprocess.run(
        [sys.executable, "-c", "from launch_testing.launch_test import main; exit(main())",
         EXAMPLE], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
