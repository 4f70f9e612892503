"""Closed forms of the flexure against the exact elastica of an extensible beam, by SciPy."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from dfm_stage.model.flexure import (
    ALUMINIUM_7075_T6,
    SPRING_STEEL_1095,
    Blade,
    DoubleParallelogram,
    FlexureError,
    Parallelogram,
    blade_for,
    chosen_manipulator,
)

DFM = chosen_manipulator()
T = DFM.blade.slenderness


def elastica(d: float, p: float) -> tuple[float, float, float]:
    """Guided blade, all per E I and L: (transverse force, axial end motion, largest curvature).

    States: x, y, angle, curvature; parameter: transverse force at the end; p is the tension.
    """
    def slopes(s: np.ndarray, z: np.ndarray, f: np.ndarray) -> np.ndarray:
        c, q = np.cos(z[2]), np.sin(z[2])
        stretch = 1.0 + T**2 / 12.0 * (p * c + f[0] * q)
        return np.array([stretch * c, stretch * q, z[3], p * q - f[0] * c])

    def ends(a: np.ndarray, b: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.array([a[0], a[1], a[2], b[1] - d, b[2]])

    s = np.linspace(0.0, 1.0, 41)
    guess = np.array([s, d * (3 * s**2 - 2 * s**3), 6 * d * (s - s**2), 6 * d * (1 - 2 * s)])
    found = solve_bvp(slopes, ends, s, guess, p=[12.0 * d], tol=1e-9, max_nodes=20000)
    assert found.success
    return float(found.p[0]), float(found.y[0, -1]) - 1.0, float(np.max(np.abs(found.y[3])))


@pytest.mark.parametrize("d", [0.005, 0.02, 0.04, 0.08])
@pytest.mark.parametrize("p", [-4.0, 0.0, 4.0])
def test_single_parallelogram_is_the_elastica(d: float, p: float) -> None:
    """Blades in a pair share the axial force; rotation of the stage is held here."""
    single, unit = Parallelogram(DFM.blade, 0.08), DFM.blade.force_unit_n
    length = DFM.blade.length_m
    force, end, _ = elastica(d, p)
    stiffness = 2.0 * force * unit / (d * length)
    assert single.stiffness_n_m(2.0 * p * unit) == pytest.approx(stiffness, rel=0.012)
    assert single.parasitic_m(d * length, 2.0 * p * unit) == pytest.approx(end * length, rel=0.012,
                                                                            abs=1e-9)


def in_series(d: float, p: float) -> tuple[float, float]:
    """Two guided blades in series, one pulled by p, one pushed: (force, motion along x)."""
    outer = brentq(lambda x: elastica(x, p)[0] - elastica(d - x, -p)[0], 0.3 * d, 0.7 * d,
                   xtol=1e-10)
    return elastica(outer, p)[0], elastica(outer, p)[1] - elastica(d - outer, -p)[1]


@pytest.mark.parametrize("p", [0.0, 2.0, -2.0])
def test_double_parallelogram_is_two_elasticas_in_series(p: float) -> None:
    d, unit = 0.077, DFM.blade.force_unit_n
    force, _ = in_series(d, p)
    stiffness = 2.0 * force * unit / (d * DFM.blade.length_m)
    assert DFM.stiffness_n_m(2.0 * p * unit) == pytest.approx(stiffness, rel=0.005)


@pytest.mark.parametrize("d", [0.0005, 0.01, 0.077])
def test_axial_stiffness_falls_with_deflection_as_the_elastica_says(d: float) -> None:
    step = 0.5
    motion = in_series(d, step)[1] - in_series(d, -step)[1]
    expected = 2.0 * (2.0 * step) * DFM.blade.force_unit_n / (motion * DFM.blade.length_m)
    assert DFM.axial_stiffness_n_m(d * DFM.blade.length_m) == pytest.approx(expected, rel=0.03)


def test_stress_is_that_of_the_largest_curvature() -> None:
    _, _, curvature = elastica(0.0385, 0.0)
    blade = DFM.blade
    modulus = blade.material.youngs_modulus_pa
    expected = modulus * curvature / blade.length_m * blade.thickness_m / 2
    assert DFM.stress_pa(7.7e-3) == pytest.approx(expected, rel=0.005)


def test_the_chosen_geometry_meets_the_papers_stiffness_and_travel() -> None:
    assert DFM.stiffness_n_m() == pytest.approx(650.0, rel=1e-12)
    assert DFM.fatigue_safety(7.73e-3) > 2.0
    assert DFM.stroke_m() > 2.0 * 7.7e-3
    assert DFM.stress_pa(DFM.stroke_m(2.5)) == pytest.approx(159e6 / 2.5)
    for load, deflection in ((-5.0, -7.692e-3), (2.5, 3.846e-3)):          # Table 1, theory
        assert DFM.force_n(deflection) == pytest.approx(load, rel=1e-3)


def test_parasitic_motion_cancels_in_the_double_parallelogram() -> None:
    single = Parallelogram(DFM.blade, 0.08)
    assert single.parasitic_m(7.7e-3) == pytest.approx(-0.6 * 7.7e-3**2 / 0.1)
    assert DFM.parasitic_m(7.7e-3) == 0.0
    thicker = DFM.parasitic_m(7.5e-3, outer_over_inner=1.05**3)
    assert thicker == pytest.approx(0.6 * 7.5e-3**2 / 0.1 * (1.05**3 - 1) / (1.05**3 + 1))


def test_rotation_vanishes_where_the_force_acts_at_the_centre_of_the_blades() -> None:
    single, d = Parallelogram(DFM.blade, 0.08), 2e-3
    force = single.stiffness_n_m() * d
    assert abs(single.rotation_rad(d, -force * DFM.blade.length_m / 2)) < 1e-18
    assert abs(DFM.rotation_rad(d, DFM.force_n(d) * DFM.blade.length_m / 2)) < 1e-18


@pytest.mark.parametrize(("change", "factor"), [
    ({"thickness_m": DFM.blade.thickness_m * 2}, 8.0), ({"length_m": 0.2}, 1 / 8),
    ({"width_m": 0.04}, 2.0),
    ({"material": SPRING_STEEL_1095}, 205 / 71.7),
])
def test_stiffness_scales_as_e_b_t3_over_l3(change: dict[str, float], factor: float) -> None:
    other = replace(DFM, blade=replace(DFM.blade, **change))
    assert other.stiffness_n_m() / DFM.stiffness_n_m() == pytest.approx(factor)


def test_blade_for_other_arrangements() -> None:
    blade = blade_for(1000.0, length_m=0.05, width_m=0.01, material=SPRING_STEEL_1095,
                      blades_in_series=1, blades_side_by_side=2)
    assert Parallelogram(blade, 0.03).stiffness_n_m() == pytest.approx(1000.0)


def test_material_damping_is_far_below_what_the_paper_measures() -> None:
    c = DFM.material_damping_n_s_m(1.082)
    assert c / (2.0 * math.sqrt(650.0 * 1.082)) == pytest.approx(0.5e-4)


@pytest.mark.parametrize(("make", "part"), [
    (lambda: Blade(0.0, 1e-3, 0.02, ALUMINIUM_7075_T6), "length_m = 0 m is outside"),
    (lambda: Blade(0.1, 0.02, 0.02, ALUMINIUM_7075_T6), "beam theory needs it slender"),
    (lambda: DoubleParallelogram(DFM.blade, 0.05, 0.08), "inner_spacing_m"),
    (lambda: DFM.stiffness_n_m(20.5 * DFM.blade.force_unit_n), "buckles the blades"),
    (lambda: DFM.stiffness_n_m(-20.5 * DFM.blade.force_unit_n), "buckles the blades"),
    (lambda: Parallelogram(DFM.blade, 0.1).stiffness_n_m(-200.0), "buckles the blades"),
    (lambda: blade_for(-1.0, length_m=0.1, width_m=0.02, material=ALUMINIUM_7075_T6),
     "stiffness_n_m must be above zero"),
])
def test_what_the_closed_forms_do_not_cover_is_refused(make: object, part: str) -> None:
    with pytest.raises(FlexureError) as caught:
        make()  # type: ignore[operator]
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_numbers_in_the_documentation_are_these() -> None:
    text = (Path(__file__).parents[3] / "docs" / "flexure.md").read_text(encoding="utf-8")
    promised = [
        f"{DFM.blade.thickness_m * 1e3:.3f} mm",
        f"{DFM.stress_pa(7.7e-3) / 1e6:.0f} MPa",
        f"{DFM.fatigue_safety(7.7e-3):.1f} times",
        f"±{DFM.stroke_m() * 1e3:.0f} mm",
        f"{DFM.axial_stiffness_n_m(7.67e-3) / 1e3:.0f} kN/m",
        f"{DFM.stiffness_n_m(20.0):.1f} N/m",
    ]
    assert [each for each in promised if each not in " ".join(text.split())] == []
