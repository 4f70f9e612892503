"""One door for every kind of file that can become a record."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from dfm_stage.recording.array_files import load_mat, load_npz
from dfm_stage.recording.bag_reader import read_bag
from dfm_stage.recording.bag_record import bag_record, topics_of
from dfm_stage.recording.csv_file import CsvTable
from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.mcap_scan import MAGIC
from dfm_stage.recording.plausibility import doubts
from dfm_stage.recording.record import Record
from dfm_stage.recording.table import Options, Table, table_record

GAPS = ("longest", "mask")
_TABLES: dict[str, Callable[[Path], Table]] = {
    "npz": load_npz, "mat": load_mat, "csv": CsvTable}
WHOLE_BYTES = 1 << 23
_END_BYTES = 1 << 20


def read_record(
    path: str | os.PathLike[str], *, axis: str | None = None, time: str | None = None,
    input: str | None = None, output: str | None = None,  # noqa: A002 named as the option is
    time_unit: str | None = None, input_unit: str | None = None, output_unit: str | None = None,
    sample_period: float | None = None, gaps: str = "longest",
) -> Record:
    """Read a record from a bag folder, an .mcap file (cut off or not), CSV, .npz or .mat.

    Parameters
    ----------
    axis : str, optional
        Only this axis. With `input` and `output` given: the name of the axis they make.
    time, input, output : str, optional
        Names of columns that are not named as in `time_s,input_v,position_m`.
    time_unit, input_unit, output_unit : str, optional
        Their units, where the names do not say; lengths, times, volts and amperes become SI,
        others are carried.
    sample_period : float, optional
        s; takes the place of the time column, or of the period that a bag's stamps show.
    gaps : str
        What becomes of a record with samples missing: `longest` keeps the longest stretch without
        a gap, `mask` keeps all and puts NaN where nothing is known.

    Returns
    -------
    Record
        `warnings` says everything that was found and done.

    Raises
    ------
    RecordingError
        If there is no usable record in it; the message is one line and names the place.
    """
    where = Path(path)
    if gaps not in GAPS:
        raise RecordError(f"gaps={gaps!r}: choose one of {', '.join(GAPS)}")
    kind = _kind(where)
    options = Options(axis, time, input, output, time_unit, input_unit, output_unit,
                      sample_period, gaps)
    if kind == "bag":
        if options != Options(axis=axis, sample_period=sample_period, gaps=gaps):
            raise RecordError("is a bag, whose topics say what they are; columns and "
                              "units (--time, --input, --output) are for tables", where)
        record = bag_record(read_bag(where, topics_of(axis)), axis, sample_period, gaps)
        first = min(where.glob("*.mcap")) if where.is_dir() else where
        record.warnings.extend(doubts(record))
        return replace(record, provenance=replace(record.provenance,
                                                  fingerprint=fingerprint(first)))
    record = table_record(_TABLES[kind](where), options, fingerprint(where))
    record.warnings.extend(doubts(record))
    return record


def _kind(path: Path) -> str:
    if path.is_dir():
        return "bag"
    try:
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise RecordError(f"cannot be read ({error.strerror})", path) from error
    return next((kind for kind, suffix, magic in (
        ("bag", ".mcap", MAGIC), ("npz", ".npz", b"PK\x03\x04"), ("mat", ".mat", b"MATLAB "))
        if path.suffix == suffix or start.startswith(magic)), "csv")


def fingerprint(path: Path) -> str:
    """Return `sha256:...` of a file's content.

    Of a file beyond WHOLE_BYTES only its size, its first and its last mebibyte are hashed
    (`sha256-ends:...`); a bag ends in checksums of everything in it.
    """
    size = path.stat().st_size
    digest = hashlib.sha256()
    with path.open("rb") as file:
        if size <= WHOLE_BYTES:
            digest.update(file.read())
            return f"sha256:{digest.hexdigest()}"
        digest.update(str(size).encode())
        digest.update(file.read(_END_BYTES))
        file.seek(size - _END_BYTES)
        digest.update(file.read(_END_BYTES))
    return f"sha256-ends:{digest.hexdigest()}"
