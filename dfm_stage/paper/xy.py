"""Sec. 6: the XY mechanism, loaded to 35 N, against closed form and finite elements."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.static import StaticTest, static_test
from dfm_stage.model import Model
from dfm_stage.model.flexure import FlexureError
from dfm_stage.model.flexure_xy import XYMechanism, chosen_xy
from dfm_stage.paper.row import PRINTED, STANDARD_GRAVITY, Row, derived, ours_only, printed
from dfm_stage.recording import Record

PLACE = "sec. 6"


@dataclass(frozen=True)
class ElementCurve:
    """Finite elements: force (F,) N, motion along and across (F,) m."""

    force_n: Array
    along_m: Array
    across_m: Array


def element_curve(mechanism: XYMechanism, direction: str, elements: int = 48,
                  count: int = 5) -> ElementCurve | None:
    """Return deflections up to the paper's load; None where the library is missing."""
    force = np.linspace(0.0, PRINTED["xy.load"].value, count + 1)
    frame = mechanism.frame(elements)
    along, across = [0.0], [0.0]
    try:
        for f in force[1:]:
            load = {"left": (f, 0.0, 0.0)} if direction == "x" else {"low": (0.0, f, 0.0)}
            x, y, _ = frame.deflect(load, steps=3)["stage"]
            along.append(float(x if direction == "x" else y))
            across.append(float(y if direction == "x" else x))
    except FlexureError:
        return None
    return ElementCurve(force, np.array(along), np.array(across))


@dataclass(frozen=True)
class XYTest:
    """Static tests in both directions, the motion across, elements, the chosen mechanism."""

    mechanism: XYMechanism
    tests: dict[str, StaticTest]
    across_m: dict[str, float]
    elements: dict[str, ElementCurve | None]
    resolution_m: float
    coupled: bool


def xy_test(model: Model, records: dict[str, Record], elements: int = 48) -> XYTest:
    """Analyse one record per driven direction ("x", "y"), each with both axes in it."""
    mechanism = chosen_xy()
    tests, across = {}, {}
    for driven, record in records.items():
        data = record.axis(driven)
        tests[driven] = static_test(data.input, data.position, record.sample_period,
                                    model.axis(driven).base["force_constant"])
        other = record.axis("y" if driven == "x" else "x").position
        levels = tests[driven].levels
        far = max(levels, key=lambda level: abs(level.position_m))
        near = min(levels, key=lambda level: abs(level.position_m))
        across[driven] = float(np.mean(other[far.stop - 200:far.stop])
                               - np.mean(other[near.stop - 200:near.stop]))
    readings = next(iter(records.values())).axis(next(iter(records))).position
    return XYTest(mechanism, tests, across,
                  {each: element_curve(mechanism, each, elements) for each in records},
                  smallest_step(readings), bool(model.coupling))


def smallest_step(readings: Array) -> float:
    """Return the smallest difference between readings, which is the encoder's resolution."""
    steps = np.diff(np.unique(readings))
    steps = steps[steps > 1e-12]
    return float(np.min(steps)) if steps.size else math.nan


