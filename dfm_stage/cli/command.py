"""What the commands have in common: how they begin and end, what they read, where they write."""

from __future__ import annotations

import argparse
import contextlib
import functools
import importlib.util
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TextIO

from dfm_stage import __version__
from dfm_stage.errors import CheckFailedError, DfmError
from dfm_stage.files import write_whole
from dfm_stage.share import door, needs_ros

Option = tuple[tuple[str, ...], dict[str, Any]]
Group = tuple[str, Sequence[Option]]
"""Options under a title of their own."""
Options = Sequence[Option | Group]
Work = Callable[[argparse.Namespace], int]
Graph = Callable[[argparse.Namespace], object]
"""Whether what is asked for runs nodes."""
Tone = Literal["good", "warn", "bad"]
TONES: dict[str, Tone] = {"none": "good", "retune": "good", "named": "good", "ambiguous": "warn",
                          "unknown": "bad", "partial": "warn", "not_excited": "warn"}
"""How good news each verdict of the diagnosis is."""
_CODES = {"good": "32", "warn": "33", "bad": "31"}
_made: list[Path] = []


def paint(text: str, tone: Tone, stream: TextIO | None = None) -> str:
    """Return text in a colour where `stream` (default: stdout) is a terminal that shows colours.

    NO_COLOR, if it is set to anything, and TERM=dumb turn them off (https://no-color.org).
    """
    if (not (stream or sys.stdout).isatty() or os.environ.get("NO_COLOR")
            or os.environ.get("TERM") == "dumb"):
        return text
    return f"\x1b[{_CODES[tone]}m{text}\x1b[0m"


class NoRosError(DfmError):
    """Nodes are to run where there is no ROS 2."""


def command(name: str, description: str | None, epilog: str, options: Options,
            graph: Graph = lambda _: False
            ) -> Callable[[Work], Callable[[Sequence[str] | None], int]]:
    """Make a function of its options a command: `main(argv)` that ends as `run_command` does.

    The help ends with the epilog as it is written. What needs the node `graph` is refused at once
    where there is no ROS 2.
    """
    parser = command_parser(name, description, epilog, options)

    def decorate(work: Work) -> Callable[[Sequence[str] | None], int]:
        @functools.wraps(work)
        def main(argv: Sequence[str] | None = None) -> int:
            given = parser.parse_args(argv)
            return run_command(lambda: work(_possible(name, given, bool(graph(given)))))

        main.parser = parser  # type: ignore[attr-defined]
        return main

    return decorate


def _possible(name: str, options: argparse.Namespace, graph: bool) -> argparse.Namespace:
    if graph and importlib.util.find_spec("rclpy") is None:
        raise NoRosError(needs_ros(name))
    return options


def run_command(work: Callable[[], int]) -> int:
    """Do the work and return its exit code; 2 with one line for an error of ours, 1 for a
    CheckFailedError, 130 with one line, the interrupt's own if it has one, after Ctrl-C. An output
    folder that stayed empty is taken away again."""
    try:
        return work()
    except DfmError as error:
        print(f"{paint('error:', 'bad', sys.stderr)} {error}", file=sys.stderr)
        return 1 if isinstance(error, CheckFailedError) else 2
    except KeyboardInterrupt as stop:
        print(str(stop) or "stopped", file=sys.stderr)
        return 130
    finally:
        while _made:
            with contextlib.suppress(OSError):
                _made.pop(0).rmdir()


def option(*flags: str, **settings: Any) -> Option:
    """Return an option or argument of a command, as `ArgumentParser.add_argument` takes it."""
    return flags, settings


def json_option(file: str) -> Option:
    """Return the option that prints a command's result as JSON."""
    return option("--json", action="store_true", help=f"print {file}, nothing else")


SEED = option("--seed", type=int, default=0, help="fixes the noise (default: 0)")
PROCESSES = option("--processes", action="store_true",
                   help="one process per node instead of all in this one")
NO_REPORT = option("--no-report", action="store_true", help="do not write report.html")


def command_parser(name: str, description: str | None, epilog: str,
                   options: Options) -> argparse.ArgumentParser:
    """A parser of these options whose help ends with examples, set as they are written."""
    parser = argparse.ArgumentParser(prog=name, description=description,
                                     epilog=epilog.replace("./run", door()),
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version",
                        version=f"{name} {__version__} (dfm_stage)")
    for flags, settings in options:
        where, entries = ((parser, ((flags, settings),)) if isinstance(settings, dict)
                          else (parser.add_argument_group(str(flags)), settings))
        for names, how in entries:
            where.add_argument(*names, **how)
    return parser


def names_in(items: Sequence[str]) -> list[str]:
    """The names in repeated options of names between commas."""
    return [name.strip() for item in items for name in item.split(",") if name.strip()]


def output_folder(path: str | Path) -> Path:
    """Make the folder that results go to.

    Raises
    ------
    DfmError
        If it cannot be made.
    """
    out = Path(path)
    _made.extend(each for each in (out, *out.parents) if not each.exists())
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DfmError(f"{out}: cannot be made a folder ({error.strerror}); choose another "
                       "with --out") from None
    return out


def dated_folder(given: str | None, kind: str) -> Path:
    """The folder that was given, else one of this kind that is named by date and time."""
    return Path(given or f"{kind}/{datetime.now().astimezone():%Y%m%d_%H%M%S}")


def new_folder(path: str | Path) -> Path:
    """Make a folder for results, or take an empty one.

    Raises
    ------
    DfmError
        If something is there already or it cannot be made.
    """
    out = Path(path)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DfmError(f"{out} is not empty; choose another folder with --out")
    return output_folder(out)


def write_output(path: Path, content: str | bytes) -> None:
    """Write a result, whole or not at all.

    Raises
    ------
    DfmError
        If it cannot be written.
    """
    try:
        write_whole(path, content)
    except OSError as error:
        raise DfmError(f"{path}: cannot be written ({error.strerror}); choose another folder "
                       "with --out") from None


def write_json(path: Path, content: Any) -> str:
    """Write a result as JSON, whole or not at all, and return the text.

    Raises
    ------
    DfmError
        If it cannot be written.
    """
    text = json_text(content)
    write_output(path, text)
    return text


def json_text(content: Any) -> str:
    """Return a result as JSON."""
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """Plain data in which numbers that are not finite, which JSON lacks, have become None."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
