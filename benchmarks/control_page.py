"""The comparison of controllers as a page and as pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.control_scan import ScanRun, tabled
from benchmarks.figure import Figure
from benchmarks.picture import write_picture
from dfm_stage.reporting import Page, Table, new_figure, page_style

Scenarios = Mapping[str, Mapping[str, ScanRun]]
Make = Callable[[int, float], tuple[Any, Any]]
SCENARIOS = {
    "": "The stage, controllers tuned on the model identified from a bag of it",
    ".wrong_10": "Controllers tuned on a model that is 10 % wrong",
    ".friction": "0.02 N of dry friction that the model lacks",
    ".effects": "A stage with cubic stiffness, dry friction and a sloping force constant; "
                "controllers tuned on its linear part",
    ".redesigned": "The same stage, controllers tuned again on the extended model",
}


def write_page(scenarios: Scenarios, figures: list[Figure], folder: Path) -> Path:
    """Write control.html and its pictures into a folder; return the page."""
    met = [each.met for each in figures if each.met is not None]
    page = Page("Controllers on the same scan")
    page.lead(f"{sum(met)} of {len(met)} promised figures are met. A raster of 5 mm in 0.4 s with "
              "turnarounds of 0.1 s; errors are those of the plant's true position.",
              "met" if all(met) else "missed", "good" if all(met) else "bad")
    page.section("At a glance")
    _show(page, folder / "control_comparison.png", partial(at_a_glance, scenarios),
          "error on the line of every controller, by what its model knows of the stage")
    for suffix, runs in scenarios.items():
        page.section(SCENARIOS[suffix])
        columns, rows = tabled(runs)
        page.table(columns, rows)
        _show(page, None if suffix else folder / "control_errors.png",
              partial(errors_over_time, runs),
              "error over the last line there and back; note the scales",
              Table(columns[:5], [row[:5] for row in rows]))
        run = runs["learning"]
        nm = 1e9 * np.array(run.per_pass_m)
        _show(page, folder / "control_learning.png" if suffix == ".wrong_10" else None,
              partial(pass_by_pass, nm), f"learning, pass by pass: {run.note}",
              Table(["pass", "line RMS / nm"], [[k + 1, v] for k, v in enumerate(nm.tolist())]))
    page.section("All figures")
    page.table(["key", "value", "unit", "bar", "met", "how"],
               [[f.key, f.value, f.unit, f.bar,
                 "" if f.met is None else "met" if f.met else "MISSED", f.how] for f in figures])
    return page.write(folder / "control.html")


def errors_over_time(runs: Mapping[str, ScanRun], make: Make) -> Any:
    """Return a plot of every controller's error over the last period, in um."""
    figure, plots = make(len(runs), 1.3 * len(runs) + 0.6)
    for plot, (name, run) in zip(plots, runs.items(), strict=True):
        n = run.scan.period_samples
        t = np.arange(n) * run.scan.sample_period_s
        plot.fill_between(t, 0, 1, where=run.scan.steady[-n:], alpha=0.08, linewidth=0,
                          transform=plot.get_xaxis_transform())
        plot.plot(t, run.error[-n:] * 1e6, linewidth=1.0)
        plot.set_ylabel(f"{name}\n/ um", fontsize=8)
    plots[-1].set_xlabel("time / s (shaded: the line)")
    return figure


def pass_by_pass(nm: Any, make: Make) -> Any:
    """Return a plot of the learning's error, nm, over its passes."""
    figure, plot = make(1, 2.8)
    plot.semilogy(1 + np.arange(len(nm)), nm, marker="o")
    plot.axhline(100.0, linestyle="--", linewidth=1.0)
    plot.set_xlabel("pass")
    plot.set_ylabel("error on the line / nm RMS")
    return figure


def at_a_glance(scenarios: Scenarios, make: Make) -> Any:
    """Return a plot of all errors on the line."""
    figure, plot = make(1, 3.4)
    names = list(scenarios[""])
    width = 0.8 / len(scenarios)
    for i, (suffix, runs) in enumerate(scenarios.items()):
        values = [runs[name].figures(1 if name == "learning" else 3)["line_rms_nm"][0]
                  if name in runs else np.nan for name in names]
        plot.bar(np.arange(len(names)) + i * width, values, width,
                 label=suffix.lstrip(".") or "identified")
    plot.set_yscale("log")
    plot.set_xticks(np.arange(len(names)) + 0.4 - 0.5 * width, names)
    plot.set_ylabel("error on the line / nm RMS")
    plot.legend(fontsize=8)
    return figure


def _show(page: Page, picture: Path | None, draw: Callable[[Make], Any], caption: str,
          table: Table | None = None) -> None:
    """Put a drawing on the page and, in colours of its own, into a picture."""
    with page_style():
        page.figure(draw(lambda rows, height: new_figure(rows, height, sharex=True)), caption,
                    table)
    if picture is not None:
        write_picture(draw(_on_white), picture, dpi=110)


def _on_white(rows: int, height_in: float) -> tuple[Any, Any]:
    from matplotlib.figure import Figure as Canvas

    figure = Canvas(figsize=(7.6, height_in), layout="constrained")
    axes = figure.subplots(rows, sharex=True)
    for each in np.atleast_1d(axes):
        each.grid(alpha=0.3)
    return figure, axes
