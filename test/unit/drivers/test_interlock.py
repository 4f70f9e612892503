"""Every cause takes the output to zero, latches, and needs clear before arm."""

from __future__ import annotations

import ast
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from dfm_stage.control import Pid, PidGains
from dfm_stage.drivers.errors import RefusedError
from dfm_stage.drivers.interlock import SWINGS, Cause, Interlock

MESSAGE = Path(__file__).parents[3] / "dfm_interfaces/msg/AmplifierState.msg"


def command(voltage=1.0, seq=1, saturated=False, measured_ns=0):
    return SimpleNamespace(voltage=voltage, seq=seq, saturated=saturated,
                           measurement_stamp_ns=measured_ns)


def armed(**options):
    interlock = Interlock(10.0, **options)
    interlock.arm()
    return interlock


def assert_latched(interlock, cause):
    assert interlock.causes == cause
    assert not interlock.armed
    assert interlock.accept(command(seq=1000), 0.0, 0) == 0.0
    with pytest.raises(RefusedError, match="clear first"):
        interlock.arm()
    assert interlock.words().startswith(str(cause.name).lower().replace("_", " "))
    interlock.clear()
    assert interlock.accept(command(seq=1001), 0.0, 0) == 0.0, "cleared is not armed"
    interlock.arm()
    assert interlock.accept(command(seq=1), 0.0, 0) == 1.0


def test_the_bits_are_those_of_the_message():
    constants = {}
    for line in MESSAGE.read_text().splitlines():
        if " FAULT_" in line and "=" in line:
            name, _, value = line.partition("#")[0].removeprefix("uint32 FAULT_").partition("=")
            constants[name.strip()] = ast.literal_eval(value.strip())
    assert constants == {cause.name: cause.value for cause in Cause}


