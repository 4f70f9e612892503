"""The page that identify writes: numbers, Bode plot, time plot, residuals, and where from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.convention import sentences
from dfm_stage.identification.frequency_response import Distortion
from dfm_stage.identification.model_fit import linear_plant
from dfm_stage.identification.paper import PAPER_MODE
from dfm_stage.identification.plant import LinearPlant
from dfm_stage.identification.residuals import LineResidual, ResidualTest
from dfm_stage.identification.workflow import Identification
from dfm_stage.reporting import (
    Drawing,
    Page,
    Quantity,
    Response,
    Table,
    bode_figure,
    format_quantity,
    log_labels,
    new_figure,
    page_style,
    time_figure,
)
from dfm_stage.reporting.table import Cell

CURVE_POINTS = 600
SHARP = 0.25
"""Damping ratio below which the curve has more points about a resonance."""
EXPLAINED = 1.2
"""RMS left over, times the noise floor, up to which the page says that the model explains all."""


def write_report(found: Identification, path: Path, records: Sequence[str]) -> None:
    """Write the page to `path`, whole or not at all.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("Identification")
    _lead(page, found)
    _numbers(page, found)
    _bode(page, found)
    _time(page, found)
    _residuals(page, found)
    _fine_print(page, found)
    page.provenance({"Records": ", ".join(records), "Model": found.model.name,
                     "Input": "; ".join(sentences(found.conventions)),
                     "Sample period": format_quantity(found.model.sample_period, "s"),
                     "Noise model": f"autoregression of order {found.fit.fits[0].noise.order}"})
    page.write(path)


def _lead(page: Page, found: Identification) -> None:
    first = found.evaluations[0]
    unit = found.sources[0].axis.output_unit
    ratio = first.fit.rms / first.floor.rms if first.floor.rms > 0.0 else math.inf
    if math.isfinite(found.natural_frequency_hz.value):
        said = (f"The stage resonates at {found.natural_frequency_hz} with a damping ratio of "
                f"{found.damping_ratio}; its static gain is {found.gain}.")
    else:
        said = f"The stage has no spring; its gain is {found.gain}."
    said += (f" What the model leaves over is {format_quantity(first.fit.rms, unit)} RMS, "
             f"{ratio:.2f} times the noise floor.")
    if not found.estimate.ok:
        page.lead(said, found.estimate.status.replace("_", " "), "bad")
    elif ratio > EXPLAINED:
        page.lead(said, "something is missing", "warn")
    else:
        page.lead(said, "explained", "good")
    for warning in found.warnings:
        page.note(warning)


def _numbers(page: Page, found: Identification) -> None:
    page.section("Parameters", "Values with 95 % intervals, which account for the colour of the "
                 "noise. " + _sentence(found.estimate.identifiability.text))
    rows: list[list[Cell]] = [[name, q, ""] for name, q in found.headline.items()
                              if math.isfinite(q.value)]
    rows += [[name, q, "estimated"] for name, q in found.estimate.quantities().items()]
    rows += [[name, Quantity(value, found.model.parameter(name).unit), "held"]
             for name, value in found.estimate.held.items()]
    page.table(("quantity", "value", ""), rows)
    if found.paper:
        page.table(("coefficient", "paper", "ours", "deviation (%)"),
                   [[row.symbol, row.paper, row.ours, row.deviation_percent]
                    for row in found.paper],
                   "Beside the paper's G(s) = 1/(s² + 1.705 s + 600.7), read as "
                   "b / (s² + c/m s + k/m)")
    if found.transfer_function is not None:
        fit = found.transfer_function
        page.table(("coefficient", "value"), [[n, fit.quantity(n)] for n in fit.names],
                   "Cross-check: the transfer function fitted to the frequency response alone, "
                   f"misfit {fit.misfit:.2f} (1 = down to the noise)")


def _bode(page: Page, found: Identification) -> None:
    if not found.responses:
        return
    source, many = found.sources[0], len(found.responses) > 1
    drawn = [Response(f"measured {number}" if many else "measured", measured.frequency_hz,
                      measured.response, np.sqrt(measured.variance), True)
             for number, measured in enumerate(found.responses, start=1)]
    low = min(float(measured.frequency_hz[0]) for measured in found.responses)
    high = max(float(measured.frequency_hz[-1]) for measured in found.responses)
    frequency = np.sort(np.concatenate((np.geomspace(low, high, CURVE_POINTS),
                                        _near_resonance(found, low, high))))
    omega = 2.0 * math.pi * frequency
    plant = linear_plant(found.model)
    drawn.append(Response("model", frequency,
                          plant.sampled_response(omega, source.sample_period)))
    if found.paper:
        drawn.append(Response("paper's G(s)", frequency, LinearPlant(
            (PAPER_MODE,), plant.lag, plant.delay).sampled_response(omega, source.sample_period)))
    first = found.responses[0]
    how = (f"{first.lines.size} lines over {first.periods_used} of {first.periods_total} periods"
           if first.lines.size else "local polynomial estimate")
    page.section("Frequency response", f"From held input to sampled position; {how}. Bands are "
                 "95 % of the measurement's noise. The curves include the hold, the amplifier's "
                 "lag and the delay, the paper's G(s) with ours.")
    page.figure(bode_figure(drawn, unit=first.unit), "Magnitude and phase, measured and modelled")
    if first.distortion is not None:
        page.table(("lines not excited", "level", "noise alone", "over excited lines (dB)",
                    "distortion"), _distortion_rows(first.distortion, first.distortion_unit))


