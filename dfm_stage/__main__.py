"""python -m dfm_stage NAME [arguments]: every node and tool by its name."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from dfm_stage.commands import NODES, TOOLS, listing, module_of, unknown
from dfm_stage.errors import DfmError

ROS_MODULES = ("rclpy", "dfm_interfaces")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one node or tool; its exit code, or 2 with one line on stderr when it cannot start."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print("\n".join(listing("usage: python -m dfm_stage NAME [arguments]",
                                ("tools", TOOLS), ("nodes", NODES))))
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
        return _refuse(unknown(name, [*NODES, *TOOLS], "--help lists the names"))
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


def _refuse(message: str) -> int:
    print(f"dfm_stage: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
