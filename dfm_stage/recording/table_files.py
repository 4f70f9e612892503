"""Tables in files: CSV in and out, NumPy .npz and MATLAB .mat files."""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.files import write_whole
from dfm_stage.recording.errors import RecordError, writing
from dfm_stage.recording.mat_file import LARGEST_BYTES, MatError, NewerMatError, read_mat
from dfm_stage.recording.record import FloatArray, Record

_DELIMITERS = ",;\t"
_COMMENTS = ("#", "%")
# Names of the sample period and of the rate, with the power that makes it a period.
_PERIODS = {**dict.fromkeys(("sample_period", "sample_time", "ts", "dt"), 1),
            **dict.fromkeys(("sample_rate", "sampling_rate", "fs"), -1)}


class CsvTable:
    """A CSV file: the first line that is not a comment names the columns.

    Comma, semicolon or tab between cells; with the latter two a decimal comma is understood.
    Empty cells and `nan` are missing values.

    Raises
    ------
    RecordError
        If it cannot be read or has no header.
    """

    kind = "csv"
    sample_period: float | None = None

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        text = _text(path)
        lines = text.splitlines()
        kept = [number for number, line in enumerate(lines)
                if line.strip() and not line.lstrip().startswith(_COMMENTS)]
        if not kept:
            raise RecordError("is empty; the first line must name the columns, like "
                              "time_s,input_v,position_m", path)
        header = lines[kept[0]]
        self.delimiter = max(_DELIMITERS, key=header.count)
        if header.count(self.delimiter) == 0:
            raise RecordError(f"line {kept[0] + 1} has one column only; separate columns "
                              f"by commas, semicolons or tabs", path)
        self.names: Sequence[str] = [cell.strip() for cell in self._row(header, f"line "
                                     f"{kept[0] + 1}")]
        self._check_names(kept[0] + 1)
        self._lines = np.array(kept[1:], np.int64) + 1
        self._rows = [lines[number] for number in kept[1:]]
        if self._rows and (self._rows[-1].count(self.delimiter) < header.count(self.delimiter)
                           or (not text.endswith(("\n", "\r")) and self._last_is_cut())):
            self.warnings.append(f"line {self._lines[-1]}, the last one, was cut off and left out")
            self._rows.pop()

    def _row(self, text: str, where: str) -> list[str]:
        try:
            return next(csv.reader([text], delimiter=self.delimiter), [])
        except csv.Error as error:
            raise RecordError(f"{where}: {error}", self.path) from None

    def _check_names(self, line: int) -> None:
        if all(_is_number(name) for name in self.names if name):
            raise RecordError(f"line {line} holds numbers; the first line must name "
                              f"the columns, like time_s,input_v,position_m", self.path)
        twice = {name for name, count in Counter(self.names).items() if name and count > 1}
        if twice:
            raise RecordError(f"line {line} names the column {min(twice)} twice; "
                              f"rename one", self.path)

    def _last_is_cut(self) -> bool:
        """Whether the last cell, which no line end follows, is shorter than all before it, or
        has lost the exponent that most of them have."""
        *others, last = (row.rpartition(self.delimiter)[2].strip().lower() for row in self._rows)
        return bool(others) and (
            len(last) < min(map(len, others))
            or ("e" not in last and 2 * sum("e" in cell for cell in others) > len(others)))

    def where(self, row: int) -> str:
        """Return the line a row stands in, counted from 1."""
        return f"line {self._lines[row]}"

    def columns(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """Return columns as floats; raises RecordError with the line of a cell that is none."""
        if not self._rows:
            raise RecordError("has a header and no rows", self.path)
        places = [self.names.index(name) for name in names]
        try:
            values = np.loadtxt(self._rows, delimiter=self.delimiter, usecols=places, ndmin=2,
                                comments=None, quotechar='"', dtype=np.float64)
        except ValueError:
            values = np.array([self._cells(row, places) for row in range(len(self._rows))])
        return {name: values[:, k].copy() for k, name in enumerate(names)}

    def _cells(self, row: int, places: Sequence[int]) -> list[float]:
        cells = self._row(self._rows[row], self.where(row))
        numbers = []
        for place in places:
            if place >= len(cells):
                raise RecordError(f"{self.where(row)} has {len(cells)} cells and "
                                  f"the header {len(self.names)}; complete or remove it",
                                  self.path)
            cell = cells[place].strip()
            if self.delimiter != "," and cell.count(",") == 1 and "." not in cell:
                cell = cell.replace(",", ".")
            if not _is_number(cell or "nan"):
                raise RecordError(f"{self.where(row)}, column {self.names[place]}: "
                                  f"{cell[:40]!r} is not a number", self.path)
            numbers.append(float(cell or "nan"))
        return numbers


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordError(f"cannot be read ({error.strerror})", path) from error
    if b"\0" in data[:4096]:
        raise RecordError("is not a text file; give a CSV file, a bag, .npz or .mat", path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def write_csv(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record as CSV that `read_record` reads back, whole or not at all.

    Columns: `time_s`, and for each axis `input_v`, `position_m`, `current_a`, `reference_m` as far
    as there are, prefixed by the axis name where there are several axes.

    Raises
    ------
    BagWriteError
        If the file cannot be written.
    """
    columns = record.columns()
    rows = zip(*(array.tolist() for array in columns.values()), strict=True)
    with writing(path):
        write_whole(path, "\n".join((",".join(columns),
                                     *(",".join("" if value != value else repr(value)
                                                for value in row) for row in rows), "")))


class ArrayTable:
    """Named arrays of equal length; a matrix gives one column for each of its shorter side.

    A scalar named `fs`, `Ts`, `dt`, `sample_rate` or `sample_period` is the sample rate or period.
    """

    def __init__(self, path: Path, kind: str, arrays: Mapping[str, Any]) -> None:
        self.path, self.kind = path, kind
        self.warnings: list[str] = []
        arrays = {name: each for name, each in arrays.items() if isinstance(each, np.ndarray)}
        self.sample_period = _sample_period(arrays)
        self._columns = dict(_columns(arrays))
        self.names: Sequence[str] = list(self._columns)
        if not self._columns:
            raise RecordError("holds no arrays of numbers", path)

    def where(self, row: int) -> str:
        """Return the index of a row, counted from 0."""
        return f"index {row}"

    def columns(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """Return columns as floats; raises RecordError if they differ in length."""
        chosen = {name: self._columns[name].astype(np.float64) for name in names}
        if len(set(map(len, chosen.values()))) > 1:
            raise RecordError("the arrays differ in length: " + ", ".join(
                f"{name} {len(values)}" for name, values in chosen.items()), self.path)
        return chosen


def load_npz(path: Path) -> ArrayTable:
    """Open an .npz file; raises RecordError if it is none."""
    try:
        with np.load(path, allow_pickle=False) as file:
            _check_sizes(file)
            arrays = {name: file[name] for name in file.files}
    except Exception as error:  # damaged headers make the reader raise errors of every kind
        raise RecordError(f"cannot be read as .npz ({_line(error)})", path) from error
    return ArrayTable(path, "npz", arrays)


def _check_sizes(file: Any) -> None:
    """Raise ValueError if the arrays of an open .npz file would fill the memory."""
    if not hasattr(file, "zip"):
        raise ValueError("it holds one array without a name")
    size = sum(member.file_size for member in file.zip.infolist())
    if size > LARGEST_BYTES:
        raise ValueError(f"it expands to {size / 2**30:.3g} GiB, more than "
                         f"{LARGEST_BYTES >> 30}")


def load_mat(path: Path) -> ArrayTable:
    """Open a .mat file of MATLAB up to version 7.2; raises RecordError if it is none.

    Structures give dotted names; the X and Y signals of a dSPACE export their own names.
    """
    try:
        content = read_mat(path.read_bytes())
    except NewerMatError as error:
        raise RecordError("is a MATLAB 7.3 file; save it with "
                          "save(..., '-v7')", path) from error
    except (OSError, MatError) as error:
        raise RecordError(f"cannot be read as .mat ({_line(error)})", path) from error
    return ArrayTable(path, "mat", dict(_flat(content)))


def write_mat(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record as a .mat file of MATLAB 5 to 7 that `read_record` reads back, whole or not
    at all; the variables are the columns of `write_csv`.

    Raises
    ------
    BagWriteError
        If the file cannot be written.
    """
    import scipy.io

    content = io.BytesIO()
    scipy.io.savemat(content, dict(record.columns()), oned_as="column", do_compression=True)
    with writing(path):
        write_whole(path, content.getvalue())


def write_npz(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record as an .npz file that `read_record` reads back, whole or not at all; the
    arrays are the columns of `write_csv`.

    Raises
    ------
    BagWriteError
        If the file cannot be written.
    """
    content = io.BytesIO()
    np.savez(content, **record.columns())  # type: ignore[arg-type]
    with writing(path):
        write_whole(path, content.getvalue())


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, Mapping) and {"X", "Y"} <= set(value):
            yield from _dspace(value)
        elif isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _dspace(capture: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """A dSPACE capture: X holds the time, Y a signal or a list of them."""
    for key in ("X", "Y"):
        signals = capture[key]
        for signal in (np.atleast_1d(signals) if isinstance(signals, np.ndarray)
                       else signals if isinstance(signals, list) else [signals]):
            if isinstance(signal, Mapping) and "Data" in signal:
                name = signal.get("Name", "")
                name = name.split("/")[-1].strip('"') if isinstance(name, str) else ""
                yield "time_s" if key == "X" else name, signal["Data"]


def _columns(arrays: Mapping[str, Any]) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    for name, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind not in "biuf" or array.size < 2 or array.ndim > 2:
            continue
        array = array.squeeze()
        if array.ndim == 1:
            yield name, array
        elif array.ndim == 2:
            table = array if array.shape[0] >= array.shape[1] else array.T
            yield from ((f"{name}[{k}]", table[:, k]) for k in range(table.shape[1]))


def _sample_period(arrays: Mapping[str, Any]) -> float | None:
    for name, value in arrays.items():
        array, power = np.asarray(value), _PERIODS.get(name.lower())
        if power and array.size == 1 and array.dtype.kind in "iuf" and array.item() > 0:
            number = float(array.item())
            return number if power > 0 else 1.0 / number
    return None
