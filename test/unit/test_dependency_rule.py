"""Who may import whom, held against the sources, and shown to be able to fail."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest

from dfm_stage.commands import module_of

ROOT = Path(__file__).parents[2]
PACKAGE = "dfm_stage"

# part: the other parts of ours it may import, or start as a command
BASE = {"arrays", "decisions", "errors", "files", "machine_code", "processors", "quantity",
        "share", "transforms", "yaml_text"}
RECORDS = BASE | {"model", "recording", "identification"}
LOOP = BASE | {"model", "trajectory", "control", "recording", "drivers"}
PURE: dict[str, set[str]] = {
    "arrays": set(),
    "decisions": {"errors"},
    "errors": set(),
    "files": set(),
    "interruption": set(),
    "machine_code": set(),
    "processors": set(),
    "quantity": set(),
    "share": {"errors"},
    "transforms": {"arrays"},
    "yaml_text": {"errors"},
    "commands": {"nodes", "cli"},  # their names, as text, for the entry point
    "model": BASE,
    "recording": BASE,
    "compile_all": BASE | {"model", "recording"},
    "reporting": BASE,
    "drivers": BASE,
    "trajectory": BASE | {"model"},
    "control": BASE | {"model"},
    "identification": BASE | {"model", "recording"},
    "diagnosis": RECORDS | {"trajectory"},
    "comparison": RECORDS | {"diagnosis"},
    "paper": RECORDS | {"trajectory", "control", "reporting"},
}
TOOLS = {*PURE, "harness", "live"} - {"commands"}
WITH_ROS: dict[str, set[str]] = {
    "middleware": BASE,
    "nodes": LOOP | {"middleware", "interruption"},
    "harness": LOOP | {"middleware", "nodes", "compile_all", "interruption"},
    "live": BASE | {"middleware", "nodes", "reporting"},
    "__main__": {"commands", "errors", "interruption", "share"},
}
ARROWS = {**PURE, **WITH_ROS, "cli": TOOLS}
CIRCLES: set[frozenset[str]] = set()
"""Modules that import each other and should not: none, and none to be added."""
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


def imports(module: str, path: Path, alone: Collection[str] = ()) -> Iterator[str]:
    """Dotted names that a module imports anywhere in it.

    `from a import b` counts as a and a.b; where a.b is among the modules `alone`, as a.b only.
    """
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *filter(None, [base])])
            names = [f"{base}.{alias.name}" for alias in node.names]
            yield from names
            if not all(name in alone for name in names):
                yield base


def starts(module: str, path: Path, known: set[str]) -> Iterator[str]:
    """Modules of ours that a module names in a text or starts as a command.

    In `[..., "-m", "dfm_stage", name]` a name that is not written out is a node's: `NodeSet`
    starts those. A text that ends in a gap, as f"dfm_stage.nodes.{name}", names the package.
    """
    tree = ast.parse(path.read_text(), str(path))
    for node in ast.walk(tree):
        if isinstance(node, (ast.List, ast.Tuple)):
            for flag, door, name in zip(node.elts, node.elts[1:], node.elts[2:]):  # noqa: B905
                if _text(flag) == "-m" and _text(door) == PACKAGE:
                    yield module_of(_text(name)) if _text(name) else f"{PACKAGE}.nodes"
        text = _text(node).rstrip(".")
        if text.startswith(f"{PACKAGE}.") and text in known and not f"{module}.".startswith(
            f"{text}."  # its own package: a registry looks for its neighbours
        ):
            yield text


def _text(node: ast.AST) -> str:
    if isinstance(node, ast.JoinedStr):
        node = node.values[0]
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


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
    started = {module: set(starts(module, path, set(known))) for module, path in known.items()}
    direct_ros = {
        module for module, names in uses.items() if any(n.split(".")[0] in ROS for n in names)
    }
    out = []
    for module in known:
        part = part_of(module)
        if part not in ARROWS and part:
            out.append(f"{module}: no rule for {part}, add it to ARROWS")
        for verb, names in (("imports", ours[module]), ("starts", started[module])):
            for name in sorted(names):
                other = part_of(name)
                if other not in ("", part) and other not in ARROWS.get(part, ()):
                    out.append(f"{module} {verb} {name}: {part} must not know {other}")
        if module in direct_ros and part not in WITH_ROS:
            out.append(f"{module} imports ROS: only {', '.join(WITH_ROS)} do")
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


def circles(root: Path) -> set[frozenset[str]]:
    """Groups of modules each of which reaches the others, by imports anywhere and by starts.

    `from package import module` is an import of the module alone.
    """
    known = modules(root)
    graph = {
        module: known.keys()
        & {*imports(module, path, alone=set(known)), *starts(module, path, set(known))}
        for module, path in known.items()
    }
    below = {module: _below(module, graph) for module in graph}
    return {
        frozenset(other for other in below[module] if module in below[other])
        for module in graph
        if module in below[module] and below[module] != {module}
    } - {frozenset({module}) for module in graph}


def _below(module: str, graph: dict[str, set[str]]) -> set[str]:
    seen: set[str] = set()
    todo = list(graph[module])
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += graph[name]
    return seen


def test_the_arrows_point_one_way() -> None:
    assert violations(ROOT) == []


def test_no_modules_go_round_in_a_circle() -> None:
    assert circles(ROOT) == CIRCLES


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
        ("cli/demo.py", "from dfm_stage.nodes import base", "cli must not know nodes"),
        ("cli/demo.py", "from dfm_stage import nodes", "cli must not know nodes"),
        ("model/plant.py", "from dfm_stage import errors", "model.plant reaches ROS through"),
        ("plumbing.py", "", "no rule for plumbing"),
        (
            "model/plant.py",
            'run([sys.executable, "-m", "dfm_stage", "diagnose"])',
            "model.plant starts dfm_stage.cli.diagnose: model must not know cli",
        ),
        (
            "control/pid.py",
            'run([sys.executable, "-m", "dfm_stage", kind, *rest])',
            "control must not know nodes",
        ),
        (
            "model/plant.py",
            'import_module(f"dfm_stage.recording.{name}")',
            "model.plant starts dfm_stage.recording: model must not know recording",
        ),
        ("drivers/port.py", 'MAIN = "dfm_stage.nodes.base"', "drivers must not know nodes"),
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
        "import rclpy\nfrom dfm_stage.nodes import base\n"
        'run([sys.executable, "-m", "dfm_stage", kind])'
    )
    if not errors:
        assert violations(tmp_path) == []
    (tmp_path / PACKAGE / file).parent.mkdir(exist_ok=True)
    (tmp_path / PACKAGE / file).write_text(source)
    assert any(complaint in line for line in violations(tmp_path)), violations(tmp_path)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("from dfm_stage.cli import b", "def f():\n    from dfm_stage.cli.a import x"),
        ("import dfm_stage.cli.b", 'run([python, "-m", "dfm_stage.cli.a"])'),
        ("from dfm_stage.cli.b import x", 'import_module("dfm_stage.cli.a")'),
    ],
)
def test_a_circle_is_seen(tmp_path: Path, first: str, second: str) -> None:
    folder = tmp_path / PACKAGE / "cli"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    (folder / "a.py").write_text(first)
    (folder / "b.py").touch()
    assert circles(tmp_path) == set()
    (folder / "b.py").write_text(second)
    assert circles(tmp_path) == {frozenset({"dfm_stage.cli.a", "dfm_stage.cli.b"})}


def walked() -> list[str]:
    """The steps of a record from file to report, as docs/architecture.md draws them."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    line = next(block for block in page.split("```") if "recording/record ->" in block)
    return [f"{PACKAGE}." + step.strip().replace("/", ".") for step in line.split("->")]


def test_the_path_of_a_record_is_one_line() -> None:
    steps, files = walked(), modules(ROOT)
    assert set(steps) <= set(files)
    back = {(name, other) for place, name in enumerate(steps)
            for other in imports(name, files[name]) if other in steps[place + 1:]}
    assert back == set()
