"""The page of a learning run: error per pass, and the error before and after."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.reporting import (
    Page,
    Quantity,
    Table,
    display_unit,
    format_quantity,
    new_figure,
    page_style,
    time_figure,
)


def learning_page(axes: list[Any], out: Path, options: argparse.Namespace) -> Path:
    """Write report.html into `out` and return its path; `axes` as in `learn.Axis`."""
    page = Page(f"Learning of {options.experiment}")
    for axis in axes:
        before, after = axis.line_rms()
        better = after < before
        page.lead(f"{axis.name}: {format_quantity(before, 'm')} RMS on the line in the first "
                  f"pass, {format_quantity(after, 'm')} with the learnt signal.",
                  "learnt" if better else "not learnt", "good" if better else "warn")
        if axis.learner.stopped:
            page.note(f"{axis.name}: stopped: {axis.learner.stopped}")
        errors = np.array(axis.learner.errors)
        factor, unit = display_unit(errors, "m")
        figure, plot = new_figure()
        with page_style():
            passes = 1 + np.arange(errors.size)
            plot.semilogy(passes, factor * errors, marker="o")
            plot.set(xlabel="pass", ylabel=f"error, RMS ({unit})")
            plot.xaxis.get_major_locator().set_params(integer=True)
        page.figure(
            figure, f"{axis.name}: error of every pass as measured, over the whole of it",
            Table(["pass", f"error, RMS ({unit})"],
                  list(zip(passes.tolist(), (factor * errors).tolist(), strict=True))))
        page.figure(time_figure(axis.reference.time_s, [
            ("first pass", "m", {"error": axis.first_error}),
            ("learnt", "m", {"error": axis.error})]),
            f"{axis.name}: error r − y of the first pass and of the one that uses the learnt "
            "signal; note the scales")
        d = axis.learner.design
        page.table(["what", "value"], [
            ["error per pass shrinks to at most", f"{d.contraction:.3f}"],
            ["with each parameter off by", f"{options.uncertainty:.0%}"],
            ["learnt up to", Quantity(d.cutoff_hz, "Hz")],
            ["share per pass", f"{options.gain:g}"]],
            f"{axis.name}: the convergence condition, checked before the first pass")
    page.provenance({"Experiment": options.experiment, "Model": options.model or options.bag,
                     "Plant": options.plant or "as the model"})
    return page.write(out / "report.html")
