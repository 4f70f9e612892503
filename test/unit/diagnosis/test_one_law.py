"""Several laws of speed found at once: named only where no single one does better."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.diagnosis import diagnose, one_law
from dfm_stage.diagnosis.alike import laws_of_speed
from dfm_stage.diagnosis.decisions import MARGIN
from dfm_stage.diagnosis.evidence import Errors, Evidence, Judged, ModelEvidence, Motion, Noise
from dfm_stage.model import Model
from dfm_stage.model.registry import ALL, library_of
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SIZE, NOISE = 2e-3, 4000, 2e-6
STIFFNESS = (2.0 * np.pi * 8.0) ** 2
MODEL = Model("s", PERIOD, {"mass": 1.0, "damping": 2.0, "stiffness": STIFFNESS,
                            "force_constant": 1.0})


def record(seed, drag):
    """A multisine that moves the stage, whose extra `drag(v)` (N) is integrated by itself."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(SIZE)
    lines = np.arange(1, 60) / (SIZE * PERIOD)
    phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    u = 3.0 * np.sin(2.0 * np.pi * np.outer(time, lines * 3.0) + phases).sum(1) / 8.0

    def slope(t, s):
        force = u[min(int(t / PERIOD + 1e-9), SIZE - 1)]
        return [s[1], force - STIFFNESS * s[0] - 2.0 * s[1] - drag(s[1])]

    x, state = np.zeros(SIZE), np.zeros(2)
    for k in range(SIZE - 1):
        state = solve_ivp(slope, (time[k], time[k + 1] - 1e-12), state, method="RK45",
                          rtol=1e-7, atol=1e-10).y[:, -1]
        x[k + 1] = state[0]
    return Record(time, PERIOD, {"x": AxisRecord(u, x + NOISE * rng.standard_normal(SIZE))},
                  Provenance(f"run {seed}", "csv"))


def of_speed(drag):
    """What is found of a stage with this drag, among laws of speed."""
    return diagnose([record(1, drag)], MODEL, holdout=[record(2, drag)], library=[
        "coulomb_friction", "eddy_current_damping", "quadratic_damping", "cubic_stiffness"])


@pytest.mark.slow
def test_a_root_of_speed_is_not_two_laws() -> None:
    """It was an eddy-current brake and Coulomb friction, by which nothing but noise was left."""
    found = of_speed(lambda v: 0.3 * np.sign(v) * np.sqrt(abs(v)))
    assert found.verdict == "partial"
    assert not found.complete
    assert set(found.names) == {"coulomb_friction", "eddy_current_damping"}
    assert "stand in for one law of speed" in found.sentence


@pytest.mark.slow
def test_two_laws_that_are_there_are_named() -> None:
    found = of_speed(lambda v: 0.05 * np.tanh(v / 1e-4) + 8.0 * v * abs(v))
    assert found.verdict == "named"
    assert set(found.names) == {"coulomb_friction", "quadratic_damping"}


def stand_ins(names, chi2, free, held_out=0.0, left=1.0, graded=False):
    """The laws that are noted to stand in for one that leaves `chi2` with `free` parameters, where
    they leave 1000 with 8; of held-out records it leaves so much more, and `left` of the
    residual."""
    least, law = (SimpleNamespace(chi2=c, ok=True, weights="w", model=c, system=SimpleNamespace(
        free=range(k))) for c, k in ((1000.0, 8), (chi2, free)))
    search = SimpleNamespace(
        weights="w", begin_work=lambda _: None, step=lambda _: None, unfinished={},
        in_place_of=lambda *_: law, polished=lambda _, found: found,
        score=lambda f: f.chi2 + 12.0 * len(f.system.free))
    rest = np.random.default_rng(1).standard_normal((2, 4000))
    trial = SimpleNamespace(search=search, lag=0, predicted=lambda model: SimpleNamespace(
        chi2=900.0 + (held_out if model == chi2 else 0.0),
        residuals=[[left * rest[0] if model == chi2 else rest[1]]]))
    found = trial, SimpleNamespace(names=names, fit=least), Evidence(
        ("run",), "m", Noise(1.0, ""), Motion(1.0), *[ModelEvidence(Errors(1.0, 1.0, 1),
                                                                    Errors(1.0, 1.0, 1))] * 3,
        graded=graded, judged=Judged("position", None, 0.1, None))
    return one_law.with_one_law(found)[2].one_law


TWO = ("cubic_stiffness", "coulomb_friction", "eddy_current_damping")


@pytest.mark.parametrize(("names", "chi2", "free", "held_out", "laws"), [
    (TWO, 1000.0 - 2.0 * MARGIN, 8, 0.0, TWO[1:]),
    (TWO, 1000.0 - 0.5 * MARGIN, 8, 0.0, ()),       # not clearly better
    (TWO, 1000.0 - 0.5 * MARGIN, 7, 0.0, TWO[1:]),  # one parameter less
    (TWO, 500.0, 8, 2.0 * MARGIN, ()),              # held-out records say no
    (TWO[:2], 500.0, 8, 0.0, ()),                   # one law of speed alone
    (("coulomb_friction", "directional_friction"), 500.0, 8, 0.0, ())])  # its sign is no speed
def test_laws_stand_in_for_one_that_does_clearly_better(names, chi2, free, held_out, laws) -> None:
    assert stand_ins(names, chi2, free, held_out) == laws


@pytest.mark.parametrize(("chi2", "left", "laws"), [
    (900.0, 0.7, TWO[1:]),
    (900.0, 0.9, ()),      # it takes but a fifth of the remainder of held-out records
    (1010.0, 0.7, ())])    # fitted records do not bear it out
def test_where_a_remainder_stays_held_out_blocks_decide(chi2, left, laws) -> None:
    assert stand_ins(TWO, chi2, 9, left=left, graded=True) == laws


def test_laws_of_speed_are_known_by_what_they_read() -> None:
    assert set(laws_of_speed(library_of([ALL]))) == {
        "coulomb_friction", "eddy_current_damping", "quadratic_damping", "stribeck_friction"}
