"""The page: escaped, self-contained, well formed, written whole."""

from __future__ import annotations

import csv
import io
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from dfm_stage.reporting import (
    Page,
    Quantity,
    ReportError,
    Response,
    Table,
    bode_figure,
    new_figure,
    time_figure,
)
from dfm_stage.reporting.figures import GRID, INK, PAPER, SERIES, SOFT, to_svg

EVIL = '<script>alert("1")</script> & \'quoted\''
VOID = {"meta", "br", "hr", "img", "link", "input"}


class Checker(HTMLParser):
    """Collects text, ids and references, and insists on balanced tags."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.stack: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.tags: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.stack.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "action", "data"):
                self.references.append(value or "")
            assert not name.startswith("on")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.stack.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.stack
        assert self.stack.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def checked(html: str) -> Checker:
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert checker.stack == []
    return checker


@pytest.fixture(scope="module")
def full() -> Page:
    t = np.arange(5000) * 1e-3
    f = np.geomspace(1.0, 70.0, 60)
    s = 2j * np.pi * f
    g = 1.0 / (s**2 + 1.705 * s + 600.7)
    page = Page(EVIL)
    page.lead(EVIL, verdict=EVIL, tone="good").note(EVIL)
    page.section(EVIL, f"{EVIL}\n\nsecond")
    page.table((EVIL, "b"), [(EVIL, Quantity(1e-3, EVIL)), ("x", None)], EVIL)
    for _ in range(2):
        page.figure(bode_figure([Response(EVIL, f, g, np.full(60, 1e-6), measured=True),
                                 Response("model", f, g)]), EVIL)
        page.figure(time_figure(t, [("position", "m", {EVIL: np.sin(t), "b": np.cos(t)}),
                                    ("voltage", "V", {"u": t})]), EVIL)
    return page.provenance({EVIL: EVIL})


def test_everything_is_escaped(full: Page) -> None:
    html = full.html()
    assert html.count("<script") == 1            # ours
    text = "".join(checked(html).words)
    assert text.count(EVIL) >= 12


def test_nothing_is_asked_of_the_network(full: Page) -> None:
    html = full.html()
    checker = checked(html)
    assert checker.references
    assert all(reference.startswith(("#", "data:text/csv")) for reference in checker.references)
    assert html.count("<script>") == checker.tags.count("script") == 1
    assert not {"link", "img", "iframe", "object", "embed"} & set(checker.tags)
    assert "@import" not in html
    assert all(url.startswith("#") for url in re.findall(r"url\(([^)]*)\)", html))


def test_ids_are_unique_and_references_resolve(full: Page) -> None:
    html = full.html()
    checker = checked(html)
    assert len(checker.ids) == len(set(checker.ids))
    used = {r[1:] for r in checker.references if r.startswith("#")}
    used |= set(re.findall(r"url\(#([^)]*)\)", html))
    assert used <= set(checker.ids)


def test_colours_follow_the_page_and_all_are_defined_twice(full: Page) -> None:
    html = full.html()
    assert not any(colour in html for colour in (INK, SOFT, GRID, PAPER, *SERIES))
    for variable in set(re.findall(r"var\(--(\w+)\)", html)):
        assert html.count(f"--{variable}:") == 3, variable     # light, dark, print


def test_every_plot_has_its_figures_and_is_drawn_for_page_and_phone(full: Page) -> None:
    html = full.html()
    assert html.count("<figure>") == html.count("<details>") == 4
    assert html.count('class="plot wide"') == html.count('class="plot narrow"') == 4
    assert html.count("<svg ") == 8
    assert "font-size: 9px" in html
    assert "DejaVu" not in html                    # text takes the font of the page


def test_the_script_is_small_and_only_where_there_are_plots(full: Page) -> None:
    script = full.html().partition("<script>")[2].partition("</script>")[0]
    assert 1000 < len(script) < 20_000          # uPlot, the smallest library, has 52 kB
    assert "<script" not in Page("a").section("s", "text").html()


def test_the_same_page_comes_out_the_same() -> None:
    def made() -> str:
        figure, axes = new_figure()
        axes.plot([0, 1], [1, 0])
        return re.sub(r"<dt>Made.*", "", Page("a").figure(figure, "c").html())
    assert made() == made()


def test_drawing_leaves_the_figure_as_it_was() -> None:
    figure, axes = new_figure(height_in=2.5)
    axes.plot([0, 1])
    before = (*figure.get_size_inches(), figure.dpi)
    Page("a").figure(figure, "c")
    assert (*figure.get_size_inches(), figure.dpi) == before


def test_numbers_are_aligned_and_ragged_rows_refused() -> None:
    html = Table(("name", "value"), [("a", 1.5), ("b", Quantity(2e-6, "m"))]).html()
    assert html.count("class=number") == 3
    assert "2 µm" in html
    with pytest.raises(ValueError, match="row 0 has 1 cells, not 2"):
        Table(("a", "b"), [("x",)])


def test_on_a_phone_long_rows_are_cards_that_name_their_cells() -> None:
    row = ["what", 1.0, 2.0, "a reason that takes more than one line of a phone's width"]
    html = Table(("name", "a < b", "value", "reason"), [row]).html()
    assert "class=cards" in html
    assert re.findall(r'data-head="([^"]*)"', html) == ["name", "a &lt; b", "value", "reason"]
    for columns, cells in ((("a", "b", "reason"), [1, 2, row[3]]), (list("abcd"), [1, 2, 3, "x"])):
        assert "data-head" not in Table(columns, [cells]).html()


def test_a_signal_keeps_its_colour_in_every_panel() -> None:
    t = np.linspace(0.0, 1.0, 50)
    figure = time_figure(t, [("x", "m", {"measured": t, "before": t, "after": t}),
                             ("left", "m", {"after": t}), ("other", "V", {"u": t, "before": t})]
                         ).figure
    colours = [{line.get_label(): line.get_color() for line in axes.lines} for axes in figure.axes]
    assert colours[1]["after"] == colours[0]["after"]
    assert colours[2]["before"] == colours[0]["before"] != colours[2]["u"]


def test_the_mean_of_a_signal_without_one_is_zero() -> None:
    t = np.arange(1000) * 1e-3
    table = time_figure(t, [("x", "m", {"x": 1e-6 * np.sin(2.0 * np.pi * 5.0 * t),
                                        "y": 1e-6 * (1.0 + np.sin(2.0 * np.pi * 5.0 * t))})]).table
    assert table is not None
    assert [row[1] for row in table.rows] == [0.0, pytest.approx(1.0)]


def downloads(html: str) -> list[list[list[str]]]:
    """The columns of every CSV on a page, blank cells left out."""
    texts = [unquote(found) for found in re.findall(
        r'href="data:text/csv;charset=utf-8,([^"]*)"', html)]
    return [[[cell for cell in column if cell] for column in zip(*csv.reader(io.StringIO(text)),
                                                                 strict=True)] for text in texts]


def test_every_figure_is_a_csv_of_what_it_draws(full: Page) -> None:
    assert len(downloads(full.html())) == 4
    t = np.linspace(0.0, 2.0, 41)
    page = Page("a").figure(time_figure(t, [
        ("position", "m", {"r": 1e-3 * t, "y": 2e-3 * t}), ("input", "V", {"u": -t})]), "c")
    ((time, r, y, again, u),) = downloads(page.html())
    assert [time[0], r[0], y[0], again[0], u[0]] == [
        "time (s)", "r, position (mm)", "y, position (mm)", "time (s)", "u, input (V)"]
    assert np.allclose(np.array([time[1:], r[1:], y[1:], u[1:]], dtype=float),
                       [t, t, 2 * t, -t], rtol=1e-4)


def test_words_and_levels_of_a_plot_are_in_its_csv() -> None:
    figure, axes = new_figure()
    axes.plot([0, 1], [4.0, 5.0], label="left")
    axes.axhline(2.5, label="floor")
    axes.set_xticks([0, 1], ["before", "after"])
    axes.set(ylabel="RMS (nm)")
    ((x, left, floor),) = downloads(Page("a").figure(figure, "c").html())
    assert x == ["before", "after"]
    assert left == ["left, RMS (nm)", "4", "5"]
    assert floor == ["floor, RMS (nm)", "2.5"]


def test_a_page_of_several_sections_has_contents() -> None:
    page = Page("a").lead("lead")
    assert "<nav" not in page.section("one").section("two").html()
    html = page.section("<three>").text("t").html()
    contents = re.findall(r'<a href="#(s\d)">([^<]*)</a>', html)
    assert [title for _, title in contents] == ["one", "two", "&lt;three&gt;"]
    for anchor, title in contents:
        assert f'<section id="{anchor}">\n<h2>{title}</h2>' in html


def test_tables_and_text_belong_to_the_figure_that_they_stand_beside() -> None:
    figure, axes = new_figure()
    axes.plot([0, 1])
    page = Page("a").section("s", "led to").figure(figure, "first").table(["n"], [[1]])
    page.figure(figure, "second").table(list("abcde"), [[0] * 5])
    rows = page.html().partition("</main>")[0].split('<div class="row')[1:]
    assert [("led to" in row, "first" in row, "second" in row, row.count("<table>"))
            for row in rows] == [
        (True, True, False, 1), (False, False, True, 0), (False, False, False, 1)]


def test_brackets_are_explained_where_they_are_used() -> None:
    with_interval = Page("a").table(["q"], [[Quantity(3.9008867, "Hz", (3.9008812, 3.9008922))]])
    assert "3.9008867(55): the bracket is half the 95 % interval" in with_interval.html()
    assert "the bracket is" not in Page("a").table(["q"], [[Quantity(3.9, "Hz")]]).html()


def test_no_peak_is_lost_in_a_long_signal() -> None:
    signal = np.zeros(200_000)
    signal[123_457], signal[77_777] = 5.0, -3.0
    figure = time_figure(np.arange(200_000) * 1e-3, [("u", "V", {"u": signal})]).figure
    line = figure.axes[0].lines[0]
    assert len(line.get_xdata()) < 4000
    assert max(line.get_ydata()) == 5.0
    assert min(line.get_ydata()) == -3.0
    assert line.get_xdata()[int(np.argmax(line.get_ydata()))] == pytest.approx(123.457)


def test_bode_figures_are_those_of_the_response() -> None:
    f = np.array([1.0, 2.0, 4.0])
    drawing = bode_figure([Response("g", f, np.array([1e-3, -1e-3j, -1e-4 + 0j]))])
    assert drawing.table is not None
    assert drawing.table.columns == ["frequency (Hz)", "g (mm/V)", "g (°)"]
    assert np.allclose(np.array(drawing.table.rows, dtype=float),
                       [[1, 1.0, 0], [2, 1.0, -90], [4, 0.1, -180]])


def test_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "report.html"
    assert Page("one").write(target) == target
    before = target.read_text()
    assert before.startswith("<!DOCTYPE html>")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(ReportError, match="No space left"):
        Page("two").write(target)
    assert target.read_text() == before
    assert os.listdir(tmp_path) == ["report.html"]
    with pytest.raises(ReportError, match="cannot write the report"):
        Page("x").write(tmp_path / "absent" / "report.html")


def test_logarithmic_axes_say_plain_numbers():
    figure, axes = new_figure()
    axes.loglog([0.1, 100.0], [1e-9, 1e-3])
    said = re.findall(r"<text[^>]*>([^<]*)</text>", to_svg(figure, "log", "a plot"))
    assert {"0.1", "100", "1e-09", "0.001"} <= set(said)
    assert not any("$" in text for text in said)
