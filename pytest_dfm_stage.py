"""The pytest plugin of dfm_stage: a running stage in one line of a test, isolated and cleaned up.

>>> def test_step(lockstep_graph, tmp_path):                           # doctest: +SKIP
...     graph = lockstep_graph(model="my_stage.yaml", bag=tmp_path / "bag")
...     graph.run("step")
...     graph.close()
...     assert abs(graph.record().axis().position[-1] - 1e-3) < 1e-6

pytest loads this module in every run of an environment that has dfm_stage. It therefore stands
beside the package and imports nothing of it until a test asks for a graph.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from dfm_stage.harness import StageGraph

    MakeGraph = Callable[..., StageGraph]

REAL_TIME = "real_time"
REACHING_OUT = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "ROS_DISCOVERY_SERVER",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
)
"""Variables by which nodes of a test could meet nodes of other machines."""


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers", f"{REAL_TIME}: against the clock; other pytest-xdist processes wait meanwhile")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Arrange turns among the processes of pytest-xdist, where a test is marked real_time."""
    if "PYTEST_XDIST_WORKER" in os.environ and any(map(needs_machine, items)):
        config.pluginmanager.register(Turns(config), "dfm_stage_turns")


def needs_machine(item: pytest.Item) -> bool:
    """Whether a test runs against the clock."""
    return item.get_closest_marker(REAL_TIME) is not None


class Turns:
    """Which processes of pytest-xdist may run a test: one alone, or all that need not be alone.

    Held by locks on two files that the processes share.
    """

    def __init__(self, config: pytest.Config) -> None:
        factory = config._tmp_path_factory  # type: ignore[attr-defined]
        folder = Path(factory.getbasetemp()).parent
        self._turn, self._machine = (folder / "turn").open("a"), (folder / "machine").open("a")
        self._alone = False

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item,
                                nextitem: pytest.Item | None) -> Iterator[None]:
        """Wait for the turn before the test's time runs; keep it for a row of such tests."""
        import fcntl

        alone = needs_machine(item)
        if not self._alone:
            # whoever waits for the machine keeps the turn, so that it comes soon
            fcntl.flock(self._turn, fcntl.LOCK_EX)
            fcntl.flock(self._machine, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
            fcntl.flock(self._turn, fcntl.LOCK_UN)
            self._alone = alone
        done = yield
        if not (self._alone and nextitem is not None and needs_machine(nextitem)):
            fcntl.flock(self._machine, fcntl.LOCK_UN)
            self._alone = False
        return done


@pytest.fixture
def stage_graph(monkeypatch: pytest.MonkeyPatch,
                tmp_path_factory: pytest.TempPathFactory) -> Iterator[MakeGraph]:
    """Bring up node sets: `graph = stage_graph(model="my_stage.yaml", ...)`.

    Takes the arguments of `dfm_stage.harness.StageGraph` and returns it running: in real time,
    each node a process. Each has a ROS domain of its own, on this machine only; nodes that the
    test itself starts join the last one. After the test all are closed and the environment is as
    before. Skips the test where ROS 2 or the stage's messages are missing.
    """
    keep_here(monkeypatch, tmp_path_factory.mktemp("ros"))
    try:
        from dfm_stage.harness import StageGraph
    except ModuleNotFoundError as error:
        pytest.skip(f"stage_graph needs ROS 2 Jazzy and dfm_interfaces: no module {error.name}; "
                    "source the workspace's install/setup.bash")
    with contextlib.ExitStack() as cleanup:
        def make(**options: Any) -> StageGraph:
            graph = cleanup.enter_context(StageGraph(**options))
            monkeypatch.setenv("ROS_DOMAIN_ID", str(graph.domain_id))
            return graph

        yield make


@pytest.fixture
def lockstep_graph(stage_graph: MakeGraph) -> MakeGraph:
    """As `stage_graph`, but faster than real time and repeatable, all nodes in this process."""
    def make(**options: Any) -> StageGraph:
        return stage_graph(**{"lockstep": True, "composed": True, **options})

    return make


def keep_here(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Keep ROS on this machine, and its logs in `folder`."""
    for name in REACHING_OUT:
        monkeypatch.setenv(name, "")  # so that what is set below is undone, too
        monkeypatch.delenv(name)
    for name, value in (("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
                        ("ROS_HOME", str(folder)), ("ROS_LOG_DIR", str(folder / "log"))):
        monkeypatch.setenv(name, value)
    from dfm_stage.middleware.discovery import keep_to_this_machine

    keep_to_this_machine()
