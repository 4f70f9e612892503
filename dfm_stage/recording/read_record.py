"""One door for every kind of file that can become a record."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dfm_stage.recording.errors import RecordError, in_file
from dfm_stage.recording.formats import MAGIC, STORAGES
from dfm_stage.recording.parts import filled, without_gaps
from dfm_stage.recording.record import AxisRecord, FloatArray, Record
from dfm_stage.recording.table import Options, Table, table_record
from dfm_stage.recording.table_files import CsvTable, load_mat, load_npz

GAPS = ("longest", "mask", "fill")
_TABLES: dict[str, Callable[[Path], Table]] = {
    "npz": load_npz, "mat": load_mat, "csv": CsvTable}
WHOLE_BYTES = 1 << 23
_END_BYTES = 1 << 20
# What lies beyond these can be read and still looks wrong.
LONGEST_PERIOD_S = 0.1
SHORTEST_PERIOD_S = 2e-6
LARGEST_TRAVEL_M = 0.5
LARGEST_INPUT_V = 500.0
SPIKE = 30.0


def read_record(
    path: str | os.PathLike[str], *, axis: str | None = None, time: str | None = None,
    input: str | None = None, output: str | None = None,  # noqa: A002 named as the option is
    time_unit: str | None = None, input_unit: str | None = None, output_unit: str | None = None,
    sample_period: float | None = None, gaps: str = "longest", input_hold: str | None = None,
    input_shift: float | None = None,
) -> Record:
    """Read a record from a bag folder, an .mcap (cut off or not) or .db3 file, CSV, .npz or .mat.

    Parameters
    ----------
    axis : str, optional
        Only this axis. With `input` and `output` given: the name of the axis they make.
    time, input, output : str, optional
        Names of columns that are not named as in `time_s,input_v,position_m`. For `input`, `none`
        stands for zeros: nothing drove the stage. Of a bag: fields,
        as `/joint_states.effort[0]`, and as time one of `header`, `publish` and `arrival`, or a
        field; by default the stamps of the headers, where there are none those of the transport.
    time_unit, input_unit, output_unit : str, optional
        Their units, where the names do not say; lengths, times, volts and amperes become SI,
        others are carried.
    sample_period : float, optional
        s; takes the place of the time column, or of the period that a bag's stamps show.
    gaps : str
        What becomes of a record with samples missing. `longest` keeps the longest stretch without
        a gap. `mask` keeps all and puts NaN where nothing is known. `fill` fills in up to two
        samples in a row and then keeps the longest stretch.
    input_hold : str, optional
        What the input does between its samples, one of `record.HOLDS`; by default it is to be
        estimated. Where samples are moved to even times, an input that stands keeps its integral;
        another is interpolated.
    input_shift : float, optional
        Samples by which the input acts later than its column says; by default to be estimated.

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
    options = Options(axis, time, input, output, time_unit, input_unit, output_unit,
                      sample_period, "mask" if gaps == "fill" else gaps, input_hold, input_shift)
    kind = _kind(where)
    record = (_from_bag(where, options) if kind == "bag" else
              table_record(_TABLES[kind](where), options, fingerprint(where)))
    record.warnings.extend(doubts(record))
    return without_gaps(filled(record)) if gaps == "fill" else record


def _from_bag(path: Path, options: Options) -> Record:
    # who reads tables does not wait for the readers of bags
    from dfm_stage.recording.bag_fields import FieldPath
    from dfm_stage.recording.bag_join import joined_record
    from dfm_stage.recording.bag_reader import read_bag
    from dfm_stage.recording.bag_record import bag_record, topics_of

    if options.names_columns:
        with in_file(path):
            topics = {FieldPath.parse(each).topic for each in (options.input, options.output)
                      if each is not None}
        record = joined_record(read_bag(path, topics), options)
    else:
        if options != Options(axis=options.axis, sample_period=options.sample_period,
                              gaps=options.gaps, input_hold=options.input_hold,
                              input_shift=options.input_shift):
            raise RecordError("is a bag: name the fields of input and output, as --input "
                              "/joint_states.effort[0], or give neither times nor units", path)
        record = bag_record(read_bag(path, topics_of(options.axis)), options.axis,
                            options.sample_period, options.gaps)
        record = _with_convention(record, options.input_hold, options.input_shift)
    return replace(record, provenance=replace(record.provenance,
                                              fingerprint=fingerprint(_first_file(path))))


