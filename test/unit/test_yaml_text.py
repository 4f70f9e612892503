"""YAML from outside: what it holds, and what is refused in time."""

from __future__ import annotations

import contextlib
import time

import pytest

from dfm_stage.yaml_text import DEEPEST, LONGEST, MOST_NODES, YamlError, load_yaml


def laughs(levels: int, width: int) -> str:
    lines = ["a0: &a0 [x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * width)}]" for k in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("layout", [False, True])
def test_aliases_mean_what_they_repeat(layout: bool) -> None:
    assert load_yaml("a: &a {k: [1, 2]}\nb: *a\nc: {<<: *a, d: 3}\n", layout) == {
        "a": {"k": [1, 2]}, "b": {"k": [1, 2]}, "c": {"k": [1, 2], "d": 3}}
    assert load_yaml(laughs(3, 3), layout)["a1"] == [["x"]] * 3
    assert len(load_yaml(laughs(3, 3), layout)["a2"]) == 3


@pytest.mark.parametrize("layout", [False, True])
@pytest.mark.parametrize(("text", "line", "words"), [
    (laughs(9, 9), 6, f"more than {MOST_NODES} values"),
    ("a: 1\nb: &b [*b]", 2, "b holds itself"),
    ("a: &a {<<: *a}", 1, "a holds itself"),
    ("[" * 30_000, 1, f"more than {DEEPEST} levels"),
    ("a: 1\nb: " + "9" * 5000, 2, "a number of 5000 digits"),
    ("a: 0x" + "f" * 5000, 1, "a number of 5002 digits"),
    ("#" * (LONGEST + 1), None, f"more than {LONGEST} characters"),
    ("a: *b", 1, "undefined alias"),
    ("a: 1\nb: {", None, "expected"),
])
def test_one_line_in_time(text: str, line: int | None, words: str, layout: bool) -> None:
    begun = time.process_time()
    with pytest.raises(YamlError, match=words) as caught:
        load_yaml(text, layout)
    assert len(str(caught.value).splitlines()) == 1
    assert line is None or caught.value.line == line
    assert time.process_time() - begun < 10.0       # a bound for hangs, not a measurement


@pytest.mark.parametrize("text", [
    "!!float {}", "!!set [1]", "!!timestamp x", "<<: 3", "? {a: 1}\n: 2", "!!binary é", "\0",
    "a: !!python/object/apply:os.system [ls]"])
@pytest.mark.parametrize("layout", [False, True])
def test_whatever_the_library_raises_is_one_error(text: str, layout: bool) -> None:
    with contextlib.suppress(YamlError):
        load_yaml(text, layout)
