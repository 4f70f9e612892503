"""From a matplotlib figure to inline SVG whose colours follow the page, light or dark."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
    reader says. The same figure gives the same text every time.
    """
    from html import escape
    width, height = figure.get_size_inches()
    buffer = io.StringIO()
    with page_style():
        import matplotlib as mpl
        _plain_decades(figure)
        try:
            if width_in is not None:
                figure.set_size_inches(width_in, max(height * 0.9, 2.2))
            with mpl.rc_context({"svg.hashsalt": prefix}):
                figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        finally:
            figure.set_size_inches(width, height)
    return _inline(buffer.getvalue(), prefix, escape(label, quote=True))


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


def _inline(text: str, prefix: str, label: str) -> str:
    svg = text[text.index("<svg"):].strip()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->\n?", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\b(id|xlink:href)="(#?)', rf'\1="\2{prefix}-', svg)
    svg = svg.replace("xlink:href=", "href=")
    svg = re.sub(r"url\(#", f"url(#{prefix}-", svg)
    for colour, variable in _VARIABLES.items():
        svg = svg.replace(colour, f"var(--{variable})")
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", svg)
    svg = re.sub(r" ?font-family: [^;\"]*;?", "", svg)
    svg = re.sub(r'\b(d|x|y|transform)="([^"]*)"', _rounded, svg)
    svg = re.sub(r'<g clip-path="([^"]*)">\s*((?:<use [^>]*/>\s*)+)</g>', _shared_style, svg)
    box = re.search(r'viewBox="[^"]*"', svg)
    head = f'<svg role="img" aria-label="{label}" {box.group(0) if box else ""}>'
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
