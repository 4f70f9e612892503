"""Formulas as text: what is accepted, how a mistake is told, and that nothing of it is run."""

from __future__ import annotations

import contextlib
import math
import random
import sys
import time
from typing import Any

import pytest

from dfm_stage.model.formula import formula_of
from dfm_stage.model.formula_text import FormulaError, degree, parse, value

PARAMETERS = {"k": {"value": 3.0, "unit": "N/m", "range": [0, 1e4]},
              "f": {"value": 0.1, "unit": "N", "range": [0, 10]},
              "d": {"value": 1e-3, "unit": "m"}}


def written(force: object, **more: object) -> dict[str, Any]:
    used = {n: p for n, p in PARAMETERS.items()
            if any(n in str(text) for text in (force, *dict(more.get("state", {})).values()))}  # type: ignore[call-overload]
    return {"name": "mine", "force": force, "parameters": used or PARAMETERS, **more}


@pytest.mark.parametrize(("text", "at", "expected"), [
    ("2 - 3 - 4", {}, -5.0), ("2 ** 3 ** 2", {}, 512.0), ("-x ** 2", {"x": 3.0}, -9.0),
    ("max(x, 2, v) / 4", {"x": 1.0, "v": 8.0}, 2.0),
    ("where(x > 0, 1, -1) * 5", {"x": -2.0}, -5.0),
    ("sign(x) + abs(x) + tanh(0)", {"x": -2.0}, 1.0), ("pow(x, 0.5) - sqrt(x)", {"x": 7.0}, 0.0),
    ("atan(tan(x)) + log(exp(x))", {"x": 0.3}, 0.6), ("sin(pi / 2) + cos(0) * 1e1", {}, 11.0),
    (" min(x,\n 2)", {"x": 5.0}, 2.0)])
def test_a_formula_means_what_it_says(text: str, at: dict[str, float], expected: float) -> None:
    assert value(parse(text, ["x", "v"]), at) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(("text", "column", "words"), [
    ("k * y", 5, "y is not known"), ("k * x + ", 8, "not understood"), ("k * x ^ 2", 7, "**"),
    ("k * x.real", 5, "no parts"), ("k * x['a']", 6, "[ has no place"),
    ("k * system(x)", 5, "system() is no function"), ("k * exp", 5, "exp is a function"),
    ("k * x / 0", 9, "division by zero"), ("k * x * sqrt(0 - 1)", 9, "not a finite number"),
    ("k * x + 9 ** 9 ** 9", 9, "not a finite number"), ("k * max(x)", 5, "2 to 8 arguments"),
    ("k * (x > 0)", 6, "only in where"), ("k * where(x, 1, 2)", 11, "begins with one comparison"),
    ("k * x if x else f", 1, "where"), ("k * (x, v)", 5, "belongs to no function"),
    ("k * x * 1j", 9, "is no number"), ("k * x * True", 9, "is no number"),
    ("k * x \u2212 f", 7, "minus of the keyboard"), ("k * x * 1e999", 9, "finite"),
    ("k * exp(x)", 9, "exp() takes a pure number"), ("k * x + f * v", 9, "they stand in one sum"),
    ("k * v", 1, "is in m kg/s^3, not in N"), ("k * x + f * sign(v)", 9, "jumps"),
    ("k * x - f * sign(v) * cos(x / d)", 9, "jumps"), ("f * sign(v - 0.1) + k * x", 1, "jump"),
    ("k * x * v / abs(v)", 1, "jumps"), ("f * where(v >= 0, 1, -2)", 1, "jumps"),
    ("k * abs(x, x)", 5, "takes 1 argument"), ("k * min(x, default=x)", 5, "arguments"),
    ("k * x - 2 * f * sign(v)", 9, "jumps")])
def test_a_mistake_is_one_line_with_its_place(text: str, column: int, words: str) -> None:
    with pytest.raises(FormulaError) as caught:
        formula_of(written(text)).effect()
    said = str(caught.value)
    assert f"column {column}:" in said
    assert words in said
    assert "\n" not in said