def xy_rows(found: XYTest) -> list[Row]:
    """Return the XY section."""
    load, travel = PRINTED["xy.load"].value, PRINTED["xy.travel"].value
    gauge, cross = PRINTED["xy.gauge"].value, PRINTED["xy.cross"].value
    k_paper = load / travel
    block = PRINTED["table1.theory"].value
    rows: list[Row] = []
    for axis, test in found.tests.items():
        rows += [
            derived(f"xy.stiffness_{axis}", f"stiffness in {axis}, slope of force over "
                    "deflection", f"{PLACE}, Fig. {16 if axis == 'x' else 17}", k_paper,
                    test.stiffness, "N/m", "35 N at 7.5 mm; static test of the XY stage's model"),
            derived(f"xy.travel_{axis}", f"displacement in {axis} under the largest load", PLACE,
                    travel, test.deflection_at(load), "m", "static test of the XY stage's model")]
    first = next(iter(found.tests.values()))
    step = PRINTED["xy.increment"].value * STANDARD_GRAVITY
    per_step = step / first.stiffness.value
    apart = float(np.min(np.diff(np.unique(np.round(first.force_n, 6)))))
    return [
        *rows,
        printed("xy.load", float(np.max(first.force_n)), "largest force in the record; the paper "
                f"equates 35 N with 3.5 kg, which weigh {3.5 * STANDARD_GRAVITY:.1f} N"),
        printed("xy.travel", first.travel_m, "largest less smallest deflection in the record"),
        derived("xy.blocks", "XY stiffness over that of one block", PLACE, k_paper / block,
                first.stiffness.value / block, "", "so the XY stage is not two blocks of Table 1; "
                "in the arrangement chosen four blocks bend, of 1.17 N/mm each"),
        printed("xy.increment", apart / STANDARD_GRAVITY, f"from level to level of our staircase; "
                f"one of the paper's is {1e3 * step:.0f} mN and would move our stage "
                f"{1e6 * per_step:.1f} µm, so 35 N are {load / step:.0f} of them"),
        printed("xy.gauge", found.resolution_m, f"smallest step of our readings; the gauge's is "
                f"{gauge / per_step:.2f} of a load increment and {100.0 * gauge / travel:.2f} % "
                "of the travel, which bounds what it can say of the stiffness"),
        printed("xy.range", first.travel_m, "what our test needs of a gauge; the paper's reaches "
                f"{PRINTED['xy.range'].value / first.travel_m:.1f} times as far"),
        *_cross_rows(found, cross, travel), *_element_rows(found, k_paper),
    ]


def _cross_rows(found: XYTest, cross: float, travel: float) -> list[Row]:
    errors, blade = found.mechanism.errors_for(cross, travel), found.mechanism.block.blade
    coupled = ("what the model's coupling gives" if found.coupled else
               "the model of the XY stage has no coupling, so this is what the readings' noise "
               "leaves")
    perfect = found.elements.get("y")
    return [
        printed("xy.cross", abs(found.across_m["y"]) if "y" in found.across_m else None,
                f"motion in x while y is driven to its end; {coupled}"),
        *(derived("xy.cross_other", "motion in Y while X is driven", PLACE, cross,
                  abs(found.across_m[axis]), "m", "'similar results are observed in other "
                  "direction'") for axis in ("x",) if axis in found.across_m),
        ours_only("xy.cross_perfect", "the same for a perfect mechanism, finite elements", PLACE,
                  float(abs(perfect.across_m[-1])) if perfect else None, "m", "zero in closed "
                  "form: the 25 µm are not parasitic, as the paper says"
                  if perfect else "pyfe3d is not installed"),
        ours_only("xy.error_angle", "all four blocks turned alike by", PLACE,
                  errors["angle_rad"], "rad", "the manufacturing error that would give 25 µm"),
        ours_only("xy.error_angle_random", "blocks turned at random, standard deviation", PLACE,
                  errors["angle_std_rad"], "rad", "likewise"),
        ours_only("xy.error_thickness", "outer blades thicker than inner ones by", PLACE,
                  100.0 * errors["outer_thickness"], "%", "likewise, all to the same side; "
                  f"{1e6 * errors['outer_thickness'] * blade.thickness_m:.0f} µm of blade: the "
                  "angle is the likelier cause"),
    ]


def _element_rows(found: XYTest, k_paper: float) -> list[Row]:
    rows = [derived("xy.closed_form", "stiffness of the chosen mechanism, closed form",
                    "Fig. 16, 17", k_paper, found.mechanism.stiffness_n_m(), "N/m", "Awtar's "
                    "eight blocks, CHOSEN to meet 35 N at 7.5 mm; the paper prints no dimensions")]
    for axis, curve in found.elements.items():
        figure = f"Fig. {16 if axis == 'x' else 17}"
        slope = (float(curve.force_n @ curve.along_m / (curve.along_m @ curve.along_m))
                 if curve else math.nan)
        rows.append(derived(f"xy.fea_{axis}", f"stiffness in {axis}, finite elements", figure,
                            k_paper, slope, "N/m", "the figure is not legible as numbers; "
                            "nonlinear beam elements against the closed form instead"
                            if curve else "pyfe3d is not installed"))
        ours = found.tests[axis].stiffness.value
        rows.append(ours_only(f"xy.fea_error_{axis}", "finite elements against the static test",
                              figure, 100.0 * (slope / ours - 1.0) if curve else None, "%",
                              "the paper: 'good matching with experimental results'"))
    return rows
