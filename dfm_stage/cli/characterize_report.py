"""The page that characterize writes: each experiment's figures, plot and where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.cli.characterize_summary import summary
from dfm_stage.paper.figures import (
    axis_of,
    curves_figure,
    decay_figure,
    response_figure,
    static_figure,
)
from dfm_stage.reporting import Page, Quantity, format_quantity

if TYPE_CHECKING:
    from dfm_stage.model import Model
    from dfm_stage.recording import Record

TITLES = {"static": "Static test", "decay": "Free decay", "step": "Step response",
          "stepped_sine": "Frequency response, stepped sine",
          "multisine": "Frequency response, multisine"}


def write_report(found: Mapping[str, tuple[Record, Any]], path: Path, model: Model | None) -> None:
    """Write the page to `path`, whole or not at all.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("Characterisation")
    page.lead(" ".join(filter(None, map(_sentence, found.items()))))
    for kind, (record, result) in found.items():
        page.section(TITLES[kind])
        page.table(("", "value"), [[name, Quantity(q.value, q.unit, q.ci95)]
                                   for name, q in summary(kind, result)])
        _plot(page, kind, record, result)
        for warning in record.warnings:
            page.note(warning)
    page.provenance({"Records": ", ".join(r.provenance.words for r, _ in found.values()),
                     "Model": model.name if model else "that of the bag"})
    page.write(path)


def _sentence(item: tuple[str, tuple[Record, Any]]) -> str:
    kind, (_, result) = item
    if kind == "static":
        q = result.stiffness
        return f"The stiffness is {format_quantity(q.value, q.unit, q.ci95)}."
    if kind == "decay":
        q = result.decrement
        return f"The logarithmic decrement is {format_quantity(q.value, q.unit, q.ci95)}."
    if kind == "step":
        q = result.settling_time
        return f"A step settles within {format_quantity(q.value, q.unit, q.ci95)}."
    q = result.constrained.natural_frequency
    return f"The {kind.replace('_', ' ')} finds {format_quantity(q.value, q.unit, q.ci95)}."


def _plot(page: Page, kind: str, record: Record, result: Any) -> None:
    data = record.axis(None if len(record.axes) == 1 else next(iter(record.axes)))
    if kind == "static":
        page.figure(static_figure(result), "Force over deflection, and each level's distance "
                    "from a straight line")
    elif kind == "decay":
        page.figure(decay_figure(data.position, record.sample_period, result),
                    "The stage let go, its extremes and the fitted envelope")
    elif kind == "step":
        page.figure(curves_figure({"position": axis_of(record)}, "position (mm)"),
                    "Answer to a voltage switched on")
    else:
        page.figure(response_figure(result), "Frequency response, measured and fitted")
