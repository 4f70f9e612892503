"""The text of a formula, read by a whitelist into a tree of our own; nothing of it is run.

Python's parser splits the text; of its tree only numbers, names that were announced, the
operators + - * / **, comparisons and the functions of `FUNCTIONS` are accepted, and copied.
"""

from __future__ import annotations

import ast
import difflib
import math
import re
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from dfm_stage.model.parameter import ModelError

LONGEST, DEEPEST, MOST_NODES, MOST_BRACKETS = 1000, 100, 400, 40
"""Characters, nested operations, operations and open brackets of one formula: far more than a
force needs, and few enough for every parser and compiler behind it."""
FUNCTIONS: dict[str, tuple[int, int]] = {
    **dict.fromkeys(("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tan", "atan", "tanh"),
                    (1, 1)),
    "min": (2, 8), "max": (2, 8), "pow": (2, 2), "where": (3, 3)}
"""Function -> the fewest and the most arguments."""
CONSTANTS = {"pi": math.pi}
COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
_OPERATORS: dict[type[ast.operator], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_STRANGE = re.compile(r"[^A-Za-z0-9_ \t\n+\-*/().,<>=]")
_INSTEAD = {"^": "; a power is **", "−": "; use the minus of the keyboard",
            "·": "; a product is *", "×": "; a product is *"}
_WRONG: dict[type[ast.AST], str] = {
    ast.Attribute: "a name has no parts; a dot belongs inside a number",
    ast.IfExp: "write where(condition, a, b)", ast.BoolOp: "write one where() inside another",
    ast.Tuple: "this comma belongs to no function", ast.Starred: "a star stands alone here",
    ast.Lambda: "a formula is one expression"}


class FormulaError(ModelError):
    """A formula cannot be used; the message says what and at which column."""


@dataclass(frozen=True)
class Node:
    """An operation, a `number` or a `name`, and the column where it begins (from 1)."""

    kind: str
    parts: tuple[Node, ...] = ()
    name: str = ""
    number: float = 0.0
    column: int = 1

    def walk(self) -> Iterator[Node]:
        """This node and all below it."""
        yield self
        for part in self.parts:
            yield from part.walk()

    @property
    def names(self) -> frozenset[str]:
        """The names of parameters, states and variables in it."""
        return frozenset(node.name for node in self.walk() if node.kind == "name")

    def text(self) -> str:
        """The formula again, with all its brackets."""
        if self.kind == "number":
            return f"{self.number:g}"
        if self.kind == "name":
            return self.name
        inner = [part.text() for part in self.parts]
        if self.kind == "negative":
            return f"-{inner[0]}"
        if self.kind in FUNCTIONS:
            return f"{self.kind}({', '.join(inner)})"
        return f"({inner[0]} {self.kind} {inner[1]})"


def parse(text: str, known: Collection[str]) -> Node:
    """The tree of a formula over the names `known`.

    Raises
    ------
    FormulaError
        If it is no such formula; one line with the column.
    """
    _check_text(text)
    begin = len(text) - len(text.lstrip())
    try:
        with warnings.catch_warnings():         # of what is refused anyway
            warnings.simplefilter("ignore")
            tree = ast.parse(re.sub(r"\s", " ", text).strip(), mode="eval")
    except SyntaxError as error:
        at = min((error.offset or len(text)) + begin, len(text))
        fail(at, f"is not understood{_near(text, at)}")
    except (RecursionError, MemoryError, ValueError):
        fail(1, f"more than {DEEPEST} operations inside each other; use parameters")
    count = sum(1 for _ in ast.walk(tree))
    if count > 3 * MOST_NODES:
        fail(1, f"more than {MOST_NODES} operations")
    return _Reader(known, begin).read(tree.body, 0)


def shown(thing: object) -> str:
    """A thing from a file, short enough for a line; of a collection only what it is."""
    if thing is None or isinstance(thing, (str, int, float)):
        return repr(thing[:40] if isinstance(thing, str) else thing)[:44]
    return f"a {type(thing).__name__}"


def fail(column: int, reason: str) -> NoReturn:
    """Refuse a formula.

    Raises
    ------
    FormulaError
        Always.
    """
    raise FormulaError(f"column {column}: {reason}")


def _check_text(text: str) -> None:
    if not text.strip():
        raise FormulaError("the formula is empty")
    if len(text) > LONGEST:
        raise FormulaError(f"the formula has {len(text)} characters; {LONGEST} are allowed")
    strange = _STRANGE.search(text)
    if strange:
        shown = strange[0] if strange[0].isprintable() else repr(strange[0])[1:-1]
        fail(strange.start() + 1, f"{shown} has no place in a formula"
             f"{_INSTEAD.get(strange[0], '')}")
    depth = 0
    for column, letter in enumerate(text, 1):
        depth += (letter == "(") - (letter == ")")
        if depth > MOST_BRACKETS:
            fail(column, f"more than {MOST_BRACKETS} brackets inside each other")


def _near(text: str, column: int) -> str:
    word = text[max(column - 1, 0):column + 11].strip()
    return f" near {word}" if word else "; it ends too early"


class _Reader:
    """Copies what is on the whitelist."""

    def __init__(self, known: Collection[str], begin: int) -> None:
        self.known, self.begin = known, begin

    def read(self, tree: ast.expr, depth: int) -> Node:
        """The node of one part of Python's tree."""
        at = tree.col_offset + self.begin + 1
        if depth > DEEPEST:
            fail(at, f"more than {DEEPEST} operations inside each other; use parameters")
        if isinstance(tree, ast.Constant):
            return _number(tree.value, at)
        if isinstance(tree, ast.Name):
            return self._name(tree.id, at)
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, (ast.USub, ast.UAdd)):
            inner = self.read(tree.operand, depth + 1)
            return _folded("negative", (inner,), at) if isinstance(tree.op, ast.USub) else inner
        if isinstance(tree, ast.BinOp) and type(tree.op) in _OPERATORS:
            parts = self.read(tree.left, depth + 1), self.read(tree.right, depth + 1)
            return _folded(_OPERATORS[type(tree.op)], parts, at)
        if isinstance(tree, ast.Call):
            return self._call(tree, at, depth)
        if isinstance(tree, ast.Compare):
            fail(at, "a comparison stands only in where(condition, a, b)")
        fail(at, _WRONG.get(type(tree), "this has no place in a formula"))

    def _name(self, name: str, at: int) -> Node:
        if name in CONSTANTS and name not in self.known:
            return Node("number", number=CONSTANTS[name], column=at)
        if name not in self.known:
            if name in FUNCTIONS:
                fail(at, f"{name} is a function; write {name}(...)")
            near = difflib.get_close_matches(name, [*self.known, *FUNCTIONS], 1)
            known = f"did you mean {near[0]}?" if near else f"known are {', '.join(self.known)}"
            fail(at, f"{name[:40]} is not known; {known}")
        return Node("name", name=name, column=at)

    def _call(self, tree: ast.Call, at: int, depth: int) -> Node:
        name = tree.func.id if isinstance(tree.func, ast.Name) else ""
        if name not in FUNCTIONS:
            near = difflib.get_close_matches(name, FUNCTIONS, 1)
            known = f"did you mean {near[0]}?" if near else \
                f"functions are {', '.join(FUNCTIONS)}"
            fail(at, f"{name[:40]}() is no function here; {known}" if name
                 else "only a named function can be called")
        low, high = FUNCTIONS[name]
        if tree.keywords or not low <= len(tree.args) <= high:
            count = f"{low}" if low == high else f"{low} to {high}"
            fail(at, f"{name}() takes {count} argument{'s' * (high > 1)}")
        if name == "where":
            parts = (self._condition(tree.args[0], depth + 1),
                     *(self.read(arg, depth + 1) for arg in tree.args[1:]))
            return Node("where", parts, column=at)
        parts = tuple(self.read(arg, depth + 1) for arg in tree.args)
        return _folded("**" if name == "pow" else name, parts, at)

    def _condition(self, tree: ast.expr, depth: int) -> Node:
        at = tree.col_offset + self.begin + 1
        if not isinstance(tree, ast.Compare) or len(tree.ops) != 1 \
                or type(tree.ops[0]) not in COMPARISONS:
            fail(at, "where() begins with one comparison such as x > x0")
        parts = self.read(tree.left, depth), self.read(tree.comparators[0], depth)
        return Node(COMPARISONS[type(tree.ops[0])], parts, column=at)


