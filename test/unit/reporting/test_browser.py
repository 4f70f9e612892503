"""The page in a real browser: nothing sticks out at the width of a phone or a desk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dfm_stage.reporting import Page, Quantity, Response, bode_figure, time_figure

T = np.arange(3000) * 1e-3
F = np.geomspace(1.0, 70.0, 80)


@pytest.fixture
def page() -> Page:
    page = Page("A title that is rather long for a phone, with_an_unbreakable_word_in_the_middle")
    page.lead("Every number stands where it should. " * 3, "passed", "good").section("One")
    page.table([f"column {i}" for i in range(12)],
               [[Quantity(1.23e-3 * i, "m", (1.2e-3 * i, 1.26e-3 * i)) for i in range(12)]])
    page.figure(bode_figure([Response("measured", F, 1.0 / (1.0 + 1j * F))]), "A response.")
    page.section("Two", "Text beside a figure. " * 9).section("Three")
    page.figure(time_figure(T, [("position", "m", {"reference": np.sin(T), "position": T})]), "T.")
    return page.provenance({"Bag": "/".join(["a_folder_with_a_long_name"] * 9)})


@pytest.mark.parametrize("dark", [False, True])
def test_no_overflow_and_every_plot_is_shown_once(
        page: Page, dark: bool, tmp_path: Path, opens_well: Callable[..., None]) -> None:
    opens_well(page.write(tmp_path / "report.html"), dark=dark)


@pytest.mark.parametrize(("spoil", "complaint"), [
    (("<main>", '<main><p style="width: 3000px">wide</p>'), "wider than the window"),
    (("<main>", "<main><figure>nothing</figure>"), "a figure is not shown"),
    (("</svg>", '<text x="9000" y="20">far</text></svg>'), "text sticks out"),
    (("</main>", "</main><script>nonsense()</script>"), "CONSOLE"),
    (("min-width: 75rem", "min-width: 190rem"), "beside their figures"),
    (("nav { grid-column: 1;", "nav { grid-column: 2;"), "contents are not beside"),
    (("minmax(0, 9fr)", "minmax(0, 2fr) minmax(0, 3fr)"), "width of a desk is empty"),
])
def test_what_is_wrong_with_a_page_is_seen(
        page: Page, spoil: tuple[str, str], complaint: str, tmp_path: Path,
        opens_well: Callable[..., None]) -> None:
    good = page.write(tmp_path / "good.html").read_text(encoding="utf-8")
    bad = tmp_path / "bad.html"
    bad.write_text(good.replace(*spoil), encoding="utf-8")
    assert bad.read_text(encoding="utf-8") != good
    with pytest.raises(AssertionError, match=complaint):
        opens_well(bad)
