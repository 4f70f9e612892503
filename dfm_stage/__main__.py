"""python -m dfm_stage NAME [arguments]: every node and tool by its name."""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Sequence

from dfm_stage.commands import NODES, TOOLS, module_of
from dfm_stage.errors import DfmError

ROS_MODULES = ("rclpy", "dfm_interfaces")


def usage() -> str:
    """The names with one line each."""
    lines = ["usage: python -m dfm_stage NAME [arguments]", ""]
    for title, group in (("tools", TOOLS), ("nodes", NODES)):
        lines.append(f"{title}:")
        lines += [f"  {name:22}{text.removeprefix('node: ')}" for name, text in group.items()]
        lines.append("")
    return "\n".join(lines).rstrip()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one node or tool; its exit code, or 2 with one line on stderr when it cannot start."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage())
        return 0
    try:
        return _run(arguments[0], arguments[1:])
    except DfmError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        return 130


def _run(name: str, rest: list[str]) -> int:
    try:
        module_name = module_of(name)
    except KeyError:
        return _refuse(_unknown(name))
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        if module_name == missing or module_name.startswith(f"{missing}."):
            return _refuse(f"{name!r} is not in this version (no module {module_name})")
        if missing.split(".")[0] in ROS_MODULES:
            return _refuse(
                f"{name} needs {missing}, which is not here: start it as ./run {name}, "
                "or source the workspace's install/setup.bash"
            )
        return _refuse(f"{name} needs the Python package {missing}: start it as ./run {name}")
    sys.argv = [name, *rest]
    return int(module.main(rest) or 0)


def _unknown(name: str) -> str:
    near = difflib.get_close_matches(name, [*NODES, *TOOLS], n=1, cutoff=0.5)
    remedy = f"did you mean {near[0]}?" if near else "--help lists the names"
    return f"there is no {name!r}: {remedy}"


def _refuse(message: str) -> int:
    print(f"dfm_stage: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
