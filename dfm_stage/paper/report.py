"""The page: every row beside the paper's, and the counterpart of each figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from dfm_stage.identification.paper import PAPER_MODE
from dfm_stage.identification.plant import LinearPlant
from dfm_stage.paper.figures import (
    curves_figure,
    decay_figure,
    response_figure,
    static_figure,
)
from dfm_stage.paper.lqr import DISTURBANCE_HZ, DISTURBANCE_N, proportional
from dfm_stage.paper.row import PRINTED, TABLE_1, Row
from dfm_stage.paper.stage import reference_of, tracking_error
from dfm_stage.paper.workflow import Comparison, Findings
from dfm_stage.reporting import Page, Quantity, Response
from dfm_stage.reporting.table import Cell

DEVIATION_DECIMALS = 3
"""Decimals of a deviation in percent: smaller ones are those of the arithmetic."""
SECTIONS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("3A Stiffness (Table 1)", ("table1", "quasistatic", "geometry"), ""),
    ("3B Damping (Eq. 1 and 2)", ("damping", "step"), ""),
    ("3C Frequency response and G(s) (Eq. 3)", ("response", "eq3", "derived"), ""),
    ("Theory against experiment", ("theory",), ""),
    ("4 PID control (Eq. 4, Ziegler and Nichols)", ("zn", "pid", "encoder"), ""),
    ("5 LQR", ("lqr",), ""),
    ("6 XY mechanism", ("xy",), ""),
)


def write_page(found: Comparison, path: Path, provenance: Mapping[str, object]) -> None:
    """Write the page to `path`, whole or not at all.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("The paper, row by row")
    within, outside, without = tally(found.rows)
    page.lead(f"{len(found.rows)} rows: {within} within 1 % of the paper, {outside} further off "
              f"for the reason beside them, {without} that the paper has no number for. Records "
              f"are {found.source}.")
    page.text("'Printed' numbers stand in the paper; 'derived' ones follow from printed ones by "
              "arithmetic. Intervals are 95 %.")
    page.section("Where the source contradicts itself")
    page.table(("quantity", "place", "paper", "ours", "deviation (%)", "reason"),
               [_cells(row) for row in found.rows if row.contradicts])
    for title, prefixes, text in SECTIONS:
        page.section(title, text)
        rows = [row for row in found.rows if row.id.split(".")[0] in prefixes]
        for draw in filter(None, map(FIGURES.get, prefixes)):
            draw(page, found.findings)
        page.table(("quantity", "place", "paper", "ours", "deviation (%)", "reason"),
                   [_cells(row) for row in rows])
    page.provenance(provenance)
    page.write(path)


def tally(rows: Sequence[Row]) -> tuple[int, int, int]:
    """Return how many rows are within 1 %, further off, and without a number to compare."""
    off = [row.deviation_percent for row in rows]
    within = sum(1 for each in off if each is not None and abs(each) <= 1.0)
    return within, sum(1 for each in off if each is not None) - within, off.count(None)


def _cells(row: Row) -> list[Cell]:
    paper: Cell = Quantity(row.paper, row.unit) if row.paper is not None else None
    ours: Cell = Quantity(row.ours, row.unit, row.ci95) if row.ours is not None else None
    place = f"{row.place} ({row.kind})" if row.kind == "derived" else row.place
    off = row.deviation_percent
    return [row.what, place, paper, ours, None if off is None else round(off, DEVIATION_DECIMALS),
            row.reason]


def _stiffness(page: Page, found: Findings) -> None:
    load, _, practice, *_ = np.array(TABLE_1).T
    page.figure(
        static_figure(found.static, PRINTED["table1.theory"].value, (load, 1e-3 * practice)),
        "Fig. 6: stiffness characteristics, force up and down; below, how far each level is "
        "off the straight line through all of ours")


def _decay(page: Page, found: Findings) -> None:
    record = found.records["decay"]
    page.figure(
        decay_figure(record.axis(None).position, record.sample_period, found.decay),
        "Fig. 7: logarithmic decrement curve (the text also calls the frequency response "
        "Fig. 7)")


def _transient(page: Page, found: Findings) -> None:
    time, measured, beam, fitted = found.transient[:, found.transient[0] <= 4.0]
    page.figure(curves_figure(
        {"measured": (time, measured), "identified G(s)": (time, fitted),
         "beam equation": (time, beam)}, "position (mm)",
        difference={"identified G(s)": (time, fitted - measured),
                    "beam equation": (time, beam - measured)},
        difference_label="less measured (µm)"),
        "Fig. 8: transient response, experiment and models")


