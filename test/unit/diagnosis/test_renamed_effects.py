"""No command decides by the name of an effect: another name changes the name in the answer, and
nothing else. Each effect of the library is renamed, where it is named and where it is a rival."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import pytest
import truth

from dfm_stage.diagnosis import diagnose
from dfm_stage.identification import Run, fit_model
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.effect import Effect
from dfm_stage.recording import AxisRecord, Provenance, Record

NEW = "zzrenamed"     # one word: it reads the same in a sentence
SAMPLES = 3000
BESIDE = ("cubic_stiffness", "quadratic_damping", "coulomb_friction", "transport_delay",
          "second_mode")
"""Candidates beside the one renamed and what shares a class with it: the whole library would only
take longer."""
SLOW = ("hysteresis", "presliding_friction")
BASE = {"coil_resistance": 8.0, "encoder_zero": 0.0}


@pytest.fixture(autouse=True)
def _as_it_was() -> Iterator[None]:
    before = dict(EFFECTS)
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


def _following(effect: Effect, old: str) -> Effect:
    """The effect with whatever it says of another one said of its new name."""
    return replace(
        effect, name=NEW if effect.name == old else effect.name,
        classes=tuple(replace(c, members=tuple(NEW if m == old else m for m in c.members))
                      for c in effect.classes),
        twins={NEW if n == old else n: convert for n, convert in effect.twins.items()},
        gives_way_to=tuple(NEW if n == old else n for n in effect.gives_way_to))


def rename(old: str) -> None:
    """Give one effect of the library another name, at its place."""
    renamed = [_following(effect, old) for effect in EFFECTS.values()]
    EFFECTS.clear()
    EFFECTS.update({effect.name: effect for effect in renamed})


def shaken(effect: Effect) -> dict[str, float]:
    """Parameters of the effect large enough to be seen; of a lag, which is soon too large."""
    factor = 1.0 if effect.searched else 30.0 if effect.late is None else 5.0
    return {n: factor * prior.typical if n in effect.sizes else prior.typical
            for n, prior in effect.priors.items()}


def answers(name: str, library: tuple[str, ...], model: Model) -> dict[str, Any]:
    """What `diagnose` and `identify`'s estimator say of one record with an effect in it."""
    feed = truth.multisine(7)[:SAMPLES]
    other = 1e-4 * truth.multisine(8)[:SAMPLES]
    current = model.base["force_constant"] * feed / 8.0
    from dfm_stage.model import Simulator

    moved = Simulator(model.with_effect(name, shaken(EFFECTS[name]))).run(feed, other=other)
    noisy = truth.record(feed, moved.output, 5)
    record = Record(noisy.time, noisy.sample_period, {
        "x": AxisRecord(feed, noisy.axes["x"].position, current=current),
        "y": AxisRecord(feed, other)}, Provenance("run", "csv"))
    found = diagnose([record], model, library=library).to_dict()
    fitted = fit_model(model.with_effect(name, shaken(EFFECTS[name])), [
        Run("run", feed, noisy.axes["x"].position, noisy.sample_period, other=other)],
        ("damping", "stiffness"), noise="white").estimate.to_dict()
    return {"diagnosis": found, "fit": fitted}


def words(thing: Any, old: str) -> Any:
    """The answer with the old name replaced wherever it stands."""
    text = json.dumps(thing, sort_keys=isinstance(thing, Mapping))
    return json.loads(text.replace(old, NEW).replace(old.replace("_", " "), NEW.replace("_", " ")))


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_another_name_changes_nothing_but_the_name(name: str) -> None:
    related = {m for c in EFFECTS[name].classes for m in c.members}
    fast = tuple(n for n in EFFECTS if n == name or (
        n not in SLOW and (n in BESIDE or n in related)))
    model = truth.believed(**BASE)
    before = answers(name, fast, model)
    rename(name)
    after = answers(NEW, tuple(NEW if n == name else n for n in fast), model)
    assert words(after, name) == words(before, name)


def test_the_test_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """A place that knows an effect by its name is found."""
    name, library = "cubic_stiffness", ("cubic_stiffness", "quadratic_damping")
    model = truth.believed(**BASE)
    before = answers(name, library, model)
    rename(name)
    starts = type(EFFECTS[NEW]).starts
    monkeypatch.setattr(Effect, "starts", lambda self, at: (
        [] if self.name == NEW else starts(self, at)))
    assert words(answers(NEW, (NEW, library[1]), model), name) != words(before, name)
