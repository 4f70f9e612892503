"""In which order effects are looked for: those that explain a part, and those to the noise."""

from __future__ import annotations

from dataclasses import dataclass
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
    monkeypatch.setattr(explaining, "stays_open", lambda _: False)
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


def told(name: str, power: float) -> tuple[None, SimpleNamespace, SimpleNamespace]:
    h = SimpleNamespace(names=(name,) if name else (), fit=leaving(20.0))
    left = SimpleNamespace(held_out=SimpleNamespace(power=power))
    return None, h, SimpleNamespace(by=name, extended=left)


@pytest.mark.parametrize(("left", "whole", "forced", "by"), [
    (20.0, told("creep", 2.0), None, "creep"),                        # windows hide a slow motion
    (20.0, told("creep", 2.0), told("gravity", 1.0), "gravity"),      # told by where it drifts
    (20.0, told("creep", 2.0), told("gravity", 3.0), "creep"),
    (20.0, told("", 9.0), told("gravity", 3.0), "gravity"),
    (20.0, told("", 9.0), None, "windows"),
    (5.0, told("creep", 2.0), told("gravity", 1.0), "noise")])        # all may be explained
def test_what_windows_do_not_tell_is_looked_for_in_whole_records_and_in_forces(
        left, whole, forced, by, monkeypatch):
    """A bench searched for all that reaches the noise for 100 s, with 67 times as much left."""
    trial = SimpleNamespace(search=Gap(left, left), lag=1,
                            witness=SimpleNamespace(cannot_tell=False))
    first = leaving(50.0)
    first.system.springless = True
    monkeypatch.setattr(explaining, "is_gross", lambda *_: True)
    monkeypatch.setattr(explaining, "stays_open", lambda _: False)
    monkeypatch.setattr(explaining, "_in_windows", lambda _: SimpleNamespace(
        search=SimpleNamespace(begin=lambda: first)))
    monkeypatch.setattr(explaining, "graded", lambda *_: (
        SimpleNamespace(names=(), fit=first), SimpleNamespace(by="windows")))
    monkeypatch.setattr(explaining, "_explaining", lambda *_: whole)
    monkeypatch.setattr(explaining, "_by_force", lambda *_: forced)
    monkeypatch.setattr(explaining, "to_noise", lambda *_: told("noise", 0.0)[1:])
    monkeypatch.setattr(explaining, "needs_grading", lambda _: False)
    assert explaining.explained(trial, first, (), split=False)[2].by == by


@pytest.mark.parametrize(("lag", "gross"), [(1, True), (16, False)])
def test_noise_alone_is_no_gross_gap_of_a_finely_sampled_body(lag, gross):
    """From sample to sample, noise makes up more than half of the change of a slow motion."""
    rng = np.random.default_rng(3)
    left = 2e-4 * rng.standard_normal(10_000)
    run = SimpleNamespace(output=np.sin(0.63e-3 * np.arange(10_000)) + left)
    bare = SimpleNamespace(system=SimpleNamespace(runs=[run]), residuals=[[left]])
    assert explaining.is_gross(bare, lag) == gross


@dataclass
class Tried:
    search: SearchTried
    dropped: dict[str, str]


@dataclass
class SearchTried:
    runs: list[SimpleNamespace]
    barred: set[str]


@pytest.mark.parametrize(("names", "left", "stands", "window", "taken"), [
    (("creep",), 1.05, True, 0, True),
    (("cogging",), 1.05, True, 0, False),     # the search ended with it
    (("creep",), 1.1, True, 0, False),        # more than noise is left
    (("creep",), 1.05, False, 0, False),      # its effects do not stand, though noise be left
    (("creep",), 1.05, True, 9, False),       # of windows, another noise is left
    ((), 1.05, True, 0, False)])
def test_effects_of_a_part_that_come_near_the_noise_are_gone_on_from(
        names, left, stands, window, taken, monkeypatch):
    """The work of a search may end in the fits of an effect with many parameters; what it dropped
    beside that one may be right."""
    trial = Tried(SearchTried([SimpleNamespace(window=window)], {"creep"}), {"creep": "why"})
    ended = SimpleNamespace(names=("cogging",))
    part = trial, SimpleNamespace(names=names, fit=leaving(left)), "graded"

    def to_noise(own, begun, *_):
        assert (own.search.barred, own.dropped) == (set(), {})
        own.dropped["hysteresis"] = "tried"
        return begun, "tested"

    monkeypatch.setattr(explaining, "to_noise", to_noise)
    monkeypatch.setattr(explaining, "judge_hypothesis",
                        lambda _: SimpleNamespace(stands=stands))
    found = explaining._near_noise(ended, part, (), False)
    assert found[1:] == ((names, "tested") if taken else part[1:])
    assert (trial.search.barred, trial.dropped) == ({"creep"}, {"creep": "why"})
