"""The bench runner: figures, table, JSON, and benchmarks that fail."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.figure import Figure
from dfm_stage.cli import bench

GOOD = """
from benchmarks.figure import Figure

def figures(quick=False):
    return [
        Figure("good.speed", 12.0 if quick else 24.0, "x", bar=10.0, bar_kind="at least",
               peer="other", peer_value=6.0, ratio=2.0, how="median of 3"),
        Figure("good.error", 0.5, "mm", bar=0.1, bar_kind="at most"),
    ]
"""
RAISING = "\ndef figures(quick=False):\n    raise ZeroDivisionError('on purpose')\n"
KILLED = "\ndef figures(quick=False):\n    import os; os.kill(os.getpid(), 9)\n"
SLOW = "\ndef figures(quick=False):\n    import time; time.sleep(600)\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A benchmarks folder with the real figure.py and two benchmarks."""
    made = tmp_path / "benchmarks"
    made.mkdir()
    (made / "__init__.py").touch()
    (made / "figure.py").write_text((bench.ROOT / "benchmarks/figure.py").read_text())
    (made / "good.py").write_text(GOOD)
    (made / "raising.py").write_text(RAISING)
    return made


@pytest.mark.parametrize(
    ("value", "bar", "kind", "bar_to", "met"),
    [
        (1.0, 1.0, "at least", None, True),
        (0.9, 1.0, "at least", None, False),
        (1.0, 1.0, "at most", None, True),
        (1.1, 1.0, "at most", None, False),
        (95.0, 90.0, "between", 99.0, True),
        (99.5, 90.0, "between", 99.0, False),
        (math.nan, 1.0, "at most", None, False),
        (5.0, None, None, None, None),
        (5.0, 1.0, None, None, None),
    ],
)
def test_a_bar_is_judged_on_its_side(value, bar, kind, bar_to, met) -> None:
    figure = Figure("k", value, "s", bar=bar, bar_kind=kind, bar_to=bar_to)
    assert figure.met is met


def test_between_needs_both_ends() -> None:
    with pytest.raises(ValueError, match="bar_to"):
        Figure("k", 1.0, "s", bar=1.0, bar_kind="between")


def test_numbers_that_json_does_not_know_become_null() -> None:
    assert Figure("k", math.nan, "s", peer_value=math.inf).to_dict()["peer_value"] is None