def _distortion_rows(found: Distortion, unit: str) -> list[list[Cell]]:
    levels = {"odd": found.odd, "even": found.even}
    return [[kind, Quantity(level, unit), Quantity(found.noise, unit),
             decibel if decibel is not None and math.isfinite(decibel) else None,
             found.significant(kind)]
            for kind, level in levels.items() if level is not None
            for decibel in [found.decibel(kind)]]


def _near_resonance(found: Identification, low: float, high: float) -> Array:
    widths = np.linspace(-4.0, 4.0, 41)
    near = np.concatenate([np.empty(0), *(
        mode.natural_frequency_hz * (1.0 + mode.damping_ratio * widths)
        for mode in linear_plant(found.model).modes
        if mode.stiffness > 0.0 and mode.damping_ratio < SHARP)])
    return np.asarray(near[(near > low) & (near < high)])


def _time(page: Page, found: Identification) -> None:
    source, fit = found.sources[0], found.fit.fits[0]
    unit = source.axis.output_unit
    time = np.asarray(np.arange(fit.measured.size) * fit.sample_period, dtype=np.float64)
    page.section("In time", f"The model simulated from the measured input of {source.name}, "
                 "nothing but the start and the offset adapted to the output.")
    page.figure(time_figure(time, [
        ("input", source.axis.input_unit, {"input": source.axis.input[fit.skip:]}),
        (source.axis.measures, unit, {"measured": fit.measured, "simulated": fit.simulated}),
        ("difference", unit, {"difference": fit.residual})]),
        f"Measured and simulated {source.axis.measures}, and what is left over")
    rows = [[e.source, "held out" if e in found.held_out else "fitted",
             e.fit_percent, Quantity(e.fit.rms, unit), Quantity(e.floor.rms, unit),
             e.floor.known_from] for e in (*found.evaluations, *found.held_out)]
    page.table(("samples", "", "fit (%)", "left over (RMS)", "noise floor", "floor from"), rows)


def _residuals(page: Page, found: Identification) -> None:
    page.section("What is left over", "Correlations of the whitened residual with itself and with "
                 "the input before it; 99 % of them lie inside the band if only noise is left.")
    page.figure(_correlation_figure(found.tests), "Correlation of the residual")
    page.table(("test", "result", "p value", "passed"),
               [[t.name.replace("_", " "), t.text, t.p_value, t.passed] for t in found.tests])
    if found.line_residuals is not None:
        page.figure(_line_figure(found.line_residuals),
                    "Power left at each excited line, over the power of the noise there")


def _correlation_figure(tests: Sequence[ResidualTest]) -> Drawing:
    figure, axes = new_figure(len(tests), 0.7 + 1.5 * len(tests), squeeze=False)
    with page_style():
        for axis, test in zip(axes[:, 0], tests, strict=True):
            axis.vlines(test.lags, 0.0, test.correlation, color="C0", linewidth=1.4)
            axis.plot(test.lags, test.correlation, "o", color="C0", markersize=3.0)
            axis.fill_between(test.lags, -test.band, test.band, color="C1", alpha=0.2, linewidth=0)
            axis.set_ylabel("with itself" if test.name == "whiteness" else "with the input")
        axes[-1, 0].set_xlabel("lag (samples)")
    rows: list[list[Cell]] = [
        [t.name.replace("_", " "), float(np.max(np.abs(t.correlation))), float(t.band[0])]
        for t in tests]
    return Drawing(figure, Table(("test", "largest correlation", "99 % band"), rows))


def _line_figure(lines: LineResidual) -> Drawing:
    figure, axis = new_figure(1, 2.6)
    with page_style():
        axis.semilogx(lines.frequency_hz, lines.ratio, "o", color="C0", markersize=3.0)
        axis.axhline(lines.band, color="C1", linewidth=1.0)
        axis.set(yscale="log", xlabel="frequency (Hz)", ylabel="power ratio")
        log_labels(axis.xaxis, axis.yaxis)
    worst = int(np.argmax(lines.ratio))
    return Drawing(figure, Table(
        ("", "frequency (Hz)", "ratio"),
        [["largest", float(lines.frequency_hz[worst]), float(lines.ratio[worst])],
         ["99.9 % limit", None, lines.band]]))


def _fine_print(page: Page, found: Identification) -> None:
    names = [n for n in found.estimate.names if "[" not in n]
    correlation = found.estimate.correlation
    rows = [[n, *(float(c) if np.isfinite(c) else None
                  for c in correlation[i, : len(names)])] for i, n in enumerate(names)]
    page.section("Correlation between the estimates")
    page.table(("", *names), rows)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."