def _response(page: Page, found: Findings) -> None:
    test = found.response
    measured = test.response.frequency_hz
    frequency = np.geomspace(measured[0], measured[-1], 500)
    fit = test.constrained
    paper = LinearPlant((PAPER_MODE,), fit.lag.value, fit.delay.value)
    page.figure(
        response_figure(test, [Response(
            "paper's G(s) behind our lag and delay", frequency, paper.sampled_response(
                2.0 * np.pi * frequency, test.response.sample_period))]),
        "The frequency response of sec. 3C, stepped sine at 0.08 V")


def _tracking(page: Page, found: Findings) -> None:
    test = found.pid
    time = test.sine.time
    curves = {"reference": (time, reference_of(test.sine)),
              "Ziegler-Nichols": (time, test.sine.axis(None).position),
              "placed, feedforward": (time, test.placed.axis(None).position)}
    page.figure(curves_figure(curves, "position (mm)"), "Fig. 9: actual and reference position")
    page.figure(curves_figure(
        {"Ziegler-Nichols": (time, tracking_error(test.sine))}, "error (µm)", scale=1e6,
        difference={"placed, feedforward": (time, tracking_error(test.placed))},
        difference_label="error, placed (µm)"),
        "Fig. 10: error on the sine; above under Ziegler-Nichols, below with gains placed on "
        "the model and feedforward")
    step = test.step
    page.figure(curves_figure(
        {"reference": (step.time, reference_of(step)),
         "Ziegler-Nichols": (step.time, step.axis(None).position)}, "position (mm)"),
        "The 1 mm step under Ziegler-Nichols")


def _regulator(page: Page, found: Findings) -> None:
    test, c = found.regulation, found.convergence
    curves = {"reference": (test.time_s, test.reference),
              **{name: (test.time_s, y) for name, y in test.laws.items()}}
    late = test.time_s >= 0.8
    errors = {name: (test.time_s[late], (test.reference - y)[late])
              for name, y in test.laws.items()}
    page.figure(curves_figure(curves, "position (mm)", difference=errors,
                              difference_label="error (µm)"),
                "Fig. 11: regulation under LQR, its steady-state error (from 0.3 s after the step "
                "on) and the cure")
    gain = proportional(test.disturbance, next(iter(test.disturbed.values())))
    page.figure(curves_figure(
        {f"disturbance times {1e6 * gain:.0f} µm/N": (test.time_s, gain * test.disturbance),
         **{name: (test.time_s, y) for name, y in test.disturbed.items()}},
        "position (µm)", scale=1e6),
        f"Fig. 12: response to a disturbance of {DISTURBANCE_N:g} N at {DISTURBANCE_HZ:g} Hz")
    page.figure(curves_figure(
        {f"L{i + 1}": (c.time_s, c.gain[:, i]) for i in range(4)},
        "gain over its limit", scale=1.0, xlabel="time (s); the end is at 4 s, P_f = 0"),
        "The finite-horizon gain L(t) on the printed plant: constant but for the last second")


def _plane(page: Page, found: Findings) -> None:
    for axis, test in found.xy.tests.items():
        curve = found.xy.elements[axis]
        order = np.argsort(test.force_n, kind="stable")
        x = test.position_m[order]
        k = found.xy.mechanism.stiffness_n_m()
        curves = {"static test": (1e3 * x, test.force_n[order]),
                  "closed form": (1e3 * x, k * x)}
        off = {"static test": (1e3 * x, test.force_n[order] - k * x)}
        if curve is not None:
            curves["finite elements"] = (1e3 * curve.along_m, curve.force_n)
            off["finite elements"] = (1e3 * curve.along_m, curve.force_n - k * curve.along_m)
        page.figure(curves_figure(
            curves, "force (N)", scale=1.0, difference=off,
            difference_label="less closed form (N)", difference_scale=1.0,
            xlabel="deflection (mm)"),
            f"Fig. {16 if axis == 'x' else 17}: {axis.upper()} direction; the paper's figure "
            "is not legible as numbers")


FIGURES: dict[str, Callable[[Page, Findings], None]] = {
    "table1": _stiffness, "damping": _decay, "step": _transient, "response": _response,
    "pid": _tracking, "lqr": _regulator, "xy": _plane}
"""Draw what belongs to the rows whose names begin so."""
