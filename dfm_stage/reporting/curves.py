"""The curves of a plot as CSV, read off the figure itself, so that every plot has them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

DIGITS = 5
"""Significant digits: a plot shows three."""


def curves_csv(figure: Figure) -> str:
    """Return what a plot draws, one pair of columns a curve, as far as it has points.

    Columns are named by curve and axis. Curves of one panel over the same abscissa share its
    column. A line across a whole panel, such as a noise floor, is a single value. Values are
    those of the axes, with their units; long signals are thinned as drawn.
    """
    columns: list[list[str]] = []
    for axes in figure.axes:
        below = axes.get_xlabel() or figure.axes[-1].get_xlabel()
        last: list[str] = []
        for label, line in _labelled(axes):
            x = _cells(axes.xaxis, line.get_xdata(orig=False))
            y = _cells(axes.yaxis, line.get_ydata(orig=False))
            across = line.get_transform() != axes.transData
            if across:
                x, y = [], [y[0]] if y[0] == y[-1] else [_cells(
                    axes.xaxis, line.get_xdata(orig=False))[0]]
            elif x != last:
                last = x
                columns.append([below, *x])
            columns.append([f"{label}, {axes.get_ylabel()}" if label else axes.get_ylabel(), *y])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(zip_longest(*columns, fillvalue=""))
    return text.getvalue()


def _labelled(axes: Axes) -> Iterator[tuple[str, Line2D]]:
    """Lines with a name: their own, or that of an earlier panel's line in the same colour."""
    names = {line.get_color(): str(line.get_label()) for other in reversed(axes.figure.axes)
             for line in other.lines if not str(line.get_label()).startswith("_")}
    for line in axes.lines:
        own = str(line.get_label())
        yield names.get(line.get_color(), "") if own.startswith("_") else own, line


def _cells(axis: Axis, values: Any) -> list[str]:
    """Numbers as text; where ticks with words stand in their place, these."""
    from matplotlib.ticker import FixedLocator

    words: dict[float, str] = {}
    if isinstance(axis.get_major_locator(), FixedLocator):
        places = [float(place) for place in axis.get_majorticklocs()]
        words = dict(zip(places, axis.get_major_formatter().format_ticks(places), strict=True))
    return [words.get(float(value)) or f"{value:.{DIGITS}g}" if np.isfinite(value) else ""
            for value in np.asarray(values, dtype=float)]
