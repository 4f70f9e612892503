"""Names and units as ROS has them (REP-144, REP-103), and everything imported is declared."""

from __future__ import annotations

import ast
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from reference_page import FURTHER_TOPICS, SERVICES

from dfm_stage.commands import NODES, TOOLS
from dfm_stage.nodes.base import node_class
from dfm_stage.nodes.wiring import LINKS

ROOT = Path(__file__).parents[2]
NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
UNIT = re.compile(r"# (m|m/s|m/s\^2|N|V|A|s)\b")
KEYS = {  # what is imported under another name than its rosdep key
    "mcap": "mcap-ros2-support", "mcap_ros2": "mcap-ros2-support", "ruamel": "python3-ruamel.yaml",
    "serial": "python3-serial", "lz4": "mcap-ros2-support", "zstandard": "mcap-ros2-support",
    "cycler": "python3-matplotlib", "filterpy": "python3-filterpy-pip",
    "llvmlite": "python3-numba",
}
WITHOUT_KEY = {"control", "pyfe3d"}     # rosdep has none; docs/ros2.md says so


def manifest(folder: str = "") -> ET.Element:
    return ET.parse(ROOT / folder / "package.xml").getroot()  # noqa: S314 our own file


@pytest.mark.parametrize("folder", ["", "dfm_interfaces"])
def test_packages_have_names_and_maintainers_that_tools_accept(folder: str) -> None:
    package = manifest(folder)
    assert NAME.fullmatch(package.findtext("name", ""))
    assert len(package.findtext("name", "")) > 1
    maintainer = package.find("maintainer")
    assert maintainer is not None
    assert re.fullmatch(r"[\w.+-]+@[\w-]+(\.[\w-]+)+", maintainer.get("email", ""))
    assert re.fullmatch(r"\d+\.\d+\.\d+", package.findtext("version", ""))


def test_every_import_is_declared() -> None:
    declared = {each.text for each in manifest() if each.tag in ("depend", "exec_depend")}
    missing = {}
    for path in (ROOT / "dfm_stage").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = ([alias.name for alias in node.names] if isinstance(node, ast.Import) else
                     [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level
                     else [])
            for module in {name.partition(".")[0] for name in names} - {"dfm_stage"}:
                if module in sys.stdlib_module_names or module in WITHOUT_KEY:
                    continue
                wanted = {module, f"python3-{module}", KEYS.get(module, "")}
                if not wanted & declared:
                    missing[module] = path.name
    # the checkout's own benchmarks, which only `bench` imports; extras, asked for by name
    assert set(missing) - {"benchmarks", "distributed", "pandas", "xarray"} == set()


def test_names_are_lower_case_with_underscores() -> None:
    parameters = [setting.name for node in NODES for setting in node_class(node).settings_table]
    topics = [*LINKS, *FURTHER_TOPICS, *SERVICES]
    parts = [part for name in (*NODES, *TOOLS, *topics) for part in name.strip("/").split("/")
             if not part.startswith("<")]
    parts += [part for name in parameters for part in name.split(".")]
    assert [part for part in parts if not NAME.fullmatch(part)] == []
    assert not [name for name in (*NODES, *TOOLS) if "__" in name]


def test_interfaces_are_named_as_ros_names_them_and_say_their_units() -> None:
    files = [path for kind in ("msg", "srv", "action")
             for path in (ROOT / "dfm_interfaces" / kind).iterdir()]
    assert len(files) > 8
    for path in files:
        assert re.fullmatch(r"([A-Z][a-z0-9]*)+", path.stem)
        for line in path.read_text(encoding="utf-8").splitlines():
            field = re.match(r"(\S+) +(\w+) *(=.*?)?(#.*)?$", line)
            if not field or field[1] in ("#", "---"):
                continue
            if field[3]:
                assert re.fullmatch(r"[A-Z][A-Z0-9_]*", field[2]), line
                continue
            assert NAME.fullmatch(field[2]), line
            if field[1] == "float64":
                assert UNIT.match(field[4] or ""), f"{path.name}: {line}"
