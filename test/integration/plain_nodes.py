"""Two plain ROS 2 nodes that know nothing of this project: a joint with a spring, and its driver.

Started as `python plain_nodes.py SECONDS`; the joint's state is integrated to the very time of
each message, so its stamps are true however late the machine is.
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


class Joint(Node):
    """x'' + 2 d w x' + w^2 x = w^2 g u, with the last command u until the next comes."""

    def __init__(self) -> None:
        super().__init__("joint")
        self.x = self.v = self.u = 0.0
        self.now = self.get_clock().now().nanoseconds
        self.out = self.create_publisher(JointState, "/joint_states", 50)
        self.create_subscription(Float64, "/arm/command", self.command, 50)
        self.create_timer(0.01, self.tell)

    def forward(self) -> int:
        """Move to the present, exactly; return it in ns."""
        now = self.get_clock().now().nanoseconds
        t, self.now = (now - self.now) * 1e-9, now
        w, d = 2.0 * math.pi * FREQUENCY_HZ, DAMPING_RATIO
        damped, rest = w * math.sqrt(1.0 - d * d), GAIN * self.u
        x, fade = self.x - rest, math.exp(-d * w * t)
        c, s = fade * math.cos(damped * t), fade * math.sin(damped * t) / damped
        self.x, self.v = (rest + x * c + (self.v + d * w * x) * s,
                          self.v * c - (w * w * x + d * w * self.v) * s)
        return now

    def command(self, message: Float64) -> None:
        self.forward()
        self.u = message.data

    def tell(self) -> None:
        now = self.forward()
        message = JointState(name=["other", "arm"], position=[0.1, self.x],
                             velocity=[0.0, self.v], effort=[0.0, self.u])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        self.out.publish(message)


class Driver(Node):
    """A random sequence of two commands, without header."""

    def __init__(self) -> None:
        super().__init__("driver")
        self.random, self.count, self.value = random.Random(3), 0, 1.0
        self.out = self.create_publisher(Float64, "/arm/command", 50)
        self.create_timer(0.02, self.tell)

    def tell(self) -> None:
        self.count += 1
        if self.count % 3 == 0:
            self.value = self.random.choice((-1.0, 1.0))
        self.out.publish(Float64(data=self.value))


def main() -> None:
    rclpy.init()
    joint = Joint()
    executor = SingleThreadedExecutor()
    executor.add_node(joint)
    executor.add_node(Driver())
    begun = joint.get_clock().now().nanoseconds
    while joint.get_clock().now().nanoseconds - begun < 1e9 * float(sys.argv[1]):
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    main()
