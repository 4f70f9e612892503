"""Lines out of fragments, device time to host time, counts without wrap, shaped steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dfm_stage.drivers.clock_map import ClockMap, Unwrap
from dfm_stage.drivers.errors import ProtocolError
from dfm_stage.drivers.threads import SigmaDelta
from dfm_stage.drivers.transport import LONGEST_LINE, LineBuffer


@given(st.binary(max_size=400), st.lists(st.integers(0, 400), max_size=8))
def test_fragments_do_not_matter(data, cuts):
    whole = [line.text for line in LineBuffer().feed(data + b"\n")]
    buffer, parts, begin = LineBuffer(), [], 0
    for cut in [*sorted(cut for cut in cuts if cut <= len(data)), len(data)]:
        parts += buffer.feed(data[begin:cut])
        begin = cut
    parts += buffer.feed(b"\n")
    assert [line.text for line in parts] == whole
    expected = [each for each in data.replace(b"\r", b"\n").split(b"\n")
                if each and len(each) <= LONGEST_LINE]
    assert whole == expected


def test_what_came_after_a_line_is_known():
    first, second = LineBuffer().feed(b"one\rtwo\rthr")
    assert (first.text, first.after) == (b"one", 7)
    assert (second.text, second.after) == (b"two", 3)


def test_noise_without_end_is_thrown_away():
    buffer = LineBuffer()
    assert buffer.feed(b"x" * 10000) == []
    assert [line.text for line in buffer.feed(b"\rok\r")] == [b"ok"]


@given(st.lists(st.integers(-2**31 + 1, 2**31 - 1), min_size=1, max_size=30),
       st.integers(-2**31, 2**31 - 1))
def test_a_count_goes_on_past_its_wrap(steps, start):
    unwrap, total = Unwrap(), start
    assert unwrap(start & 0xFFFFFFFF) == start
    for step in steps:
        total += step
        assert unwrap(total & 0xFFFFFFFF) == total


def test_after_a_restart_counts_begin_anew():
    unwrap = Unwrap(500)
    assert [unwrap(raw) for raw in (249, 251, 499, 1)] == [249, 251, 499, 501]
    unwrap.restart()
    assert unwrap(3) == 3


@pytest.mark.parametrize("drift", [0.0, 1e-4, -1e-4])
def test_device_time_is_found_within_its_jitter(drift):
    """Arrivals are late by 0.2 ms at least and exponentially more; the truth is known."""
    rng = np.random.default_rng(3)
    ticks = np.arange(512 * 40)
    true_ns = (1e18 + ticks / 512 * (1.0 + drift) * 1e9).astype(np.int64)
    arrival = true_ns + (200_000 + rng.exponential(3e5, ticks.size)).astype(np.int64)
    clock = ClockMap(1.0 / 512, fixed_delay_s=200e-6)
    out = np.array([clock(int(tick), int(when)) for tick, when in zip(ticks, arrival,
                                                                     strict=True)])
    assert np.all(out <= arrival)
    late = (out - true_ns)[512 * 12:] * 1e-9
    assert np.max(np.abs(late)) < 100e-6
    assert np.std(np.diff(out[512 * 12:])) < 2e4
    second = (clock.at(int(arrival[-1])) - clock.at(int(arrival[-1]) - 10**9)) / 512
    assert 1.0 / second - 1.0 == pytest.approx(drift, abs=2e-5)
    middle = 512 * 39
    assert clock.at(int(true_ns[middle])) == pytest.approx(middle, abs=0.06)


def test_a_clock_that_goes_back_is_a_restart():
    clock = ClockMap(1.0 / 512)
    clock(100, 10**9)
    with pytest.raises(ProtocolError, match="restarted"):
        clock(3, 10**9 + 1)
    clock.restart()
    assert clock(3, 2 * 10**9) == 2 * 10**9


@given(st.floats(-2.0, 2.0))
def test_the_mean_of_shaped_steps_is_the_value(value):
    shape = SigmaDelta(0.01)
    sent = np.array([shape(value) for _ in range(200)]) * 0.01
    assert np.mean(sent) == pytest.approx(value, abs=0.01 / 200 + 1e-12)
    assert np.max(np.abs(sent - value)) <= 0.01 + 1e-12


def test_unshaped_is_rounding_and_reset_forgets():
    plain = SigmaDelta(0.01, shaped=False)
    assert [plain(0.004) for _ in range(5)] == [0] * 5
    shape = SigmaDelta(0.01)
    shape(0.004)
    shape.reset()
    assert [shape(0.004) for _ in range(2)] == [0, 1]
