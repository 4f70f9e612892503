"""One self-contained HTML page, built from top to bottom.

On a desk a figure stands beside the text and tables that belong to it, and the contents beside
both; on a phone everything is one column. The order of the source is that of reading, so that the
page also reads aloud and prints.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from html import escape
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote

import numpy as np

from dfm_stage import __version__
from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole
from dfm_stage.reporting.curves import curves_csv
from dfm_stage.reporting.figures import NARROW_IN, Drawing, to_svg
from dfm_stage.reporting.style import STYLE
from dfm_stage.reporting.table import Cell, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tone = Literal["good", "warn", "bad", "plain"]
Kind = Literal["text", "figure", "table", "wide"]
MOST_BESIDE = 4
"""Columns up to which a table fits beside a figure."""
FEWEST_SECTIONS = 3
"""From how many sections on a page has a table of contents."""
PLOTS_SCRIPT = Path(__file__).parent / "plots.js"
IN_BRACKETS = re.compile(r"(\d[\d.]*)\((\d+)\)")


class ReportError(DfmError):
    """A report cannot be written."""


@dataclass
class _Section:
    """A heading and what stands below it, as (kind, HTML)."""

    title: str
    blocks: list[tuple[Kind, str]] = field(default_factory=list)

    def html(self, anchor: str) -> Iterator[str]:
        yield f'<section id="{anchor}">'
        if self.title:
            yield f"<h2>{escape(self.title)}</h2>"
        for row in self._rows():
            figure = next((html for kind, html in row if kind == "figure"), "")
            if not figure:
                yield from ('<div class="row">', *_beside(row), "</div>")
                continue
            before, after = _around(row)
            yield '<div class="row with-figure">'
            yield from ('<div class="before">', *before, "</div>") if before else ()
            yield figure
            yield from ('<div class="after">', *after, "</div>") if after else ()
            yield "</div>"
        yield "</section>"

    def _rows(self) -> Iterator[list[tuple[Kind, str]]]:
        """Blocks that stand side by side: what leads to a figure, the figure, what follows it."""
        row: list[tuple[Kind, str]] = []
        for block in self.blocks:
            full = any(kind == "figure" for kind, _ in row)
            if row and (block[0] == "wide" or (block[0] == "figure" and full)):
                yield row
                row = []
            row.append(block)
            if block[0] == "wide":
                yield row
                row = []
        if row:
            yield row


def _around(row: Sequence[tuple[Kind, str]]) -> tuple[list[str], list[str]]:
    """What stands before and after the figure of a row."""
    place = next(number for number, (kind, _) in enumerate(row) if kind == "figure")
    return [html for _, html in row[:place]], [html for _, html in row[place + 1:]]


def _beside(row: Sequence[tuple[Kind, str]]) -> Iterator[str]:
    """Tables, each with the text that follows it as one block, which may stand beside it."""
    for of_text, group in groupby(row, lambda block: block[0] == "text"):
        blocks = [html for _, html in group]
        if of_text and blocks[0] is not row[0][1]:
            yield from ('<div class="texts">', *blocks, "</div>")
        else:
            yield from blocks


class Page:
    """A report: title, verdict, sections of text, plots and tables, and where it all came from.

    Every method but `html` and `write` returns the page itself. All text is escaped; nothing on
    the page asks the network for anything.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self._sections = [_Section("")]
        self._provenance: dict[str, str] = {}
        self._figures = 0

    def lead(self, text: str, verdict: str = "", tone: Tone = "plain") -> Page:
        """Add the sentence that answers the reader's question, with a one-word verdict."""
        badge = f'<span class="badge {tone}">{escape(verdict)}</span>' if verdict else ""
        return self._add("text", f'<p class="lead">{badge}{escape(text)}</p>')

    def section(self, title: str, text: str = "") -> Page:
        """Start a section; a blank line in `text` starts a paragraph."""
        self._sections.append(_Section(title))
        return self.text(text) if text else self

    def text(self, text: str) -> Page:
        """Add paragraphs."""
        for paragraph in text.split("\n\n"):
            if paragraph.strip():
                self._add("text", f"<p>{escape(' '.join(paragraph.split()))}</p>")
        return self

    def note(self, text: str) -> Page:
        """Add a warning the reader must not miss."""
        return self._add("text", f'<p class="note">{escape(text)}</p>')

    def figure(self, figure: Figure | Drawing, caption: str, table: Table | None = None) -> Page:
        """Add a plot, its curves as CSV, and its figures in a table.

        A `Drawing` brings its table along, which folds out below the plot on a phone and stands
        beside it on a desk. The plot is drawn once for a wide page and once for a phone; the page
        shows the one that fits.
        """
        drawing = figure if isinstance(figure, Drawing) else Drawing(figure)
        table = table or drawing.table
        self._figures += 1
        number = f"f{self._figures}"
        wide = to_svg(drawing.figure, f"{number}w", caption)
        narrow = to_svg(drawing.figure, f"{number}n", caption, NARROW_IN)
        figures = (f"<details><summary>The figures behind this plot</summary>{table.html()}"
                   "</details>") if table is not None else ""
        data = quote(curves_csv(drawing.figure), safe=",:;()/")
        return self._add("figure", (
            f'<figure><div class="drawn"><div class="plot wide">{wide}</div>'
            f'<div class="plot narrow">{narrow}</div>'
            f'<figcaption>{escape(caption)} <a class="csv" download="figure_{self._figures}.csv" '
            f'href="data:text/csv;charset=utf-8,{data}">CSV</a></figcaption></div>'
            f"{figures}</figure>"))

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[Cell]],
              caption: str = "") -> Page:
        """Add a table; cells are text, numbers, `Quantity` (value and 95 % interval) or None."""
        return self._add("wide" if len(columns) > MOST_BESIDE else "table",
                         Table(columns, rows).html(caption))

    def provenance(self, entries: Mapping[str, object]) -> Page:
        """Add what the page was made from (bag, model, versions) to its foot."""
        self._provenance.update({str(key): str(value) for key, value in entries.items()})
        return self

    def html(self) -> str:
        """Return the whole page."""
        body = [line for number, section in enumerate(self._sections)
                for line in section.html(f"s{number}") if section.title or section.blocks]
        return "\n".join((
            '<!DOCTYPE html>', '<html lang="en">', "<head>", '<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(self.title)}</title>", f"<style>\n{STYLE}</style>", "</head>",
            "<body>", f"<h1>{escape(self.title)}</h1>", *self._contents(), "<main>", *body,
            "</main>", f"<footer><dl>{self._foot(body)}</dl></footer>", *self._script(),
            "</body>", "</html>", ""))

    def _contents(self) -> Iterator[str]:
        entries = [f'<li><a href="#s{number}">{escape(section.title)}</a></li>'
                   for number, section in enumerate(self._sections) if section.title]
        if len(entries) >= FEWEST_SECTIONS:
            yield f'<nav aria-label="Contents"><ol>{"".join(entries)}</ol></nav>'

    def _script(self) -> Iterator[str]:
        if self._figures:
            yield f"<script>\n{PLOTS_SCRIPT.read_text(encoding='utf-8')}</script>"

    def _foot(self, body: Sequence[str]) -> str:
        versions = f"Python {platform.python_version()}, NumPy {np.__version__}"
        foot = {**self._provenance, "Versions": f"dfm_stage {__version__}, {versions}",
                "Made": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")}
        shown = next((found for line in body if "<svg" not in line
                      for found in IN_BRACKETS.finditer(line)), None)
        if shown is not None:
            foot["Brackets"] = (f"{shown[0]}: the bracket is half the 95 % interval, in units of "
                                "the last digit")
        return "".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>"
                       for key, value in foot.items())

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page, whole or not at all, and return its path.

        Raises
        ------
        ReportError
            If the folder does not exist or cannot be written.
        """
        target = Path(path)
        try:
            write_whole(target, self.html())
        except OSError as error:
            raise ReportError(f"{target}: cannot write the report: {error.strerror}; choose a "
                              "folder that exists and is writable") from None
        return target

    def _add(self, kind: Kind, html: str) -> Page:
        self._sections[-1].blocks.append((kind, html))
        return self
