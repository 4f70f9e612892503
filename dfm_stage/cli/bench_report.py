"""The benchmarks as a table and as a page: every figure beside its bar and its peer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dfm_stage.quantity import format_number
from dfm_stage.reporting import Page, new_figure, page_style
from dfm_stage.reporting.table import Cell

Figure = Mapping[str, Any]
ROW = ("key", "value", "range", "unit", "bar", "", "peer", "peer value", "ratio", "how")
VERDICTS = {True: "met", False: "MISSED", None: ""}
TITLES = {
    "loop": "The node graph in real time", "lockstep": "The node graph in lockstep",
    "bags": "Reading bags", "simulate": "The simulator", "coverage": "Intervals that hold",
    "identify": "Identification", "motor_bench": "Data recorded by others",
    "control": "Controllers on one scan", "drivers": "Serial drivers", "diagnose": "Diagnosis",
    "long": "Long records", "minute": "Records of a minute",
    "faults": "Faults", "joins": "Tools that come and go",
    "executors": "Executors", "zero_current": "Time to zero current",
    "real": "Diagnoses of records measured by others",
}
COLUMNS = ("figure", "value", "range", "unit", "bar", "", "peer", "its value", "ratio", "how")
MOST_IN_A_PLOT = 24


def write_page(figures: Sequence[Figure], path: Path, machine: Mapping[str, Any],
               failed: Sequence[Mapping[str, str]] = (), commands: Sequence[str] = ()) -> None:
    """Write the page to `path`, whole or not at all; `figures` as bench's JSON has them.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("Measured figures")
    judged = [figure for figure in figures if figure.get("met") is not None]
    met = sum(bool(figure["met"]) for figure in judged)
    complete = met == len(judged) and not failed
    page.lead(f"{len(figures)} figures, {met} of {len(judged)} bars met. A bar is what was "
              "promised before the measurement; a peer did the same work in the same run.",
              "all met" if complete else "some missed", "good" if complete else "warn")
    for each in failed:
        page.note(f"{each['bench']} failed: {each['reason']}")
    missed = [figure for figure in judged if not figure["met"]]
    if missed:
        page.section("Missed")
        page.table(COLUMNS, [_cells(figure) for figure in missed])
    groups: dict[str, list[Figure]] = {}
    for figure in figures:
        groups.setdefault(str(figure["key"]).partition(".")[0], []).append(figure)
    for name, group in groups.items():
        page.section(TITLES.get(name, name.replace("_", " ")), f"Repeat it: ./run bench {name}")
        compared = [figure for figure in group if _margin(figure) is not None]
        if compared:
            page.figure(_margins(compared[:MOST_IN_A_PLOT]), "Each figure over its bar, on the "
                        "side that was promised: right of the line is met")
        page.table(COLUMNS, [_cells(figure) for figure in group])
    page.provenance({"Commands": "; ".join(commands) or "./run bench",
                     "Machine": f"{machine.get('cpu', '?')}, {machine.get('cores', '?')} cores, "
                     f"{machine.get('memory_gib', '?')} GiB",
                     "Load at the start": machine.get("load_1min", "?"),
                     "Kernel": machine.get("kernel", "?"),
                     "Measured with": f"Python {machine.get('python', '?')}, "
                     f"NumPy {machine.get('numpy', '?')}"})
    page.write(path)


def _cells(figure: Figure) -> list[Cell]:
    return cells(figure, format_number, "≥ ", "≤ ")


def _margin(figure: Figure) -> float | None:
    """By what factor a bar is met, above 1, or missed, below; None where there is none."""
    value, bar = figure["value"], figure["bar"]
    if value is None or bar is None or value <= 0.0 or bar <= 0.0:
        return None
    return {"at least": value / bar, "at most": bar / value}.get(str(figure.get("bar_kind")))


def _margins(figures: Sequence[Figure]) -> Any:
    figure, axis = new_figure(1, 0.9 + 0.24 * len(figures))
    with page_style():
        for row, each in enumerate(reversed(figures)):
            margin = _margin(each) or 0.0
            axis.plot(margin, row, "o", color="C0" if each["met"] else "C1", markersize=6.0)
        axis.axvline(1.0, color="C2", linestyle="--", linewidth=1.0)
        low, high = (edge(_margin(each) or 1.0 for each in figures) for edge in (min, max))
        axis.set(xscale="log", xlim=(min(0.5, 0.8 * low), max(2.0, 1.25 * high)),
                 ylim=(-0.7, len(figures) - 0.3), xlabel="times the bar")
        axis.set_yticks(range(len(figures)),
                        [str(each["key"]).partition(".")[2] for each in reversed(figures)])
    return figure


def cells(figure: Figure, number: Callable[[float], str], at_least: str,
          at_most: str) -> list[Any]:
    """Return a figure's cells under `ROW`; `number` and the two signs write its bar."""
    return [str(figure["key"]), figure["value"], _range(figure, number), str(figure["unit"]),
            _bar(figure, number, {"at least": at_least, "at most": at_most}),
            VERDICTS[figure.get("met")], str(figure["peer"] or ""), figure["peer_value"],
            figure["ratio"], str(figure["how"])]


def table(figures: Sequence[Figure]) -> str:
    """The figures as aligned text, one line each."""
    rows = [ROW, *(_texts(figure) for figure in figures)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(ROW) - 1)]
    right = {"value", "peer value", "ratio"}
    return "\n".join("  ".join([*(
        cell.rjust(width) if title in right else cell.ljust(width)
        for cell, width, title in zip(row, widths, ROW, strict=False)), row[-1]]).rstrip()
        for row in rows)


def _range(figure: Figure, number: Callable[[float], str]) -> str:
    low, high = figure.get("low"), figure.get("high")
    return "" if low is None or high is None else f"{number(low)} to {number(high)}"


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
