"""Columns as a DataFrame of pandas or a Dataset of xarray, where these are installed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.recording.errors import MissingPackageError


def data_frame(columns: Mapping[str, Any], index: str, values: Any,
               about: Mapping[str, Any]) -> Any:
    """Return columns of N rows over an index (N,).

    A column of shape (N, k) becomes k columns `name[0]` and so on; one of sequences keeps an array
    in each row.

    Raises
    ------
    MissingPackageError
        If pandas is not installed.
    """
    pandas = _module("pandas")
    flat: dict[str, Any] = {}
    for name, column in columns.items():
        rows = _rows(column)
        if rows.ndim == 1:
            flat[name] = rows
        else:
            rows = rows.reshape(len(rows), -1)
            flat |= {f"{name}[{k}]": rows[:, k] for k in range(rows.shape[1])}
    frame = pandas.DataFrame(flat, index=pandas.Index(values, name=index))
    frame.attrs.update(about)
    return frame


def data_set(columns: Mapping[str, Any], index: str, values: Any, about: Mapping[str, Any],
             units: Mapping[str, str] | None = None) -> Any:
    """Return columns of N rows as variables over the dimension `index` (N,).

    A column of shape (N, k) has a second dimension `<name>_element`; one of sequences keeps an
    array in each row. `units` go to the attributes.

    Raises
    ------
    MissingPackageError
        If xarray is not installed.
    """
    xarray = _module("xarray")

    def variable(name: str, column: Any) -> tuple[tuple[str, ...], Array, dict[str, str]]:
        rows = _rows(column)
        inner = [f"{name}_element{number or ''}" for number in range(rows.ndim - 1)]
        unit = (units or {}).get(name, "")
        return (index, *inner), rows, {"units": unit} if unit else {}

    return xarray.Dataset({name: variable(name, column) for name, column in columns.items()},
                          {index: variable(index, values)}, dict(about))


def _rows(column: Any) -> Any:
    """An array whose first axis are the rows; of sequences, one of objects."""
    if isinstance(column, np.ndarray):
        return column
    rows = np.empty(len(column), object)
    for number in range(len(column)):
        rows[number] = column[number]
    return rows


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise MissingPackageError(f"to_{name} needs {error.name}, which is not installed: "
                                  f"pip install {name}") from None
