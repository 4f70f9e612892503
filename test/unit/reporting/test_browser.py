"""The page in a real browser: nothing sticks out at the width of a phone or a desk."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from dfm_stage.reporting import Page, Quantity, Response, bode_figure, time_figure

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
               None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium here to open the report in")

PROBE = """<body><iframe src="report.html" width="{width}" height="900"></iframe><script>
window.onload = () => {{
  const page = document.querySelector("iframe").contentDocument;
  const shown = [...page.querySelectorAll(".plot svg")].filter(e => e.getClientRects().length);
  document.body.innerHTML = "<pre>" + JSON.stringify({{
    width: page.documentElement.clientWidth, content: page.documentElement.scrollWidth,
    plots: shown.map(e => [e.getBoundingClientRect().width, e.getBoundingClientRect().height]),
    text: Math.min(...shown.flatMap(e => [...e.querySelectorAll("text")]
                                          .map(t => t.getBoundingClientRect().height))),
    outside: shown.flatMap(e => [...e.querySelectorAll("text")].filter(t =>
      t.getBoundingClientRect().right > e.getBoundingClientRect().right + 2
      || t.getBoundingClientRect().left < e.getBoundingClientRect().left - 2)).length,
  }}) + "</pre>";
}};</script></body>"""


@pytest.mark.parametrize("width", [390, 1440])
def test_no_overflow_and_every_plot_is_shown_once(tmp_path: Path, width: int) -> None:
    t = np.arange(3000) * 1e-3
    f = np.geomspace(1.0, 70.0, 80)
    page = Page("A title that is rather long for a phone, with_an_unbreakable_word_in_the_middle")
    page.lead("Every number stands where it should. " * 3, "passed", "good")
    page.table([f"column {i}" for i in range(12)],
               [[Quantity(1.23e-3 * i, "m", (1.2e-3 * i, 1.26e-3 * i)) for i in range(12)]])
    page.figure(bode_figure([Response("measured", f, 1.0 / (1.0 + 1j * f))]), "A response.")
    page.figure(time_figure(t, [("position", "m", {"reference": np.sin(t), "position": t})]), "T.")
    page.provenance({"Bag": "/".join(["a_folder_with_a_long_name"] * 9)})
    page.write(tmp_path / "report.html")
    (tmp_path / "probe.html").write_text(PROBE.format(width=width))
    done = subprocess.run(
        [str(BROWSER), "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
         f"--user-data-dir={tmp_path / 'profile'}", "--allow-file-access-from-files",
         "--window-size=1600,1000", (tmp_path / "probe.html").as_uri()],
        capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r"<pre>(.*?)</pre>", done.stdout, re.DOTALL)
    assert found, done.stdout
    seen = json.loads(unescape(found.group(1)))
    assert seen["content"] <= seen["width"]
    assert len(seen["plots"]) == 2
    for plot_width, plot_height in seen["plots"]:
        assert plot_width > 0.6 * min(width, 960)
        assert plot_height > 150
    assert seen["text"] > 9
    assert seen["outside"] == 0
