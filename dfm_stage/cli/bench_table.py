"""The rows of figures that the terminal and the page of the benchmarks show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Figure = Mapping[str, Any]
COLUMNS = ("key", "value", "unit", "bar", "", "peer", "peer value", "ratio", "how")
VERDICTS = {True: "met", False: "MISSED", None: ""}


def cells(figure: Figure, number: Callable[[float], str], at_least: str,
          at_most: str) -> list[Any]:
    """Return a figure's cells under `COLUMNS`; `number` and the two signs write its bar."""
    return [str(figure["key"]), figure["value"], str(figure["unit"]),
            _bar(figure, number, {"at least": at_least, "at most": at_most}),
            VERDICTS[figure.get("met")], str(figure["peer"] or ""), figure["peer_value"],
            figure["ratio"], str(figure["how"])]


def table(figures: Sequence[Figure]) -> str:
    """The figures as aligned text, one line each."""
    rows = [COLUMNS, *(_texts(figure) for figure in figures)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS) - 1)]
    right = {"value", "peer value", "ratio"}
    return "\n".join("  ".join([*(
        cell.rjust(width) if title in right else cell.ljust(width)
        for cell, width, title in zip(row, widths, COLUMNS, strict=False)), row[-1]]).rstrip()
        for row in rows)


def _bar(figure: Figure, number: Callable[[float], str], signs: Mapping[str, str]) -> str:
    if figure["bar"] is None:
        return ""
    bar = number(float(figure["bar"]))
    if figure.get("bar_kind") == "between":
        return f"{bar} to {number(float(figure['bar_to']))}"
    return signs.get(str(figure.get("bar_kind")), "") + bar


def _texts(figure: Figure) -> list[str]:
    row = ["" if cell is None else cell if isinstance(cell, str) else _number(cell)
           for cell in cells(figure, _number, ">= ", "<= ")]
    return [row[0], row[1] or "nan", *row[2:]]


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e5 else f"{value:.0f}"
