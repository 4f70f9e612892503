"""The page of every command, opened in a browser at the width of a phone and of a desk."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from dfm_stage.cli import bench, diagnose, example, identify, tune

Judge = Callable[..., None]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("example")
    assert example.main([str(made)]) == 0
    return made


def test_identify(folder: Path, tmp_path: Path, opens_well: Judge) -> None:
    assert identify.main([str(folder / "multisine.csv"), "--out", str(tmp_path)]) == 0
    opens_well(tmp_path / "report.html")


@pytest.mark.parametrize("library", [[], ["--library", "back_emf,saturation"]],
                         ids=["named", "unknown"])
def test_diagnose(folder: Path, library: list[str], tmp_path: Path, opens_well: Judge) -> None:
    assert diagnose.main([str(folder / "multisine.csv"), "--holdout", str(folder / "sweep.csv"),
                          "--model", str(folder / "model.yaml"), "--out", str(tmp_path),
                          *library]) == 0
    opens_well(tmp_path / "report.html")


def test_tune(tmp_path: Path, opens_well: Judge) -> None:
    assert tune.main(["--model", "xy_stage", "--out", str(tmp_path / "gains.yaml")]) == 0
    opens_well(tmp_path / "gains.html")


def figure(key: str, value: float | None, **more: object) -> dict[str, object]:
    return {"key": key, "value": value, "unit": "ms", "bar": None, "bar_kind": None,
            "bar_to": None, "met": None, "peer": None, "peer_value": None, "ratio": None,
            "how": "one line that says what was done, how often, and which statistic it is",
            **more}


def test_bench(tmp_path: Path, opens_well: Judge, capsys: pytest.CaptureFixture[str]) -> None:
    slow = figure("loop.age", 2.0, bar=1.0, bar_kind="at most", met=False, peer="another",
                  peer_value=4.0, ratio=0.5)
    first = {"machine": {"cpu": "a", "cores": 2, "load_1min": 0.1}, "failed": [], "figures": [
        slow, figure("loop.lost", 0.0, bar=0.0, bar_kind="at most", met=True),
        figure("bags.speed", 50.0, bar=40.0, bar_kind="at least", met=True),
        figure("coverage.share", 95.0, bar=92.0, bar_to=98.0, bar_kind="between", met=True),
        figure("bags.nothing", None)]}
    again = {**first, "figures": [{**slow, "value": 0.0, "met": True}],  # the median is 1.0
             "failed": [{"bench": "drivers", "reason": "no port"}]}
    files = [tmp_path / "first.json", tmp_path / "again.json"]
    for file, content in zip(files, (first, again), strict=True):
        file.write_text(json.dumps(content))
    page = tmp_path / "new" / "bench.html"
    assert bench.main(["--from", str(files[0]), "--page", str(page)]) == 0
    assert "3 of 4 bars met" in capsys.readouterr().out
    opens_well(page)
    assert bench.main(["--from", str(files[0]), "--from", str(files[1]), "--page",
                       str(page)]) == 1
    assert "4 of 4 bars met" in capsys.readouterr().out
    text = page.read_text(encoding="utf-8")
    assert "./run bench loop" in text
    assert "drivers failed: no port" in text
    assert "≥ 40" in text


def test_results_that_are_none_are_refused_in_one_line(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.json").write_text("[1, 2]")
    assert bench.main(["--from", str(tmp_path / "a.json"), "--page", "p.html"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
