"""The faults there are: what each does to a running graph, and what has to be said of it.

A kind is one entry of `KINDS`: a function that does it, and the words that explain it. What ends
it goes onto `scene.undo`, which the campaign closes before the operator repairs the graph.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import random
import resource
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.fault_ledger import CLOCK_AHEAD_S
from benchmarks.fault_outcome import Fault
from benchmarks.fault_scene import (
    NODES,
    RECORDER,
    RECORDER_MAY_LOSE_S,
    Scene,
    packaged_model,
)
from benchmarks.private import PRIVATE
from dfm_stage.harness import HarnessError

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 where Fast DDS has its ports
CLOCK_STEP_S = 60.0
"""Longer than a graph may take to recover: a wait by the clock that was set back shows."""
FAKETIME_FILE = "FAKETIME_TIMESTAMP_FILE"
STORM_HZ = 1000
STOPPED_S = 10.0
MEMBERS_S = 4.0
"""A node that starts has met the others within this, s."""
LIVE = {"controller": ("kp", "600.0"), "trajectory_generator": ("duration_s", "4.0")}
FIXED = ("realtime_priority", "20")


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    `targets` is what it may be done to, `lasts_s` the range of how long. One of `words` must be
    said in diagnostics, also where the loop went on; without them there is something to explain
    only where it did not, or a node is gone. `faked_clock`: needs nodes under libfaketime;
    `private`: a /dev/shm and a disk of its own.
    """

    name: str
    strike: Callable[[Scene, Fault], None]
    targets: Sequence[str] = NODES
    lasts_s: tuple[float, float] = (0.0, 0.0)
    words: tuple[str, ...] = ()
    faked_clock: bool = False
    private: bool = False

    def impossible(self) -> str:
        """Return why it cannot be done on this machine, or nothing."""
        if self.private and PRIVATE not in os.environ:
            return "a mount namespace of its own is not permitted"
        if self.faked_clock and not faketime():
            return "libfaketime (pip install libfaketime) is not there"
        return ""


# Nodes

def _kill(scene: Scene, fault: Fault) -> None:
    scene.end(fault.node, signal.SIGKILL)


def _restart(scene: Scene, fault: Fault) -> None:
    scene.end(fault.node, signal.SIGINT)
    scene.start(fault.node)


def _pause(scene: Scene, fault: Fault) -> None:
    begin_ns = time.time_ns()
    scene.graph.signal_node(fault.node, signal.SIGSTOP)
    try:
        scene.spin(fault.pause_s)
    finally:
        scene.graph.signal_node(fault.node, signal.SIGCONT)
    if fault.node == RECORDER:
        scene.ledger.paused.append((begin_ns, time.time_ns()))


def _stop_all(scene: Scene, fault: Fault) -> None:
    """The witness stands still, too."""
    begin_ns, nodes = time.time_ns(), [each.full_name for each in scene.graph.launched]
    try:
        for node in nodes:
            scene.graph.signal_node(node, signal.SIGSTOP)
        time.sleep(fault.pause_s)
    finally:
        for node in nodes:
            scene.graph.signal_node(node, signal.SIGCONT)
    scene.ledger.paused.append((begin_ns, time.time_ns()))


def _twice(scene: Scene, fault: Fault) -> None:
    scene.undo.enter_context(scene.second([fault.node]))
    scene.spin(fault.pause_s)


def _second_graph(scene: Scene, fault: Fault) -> None:
    scene.undo.enter_context(scene.second(
        [name.replace("/stage", fault.node, 1) for name in NODES]))
    scene.spin(fault.pause_s)


# What nodes live on

def _no_memory(scene: Scene, fault: Fault) -> None:
    """From now on the node gets no more address space than it has."""
    pid = scene.pid(fault.node)
    before = resource.prlimit(pid, resource.RLIMIT_AS)
    pages = int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[0])
    resource.prlimit(pid, resource.RLIMIT_AS, (pages * resource.getpagesize(), before[1]))

    def lift() -> None:
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(pid, resource.RLIMIT_AS, before)

    scene.undo.callback(lift)
    scene.spin(fault.pause_s)


def _disk_full(scene: Scene, fault: Fault) -> None:
    until_ns = time.time_ns() - int(RECORDER_MAY_LOSE_S * 1e9)
    scene.undo.callback(scene.change_bag, until_ns)
    scene.undo.enter_context(_full(scene.folder))
    scene.spin(fault.pause_s)


def _shared_memory_full(scene: Scene, fault: Fault) -> None:
    """A node that starts meanwhile cannot have its ports."""
    if fault.node in NODES:
        scene.end(fault.node, signal.SIGINT)
    scene.undo.enter_context(_full(SHARED_MEMORY))
    if fault.node in NODES:
        scene.graph.launch_again(fault.node)
    scene.spin(fault.pause_s)


