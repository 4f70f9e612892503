"""What a screen simulates for all starting points at once, and which of them it looks at."""

from __future__ import annotations

import numpy as np
import pytest
import truth

from dfm_stage.diagnosis.candidates import excluded, starts
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.screen import Hit, Screen
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.search_decisions import LOOKED_CLOSELY
from dfm_stage.model import EFFECTS
from dfm_stage.model.registry import ALL, library_of

HARD, HARDER = 2e9, 1e10
"""Cubic stiffness, N/m^3, that bends the motion by some 10 and 50 %."""


@pytest.fixture(scope="module")
def search() -> Search:
    return search_of(HARD)


def search_of(hard: float) -> Search:
    runs = []
    for seed in (1, 2):
        feed = truth.multisine(seed)
        moved = truth.move(feed, lambda x, v: -hard * x**3 - 3.0 * abs(v) * v)
        runs.append(observe(truth.record(feed, moved, seed, f"run {seed}"), truth.believed()))
    found = Search(truth.believed(), runs, ("damping", "stiffness"), library=tuple(EFFECTS))
    found.begin()
    return found


def screen(search: Search, *names: str) -> Screen:
    bare = search.fitted((), search.begin())
    if not names:
        return Screen(bare, search.runs, search.weights, search.noise)
    hits = [h for h in search.screened(bare, ())[1] if h.name in names][:1]
    return Screen(search.fitted(names, bare, hits), search.runs, search.weights, search.noise,
                  bare.model)


@pytest.mark.parametrize("name", library_of([ALL]))
def test_points_simulated_together_respond_as_each_alone(search, name):
    own = screen(search)
    if excluded(name, own.model, own.at):
        pytest.skip("it is no candidate here")
    points = [p for each in starts(name, own.at)[::9] for p in
              EFFECTS[name].directions(each, own.at)]
    together = list(own._responses(own.model, name, points)) if points else []
    for point, response in zip(points, together, strict=True):
        alone = own._outputs(own.model.with_effect(name, point))
        assert (alone is None and not np.all(np.isfinite(response))) \
            or np.array_equal(alone, response)


@pytest.mark.parametrize("name", library_of([ALL]))
def test_a_gain_is_what_least_squares_take_of_the_residual(search, name):
    """Of what the free parameters leave, by the projected response at its best multiple."""
    own = screen(search)
    if excluded(name, own.model, own.at):
        pytest.skip("it is no candidate here")
    for hit in own.hits(name):
        sizes = np.ones(1) if EFFECTS[name].searched else np.linalg.lstsq(
            hit.columns, own.residual, rcond=1e-9)[0]
        left = own.residual - hit.columns @ sizes
        np.testing.assert_allclose(own.basis.T @ hit.columns, 0.0, atol=1e-9 * np.max(
            np.linalg.norm(hit.columns, axis=0)))
        assert own.residual @ own.residual - left @ left == pytest.approx(
            hit.gain, rel=1e-5, abs=1e-6 * own.residual.size)


def test_beside_a_nonlinear_effect_the_best_point_is_among_those_looked_at_closely(search):
    own = screen(search, "cubic_stiffness")
    points = starts("second_mode", own.at)
    assert own._first is not None
    assert len(points) > 2 * LOOKED_CLOSELY
    looked: list[int] = []
    exact = own._looked_at

    def counted(name: str, chosen: list[dict[str, float]]) -> list[Hit | None]:
        looked.append(len(chosen))
        return exact(name, chosen)

    own._looked_at = counted
    best = own.hits("second_mode")[0]
    assert looked == [LOOKED_CLOSELY]
    every = [h for h in exact("second_mode", points) if h is not None]
    assert best.gain == max(h.gain for h in every)


def test_a_linear_model_needs_no_first_look(search):
    assert screen(search)._first is None


def test_a_linear_model_that_moves_otherwise_is_not_asked():
    assert screen(search_of(HARDER), "cubic_stiffness")._first is None


def test_parameters_that_move_nothing_leave_the_whole_residual(search):
    """A reading rounded to more than the motion never changes: nothing can be refitted to it."""
    bare = search.fitted((), search.begin())
    blind = fit(bare.model.with_effect("encoder_quantization", {"step": 1.0}), search.runs, (),
                search.weights, iterations=0)
    own = Screen(blind, search.runs, search.weights, search.noise)
    assert own.basis.shape == (blind.white.size, 0)
    assert np.array_equal(own.residual, blind.white)
