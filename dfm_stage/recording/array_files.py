"""Arrays that other programs saved: NumPy .npz and MATLAB .mat files as tables."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.files import write_whole
from dfm_stage.recording.errors import RecordError, writing
from dfm_stage.recording.record import FloatArray, Record
from dfm_stage.recording.table import columns_of

# Names of the sample period and of the rate, with the power that makes it a period.
_PERIODS = {**dict.fromkeys(("sample_period", "sample_time", "ts", "dt"), 1),
            **dict.fromkeys(("sample_rate", "sampling_rate", "fs"), -1)}


class ArrayTable:
    """Named arrays of equal length; a matrix gives one column for each of its shorter side.

    A scalar named `fs`, `Ts`, `dt`, `sample_rate` or `sample_period` is the sample rate or period.
    """

    def __init__(self, path: Path, kind: str, arrays: Mapping[str, Any]) -> None:
        self.path, self.kind = path, kind
        self.warnings: list[str] = []
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
            return ArrayTable(path, "npz", {name: file[name] for name in file.files})
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise RecordError(f"cannot be read as .npz ({_line(error)})", path) from error


def load_mat(path: Path) -> ArrayTable:
    """Open a .mat file of MATLAB up to version 7.2; raises RecordError if it is none.

    Structures give dotted names; the X and Y signals of a dSPACE export their own names.
    """
    import scipy.io
    from scipy.io.matlab import MatReadError

    try:
        content = scipy.io.loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise RecordError("is a MATLAB 7.3 file; save it with "
                          "save(..., '-v7')", path) from error
    except (OSError, ValueError, TypeError, KeyError, IndexError, MatReadError) as error:
        raise RecordError(f"cannot be read as .mat ({_line(error)})", path) from error
    return ArrayTable(path, "mat", dict(_flat({name: value for name, value in content.items()
                                               if not name.startswith("__")})))


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
    scipy.io.savemat(content, dict(columns_of(record)), oned_as="column", do_compression=True)
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
        for signal in signals if isinstance(signals, (list, np.ndarray)) else [signals]:
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
            return float(array.item()) ** power
    return None
