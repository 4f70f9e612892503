"""More than one machine, by network namespaces: all is recorded, and a cut link is safe."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.machines import HOSTS, STALE_S, TOPICS, missing, run, zero_after_s

pytestmark = pytest.mark.usefixtures("hosts_permitted")


@pytest.mark.slow
@pytest.mark.real_time
def test_three_hosts_scan_are_recorded_and_go_safe_when_the_link_dies(tmp_path):
    assert HOSTS == ("plant", "control", "store")
    seen = run(tmp_path, 1.0)
    for phase in seen.phases:
        for topic in TOPICS:
            assert missing(seen, topic, phase.start_ns, phase.end_ns) == 0, (phase.name, topic)
    amplifier = seen.near["/stage/x/amplifier"]
    assert amplifier["enabled"][amplifier["header.stamp"] < seen.cut_ns].any()
    assert zero_after_s(seen) < 2.0, f"the stale time-out is {STALE_S} s"
    after = seen.near["/stage/x/plant"]["header.stamp"] > seen.cut_ns
    assert np.max(np.abs(seen.near["/stage/x/plant"]["position"][after])) < 7.7e-3
