"""The process of a node: its executor, its signals, its participant, and its end."""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dfm_stage import __version__, interruption
from dfm_stage.errors import DfmError
from dfm_stage.middleware import security
from dfm_stage.middleware.discovery import loopback_alone
from dfm_stage.middleware.hand_over import handing_over
from dfm_stage.middleware.security import OPERATOR, enclave_of, require_what_was_asked
from dfm_stage.middleware.shared_memory import (
    PORT_LOOK_S,
    PortWatch,
    avoiding_dead_ports,
    sign_notes,
)
from dfm_stage.nodes.base import PRIORITY, LoopNode, node_class

BEGUN_ANEW = "DFM_STAGE_BEGUN_ANEW"
"""How often this process began anew, in its environment."""
_EVENTS_PER_LOOK = 64
_LEAVING_S = 0.3
"""A reader learns what it lacks within 0.1 s (config/fastdds.xml)."""
_PLACE = re.compile(r", at \.?/")
_SWITCH_S = 1e-4
_ROS_ARGUMENTS = "--ros-args"
_STANDARD = 2
"""The last of the three standard descriptors."""


def make_executor(context: Any) -> Any:
    """Return the executor: rclpy's EventsExecutor, or with DFM_EXECUTOR=default the default one.

    The default one needs more than twice the processor; it is there for comparison and as a way
    out should a later rclpy break the experimental one.
    """
    if os.environ.get("DFM_EXECUTOR", "events") == "default":
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def helper_node(name: str, namespace: str, context: Any, arguments: Sequence[str] = ()) -> Node:
    """Make a node for a program beside the graph: no parameters, arguments or rosout.

    `arguments` are those that its context was initialised with.

    Raises
    ------
    DfmError
        If the middleware refuses it something.
    """
    with refusals_told(name, arguments), avoiding_dead_ports():
        return rclpy.create_node(name, namespace=namespace, context=context,
                                 use_global_arguments=False, enable_rosout=False,
                                 start_parameter_services=False)


@contextlib.contextmanager
def refusals_told(name: str, arguments: Sequence[str] = ()) -> Iterator[None]:
    """Turn what the middleware refuses a node of a process with these arguments into DfmError."""
    try:
        yield
    except rclpy_implementation.RCLError as error:
        right = (f"; has its enclave {enclave_of(arguments)} the right to it, in this "
                 "ROS_DOMAIN_ID?" if security.asked() else "")
        raise DfmError(f"{name}: the middleware refused: {_in_one_line(error)}"
                       f"{right}") from error


class Helper:
    """A node beside the graph in a context of its own, which `executor` spins."""

    def __init__(self, name: str, namespace: str) -> None:
        arguments = [_ROS_ARGUMENTS, "--enclave", OPERATOR]
        require_what_was_asked(arguments)
        self._context = rclpy.Context()
        with loopback_alone():
            rclpy.init(context=self._context, args=arguments,
                       signal_handler_options=SignalHandlerOptions.NO)
        self.node = helper_node(name, namespace, self._context, arguments)
        self.executor = make_executor(self._context)
        self.executor.add_node(self.node)

    def ok(self) -> bool:
        """Return whether its context is still there."""
        return bool(self._context.ok())

    def close(self) -> None:
        """Leave the graph."""
        self.node.destroy_node()
        self._context.try_shutdown()


def steady_interpreter() -> None:
    """Have the loop wait for nothing in this process.

    The garbage collector stays away from what is there at start. It does not even look through it
    once: in a process that just began there is nothing to find. A thread beside the loop that
    computes (the bag writer, a driver) gives the interpreter lock up after 0.1 ms, not 5: at 5 kHz
    a sample has 0.2 ms.
    """
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
    sys.setswitchinterval(_SWITCH_S)


class StopRequest:
    """SIGINT and SIGTERM as a flag instead of an exception.

    An exception could be raised in the middle of anything, a C++ destructor or the closing of a
    bag included; where it was, the process aborted. True once asked to stop. As a context manager
    it puts the handlers back at the end; a process that is to end anyway calls `install`, so that
    a second signal finds no moment to strike in.
    """

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def __bool__(self) -> bool:
        return self.asked

    def _ask(self, _number: int, _frame: Any) -> None:
        self.asked = True

    def install(self) -> None:
        """Take the signals; only the main thread can."""
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._ask)
                            for number in (signal.SIGINT, signal.SIGTERM)}

    def __enter__(self) -> StopRequest:
        self.install()
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def run_node(kind: type[LoopNode], args: Sequence[str] | None = None) -> int:
    """Run one node until it is interrupted; return the exit code.

    `--help` and `--version` only print. A parameter or file that cannot be used is one line on
    stderr and exit code 2. A node whose port in shared memory is gone begins anew in the same
    process. The process runs at the node's real-time priority.
    """
    given = list(sys.argv[1:] if args is None else args)
    return _run(given, lambda: [] if _answered(kind, _own_arguments(given)) else [kind])


def run_nodes(args: Sequence[str]) -> int:
    """Run several nodes in one process, as `run_node` runs one.

    `args` are their full names, such as /stage/x/controller, and ROS arguments for all of them.
    They hand messages over. The process runs at the priority of the first that is no recorder.
    """
    given = list(args)
    return _run(given, lambda: [_placed(name, given) for name in _own_arguments(given)])


