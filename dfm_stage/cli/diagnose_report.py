"""The page that diagnose writes: verdict, gap, evidence, rejected rivals, next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.cli.command import TONES
from dfm_stage.cli.diagnose_force_report import accepted, formulas, missing_force
from dfm_stage.diagnosis import Comparison, Diagnosis
from dfm_stage.diagnosis.spectra import density
from dfm_stage.identification.convention import sentences
from dfm_stage.reporting import (
    Drawing,
    Page,
    Quantity,
    Table,
    display_unit,
    format_quantity,
    log_labels,
    new_figure,
    page_style,
    time_figure,
)
from dfm_stage.reporting.table import Cell

BINS = 40
NO_GAP = 1.5


def write_report(found: Diagnosis, path: Path, records: Sequence[str], model: str) -> None:
    """Write the page to `path`, whole or not at all.

    Raises
    ------
    ReportError
        If the folder cannot be written.
    """
    page = Page("Diagnosis")
    page.lead(found.sentence, "nothing missing" if found.verdict == "none" else
              found.verdict.replace("_", " "), TONES[found.verdict])
    for warning in found.warnings:
        page.note(warning)
    for section in (_gap, accepted, _effects, missing_force, formulas, _simulated, _evidence,
                    _rejected, _next):
        section(page, found)
    page.provenance({"Records": ", ".join(records), "Model": model,
                     "Input": "; ".join(sentences(found.conventions)),
                     "Sample period": format_quantity(found.model.sample_period, "s"),
                     "Time taken": f"{found.seconds:.0f} s"})
    page.write(path)


def _gap(page: Page, found: Diagnosis) -> None:
    page.section("The gap", "RMS of measured minus simulated: with the model as it was given, "
                 "with its own parameters re-estimated, and with what was found added. The line "
                 f"is the noise floor, known from {found.gap.noise_floor_from}.")
    page.figure(_gaps(found), "The gap before and after, on fitted and on held-out records")


def _gaps(found: Diagnosis) -> Drawing:
    gap = found.gap
    values = np.array([gap.fit, gap.held_out], dtype=float)
    factor, unit = display_unit((float(np.nanmax(values)),), gap.unit)
    figure, axis = new_figure(1, 2.6)
    words = ("as given", "retuned", "with effects" if found.effects else "as answered")
    with page_style():
        for row, (label, mark) in enumerate((("fitted", "o"), ("held out", "D"))):
            axis.plot(range(3), values[row] * factor, mark, linestyle=":", linewidth=1.0,
                      markersize=7.0, color=f"C{row}", label=label)
        axis.axhline(gap.noise_floor * factor, color="C2", linewidth=1.2, linestyle="--",
                     label="noise floor")
        axis.set_xticks(range(3), words)
        axis.set_yscale("log")
        axis.margins(x=0.15, y=0.12)
        shown = factor * np.append(values, gap.noise_floor)
        if np.nanmax(shown) < NO_GAP * np.nanmin(shown):  # a permille is not to look like a gap
            axis.set_ylim(np.nanmin(shown) / NO_GAP, np.nanmax(shown) * NO_GAP)
        axis.set_ylabel(f"RMS ({unit})")
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
    rows: list[list[Cell]] = [
        [label, *(Quantity(v, gap.unit) for v in row)]
        for label, row in (("fitted", gap.fit), ("held out", gap.held_out))]
    rows.append(["noise floor", Quantity(gap.noise_floor, gap.unit), None, None])
    return Drawing(figure, Table(("records", *words), rows))


def _effects(page: Page, found: Diagnosis) -> None:
    if found.effects:
        page.section("What was found", "In the order in which it shrank the gap. Intervals are "
                     "95 %.")
        for effect in found.effects:
            page.table(("parameter", "value"),
                       [[n, Quantity(q.value, q.unit, q.ci95)]
                        for n, q in effect.parameters.items()],
                       f"{' or '.join(effect.members)}: {effect.gap_share:.0%} of the gap's "
                       "power")
            page.text("\n\n".join(line[:1].upper() + line[1:] + "." for line in effect.evidence))
    elif found.description is not None:
        d = found.description
        page.section("What is left over", "No effect of the library explains it. In the "
                     "reading it looks like this.")
        page.table(("property", "value"), [
            ["parity", d.parity], ["memory", d.memory],
            ["grows with amplitude to the power", d.amplitude_exponent],
            ["strongest at", None if d.frequency_hz is None else Quantity(d.frequency_hz, "Hz")],
            ["side", d.side]])
    page.table(("base parameter", "re-estimated"),
               [[n, Quantity(q.value, q.unit, q.ci95)] for n, q in found.base.items()])


def _compared(found: Diagnosis, held_out: bool) -> list[tuple[Comparison, Array, Array]]:
    """Records with what the model leaves of them, given and as answered (N,)."""
    return [(c, c.left["given"], c.left[found.shown]) for c in found.comparisons
            if c.held_out == held_out and {"given", found.shown} <= set(c.left)]


def _simulated(page: Page, found: Diagnosis) -> None:
    shown = [*_compared(found, False)[:1], *_compared(found, True)[:1]]
    if shown:
        page.section("Measured against simulated", "Nothing but initial states and offsets are "
                     "adapted on held-out records.")
    for run, before, after in shown:
        page.figure(time_figure(run.time, [
            (run.measures, found.gap.unit, {
                "measured": run.measured, "before": run.measured - before,
                "after": run.measured - after}),
            ("left before", found.gap.unit, {"before": before}),
            ("left after", found.gap.unit, {"after": after})]),
            f"{run.name} ({'held out' if run.held_out else 'fitted'}): {run.measures}, and what "
            "is left over before and after")


def _evidence(page: Page, found: Diagnosis) -> None:
    for run, before, after in _compared(found, False)[:1]:
        page.section("Where it is", "The gap in frequency, over the output and over its rate, "
                     "before and after. Flat curves at the noise are what a complete model "
                     "leaves.")
        page.figure(_localised(run, before, after, found.gap.unit),
                    f"The gap of {run.name}, localised")
        page.table(("record", "finding", "value", "limit", "", "meaning"), [
            [name, f.name.replace("_", " "), f.value, f.limit, "real" if f.real else "noise",
             f.text] for name, each in found.findings.items() for f in each],
            "What is left over by the best model, against what noise would give")


def _localised(run: Comparison, before: Array, after: Array, unit: str) -> Drawing:
    change = np.gradient(run.measured, run.sample_period)
    names, rate = {
        "position": (("position", "speed"), "/s"),
        "velocity": (("velocity", "acceleration"), "/s^2"),
        "acceleration": (("acceleration", "jerk"), "/s^3")}[run.measures]
    per_time = unit.partition("/")[0] + rate
    factor, shown = display_unit((float(np.max(np.abs(before))),), unit)
    abscissae = [(signal, *display_unit((float(np.max(np.abs(signal))),), its)) for signal, its in
                 ((run.measured, unit), (change, per_time))]
    figure, axes = new_figure(3, 5.6, squeeze=False)
    rows: list[list[Cell]] = []
    with page_style():
        for label, left, colour in (("before", before, "C1"), ("after", after, "C2")):
            hertz, power = density(left, min(4096, left.size // 2), run.sample_period)
            axes[0, 0].loglog(hertz[1:], np.sqrt(power[1:]) * factor, color=colour, label=label)
            for row, (along, scale, _) in enumerate(abscissae, 1):
                centre, mean = _binned(along, left)
                axes[row, 0].plot(scale * centre, mean * factor, color=colour, marker="o",
                                  markersize=2.5)
            rows.append([label, Quantity(float(np.std(left)), unit),
                         float(hertz[1 + int(np.argmax(power[1:]))])])
        axes[0, 0].set(xlabel="frequency (Hz)", ylabel=f"gap ({shown}/√Hz)")
        axes[0, 0].legend(loc="best")
        log_labels(axes[0, 0].xaxis, axes[0, 0].yaxis)
        for row, name in enumerate(names, 1):
            axes[row, 0].set(xlabel=f"{name} ({abscissae[row - 1][2]})",
                             ylabel=f"mean gap ({shown})")
    return Drawing(figure, Table(("", "RMS", "strongest at (Hz)"), rows))


def _binned(along: Array, values: Array) -> tuple[Array, Array]:
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    place = np.clip(np.searchsorted(edges, along, "right") - 1, 0, BINS - 1)
    count = np.maximum(np.bincount(place, minlength=BINS), 1)
    return (np.bincount(place, along, BINS) / count, np.bincount(place, values, BINS) / count)


def _rejected(page: Page, found: Diagnosis) -> None:
    page.section("What it is not")
    page.table(("effect", "held-out RMS with it", "why not"), [
        [r.name, None if r.held_out_rms is None else Quantity(r.held_out_rms, found.gap.unit),
         r.reason] for r in found.rejected])
    if found.detection_limits:
        page.section("What would have shown",
                     "Half of all records like these would have named an effect of this size; a "
                     "smaller one may be there. Reckoned to first order, at the value of its "
                     "other parameters that shows it best.")
        page.table(("effect", "parameter", "size"),
                   [[name, n, Quantity(size.value, size.unit)]
                    for name, sizes in sorted(found.detection_limits.items())
                    for n, size in sizes.items()])


def _next(page: Page, found: Diagnosis) -> None:
    if found.next_experiment is None:
        return
    page.section("The next experiment", str(found.next_experiment.get("description", "")))
    page.table(("setting", "value"), [
        ["duration (s)", float(found.next_experiment["duration_s"])],
        *([k, v if isinstance(v, (str, bool)) else float(v)] for k, v in
          found.next_experiment["axes"]["x"]["excitation"].items())],
        "next_experiment.yaml, as the trajectory generator and diagnose --run take it")
