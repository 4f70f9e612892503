"""Plots in a real browser: values under the pointer, zoom, at the width of a phone and a desk."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from dfm_stage.reporting import Page, Response, bode_figure, new_figure, time_figure

T = np.arange(40_000) * 1e-3
Y = 1e-3 * np.sin(3.0 * T) + 2e-4 * np.sin(40.0 * T)
F = np.geomspace(1.0, 70.0, 80)
PLACES = (0.03, 0.25, 0.375, 0.7, 0.98)
ZOOM = (0.25, 0.5)
SCRIPT = """
const seen = frame => {
  const page = frame.contentDocument, view = frame.contentWindow;
  const plots = [...page.querySelectorAll(".plot")].filter(e => e.getClientRects().length);
  const send = (target, kind, x, y) => target.dispatchEvent(new view.PointerEvent(
    kind, {clientX: x, clientY: y, bubbles: true, pointerType: "mouse"}));
  const ticks = svg => [...svg.querySelectorAll("[id$='-x'] text")].filter(
    e => e.getClientRects().length && !/\\(/.test(e.textContent)).map(e => e.textContent);
  return plots.map(plot => {
    plot.scrollIntoView();
    const svg = plot.querySelector("svg");
    const panels = [...svg.querySelectorAll("[id*='-axes_'], [id$='-panel0'], [id$='-panel1']")];
    const box = panel => panel.querySelector("[id*='patch_'] path").getBoundingClientRect();
    const at = (panel, kind, across, up, target) => send(target ?? plot, kind,
      box(panel).left + across * box(panel).width, box(panel).bottom - up * box(panel).height);
    const lines = () => [...plot.querySelectorAll(".readout div")].map(e => e.textContent);
    const hover = place => panels.map(panel => {
      at(panel, "pointermove", place, 0.5);
      const edge = plot.querySelector(".readout").getBoundingClientRect();
      return {lines: lines(), wide: page.documentElement.scrollWidth > view.innerWidth,
              inside: edge.left >= 0 && edge.right <= view.innerWidth};
    });
    const key = name => {
      svg.dispatchEvent(new view.KeyboardEvent("keydown", {key: name, bubbles: true}));
      return lines();
    };
    const drawn = () => panels.map(panel =>
      [...panel.querySelectorAll("path, use")].map(e => e.outerHTML).join(""));
    const before = ticks(svg), first = drawn();
    const whole = PLACES.map(hover), walked = [key("ArrowRight"), key("ArrowRight")];
    at(panels[0], "pointerdown", ZOOM[0], 0.5);
    at(panels[0], "pointermove", ZOOM[1], 0.5);
    at(panels[0], "pointerup", ZOOM[1], 0.5, view);
    const zoomed = {ticks: ticks(svg), middle: hover(0.5), drawn: drawn()};
    at(panels[0], "dblclick", 0.5, 0.5);
    const reset = ticks(svg), last = drawn();
    send(plot, "pointerleave", 0, 0);
    return {before, whole, walked, zoomed, reset, first, last, left: lines()};
  });
};""".replace("PLACES", str(list(PLACES))).replace("ZOOM", str(list(ZOOM)))


@pytest.fixture(scope="module")
def opened(browse: Callable[..., list[Any]], tmp_path_factory: pytest.TempPathFactory
           ) -> list[tuple[Any, list[list[str]], tuple[float, float], bool]]:
    """What was seen of a plot, the columns of its CSV, and limits and scale of its abscissa."""
    drawings = [
        time_figure(T, [("position", "m", {"measured": Y, "simulated": 0.9 * Y}),
                        ("left", "m", {"left": 0.1 * Y})]),
        bode_figure([Response("measured", F, 1.0 / (1.0 + 1j * F), np.full(F.size, 1e-3), True),
                     Response("model", F, 1.0 / (1.0 + 1.1j * F))])]
    page = Page("Plots").section("One")
    for drawing in drawings:
        page.figure(drawing, "A plot, with an unbreakable_caption.")
    path = page.write(tmp_path_factory.mktemp("plots") / "report.html")
    tables = [list(zip(*csv.reader(io.StringIO(unquote(found))), strict=True)) for found in
              re.findall(r'href="data:text/csv;charset=utf-8,([^"]*)"', path.read_text("utf-8"))]
    axes = [drawing.figure.axes[-1] for drawing in drawings]
    return [(plot, table, axis.get_xlim(), axis.get_xscale() == "log")
            for frame in browse(path, SCRIPT)
            for plot, table, axis in zip(frame, tables, axes, strict=True)]


def value_at(place: float, limits: tuple[float, float], log: bool) -> float:
    """Abscissa a share of the panel's width from its left edge."""
    low, high = np.log10(limits) if log else limits
    return float(10 ** (low + place * (high - low)) if log else low + place * (high - low))


def samples(table: list[list[str]], column: int) -> tuple[np.ndarray, list[str]]:
    """Abscissae and cells of a curve: the abscissa is the last one named so before it."""
    name = table[0][0]
    x = next(table[i] for i in range(column, -1, -1) if table[i][0] == name)
    filled = [i for i in range(1, len(x)) if x[i]]
    return np.array([float(x[i]) for i in filled]), [table[column][i] for i in filled]


def expected(table: list[list[str]], column: int, x: float, log: bool) -> str:
    """The CSV's cell at the sample nearest to x."""
    abscissae, cells = samples(table, column)
    scale = np.log10 if log else np.asarray
    return cells[int(np.argmin(np.abs(scale(abscissae) - scale(x))))]


def told(line: str) -> str:
    """The number of a line of the readout, as the CSV writes it."""
    return re.search(r"[−\d.e]+(?=\s?\S*$)", line)[0].replace("−", "-")


def curves(table: list[list[str]], panel: int) -> list[int]:
    """Columns of the curves of a panel: those after its abscissae, told apart by their axis."""
    named = [i for i, column in enumerate(table) if column[0] != table[0][0]]
    axes = list(dict.fromkeys(table[i][0].rpartition(", ")[2] for i in named))
    return [i for i in named if table[i][0].endswith(axes[panel])]


def test_pointing_tells_the_nearest_sample_of_each_curve(opened: Any) -> None:
    assert len(opened) == 4
    for plot, table, limits, log in opened:
        for place, panels in zip(PLACES, plot["whole"], strict=True):
            x = value_at(place, limits, log)
            for number, panel in enumerate(panels):
                _, *lines, hint = panel["lines"]
                assert [told(line) for line in lines] == [
                    expected(table, column, x, log) for column in curves(table, number)]
                assert hint == "drag: zoom"


def test_the_readout_stays_inside_the_window(opened: Any) -> None:
    said = [panel for plot, *_ in opened for panels in plot["whole"] for panel in panels]
    assert not any(panel["wide"] for panel in said)
    assert all(panel["inside"] for panel in said)
    assert all(plot["left"] == [] for plot, *_ in opened)


def test_dragging_narrows_the_axis_of_every_panel_below(opened: Any) -> None:
    for plot, table, limits, log in opened:
        shown = [float(text.replace("−", "-")) for text in plot["zoomed"]["ticks"]]
        low, high = (value_at(each, limits, log) for each in ZOOM)
        assert len(shown) >= 3
        assert low <= min(shown) < max(shown) <= high
        for number, panel in enumerate(plot["zoomed"]["middle"]):
            x = value_at(sum(ZOOM) / 2, limits, log)
            assert told(panel["lines"][1]) == expected(
                table, curves(table, number)[0], x, log)
            assert plot["zoomed"]["drawn"][number] != plot["first"][number]


def test_a_double_click_shows_all_again(opened: Any) -> None:
    for plot, *_ in opened:
        assert plot["reset"] == plot["before"]
        assert plot["last"] == plot["first"]


def test_arrows_walk_along_the_samples(opened: Any) -> None:
    for plot, table, limits, log in opened:
        abscissae, _ = samples(table, curves(table, 1)[0])
        scale = np.log10 if log else np.asarray
        start = np.argmin(np.abs(scale(abscissae) - scale(value_at(PLACES[-1], limits, log))))
        for step, lines in enumerate(plot["walked"], 1):
            assert float(told(lines[0])) == abscissae[min(start + step, abscissae.size - 1)]


def marks(drawn: str) -> list[float]:
    """Abscissae of a panel's markers, on the page."""
    return [float(x) for x in re.findall(r'<use href="[^"]*" x="([^"]*)" y="[^"]*"></use>', drawn)]


def bars(drawn: str) -> list[float]:
    """Abscissae of a panel's error bars, on the page."""
    return [float(x) for x in re.findall(
        r'<path d="M (\S+) \S+\s+L \1 \S+\s+" clip-path="[^"]*" style="[^"]*width: 0.8"', drawn)]


def test_error_bars_and_bands_move_with_their_points(
        browse: Callable[..., list[Any]], tmp_path: Path) -> None:
    figure, axes = new_figure()
    x = np.arange(12.0)
    y = np.where(x == 3.0, np.nan, np.sin(x))
    axes.errorbar(x, y, 0.3, marker="o", elinewidth=0.8, label="at 3 mm/s")
    axes.set(ylabel="force (N)")
    axes.fill_between(x, np.cos(x), 2.0)
    page = Page("a").section("s").figure(figure, "c").write(tmp_path / "report.html")
    for (plot,) in browse(page, SCRIPT):
        (whole,), (zoomed,) = plot["first"], plot["zoomed"]["drawn"]
        assert len(marks(whole)) == 11
        assert plot["whole"][0][0]["lines"][1] == "at 3 mm/s 0\u00a0N"
        for drawn in (whole, zoomed):
            assert bars(drawn) == pytest.approx(marks(drawn), abs=0.05)
        assert np.ptp(marks(zoomed)) == pytest.approx(
            np.ptp(marks(whole)) / (ZOOM[1] - ZOOM[0]), rel=1e-2)
        # the band is a path of its own, from the first point to the last
        band = [[float(each) for each in re.findall(r"[ML] (\S+) ", path)] for path in (
            next(d for d in re.findall(r' d="([^"]*)"', drawn) if d.count("L") >= 23)
            for drawn in (whole, zoomed))]
        assert np.ptp(band[1]) == pytest.approx(np.ptp(band[0]) / (ZOOM[1] - ZOOM[0]), rel=1e-2)
        assert plot["last"] == plot["first"]


def test_words_and_points_that_do_not_run_along_an_axis(
        browse: Callable[..., list[Any]], tmp_path: Path) -> None:
    named, axes = new_figure()
    axes.plot([0, 1, 2], [4.0, 5.0, 7.0], "o", label="RMS")
    axes.set_xticks([0, 1, 2], ["as given", "retuned, twice", "after"])
    axes.set(ylabel="RMS (nm)")
    closed, axes = new_figure()
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    axes.plot(np.cos(angle), np.sin(angle))
    axes.set(xlabel="x (mm)", ylabel="force (N)")
    page = Page("a").section("s").figure(named, "c").figure(closed, "d")
    for words, loop in browse(page.write(tmp_path / "report.html"), SCRIPT):
        assert [panel["lines"][:2] for (panel,) in words["whole"]] == [
            [word, f"RMS {value}\u00a0nm"] for word, value in (
                ("as given", 4), ("as given", 4), ("retuned, twice", 5), ("retuned, twice", 5),
                ("after", 7))]
        assert words["zoomed"]["ticks"] == words["before"]      # words are not zoomed
        for (panel,) in loop["whole"]:
            x, y, _ = panel["lines"]                            # one sample, not one a branch
            assert np.hypot(float(told(x)), float(told(y))) == pytest.approx(1.0, abs=1e-4)
