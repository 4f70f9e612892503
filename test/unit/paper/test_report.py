"""The page holds every row and a counterpart of every figure."""

from __future__ import annotations

import re

from dfm_stage.paper.report import tally, write_page


def test_every_row_and_figure_is_on_the_page(comparison, tmp_path):
    write_page(comparison, tmp_path / "report.html", {"Model": "paper_stage"})
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    for number in (6, 7, 8, 9, 10, 11, 12, 16, 17):
        assert f"<figcaption>Fig. {number}:" in text
    for row in comparison.rows:
        assert row.what.replace("'", "&#x27;") in text
    assert len(re.findall(r"<svg ", text)) >= 24          # wide and narrow
    assert "http" not in re.sub(r'xmlns="[^"]*"', "", text)


def test_the_page_opens_well(comparison, tmp_path, opens_well):
    write_page(comparison, tmp_path / "report.html", {"Model": "paper_stage"})
    opens_well(tmp_path / "report.html")


def test_the_tally_adds_up(comparison):
    assert sum(tally(comparison.rows)) == len(comparison.rows)
