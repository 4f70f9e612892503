"""Sections of the page that diagnose writes: the missing force, and formulas for it."""

from __future__ import annotations

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis import Diagnosis, wording
from dfm_stage.diagnosis.evidence import Offer
from dfm_stage.diagnosis.spectra import density
from dfm_stage.diagnosis.surface import FILE, Surface
from dfm_stage.model.formula_text import value
from dfm_stage.reporting import (
    Drawing,
    Page,
    Quantity,
    Table,
    display_unit,
    format_number,
    log_labels,
    new_figure,
    page_style,
)
from dfm_stage.reporting.figures import thinned
from dfm_stage.reporting.table import Cell


def accepted(page: Page, found: Diagnosis) -> None:
    """The formulas that were added to the model."""
    for each in found.accepted:
        page.section("What was accepted", f"{each.name}: force = {each.force}. The gap above is "
                     "told without it (as given, retuned) and with it.")
        page.table(("parameter", "value"), [[n, Quantity(q.value, q.unit, q.ci95)]
                                            for n, q in each.parameters.items()])


def missing_force(page: Page, found: Diagnosis) -> None:
    """The force that is missing, over position and velocity, time and frequency."""
    s = found.surface
    if s is None:
        return
    page.section("The force that is missing", f"{wording.missing_force(s)}\n\nThe picture leaves "
                 "out what is linear in position or velocity, the stage's own stiffness and "
                 "damping"
                 + (", and what was found." if found.effects else "."))
    page.figure(_sections(s), "The missing force along sections of its surface, with 95 % "
                "intervals")
    page.text(f"{FILE} has the whole surface.")
    if s.history is not None:
        page.figure(_history(s, *s.history), "The missing force over time and frequency, along "
                    "the first record")


def _sections(s: Surface) -> Drawing:
    """Force over position at three speeds, and over velocity at three positions."""
    force, newton = display_unit((float(np.nanmax(np.abs(s.force))),), s.force_unit)
    figure, axes = new_figure(2, 5.0, squeeze=False)
    rows: list[list[Cell]] = []
    motions = (("position", s.x, s.unit), ("velocity", s.v, f"{s.unit}/s"))
    with page_style():
        for number, (name, along, unit) in enumerate(motions):
            axis, (other, across, its) = axes[number, 0], motions[1 - number]
            (factor, shown), (scale, at_unit) = (
                display_unit((float(np.nanmax(np.abs(each))),), of)
                for each, of in ((along, unit), (across, its)))
            for colour, at in enumerate(_chosen(s, number)):
                line = (slice(None), at) if number == 0 else (at, slice(None))
                place = format_number(scale * float(np.nanmean(across[line])), 2)
                axis.errorbar(factor * along[line], force * s.force[line],
                              1.96 * force * s.standard_error[line], color=f"C{colour}",
                              marker="o", elinewidth=0.8, label=f"at {place} {at_unit}")
                told = s.force[line][np.isfinite(s.force[line])]
                rows.append([f"{other} {place} {at_unit}", int(np.sum(s.samples[line])), Quantity(
                    float(told.min()), s.force_unit), Quantity(float(told.max()), s.force_unit)])
            axis.set(xlabel=f"{name} ({shown})", ylabel=f"missing force ({newton})")
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1,
                        handlelength=1.0, columnspacing=1.0)
        figure.align_ylabels()
    return Drawing(figure, Table(("section at", "samples", "smallest", "largest"), rows))


def _chosen(s: Surface, number: int) -> list[int]:
    """The middle bin of the axis that is not `number`, and one half-way to each end, as far as
    they hold anything."""
    counts = np.isfinite(s.force).sum(axis=number)
    middle = counts.size // 2
    reach = (counts.size + 1) // 4
    return [at for at in (middle - reach, middle, middle + reach) if counts[at] > 1]


