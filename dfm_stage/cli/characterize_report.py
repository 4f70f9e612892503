"""What characterize prints and reports of each experiment: figures, plot, where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dfm_stage.paper.figures import curves_figure, decay_figure, response_figure, static_figure
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
RESPONSE = {
    "numerator": "numerator", "damping, 2 zeta w": "damping", "stiffness, w^2": "stiffness",
    "natural frequency": "natural_frequency", "damping ratio": "damping_ratio",
    "static gain": "static_gain", "amplifier lag": "lag", "delay": "delay"}
QUANTITIES: dict[str, dict[str, str]] = {
    "static": {"stiffness": "stiffness", "largest distance from a line": "linearity",
               "hysteresis loop": "hysteresis",
               "hysteresis loop over the travel": "hysteresis_percent"},
    "decay": {"logarithmic decrement": "decrement", "damping ratio": "damping",
              "damping ratio, Eq. 2 as printed": "damping_as_printed",
              "natural frequency": "natural_frequency",
              "decrement of the first half": "early", "decrement of the second half": "late"},
    "step": {"rise time, 10 to 90 %": "rise_time", "settling time, {band:g} %": "settling_time",
             "overshoot": "overshoot", "time of the peak": "peak_time",
             "damping ratio from the overshoot": "damping",
             "natural frequency from the peak": "natural_frequency"},
    "stepped_sine": RESPONSE, "multisine": RESPONSE,
}
"""What is told of each kind of experiment: words, and the attribute of its result."""


def summary(kind: str, result: Any) -> list[tuple[str, Any]]:
    """Return what a result says, as (what, Quantity) pairs."""
    found = getattr(result, "constrained", result)
    return [(words.format(band=100.0 * getattr(found, "band", 0.0)), getattr(found, name))
            for words, name in QUANTITIES[kind].items()]


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
    return f"{words} {getattr(getattr(result, 'constrained', result), name)}."


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
