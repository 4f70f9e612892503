"""Running an experiment on the graph: tried again where nodes did not find each other."""

from __future__ import annotations

from pathlib import Path

import pytest

harness = pytest.importorskip("dfm_stage.harness", reason="needs rclpy")

from dfm_stage.cli.graph_run import run_on_graph  # noqa: E402


class Graph:
    """A graph that does not come up."""

    errors: tuple[Exception, ...] = ()
    started = 0

    def __init__(self, **_: object) -> None:
        type(self).started += 1

    def __enter__(self) -> Graph:
        raise self.errors[self.started - 1]

    def __exit__(self, *_: object) -> None: ...


@pytest.mark.parametrize(("first", "starts"), [
    (harness.NotInTimeError("controller: late"), 2),
    (harness.HarnessError("controller ended with code 1; /x/y is not ready"), 1),
])
def test_a_graph_is_started_again_only_where_nodes_did_not_meet(
        first: Exception, starts: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    last = harness.HarnessError("the second start failed as well")
    monkeypatch.setattr(Graph, "errors", (first, last))
    monkeypatch.setattr(Graph, "started", 0)
    monkeypatch.setattr(harness, "StageGraph", Graph)
    with pytest.raises(harness.HarnessError) as failed:
        run_on_graph("scan", tmp_path / "bag", model="paper_stage")
    assert Graph.started == starts
    assert failed.value is (last if starts == 2 else first)
