"""Batches of diagnoses: in parallel, on a cluster, and when some of them fail."""

from __future__ import annotations

import csv
import json
import os
import re
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.stats import linregress, t

from dfm_stage.cli import diagnose_batch, example
from dfm_stage.cli.diagnose_batch import Job, Outcome, run_batch
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.history import MONTH_S
from dfm_stage.model import Simulator, load_model
from dfm_stage.recording import AxisRecord, Provenance, Record, write_csv
from dfm_stage.trajectory import make_excitation


def test_as_many_at_once_as_asked_and_every_run_once(monkeypatch: pytest.MonkeyPatch) -> None:
    together = threading.Barrier(3, timeout=30.0)

    def slow(job: Job) -> Outcome:
        together.wait()
        return Outcome(job.run, 0, 0.0)

    monkeypatch.setattr(diagnose_batch, "work", slow)
    jobs = [Job(f"run{k}", ()) for k in range(6)]
    assert sorted(each.run for each in run_batch(jobs, 3)) == [job.run for job in jobs]


def _answered(job: Job) -> Outcome:
    """As `diagnose` leaves its answer, without a diagnosis."""
    folder = Path(job.arguments[job.arguments.index("--out") + 1])
    folder.mkdir(parents=True)
    (folder / "diagnosis.json").write_text(json.dumps({
        "verdict": "none", "effects": [], "base": {}, "recorded_ns": [None],
        "gap": {"unit": "m", "held_out": {"before": 1e-7, "after": 1e-7}}}), encoding="utf-8")
    return Outcome(job.run, 0, 0.5)


