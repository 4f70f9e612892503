"""Parameters: described with unit and range, refused with the reason at start and at run time."""

from __future__ import annotations

import math

import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter

from dfm_stage.errors import DfmError
from dfm_stage.nodes.amplifier_driver import AmplifierDriver
from dfm_stage.nodes.controller import Controller
from dfm_stage.nodes.encoder_driver import EncoderDriver
from dfm_stage.nodes.recorder import Recorder
from dfm_stage.nodes.sim_plant import SimPlant
from dfm_stage.nodes.trajectory_generator import TrajectoryGenerator

NODES = (AmplifierDriver, Controller, EncoderDriver, Recorder, SimPlant, TrajectoryGenerator)


@pytest.mark.parametrize("kind", NODES, ids=lambda kind: kind.kind)
def test_every_parameter_is_described(make, kind):
    node = make(kind)
    for name in node.settings.values:
        descriptor = node.describe_parameter(name)
        assert len(descriptor.description) > 10, name
        if descriptor.type == ParameterType.PARAMETER_DOUBLE:
            assert descriptor.floating_point_range, name
        if name.endswith("_s") and not name.endswith("_v_s"):
            assert descriptor.description.endswith("s]"), name
        if name.endswith("_v"):
            assert "[V]" in descriptor.description, name


@pytest.mark.parametrize(("kind", "parameters", "words"), [
    (Controller, {"kp": "1"}, ["kp", "real number", "1.0"]),
    (Controller, {"ki": "-5.0"}, ["ki", "-5", "V/(m s)"]),
    (Controller, {"output_limit_v": ".nan"}, ["output_limit_v"]),
    (Controller, {"mode": "magic"}, ["mode", "open_loop", "pid"]),
    (EncoderDriver, {"zero_counts": "1.5"}, ["zero_counts", "whole number"]),
    (AmplifierDriver, {"device": "none"}, ["device", "sim"]),
    (SimPlant, {"model": "no_such_model"}, ["no_such_model"]),
    (SimPlant, {"model": "xy_stage", "axes": "z"}, ["z", "x y"]),
    (TrajectoryGenerator, {"experiment": "no_such"}, ["no_such", "multisine"]),
    (TrajectoryGenerator, {"reference__kind": "raster", "reference__line_time_s": "0.0004"},
     ["line_time_s"]),
    (TrajectoryGenerator, {"reference__kind": "sine", "reference__dwell_s": "1.0"}, ["dwell_s"]),
    (Recorder, {"topics": "'('"}, ["topics", "regular expression"]),
    (Recorder, {"bag": "/proc/no/bag"}, ["/proc/no"]),
])
def test_a_bad_value_at_start_is_refused_with_the_reason(make, kind, parameters, words):
    with pytest.raises(DfmError) as error:
        make(kind, **parameters)
    message = str(error.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(("values", "words"), [
    ({"kp": math.nan}, ["kp"]),
    ({"kp": math.inf}, ["kp"]),
    ({"ki": -1.0}, ["ki"]),
    ({"mode": "magic"}, ["mode", "pid"]),
    ({"lockstep": True}, ["read-only"]),
    ({"kp": 10.0, "anti_windup": "hope"}, ["anti_windup"]),
])
def test_a_bad_value_at_run_time_is_refused_and_changes_nothing(make, values, words):
    node = make(Controller, kp=123.0)
    before = dict(node.settings.values)
    result = node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in values.items()])
    assert not result.successful
    for word in words:
        assert word in result.reason
    assert node.settings.values == before


def test_gains_change_at_run_time(make):
    node = make(Controller)
    assert node.set_parameters_atomically([Parameter("kp", value=42.0)]).successful
    assert node._laws.by_name["pid"].gains.kp == 42.0


def test_a_signal_that_cannot_be_made_is_refused_at_run_time(make):
    node = make(TrajectoryGenerator)
    result = node.set_parameters_atomically([
        Parameter("reference.kind", value="raster"),
        Parameter("reference.line_time_s", value=1.23456e-4)])
    assert not result.successful
    assert "line_time_s" in result.reason
    assert node.settings["reference.kind"] == "hold"
