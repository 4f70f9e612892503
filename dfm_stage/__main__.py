"""dfm-stage NAME [arguments], or python -m dfm_stage: every node and tool by its name."""

from __future__ import annotations

from dfm_stage.interruption import INTERRUPTED, as_usual, end_at_once, interrupted, work_is_over

if __name__ == "__main__":
    end_at_once()  # before the imports, which take the time

import gc
import importlib
import io
import os
import re
import select
import sys
from collections.abc import Sequence

from dfm_stage import __version__
from dfm_stage.commands import NODES, ON_NODES, TOOLS, listing, module_of, unknown
from dfm_stage.errors import DfmError
from dfm_stage.share import needs_ros

ROS_MODULES = re.compile(r"rclpy|rpyutils|launch|ament_\w+|\w+_(msgs|srvs|interfaces)")
COLLECTIONS = 200_000, 20, 100
"""When the garbage collector looks for cycles: usually it does so again and again while modules
load, which takes a tenth of a short command's time and finds nothing."""
READER_GONE = 141
"""128 + SIGPIPE, which is what shells see of a program whose reader has left (`| head`)."""


def entry() -> int:
    """Run `main` as the whole of a process; the name is that of the script where it is known.

    A signal ends it without a traceback at any moment, and so does a reader of its output that
    leaves.
    """
    end_at_once()
    gc.set_threshold(*COLLECTIONS)
    if isinstance(sys.stdout, io.TextIOWrapper):    # what Windows pipes has no superscripts
        sys.stdout.reconfigure(errors="replace")
    script = os.path.basename(sys.argv[0])
    try:
        try:
            return main([script, *sys.argv[1:]] if script in {**NODES, **TOOLS} else None)
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        if not _reader_gone():
            raise
        return READER_GONE
    except Exception:
        if not interrupted():
            raise
        return INTERRUPTED
    finally:
        work_is_over()
        gc.freeze()         # the end of the process frees all of it


def _reader_gone() -> bool:
    """Return whether nobody reads our output any more; what is left of it then goes nowhere."""
    gone = False
    for stream in (sys.stdout, sys.stderr):
        if stream is None:
            continue
        if hasattr(select, "poll"):
            look = select.poll()
            look.register(stream.fileno(), 0)
            if not any(found & select.POLLERR for _, found in look.poll(0)):
                continue
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        gone = True
    return gone


def main(argv: Sequence[str] | None = None) -> int:
    """Run one node or tool; its exit code, or 2 with one line on stderr when it cannot start."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        alone = {name: text for name, text in TOOLS.items() if name not in ON_NODES}
        print("\n".join(listing("usage: dfm-stage NAME [arguments]     (NAME --help says more)",
                                ("tools", alone),
                                ("tools that run nodes, with ROS 2",
                                 {name: TOOLS[name] for name in ON_NODES}),
                                ("nodes, with ROS 2", NODES))))
        return 0
    if arguments[0] == "--version":
        print(f"dfm-stage {__version__}")
        return 0
    try:
        return _run(arguments[0], arguments[1:])
    except DfmError as error:
        return _refuse(str(error))
    except KeyboardInterrupt:
        return INTERRUPTED


def _run(name: str, rest: list[str]) -> int:
    try:
        module_name = module_of(name)
    except KeyError:
        return _refuse(unknown(name, [*NODES, *TOOLS], "--help lists the names"))
    sys.argv = [name, *rest]
    try:
        module = importlib.import_module(module_name)
        if name in TOOLS:
            as_usual()
        return int(module.main(rest) or 0)
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
    sys.exit(entry())
