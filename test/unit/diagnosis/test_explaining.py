"""In which order effects are looked for: those that explain a part, and those to the noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dfm_stage.diagnosis import explaining


class Gap:
    """A search whose first effects leave `left` times the noise, and `minimum` in a fit begun
    anew; one by itself leaves `alone` times the noise."""

    def __init__(self, left: float, minimum: float, alone: float = 99.0) -> None:
        self.left, self.minimum, self.by_itself = left, minimum, alone

    def begin_work(self, _: float) -> None:
        pass

    def alone(self, *_: object) -> tuple[tuple[str, ...], SimpleNamespace]:
        return ("cogging",), leaving(self.by_itself)

    def grown(self, *_: object, **__: object) -> tuple[tuple[str, ...], SimpleNamespace]:
        return ("creep",), leaving(self.left)

    def restarted(self, *_: object) -> SimpleNamespace:
        return leaving(self.minimum)


def leaving(rms: float) -> SimpleNamespace:
    return SimpleNamespace(ok=True, chi2=100.0 * rms**2, white=np.zeros(100),
                           system=SimpleNamespace(springless=False, runs=[
                               SimpleNamespace(driven=True)]))


@pytest.mark.parametrize(("left", "minimum", "on"), [
    (10.0, 10.0, False),    # nothing explains a part, and the noise is far
    (10.0, 1.0, True),      # the fit had ended in a far minimum
    (1.2, 1.2, True)])      # no gross remainder
def test_the_search_to_the_noise_ends_where_nothing_explains_a_part(
        left, minimum, on, monkeypatch):
    nothing = SimpleNamespace(names=(), fit=leaving(left))
    trial = SimpleNamespace(search=Gap(left, minimum), witness=None)
    monkeypatch.setattr(explaining, "_explaining", lambda *_: (trial, nothing, "graded"))
    monkeypatch.setattr(explaining, "is_far", lambda _: True)
    monkeypatch.setattr(explaining, "to_noise", lambda *_: (nothing, "tested"))
    monkeypatch.setattr(explaining, "needs_grading", lambda _: False)
    found = explaining.explained(trial, leaving(50.0), (), split=False)
    assert found[2] == ("tested" if on else "graded")


@pytest.mark.parametrize(("alone", "begun"), [(1.0, ("cogging",)), (1.2, ("creep",))])
def test_one_effect_that_leaves_only_noise_is_gone_on_from(alone, begun, monkeypatch):
    trial = SimpleNamespace(search=Gap(1.2, 1.2, alone), witness=None)
    monkeypatch.setattr(explaining, "to_noise", lambda _, names, *__: (names, "tested"))
    monkeypatch.setattr(explaining, "needs_grading", lambda _: False)
    assert explaining.explained(trial, leaving(50.0), (), split=False)[1] == begun


@pytest.mark.parametrize(("far", "on"), [(True, False), (False, True)])
def test_no_search_to_the_noise_goes_on_from_a_part_that_leaves_far_more(far, on, monkeypatch):
    """A bench whose second mode left 67 times the noise took 100 s of its 180 s like that."""
    a_part = SimpleNamespace(names=("creep",), fit=leaving(10.0))
    trial = SimpleNamespace(search=Gap(10.0, 10.0), witness=None)
    monkeypatch.setattr(explaining, "_explaining", lambda *_: (trial, a_part, "graded"))
    monkeypatch.setattr(explaining, "is_far", lambda _: far)
    monkeypatch.setattr(explaining, "to_noise", lambda *_: (a_part, "tested"))
    monkeypatch.setattr(explaining, "needs_grading", lambda _: False)
    found = explaining.explained(trial, leaving(50.0), (), split=False)
    assert found[2] == ("tested" if on else "graded")


@pytest.mark.parametrize(("whole", "told"), [
    (("creep",), "in whole"),     # windows hide a slow motion
    ((), "in windows")])          # nothing either way: judged where it can be judged
def test_what_windows_do_not_tell_is_looked_for_in_whole_records(whole, told, monkeypatch):
    trial = SimpleNamespace(search=Gap(10.0, 10.0), witness=SimpleNamespace(cannot_tell=False))
    first = leaving(50.0)
    first.system.springless = True
    monkeypatch.setattr(explaining, "is_gross", lambda _: True)
    monkeypatch.setattr(explaining, "is_far", lambda _: True)
    monkeypatch.setattr(explaining, "stays_open", lambda _: False)
    monkeypatch.setattr(explaining, "_in_windows", lambda _: SimpleNamespace(
        search=SimpleNamespace(begin=lambda: first)))
    monkeypatch.setattr(explaining, "graded", lambda *_: (
        SimpleNamespace(names=(), fit=first), "in windows"))
    monkeypatch.setattr(explaining, "_explaining", lambda *_: (
        trial, SimpleNamespace(names=whole, fit=leaving(10.0)), "in whole"))
    monkeypatch.setattr(explaining, "_by_force", lambda *_: None)
    assert explaining.explained(trial, first, (), split=False)[2] == told


def test_the_force_balance_is_asked_before_whole_records_where_windows_tell_nothing(monkeypatch):
    """A pendulum's free swing was told as gravity and a brake by where its phase drifts; its
    force balance shows gravity at once."""
    trial = SimpleNamespace(search=Gap(10.0, 10.0), witness=SimpleNamespace(cannot_tell=False))
    first = leaving(50.0)
    first.system.springless = True
    monkeypatch.setattr(explaining, "is_gross", lambda _: True)
    monkeypatch.setattr(explaining, "stays_open", lambda _: False)
    monkeypatch.setattr(explaining, "_in_windows", lambda _: SimpleNamespace(
        search=SimpleNamespace(begin=lambda: first)))
    monkeypatch.setattr(explaining, "graded", lambda *_: (
        SimpleNamespace(names=(), fit=first), "in windows"))
    monkeypatch.setattr(explaining, "_by_force", lambda *_: (trial, first, "by force"))
    monkeypatch.setattr(explaining, "_explaining", lambda *_: pytest.fail("judged by its drift"))
    assert explaining.explained(trial, first, (), split=False)[2] == "by force"