def test_a_run_that_fails_is_named_and_the_others_go_on(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    real = diagnose_batch.work
    (tmp_path / "second").touch()
    second = str(tmp_path / "second")
    monkeypatch.setattr(diagnose_batch, "work", lambda job: real(job) if "gone" in job.run else
                        _answered(job))
    code = diagnose_batch.main([second, "a/gone.csv", "--model", "paper_stage", "--out",
                                str(tmp_path / "out"), "--options=--no-report"])
    assert code == 1
    found = json.loads((tmp_path / "out" / "batch.json").read_text(encoding="utf-8"))
    assert [(each["run"], each["code"]) for each in found] == [(second, 0), ("a/gone.csv", 2)]
    assert "gone.csv" in found[1]["words"]
    assert "1 of 2 diagnosed" in capsys.readouterr().out


@pytest.mark.parametrize(("runs", "names"), [
    (["/d/a", "/d/b"], ["a", "b"]),
    (["/d/jan/run", "/d/feb/run", "/d/other"], ["jan_run", "feb_run", "other"]),
    (["/d/jan/x/run", "/d/feb/x/run"], ["jan_x_run", "feb_x_run"]),
    (["/d/jan/run", "/d/feb/run", "/d/jan_run"], ["jan_run", "feb_run", "jan_run_2"]),
    (["/run", "/d/run"], ["run", "d_run"]),
])
def test_every_run_has_a_folder_of_its_own(runs: list[str], names: list[str]) -> None:
    assert diagnose_batch.folders([Path(run) for run in runs]) == names


def test_a_batch_that_was_stopped_goes_on_where_it_was(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    done, interruptions = [], [KeyboardInterrupt()]

    def work(job: Job) -> Outcome:
        if job.run.endswith("c") and interruptions:
            raise interruptions.pop()
        done.append(job.run)
        return _answered(job)

    monkeypatch.setattr(diagnose_batch, "work", work)
    runs = [str(tmp_path / name) for name in "abc"]
    for run in runs:
        Path(run).touch()
    # the third is named twice, in two ways
    arguments = [*runs, f"{tmp_path}/../{tmp_path.name}/c", "--model", "paper_stage", "--jobs",
                 "1", "--out", str(tmp_path / "out")]
    assert diagnose_batch.main(arguments) == 130
    assert diagnose_batch.main([*arguments, "--resume"]) == 0
    assert done == runs
    found = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
    assert (found["diagnosed"], found["verdicts"], found["dated_by"]) == (3, {"none": 3}, "order")
    assert "3 of 3 diagnosed, and no effect is missing in any." in capsys.readouterr().out


def test_a_stage_that_changes_over_the_months(
        tmp_path: Path, capsys: pytest.CaptureFixture[str],
        opens_well: Callable[..., None]) -> None:
    """Five records of a cubic stage whose stiffness falls by 2 % a month, and a broken one."""
    months = [0.0, 1.3, 2.1, 3.4, 4.0]
    runs = [tmp_path / name for name in (
        "jan/run.csv", "feb/run.csv", "mar.csv", "apr.csv", "may.csv", "broken.csv")]
    for k, (run, month) in enumerate(zip(runs, months, strict=False)):
        run.parent.mkdir(exist_ok=True)
        _measure(run, 650.0 * (1.0 - 0.02 * month), k)
        os.utime(run, (1.75e9, 1.75e9 + month * MONTH_S))
    runs[-1].write_text("time_s,input_v,position_m\n0.0,1.0,nonsense\n", encoding="utf-8")
    out = tmp_path / "out"
    assert diagnose_batch.main([*map(str, runs), "--model", "paper_stage", "--out", str(out),
                                "--options=--no-report --library cubic_stiffness"]) == 1
    names = ["jan_run.csv", "feb_run.csv", "mar.csv", "apr.csv", "may.csv"]
    stiffness = [json.loads((out / name / "diagnosis.json").read_text("utf-8"))["base"][
        "stiffness"]["value"] for name in names]
    line = linregress(months, stiffness)
    found = json.loads((out / "summary.json").read_text("utf-8"))
    change = next(c for c in found["changes"] if c["parameter"] == "stiffness")
    assert change["slope"]["value"] == pytest.approx(line.slope, rel=1e-6)
    assert change["slope"]["ci95"] == pytest.approx(
        [line.slope + sign * t.ppf(0.975, 3) * line.stderr for sign in (-1, 1)], rel=1e-6)
    assert change["slope"]["ci95"][0] < -13.0 < change["slope"]["ci95"][1]
    assert (change["real"], change["slope"]["unit"]) == (True, "N/m/month")
    assert (found["dated_by"], found["records"], found["diagnosed"]) == ("file", 6, 5)
    assert found["effects"] == [{"name": "cubic_stiffness", "records": 5, "share": 1.0}]
    assert [Path(each["run"]).name for each in found["failed"]] == ["broken.csv"]
    assert "line 2" in found["failed"][0]["words"]
    assert "5 of 6 diagnosed: cubic stiffness in 5. Stiffness falls by " in capsys.readouterr().out
    with (out / "summary.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["record"] for row in rows[:5]] == names
    assert [float(row["stiffness (N/m)"]) for row in rows[:5]] == pytest.approx(stiffness)
    page = (out / "summary.html").read_text(encoding="utf-8")
    for href in re.findall(r'href="([^"#:]+)"', page):
        assert (out / href).is_file()
    assert all(f'href="{name}/diagnosis.json"' in page for name in names)
    opens_well(out / "summary.html")


def _measure(path: Path, stiffness: float, seed: int) -> None:
    stage = load_model("paper_stage").with_effect("cubic_stiffness", {"k3": 3e7}) \
        .with_parameters({"stiffness": stiffness})
    volts = make_excitation({"kind": "multisine", "amplitude_v": 1.0, "low_hz": 0.5,
                             "high_hz": 60.0, "period_s": 4.0}, sample_period_s=1e-3,
                            duration_s=4.0, seed=seed).voltage
    write_csv(Record(1e-3 * np.arange(volts.size), 1e-3, {"x": AxisRecord(
        volts, Simulator(stage).run(volts).measured(seed))}, Provenance("run", "csv")), path)


@pytest.mark.parametrize(("arguments", "words"), [
    (["a", "--model", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
    (["a", "--model", "paper_stage", "--jobs", "0"], "--jobs 0: give at least 1"),
])
def test_what_cannot_be_used(arguments: list[str], words: str, tmp_path: Path,
                             capsys: pytest.CaptureFixture[str]) -> None:
    assert diagnose_batch.main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_cluster_is_used_by_its_address(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    class Client:
        def __init__(self, address: str, timeout: float) -> None:
            asked.append(address)
            assert timeout > 0.0
            if "nobody" in address:
                raise OSError("timed out")

        def __enter__(self) -> Client:
            return self

        def __exit__(self, *_: object) -> None:
            asked.append("closed")

        def map(self, function: object, jobs: list[Job], pure: bool) -> list[Job]:
            assert function is diagnose_batch.work
            assert not pure  # the same run may be asked for twice
            return jobs

    module = ModuleType("distributed")
    module.__dict__.update(vars(SimpleNamespace(
        Client=Client, as_completed=lambda jobs, with_results: (
            (job, Outcome(job.run, 0, 1.0)) for job in jobs))))
    monkeypatch.setitem(sys.modules, "distributed", module)
    assert [each.run for each in run_batch([Job("a", ()), Job("b", ())], 1, "tcp://h:1")] == [
        "a", "b"]
    assert asked == ["tcp://h:1", "closed"]
    with pytest.raises(DiagnosisError, match="cluster tcp://nobody:1: cannot be reached"):
        list(run_batch([Job("a", ())], 1, "tcp://nobody:1"))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DiagnosisError, match=r"Dask is not installed here; pip install "):
        list(run_batch([Job("a", ())], 1, "tcp://h:1"))


@pytest.mark.slow
def test_two_runs_on_a_real_cluster(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    assert example.main([str(tmp_path / "example")]) == 0
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1",
                                  dashboard_address=None) as cluster:
        assert diagnose_batch.main(
            [str(tmp_path / "example" / "multisine.csv"), "gone.csv", "--model",
             str(tmp_path / "example" / "model.yaml"), "--out", str(tmp_path / "out"),
             "--cluster", cluster.scheduler_address]) == 1
    found = {each["run"]: each["code"] for each in json.loads(
        (tmp_path / "out" / "batch.json").read_text("utf-8"))}
    assert sorted(found.values()) == [0, 2]
    assert (tmp_path / "out" / "multisine.csv" / "diagnosis.json").exists()
