"""The plots that several reports share, each with the table of what it shows, and their SVG, whose
colours follow the page, light or dark."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from itertools import cycle, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.quantity import display_unit, superscript_power
from dfm_stage.reporting.curves import name_elements, panels_of
from dfm_stage.reporting.table import Cell, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours that stand for a variable of the page's style sheet; matplotlib needs a number.
INK, SOFT, GRID, PAPER = "#010101", "#020202", "#030303", "#040404"
SERIES = ("#050501", "#050502", "#050503", "#050504", "#050505", "#050506")
_VARIABLES = {INK: "ink", SOFT: "soft", GRID: "grid", PAPER: "paper",
              **{colour: f"c{i}" for i, colour in enumerate(SERIES, 1)}}

WIDE_IN, NARROW_IN = 7.6, 3.7
_STYLE: dict[str, Any] = {
    "svg.fonttype": "none", "font.size": 9.0, "font.family": "sans-serif",
    "text.color": INK, "axes.labelcolor": INK, "axes.titlecolor": INK, "axes.edgecolor": SOFT,
    "xtick.color": SOFT, "ytick.color": SOFT, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "grid.color": GRID, "grid.linewidth": 0.7, "axes.grid": True, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.8,
    "axes.facecolor": "none", "figure.facecolor": "none", "savefig.facecolor": "none",
    "lines.linewidth": 1.4, "lines.markersize": 3.5, "legend.frameon": False,
    "legend.fontsize": 9.0, "axes.titlesize": 9.5, "axes.titlelocation": "left",
    "axes.unicode_minus": True, "path.simplify": True, "path.simplify_threshold": 0.3,
    "text.parse_math": False,
}
_TABLE_ROWS = 12
_PLOT_POINTS = 1500
_DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)))     # lines that lie on one another stay visible


@contextmanager
def page_style() -> Iterator[None]:
    """Draw inside this so that a figure's text, grid and series take the page's colours."""
    import matplotlib as mpl
    from cycler import cycler
    style: Any = {**_STYLE, "axes.prop_cycle": cycler(color=list(SERIES))}
    with mpl.rc_context(style):
        yield


def new_figure(rows: int = 1, height_in: float = 3.0, **subplots: Any) -> tuple[Figure, Any]:
    """Return (figure, axes) in the page's style; axes as `matplotlib.pyplot.subplots` gives them.

    No window system and no global state of pyplot is involved.
    """
    from matplotlib.figure import Figure
    with page_style():
        figure = Figure(figsize=(WIDE_IN, height_in), layout="constrained")
        axes = figure.subplots(rows, **subplots)
    return figure, axes


def to_svg(figure: Figure, prefix: str, label: str, width_in: float | None = None) -> str:
    """Return the figure as an <svg> element without a fixed size.

    `prefix` keeps its ids apart from those of other figures on the page; `label` is what a screen
    reader says. The same figure gives the same text every time. `data-panels` tells the page's
    script where the curves are.
    """
    (width, height), dpi = figure.get_size_inches(), figure.dpi
    buffer = io.StringIO()
    with page_style():
        import matplotlib as mpl
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        _plain_decades(figure)
        name_elements(figure)
        try:
            if width_in is not None:
                figure.set_size_inches(width_in, max(height * 0.9, 2.2))
            # savefig() would draw twice, the first time only to lay the figure out
            with mpl.rc_context({"svg.hashsalt": prefix}):
                canvas: Any = FigureCanvasSVG(figure)
                canvas.print_svg(buffer, metadata={"Date": None, "Creator": None})
            panels = json.dumps(panels_of(figure, prefix), ensure_ascii=False,
                                separators=(",", ":"))
        finally:
            figure.set_size_inches(width, height)
            figure.set_dpi(dpi)
    return _inline(buffer.getvalue(), prefix, label, panels)


def _plain_decades(figure: Figure) -> None:
    """Write 0.1, 1, 10 at logarithmic axes, whose own labels are mathematical text."""
    from matplotlib.ticker import LogFormatter, LogFormatterMathtext

    class Plain(LogFormatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(axis.get_major_formatter(), LogFormatterMathtext):
                axis.set_major_formatter(Plain())
                axis.set_minor_formatter(Plain(labelOnlyBase=False))


def _inline(text: str, prefix: str, label: str, panels: str) -> str:
    svg = text[text.index("<svg"):].strip()
    changes: list[tuple[str, Any]] = [
        (r"<metadata>.*?</metadata>", ""), (r"<!--.*?-->\n?", ""),
        (r'\b(id|xlink:href)="(#?)', rf'\1="\2{prefix}-'), ("xlink:href=", "href="),
        (r"url\(#", f"url(#{prefix}-"),
        *((colour, f"var(--{variable})") for colour, variable in _VARIABLES.items()),
        (r"font: ([\d.]+px) [^;\"]*", r"font-size: \1"), (r" ?font-family: [^;\"]*;?", ""),
        (r'\b(d|x|y|transform)="([^"]*)"', _rounded),
        (r'<g clip-path="([^"]*)">\s*((?:<use [^>]*/>\s*)+)</g>', _shared_style)]
    for pattern, replacement in changes:
        svg = re.sub(pattern, replacement, svg, flags=re.DOTALL)
    box = re.search(r'viewBox="[^"]*"', svg)
    head = (f'<svg role="img" aria-label="{escape(label)}" {box.group(0) if box else ""} '
            f'data-panels="{escape(panels)}">')
    return head + svg[svg.index(">") + 1:]


def _rounded(attribute: re.Match[str]) -> str:
    """Keep two decimals of a coordinate: 1/7000 of an inch."""
    def short(number: re.Match[str]) -> str:
        return f"{float(number.group()):.2f}".rstrip("0").rstrip(".")
    name, value = attribute.groups()
    return f'{name}="{re.sub(r"-?[0-9]+[.][0-9]{3,}", short, value)}"'


def _shared_style(group: re.Match[str]) -> str:
    """Give the markers of a line their style once instead of at every point."""
    clip, markers = group.groups()
    styles = set(re.findall(r' style="([^"]*)"', markers))
    if len(styles) != 1:
        return group.group()
    bare = re.sub(r' style="[^"]*"|\n\s*', "", markers)
    return f'<g clip-path="{clip}" style="{styles.pop()}">{bare}</g>'


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

    The phase is unwrapped from the lowest frequency on. The table lists up to 12 frequencies of
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
        The unit is SI; the display prefix is chosen per panel. A label has the same colour in
        every panel. Long signals are drawn by their extremes in each of some hundred intervals,
        so no peak is lost.
    """
    height = height_in if height_in is not None else 0.6 + 1.75 * len(panels)
    figure, axes = new_figure(len(panels), height, sharex=True, squeeze=False)
    rows: list[list[Cell]] = []
    known: dict[str, str] = {}
    with page_style():
        for axis, (title, unit, signals) in zip(axes[:, 0], panels, strict=True):
            taken = {known[label] for label in signals if label in known}
            free = cycle([colour for colour in SERIES if colour not in taken] or SERIES)
            peak = max((float(np.nanmax(np.abs(s))) for s in signals.values()), default=0.0)
            factor, shown = display_unit((peak,), unit)
            under = {"linewidth": 2.4, "alpha": 0.55}
            for label, signal in signals.items():
                if label not in known:
                    known[label] = next(free)
                colour = known[label]
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
    """Return mean, RMS, smallest and largest of a signal (N,), for a table.

    What is smaller than four digits of the largest show, such as the mean of a residual that has
    none, is 0.
    """
    found = [float(each) for each in (np.nanmean(signal), np.sqrt(np.nanmean(signal**2)),
                                      np.nanmin(signal), np.nanmax(signal))]
    least = 1e-4 * max(map(abs, found), default=0.0)
    return [each if abs(each) > least else 0.0 for each in found]


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
