"""The page that characterize writes: each experiment's figures, plot and where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.cli.characterize_summary import summary
from dfm_stage.paper.figures import (
    curves_figure,
    decay_figure,
    response_figure,
    static_figure,
)
from dfm_stage.reporting import Drawing, Page

if TYPE_CHECKING:
    from dfm_stage.model import Model
    from dfm_stage.recording import Record

TITLES = {"static": "Static test", "decay": "Free decay", "step": "Step response",
          "stepped_sine": "Frequency response, stepped sine",
          "multisine": "Frequency response, multisine"}
LEADS = {"static": ("The stiffness is", "stiffness"),
         "decay": ("The logarithmic decrement is", "decrement"),
         "step": ("A step settles within", "settling_time"),
         "stepped_sine": ("The stepped sine finds", "natural_frequency"),
         "multisine": ("The multisine finds", "natural_frequency")}
"""How the lead tells the figure of each kind that matters most, and which that is."""


def write_report(found: Mapping[str, tuple[Record, Any]], path: Path, model: Model | None) -> None:
    """Write the page to `path`, whole or not at all.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("Characterisation")
    page.lead(" ".join(_sentence(kind, result) for kind, (_, result) in found.items()))
    for kind, (record, result) in found.items():
        page.section(TITLES[kind])
        page.table(("", "value"), summary(kind, result))
        page.figure(*_drawn(kind, record, result))
        for warning in record.warnings:
            page.note(warning)
    page.provenance({"Records": ", ".join(r.provenance.words for r, _ in found.values()),
                     "Model": model.name if model else "that of the bag"})
    page.write(path)


def _sentence(kind: str, result: Any) -> str:
    words, name = LEADS[kind]
    q = getattr(getattr(result, "constrained", result), name)
    return f"{words} {q}."


def _drawn(kind: str, record: Record, result: Any) -> tuple[Drawing, str]:
    """Return the figure of an experiment and its caption."""
    data = record.axis(None if len(record.axes) == 1 else next(iter(record.axes)))
    if kind == "static":
        return static_figure(result), ("Force over deflection, and each level's distance from a "
                                       "straight line")
    if kind == "decay":
        return (decay_figure(data.position, record.sample_period, result),
                "The stage let go, its extremes and the fitted envelope")
    if kind == "step":
        return (curves_figure({"position": (record.time, record.axis(None).position)},
                              "position (mm)"), "Answer to a voltage switched on")
    return response_figure(result), "Frequency response, measured and fitted"