def _number(value: object, at: int) -> Node:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        fail(at, f"{str(value)[:40]} is no number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        fail(at, "a number must be finite")
    return Node("number", number=number, column=at)


def _folded(kind: str, parts: tuple[Node, ...], at: int) -> Node:
    """The operation; of numbers alone its value, so that what has none is found here."""
    node = Node(kind, parts, column=at)
    if kind == "/" and parts[1].kind == "number" and parts[1].number == 0.0:
        fail(parts[1].column, "a division by zero")
    if any(part.kind != "number" for part in parts):
        return node
    number = float(value(node, {}))
    if not math.isfinite(number):
        fail(at, f"{node.text()[:60]} is not a finite number")
    return Node("number", number=number, column=at)


def degree(node: Node, of: Collection[str]) -> float | None:
    """With which power the value grows when all names `of` grow by one positive factor.

    0 where it does not depend on them, None where it is no power; `math.nan` for a zero, which
    has any.
    """
    if node.kind == "number":
        return math.nan if node.number == 0.0 else 0.0
    if node.kind == "name":
        return 1.0 if node.name in of else 0.0
    found = [degree(part, of) for part in node.parts]
    if any(each is None for each in found):
        return None
    own = [each for each in found if each is not None]
    return _degree(node, own)


def _degree(node: Node, own: list[float]) -> float | None:
    if node.kind in ("negative", "abs"):
        return own[0]
    if node.kind in ("*", "/"):
        return own[0] + own[1] if node.kind == "*" else own[0] - own[1]
    if node.kind == "**" and node.parts[1].kind == "number":
        return own[0] * node.parts[1].number
    if node.kind == "sqrt":
        return 0.5 * own[0]
    if node.kind in ("+", "-", "min", "max", "where"):
        sure = {each for each in own[node.kind == "where":] if not math.isnan(each)}
        if node.kind == "where" and own[0] != 0.0:
            return None
        return (sure.pop() if sure else math.nan) if len(sure) <= 1 else None
    if node.kind == "sign" or node.kind in COMPARISONS.values():
        sure = {each for each in own if not math.isnan(each)}
        return 0.0 if len(sure) <= 1 else None
    return 0.0 if not any(own) else None


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power,
    "negative": np.negative, "abs": np.abs, "<": np.less, "<=": np.less_equal, ">": np.greater,
    ">=": np.greater_equal, "where": np.where, "sign": np.sign, "sqrt": np.sqrt, "exp": np.exp,
    "log": np.log, "sin": np.sin, "cos": np.cos, "tan": np.tan, "atan": np.arctan,
    "tanh": np.tanh}


def value(node: Node, given: Mapping[str, Any]) -> Any:
    """The value at `given` names, which may be arrays; NaN or infinite where it has none."""
    with np.errstate(all="ignore"):
        return _value(node, given)


def _value(node: Node, given: Mapping[str, Any]) -> Any:
    if node.kind == "number":
        return np.float64(node.number)
    if node.kind == "name":
        return np.asarray(given[node.name], dtype=np.float64)
    parts = [_value(part, given) for part in node.parts]
    if node.kind in ("min", "max"):
        pick = np.minimum if node.kind == "min" else np.maximum
        for other in parts[1:]:
            parts[0] = pick(parts[0], other)
        return parts[0]
    return _OPERATIONS[node.kind](*parts)
