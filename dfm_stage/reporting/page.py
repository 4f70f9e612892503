"""One self-contained HTML page, built from top to bottom."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from dfm_stage import __version__
from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole
from dfm_stage.reporting.figures import NARROW_IN, Drawing, to_svg
from dfm_stage.reporting.style import STYLE
from dfm_stage.reporting.table import Cell, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tone = Literal["good", "warn", "bad", "plain"]


class ReportError(DfmError):
    """A report cannot be written."""


class Page:
    """A report: title, verdict, sections of text, plots and tables, and where it all came from.

    Every method but `html` and `write` returns the page itself. All text is escaped; nothing on
    the page asks the network for anything.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self._body: list[str] = []
        self._provenance: dict[str, str] = {}
        self._figures = 0

    def lead(self, text: str, verdict: str = "", tone: Tone = "plain") -> Page:
        """Add the sentence that answers the reader's question, with a one-word verdict."""
        badge = f'<span class="badge {tone}">{escape(verdict)}</span>' if verdict else ""
        return self._add(f'<p class="lead">{badge}{escape(text)}</p>')

    def section(self, title: str, text: str = "") -> Page:
        """Start a section; a blank line in `text` starts a paragraph."""
        self._add(f"<h2>{escape(title)}</h2>")
        return self.text(text) if text else self

    def text(self, text: str) -> Page:
        """Add paragraphs."""
        for paragraph in text.split("\n\n"):
            if paragraph.strip():
                self._add(f"<p>{escape(' '.join(paragraph.split()))}</p>")
        return self

    def note(self, text: str) -> Page:
        """Add a warning the reader must not miss."""
        return self._add(f'<p class="note">{escape(text)}</p>')

    def figure(self, figure: Figure | Drawing, caption: str, table: Table | None = None) -> Page:
        """Add a plot with the figures it shows in a table that folds out below it.

        A `Drawing` brings its table along. The plot is drawn once for a wide page and once for a
        phone; the page shows the one that fits.
        """
        drawing = figure if isinstance(figure, Drawing) else Drawing(figure)
        table = table or drawing.table
        self._figures += 1
        number = f"f{self._figures}"
        wide = to_svg(drawing.figure, f"{number}w", caption)
        narrow = to_svg(drawing.figure, f"{number}n", caption, NARROW_IN)
        figures = (f"<details><summary>The figures behind this plot</summary>{table.html()}"
                   "</details>") if table is not None else ""
        return self._add(f'<figure><div class="plot wide">{wide}</div>'
                         f'<div class="plot narrow">{narrow}</div>'
                         f"<figcaption>{escape(caption)}</figcaption>{figures}</figure>")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[Cell]],
              caption: str = "") -> Page:
        """Add a table; cells are text, numbers, `Quantity` (value ± 95 % interval) or None."""
        return self._add(Table(columns, rows).html(caption))

    def provenance(self, entries: Mapping[str, object]) -> Page:
        """Add what the page was made from (bag, model, versions) to its foot."""
        self._provenance.update({str(key): str(value) for key, value in entries.items()})
        return self

    def html(self) -> str:
        """Return the whole page."""
        versions = f"Python {platform.python_version()}, NumPy {np.__version__}"
        foot = {**self._provenance, "Versions": f"dfm_stage {__version__}, {versions}",
                "Made": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")}
        entries = "".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>"
                          for key, value in foot.items())
        return "\n".join((
            '<!DOCTYPE html>', '<html lang="en">', "<head>", '<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(self.title)}</title>", f"<style>\n{STYLE}</style>", "</head>",
            "<body>", "<main>", f"<h1>{escape(self.title)}</h1>", *self._body, "</main>",
            f"<footer><dl>{entries}</dl></footer>", "</body>", "</html>", ""))

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

    def _add(self, html: str) -> Page:
        self._body.append(html)
        return self
