"""Who may import whom, held against the sources, and shown to be able to fail."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = "dfm_stage"

# part: the other parts of ours it may import
BASE = {"arrays", "decisions", "errors", "files", "machine_code", "quantity"}
ARROWS: dict[str, set[str]] = {
    "arrays": set(),
    "decisions": {"errors"},
    "errors": set(),
    "files": set(),
    "machine_code": set(),
    "quantity": set(),
    "commands": set(),
    "domain": BASE,
    "model": BASE,
    "recording": BASE,
    "compile_all": BASE | {"model", "recording"},
    "reporting": BASE,
    "drivers": BASE,
    "trajectory": BASE | {"model"},
    "control": BASE | {"model"},
    "identification": BASE | {"model", "recording"},
    "diagnosis": BASE | {"model", "recording", "identification", "trajectory"},
    "paper": BASE | {"model", "trajectory", "control", "identification", "recording", "reporting"},
}
PURE = set(ARROWS)
WITH_ROS = {"nodes", "harness", "emulated", "live"}
ANYTHING = {"cli", "nodes", "harness", "emulated", "__main__", "live"}
MAY_IMPORT_NODES = {"nodes", "harness", "emulated", "live"}
ROS = {
    "action_msgs", "ament_index_python", "builtin_interfaces", "dfm_interfaces", "diagnostic_msgs",
    "geometry_msgs", "launch", "launch_ros", "lifecycle_msgs", "rcl_interfaces", "rclpy",
    "rosgraph_msgs", "rosidl_runtime_py", "rpyutils", "sensor_msgs", "std_msgs", "std_srvs",
}  # fmt: skip


def modules(root: Path) -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in sorted((root / PACKAGE).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(module: str, path: Path) -> Iterator[str]:
    """Dotted names that a module imports anywhere in it; `from a import b` counts as a and a.b."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *filter(None, [base])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def part_of(module: str) -> str:
    """`model` of `dfm_stage.model.base`; empty for the package itself."""
    return module.split(".")[1] if "." in module else ""


def violations(root: Path) -> list[str]:
    """What breaks the rule, one line each."""
    known = modules(root)
    uses = {
        module: {name for name in imports(module, path) if name != module}
        for module, path in known.items()
    }
    ours = {module: {name for name in names if name in known} for module, names in uses.items()}
    direct_ros = {
        module for module, names in uses.items() if any(n.split(".")[0] in ROS for n in names)
    }
    out = []
    for module in known:
        part = part_of(module)
        if part not in ARROWS and part not in ANYTHING and part:
            out.append(f"{module}: no rule for {part}, add it to ARROWS")
        for name in sorted(ours[module]):
            other = part_of(name)
            if other in ("", part):
                continue
            if other == "nodes" and part not in MAY_IMPORT_NODES:
                out.append(f"{module} imports {name}: only the harness imports nodes")
            elif part in ARROWS and other not in ARROWS[part]:
                out.append(f"{module} imports {name}: {part} must not know {other}")
        if module in direct_ros and part not in WITH_ROS:
            out.append(f"{module} imports ROS: only nodes and harness do")
        if part in PURE and (reached := reach(module, ours) & direct_ros - {module}):
            out.append(f"{module} reaches ROS through {', '.join(sorted(reached))}")
    return out


def reach(module: str, ours: dict[str, set[str]]) -> set[str]:
    """Every module of ours that importing `module` loads, parent packages included."""
    todo, seen = [module], set()
    while todo:
        name = todo.pop()
        if name in seen:
            continue
        seen.add(name)
        parents = [name.rsplit(".", depth)[0] for depth in range(1, name.count(".") + 1)]
        todo += [*ours.get(name, ()), *(parent for parent in parents if parent in ours)]
    return seen


def test_the_arrows_point_one_way() -> None:
    assert violations(ROOT) == []


def test_pure_packages_import_where_ros_cannot_be_imported() -> None:
    names = [module for module in modules(ROOT) if part_of(module) in PURE]
    code = f"""
import importlib, sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {ROS!r}:
            raise ImportError(f"ROS is out of bounds here: {{name}}")
sys.meta_path.insert(0, Refuse())
for name in {names!r}:
    importlib.import_module(name)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("file", "source", "complaint"),
    [
        ("model/plant.py", "from dfm_stage.recording import record", "model must not know record"),
        ("model/plant.py", "import dfm_stage.identification.fit", "model must not know ident"),
        ("recording/bag.py", "from ..model import plant", "recording must not know model"),
        ("trajectory/scan.py", "import rclpy", "trajectory.scan imports ROS"),
        (
            "cli/demo.py",
            "def main():\n    from std_msgs.msg import Header",
            "cli.demo imports ROS",
        ),
        ("cli/demo.py", "from dfm_stage.nodes import base", "only the harness imports nodes"),
        ("cli/demo.py", "from dfm_stage import nodes", "only the harness imports nodes"),
        ("model/plant.py", "from dfm_stage import errors", "model.plant reaches ROS through"),
        ("plumbing.py", "", "no rule for plumbing"),
    ],
)
def test_the_rule_can_fail(tmp_path: Path, file: str, source: str, complaint: str) -> None:
    for module in ("model/plant", "recording/record", "identification/fit", "nodes/base"):
        for path in (tmp_path / PACKAGE, (tmp_path / PACKAGE / module).parent):
            path.mkdir(parents=True, exist_ok=True)
            (path / "__init__.py").touch()
        (tmp_path / PACKAGE / f"{module}.py").touch()
    errors = "import rclpy" if "errors" in source else ""
    (tmp_path / PACKAGE / "errors.py").write_text(errors)
    (tmp_path / PACKAGE / "nodes/base.py").write_text("import rclpy\nfrom .. import model")
    (tmp_path / PACKAGE / "harness.py").write_text(
        "import rclpy\nfrom dfm_stage.nodes import base"
    )
    if not errors:
        assert violations(tmp_path) == []
    (tmp_path / PACKAGE / file).parent.mkdir(exist_ok=True)
    (tmp_path / PACKAGE / file).write_text(source)
    assert any(complaint in line for line in violations(tmp_path)), violations(tmp_path)
