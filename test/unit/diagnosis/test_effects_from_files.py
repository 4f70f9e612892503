"""Effects from files outside the package, with the traits of the base class alone: a spring of
fifth order, and a force with states of its own. Their records are made by SciPy's DOP853."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import truth
from scipy.integrate import solve_ivp

from dfm_stage.cli.diagnose_report import write_report
from dfm_stage.diagnosis import diagnose
from dfm_stage.diagnosis.fit import system_of
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification import Run, fit_model
from dfm_stage.model import EFFECTS, Simulator, load_model, save_model
from dfm_stage.model.registry import load_effect

HERE = Path(__file__).parent
FILES = {"quintic_stiffness": HERE.parent / "model" / "quintic_stiffness.py",
         "absorber": HERE / "absorber.py"}
TRUE = {"quintic_stiffness": {"k5": 3e13},
        "absorber": {"stiffness": 160.0, "frequency": 21.0, "damping_ratio": 0.15}}
OTHERS = ("cubic_stiffness", "quadratic_stiffness", "quadratic_damping", "coulomb_friction",
          "creep", "transport_delay")


@pytest.fixture(scope="module", autouse=True)
def _registered() -> Iterator[None]:
    before = dict(EFFECTS)
    for path in FILES.values():
        load_effect(path)
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


def slope(name: str, s: list[float], u: float) -> list[float]:
    """The equations of motion, as the files' docstrings have them."""
    x, v, z, dz = s
    force = truth.GAIN * u - truth.DAMPING * v - truth.STIFFNESS * x
    p = TRUE[name]
    if name == "quintic_stiffness":
        return [v, (force - p["k5"] * x**5) / truth.MASS, 0.0, 0.0]
    w, zeta = 2.0 * math.pi * p["frequency"], p["damping_ratio"]
    pull = p["stiffness"] * ((z - x) + 2.0 * zeta / w * (dz - v))
    return [v, (force + pull) / truth.MASS, dz, -w * w * (z - x) - 2.0 * zeta * w * (dz - v)]


def moved(name: str, feeds: list[np.ndarray]) -> np.ndarray:
    """Positions (R, N) from rest under R held inputs, solved at once: the calls take the time."""
    state, out = np.zeros((len(feeds), 4)), np.empty((len(feeds), feeds[0].size))
    for k, inputs in enumerate(np.transpose(feeds).tolist()):
        out[:, k] = state[:, 0]
        state = solve_ivp(
            lambda _, s, inputs=inputs: [rate for row, u in zip(
                s.reshape(-1, 4).tolist(), inputs, strict=True) for rate in slope(name, row, u)],
            (0.0, truth.PERIOD), state.ravel(), method="DOP853", rtol=1e-9,
            atol=1e-13).y[:, -1].reshape(-1, 4)
    return out


@pytest.mark.parametrize("name", TRUE)
def test_an_effect_from_a_file_is_simulated_fitted_named_written_and_drawn(name, tmp_path):
    train, held = 2.0 * truth.multisine(31)[:6000], 2.0 * truth.scan()[:6000]
    positions = moved(name, [train, held])
    believed = truth.believed()
    complete = believed.with_effect(name, TRUE[name])
    simulated = Simulator(complete).run(train).position
    assert np.max(np.abs(simulated - positions[0])) < 1e-5 * np.ptp(positions[0])

    off = believed.with_effect(name, {n: 0.7 * v for n, v in TRUE[name].items()})
    refit = fit_model(off, [Run("train", train, positions[0], truth.PERIOD)],
                      [f"{name}.{n}" for n in TRUE[name]], noise="white").model
    for n, v in TRUE[name].items():
        assert refit.parameters()[f"{name}.{n}"] == pytest.approx(v, rel=1e-3)

    runs = [truth.record(feed, x, seed) for feed, x, seed in
            zip((train, held), positions, (41, 42), strict=True)]
    found = diagnose(runs[:1], believed, holdout=runs[1:], library=(*OTHERS, *TRUE))
    assert (found.verdict, found.names) == ("named", (name,))
    for n, v in TRUE[name].items():
        assert found.effects[0].parameters[n].value == pytest.approx(v, rel=0.05)

    save_model(found.model, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.effect(name) is not None
    assert np.array_equal(Simulator(again).run(train).position,
                          Simulator(found.model).run(train).position)
    write_report(found, tmp_path / "report.html", ["train"], "believed")
    page = (tmp_path / "report.html").read_text("utf-8")
    for shown in (name.replace("_", " "), "Measured against simulated", *TRUE[name]):
        assert shown in page


@pytest.mark.parametrize(("driven", "own"), [(False, {"position", "velocity"}), (True, set())])
def test_a_body_of_its_own_was_set_going_before_a_ring_down(driven, own):
    model = truth.believed().with_effect("absorber", TRUE["absorber"])
    feed, output = np.full(500, float(driven)), np.sin(np.arange(500) / 9.0)
    feed[::2] = 0.0
    run = Observation("run", feed, 1e-4 * output, model.sample_period)
    unknowns = {u.name for u in system_of(model, [run], ()).unknowns}
    assert {n for n in unknowns if n.startswith("initial.absorber")} == {
        f"initial.absorber.{n}" for n in own}
