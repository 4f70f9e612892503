"""What the commands that set models beside records have in common."""

from __future__ import annotations

import argparse
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.cli.command import option, write_output
from dfm_stage.cli.records import read_with
from dfm_stage.errors import DfmError
from dfm_stage.model import Model
from dfm_stage.quantity import format_quantity
from dfm_stage.recording import Record
from dfm_stage.recording.units import column_unit

if TYPE_CHECKING:
    from dfm_stage.comparison import Simulation

RECORD_NAMES = option("records", nargs="+", metavar="RECORD",
                      help="bag folder, .mcap, .csv, .npz or .mat")
AXIS = option("--axis", metavar="NAME", help="axis, where a record or a model has several")


def read_all(options: argparse.Namespace, models: Sequence[Model],
             paths: Sequence[str]) -> dict[str, Record]:
    """Read records at the period of the models, by names that differ.

    Raises
    ------
    DfmError
        If one cannot be read, or the models step by different periods.
    """
    periods = {model.axis(options.axis or next(iter(model.axes), None)).sample_period
               for model in models}
    if len(periods) > 1:
        raise DfmError("the models step by different sample periods: "
                       f"{', '.join(f'{each:g} s' for each in sorted(periods))}")
    found: dict[str, Record] = {}
    for path in paths:
        name = Path(path).name or path
        found[path if name in found else name] = read_with(options, path, period=min(periods))
    return found


def said(found: Simulation) -> str:
    """RMS and fit in words."""
    share = found.fit_percent
    return (f"RMS {format_quantity(found.rms, found.unit)}, "
            f"{'at rest' if share is None else f'fit {share:.2f} %'}, "
            f"{found.measured.size} samples, the first {found.skipped} left out")


def columns(path: Path, time: Array, signals: Mapping[str, Array], unit: str) -> None:
    """Write signals (N,) of one unit over time (s) as CSV.

    Raises
    ------
    DfmError
        If it cannot be written.
    """
    text = io.StringIO()
    head = ",".join(("time_s", *(f"{name}_{column_unit(unit)}" for name in signals)))
    np.savetxt(text, np.column_stack((time, *signals.values())), fmt="%.9g", delimiter=",",
               header=head, comments="")
    write_output(path, text.getvalue())