def _history(s: Surface, time_s: Array, force: Array) -> Drawing:
    """Force over time, and its spectrum."""
    factor, newton = display_unit((float(np.max(np.abs(force))),), s.force_unit)
    figure, axes = new_figure(2, 4.6, squeeze=False)
    step = float(np.median(np.diff(time_s)))
    even = np.interp(np.arange(time_s[0], time_s[-1], step), time_s, force)  # rests are left out
    hertz, power = density(even, min(4096, max(even.size // 4, 8)), step)
    with page_style():
        axes[0, 0].plot(*thinned(time_s, factor * force))
        axes[0, 0].set(xlabel="time (s)", ylabel=f"missing force ({newton})")
        axes[1, 0].loglog(hertz[1:], factor * np.sqrt(power[1:]))
        axes[1, 0].set(xlabel="frequency (Hz)", ylabel=f"density ({newton}/√Hz)")
        log_labels(axes[1, 0].xaxis, axes[1, 0].yaxis)
        figure.align_ylabels()
    top = float(hertz[1 + int(np.argmax(power[1:]))])
    return Drawing(figure, Table(("", "RMS", "strongest at"), [[
        "missing force", Quantity(float(np.std(force)), s.force_unit), Quantity(top, "Hz")]]))


def formulas(page: Page, found: Diagnosis) -> None:
    """The formulas that are offered."""
    s = found.surface
    if s is None:
        return
    if not found.formulas:
        page.section("Formulas for it", f"{wording.NO_FORMULA.capitalize()}.")
        return
    page.section("Formulas for it", "Found by sparse regression of the missing force, then fitted "
                 "and judged in simulation as effects are. A formula is no name: it says how the "
                 "force behaves, not what makes it. `diagnose --accept FILE` adds one to the "
                 "model.")
    page.table(("file", "force", "share of the held-out gap", "held-out RMS with it",
                "all terms chosen again"), [
        [o.file, o.formula.text + (f" beside {', '.join(o.beside)}" if o.beside else ""),
         f"{o.share:.0%}", Quantity(o.held_out_rms, found.gap.unit),
         f"{round(o.found_in * o.draws)} of {o.draws} draws"] for o in found.formulas])
    for o in found.formulas:
        page.table(("parameter", "value"), [[n, Quantity(q.value, q.unit, q.ci95)]
                                            for n, q in o.parameters.items()],
                   f"{o.formula.name}, intervals of 95 %; " + "; ".join(
                       f"{text} in {n} of {o.draws} draws" for text, n in o.came_back))
    drawn = [(o, force) for o in found.formulas if set(o.beside) == set(found.names)
             and (force := _along(o, s)) is not None]
    if drawn:
        page.figure(_overlaid(s, drawn), "The missing force over position and over velocity, "
                    "means of its surface with 95 % intervals, and the formulas")


def _along(o: Offer, s: Surface) -> Array | None:
    """The force of a formula in the bins of the surface, off what is linear; None where it takes
    more than position and velocity."""
    effect = o.formula.effect()
    values = {p.name: p.value for p in o.formula.parameters}
    if {"i", "u", "t"} & effect.tree.names or o.formula.kind != "force":
        return None
    told = np.isfinite(s.force)
    x, v = s.x[told], s.v[told]
    force = np.full(s.force.shape, np.nan)
    force[told] = value(effect.tree, {"x": x, "v": v, **values})
    return _off_linear(force, s)


def _off_linear(force: Array, s: Surface) -> Array:
    """A force in the bins without a level and what is linear in position or velocity there."""
    told = np.isfinite(s.force)
    x, v, weight = s.x[told], s.v[told], np.sqrt(s.samples[told])
    linear = np.column_stack((np.ones_like(x), x / max(float(np.std(x)), 1e-300),
                              v / max(float(np.std(v)), 1e-300)))
    taken = np.linalg.lstsq(linear * weight[:, None], force[told] * weight, rcond=None)[0]
    off = np.full(force.shape, np.nan)
    off[told] = force[told] - linear @ taken
    return off


def _overlaid(s: Surface, drawn: list[tuple[Offer, Array]]) -> Drawing:
    """Means over the other axis."""
    factor, newton = display_unit((float(np.nanmax(np.abs(s.force))),), s.force_unit)
    figure, axes = new_figure(2, 5.0, squeeze=False)
    rows: list[list[Cell]] = []
    measured = _off_linear(s.force, s)
    motions = (("position", s.x, s.unit), ("velocity", s.v, f"{s.unit}/s"))
    with page_style():
        for number, (name, along, unit) in enumerate(motions):
            axis, over = axes[number, 0], 1 - number
            scale, shown = display_unit((float(np.nanmax(np.abs(along))),), unit)
            place, mean = scale * _mean(along, s, over), factor * _mean(measured, s, over)
            error = factor * np.sqrt(_mean(s.standard_error**2, s, over))
            axis.errorbar(place, mean, 1.96 * error, color="C0", marker="o", linestyle="none",
                          elinewidth=0.8, label="records")
            for colour, (o, force) in enumerate(drawn, 1):
                told = factor * _mean(force, s, over)
                axis.plot(place, told, color=f"C{colour}", label=o.formula.name)
                rows.append([f"{o.formula.name}, over {name}", Quantity(
                    float(np.nanstd(told - mean)) / factor, s.force_unit)])
            axis.set(xlabel=f"{name} ({shown})", ylabel=f"missing force ({newton})")
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.1)
        figure.align_ylabels()
    return Drawing(figure, Table(("formula", "RMS off the means"), rows))


def _mean(values: Array, s: Surface, over: int) -> Array:
    """Mean over one axis of the bins, weighted by their samples."""
    weight = np.where(np.isfinite(s.force), s.samples, 0.0)
    total = weight.sum(axis=over)
    return np.asarray(np.where(total > 0.0, np.sum(np.where(
        np.isfinite(s.force), values, 0.0) * weight, axis=over) / np.maximum(total, 1.0), np.nan))