def test_disarmed_nothing_goes_out_and_armed_everything_in_range():
    interlock = Interlock(10.0)
    assert interlock.accept(command(), 0.0, 0) == 0.0
    interlock.arm()
    assert [interlock.accept(command(value, seq), 0.0, 0)
            for seq, value in enumerate((-10.0, 0.0, 10.0))] == [-10.0, 0.0, 10.0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number(value):
    interlock = armed()
    assert interlock.accept(command(value), 0.0, 0) == 0.0
    assert_latched(interlock, Cause.NOT_FINITE)


@pytest.mark.parametrize("value", [10.1, -1e300])
def test_a_command_out_of_range(value):
    interlock = armed()
    assert interlock.accept(command(value), 0.0, 0) == 0.0
    assert_latched(interlock, Cause.OUT_OF_RANGE)


def test_commands_that_stop_but_not_before_the_first():
    interlock = armed(stale_s=0.02)
    assert not interlock.stale(1e9)
    assert interlock.time_left(1e9) == math.inf
    interlock.accept(command(), 5.0, 0)
    assert not interlock.stale(5.0199)
    assert interlock.time_left(5.015) == pytest.approx(0.005)
    assert interlock.stale(5.0201)
    assert not interlock.stale(6.0), "once is enough"
    assert_latched(interlock, Cause.STALE_COMMAND)


def test_in_lockstep_commands_are_never_stale():
    interlock = armed(stale_s=0.0)
    interlock.accept(command(), 5.0, 0)
    assert not interlock.stale(1e9)


@pytest.mark.parametrize("numbers", [(5, 5), (5, 4), (5, 6, 3), (9, 2**31 + 9)])
def test_two_publishers_are_told_by_their_numbers(numbers):
    interlock = armed()
    out = [interlock.accept(command(seq=number), 0.0, 0) for number in numbers]
    assert out == [1.0] * (len(numbers) - 1) + [0.0]
    assert_latched(interlock, Cause.OTHER_PUBLISHER)


@pytest.mark.parametrize("numbers", [(1, 2, 3), (1, 5, 100), (2**32 - 1, 0, 1), (0, 0, 0)])
def test_lost_commands_a_wrap_and_commands_without_number_are_no_second_publisher(numbers):
    interlock = armed()
    assert [interlock.accept(command(seq=number), 0.0, 0) for number in numbers] == [1.0] * 3


def test_a_command_for_an_old_measurement():
    interlock = armed(measurement_age_s=0.02)
    assert interlock.accept(command(seq=1, measured_ns=10**9), 0.0, 10**9 + 19_000_000) == 1.0
    assert interlock.accept(command(seq=2, measured_ns=10**9), 0.0, 10**9 + 21_000_000) == 0.0
    interlock.clear()
    interlock.arm()
    assert interlock.accept(command(), 0.0, 10**9) == 0.0
    assert interlock.causes == Cause.ENCODER


def test_a_measurement_from_before_the_clock_was_set_back_may_be_of_any_age():
    interlock = armed(measurement_age_s=0.02)
    assert interlock.accept(command(seq=1, measured_ns=10**9), 0.0, 10**9 - 19_000_000) == 1.0
    assert interlock.accept(command(seq=2, measured_ns=10**9), 0.0, 10**9 - 60_000_000) == 0.0
    assert interlock.words() == ("encoder: a command answers a measurement stamped 60.0 ms ahead "
                                 "of the clock: was it set back?")


def test_commands_for_old_measurements_are_zero_and_latch_where_they_last():
    interlock = armed(measurement_age_s=0.02, age_lasts_s=0.02)

    def asked(seq, now_ms, age_ms):
        return interlock.accept(command(1.0, seq, measured_ns=(now_ms - age_ms) * 10**6),
                                now_ms * 1e-3, now_ms * 10**6)

    assert [asked(1, 100, 30), asked(2, 110, 25), asked(3, 112, 20)] == [0.0, 0.0, 1.0]
    assert [asked(4, 113, 21), asked(5, 131, 21)] == [0.0, 0.0]
    assert interlock.armed
    assert not interlock.stale(0.140), "an old command is not none"
    assert asked(6, 132, 132) == 1.0, "a command by hand has no stamp"
    assert asked(7, 133, 25) == 0.0
    assert (interlock.too_old, interlock.causes) == (5, Cause.ENCODER)
    assert interlock.words() == "encoder: a command answers a measurement 25.0 ms old"


@pytest.mark.parametrize(("age_s", "leaves"), [(0.0, True), (0.02, False)])
def test_a_loop_that_falls_behind_does_not_drive_the_stage_out_of_its_travel(age_s, leaves):
    """As measured in a fault campaign: the commands came, the measurements they answered aged."""
    period_s, travel_m = 1e-3, 7.7e-3
    step, into, *_ = scipy.signal.cont2discrete(
        (np.array([[0.0, 1.0], [-600.7, -1.705]]), np.array([[0.0], [1.0]]), np.eye(2),
         np.zeros((2, 1))), period_s)
    law = Pid(PidGains(kp=600.0, ki=4000.0, kd=30.0, output_limit_v=2.0), period_s)
    interlock = armed(measurement_age_s=age_s, age_lasts_s=0.02 if age_s else 0.0)
    state, furthest, seen = np.array([1e-3, 0.0]), 0.0, []
    for now in range(600):
        seen.append(state[0])
        measured = max(0, now - min(now // 2, 60))
        answer = law.step(0.5e-3, seen[measured], 0.0, 0.0, period_s)
        voltage = interlock.accept(command(answer, now + 1, measured_ns=measured * 10**6),
                                   now * period_s, now * 10**6)
        state = step @ state + into[:, 0] * voltage
        furthest = max(furthest, abs(state[0]))
    assert (furthest > travel_m) == leaves


def swings(interlock, count, period_ns):
    return [interlock.accept(command(10.0 * (-1) ** index, index + 1, True), 0.0,
                             index * period_ns) for index in range(count)]


def test_a_loop_that_swings_from_limit_to_limit():
    interlock = armed(divergence_window_s=0.5)
    assert swings(interlock, SWINGS + 1, 50_000_000)[-1] == 0.0
    assert_latched(interlock, Cause.DIVERGING)


def test_slow_swings_and_long_saturation_are_none():
    slow = armed(divergence_window_s=0.5)
    assert 0.0 not in swings(slow, 50, 200_000_000)
    long = armed()
    assert all(long.accept(command(10.0, seq, True), 0.0, seq) for seq in range(1, 100))
    never = armed(divergence_window_s=0.0)
    assert 0.0 not in swings(never, 50, 1)


def test_who_trips_is_told_once_and_only_while_armed():
    heard = []
    interlock = Interlock(1.0, on_trip=lambda cause, why: heard.append((cause, why)))
    interlock.trip(Cause.DRIVE, "short")
    assert not interlock.causes
    interlock.arm()
    interlock.trip(Cause.DRIVE, "short")
    interlock.trip(Cause.CURRENT, "2 A")
    assert heard == [(Cause.DRIVE, "short")]
    assert interlock.clear() == "drive: short"


@given(st.lists(st.tuples(st.floats(allow_nan=True, allow_infinity=True),
                          st.integers(0, 2**32 - 1), st.booleans(), st.integers(-2**62, 2**62)),
                max_size=40))
def test_no_sequence_of_commands_gets_past_the_limit(commands):
    interlock = armed(measurement_age_s=0.02)
    for value, seq, saturated, stamp in commands:
        was_armed = interlock.armed
        out = interlock.accept(command(value, seq, saturated, stamp), 0.0, stamp)
        assert math.isfinite(out)
        assert abs(out) <= 10.0
        assert out == 0.0 or (was_armed and interlock.armed)
