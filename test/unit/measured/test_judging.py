"""Right, silent and wrong answers are told apart."""

from __future__ import annotations

import pytest

from benchmarks.measured.judging import judge, names_of
from benchmarks.measured.records import Expected

FRICTION = Expected(("named", "partial", "ambiguous"), "because",
                    first=("coulomb_friction", "presliding_friction"),
                    also=("force_offset",), required=(("coulomb_friction",),))
RELATIVE = Expected(("unknown", "partial", "named"), "because", first=("cubic_stiffness",),
                    complete=False)
LINEAR = Expected(("none", "retune"), "because")


def answer(verdict: str, *names: str, **more: object) -> dict[str, object]:
    classes = [each.split("|") for each in names]
    effects = [{"name": members[0], "class": members} for members in classes]
    return {"verdict": verdict, "effects": effects, "description": None, **more}


@pytest.mark.parametrize(("expected", "given", "judged"), [
    (FRICTION, answer("named", "coulomb_friction"), "right"),
    (FRICTION, answer("partial", "coulomb_friction", "force_offset"), "right"),
    (FRICTION, answer("ambiguous", "presliding_friction|coulomb_friction"), "right"),
    (FRICTION, answer("unknown"), "silent"),
    (FRICTION, answer("named", "presliding_friction"), "silent"),
    (FRICTION, answer("none"), "wrong"),
    (FRICTION, answer("named", "second_mode"), "wrong"),
    (FRICTION, answer("named", "coulomb_friction", "second_mode"), "wrong"),
    (FRICTION, answer("ambiguous", "coulomb_friction|second_mode"), "wrong"),
    (FRICTION, answer("named", "force_offset", "coulomb_friction"), "wrong"),
    (RELATIVE, answer("unknown"), "right"),
    (RELATIVE, answer("partial", "cubic_stiffness"), "right"),
    (RELATIVE, answer("named", "cubic_stiffness", complete=False), "right"),
    (RELATIVE, answer("named", "cubic_stiffness"), "wrong"),
    (RELATIVE, answer("named", "cubic_stiffness", complete=True), "wrong"),
    (RELATIVE, answer("retune"), "wrong"),
    (LINEAR, answer("retune"), "right"),
    (LINEAR, answer("unknown"), "silent"),
    (LINEAR, answer("named", "cubic_stiffness"), "wrong"),
])
def test_answers_are_told_apart(expected, given, judged):
    assert judge(expected, given).judged == judged


def test_a_remainder_makes_a_name_of_schema_1_incomplete():
    given = answer("named", "cubic_stiffness", description={"parity": "odd"})
    assert judge(RELATIVE, given).judged == "right"


def test_a_class_is_one_name():
    assert names_of(answer("ambiguous", "creep|hysteresis", "force_offset")) == (
        "creep|hysteresis", "force_offset")
