"""Subscriptions that no executor watches: what came is fetched every few milliseconds.

To wake up for each of several thousand messages a second costs a program beside the graph most of
its processor time, and with it the answers that it waits for.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from dfm_stage.middleware.hand_over import Receiver
from dfm_stage.nodes.process import helper_node

FETCH_PERIOD_S = 0.005


class Taps:
    """Topics that are fetched while the executor of `node` spins."""

    def __init__(self, node: Node) -> None:
        self._node = helper_node(f"{node.get_name()}_tap", node.get_namespace(), node.context)
        self._spun_with = node
        self._taps: list[tuple[Callable[..., Any], Any, Callable[[bytes], object]]] = []
        node.create_timer(FETCH_PERIOD_S, self._fetch,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add(self, message_type: Any, topic: str, callback: Callable[[bytes], object],
            qos: Any) -> Receiver:
        """Subscribe: `callback` gets the serialised messages."""
        tap = Receiver(self._node, message_type, topic, callback, qos, spun_with=self._spun_with)
        self._taps.append((tap.ros.handle.take_message, message_type, tap.from_dds))
        return tap

    def _fetch(self) -> None:
        for take, message_type, heard in self._taps:
            while (taken := take(message_type, True)) is not None:
                heard(taken[0])

    def close(self) -> None:
        """Leave the graph."""
        self._taps.clear()
        self._node.destroy_node()
