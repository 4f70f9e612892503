"""Two plain ROS 2 nodes that know nothing of this project: joints with a spring, and a driver.

Started as `python plain_nodes.py SECONDS`. The states are integrated to the very time of each
message, so its stamps are true however late the machine is. The arm has a servo of its own, whose
effort acts from a message on; the elbow does what the driver's commands say as they come.
"""

from __future__ import annotations

import math
import random
import sys

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

FREQUENCY_HZ, DAMPING_RATIO, GAIN = 3.0, 0.05, 0.02


class Mechanism:
    """x'' + 2 d w x' + w^2 x = w^2 g u, u constant in between."""

    def __init__(self) -> None:
        self.x = self.v = self.u = 0.0

    def forward(self, t: float) -> None:
        """Move on by t s, exactly."""
        w, d = 2.0 * math.pi * FREQUENCY_HZ, DAMPING_RATIO
        damped, rest = w * math.sqrt(1.0 - d * d), GAIN * self.u
        x, fade = self.x - rest, math.exp(-d * w * t)
        c, s = fade * math.cos(damped * t), fade * math.sin(damped * t) / damped
        self.x, self.v = (rest + x * c + (self.v + d * w * x) * s,
                          self.v * c - (w * w * x + d * w * self.v) * s)


class Joints(Node):
    """Tells the states at 100 Hz."""

    def __init__(self) -> None:
        super().__init__("joints")
        self.arm, self.elbow, self.random, self.count = Mechanism(), Mechanism(), \
            random.Random(5), 0
        self.now = self.get_clock().now().nanoseconds
        self.out = self.create_publisher(JointState, "/joint_states", 50)
        self.create_subscription(Float64, "/elbow/command", self.command, 50)
        self.create_timer(0.01, self.tell)

    def forward(self) -> int:
        """Move to the present; return it in ns."""
        now = self.get_clock().now().nanoseconds
        for each in (self.arm, self.elbow):
            each.forward((now - self.now) * 1e-9)
        self.now = now
        return now

    def command(self, message: Float64) -> None:
        self.forward()
        self.elbow.u = message.data

    def tell(self) -> None:
        now = self.forward()
        self.count += 1
        if self.count % 6 == 0:
            self.arm.u = self.random.choice((-1.0, 1.0))
        message = JointState(name=["elbow", "arm"], position=[self.elbow.x, self.arm.x],
                             velocity=[self.elbow.v, self.arm.v], effort=[0.0, self.arm.u])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        self.out.publish(message)


class Driver(Node):
    """A random sequence of two commands, without header."""

    def __init__(self) -> None:
        super().__init__("driver")
        self.random, self.count, self.value = random.Random(3), 0, 1.0
        self.out = self.create_publisher(Float64, "/elbow/command", 50)
        self.create_timer(0.02, self.tell)

    def tell(self) -> None:
        self.count += 1
        if self.count % 3 == 0:
            self.value = self.random.choice((-1.0, 1.0))
        self.out.publish(Float64(data=self.value))


def main() -> None:
    rclpy.init()
    joints = Joints()
    executor = SingleThreadedExecutor()
    executor.add_node(joints)
    executor.add_node(Driver())
    begun = joints.get_clock().now().nanoseconds
    while joints.get_clock().now().nanoseconds - begun < 1e9 * float(sys.argv[1]):
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    main()
