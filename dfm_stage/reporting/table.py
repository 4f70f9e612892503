"""A table as data, and as HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from numbers import Integral, Real
from urllib.parse import quote

from dfm_stage.quantity import Quantity, format_number


@dataclass(frozen=True)
class Link:
    """Text that leads to another file, by its path from the page."""

    text: str
    path: str


Cell = str | float | int | bool | Quantity | Link | None
LONG_TEXT = 40
"""Characters above which a cell needs a column as wide as a phone."""
MOST_ON_PHONE = 3
"""Columns that a phone shows beside one another where one of them holds long text."""
MANY = 6
"""Columns above which a table is set smaller, to stand beside a figure."""


@dataclass(frozen=True)
class Table:
    """Column heads and rows of cells; every row has as many cells as there are columns."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]

    def html(self, caption: str = "") -> str:
        """Return the table as escaped HTML that scrolls sideways where it is too wide.

        On a phone, a table of many columns with long text becomes a card for each row.
        """
        numeric = [all(_is_number(row[i]) for row in self.rows) and bool(self.rows)
                   for i in range(len(self.columns))]
        cards = len(self.columns) > MOST_ON_PHONE and any(
            isinstance(cell, str) and len(cell) > LONG_TEXT for row in self.rows for cell in row)
        kind = " class=cards" if cards else " class=many" if len(self.columns) > MANY else ""
        parts = [f'<div class="scroll" tabindex="0"><table{kind}>']
        if caption:
            parts.append(f"<caption>{escape(caption)}</caption>")
        parts.append("<thead><tr>" + "".join(
            f"<th{' class=number' if number else ''} scope=col>{escape(str(column))}</th>"
            for column, number in zip(self.columns, numeric, strict=True))
            + "</tr></thead><tbody>")
        heads = [f' data-head="{escape(str(column))}"' if cards else "" for column in self.columns]
        parts.extend("<tr>" + "".join(
            f"<td{' class=number' if number else ''}{head}>{cell_html(cell)}</td>"
            for cell, number, head in zip(row, numeric, heads, strict=True)) + "</tr>"
            for row in self.rows)
        parts.append("</tbody></table></div>")
        return "\n".join(parts)

    def __post_init__(self) -> None:
        for i, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(f"row {i} has {len(row)} cells, not {len(self.columns)}")


def cell_html(cell: Cell) -> str:
    """Return one cell as escaped text."""
    if cell is None:
        return "–"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, Link):
        return f'<a href="{escape(quote(cell.path))}">{escape(cell.text)}</a>'
    if isinstance(cell, Integral):
        return str(int(cell)).replace("-", "−")
    if isinstance(cell, Real):
        return format_number(float(cell))
    return escape(str(cell))


def _is_number(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, (Real, Quantity)) and not isinstance(cell, bool))
