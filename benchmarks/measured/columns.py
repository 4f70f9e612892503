"""Columns of a record, and helpers of the readers of original files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import scipy.io
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = dict[str, Array]
Reader = Callable[[Path], dict[str, Columns]]


def timed(period: float, **columns: Array) -> Columns:
    """Columns with even time stamps."""
    size = len(next(iter(columns.values())))
    return {"time_s": period * np.arange(size),
            **{name: np.asarray(values, float) for name, values in columns.items()}}


def matlab(path: Path, name: str) -> NDArray[np.object_] | Array:
    return np.asarray(scipy.io.loadmat(path, squeeze_me=True)[name])


def parts_of(columns: Columns, parts: Mapping[str, slice]) -> dict[str, Columns]:
    """Parts of a run, cut out of all of its columns."""
    return {part: {name: values[cut] for name, values in columns.items()}
            for part, cut in parts.items()}