def _with_convention(record: Record, hold: str | None, shift: float | None) -> Record:
    return replace(record, axes={name: replace(each, input_hold=hold, input_shift=shift)
                                 for name, each in record.axes.items()})


def _first_file(bag: Path) -> Path:
    """The file of a bag whose fingerprint stands for it."""
    if not bag.is_dir():
        return bag
    return min(file for file in bag.iterdir() if file.suffix in STORAGES.values())


def _kind(path: Path) -> str:
    if path.is_dir():
        return "bag"
    try:
        with path.open("rb") as file:
            start = file.read(64)
    except OSError as error:
        raise RecordError(f"cannot be read ({error.strerror})", path) from error
    return next((kind for kind, suffix, magic in (
        ("bag", ".mcap", MAGIC), ("bag", ".db3", b"SQLite format 3\0"),
        ("npz", ".npz", b"PK\x03\x04"), ("mat", ".mat", b"MATLAB "))
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


def doubts(record: Record) -> list[str]:
    """Return a sentence for everything in the record that looks wrong."""
    found = []
    if record.sample_period > LONGEST_PERIOD_S:
        name, unit = ("micro", "us") if record.sample_period > 20 else ("milli", "ms")
        found.append(f"the sample period reads as {record.sample_period:.4g} s; if the time is in "
                     f"{name}seconds, name the column time_{unit} (or say --time-unit {unit})")
    if record.sample_period < SHORTEST_PERIOD_S:
        found.append(f"the sample period reads as {record.sample_period:.4g} s; if the time is in "
                     f"seconds, name the column time_s (or say --time-unit s)")
    return found + [f"axis {name}: {text}" if len(record.axes) > 1 else text
                    for name, axis in record.axes.items()
                    for text in _axis_doubts(axis)]


def _spikes(position: FloatArray, what: str, unit: str) -> list[str]:
    """Samples that lie far off both neighbours, which lie together."""
    if len(position) < 20:
        return []
    off = position[1:-1] - 0.5 * (position[:-2] + position[2:])
    apart = np.abs(position[2:] - position[:-2])
    usual = max(float(np.quantile(np.abs(off), 0.9)), float(np.quantile(apart, 0.9)))
    places = np.flatnonzero((np.abs(off) > SPIKE * usual) & (np.abs(off) > 5.0 * apart)) + 1
    if not len(places) or usual == 0.0:
        return []
    more = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return [(f"the {what} jumps and comes back at sample {places[0]}{more} "
             f"({position[places[0]]:.4g} {unit}); empty cells would count as missing samples")]


def _axis_doubts(axis: AxisRecord) -> list[str]:
    found = []
    what, unit = axis.measures, axis.output_unit
    drive = axis.input[np.isfinite(axis.input)]
    position = axis.position[np.isfinite(axis.position)]
    if not len(drive) or not len(position):
        return [f"there is not one sample with both input and {what}"]
    if np.ptp(drive) == 0:
        found.append(f"the input is constant ({drive[0]:.4g} {axis.input_unit}); only what "
                     f"happens without excitation can be seen")
    if np.ptp(position) == 0:
        found.append(f"the {what} is constant ({position[0]:.6g} {unit}); is the "
                     f"encoder connected, and is this the right column?")
    found += _spikes(position, what, unit)
    travel = float(np.ptp(position))
    if unit == "m" and travel > LARGEST_TRAVEL_M:
        name, unit = ("micro", "um") if travel > 20 else ("milli", "mm")
        found.append(f"the position spans {travel:.4g} m; if the column is in {name}metres, name "
                     f"it position_{unit} (or say --output-unit {unit})")
    largest = float(np.abs(drive).max())
    if axis.input_unit == "V" and largest > LARGEST_INPUT_V:
        found.append(f"the input reaches {largest:.4g} V; if the column is in millivolts, name it "
                     f"input_mv (or say --input-unit mV)")
    return found