def _placed(name: str, given: list[str]) -> Callable[[], LoopNode]:
    """Return what makes a node of the package by its full name."""
    namespace, _, kind = name.rpartition("/")
    try:
        made = node_class(kind)
    except (ModuleNotFoundError, AttributeError):
        made = None
    if made is None or not namespace.startswith("/"):
        raise DfmError(f"{name!r} is no full name of a node of the package, such as "
                       "/stage/x/controller")
    start = given.index(_ROS_ARGUMENTS) + 1 if _ROS_ARGUMENTS in given else len(given)
    return partial(made, cli_args=[
        _ROS_ARGUMENTS, "-r", f"__ns:={namespace}", *given[start:]])


def _run(given: list[str], kinds: Callable[[], Sequence[Callable[[], LoopNode]]]) -> int:
    stop = StopRequest()
    stop.install()
    nodes: list[LoopNode] = []
    anew = False
    try:
        make = kinds()
        if not make:
            return 0
        _give_way(min(_class_of(each).niceness for each in make))
        _join(given)
        context = rclpy.get_default_context()
        executor = make_executor(context)
        with handing_over(context, executor) if len(make) > 1 else contextlib.nullcontext():
            for kind in make:
                nodes.append(_made(kind))
                _sign(nodes)
                executor.add_node(nodes[-1])
                nodes[-1].begin()
            anew = _spin(nodes, executor, stop)
    except ExternalShutdownException:
        pass
    except (DfmError, InvalidParameterTypeException) as error:
        print(f"error: {_in_one_line(error)}", file=sys.stderr)
        return 2
    finally:
        for node in nodes:
            node.ends_process = node is nodes[-1]
            node.destroy_node()
        if anew:
            for node in nodes:
                node.realtime.give_back()
            _begin_anew()
        rclpy.try_shutdown()
    return 0


def _own_arguments(given: list[str]) -> list[str]:
    """Return what is no ROS argument; DfmError where it does not go up."""
    try:
        return list(remove_ros_args(["", *given])[1:])
    except RuntimeError as error:
        raise DfmError(str(error)) from error


def _answered(kind: type[LoopNode], own: list[str]) -> bool:
    """Print what was asked about the node; return whether anything was."""
    if {"-h", "--help"} & set(own):
        from dfm_stage.nodes.help import help_text

        print(help_text(kind))
    elif "--version" in own:
        print(f"{kind.kind} {__version__} (dfm_stage)")
    elif own:
        raise DfmError(f"unknown arguments {' '.join(own)}: write parameters as --ros-args -p "
                       f"name:=value; {kind.kind} --help lists them")
    return bool(own)


def _join(given: list[str]) -> None:
    """Join the graph with these ROS arguments; DfmError where that cannot be."""
    require_what_was_asked(given)
    try:
        with loopback_alone():
            rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise DfmError(str(error)) from error


def _made(kind: Callable[[], LoopNode]) -> LoopNode:
    """Make the node; DfmError where the middleware refuses it something."""
    with refusals_told(_class_of(kind).kind, sys.argv), avoiding_dead_ports():
        return kind()


def _sign(nodes: Sequence[LoopNode]) -> bool:
    """Say in the notes of this process whose it is; return whether that is written."""
    return sign_notes(nodes[0].an_endpoint(), [each.get_fully_qualified_name() for each in nodes])


def _class_of(kind: Callable[[], LoopNode]) -> type[LoopNode]:
    """Return the class of the node that this makes."""
    return kind.func if isinstance(kind, partial) else kind  # type: ignore[return-value]


def _give_way(niceness: int) -> None:
    """Raise the niceness of this process to a value; one that began anew has it already."""
    if niceness > os.getpriority(os.PRIO_PROCESS, 0):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)


def _in_one_line(error: Exception) -> str:
    """What an error says, without the places in their own sources that rcl and rclpy add."""
    return " ".join(_PLACE.split(str(error))[0].split())


def _spin(nodes: Sequence[LoopNode], executor: Any, stop: StopRequest) -> bool:
    """Spin until asked to stop; return True where the process has to begin anew instead."""
    leader = min(nodes, key=lambda node: node.priority < PRIORITY.default)
    for node in nodes:
        node.leaving_s = _LEAVING_S
        if node is not leader:
            node.realtime.words = f"that of {leader.get_fully_qualified_name()}"
    steady_interpreter()
    if not isinstance(executor, SingleThreadedExecutor):  # that keeps the processors full
        leader.realtime.take(leader.settings[PRIORITY.name], time.monotonic())
    ports, look = PortWatch(), time.monotonic()
    signed = False
    while rclpy.ok():
        # spin() of this executor forgets timers while no message comes
        for _ in range(_EVENTS_PER_LOOK):
            executor.spin_once(0.1)
            if stop.asked:
                return False
        if time.monotonic() - look > PORT_LOOK_S:
            look = time.monotonic()
            signed = signed or _sign(nodes)  # again: /dev/shm may have been full
            if ports.lost():
                leader.get_logger().error("its port in shared memory is gone (was another "
                                          "process killed?): it hears nobody and begins anew")
                return True
    return False


def _begin_anew() -> None:
    """Start this process over. Fast DDS opens its locks for children, too: kept, the lost port
    would be taken for one of the new beginning, and be lost again."""
    os.environ[BEGUN_ANEW] = str(int(os.environ.get(BEGUN_ANEW, "0")) + 1)
    for name in os.listdir("/proc/self/fd"):
        if int(name) > _STANDARD:
            with contextlib.suppress(OSError):
                os.set_inheritable(int(name), False)
    interruption.block()
    os.execv(sys.executable, sys.orig_argv)  # noqa: S606 what started this

