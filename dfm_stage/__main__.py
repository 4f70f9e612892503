"""dfm-stage NAME [arguments], or python -m dfm_stage: every node and tool by its name."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Sequence

from dfm_stage import __version__
from dfm_stage.commands import NODES, TOOLS, listing, module_of, unknown
from dfm_stage.errors import DfmError
from dfm_stage.share import needs_ros

ROS_MODULES = re.compile(r"rclpy|rpyutils|launch|ament_\w+|\w+_(msgs|srvs|interfaces)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one node or tool; its exit code, or 2 with one line on stderr when it cannot start."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print("\n".join(listing("usage: dfm-stage NAME [arguments]     (NAME --help says more)",
                                ("tools", TOOLS), ("nodes, with ROS 2", NODES))))
        return 0
    if arguments[0] == "--version":
        print(f"dfm-stage {__version__}")
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
    sys.argv = [name, *rest]
    try:
        return int(importlib.import_module(module_name).main(rest) or 0)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if ROS_MODULES.fullmatch(missing):
            return _refuse(needs_ros(name))
        return _refuse(f"{name} needs the Python module {missing}, which is not here: start it as "
                       f"./run {name} in a clone of the repository")


def _refuse(message: str) -> int:
    print(f"dfm_stage: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
