"""Who talks to whom: topics and services, their types, their quality of service.

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

import importlib
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
    """One loop topic: its name in the axis namespace, its type, the nodes at its ends.

    The `subscribers` always listen, those in `sometimes` where a parameter says so.
    """

    topic: str
    type: Any
    publisher: str
    subscribers: tuple[str, ...]
    buffered: tuple[str, ...] = ()
    sometimes: tuple[str, ...] = ()


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
        Link("amplifier", AmplifierState, "amplifier_driver", (), sometimes=("controller",)),
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
DRIVERS = ("encoder_driver", "amplifier_driver")
EVERY_NODE: tuple[str, ...] = ()
"""In the tables: all of them, those that users write included."""


@dataclass(frozen=True)
class Topic:
    """A topic beside the loop: its name from the axis namespace (`~/`: below the node), its type,
    the nodes at its ends."""

    name: str
    type: str
    publishers: tuple[str, ...]
    what: str
    qos: QoSProfile
    subscribers: tuple[str, ...] = ()
    subscriber_qos: QoSProfile | None = None

    def is_of(self, kind: str) -> bool:
        """Whether nodes of this kind publish it."""
        return not self.publishers or kind in self.publishers


TOPICS = {
    topic.name: topic for topic in (
        Topic("joint_states", "sensor_msgs/msg/JointState", ("encoder_driver",),
              "position at 20 Hz, for viewers", QoSProfile(depth=10)),
        Topic("encoder_health", "diagnostic_msgs/msg/DiagnosticStatus", ("encoder_driver",),
              "latched: why the output must be off, directly to amplifier_driver",
              LATCHED_QOS, ("amplifier_driver",)),
        Topic("amplifier_health", "diagnostic_msgs/msg/DiagnosticStatus", ("amplifier_driver",),
              "latched: whether the output is on, and why not; at each change, in real time at "
              "10 Hz, too", LATCHED_QOS, ("trajectory_generator",)),
        Topic("loop_health", "diagnostic_msgs/msg/DiagnosticStatus",
              ("controller", "trajectory_generator"),
              "latched: whether measurements come at `sample_period_s`; amplifier_driver does not "
              "arm before", LATCHED_QOS, ("amplifier_driver",), LATCHED_FROM_MANY_QOS),
        Topic("~/transition_event", "lifecycle_msgs/msg/TransitionEvent", DRIVERS,
              "changes of life cycle", QoSProfile(depth=10)),
        Topic("~/config", "std_msgs/msg/String", EVERY_NODE,
              "latched JSON: parameters, versions, what was loaded", LATCHED_QOS),
        Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", EVERY_NODE,
              "state and counters, 1 Hz", QoSProfile(depth=10), ("trajectory_generator",)),
        Topic("/clock", "rosgraph_msgs/msg/Clock", ("sim_plant",),
              "simulation time, in lockstep", QoSProfile(depth=100)),
    )
}


@dataclass(frozen=True)
class Service:
    """A service or action of some of the nodes."""

    name: str
    type: str
    nodes: tuple[str, ...]
    what: str

    def is_of(self, kind: str) -> bool:
        """Whether nodes of this kind offer it."""
        return not self.nodes or kind in self.nodes


SERVICES = (
    Service("~/arm", "std_srvs/srv/Trigger", ("amplifier_driver",),
            "output on at zero; refuses with the reason"),
    Service("~/disarm", "std_srvs/srv/Trigger", ("amplifier_driver",),
            "output to zero and off"),
    Service("~/clear", "std_srvs/srv/Trigger", ("amplifier_driver",),
            "forget latched faults, at an operator's request"),
    Service("~/home", "std_srvs/srv/Trigger", ("encoder_driver",),
            "here is zero, or the next index mark is"),
    Service("~/change_state", "lifecycle_msgs/srv/ChangeState", DRIVERS,
            "configure, activate, deactivate, cleanup"),
    Service("~/get_state", "lifecycle_msgs/srv/GetState", DRIVERS,
            "and what else belongs to a life cycle"),
    Service("~/start", "std_srvs/srv/Trigger", ("trajectory_generator",),
            "run what the parameters say"),
    Service("~/stop", "std_srvs/srv/Trigger", ("trajectory_generator",),
            "end it and hold still"),
    Service("~/run_experiment", "dfm_interfaces/action/RunExperiment",
            ("trajectory_generator",), "run, with progress"),
    Service("~/stop", "std_srvs/srv/Trigger", ("recorder",), "close the bag"),
    Service("~/ready", "dfm_interfaces/srv/Ready", EVERY_NODE,
            "whether it is connected to these nodes"),
)


def interface(name: str) -> Any:
    """Return the class of a type such as `std_msgs/msg/String`, which is loaded only now."""
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def subscriber_qos(link: Link, node_kind: str, lockstep: bool) -> QoSProfile:
    """Return the quality of service of a loop subscription."""
    if lockstep:
        return LOCKSTEP_QOS
    return PUBLISHER_QOS if node_kind in link.buffered else SUBSCRIBER_QOS
