"""tools/prose.py counts as a reader would, and names file, line and remedy."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))
prose = importlib.import_module("prose")


def lengths(text: str) -> list[int]:
    """Words of every sentence of some Markdown."""
    return [prose.count(sentence) for paragraph in prose.paragraphs(text)
            for sentence in paragraph.sentences()]


@pytest.mark.parametrize(("text", "expected"), [
    ("One two three. Four five!", [3, 2]),
    ("It is 0.5 m long, see ch. 4 of it.", [10]),
    ("Over two\nlines. Is it?", [3, 2]),
    ("Run `./run identify BAG --out DIR` on it.", [4]),
    ("See [the\npage](a_long/path.md#and-anchor) once.", [4]),
    ("With $a + b + c$ in it.", [4]),
    ("- First item\n- second item\n  goes on", [2, 4]),
    ("1. First.\n2. Second thing.", [1, 2]),
    ("# A heading\n| a | table |\n|---|---|\nText here.", [2]),
    ("```\ncode is no prose\n```\nText here.", [2]),
    ("<!-- hidden\nwords -->\nText here.", [2]),
    ("Before:\n\n    indented = code\n\nText here.", [1, 2]),
    ("$$\na = b\n$$\nText here.", [2]),
    ("> Quoted text\n> goes on.", [4]),
])
def test_words_are_counted_as_a_reader_does(text: str, expected: list[int]) -> None:
    assert lengths(text) == expected


@pytest.mark.parametrize(("text", "what"), [
    ("word " * 41 + ".\n" + "\n\nOne. " * 20, "t.md:1: 41 words in the sentence"),
    ("\n\n" + "Word word word. " * 41, "t.md:3: 123 words in a paragraph"),
    ("\n" + "word " * 17 + ".", "t.md:2: 17.0 words in the mean of 1 sentences"),
])
def test_each_rule_is_held_with_place_and_remedy(text: str, what: str) -> None:
    found = [str(each) for each in prose.complaints("t.md", (
        ("t.md", paragraph) for paragraph in prose.paragraphs(text)))]
    assert len(found) == 1
    assert found[0].startswith(what)
    assert "at most)" in found[0].rpartition("; ")[2]


def test_what_keeps_to_the_rules_is_not_told() -> None:
    text = ("word " * 40 + ". " + "Short. " * 80 + "\n\n") * 2
    assert prose.complaints("t.md", (("t.md", each) for each in prose.paragraphs(text))) == []


def test_of_a_docstring_types_and_titles_do_not_count() -> None:
    text = prose.without_fields(
        "What it does.\n\nParameters\n----------\nx : (N,) float, optional\n    Position, m.\n"
        "    Two lines.\n\nReturns\n-------\nfloat")
    assert lengths(text) == [3, 2, 2]


def test_only_what_the_package_exports_is_read(tmp_path: Path) -> None:
    file = tmp_path / "__init__.py"
    file.write_text('__all__ = ["f", "C"]\ndef f():\n    "Public."\ndef g():\n    "Own."\n'
                    'class C:\n    "A class."\n    def m(self):\n        "A method."\n'
                    '    def _n(self):\n        "Own."\n')
    names = prose.exported(file)
    found = [text for _, text in prose.docstrings(prose.ast.parse(file.read_text()), names)]
    assert found == ["Public.", "A class.", "A method."]


def test_the_exit_code_says_whether_the_pages_keep_to_the_rules(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for text, code in (("A short sentence.", 0), ("word " * 41 + ".", 1)):
        page.write_text(text)
        done = subprocess.run([sys.executable, ROOT / "tools/prose.py", page], check=False,
                              capture_output=True, text=True)
        assert done.returncode == code
        assert done.stdout.startswith("page.md:1: ") == bool(code)


def test_a_table_that_an_empty_line_tears_is_found() -> None:
    table = "| a | b |\n|---|---|\n| 1 | 2 |\n"
    assert list(prose.headless(f"Text.\n\n{table}\nMore.")) == []
    assert list(prose.headless(f"{table}\n| 3 | 4 |\n")) == [5]
    assert list(prose.headless(f"```\n| 3 | 4 |\n```\n{table}")) == []


def test_a_page_is_held_against_the_rule_of_tables(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("Text.\n\n| 3 | 4 |\n", "utf-8")
    complaint, = prose.of_page(page)
    assert str(complaint).startswith("page.md:3: a table without a line of headings")
