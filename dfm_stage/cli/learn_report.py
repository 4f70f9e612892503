"""The page of a learning run: error per pass, and the error before and after."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np


def learning_page(axes: list[Any], out: Path, options: argparse.Namespace) -> Path:
    """Write report.html into `out` and return its path; `axes` as in `learn.Axis`."""
    from dfm_stage.reporting import Page, Table, new_figure, page_style

    page = Page(f"Learning of {options.experiment}")
    for axis in axes:
        steady = axis.reference.steady
        before, after = (float(np.sqrt(np.mean(e[steady]**2))) * 1e9
                         for e in (axis.first_error, axis.error))
        better = after < before
        page.lead(f"{axis.name}: {before:.4g} nm RMS on the line in the first pass, "
                  f"{after:.4g} nm with the learnt signal.", "learnt" if better else "not learnt",
                  "good" if better else "warn")
        if axis.learner.stopped:
            page.note(f"{axis.name}: stopped: {axis.learner.stopped}")
        with page_style():
            figure, plot = new_figure()
            passes = 1 + np.arange(len(axis.learner.errors))
            nm = 1e9 * np.array(axis.learner.errors)
            plot.semilogy(passes, nm, marker="o")
            plot.set_xlabel("pass")
            plot.set_ylabel("error / nm RMS")
            rows = list(zip(passes.tolist(), nm.tolist(), strict=True))
            page.figure(figure, f"{axis.name}: error of every pass as measured, over the whole of "
                        "it", Table(["pass", "error / nm RMS"], rows))
            figure, plots = new_figure(2, 4.5, sharex=True)
            t = axis.reference.time_s
            for plot, error, label in zip(plots, (axis.first_error, axis.error),
                                          ("first pass", "learnt"), strict=True):
                plot.plot(t, error * 1e9, linewidth=0.8)
                plot.set_ylabel(f"{label} / nm")
            plots[-1].set_xlabel("time / s")
            page.figure(figure, f"{axis.name}: error r - y of the first pass and of the one that "
                        "uses the learnt signal")
        d = axis.learner.design
        page.table(["what", "value"], [
            ["error per pass shrinks to at most", f"{d.contraction:.3f}"],
            ["with each parameter off by", f"{options.uncertainty:.0%}"],
            ["learnt up to", f"{d.cutoff_hz:g} Hz"], ["share per pass", f"{options.gain:g}"]],
            f"{axis.name}: the convergence condition, checked before the first pass")
    page.provenance({"Experiment": options.experiment, "Model": options.model or options.bag,
                     "Plant": options.plant or "as the model"})
    return page.write(out / "report.html")