@contextlib.contextmanager
def _full(folder: Path) -> Iterator[None]:
    """Take all the room there is; only where that is nobody else's."""
    if PRIVATE not in os.environ:
        raise HarnessError(f"{folder} is not this bench's alone")
    ballast = folder / "ballast"
    try:
        with ballast.open("wb") as file:
            while free := os.statvfs(folder).f_bavail:
                size = os.fstat(file.fileno()).st_size
                with contextlib.suppress(OSError):  # a node was faster
                    os.posix_fallocate(file.fileno(), size, free * os.statvfs(folder).f_frsize)
        yield
    finally:
        ballast.unlink(missing_ok=True)


# What nodes take for granted

def _clock_set(scene: Scene, fault: Fault) -> None:
    """The clock of the nodes alone is set, and set back; their monotonic clock goes on."""
    step_s = CLOCK_STEP_S if fault.node == "forward" else -CLOCK_STEP_S
    _set_clock(scene, CLOCK_AHEAD_S + step_s)
    scene.undo.callback(_set_clock, scene, CLOCK_AHEAD_S)
    scene.spin(fault.pause_s)


def _set_clock(scene: Scene, ahead_s: float) -> None:
    file = Path(os.environ[FAKETIME_FILE])
    fresh = file.with_suffix(".new")
    fresh.write_text(f"{ahead_s:+g}\n", "ascii")
    fresh.replace(file)
    scene.clock_ahead_ns = int(ahead_s * 1e9)


def _model_replaced(scene: Scene, fault: Fault) -> None:
    """The operator can go on: what the nodes work with is in their memory."""
    known = scene.model.read_bytes()
    scene.undo.callback(scene.model.write_bytes, known)
    if fault.node == "gone":
        scene.model.unlink()
    else:
        scene.model.write_bytes(known[:len(known) // 2] + b": [" if fault.node == "broken" else
                                packaged_model("demo_stage"))
    scene.spin(fault.pause_s)
    scene.operate()


# Strangers

def _storm(scene: Scene, fault: Fault) -> None:
    kind = fault.node.rpartition("/")[2]
    scene.undo.enter_context(scene.tool("storm", fault.node, str(STORM_HZ),
                                        *LIVE.get(kind, FIXED)))
    scene.spin(fault.pause_s)


def _never_reads(scene: Scene, fault: Fault) -> None:
    process = scene.undo.enter_context(scene.tool("deaf", "/stage/x"))
    if fault.node == "stopped":
        process.send_signal(signal.SIGSTOP)
    scene.spin(fault.pause_s)


KINDS = {kind.name: kind for kind in (
    Kind("kill", _kill),
    Kind("pause", _pause, lasts_s=(0.05, 2.0)),
    Kind("restart", _restart),
    Kind("stop_all", _stop_all, ("all nodes",), (STOPPED_S, STOPPED_S)),
    Kind("twice", _twice, lasts_s=(MEMBERS_S, MEMBERS_S + 2.0), words=("nodes are called",)),
    Kind("second_graph", _second_graph, ("/stage", "/elsewhere"), (MEMBERS_S, MEMBERS_S + 2.0)),
    Kind("no_memory", _no_memory, lasts_s=(1.0, 4.0)),
    Kind("disk_full", _disk_full, (RECORDER,), (1.0, 3.0), ("the disk is full",), private=True),
    Kind("shared_memory_full", _shared_memory_full, (str(SHARED_MEMORY), "/stage/x/controller"),
         (1.0, 3.0), private=True),
    Kind("clock_set", _clock_set, ("forward", "back"), (1.0, 3.0), faked_clock=True),
    Kind("model_replaced", _model_replaced, ("another", "broken", "gone"), (0.5, 1.0)),
    Kind("storm", _storm, lasts_s=(1.0, 3.0)),
    Kind("never_reads", _never_reads, ("not spun", "stopped"), (2.0, 4.0)),
)}


def draw(count: int, seed: int, only: str | None = None) -> list[Fault]:
    """Return `count` faults, each kind on each target as often as any other, in random order.

    With `only` they are of this kind. Fewer faults of a seed are the first of more.
    """
    rng = random.Random(seed)
    every = [(target, kind) for kind in KINDS.values() if only in {None, kind.name}
             for target in kind.targets]
    out: list[Fault] = []
    while len(out) < count:
        rng.shuffle(every)
        out += [Fault(target, kind.name, rng.uniform(*kind.lasts_s) if kind.lasts_s[1] else 0.0)
                for target, kind in every]
    return out[:count]


def faketime() -> Path | None:
    """Return the library of the PyPI package libfaketime, or None.

    Not that of Debian 12: under it `time.sleep` fails in Python 3.11, whatever the clock.
    """
    found = importlib.util.find_spec("libfaketime")
    for folder in (found.submodule_search_locations or ()) if found else ():
        return next(Path(folder).glob("vendor/libfaketime/src/libfaketime.so.1"), None)
    return None
