"""The XY mechanism assembled from double parallelograms, in closed form and as finite elements.

After Awtar (Synthesis and Analysis of Parallel Kinematic XY Flexure Mechanisms, MIT, 2004): two
stages that move in x only (left, right) and two that move in y only (low, high), each guided from
the ground by one block; the motion stage hangs between them on four blocks more, those to left and
right yielding in y, those to low and high in x. Moving in x bends four blocks: those that guide
left and right and those between the motion stage and low and high.

The paper prints neither the arrangement's dimensions nor those of its blocks; they are CHOSEN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from dfm_stage.model.flexure import (
    ALUMINIUM_7075_T6,
    DoubleParallelogram,
    FlexureError,
    Material,
    blade_for,
)
from dfm_stage.model.flexure_fe import GROUND, Frame

# name: (from, to, place of the block over `arm`, direction of its blades in degrees). Blocks whose
# blades run along y yield in x.
_BLOCKS: dict[str, tuple[str, str, tuple[float, float], float]] = {
    "ground_left": (GROUND, "left", (-2.0, 0.0), 90.0),
    "ground_right": (GROUND, "right", (2.0, 0.0), -90.0),
    "low_stage": ("low", "stage", (0.0, -1.0), -90.0),
    "high_stage": ("high", "stage", (0.0, 1.0), 90.0),
    "ground_low": (GROUND, "low", (0.0, -2.0), 0.0),
    "ground_high": (GROUND, "high", (0.0, 2.0), 180.0),
    "left_stage": ("left", "stage", (-1.0, 0.0), 180.0),
    "right_stage": ("right", "stage", (1.0, 0.0), 0.0),
}
X_BLOCKS = ("ground_left", "ground_right", "low_stage", "high_stage")
Y_BLOCKS = ("ground_low", "ground_high", "left_stage", "right_stage")


@dataclass(frozen=True)
class BlockError:
    """What manufacturing did to one block.

    `angle_rad` turns the whole block; `outer_thickness` is the relative thickness error of its
    outer pair of blades against its inner pair.
    """

    angle_rad: float = 0.0
    outer_thickness: float = 0.0


@dataclass(frozen=True)
class XYMechanism:
    """Eight equal blocks; `arm_m` is the distance of the inner blocks from the centre."""

    block: DoubleParallelogram
    arm_m: float = 0.06
    errors: Mapping[str, BlockError] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.errors:
            if name not in _BLOCKS:
                raise FlexureError(f"there is no block {name!r}; known: {', '.join(_BLOCKS)}")

    def stiffness_n_m(self) -> float:
        """Return dF/dx = dF/dy, N/m: four blocks bend in either direction."""
        return 4.0 * self.block.stiffness_n_m()

    def stroke_m(self, safety: float = 1.0) -> float:
        """Return the travel in either direction at the fatigue limit over `safety`, m."""
        return self.block.stroke_m(safety)

    def cross_axis_m(self, deflection_m: float, direction: str = "x") -> float:
        """Return how far the motion stage moves across a deflection in x (or y), m.

        Zero for a perfect mechanism. A block off by an angle e moves e d across, one with unequal
        pairs by its parasitic motion; each of the four blocks that bend pushes the stage across
        through, or against, one block's stiffness, so that the stage goes to their mean.
        """
        if direction not in ("x", "y"):
            raise FlexureError(f"direction must be x or y, not {direction!r}")
        total = 0.0
        for name in X_BLOCKS if direction == "x" else Y_BLOCKS:
            error = self.errors.get(name, BlockError())
            ratio = (1.0 + error.outer_thickness)**3
            # Positive along the block's blades; +90 and 0 degrees point up and right.
            along = self.block.parasitic_m(deflection_m, ratio)
            across = 90.0 if direction == "x" else 0.0
            outward = math.cos(math.radians(_BLOCKS[name][3] - across))
            turned = error.angle_rad * deflection_m * (1.0 if direction == "x" else -1.0)
            total += outward * along + turned
        return 0.25 * total

    def errors_for(self, cross_m: float, deflection_m: float) -> dict[str, float]:
        """Return the manufacturing errors that would each give a cross-axis motion.

        `angle_rad`: all four blocks turned alike; `angle_std_rad`: turned at random, the standard
        deviation whose RMS motion this is; `outer_thickness` and `outer_thickness_std`: likewise
        the relative thickness error of the outer pairs.
        """
        angle = cross_m / deflection_m
        part = cross_m * self.block.blade.length_m / (0.6 * deflection_m**2)
        if not 0.0 <= part < 1.0:
            raise FlexureError(f"no thickness error gives {cross_m:g} m across at a deflection of "
                               f"{deflection_m:g} m")
        thickness = ((1.0 + part) / (1.0 - part))**(1.0 / 3.0) - 1.0
        half = ((1.0 + 2.0 * part) / (1.0 - 2.0 * part))**(1.0 / 3.0) - 1.0 if part < 0.5 else (
            math.inf)
        return {"angle_rad": angle, "angle_std_rad": 2.0 * angle, "outer_thickness": thickness,
                "outer_thickness_std": half}

    def frame(self, elements: int = 48) -> Frame:
        """Return the finite-element model.

        Stages "stage", "left", "right", "low", "high", and "<block>_intermediate" in every block.
        """
        frame, arm = Frame(elements), self.arm_m
        frame.stage("stage", (0.0, 0.0))
        for name, (x, y) in (("left", (-1.5, 0.0)), ("right", (1.5, 0.0)), ("low", (0.0, -1.5)),
                             ("high", (0.0, 1.5))):
            frame.stage(name, (x * arm, y * arm))
        for name, (from_stage, to_stage, place, angle) in _BLOCKS.items():
            error = self.errors.get(name, BlockError())
            add_block(frame, self.block, name, (place[0] * arm, place[1] * arm),
                      math.radians(angle) + error.angle_rad, from_stage, to_stage,
                      error.outer_thickness)
        return frame


def add_block(frame: Frame, block: DoubleParallelogram, name: str, origin: tuple[float, float],
              angle_rad: float, from_stage: str, to_stage: str,
              outer_thickness: float = 0.0) -> None:
    """Add a double parallelogram to a frame, its blades pointing from `origin` along an angle.

    The outer pair hangs on `from_stage`, the inner pair on `to_stage`, and the intermediate stage
    that joins them far out is called "<name>_intermediate".
    """
    c, s = math.cos(angle_rad), math.sin(angle_rad)

    def place(along: float, across: float) -> tuple[float, float]:
        return origin[0] + c * along - s * across, origin[1] + s * along + c * across
    length, middle = block.blade.length_m, f"{name}_intermediate"
    frame.stage(middle, place(length, 0.0))
    outer = block.with_thickness_error(outer_thickness).blade
    for spacing, blade, base in ((block.outer_spacing_m, outer, from_stage),
                                 (block.inner_spacing_m, block.blade, to_stage)):
        for across in (-0.5 * spacing, 0.5 * spacing):
            frame.blade(blade, place(0.0, across), place(length, across), base, middle)


def chosen_xy(load_n: float = 35.0, travel_m: float = 7.5e-3,
              material: Material = ALUMINIUM_7075_T6) -> XYMechanism:
    """Return a mechanism that the paper's 35 N move by its 7.5 mm.

    That is 4.67 N/mm, four blocks of 1.17 N/mm: not blocks of Table 1, which would give 2.6 N/mm.
    """
    blade = blade_for(load_n / travel_m / 4.0, length_m=0.1, width_m=0.02, material=material)
    return XYMechanism(DoubleParallelogram(blade, outer_spacing_m=0.08, inner_spacing_m=0.05))
