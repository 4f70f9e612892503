"""Every relative link and every anchor of the pages leads somewhere, and every page is reached."""

from __future__ import annotations

from pathlib import Path

import pytest
from pages import PAGES, ROOT, anchors, links


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    broken = []
    for link in links(page):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert not broken


def test_every_page_is_reached_from_the_readme() -> None:
    reached, todo = set(), [ROOT / "README.md"]
    while todo:
        page = todo.pop()
        reached.add(page)
        targets = [(page.parent / link.partition("#")[0]).resolve() for link in links(page)
                   if not link.startswith(("http", "#"))]
        todo += [target for target in targets if target.suffix == ".md" and target not in reached]
    assert {page for page in PAGES if page.name != "CHANGELOG.md"} <= reached


def test_anchors_are_those_of_github(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# `demo`: a *b*, c\n## The first time\n## The first time\n```\n# no\n```\n")
    assert anchors(page) == {"demo-a-b-c", "the-first-time", "the-first-time-1"}
