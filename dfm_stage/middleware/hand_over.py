"""Messages between the nodes of one process: by a call, and over DDS only for who is outside.

rclpy has no transport within a process: between two nodes of one executor a message costs a
wake-up and a way through DDS, ten times of what the nodes do with it. Who composes nodes on one
executor opens a `HandOver` for their context. From then on a `Sender` puts a message where its
`Receiver`s wait, and the executor calls them in the order in which messages were put, after the
callback that put them. So nobody is called from within a call, what a callback raises reaches
whoever spins, and a thread of a driver may put messages, too. A message is put as bytes, and with
the fields that it was made of: a receiver that wants fields need not decode it. What goes outside
goes when all in the process have been called: the loop does not wait for the system calls. Jobs
beside the loop come after that (`in_spare_time`): at 5 kHz a sample has 0.2 ms. A clock that is as
fast as that ticks in the thread of the loop itself (`keep_time`).

A receiver that only keeps messages (the recorder) takes them when it likes: with `arrivals`, a
list of its own, bytes are put there with the time, and nobody is called.

Every receiver keeps its subscription: the graph shows it, and publishers that do not hand over
(other processes, plain rclpy nodes) reach it there. A message goes to DDS, too, where more
subscriptions are matched than there are receivers. What a receiver then hears twice it drops. As
the subscription would, a receiver that has a depth keeps the newest messages.

Only for topics without history for late joiners (durability: volatile).
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from operator import itemgetter
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile

TURN_S = 4e-3
"""How long messages are handed over before timers and services get their turn: a loop in lockstep
never runs out of messages. A turn of the executor costs 0.08 ms: 7 % of the time after 1 ms. Who
hears what is looked up once in this time, and when somebody asks whether all is ready."""
_STAY_S = 1e-3
"""How long the ticks of a fast clock follow each other before the executor gets its turn."""
_FAST_S = _STAY_S / 2
"""A clock up to this period is fast: between two of its ticks a turn of the executor, with what
wakes it, takes too much of the time."""
_SPARE = 0.25
"""Share of the time from turn to turn for jobs beside the loop; one is always done."""
_ECHOES = 64
"""At least so many messages that went to DDS, too, are known again when they come from there."""


class HandOver:
    """What the nodes of one context hand over, on the one `executor` that spins them.

    A node that is not, or no more, on this executor hears by DDS. `due` are the receivers in the
    order of the messages that wait with them; `scheduled` is whether a turn is ahead or under way,
    in which they are called. `turn` is a number while a turn is under way, and 0 between turns.
    Who hears what is looked up when that number changes, `TURN_S` after the last time: a listener
    that joins hears from then on. `outside` is what goes to DDS at the end of the turn.
    """

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._known: list[Receiver] = []
        self._spun: list[Node] | None = None
        self._receivers: dict[str, tuple[Receiver, ...]] = {}
        self.due: deque[Receiver] = deque()
        self.outside: deque[tuple[Callable[[bytes], None], bytes]] = deque()
        self._turns = self.turn = self.thread = 0
        self._looked_s = self._begun_s = self._ended_s = 0.0
        self.spare: deque[Callable[[], object]] = deque()
        self.scheduled = False
        self._ticks: dict[Callable[[], float], float] = {}
        self._ticking = False

    def add(self, receiver: Receiver) -> None:
        """Have a receiver called from now on."""
        self._known.append(receiver)
        self._spun = None

    def remove(self, receiver: Receiver) -> None:
        """Have a receiver called no more."""
        receiver.waiting.clear()
        if receiver in self._known:
            self._known.remove(receiver)
            self._spun = None

    def receivers(self, topic: str) -> tuple[Receiver, ...]:
        """Return who gets what is put on a topic."""
        if not self.turn:
            self._look()
        return self._receivers.get(topic, ())

    def idle(self) -> bool:
        """Return whether all that was put has arrived."""
        return not (self.due or self.outside)

    def look_anew(self) -> None:
        """Look up who hears what at the next turn."""
        self._spun = None

    def close(self) -> None:
        """Let go of everything: a circle through the executor, which is no Python object, would
        keep the participant alive."""
        self._executor = None
        self._known.clear()
        self._receivers.clear()
        self.due.clear()
        self.outside.clear()
        self.spare.clear()
        self._ticks.clear()
        self._spun = None

    def _look(self) -> None:
        """Find who is to be called, where the nodes on the executor have changed."""
        if self._executor is None or self._spun == (spun := self._executor.get_nodes()):
            return
        self._spun, self._receivers = spun, {}
        for receiver in self._known:
            if receiver.spun_with in spun:
                before = self._receivers.get(receiver.topic, ())
                self._receivers[receiver.topic] = (*before, receiver)
            else:
                receiver.waiting.clear()

    def schedule(self) -> None:
        """Have the executor call those that are due."""
        if self._executor is not None:
            self.scheduled = True
            self._executor.create_task(self._turn)

    def _turn(self) -> None:
        self.scheduled = False
        self.run()

    def keep_time(self, tick: Callable[[], float]) -> None:
        """Run `tick` now, and then always when it is due, which it returns (steady clock, s)."""
        self._ticks[tick] = 0.0
        if not self._ticking:
            self._ticking = True
            self._executor.create_task(self._tick)

    def _tick(self) -> None:
        """Sleep and run what is due, for `_STAY_S`; then go on after what the executor has to do.

        A timer of the executor sleeps in a thread of its own, which then wakes this one: twice as
        many chances to wake up late.
        """
        until_s = time.monotonic() + _STAY_S
        while self._ticks:
            tick, due_s = min(self._ticks.items(), key=itemgetter(1))
            if (rest_s := due_s - time.monotonic()) > 0.0:
                time.sleep(rest_s)
            due_s = self.run(tick)
            if tick in self._ticks:
                self._ticks[tick] = due_s
            if due_s > until_s:
                self._executor.create_task(self._tick)
                return
        self._ticking = False

    def run(self, first: Callable[[], Any] | None = None) -> Any:
        """Call `first`, then those that are due, for `TURN_S` at most; then send outside, and do
        jobs for `_SPARE` of the time since the last turn. Return what `first` did."""
        due, now, ahead = self.due, time.monotonic, self.scheduled
        begun_s = now()
        since_s, self._begun_s = begun_s - self._begun_s, begun_s
        if begun_s - self._looked_s > TURN_S or self._spun is None:
            self._looked_s = begun_s
            self._turns += 1
            self._look()
        self.scheduled, self.turn, self.thread = True, self._turns, threading.get_ident()
        try:
            result = first() if first is not None else None
            while due:
                receiver = due.popleft()
                if receiver.waiting:  # else a newer message took the place of this one
                    receiver.received += 1
                    receiver.callback(receiver.waiting.popleft())
                if now() - begun_s > TURN_S:
                    break
        finally:
            self.scheduled, self.turn = ahead, 0
            if due and not ahead:
                self.schedule()
            while self.outside:
                send, data = self.outside.popleft()
                send(data)
            self._ended_s = now()
        while self.spare:
            self.spare.popleft()()
            if now() - self._ended_s >= _SPARE * since_s:
                break
        return result

    def when_spare(self, job: Callable[[], object]) -> None:
        """Do a job that is no part of the loop at the end of a turn: then there is most time until
        the next. Where no turns follow each other, do it now."""
        if job not in self.spare:
            self.spare.append(job)
        while self.spare and time.monotonic() - self._ended_s > TURN_S:
            self.spare.popleft()()

    def forget(self, node: object) -> None:
        """Drop the jobs and the clock of a node that ends."""
        for job in [each for each in self.spare if getattr(each, "__self__", None) is node]:
            self.spare.remove(job)
        for tick in [each for each in self._ticks if getattr(each, "__self__", None) is node]:
            del self._ticks[tick]


_open: dict[Any, HandOver] = {}


@contextmanager
def handing_over(context: Any, executor: Any) -> Iterator[None]:
    """Have the nodes that are made with `context`, all of which `executor` spins, hand over."""
    _open[context] = HandOver(executor)
    try:
        yield
    finally:
        _open.pop(context).close()


def hands_over(node: Node) -> bool:
    """Return whether a node is in a process whose nodes hand over."""
    return node.context in _open


def look_anew(node: Node) -> None:
    """Look up who hears what before the next message."""
    if node.context in _open:
        _open[node.context].look_anew()


def in_a_turn(node: Node, callback: Callable[[], None]) -> Callable[[], None]:
    """Return what an executor calls in place of `callback`, so that what this puts is handed over
    right after it, and not at the executor's next turn."""
    hand_over = _open.get(node.context)
    return callback if hand_over is None else partial(hand_over.run, callback)


