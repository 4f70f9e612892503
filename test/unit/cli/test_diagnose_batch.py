"""Batches of diagnoses: in parallel, on a cluster, and when some of them fail."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from dfm_stage.cli import diagnose_batch, example
from dfm_stage.cli.diagnose_batch import Job, Outcome, run_batch
from dfm_stage.diagnosis.errors import DiagnosisError


def test_as_many_at_once_as_asked_and_every_run_once(monkeypatch: pytest.MonkeyPatch) -> None:
    together = threading.Barrier(3, timeout=30.0)

    def slow(job: Job) -> Outcome:
        together.wait()
        return Outcome(job.run, 0, 0.0)

    monkeypatch.setattr(diagnose_batch, "work", slow)
    jobs = [Job(f"run{k}", ()) for k in range(6)]
    assert sorted(each.run for each in run_batch(jobs, 3)) == [job.run for job in jobs]


def test_a_run_that_fails_is_named_and_the_others_go_on(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    real = diagnose_batch.work
    monkeypatch.setattr(diagnose_batch, "work", lambda job: real(job) if "gone" in job.run else
                        Outcome(job.run, 0, 0.5))
    code = diagnose_batch.main(["b/second", "a/gone.csv", "--model", "paper_stage", "--out",
                                str(tmp_path / "out"), "--options=--no-report"])
    assert code == 1
    found = json.loads((tmp_path / "out" / "batch.json").read_text(encoding="utf-8"))
    assert [(each["run"], each["code"]) for each in found] == [("b/second", 0), ("a/gone.csv", 2)]
    assert "gone.csv" in found[1]["words"]
    assert "1 of 2 diagnosed" in capsys.readouterr().out


@pytest.mark.parametrize(("arguments", "words"), [
    (["a/x", "b/x", "--model", "paper_stage"], "x: two runs have this name"),
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