def test_table_and_json_say_the_same(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "new" / "bench.json"
    assert bench.main(["good", "--folder", str(folder), "--quick", "--json", str(out)]) == 0
    written = json.loads(out.read_text())
    assert {"machine", "measured", "commands", "figures", "failed"} <= set(written)
    assert written["commands"] == ["./run bench good --quick"]
    assert {"cpu", "cores", "python", "numpy"} <= set(written["machine"])
    assert os.uname().nodename not in json.dumps(written["machine"]).split('"')
    asked = {"key", "value", "unit", "bar", "peer", "peer_value", "ratio", "how"}
    assert all(asked <= set(figure) for figure in written["figures"])
    assert [figure["value"] for figure in written["figures"]] == [12.0, 0.5]
    shown = capsys.readouterr().out
    line = next(line for line in shown.splitlines() if "good.speed" in line)
    assert " ".join(line.split()) == "good.speed 12 x >= 10 met other 6 2 median of 3"
    assert "MISSED" in next(line for line in shown.splitlines() if "good.error" in line)
    assert "2 figures, 1 of 2 bars met, 0 benchmarks failed" in shown


def test_a_failing_benchmark_stops_nothing_else(folder: Path, tmp_path: Path, capfd) -> None:
    (folder / "killed.py").write_text(KILLED)
    out = tmp_path / "bench.json"
    assert (
        bench.main(["--folder", str(folder), "--json", str(out), "killed", "raising", "good"]) == 1
    )
    written = json.loads(out.read_text())
    assert [failure["bench"] for failure in written["failed"]] == ["killed", "raising"]
    assert "signal 9" in written["failed"][0]["reason"]
    assert len(written["figures"]) == 2
    assert "on purpose" in capfd.readouterr().err


COUNTING = """
from pathlib import Path
from benchmarks.figure import Figure

def figures(quick=False):
    seen = Path(__file__).with_name("seen")
    seen.write_text((seen.read_text() if seen.exists() else "") + "c")
    return [Figure("counting.turn", float(len(seen.read_text())), "")]
"""


def test_runs_take_turns_and_files_are_taken_together(folder: Path, tmp_path, capsys) -> None:
    (folder / "counting.py").write_text(COUNTING)
    out = tmp_path / "bench.json"
    asked = ["--folder", str(folder), "--json", str(out)]
    assert bench.main([*asked, "--runs", "3", "counting", "good"]) == 0
    written = json.loads(out.read_text())
    turn, speed, _ = written["figures"]
    assert (turn["value"], turn["low"], turn["high"], turn["runs"]) == (2.0, 1.0, 3.0, 3)
    assert (speed["value"], speed["interval"], speed["met"]) == (24.0, "3 runs", True)
    assert written["commands"] == ["./run bench counting good --runs 3"]
    assert "[2/6] good" in capsys.readouterr().err
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**written, "figures": [{**turn, "high": 7.0, "value": 6.0}]}))
    assert bench.main(["--from", str(out), "--from", str(other)]) == 0
    assert "counting.turn      4  1 to 7" in capsys.readouterr().out
    other.write_text("[]")
    assert bench.main(["--from", str(other)]) == 2
    assert "not what bench --json writes" in capsys.readouterr().err
    assert bench.main([*asked, "--runs", "0", "good"]) == 2


def test_an_unknown_name_gets_the_nearest(folder: Path, capsys) -> None:
    assert bench.main(["--folder", str(folder), "godo"]) == 2
    assert capsys.readouterr().err == "bench: there is no benchmark 'godo': did you mean good?\n"


def test_only_modules_with_figures_are_benchmarks(folder: Path) -> None:
    assert bench.available(folder) == ["good", "raising"]
    assert "figure" not in bench.available(bench.ROOT / "benchmarks")


def test_an_unwritable_file_is_one_line(folder: Path, capsys) -> None:
    target = folder / "good.py" / "bench.json"
    assert bench.main(["--folder", str(folder), "good", "--json", str(target)]) == 2
    assert "cannot write" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_a_signal_ends_the_benchmark_too(folder: Path, number: int, code: int) -> None:
    (folder / "slow.py").write_text(SLOW)
    command = [sys.executable, "-m", "dfm_stage", "bench", "--folder", str(folder), "slow"]
    runner = subprocess.Popen(command, cwd=bench.ROOT, stderr=subprocess.DEVNULL)
    children = Path(f"/proc/{runner.pid}/task/{runner.pid}/children")
    while not children.read_text().split():
        time.sleep(0.002)
    child = int(children.read_text().split()[0])
    runner.send_signal(number)
    assert runner.wait() == code
    while runs(child):
        time.sleep(0.02)


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


MANY = '''
"""Takes a number of cases."""
from benchmarks.figure import Figure


def figures(quick=False, *, cases=None, resume=False):
    return [Figure("many.cases", float(cases), "1"), Figure("many.resume", float(resume), "1")]
'''


def test_an_option_reaches_only_the_benchmark_that_takes_it(folder: Path, tmp_path, capfd) -> None:
    (folder / "many.py").write_text(MANY)
    out = tmp_path / "bench.json"
    asked = ["--folder", str(folder), "--json", str(out), "--cases", "7", "--resume"]
    assert bench.main([*asked, "many"]) == 0
    assert [f["value"] for f in json.loads(out.read_text())["figures"]] == [7.0, 1.0]
    assert bench.main([*asked, "good"]) == 1
    assert "benchmark good takes no --cases" in capfd.readouterr().err
