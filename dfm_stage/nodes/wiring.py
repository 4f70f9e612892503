"""Who talks to whom: the loop topics, their types, their quality of service.

Loop topics are relative names inside the namespace of one axis (`/stage/x`). Publishers are
reliable with a history of 2000 samples, so a recorder that is held up for two seconds at 1 kHz
loses nothing; the nodes of the loop subscribe best effort with depth 1, because a late sample is
of no use to them (a queue of commands is delay, and with it the loop diverged). The simulated
scale is read through a deep, reliable subscription, as the buffer of a real counter would be, and
the generator, which works one sample ahead, counts every measurement. In lockstep every sample
counts: both sides are reliable and keep all, and a full history holds the publisher back instead
of losing a sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dfm_interfaces.msg import (
    AmplifierState,
    CoilCurrent,
    Command,
    Drive,
    Excitation,
    Measurement,
    PlantState,
    PositionCounts,
    Reference,
)

DEFAULT_NAMESPACE = "/stage/x"
RECORDER_TAP = "recorder_tap"


@dataclass(frozen=True)
class Link:
    """One loop topic: its name in the axis namespace, its type, the nodes at its ends."""

    topic: str
    type: Any
    publisher: str
    subscribers: tuple[str, ...]
    buffered: tuple[str, ...] = ()


LINKS = {
    link.topic: link for link in (
        Link("sim/position_counts", PositionCounts, "sim_plant", ("encoder_driver",),
             buffered=("encoder_driver",)),
        Link("sim/current", CoilCurrent, "sim_plant", ("amplifier_driver",)),
        Link("sim/drive", Drive, "amplifier_driver", ("sim_plant",)),
        Link("measurement", Measurement, "encoder_driver",
             ("controller", "trajectory_generator"), buffered=("trajectory_generator",)),
        Link("reference", Reference, "trajectory_generator", ("controller",)),
        Link("excitation", Excitation, "trajectory_generator", ("controller",)),
        Link("command", Command, "controller", ("amplifier_driver",)),
        Link("amplifier", AmplifierState, "amplifier_driver", ()),
        Link("plant", PlantState, "sim_plant", ()),
    )
}

LOCKSTEP_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
PUBLISHER_QOS = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
SUBSCRIBER_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LOSSY_QOS = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                         durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED_FROM_MANY_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE,
                                   durability=DurabilityPolicy.TRANSIENT_LOCAL)


def subscriber_qos(link: Link, node_kind: str, lockstep: bool) -> QoSProfile:
    """Return the quality of service of a loop subscription."""
    if lockstep:
        return LOCKSTEP_QOS
    return PUBLISHER_QOS if node_kind in link.buffered else SUBSCRIBER_QOS
