"""The XY mechanism: closed form against finite elements, and what the paper's 25 um would take."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dfm_stage.model.flexure import FlexureError
from dfm_stage.model.flexure_xy import X_BLOCKS, Y_BLOCKS, BlockError, XYMechanism, chosen_xy

pytest.importorskip("pyfe3d")
XY = chosen_xy()


def deflected(mechanism: XYMechanism, force: float, direction: str = "x",
              elements: int = 32) -> tuple[float, float, float]:
    """(along, across, rotation) of the motion stage with the force on the guided stage."""
    load = {"left": (force, 0.0, 0.0)} if direction == "x" else {"low": (0.0, force, 0.0)}
    x, y, turn = mechanism.frame(elements).deflect(load, steps=3)["stage"]
    return (x, y, turn) if direction == "x" else (y, x, turn)


@cache
def perfect_across(direction: str) -> float:
    return deflected(XY, 30.0, direction, elements=32)[1]


def test_the_papers_load_moves_it_the_papers_travel() -> None:
    assert 35.0 / XY.stiffness_n_m() == pytest.approx(7.5e-3)
    assert XY.block.fatigue_safety(7.5e-3) > 2.0


@pytest.mark.parametrize("direction", ["x", "y"])
def test_stiffness_for_small_deflections(direction: str) -> None:
    along, across, _ = deflected(XY, 0.5, direction)
    assert 0.5 / along == pytest.approx(XY.stiffness_n_m(), rel=0.01)
    assert abs(across) < 1e-4 * along


def test_stiffness_and_cross_axis_motion_over_the_travel() -> None:
    along, across, rotation = deflected(XY, 35.0, elements=96)
    assert 35.0 / along == pytest.approx(XY.stiffness_n_m(), rel=0.03)
    assert abs(across) < 0.5e-6                       # 7.5 mm along
    assert abs(rotation) < 1e-6


def test_moving_in_one_direction_does_not_stiffen_the_other() -> None:
    frame = XY.frame(48)
    alone = frame.deflect({"low": (0.0, 20.0, 0.0)})["stage"][1]
    both = frame.deflect({"low": (0.0, 20.0, 0.0), "left": (20.0, 0.0, 0.0)})["stage"][1]
    assert both == pytest.approx(alone, rel=0.01)


@pytest.mark.parametrize(("direction", "name"), [("x", name) for name in X_BLOCKS]
                         + [("y", name) for name in Y_BLOCKS])
@pytest.mark.parametrize("error", [BlockError(angle_rad=5e-3), BlockError(outer_thickness=0.05)])
def test_cross_axis_motion_by_manufacturing(direction: str, name: str, error: BlockError) -> None:
    wrong = replace(XY, errors={name: error})
    perfect = perfect_across(direction)
    along, across, _ = deflected(wrong, 30.0, direction, elements=32)
    assert across - perfect == pytest.approx(wrong.cross_axis_m(along, direction), rel=0.05)


def test_what_the_papers_25_micrometres_take() -> None:
    found = XY.errors_for(25e-6, 7.5e-3)
    assert found["angle_rad"] == pytest.approx(1.0 / 300.0)
    alike = replace(XY, errors={name: BlockError(angle_rad=found["angle_rad"])
                                for name in X_BLOCKS})
    assert alike.cross_axis_m(7.5e-3) == pytest.approx(25e-6)
    side = {name: 1.0 if name in ("ground_left", "high_stage") else -1.0 for name in X_BLOCKS}
    part = found["outer_thickness"]
    thick = replace(XY, errors={
        name: BlockError(outer_thickness=part if side[name] > 0 else 1 / (1 + part) - 1)
        for name in X_BLOCKS})
    assert thick.cross_axis_m(7.5e-3) == pytest.approx(25e-6)
    rng = np.random.default_rng(0)
    draws = [replace(XY, errors={name: BlockError(angle_rad=float(rng.normal(
        0.0, found["angle_std_rad"]))) for name in X_BLOCKS}).cross_axis_m(7.5e-3)
        for _ in range(2000)]
    assert math.sqrt(np.mean(np.square(draws))) == pytest.approx(25e-6, rel=0.06)


def test_first_modes_are_the_two_translations() -> None:
    masses = dict.fromkeys(("left", "right", "low", "high"), (0.3, 1e-3))
    masses["stage"] = (1.0, 2e-3)
    masses.update({f"{name}_intermediate": (0.1, 1e-4) for name in (*X_BLOCKS, *Y_BLOCKS)})
    found = XY.frame(12).frequencies_hz(masses, 3)
    blade = XY.block.blade
    # In x: stage, left and right; the intermediate stages of the blocks that bend move half as
    # far, those of left_stage and right_stage all the way. A blade that bends from rest to half
    # the motion, or from half to all of it, counts with 0.343 of its mass in the mean.
    blades = (16 * 0.343 + 8) * blade.mass_per_length * blade.length_m
    moving = 1.0 + 2 * 0.3 + 4 * (0.1 / 4) + 2 * 0.1 + blades
    assert found[:2] == pytest.approx(math.sqrt(XY.stiffness_n_m() / moving) / (2 * math.pi),
                                      rel=0.005)
    assert found[2] > 1.5 * found[1]


def test_unknown_blocks_and_directions_are_refused() -> None:
    with pytest.raises(FlexureError, match="no block 'middle'"):
        replace(XY, errors={"middle": BlockError()})
    with pytest.raises(FlexureError, match="direction must be x or y"):
        XY.cross_axis_m(1e-3, "z")
    with pytest.raises(FlexureError, match="no thickness error"):
        XY.errors_for(1e-3, 1e-3)
