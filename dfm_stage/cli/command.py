"""What the commands have in common: how they end, where they write, what records they read."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.cli.colour import paint
from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole

if TYPE_CHECKING:
    from dfm_stage.recording import Record

_COLUMNS = ("time", "input", "output")
_made: list[Path] = []


def run_command(work: Callable[[], int], stopped: str = "stopped") -> int:
    """Do the work and return its exit code; 2 with one line for an error of ours, 130 with the
    line `stopped` after Ctrl-C. An output folder that stayed empty is taken away again."""
    try:
        return work()
    except DfmError as error:
        print(f"{paint('error:', 'bad', sys.stderr)} {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(stopped, file=sys.stderr)
        return 130
    finally:
        while _made:
            with contextlib.suppress(OSError):
                _made.pop(0).rmdir()


def command_parser(name: str, description: str | None, epilog: str) -> argparse.ArgumentParser:
    """A parser whose help ends with examples, set as they are written."""
    return argparse.ArgumentParser(prog=name, description=description, epilog=epilog,
                                   formatter_class=argparse.RawDescriptionHelpFormatter)


def add_column_options(parser: argparse.ArgumentParser) -> None:
    """Add what `read_with` needs to know of a foreign CSV file."""
    table = parser.add_argument_group("CSV files with other column names")
    for name in _COLUMNS:
        table.add_argument(f"--{name}", metavar="COLUMN")
    for name in _COLUMNS:
        table.add_argument(f"--{name}-unit", metavar="UNIT")
    table.add_argument("--sample-period", type=float, metavar="SECONDS")


def read_with(options: argparse.Namespace, path: str, axis: str | None = None) -> Record:
    """Read a record by the options of `add_column_options`.

    Raises
    ------
    DfmError
        If it cannot be read.
    """
    from dfm_stage.recording import read_record

    return read_record(path, axis=axis, time=options.time, input=options.input,
                       output=options.output, time_unit=options.time_unit,
                       input_unit=options.input_unit, output_unit=options.output_unit,
                       sample_period=options.sample_period)


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


def write_output(path: Path, text: str) -> None:
    """Write a result, whole or not at all.

    Raises
    ------
    DfmError
        If it cannot be written.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise DfmError(f"{path}: cannot be written ({error.strerror}); choose another folder "
                       "with --out") from None


def finite(value: Any) -> Any:
    """Plain data in which numbers that are not finite, which JSON lacks, have become None."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
