"""How many formulas are fitted: one always, further ones while work is left."""

from __future__ import annotations

from types import SimpleNamespace

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

    def fit(_trial, _proposal, number):
        done.append(number)
        search.steps += each

    monkeypatch.setattr(formula_offer, "weights_like", lambda *_: ())
    monkeypatch.setattr(formula_offer, "power", lambda *_: 1.0)
    monkeypatch.setattr(formula_offer, "_proposals", lambda *_: [1, 2, 3, 4])
    monkeypatch.setattr(formula_offer, "_fitted", fit)
    monkeypatch.setattr(formula_offer, "_ranked", lambda *_: [])
    monkeypatch.setattr(formula_offer, "replace", lambda evidence, **_: evidence)
    evidence = SimpleNamespace(surface=1, judged=SimpleNamespace(change=False, noise_power=0.0))
    bare = SimpleNamespace(bare=SimpleNamespace(model=None))
    formula_offer.with_formulas(trial, bare, evidence, SimpleNamespace(model="retuned"))
    assert done == fitted
