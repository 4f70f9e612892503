"""The beam equation against tabled roots and against Hermite elements assembled here."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg

from dfm_stage.model.beam import (
    BladeChain,
    Span,
    manipulator_chain,
    stage_mass_for,
)
from dfm_stage.model.flexure import FlexureError, chosen_manipulator

DFM = chosen_manipulator()
OMEGA, INTERMEDIATE_KG = 24.51, 0.15
STAGE_KG = stage_mass_for(DFM, OMEGA, INTERMEDIATE_KG)
CHAIN = manipulator_chain(DFM, STAGE_KG, INTERMEDIATE_KG)


def hermite(chain: BladeChain, elements: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of the chain with cubic elements, one blade of `count` times E I, rho A.

    Coordinates: the stages' deflections, then deflection and slope at every inner node.
    """
    n = len(chain.spans)
    total = n + len(chain.spans) * 2 * (elements - 1)
    k_full, m_full = np.zeros((total, total)), np.diag([*chain.masses_kg, *[0.0] * (total - n)])
    first = n
    for i, span in enumerate(chain.spans):
        h = span.blade.length_m / elements
        ei, ra = (span.count * span.blade.bending_stiffness,
                  span.count * span.blade.mass_per_length)
        k = ei / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                                  [-12, -6 * h, 12, -6 * h],
                                  [6 * h, 2 * h * h, -6 * h, 4 * h * h]])
        m = ra * h / 420 * np.array([[156, 22 * h, 54, -13 * h],
                                     [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                                     [54, 13 * h, 156, -22 * h],
                                     [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])
        for e in range(elements):
            left = [i - 1 if i else -1, -1] if e == 0 else [first + 2 * e - 2, first + 2 * e - 1]
            right = [i, -1] if e == elements - 1 else [first + 2 * e, first + 2 * e + 1]
            where = [*left, *right]
            for a in range(4):
                for b in range(4):
                    if where[a] >= 0 and where[b] >= 0:
                        k_full[where[a], where[b]] += k[a, b]
                        m_full[where[a], where[b]] += m[a, b]
        first += 2 * (elements - 1)
    return k_full, m_full


def test_clamped_guided_blade_has_the_tabled_roots() -> None:
    span = Span(DFM.blade, 1)
    modes = BladeChain((span,), (0.0,)).modes(4)
    roots = [math.sqrt(mode.omega / span.blade_period) for mode in modes]
    # tan b + tanh b = 0; Blevins, Formulas for Natural Frequency and Mode Shape, table 8-1.
    assert roots == pytest.approx([2.36502037, 5.49780392, 8.63937983, 11.78097245], rel=1e-8)


@pytest.mark.parametrize("masses", [(INTERMEDIATE_KG, STAGE_KG), (0.0, 0.0), (0.001, 0.02)])
def test_modes_are_those_of_finite_elements(masses: tuple[float, float]) -> None:
    chain = BladeChain(CHAIN.spans, masses)
    k, m = hermite(chain)
    values, vectors = scipy.linalg.eigh(k, m)
    moving = [i for i in range(12) if np.max(np.abs(vectors[:2, i])) > 1e-6][:5]
    for mode, i in zip(chain.modes(5), moving, strict=True):
        assert mode.omega == pytest.approx(math.sqrt(values[i]), rel=2e-5)
        shape = vectors[:2, i] * np.sign(vectors[1, i])
        assert mode.shape == pytest.approx(shape, rel=1e-4, abs=1e-4)


def test_the_first_mode_is_the_papers_and_the_lumped_mass_is_not_far() -> None:
    first, second = CHAIN.modes(2)
    assert first.omega == pytest.approx(OMEGA, rel=1e-9)
    blades = 4 * DFM.blade.mass_per_length * DFM.blade.length_m
    lumped = STAGE_KG + INTERMEDIATE_KG / 4 + 0.3 * blades
    assert math.sqrt(650.0 / lumped) == pytest.approx(OMEGA, rel=0.01)
    # The intermediate stage swings on all four blades while the stage stays behind.
    assert second.omega == pytest.approx(math.sqrt(4 * 650.0 / INTERMEDIATE_KG), rel=0.05)
    assert abs(second.shape[0]) > 10 * abs(second.shape[1])


@pytest.mark.parametrize("loss", [0.0, 0.07])
def test_compliance_is_that_of_finite_elements(loss: float) -> None:
    k, m = hermite(CHAIN)
    f = np.array([0.01, 1.0, 3.7, 4.2, 21.0, 70.0])
    unit = np.zeros(len(k))
    unit[1] = 1.0
    expected = [np.linalg.solve((1 + 1j * loss) * k - (2 * math.pi * x)**2 * m, unit)[1]
                for x in f]
    assert CHAIN.compliance(f, loss_factor=loss) == pytest.approx(np.array(expected), rel=2e-4)


def test_a_damper_gives_the_resonance_its_height() -> None:
    c = 1.845
    peak = CHAIN.compliance(np.array([OMEGA / (2 * math.pi)]), damping_n_s_m=c)[0]
    assert abs(peak) == pytest.approx(1.0 / (c * OMEGA), rel=0.02)


def test_step_response_is_that_of_finite_elements() -> None:
    k, m = hermite(CHAIN, 12)
    values, vectors = scipy.linalg.eigh(k, m)
    t = np.linspace(0.0, 0.6, 200)
    omega, zeta = np.sqrt(values), 0.035
    damped = omega * math.sqrt(1 - zeta**2)
    angle = np.outer(t, damped)
    each = 1 - np.exp(-zeta * np.outer(t, omega)) * (
        np.cos(angle) + zeta / math.sqrt(1 - zeta**2) * np.sin(angle))
    expected = 2.0 * each @ (vectors[1]**2 / values)
    found = CHAIN.step_response(t, 2.0, zeta)
    assert np.max(np.abs(found - expected)) < 1e-4 * np.max(expected)
    assert CHAIN.step_response(np.array([-1.0, 0.0, 60.0]), 2.0, zeta) == pytest.approx(
        [0.0, 0.0, 2.0 / 650.0], rel=1e-6)


def test_the_static_limit_is_the_stiffness() -> None:
    assert 1.0 / CHAIN.compliance(np.array([1e-6]))[0].real == pytest.approx(650.0, rel=1e-9)


@pytest.mark.parametrize("b", [0.299, 0.301])
def test_series_and_closed_form_agree_where_they_meet(b: float) -> None:
    span = Span(DFM.blade, 1)
    unit = DFM.blade.bending_stiffness / DFM.blade.length_m**3
    got = span.dynamic_stiffness(span.blade_period * b**2) / unit
    down = 1 - math.cos(b) * math.cosh(b)
    near = b**3 * (math.sin(b) * math.cosh(b) + math.cos(b) * math.sinh(b)) / down
    far = -b**3 * (math.sin(b) + math.sinh(b)) / down
    assert got[0, 0].real == pytest.approx(near, rel=1e-9)
    assert got[0, 1].real == pytest.approx(far, rel=1e-9)


@pytest.mark.parametrize(("make", "part"), [
    (lambda: BladeChain((), ()), "spans need as many"),
    (lambda: BladeChain(CHAIN.spans, (1.0,)), "spans need as many"),
    (lambda: BladeChain(CHAIN.spans, (1.0, -1.0)), "must not be negative"),
    (lambda: CHAIN.modes(0), "count must be at least 1"),
    (lambda: CHAIN.step_response(np.zeros(2), 1.0, 1.0), "damping_ratio"),
    (lambda: stage_mass_for(DFM, 24.51, 20.0), "intermediate stage alone is slower"),
])
def test_bad_questions_are_refused(make: object, part: str) -> None:
    with pytest.raises(FlexureError) as caught:
        make()  # type: ignore[operator]
    assert part in str(caught.value)
