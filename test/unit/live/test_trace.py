"""What the page shows of a sample is what the nodes said of that very sample."""

from __future__ import annotations

import json
import math
import re
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

from reference_page import SERVICES

from dfm_stage.live.trace import BEHIND, KEPT, MOST_ROWS, Trace
from dfm_stage.nodes.wiring import LINKS

CONFIG = Path(__file__).parents[3] / "config"
LAYOUT = CONFIG / "foxglove/stage.json"
PLOTJUGGLER = CONFIG / "plotjuggler/stage.xml"


def measurement(seq: int) -> SimpleNamespace:
    return SimpleNamespace(seq=seq, stamp_ns=seq * 1_000_000, position=1e-6 * seq, flags=1)


def reference(seq: int) -> SimpleNamespace:
    return SimpleNamespace(seq=seq, position=2e-6 * seq)


def answer(seq: int, current: float = 0.5) -> SimpleNamespace:
    return SimpleNamespace(measurement_seq=seq, voltage=0.1 * seq, current=current)


def test_a_sample_is_put_together_whatever_came_first() -> None:
    trace = Trace()
    trace.on_reference(reference(1))
    trace.on_measurement(measurement(0))
    trace.on_measurement(measurement(1))
    trace.on_amplifier(answer(0, math.nan))
    trace.on_amplifier(answer(1))
    trace.on_reference(reference(0))
    assert trace.rows() == []
    assert trace.rows(everything=True) == [[0.0, 0.0, 0.0, 0.0, None],
                                           [1e-3, 1e-6, 2e-6, 0.1, 0.5]]
    assert trace.rows(everything=True) == []


def test_what_is_not_known_is_nothing() -> None:
    trace = Trace()
    trace.on_measurement(measurement(7))
    assert trace.rows(everything=True) == [[7e-3, 7e-6, None, None, None]]


def test_the_newest_wait_for_their_answers() -> None:
    trace = Trace()
    for seq in range(BEHIND + 5):
        trace.on_measurement(measurement(seq))
    assert [row[1] for row in trace.rows()] == [1e-6 * seq for seq in range(5)]


def test_a_fast_loop_is_thinned_evenly_and_says_so() -> None:
    trace = Trace()
    for seq in range(600 + BEHIND):
        trace.on_measurement(measurement(seq))
    rows = trace.rows()
    assert len(rows) <= MOST_ROWS
    assert trace.every == 5
    assert {round((b[0] or 0.0) - (a[0] or 0.0), 6)
            for a, b in pairwise(rows)} == {5e-3}


def test_nothing_grows_where_nobody_looks() -> None:
    trace = Trace()
    for seq in range(3 * KEPT):
        trace.on_measurement(measurement(seq))
        trace.on_reference(reference(seq))
        trace.on_amplifier(answer(seq))
    assert len(trace._measured) == len(trace._references) == len(trace._answers) == KEPT
    assert trace.heard == 3 * KEPT


def test_the_foxglove_layout_asks_for_topics_fields_and_services_that_there_are() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    config = layout["configById"]
    paths = [path["value"] for panel in config.values() for path in panel.get("paths", [])]
    for path in paths:
        if path.startswith("/studio_script"):
            continue
        topic, _, field = path.removeprefix("/stage/x/").partition(".")
        assert field in LINKS[topic].type.get_fields_and_field_types(), path
    services = [panel["serviceName"] for panel in config.values() if "serviceName" in panel]
    assert {name.removeprefix("/stage/x/") for name in services} <= set(SERVICES)
    placed = set(re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(layout["layout"])))
    assert placed == set(config)
    for node in layout["userNodes"].values():
        for topic in re.findall(r'"/stage/x/(\w+)"', node["sourceCode"]):
            assert topic in LINKS


def test_the_plotjuggler_layout_plots_topics_and_fields_that_there_are() -> None:
    root = ET.parse(PLOTJUGGLER).getroot()  # noqa: S314 our own file
    made = {each.get("name"): each for each in root.iter("snippet")}
    curves = [str(each.get("name")) for each in root.iter("curve")]
    assert made.keys() <= set(curves)
    sources = [str(each.text) for snippet in made.values() for each in snippet.iter()
               if each.tag == "linked_source" or re.fullmatch(r"v\d+", each.tag)]
    for snippet in made.values():
        given = {"value", *(each.tag for each in snippet.find("additional_sources") or ())}
        used = set(re.findall(r"\b(?:value|v\d+)\b", str(snippet.findtext("function"))))
        assert used == given
    for path in [*sources, *(curve for curve in curves if curve not in made)]:
        topic, _, field = path.removeprefix("/stage/x/").partition("/")
        assert field in LINKS[topic].type.get_fields_and_field_types(), path
    for splitter in root.iter("DockSplitter"):
        sizes = [float(size) for size in str(splitter.get("sizes")).split(";")]
        assert len(sizes) == len(splitter) == int(str(splitter.get("count")))
        assert math.isclose(sum(sizes), 1.0)


def test_both_layouts_plot_the_same() -> None:
    xml = ET.parse(PLOTJUGGLER).getroot()  # noqa: S314 our own file
    shown = {str(each.get("name")) for each in xml.iter("curve")} - {"error_x"}
    foxglove = re.findall(r'"value": "(/stage/x/\w+)\.(\w+)"', LAYOUT.read_text("utf-8"))
    assert shown == {"/".join(each) for each in foxglove}