@pytest.mark.parametrize(("changed", "words"), [
    ({"name": "a b"}, "name"), ({"name": "mass"}, "name"), ({"name": None}, "name"),
    ({"force": None}, "exactly one"), ({"input": "k"}, "exactly one"), ({"force": ["k"]}, "text"),
    ({"parameters": {}}, "needs a parameter"), ({"parameters": [1]}, "mappings"),
    ({"parameters": {"k": 3}}, "value"), ({"parameters": {"k": {"value": math.nan}}}, "finite"),
    ({"parameters": {"v": {"value": 1}}}, "another word"),
    ({"parameters": {"k": {"value": 1, "unit": "furlong"}}}, "unit"),
    ({"parameters": {"k": {"value": 1, "range": [2, 3]}}}, "outside"),
    ({"parameters": {"k": {"value": 1, "range": [3, 0]}}}, "lowest"),
    ({"parameters": {"k": {"value": 1}, "j": {"value": 1}}}, "j is not used"),
    ({"state": {"k": "v"}}, "another word"), ({"state": {"z": "v"}}, "z is not used"),
    ({"force": "-k * z", "state": {"z": "v - x"}}, "column 5"),
    ({"force": "-k * sign(v)", "parameters": {"k": {"value": 1, "range": [-1, 1]}}}, "below"),
])
def test_an_entry_that_is_wrong_is_one_line(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(FormulaError, match=words) as caught:
        formula_of({**written("-k * x"), **changed}).effect()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [
    "-k * max(x - 0.001, 0)", "-f * tanh(v / 0.01)", "-k * x - f * sign(v)", "-9.81 * k * x",
    "-f * sign(v) * sqrt(abs(v) / 2.3)", "-k * where(v > 0.01, v - 0.01, 0) * 1.23e-4",
    "k * x * i * 0.001", "-f * (x / d) ** 3", "-f * exp(-(v / 0.3) ** 2)"])
def test_numbers_may_carry_a_unit_and_what_is_unknown_is_not_checked(text: str) -> None:
    formula_of(written(text)).effect()


@pytest.mark.parametrize(("text", "of", "power"), [
    ("k * x", "k", 1.0), ("k * max(x - d, 0)", "k", 1.0), ("k + 1", "k", None), ("x", "k", 0.0),
    ("sqrt(k * f) * x", "kf", 1.0), ("k * x + f", "k", None), ("k * x + f", "kf", 1.0),
    ("exp(k)", "k", None), ("f / k", "k", -1.0), ("f * sign(k)", "k", 0.0)])
def test_with_which_power_of_its_parameters_a_formula_grows(text: str, of: str,
                                                            power: float | None) -> None:
    assert degree(parse(text, ["x", "k", "f", "d"]), [*of]) == power


HOSTILE = (
    "__import__('os').system('touch {}')", "().__class__.__bases__[0].__subclasses__()",
    "eval('1')", "exec(k)", "open(k)", "k.__class__", "lambda: k", "[k for k in k]", "k := x",
    "(yield k)", "await k", "f'{{k}}'", "k if x else f", "k and x", "not k", "k @ x", "k // x",
    "k % x", "k << 9", "~k", "k; x", "*k", "**k", "k()", "k(x)", "x(k)", "sin", "max(*k)", "'k'",
    "9**9**9**9*k", "k**9**9**9", "1e308*1e308*k", "0*k/0", "k/(x-x)", "nan*k", "inf*k", "None",
    "0x" + "f" * 500, "1_0*k", "1" * 900, "\N{FULLWIDTH LATIN SMALL LETTER K}*x", "k\u200bx",
    "k\x00x", "\ud800", "k" * 999, "(" * 999, "-" * 999 + "k", "k+" * 499 + "k", "k**" * 300 + "k",
    "exp(" * 39 + "k" + ")" * 39, "a" * 1_000_000, "(" * 500_000 + ")" * 500_000, "#", "k#", "\\",
    "k\nx", "", " ", "1if 1else 2", "0o777*k", "0777*k", "1__0", "...", "k.", ".5.5", "1.e", "k,",
    "where(k)", "where(1, 2, 3)", "where(x > 0 > v, k, f)", "min()", "pow(0, -1)*k", "log(0)*k",
    "sign(sign(sign(v)))*k", "tan(pi/2)*k*x", "k*x/1e-320", "k*x*-0.0", "max(k*x, -k*x, k*v*d)")
