"""Table 1 and Fig. 6: force, deflection, stiffness; the quasi-static criterion; the geometry."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.static import StaticTest
from dfm_stage.model import Model
from dfm_stage.model.flexure import DoubleParallelogram, FlexureError, chosen_manipulator
from dfm_stage.paper.row import PRINTED, TABLE_1, Row, derived, ours_only, printed

PLACE = "Table 1"


def table_rows(test: StaticTest, model: Model) -> list[Row]:
    """Return Table 1 from a static test through the node graph."""
    theory = PRINTED["table1.theory"].value
    rows = [printed("table1.theory", test.stiffness,
                    "slope of the line through all levels of the static test; the model's "
                    f"stiffness is {model.base.get('stiffness', math.nan):g} N/m, taken from this "
                    "very number")]
    worst = 0.0
    for load, _, practice, stiffness, error in TABLE_1:
        name = f"{load:g}N"
        deflection = test.deflection_at(load)
        ours = load / deflection.value
        off = 100.0 * abs(theory - ours) / theory
        worst = max(worst, off)
        rows += [
            Row(f"table1.deflection.{name}", f"deflection at {load:g} N", PLACE, practice * 1e-3,
                deflection.value, "m", "the paper's are measured, 0.2 to 0.8 % softer than its "
                "theory and not quite odd; the simulated stage is the theory", "printed",
                deflection.ci95),
            Row(f"table1.stiffness.{name}", f"stiffness at {load:g} N", PLACE, 1e3 * stiffness,
                ours, "N/m", "load over deflection; the printed value is that of the printed "
                f"deflection ({1e3 * load / (1e3 * practice * 1e-3):.4g} N/m)", "printed"),
            Row(f"table1.error.{name}", f"error of theory at {load:g} N", PLACE, error, off, "%",
                f"against the theory's {theory:g} N/m", "printed")]
    odd = 1e-3 * (TABLE_1[0][2] + TABLE_1[3][2])
    return [
        *rows,
        printed("table1.error", worst, "largest of the four; the paper claims less than 1 %"),
        derived("table1.linearity", "spread of the stiffness over the travel", PLACE,
                _spread_percent(row[3] for row in TABLE_1),
                _spread_percent(row[0] / test.deflection_at(row[0]).value for row in TABLE_1),
                "%", "largest less smallest over the mean; a double parallelogram does not "
                "stiffen"),
        derived("table1.symmetry", "deflection at -5 N plus that at 5 N", PLACE, odd,
                test.deflection_at(-5.0).value + test.deflection_at(5.0).value, "m",
                "an offset or a force constant that depends on the sign; the model has neither"),
        ours_only("table1.hysteresis", "hysteresis loop, largest width", "Fig. 6",
                  test.hysteresis, "m", "the paper calls forward and backward path a close match "
                  "without a number")]


def quasistatic_rows(omega: float, damping_ratio: float, slope_m_s: float,
                     travel_m: float) -> list[Row]:
    """Return what a test at three times, and at a third of, the natural frequency would read."""
    def reading(ratio: float) -> float:
        return 100.0 * (abs(1.0 / complex(1.0 - ratio**2, 2.0 * damping_ratio * ratio)) - 1.0)

    printed_ratio = PRINTED["quasistatic.limit"].value
    equivalent = slope_m_s / (0.5 * travel_m) / omega
    return [
        printed("quasistatic.limit", 1.0 / printed_ratio,
                "printed as 'less than the three times of its natural frequency'; that must read "
                "one third of it"),
        ours_only("quasistatic.printed", "error of the deflection at three times the natural "
                  "frequency", "sec. 3A", reading(printed_ratio), "%", "from the identified "
                  "natural frequency and damping: the stage hardly follows"),
        ours_only("quasistatic.third", "error of the deflection at a third of it", "sec. 3A",
                  reading(1.0 / printed_ratio), "%", "even a third is not static; the levels are "
                  "held instead"),
        ours_only("quasistatic.ours", "frequency of our staircase over the natural one",
                  "sec. 3A", equivalent, "", "largest mean speed between levels over half the "
                  "travel and the natural frequency")]


def geometry_rows(manipulator: DoubleParallelogram | None = None) -> list[Row]:
    """Return the chosen geometry: stiffness, stress, stroke, closed form against elements."""
    dfm = manipulator or chosen_manipulator()
    travel = 1e-3 * max(abs(row[2]) for row in TABLE_1)
    load = max(abs(row[0]) for row in TABLE_1)
    chosen = ("the paper prints neither geometry nor material: CHOSEN, aluminium 7075-T6, blades "
              f"{1e3 * dfm.blade.length_m:g} x {1e3 * dfm.blade.width_m:g} mm")
    rows = [
        derived("geometry.stiffness", "stiffness of the geometry, closed form", "sec. 2",
                PRINTED["table1.theory"].value, dfm.stiffness_n_m(), "N/m",
                f"{chosen}; the thickness, {1e3 * dfm.blade.thickness_m:.3f} mm, follows from the "
                "stiffness"),
        ours_only("geometry.fatigue", "fatigue limit over stress at the largest travel", "sec. 2",
                  dfm.fatigue_safety(travel), "", f"{1e-6 * dfm.stress_pa(travel):.0f} MPa at "
                  f"{1e3 * travel:g} mm; {chosen}"),
        derived("geometry.stroke", "travel at the fatigue limit", "sec. 2", travel,
                dfm.stroke_m(), "m", "the paper's travel is well inside; " + chosen),
        derived("geometry.parasitic", "motion along the blades at the largest travel", "sec. 2",
                0.0, dfm.parasitic_m(travel), "m", "zero in closed form, as the paper says of "
                "the DFM"),
        ours_only("geometry.rotation", "rotation of the stage at the largest travel", "sec. 2",
                  dfm.rotation_rad(travel), "rad", "the paper's 'small rotation of motion stage'")]
    try:
        from dfm_stage.model.flexure_fe import manipulator_frame

        _, along, turn = manipulator_frame(dfm, 96).deflect({"stage": (0.0, load, 0.0)})["stage"]
        element, reason = load / float(along), "nonlinear beam elements, 96 per blade"
        rotation = float(turn)
    except FlexureError as error:
        element, rotation, reason = math.nan, math.nan, str(error)
    return [*rows,
            derived("geometry.fea", "stiffness at 5 N, finite elements", "sec. 2",
                    PRINTED["table1.theory"].value, element, "N/m", f"{reason}; {chosen}"),
            ours_only("geometry.fea_rotation", "rotation at 5 N, finite elements", "sec. 2",
                      rotation, "rad", f"{reason}; closed form "
                      f"{1e6 * dfm.rotation_rad(load / dfm.stiffness_n_m()):.2f} µrad")]


def _spread_percent(stiffness: Iterable[float]) -> float:
    values = list(stiffness)
    return 100.0 * float(np.ptp(values) / np.mean(values))


def mass_and_damping_rows(stiffness: Quantity, omega: Quantity, damping: Quantity,
                          model: Model) -> list[Row]:
    """Return moving mass and viscous damping as the paper's numbers give them, and ours."""
    mass = PRINTED["table1.theory"].value / PRINTED["response.natural"].value**2
    ours_mass = stiffness.value / omega.value**2
    spread = math.hypot(stiffness.half_width / stiffness.value,
                        2.0 * omega.half_width / omega.value) * ours_mass
    ours_c = damping.value * ours_mass
    spread_c = math.hypot(damping.half_width / damping.value, spread / ours_mass) * ours_c
    return [
        derived("derived.mass", "moving mass, k / w^2", "Table 1, sec. 3C", mass,
                Quantity(ours_mass, "kg", (ours_mass - spread, ours_mass + spread)), "kg",
                f"static stiffness over identified frequency; the model has "
                f"{model.base['mass']:g} kg"),
        derived("derived.damping", "viscous damping, 1.705 m", "Eq. 3",
                PRINTED["eq3.damping"].value * mass,
                Quantity(ours_c, "N s/m", (ours_c - spread_c, ours_c + spread_c)), "N s/m",
                f"the model has {model.base.get('damping', 0.0):g} N s/m")]
