"""Whether an answer (diagnosis.json, schema 1 or 2) is the one that was expected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from benchmarks.measured.records import Expected

WITH_NAMES = ("named", "partial", "ambiguous")
Judged = Literal["right", "silent", "wrong"]


@dataclass(frozen=True)
class Judgement:
    """`right`, or `wrong` (it says what is not so), or `silent` (it does not say what is)."""

    judged: Judged
    reason: str


def names_of(answer: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of the effects found, a class of several as `a|b`, in their order."""
    return tuple("|".join(dict.fromkeys((effect["name"], *effect.get("class", ()))))
                 for effect in answer.get("effects", ()))


def is_complete(answer: Mapping[str, Any]) -> bool:
    """Whether the answer claims that nothing but noise is left."""
    return bool(answer.get("complete", answer["verdict"] == "named"
                           and answer.get("description") is None))


def judge(expected: Expected, answer: Mapping[str, Any]) -> Judgement:
    """Compare an answer with what was expected of it."""
    verdict = answer["verdict"]
    effects: Sequence[Mapping[str, Any]] = answer.get("effects", ())
    if verdict not in WITH_NAMES or not effects:
        if verdict in expected.verdicts:
            return Judgement("right", f"`{verdict}`, as expected")
        said = "says that nothing is missing" if verdict in ("none", "retune") else "names nothing"
        wrong: Judged = "wrong" if verdict in ("none", "retune") else "silent"
        return Judgement(wrong, f"`{verdict}` {said}")
    members = [{effect["name"], *effect.get("class", ())} for effect in effects]
    strangers = sorted(name for each in members for name in each - expected.allowed)
    if strangers:
        return Judgement("wrong", f"{', '.join(strangers)}: not expected")
    if verdict not in expected.verdicts:
        return Judgement("wrong", f"`{verdict}` was not expected")
    if expected.first and not members[0] & set(expected.first):
        return Judgement("wrong", f"{effects[0]['name']} comes first")
    found = set().union(*members)
    missing = [" or ".join(group) for group in expected.required if not found & set(group)]
    if missing:
        return Judgement("silent", f"{', '.join(missing)} is not named")
    if expected.complete is False and is_complete(answer):
        return Judgement("wrong", "complete, though something known is in no library")
    return Judgement("right", f"`{verdict}`, as expected")