def in_spare_time(node: Node, job: Callable[[], object]) -> Callable[[], object]:
    """Return what an executor calls in place of `job`, a method of `node` that is no part of the
    loop."""
    hand_over = _open.get(node.context)
    return job if hand_over is None else partial(hand_over.when_spare, job)


def keep_time(node: Node, tick: Callable[[], float], period_s: float) -> bool:
    """Run `tick`, a method of `node` that returns when it is due again (steady clock, s), without
    a timer from now on; False, and nothing is done, where its period is none that needs it."""
    hand_over = _open.get(node.context)
    if hand_over is None or period_s > _FAST_S:
        return False
    hand_over.keep_time(tick)
    return True


def forget(node: object) -> None:
    """Drop the jobs and the clock of a node that ends."""
    for hand_over in _open.values():
        hand_over.forget(node)


class Receiver:
    """A subscription whose `callback` gets messages, by a call or from DDS.

    It gets the serialised message, or with `decode` what that makes of it. `received` counts
    them. `spun_with` is the node whose executor has to be that of the hand-over, where it is not
    `node`. With `arrivals` what is handed over is put there as (`number`, serialised message,
    system time in ns).
    """

    def __init__(self, node: Node, message_type: Any, topic: str,
                 callback: Callable[[Any], object], qos: QoSProfile, *,
                 decode: Callable[[bytes], Any] | None = None, spun_with: Node | None = None,
                 arrivals: list[tuple[int, bytes, int]] | None = None, number: int = 0) -> None:
        depth = None if qos.history == HistoryPolicy.KEEP_ALL else qos.depth
        self.callback = callback
        self.decode = decode
        self.arrivals = arrivals
        self.number = number
        self.received = 0
        self.waiting: deque[Any] = deque(maxlen=depth)
        self.echoes: deque[bytes] = deque(maxlen=depth and max(depth, _ECHOES))
        self.ros = node.create_subscription(message_type, topic, self.from_dds, qos, raw=True)
        self.topic = self.ros.topic_name
        self.spun_with = spun_with or node
        self._hand_over = _open.get(node.context)
        if self._hand_over is not None:
            self._hand_over.add(self)

    def from_dds(self, data: bytes) -> None:
        """Take a message that came from DDS, unless it was handed over."""
        if not self.was_handed_over(data):
            self.received += 1
            self.callback(data if self.decode is None else self.decode(data))

    def was_handed_over(self, data: bytes) -> bool:
        """Return whether what came from DDS is known already, and forget it."""
        if data not in self.echoes:
            return False
        while self.echoes.popleft() != data:
            pass
        return True

    def leave(self) -> None:
        """Receive by call no more."""
        if self._hand_over is not None:
            self._hand_over.remove(self)


