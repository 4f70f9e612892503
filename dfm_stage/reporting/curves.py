"""The curves of a plot, read off the figure itself, so that every plot has them: as CSV, and as
what the page's script needs to find their values under the pointer."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
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
POINTS_PER_INCH = 72.0
"""Unit of an SVG that matplotlib writes."""


@dataclass(frozen=True)
class Curve:
    """A line of a plot, its name, and the columns of the CSV that hold it.

    `x` is None for a line across a whole panel, such as a noise floor: it is a single value.
    """

    line: Line2D
    name: str
    x: int | None
    y: int


def curves_of(figure: Figure) -> list[list[Curve]]:
    """Return the curves of each panel; those over the same abscissa share its column."""
    panels: list[list[Curve]] = []
    column = 0
    for axes in figure.axes:
        panel: list[Curve] = []
        last: Curve | None = None
        for name, line in _labelled(axes):
            across = line.get_transform() != axes.transData
            if across:
                panel.append(Curve(line, name, None, column))
            elif last is not None and np.array_equal(line.get_xdata(orig=False),
                                                     last.line.get_xdata(orig=False)):
                panel.append(Curve(line, name, last.x, column))
            else:
                last = Curve(line, name, column, column + 1)
                panel.append(last)
            column = panel[-1].y + 1
        panels.append(panel)
    return panels


def curves_csv(figure: Figure) -> str:
    """Return what a plot draws, one pair of columns a curve, as far as it has points.

    Columns are named by curve and axis. Values are those of the axes, with their units; long
    signals are thinned as drawn.
    """
    columns: list[list[str]] = []
    for axes, panel in zip(figure.axes, curves_of(figure), strict=True):
        below = axes.get_xlabel() or figure.axes[-1].get_xlabel()
        for curve in panel:
            x = _cells(axes.xaxis, curve.line.get_xdata(orig=False))
            y = _cells(axes.yaxis, curve.line.get_ydata(orig=False))
            if curve.x is None:
                y = [y[0]] if y[0] == y[-1] else [x[0]]
            elif curve.x == len(columns):
                columns.append([below, *x])
            columns.append([f"{curve.name}, {axes.get_ylabel()}" if curve.name
                            else axes.get_ylabel(), *y])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(zip_longest(*columns, fillvalue=""))
    return text.getvalue()


def panels_of(figure: Figure, prefix: str) -> list[dict[str, Any]]:
    """Return where the panels of a figure just drawn lie in its SVG, their axes, and the columns
    of their curves; and how the elements are named there: `panel_id`, with `prefix`."""
    width, height = (POINTS_PER_INCH * each for each in figure.get_size_inches())
    found = []
    for number, (axes, panel) in enumerate(zip(figure.axes, curves_of(figure), strict=True)):
        place = axes.get_position()
        box = [place.x0 * width, height - place.y1 * height,
               place.width * width, place.height * height]
        found.append({
            "id": f"{prefix}-panel{number}", "box": [round(each, 2) for each in box],
            "x": _axis(axes.xaxis), "y": _axis(axes.yaxis),
            "curves": [[f"{prefix}-curve{curve.y}", curve.x, curve.y] for curve in panel
                       if curve.x is not None]})
    return found


def name_elements(figure: Figure) -> None:
    """Give panels, axes and curves the ids that `panels_of` speaks of."""
    for number, (axes, panel) in enumerate(zip(figure.axes, curves_of(figure), strict=True)):
        axes.set_gid(f"panel{number}")
        axes.xaxis.set_gid(f"panel{number}-x")
        axes.yaxis.set_gid(f"panel{number}-y")
        for curve in panel:
            curve.line.set_gid(f"curve{curve.y}")


def _axis(axis: Axis) -> dict[str, Any]:
    words = _words(axis)
    return {"limits": [float(each) for each in axis.get_view_interval()],
            "scale": axis.get_scale(),
            **({"words": {word: place for place, word in words.items()}} if words else {})}


def _labelled(axes: Axes) -> Iterator[tuple[str, Line2D]]:
    """Lines with a name: their own, or that of an earlier panel's line in the same colour."""
    names = {line.get_color(): str(line.get_label()) for other in reversed(axes.figure.axes)
             for line in other.lines if not str(line.get_label()).startswith("_")}
    # error bars keep the label of their line to themselves
    bars = {each.lines[0]: each for each in axes.containers if hasattr(each, "lines")}
    for line in axes.lines:
        own = str(bars.get(line, line).get_label())
        yield names.get(line.get_color(), "") if own.startswith("_") else own, line


def _words(axis: Axis) -> dict[float, str]:
    """Ticks that stand in the place of numbers."""
    from matplotlib.ticker import FixedLocator

    if not isinstance(axis.get_major_locator(), FixedLocator):
        return {}
    places = [float(place) for place in axis.get_majorticklocs()]
    return dict(zip(places, axis.get_major_formatter().format_ticks(places), strict=True))


def _cells(axis: Axis, values: Any) -> list[str]:
    """Numbers as text; where ticks with words stand in their place, these."""
    words = _words(axis)
    return [words.get(float(value)) or f"{value:.{DIGITS}g}" if np.isfinite(value) else ""
            for value in np.asarray(values, dtype=float)]
