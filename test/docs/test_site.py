"""The site that ./run docs builds: strict, complete, self-contained, with every link alive."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from pages import ROOT

import dfm_stage

pytestmark = pytest.mark.slow
WIDTHS = (390, 1440)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chromium-headless-shell")
PROBE = """<script>window.onload = () => {
  const found = [...document.querySelectorAll("iframe")].map(frame => {
    const page = frame.contentDocument.documentElement;
    return [frame.src.split("/").pop(), page.scrollWidth, page.clientWidth];
  });
  document.body.innerHTML = "<pre></pre>";
  document.querySelector("pre").textContent = JSON.stringify(found);
};</script>"""
LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src"}


class Page(HTMLParser):
    """Links, anchors and loaded files of one page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.tags: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.tags.add(tag)
        self.anchors.add(given.get("id", ""))
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if given.get(LOADED.get(tag, "-")):
            self.loaded.append(given[LOADED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("manual") / "site"
    done = subprocess.run([sys.executable, ROOT / "tools/manual.py", folder], check=False,
                          capture_output=True, text=True, timeout=280)
    if "cannot be fetched" in done.stderr:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip() == str(folder / "index.html")
    return folder


@pytest.fixture(scope="module")
def built(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in sorted(site.glob("*.html"))}


def test_every_page_is_there_and_in_the_order(site: Path, built: dict[Path, Page]) -> None:
    names = {page.stem for page in (ROOT / "docs").glob("*.md")}
    assert names <= {path.stem for path in built}
    linked = {link.partition("#")[0] for link in built[site / "index.html"].links}
    assert {f"{name}.html" for name in names - {"index"}} <= linked


def test_every_link_of_the_site_leads_somewhere(built: dict[Path, Page]) -> None:
    broken = []
    for path, page in built.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            known = built.get(target)
            if not target.exists() or (
                    parts.fragment and known and unquote(parts.fragment) not in known.anchors):
                broken.append(f"{path.name}: {link}")
    assert broken == []


def test_nothing_is_loaded_from_elsewhere(built: dict[Path, Page]) -> None:
    assert [(path.name, url) for path, page in built.items() for url in page.loaded
            if urlsplit(url).netloc] == []


def test_the_api_page_has_every_public_name(site: Path, built: dict[Path, Page]) -> None:
    anchors = built[site / "api.html"].anchors
    assert {f"dfm_stage.{name}" for name in dfm_stage.__all__} <= anchors


def test_equations_are_drawn_and_pages_are_searched(site: Path, built: dict[Path, Page]) -> None:
    assert "math" in built[site / "stage.html"].tags
    assert "hysteresi" in (site / "searchindex.js").read_text(encoding="utf-8")


def test_a_row_of_a_wide_table_names_its_cells(site: Path) -> None:
    page = (site / "decisions.html").read_text(encoding="utf-8")
    heads = re.findall(r'<th class="head"><p>(.*?)</p></th>', page)
    named = re.findall(r'<td><span class="named">(.*?)</span>', page)
    assert len(heads) == 5
    assert len(named) >= 100
    assert named == heads * (len(named) // 5)


@pytest.mark.parametrize(("name", "figures"), [("csv_to_effect", 4), ("graph_to_model", 3)])
def test_the_figures_of_a_notebook_are_drawn(site: Path, built: dict[Path, Page], name: str,
                                             figures: int) -> None:
    drawn = {site / url for url in built[site / f"{name}.html"].loaded
             if f"{name}-" in url}
    assert len({path.read_bytes() for path in drawn}) == figures


@pytest.fixture(scope="module")
def opened(built: dict[Path, Page], tmp_path_factory: pytest.TempPathFactory
           ) -> list[tuple[int, str, int, int]]:
    """Width of the frame, page, width of its content and of its window, of every page."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no Chromium here to open the pages in (requirements/system.txt)")
    frames = [(width, path) for width in WIDTHS for path in built]
    folder = tmp_path_factory.mktemp("opened")
    probe = folder / "probe.html"
    probe.write_text("<body>" + "".join(
        f'<iframe src="{path.as_uri()}" width="{width}" height="900"></iframe>'
        for width, path in frames) + f"{PROBE}</body>", encoding="utf-8")
    done = subprocess.run(
        [browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
         f"--user-data-dir={folder / 'profile'}", "--allow-file-access-from-files",
         "--virtual-time-budget=20000", probe.as_uri()],
        capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r"<pre>(.*?)</pre>", done.stdout, re.DOTALL)
    assert found, done.stdout[:2000]
    seen = json.loads(unescape(found[1]))
    assert [name for name, _, _ in seen] == [path.name for _, path in frames]
    return [(width, *each) for (width, _), each in zip(frames, seen, strict=True)]


@pytest.mark.parametrize("width", WIDTHS)
def test_no_page_is_wider_than_the_window(opened: list[tuple[int, str, int, int]],
                                          width: int) -> None:
    assert [name for frame, name, content, window in opened
            if frame == width and content > window] == []
