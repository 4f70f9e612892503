"""Closed forms against finite elements: 1 % for small deflections, 3 % over the whole travel."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dfm_stage.model.beam import manipulator_chain, stage_mass_for
from dfm_stage.model.flexure import FlexureError, Parallelogram, chosen_manipulator

pytest.importorskip("pyfe3d")

from dfm_stage.model.flexure_fe import GROUND, Frame, manipulator_frame, parallelogram_frame

DFM = chosen_manipulator()
SINGLE = Parallelogram(DFM.blade, 0.08)


@pytest.mark.parametrize(("force", "tolerance"), [(0.02, 0.002), (2.5, 0.01), (5.0, 0.03)])
def test_stiffness_over_the_travel(force: float, tolerance: float) -> None:
    deflection = manipulator_frame(DFM).deflect({"stage": (0.0, force, 0.0)})["stage"][1]
    assert force / deflection == pytest.approx(DFM.stiffness_n_m(), rel=tolerance)


def test_rotation_and_parasitic_motion_of_the_double_parallelogram() -> None:
    x, y, rotation = manipulator_frame(DFM).deflect({"stage": (0.0, 5.0, 0.0)})["stage"]
    assert y > 7.6e-3
    assert rotation == pytest.approx(DFM.rotation_rad(y), rel=0.01)
    assert abs(x) < 0.002 * abs(SINGLE.parasitic_m(y))


def test_parasitic_motion_and_rotation_of_the_single_parallelogram() -> None:
    force = SINGLE.stiffness_n_m() * 4e-3
    x, y, rotation = parallelogram_frame(SINGLE).deflect({"stage": (0.0, force, 0.0)})["stage"]
    assert x == pytest.approx(SINGLE.parasitic_m(y), rel=0.01)
    assert rotation == pytest.approx(SINGLE.rotation_rad(y), rel=0.01)


@pytest.mark.parametrize("axial", [-20.0, 20.0])
def test_softening_by_an_axial_load(axial: float) -> None:
    frame = manipulator_frame(DFM)
    y = frame.deflect({"stage": (axial, 0.2, 0.0)})["stage"][1]
    assert 0.2 / y == pytest.approx(DFM.stiffness_n_m(axial), rel=0.002)
    assert DFM.stiffness_n_m(axial) < 0.97 * DFM.stiffness_n_m()


@pytest.mark.parametrize("force", [0.0, 5.0])
def test_axial_stiffness(force: float) -> None:
    frame = manipulator_frame(DFM)
    out, back = (frame.deflect({"stage": (x, force, 0.0)})["stage"] for x in (1.0, -1.0))
    assert 2.0 / (out[0] - back[0]) == pytest.approx(DFM.axial_stiffness_n_m(out[1]), rel=0.03)


def test_first_modes_are_those_of_the_beam_equation() -> None:
    stage_kg = stage_mass_for(DFM, 24.51, 0.15)
    found = manipulator_frame(DFM, 24).frequencies_hz(
        {"stage": (stage_kg, 1e-3), "intermediate": (0.15, 2e-4)}, 2)
    expected = [mode.frequency_hz for mode in manipulator_chain(DFM, stage_kg, 0.15).modes(2)]
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_thickness_error_between_the_pairs_gives_the_parasitic_motion_it_should() -> None:
    frame = manipulator_frame(DFM, thickness_errors=(0.03, 0.03, 0.0, 0.0))
    stages = frame.deflect({"stage": (0.0, 5.0, 0.0)})
    x, y, _ = stages["stage"]
    assert x == pytest.approx(DFM.parasitic_m(y, outer_over_inner=1.03**3), rel=0.03)


def test_a_frame_may_stand_at_any_angle() -> None:
    turn, length = math.radians(30.0), DFM.blade.length_m
    rotate = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])

    def at(x: float, y: float) -> tuple[float, float]:
        u, v = rotate @ (x, y)
        return float(u), float(v)
    frame = Frame(24)
    frame.stage("stage", at(length, 0.0))
    for y in (-0.04, 0.04):
        frame.blade(DFM.blade, at(0.0, y), at(length, y), GROUND, "stage")
    straight = parallelogram_frame(SINGLE, 24).deflect({"stage": (1.0, 2.0, 0.01)})["stage"]
    turned = frame.deflect({"stage": (*(rotate @ (1.0, 2.0)), 0.01)})["stage"]
    assert rotate.T @ turned[:2] == pytest.approx(straight[:2], rel=1e-6)
    assert turned[2] == pytest.approx(straight[2], rel=1e-6)


def test_unknown_stages_and_missing_equilibria_are_named() -> None:
    frame = manipulator_frame(DFM, 8)
    with pytest.raises(FlexureError, match="no stage 'table'"):
        frame.deflect({"table": (0.0, 1.0, 0.0)})
    with pytest.raises(FlexureError, match="no stage 'table'"):
        frame.blade(DFM.blade, (0.0, 0.0), (0.1, 0.0), GROUND, "table")
    with pytest.raises(FlexureError, match="no equilibrium"):
        frame.deflect({"stage": (0.0, 1e9, 0.0)}, steps=1)
