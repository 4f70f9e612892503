"""Several runs of a bench as one, and the pages whose tables are made from kept figures."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks import page
from benchmarks.composed import late_percent
from benchmarks.figure import Figure
from dfm_stage.cli.bench_runs import combined, merged


def figure(value: float | None, **more) -> dict:
    kind = {"bar": 3.0, "bar_kind": "at least", **more}
    return {**Figure("loop.speed", 0.0 if value is None else value, "x", **kind).to_dict(),
            "value": value}


def report(*figures: dict, load: float = 0.5, **more) -> dict:
    return {"machine": {"cores": 2, "load_1min": load}, "measured": "2026-01-02",
            "commands": ["./run bench loop"], "figures": list(figures), "failed": [], **more}


def test_the_value_of_several_runs_is_the_median_with_the_range():
    one, = combined([[figure(value, peer="C", peer_value=peer, ratio=value / peer)]
                     for value, peer in ((4.0, 1.0), (1.0, 2.0), (2.0, 4.0))])
    assert (one["value"], one["low"], one["high"]) == (2.0, 1.0, 4.0)
    assert (one["peer_value"], one["ratio"]) == (2.0, 0.5)
    assert (one["runs"], one["interval"]) == (3, "3 runs")
    assert one["met"] is False      # the last and the first run alone would say otherwise


def test_a_figure_of_one_run_keeps_its_own_interval():
    wilson = figure(95.0, low=92.7, high=96.9, interval="95 %")
    assert combined([[wilson]]) == [wilson]
    one, = combined([[wilson], [wilson]])
    assert (one["low"], one["high"], one["interval"]) == (95.0, 95.0, "2 runs")


def test_runs_that_were_combined_before_keep_their_range():
    first = combined([[figure(1.0)], [figure(9.0)]])
    one, = combined([first, [figure(4.0)]])
    assert (one["low"], one["high"], one["runs"]) == (1.0, 9.0, 3)


def test_a_run_without_a_value_is_counted():
    one, = combined([[figure(5.0)], [figure(None)], [figure(4.0)]])
    assert (one["value"], one["interval"], one["met"]) == (4.5, "2 of 3 runs", True)
    none, = combined([[figure(None)], [figure(None)]])
    assert (none["value"], none["low"], none["met"]) == (None, None, False)


@pytest.mark.parametrize(("judging", "met"), [(2, True), (1, None)])
def test_a_bar_is_judged_where_more_than_half_of_the_runs_judged_it(judging, met):
    runs = [[figure(5.0, bar_kind="at least" if k < judging else None)] for k in range(3)]
    assert combined(runs)[0]["met"] is met


def test_reports_are_merged_with_the_range_of_the_load():
    both = merged([{**report(figure(1.0), load=0.2), "versions": "Fast DDS 2.14.5"},
                   report(figure(2.0), load=3.0)])
    assert both["versions"] == "Fast DDS 2.14.5"
    assert both["machine"]["load_range"] == [0.2, 3.0]
    assert both["commands"] == ["./run bench loop"]
    assert both["figures"][0]["value"] == 1.5


def test_files_are_kept_by_their_bench(tmp_path: Path):
    for number, value in enumerate((1.0, 2.0, 6.0)):
        (tmp_path / f"{number}.json").write_text(json.dumps(report(
            figure(value), {**figure(1.0), "key": "two_axes.age"},
            {**figure(1.0), "key": "diagnose.seconds"}, {**figure(None), "key": "secured.checks"},
            commands=["./run bench loop composed --quick"])))
    page.keep(sorted(tmp_path.glob("*.json")), tmp_path / "kept")
    kept = page.read_kept(tmp_path / "kept")
    assert set(kept) == {"loop", "composed"}
    assert kept["loop"]["commands"] == ["./run bench loop --quick"]
    assert [each["value"] for each in kept["loop"]["figures"]] == [2.0]
    row, = page.table(kept["loop"]["figures"], 3).splitlines()[2:]
    assert row == "| speed<br>`loop.speed` | 2 x **missed** | 1 to 6 | at least 3 x |"
    assert "`./run bench loop --quick --runs 3`, 2026-01-02, 2 cores, load 0.5, 3 runs" in \
        page.section("loop", kept)


@pytest.mark.parametrize(("value", "text"), [
    (0.123456, "0.123"), (99.75, "99.8"), (1374174.0, "1,374,174"), (684134.4, "684,000"),
    (1234.5, "1,230"), (-2.0, "−2"), (0.0, "0"), (3.1e-5, "3.1·10⁻⁵"), (None, "–"),
    (float("inf"), "–")])
def test_numbers_have_three_digits(value, text):
    assert page.number(value) == text


def test_a_near_miss_shows_the_digits_that_tell():
    near = Figure("bench.rate", 99.8642, "%", 99.9, bar_kind="at least").to_dict()
    assert page.shown_value(near) == "99.86 % **missed**"


def test_bars_peers_and_answers_are_told_in_words():
    plain = [Figure("b.rate", 95.0, "%", 92.0, "SciPy", 60.0, None, "", "between", 98.0),
             Figure("b.same", 1.0, "1 = yes", 1.0, bar_kind="at least"),
             Figure("b.busy", 2.0, "ms", 1.0), Figure("b.none", float("nan"), "us")]
    rows = page.table([each.to_dict() for each in plain]).splitlines()
    assert rows == ["| figure | value | bar | peer |", "|---|---|---|---|",
                    "| rate<br>`b.rate` | 95 % | 92 to 98 % | SciPy: 60 % |",
                    "| same<br>`b.same` | yes | yes | |",
                    "| busy<br>`b.busy` | 2 ms | 1 ms, undecided | |",
                    "| none<br>`b.none` | – | | |"]


def test_a_bench_without_kept_figures_says_so():
    assert page.section("loop", {}) == "Not measured yet: `./run bench loop`."
    with pytest.raises(ValueError, match="no markers"):
        page.put("text", {"figures: loop": "table"})


@pytest.mark.parametrize("path", page.PAGES, ids=lambda path: path.name)
def test_the_pages_hold_the_tables_of_what_is_kept(path: Path):
    text = path.read_text("utf-8")
    assert page.with_figures(text, page.read_kept()) == text
    assert page.MISSED.read_text("utf-8") == page.missed(page.read_kept())


def test_every_kept_bench_has_a_page_and_the_fields_of_a_figure():
    pages = "".join(path.read_text("utf-8") for path in page.PAGES)
    fields = set(asdict(Figure("k", 1.0, "s")))
    for bench, kept in page.read_kept().items():
        assert f"<!-- figures: {bench} -->" in pages
        for each in kept["figures"]:
            assert fields - {"low", "high", "interval", "runs"} <= set(each)
            assert page.bench_of(each["key"]) == bench


def test_controllers_stand_side_by_side():
    runs = [Figure("control.pid.line_rms_nm", 1476.3, "nm", 2000.0, bar_kind="at most"),
            Figure("control.lqr.line_rms_nm", 2061.0, "nm", 2000.0, bar_kind="at most"),
            Figure("control.pid.line_peak_nm.effects", 9.0, "nm"),
            Figure("control.pid.sine_um", 0.07, "um", 5.0, bar_kind="at most")]
    text = page.section("control", {"control": report(*(each.to_dict() for each in runs))})
    assert ("| RMS on the line, identified model |  | 1,480 nm | 2,061 nm **missed** |  |  |"
            in text)
    assert "2 of 3 bars are met" in text
    assert "`control.pid.sine_um` | 0.07 µm | at most 5 µm |" in text
    assert "line_peak_nm.effects" not in text


def test_targets_of_spoilt_inputs_have_a_row_each():
    row = {"target": "csv", "inputs": 19200, "values": 3723, "refusals": 15477, "findings": 0,
           "slowest_s": 1.056, "peak_mib": 576.07}
    text = page.targets({"seed": 1, "targets": [row, {**row, "target": "npz", "peak_mib": 3.0}]},
                        page.number)
    assert "| csv | 19,200 | 3,723 | 15,477 | 0 | 1.06 | 576 |" in text
    assert "| all | 38,400 | 7,446 | 30,954 | 0 | 1.06 | 576 |" in text


def test_a_sample_is_late_by_more_than_a_period_of_the_one_most_in_time() -> None:
    numbers = np.arange(10)
    stamps = 5_000_000_000 + 1_000_000 * numbers
    stamps[3] += 999_999
    stamps[7] += 1_000_001
    assert late_percent(numbers, stamps, 1000.0, 10) == 10.0
    seen = numbers != 5
    assert late_percent(numbers[seen], stamps[seen], 1000.0, 10) == 20.0
    assert late_percent(numbers[:0], stamps[:0], 1000.0, 10) == 100.0