ATOMS = ("x", "v", "u", "i", "t", "z", "k", "f", "d", "0", "1", "2", "0.5", "1e-3", "1e300", "pi")


def drawn(rng: random.Random, depth: int) -> str:
    """A formula at random; many are wrong in their units."""
    if depth == 0 or rng.random() < 0.2:
        return rng.choice(ATOMS)
    kind = rng.randrange(8)
    a, b = drawn(rng, depth - 1), drawn(rng, depth - 1)
    if kind < 4:
        return f"({a} {rng.choice(['+', '-', '*', '/', '**', '*', '+'])} {b})"
    if kind < 6:
        return f"{rng.choice(['abs', 'sign', 'sqrt', 'exp', 'log', 'sin', 'tanh', 'atan'])}({a})"
    if kind == 6:
        return f"{rng.choice(['min', 'max', 'pow'])}({a}, {b})"
    return f"where({a} {rng.choice(['<', '<=', '>', '>='])} {b}, {a}, {b})"


def spoilt(rng: random.Random, text: str) -> str:
    """A text with some characters changed."""
    letters = [*text]
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(len(letters) + 1)
        letters[place:place + rng.randrange(2)] = rng.choice("()+-*/.,<>=xkz_0e\"'[]{}:;@\\^λ \n")
    return "".join(letters)


def test_ten_thousand_formulas_end_in_an_answer_or_one_line(
        tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random, spoilt and hostile ones; an audit hook sees whatever would touch the machine."""
    monkeypatch.chdir(tmp_path)
    touched: list[str] = []
    watching = [True]

    def watch(event: str, _: object) -> None:
        if watching[0] and event in ("open", "os.system", "subprocess.Popen", "socket.connect",
                                     "os.posix_spawn", "import", "os.remove"):
            touched.append(event)

    rng = random.Random(20261)
    loose = {n: {"value": 0.5, **({} if n == "d" else {"range": [0, 2]})} for n in "kfd"}
    texts = [each.format(tmp_path / "touched") if "{}" in each else each for each in HOSTILE]
    while len(texts) < 10_000:
        text = drawn(rng, rng.randrange(1, 6))
        texts.append(spoilt(rng, text) if rng.random() < 0.3 else text)
    formula_of(written("-k * x")).effect()
    sys.addaudithook(watch)
    answers, longest = 0, 0.0
    for text in texts:
        begun = time.process_time()
        try:
            effect = formula_of({"name": "mine", "force": f"{text}", "state": {"z": "v - z"},
                                 "parameters": loose}).effect()
            del effect
            answers += 1
        except FormulaError as error:
            said = str(error)
            assert "\n" not in said, text[:100]
            assert len(said) < 600, text[:100]
            if "not used" in said:
                answers += _alone(text)
        longest = max(longest, time.process_time() - begun)
    watching[0] = False
    assert answers > 1000
    assert touched == []
    assert [*tmp_path.iterdir()] == []
    assert longest < 5.0        # a bound for hangs, not a measurement


def _alone(text: str) -> bool:
    """Whether a formula is one with the names that it has."""
    used = {n: {"value": 0.5} for n in "kfd" if n in text} | {"q": {"value": 1.0}}
    with contextlib.suppress(FormulaError):
        return len(formula_of({
            "name": "mine", "force": f"({text}) + q", "parameters": used,
            **({"state": {"z": "v - z"}} if "z" in text else {})}).effect().sizes) > 0
    return False