class Sender:
    """A publisher of serialised messages."""

    def __init__(self, node: Node, message_type: Any, topic: str, qos: QoSProfile) -> None:
        self.ros = node.create_publisher(message_type, topic, qos)
        self._topic = self.ros.topic_name
        self._publish: Callable[[bytes], None] = self.ros.handle.publish_raw
        self._matched: Callable[[], int] = self.ros.handle.get_subscription_count
        self._hand_over = _open.get(node.context)
        self._looked = 0
        self._here: tuple[Receiver, ...] = ()
        self._called: tuple[Receiver, ...] = ()
        self._keeping: tuple[tuple[Callable[[Any], None], int], ...] = ()
        self._outside = True

    def put(self, data: bytes, fields: Any = None) -> None:
        """Send a message to the receivers of this process, and over DDS to all others.

        `fields` is what decoding it would give, where the caller has that.
        """
        hand_over = self._hand_over
        if hand_over is not None:
            if not self._looked or self._looked != hand_over.turn:
                self._look(hand_over)
            for receiver in self._called:
                receiver.waiting.append(
                    data if receiver.decode is None
                    else receiver.decode(data) if fields is None else fields)
                hand_over.due.append(receiver)
            if self._called and not hand_over.scheduled:
                hand_over.schedule()
            for keep, number in self._keeping:
                keep((number, data, time.time_ns()))
            if not self._outside:
                return
            for receiver in self._here:
                receiver.echoes.append(data)
            if hand_over.turn and hand_over.thread == threading.get_ident():
                hand_over.outside.append((self.to_dds, data))
                return
        self.to_dds(data)

    def _look(self, hand_over: HandOver) -> None:
        """Find who hears this sender, here and outside, for this turn."""
        self._looked = hand_over.turn
        here = hand_over.receivers(self._topic)
        if here is not self._here:
            self._here = here
            self._called = tuple(each for each in here if each.arrivals is None)
            self._keeping = tuple((each.arrivals.append, each.number) for each in here
                                  if each.arrivals is not None)
        self._outside = self._matched() > len(here)

    def to_dds(self, data: bytes) -> None:
        """Send a message over DDS.

        Raises
        ------
        RuntimeError
            If the history of the publisher is full.
        """
        self._publish(data)

    def delivered(self, within_s: float = 0.0) -> bool:
        """Return whether every receiver and every reliable subscriber has all that was sent."""
        return (self._hand_over is None or self._hand_over.idle()) and bool(
            self.ros.wait_for_all_acked(Duration(seconds=max(within_s, 0.0))))
