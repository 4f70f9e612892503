"""Formulas at random, spoilt and hostile, as the JSON of the mapping that holds one."""

from __future__ import annotations

import json
import re
from random import Random
from typing import Any

from benchmarks.bytes_damage import NUMBERS, WORDS, junk, spoilt_tree

ATOMS = ("x", "v", "u", "i", "t", "z", "k", "f", "d", "0", "1", "2", "0.5", "1e-3", "1e300", "pi",
         "-1", "1e-320", "3", "k", "x", "v")
UNARY = ("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "atan", "-", "+")
HOSTILE = (
    "__import__('os').system('touch touched')", "().__class__.__bases__[0].__subclasses__()",
    "eval('1')", "exec(k)", "open(k)", "open('touched', 'w')", "k.__class__", "lambda: k",
    "[k for k in k]", "(k := x)", "(yield k)", "await k", "f'{k}'", "f'{__import__(\"os\")}'",
    "k if x else f", "k and x", "not k", "k @ x", "k // x", "k % x", "k << 9", "~k", "k; x", "*k",
    "**k", "k()", "k(x)", "x(k)", "sin", "max(*k)", "'k'", "9**9**9**9*k", "k**9**9**9",
    "1e308*1e308*k", "0*k/0", "k/(x-x)", "nan*k", "inf*k", "None", "True*k", "...",
    "0x" + "f" * 90,
    "1_0*k", "1" * 900, "k" * 999, "(" * 999, "-" * 999 + "k", "k+" * 499 + "k", "k**" * 300 + "k",
    "exp(" * 39 + "k" + ")" * 39, "a" * 100_000, "(" * 50_000 + ")" * 50_000, "#", "k#", "\\",
    "k\nx", "", " ", "1if 1else 2", "0o777*k", "0777*k", "1__0", "k.", ".5.5", "1.e", "k,", "1j*k",
    "where(k)", "where(1, 2, 3)", "where(x > 0 > v, k, f)", "min()", "pow(0, -1)*k", "log(0)*k",
    "sign(sign(sign(v)))*k", "tan(pi/2)*k*x", "k*x/1e-320", "k*x*-0.0", "max(k*x, -k*x, k*v*d)",
    "k\u200bx", "\uff4b*x", "k\0x", "k*\u0661", "breakpoint()", "globals()", "k.real", "x[0]",
    "{k: x}", "{k}", "[k]", "k is x", "k in x", "k = x", "del k", "import os", "pass", "assert k",
    "@k", "b'k'", "print(k)", "type(k)(x)", "abs.__globals__", "where(x > 0, eval('1'), k)")
LETTERS = "()+-*/.,<>=xkz_0e\"'[]{}:;@\\^λ \n%&|~!?#$`\t\0é"


def drawn(rng: Random, depth: int) -> str:
    """A formula at random; many are wrong in their units."""
    if depth == 0 or rng.random() < 0.2:
        return rng.choice(ATOMS)
    kind = rng.randrange(8)
    a, b = drawn(rng, depth - 1), drawn(rng, depth - 1)
    if kind < 4:
        return f"({a} {rng.choice(('+', '-', '*', '/', '**', '*', '+'))} {b})"
    if kind < 6:
        return f"{rng.choice(UNARY)}({a})"
    if kind == 6:
        return f"{rng.choice(('min', 'max', 'pow'))}({a}, {b})"
    return f"where({a} {rng.choice(('<', '<=', '>', '>='))} {b}, {a}, {b})"


def _spoilt(rng: Random, text: str) -> str:
    letters = [*text]
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(len(letters) + 1)
        letters[place:place + rng.randrange(2)] = rng.choice(LETTERS)
    return "".join(letters)


def _text(rng: Random) -> str:
    kind = rng.randrange(10)
    text = rng.choice(HOSTILE) if kind == 0 else drawn(rng, rng.randrange(1, 6))
    if kind == 1:
        text = text.replace(rng.choice(ATOMS), rng.choice(HOSTILE), 1)
    return _spoilt(rng, text) if kind in (2, 3) else text


def spoilt_formula(rng: Random) -> bytes:
    """The mapping of a formula; most use the parameters that they have."""
    text = _text(rng)
    kind = rng.choice(("force",) * 6 + ("input", "reading"))
    for name, other in {"input": {"x": "u", "v": "t", "i": "u", "z": "u"},
                        "reading": {"v": "x", "u": "t", "i": "x", "z": "x"}}.get(kind, {}).items():
        text = re.sub(rf"\b{name}\b", other, text)
    rates = {"z": rng.choice((_text(rng), "v - z / 0.1"))} if re.search(r"\bz\b", text) else {}
    if not re.search(r"\b[kfd]\b", text):
        text = f"({text}) * k"
    used = [n for n in "kfd" if re.search(rf"\b{n}\b", " ".join((text, *rates.values())))]
    parameters: dict[str, Any] = {
        n: {"value": 0.5, **({"range": [0, 2]} if rng.random() < 0.6 else {}),
            **({"unit": rng.choice(("N", "N/m", "m", "N s/m", "1", "m/s", "V", "kg m^2"))}
               if rng.random() < 0.3 else {})} for n in used or ["k"]}
    given: dict[str, Any] = {
        "name": "mine", kind: text,
        "parameters": parameters, **({"state": rates} if rates else {})}
    if rng.random() < 0.1:
        each = rng.choice([*parameters.values()])
        each[rng.choice(("value", "unit", "range"))] = rng.choice(
            (rng.choice(NUMBERS), [rng.choice(NUMBERS), rng.choice(NUMBERS)], rng.choice(WORDS),
             junk(rng)))
    if rng.random() < 0.1:
        spoilt = spoilt_tree(rng, given)
        given = spoilt if isinstance(spoilt, dict) else given   # files refuse what is no mapping
    return json.dumps(given).encode()
