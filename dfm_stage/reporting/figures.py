"""The plots that several reports share, each with the table of what it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.quantity import display_unit, superscript_power
from dfm_stage.reporting.drawing import SERIES, new_figure, page_style
from dfm_stage.reporting.table import Cell, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TABLE_ROWS = 20
_PLOT_POINTS = 1500
_DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)))     # lines that lie on one another stay visible


@dataclass(frozen=True)
class Drawing:
    """A figure and the table of figures behind it."""

    figure: Figure
    table: Table | None = None


@dataclass(frozen=True)
class Response:
    """A frequency response to plot: arrays of shape (F,).

    `std` is the standard deviation of the complex response (of either part's sum, as identify
    gives it); it is drawn as a band of 1.96 relative standard deviations about the points.
    `measured` chooses points rather than a line.
    """

    label: str
    frequency_hz: Array
    response: Complex
    std: Array | None = None
    measured: bool = False


def bode_figure(responses: Sequence[Response], *, unit: str = "m/V",
                height_in: float = 4.6) -> Drawing:
    """Return magnitude and phase of one or more frequency responses over frequency in Hz.

    The phase is unwrapped from the lowest frequency on. The table lists up to 20 frequencies of
    the first response and every response interpolated there.
    """
    from matplotlib.ticker import MultipleLocator

    factor, shown = display_unit((max(float(np.max(np.abs(r.response))) for r in responses),),
                                 unit)
    figure, (top, bottom) = new_figure(2, height_in, sharex=True, height_ratios=(3, 2))
    with page_style():
        lines = iter(_DASHES)
        for colour, r in zip(_colours(len(responses)), responses, strict=True):
            magnitude, phase = np.abs(r.response) * factor, _phase_deg(r.response)
            marks: dict[str, Any] = ({"linestyle": "", "marker": "o", "markersize": 2.6,
                                      "alpha": 0.75} if r.measured
                                     else {"linewidth": 1.5, "linestyle": next(lines, "-")})
            top.loglog(r.frequency_hz, magnitude, color=colour, label=r.label, **marks)
            bottom.semilogx(r.frequency_hz, phase, color=colour, **marks)
            if r.std is not None:
                _bands(top, bottom, colour, r.frequency_hz, magnitude, phase, r.std * factor)
        top.set_ylabel(f"magnitude ({shown})")
        bottom.set(xlabel="frequency (Hz)", ylabel="phase (°)")
        bottom.yaxis.set_major_locator(MultipleLocator(90.0))
        log_labels(top.yaxis, bottom.xaxis)
        top.legend(loc="best")
        figure.align_ylabels()
    return Drawing(figure, _bode_table(responses, factor, shown))


def time_figure(time_s: Array, panels: Sequence[tuple[str, str, Mapping[str, Array]]], *,
                height_in: float | None = None) -> Drawing:
    """Return signals over time, one panel below the other.

    Parameters
    ----------
    time_s : (N,) array
        Common time base, s.
    panels : sequence of (title, unit, {label: (N,) array})
        The unit is SI; the display prefix is chosen per panel. Long signals are drawn by their
        extremes in each of some hundred intervals, so no peak is lost.
    """
    height = height_in if height_in is not None else 0.6 + 1.75 * len(panels)
    figure, axes = new_figure(len(panels), height, sharex=True, squeeze=False)
    rows: list[list[Cell]] = []
    with page_style():
        for axis, (title, unit, signals) in zip(axes[:, 0], panels, strict=True):
            peak = max((float(np.nanmax(np.abs(s))) for s in signals.values()), default=0.0)
            factor, shown = display_unit((peak,), unit)
            under = {"linewidth": 2.4, "alpha": 0.55}
            for colour, (label, signal) in zip(_colours(len(signals)), signals.items(),
                                               strict=True):
                t, y = thinned(np.asarray(time_s), np.asarray(signal) * factor)
                first = len(signals) > 1 and not axis.lines
                axis.plot(t, y, color=colour, label=label,
                          **(under if first else {"linewidth": 1.1}))
                rows.append([f"{title}: {label}" if label != title else title,
                             *statistics(np.asarray(signal) * factor), shown])
            axis.set_ylabel(f"{title} ({shown})" if shown else title)
            if len(signals) > 1:
                axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1,
                            ncols=min(3, len(signals)))
            axis.margins(x=0.0)
        axes[-1, 0].set_xlabel("time (s)")
        figure.align_ylabels()
    return Drawing(figure, Table(("signal", "mean", "RMS", "min", "max", "unit"), rows))


def statistics(signal: Array) -> list[Cell]:
    """Return mean, RMS, smallest and largest of a signal (N,), for a table."""
    return [float(np.nanmean(signal)), float(np.sqrt(np.nanmean(signal**2))),
            float(np.nanmin(signal)), float(np.nanmax(signal))]


def _bode_table(responses: Sequence[Response], factor: float, unit: str) -> Table:
    first = responses[0]
    chosen = np.unique(np.linspace(0, first.frequency_hz.size - 1,
                                   min(_TABLE_ROWS, first.frequency_hz.size)).round().astype(int))
    columns = ["frequency (Hz)"]
    cells: list[Array] = [first.frequency_hz[chosen]]
    for r in responses:
        columns += [f"{r.label} ({unit})", f"{r.label} (°)"]
        for values in (np.abs(r.response) * factor, _phase_deg(r.response)):
            cells.append(np.interp(cells[0], r.frequency_hz, values, np.nan, np.nan))
    rows: list[list[Cell]] = [[float(value) for value in row] for row in zip(*cells, strict=True)]
    return Table(columns, rows)


def _bands(top: Axes, bottom: Axes, colour: str, frequency: Array, magnitude: Array,
           phase: Array, std: Array) -> None:
    spread = 1.96 * std / np.sqrt(2.0)
    turn = np.degrees(np.arctan2(spread, magnitude))
    top.fill_between(frequency, np.maximum(magnitude - spread, 1e-3 * magnitude),
                     magnitude + spread, color=colour, alpha=0.22, linewidth=0)
    bottom.fill_between(frequency, phase - turn, phase + turn, color=colour, alpha=0.22,
                        linewidth=0)


def _phase_deg(response: Complex) -> Array:
    return np.asarray(np.degrees(np.unwrap(np.angle(response))), dtype=np.float64)


def thinned(t: Array, y: Array) -> tuple[Array, Array]:
    """Return a long signal, both (N,), by its extremes in each of some hundred intervals.

    No peak is lost, and none appears.
    """
    if t.size <= 2 * _PLOT_POINTS:
        return t, y
    edges = np.linspace(0, t.size, _PLOT_POINTS // 2 + 1).astype(int)
    keep = {0, t.size - 1}
    for low, high in pairwise(edges):
        part = y[low:high]
        if np.isfinite(part).any():
            keep.update((low + int(np.nanargmin(part)), low + int(np.nanargmax(part))))
    index = np.array(sorted(keep))
    return t[index], y[index]


def _colours(count: int) -> list[str]:
    return [SERIES[i % len(SERIES)] for i in range(count)]


def log_labels(*axes: Any) -> None:
    """Write the powers of ten of logarithmic axes as plain text, and nothing between them."""
    for axis in axes:
        axis.set_major_formatter(lambda value, _: superscript_power(value))
        axis.set_minor_formatter("")
