"""How many formulas are fitted: one always, further ones while work is left."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dfm_stage.diagnosis import formula_offer


@pytest.mark.parametrize(("each", "fitted"), [(0.0, [0, 1, 2]), (6.0, [0, 1]), (20.0, [0])])
def test_further_formulas_are_fitted_while_work_is_left(each, fitted, monkeypatch):
    """One formula of a long record may take all the work by itself."""
    done = []
    search = SimpleNamespace(steps=0.0, most_steps=10.0, step=lambda _: None, weights=(),
                             begin_work=lambda _: None, weigh_at_first=lambda _: None,
                             model=SimpleNamespace(effects=()))
    trial = SimpleNamespace(search=search, held=(), predicted=lambda _: SimpleNamespace(
        residuals=()))

    def fit(_trial, _proposal, number, _change):
        done.append(number)
        search.steps += each

    monkeypatch.setattr(formula_offer, "weights_like", lambda *_: ())
    monkeypatch.setattr(formula_offer, "power", lambda *_: 1.0)
    monkeypatch.setattr(formula_offer, "_proposals", lambda *_: [1, 2, 3, 4])
    monkeypatch.setattr(formula_offer, "_fitted", fit)
    monkeypatch.setattr(formula_offer, "_ranked", lambda *_: [])
    monkeypatch.setattr(formula_offer, "replace", lambda evidence, **_: evidence)
    evidence = SimpleNamespace(surface=1, judged=SimpleNamespace(lag=0, noise_power=0.0))
    bare = SimpleNamespace(bare=SimpleNamespace(model=None))
    formula_offer.with_formulas(trial, bare, evidence, SimpleNamespace(model="retuned"))
    assert done == fitted


@pytest.mark.parametrize(("left", "goes_on"), [(0.5, True), (2.0, False)])
def test_a_formula_whose_fit_ends_far_off_is_fitted_no_further(left, goes_on, monkeypatch):
    """Its minimum and its held-out error would take as much work again."""
    done = []

    def settled(_names, found):
        done.append(found)
        return found

    def fit(size):
        return SimpleNamespace(ok=True, residuals=[[np.full(8, size)]], model=None)

    search = SimpleNamespace(step=lambda _: None, settled=settled,
                             once=lambda *_: fit(left))
    trial = SimpleNamespace(search=search, predicted=lambda _: SimpleNamespace(residuals=[1]))
    law = SimpleNamespace(name="proposed_0", text="-f * sign(v)", effect=lambda: SimpleNamespace(
        defaults={}))
    monkeypatch.setattr(formula_offer, "formula_from", lambda *_: law)
    monkeypatch.setattr(formula_offer, "EFFECTS", SimpleNamespace(hold=lambda _: None))
    proposal = SimpleNamespace(names=(), start=fit(1.0), scales={}, found=SimpleNamespace(
        parts=(), base={}))
    found = formula_offer._fitted(trial, proposal, 0, False)
    assert (found is not None) is goes_on is bool(done)
