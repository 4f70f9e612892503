"""A bare pipeline of five processes: a 1 kHz source, three relays and a sink, in plain rclpy."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
from numpy.typing import NDArray

STAGES = 5


def ages_ms(duration_s: float, priority: int = 0) -> NDArray[np.float64]:
    """Run the pipeline, with SCHED_RR if there is a `priority`; return the ages of the
    messages at the sink, ms."""
    from dfm_stage.harness.domain import claim_domain

    with claim_domain() as domain:
        env = {**os.environ, "ROS_DOMAIN_ID": str(domain.number)}
        processes = [subprocess.Popen(
            [sys.executable, "-m", "benchmarks.pipeline", str(index), str(duration_s),
             str(priority)], env=env, stdout=subprocess.PIPE, text=True)
            for index in range(STAGES)]
        try:
            output = processes[-1].communicate(timeout=duration_s + 60.0)[0]
        finally:
            for process in processes:
                process.kill()
                process.communicate()
    return np.array([float(line) for line in output.split()])


def _stage(index: int, duration_s: float, priority: int) -> None:
    import rclpy
    from rclpy.clock import Clock, ClockType
    from rclpy.experimental import EventsExecutor
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from dfm_interfaces.msg import Measurement
    from dfm_stage.middleware.scheduling import RealTime

    rclpy.init()
    node = rclpy.create_node(f"stage_{index}")
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    ages: list[float] = []
    publisher = node.create_publisher(Measurement, f"link_{index}", qos)

    def source() -> None:
        message = Measurement()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        publisher.publish(message)

    def relay(message: Measurement) -> None:
        if index < STAGES - 1:
            publisher.publish(message)
        else:
            stamp = message.header.stamp
            ages.append((time.time_ns() - stamp.sec * 10**9 - stamp.nanosec) * 1e-6)

    if index == 0:
        node.create_timer(1e-3, source, clock=Clock(clock_type=ClockType.STEADY_TIME))
    else:
        node.create_subscription(Measurement, f"link_{index - 1}", relay, qos)
    executor = EventsExecutor()
    executor.add_node(node)
    RealTime().take(priority, time.monotonic())
    wanted = int(duration_s * 1000)
    deadline = time.monotonic() + duration_s + 30.0
    while time.monotonic() < deadline and (index < STAGES - 1 or len(ages) < wanted):
        executor.spin_once(timeout_sec=0.1)
    print("\n".join(f"{age:.4f}" for age in ages[wanted // 10:]))
    os._exit(0) if index < STAGES - 1 else sys.stdout.flush()


if __name__ == "__main__":
    _stage(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
