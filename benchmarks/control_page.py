"""The comparison of controllers as a page and as pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.control_scan import Run, tabled
from benchmarks.figure import Figure
from dfm_stage.reporting import Page, Table, new_figure, page_style

SCENARIOS = {
    "": "The stage, controllers tuned on the model identified from a bag of it",
    ".wrong_10": "Controllers tuned on a model that is 10 % wrong",
    ".friction": "0.02 N of dry friction that the model lacks",
    ".effects": "A stage with cubic stiffness, dry friction and a sloping force constant; "
                "controllers tuned on its linear part",
    ".redesigned": "The same stage, controllers tuned again on the extended model",
}


def write_page(scenarios: Mapping[str, Mapping[str, Run]], figures: list[Figure],
               folder: Path) -> Path:
    """Write control.html and its pictures into a folder; return the page."""
    met = [each.met for each in figures if each.met is not None]
    page = Page("Controllers on the same scan")
    page.lead(f"{sum(met)} of {len(met)} promised figures are met. A raster of 5 mm in 0.4 s with "
              "turnarounds of 0.1 s; errors are those of the plant's true position.",
              "met" if all(met) else "missed", "good" if all(met) else "bad")
    for suffix, runs in scenarios.items():
        page.section(SCENARIOS[suffix])
        columns, rows = tabled(runs)
        page.table(columns, rows)
        drawing = errors_over_time(runs)
        page.figure(drawing, "error over the last line there and back; note the scales",
                    Table(columns[:5], [row[:5] for row in rows]))
        if not suffix:
            _save(drawing, folder / "control_errors.png")
        if runs["learning"].per_pass_m:
            _learning(page, runs["learning"], folder if suffix == ".wrong_10" else None)
    _bars(page, scenarios, folder)
    page.section("All figures")
    page.table(["key", "value", "unit", "bar", "met", "how"],
               [[f.key, f.value, f.unit, f.bar,
                 "" if f.met is None else "met" if f.met else "MISSED", f.how] for f in figures])
    return page.write(folder / "control.html")


def errors_over_time(runs: Mapping[str, Run]) -> Any:
    """Return a plot of every controller's error over the last period, in um."""
    with page_style():
        figure, plots = new_figure(len(runs), 1.3 * len(runs) + 0.6, sharex=True)
        for plot, (name, run) in zip(plots, runs.items(), strict=True):
            n = run.scan.period_samples
            t = np.arange(n) * run.scan.sample_period_s
            error, line = run.error[-n:] * 1e6, run.scan.steady[-n:]
            plot.fill_between(t, 0, 1, where=line, transform=plot.get_xaxis_transform(),
                              alpha=0.08, linewidth=0)
            plot.plot(t, error, linewidth=1.0)
            plot.set_ylabel(f"{name}\n/ um", fontsize=8)
        plots[-1].set_xlabel("time / s (shaded: the line)")
    return figure


def _learning(page: Page, run: Run, folder: Path | None) -> None:
    with page_style():
        figure, plot = new_figure(1, 2.8)
        passes = 1 + np.arange(len(run.per_pass_m))
        nm = 1e9 * np.array(run.per_pass_m)
        plot.semilogy(passes, nm, marker="o")
        plot.axhline(100.0, linestyle="--", linewidth=1.0)
        plot.set_xlabel("pass")
        plot.set_ylabel("error on the line / nm RMS")
    page.figure(figure, f"learning, pass by pass: {run.note}",
                Table(["pass", "line RMS / nm"], list(zip(passes.tolist(), nm.tolist(),
                                                          strict=True))))
    if folder is not None:
        _save(figure, folder / "control_learning.png")


def _bars(page: Page, scenarios: Mapping[str, Mapping[str, Run]], folder: Path) -> None:
    with page_style():
        figure, plot = new_figure(1, 3.4)
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
    page.section("At a glance")
    page.figure(figure, "error on the line of every controller, by what its model knows of the "
                "stage")
    _save(figure, folder / "control_comparison.png")


def _save(figure: Any, path: Path) -> None:
    temporary = path.with_name(f".{path.name}")
    figure.savefig(temporary, format="png", dpi=120)
    temporary.replace(path)
