"""The page that tune writes: the parameters, what they promise, the loop, and why."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dfm_stage.cli.tune_verify import Tracking
from dfm_stage.control import (
    LQR_PARAMETERS,
    PID_PARAMETERS,
    SHAPER_PARAMETERS,
    Tuned,
    Ultimate,
    loop_of,
)
from dfm_stage.model import Model
from dfm_stage.reporting import (
    Drawing,
    Page,
    Quantity,
    Table,
    display_unit,
    new_figure,
    page_style,
)
from dfm_stage.reporting.table import Cell

ROBUST = 0.5
METHODS = {"pid": "PID", "lqr": "LQR", "ziegler_nichols": "Ziegler and Nichols's PID"}
LOWEST_HZ = 0.1
UNITS = {each.name: each.unit
         for each in (*PID_PARAMETERS, *LQR_PARAMETERS, *SHAPER_PARAMETERS)}
PREDICTED = {"step_1mm_after_5s": "largest error from 5 s after a 1 mm step on",
             "sine_1mm_half_hz_peak": "largest error on ±1 mm at 0.5 Hz",
             "at_rest_rms": "at rest, RMS"}


def write_report(path: Path, results: Mapping[str, Tuned], models: Mapping[str, Model],
                 found: Mapping[str, Mapping[str, Ultimate]],
                 verified: Mapping[str, Tracking], provenance: Mapping[str, object]) -> None:
    """Write the page to `path`, whole or not at all; everything is by axis.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("Tuning")
    for axis, tuned in results.items():
        m = tuned.margins
        named = f"Axis {axis}: " if len(results) > 1 else ""
        page.lead(f"{named}{METHODS[tuned.method]} with a modulus margin of "
                  f"{m.modulus:.3f}; the loop follows up to {tuned.bandwidth_hz:.3g} Hz.",
                  "robust" if m.modulus >= 0.99 * ROBUST else "little margin",
                  "good" if m.modulus >= 0.99 * ROBUST else "warn")
    for axis, tuned in results.items():
        _axis(page, f"Axis {axis}: " if len(results) > 1 else "", tuned, models[axis])
        _measured(page, found.get(axis, {}), verified.get(axis))
    page.provenance(provenance)
    page.write(path)


def _axis(page: Page, named: str, tuned: Tuned, model: Model) -> None:
    page.section(f"{named}What it promises", "On the model, delay, lag and sampling included.")
    m = tuned.margins
    promised: list[list[Cell]] = [
        [PREDICTED[name], Quantity(value, "m"), "of the true position"]
        for name, value in tuned.predicted.items()]
    page.table(("quantity", "value", ""), [
        ["modulus margin", m.modulus, "smallest distance of the loop from −1; 0.5 is robust"],
        ["gain margin", m.gain, "factor by which the gain may grow"],
        ["phase margin", Quantity(m.phase_deg, "deg"), "that may be lost at a crossover"],
        ["highest crossover", Quantity(m.crossover_hz, "Hz"), "where the loop gain is one"],
        ["bandwidth", Quantity(tuned.bandwidth_hz, "Hz"), "up to which it follows, −3 dB"],
        *promised])
    page.figure(_sensitivity(tuned, model), "1/(1 + L), the sensitivity, is what the "
                "loop multiplies a disturbance by: below 1 it is taken off, its peak is the "
                "inverse of the modulus margin. L/(1 + L) is how the loop follows")
    page.section(f"{named}Parameters and why")
    page.table(("parameter", "value", "unit"), [
        [name, value if isinstance(value, (str, bool)) else float(value),
         display_unit((), UNITS.get(name, ""))[1]]
        for name, value in {**tuned.parameters, **tuned.generator}.items()],
        "As the parameter file has them")
    for reason in tuned.reasons:
        page.text(reason[:1].upper() + reason[1:] + ".")


def _sensitivity(tuned: Tuned, model: Model) -> Drawing:
    hertz, loop = loop_of(tuned.parameters, model)
    hertz, loop = hertz[hertz >= LOWEST_HZ], loop[hertz >= LOWEST_HZ]
    curves = {"1/(1 + L)": np.abs(1.0 / (1.0 + loop)),
              "L/(1 + L)": np.abs(loop / (1.0 + loop))}
    figure, axis = new_figure(1, 3.2)
    with page_style():
        for label, values in curves.items():
            axis.loglog(hertz, values, label=label)
        axis.axhline(1.0 / tuned.margins.modulus, color="C2", linestyle="--", linewidth=1.0,
                     label="1 / margin")
        axis.set(xlabel="frequency (Hz)", ylabel="factor")
        axis.set_ylim(bottom=1e-3)
        axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.1,
                    columnspacing=1.0, handlelength=1.4)
    rows: list[list[Cell]] = [
        [label, float(np.max(values)), float(hertz[np.argmax(values)]), float(values[0]),
         float(hertz[0])] for label, values in curves.items()]
    return Drawing(figure, Table(("curve", "largest", "at (Hz)", "at the lowest frequency",
                                  "which is (Hz)"), rows))


def _measured(page: Page, ways: Mapping[str, Ultimate], verified: Tracking | None) -> None:
    if ways:
        page.table(("on the running loop", "ultimate gain", "period"),
                   [[way.replace("_", " "), Quantity(each.gain_v_m, "V/m"),
                     Quantity(each.period_s, "s")] for way, each in ways.items()])
    if verified is not None:
        page.table((f"{verified.experiment}, on the node graph", "RMS", "peak"), [
            ["predicted on the model", Quantity(verified.predicted_rms_m, "m"),
             Quantity(verified.predicted_peak_m, "m")],
            ["achieved", Quantity(verified.achieved_rms_m, "m"),
             Quantity(verified.achieved_peak_m, "m")]])
