"""Countable rules of prose and tables, for the pages and the docstrings of the public interface.

Run by ./run lint, or alone: `./run exec python tools/prose.py [FILE ...]`. Code, tables, headings,
formulas and the targets of links do not count. The mean is that of a page, or of a package.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MEAN_WORDS = 16
LONGEST_SENTENCE = 40
LONGEST_PARAGRAPH = 120
PUBLIC = ("", "model", "recording", "identification", "diagnosis", "control")
"""Packages of dfm_stage whose `__all__` is the public interface; docs/library.md says so."""

_FENCED = re.compile(r"^( *)(```|~~~).*?^\1\2 *$", re.DOTALL | re.MULTILINE)
_HIDDEN = (_FENCED, re.compile(r"<!--.*?-->", re.DOTALL), re.compile(r"\$\$.*?\$\$", re.DOTALL),
           re.compile(r"\A---\n.*?^---$", re.DOTALL | re.MULTILINE))
_INLINE = ((re.compile(r"!\[[^\]]*\]\([^)]*\)"), ""), (re.compile(r"``[^`]+``|`[^`]*`"), "Code"),
           (re.compile(r"\$[^$\n]+\$"), "Formula"),
           (re.compile(r"\[((?:[^\]\[]|\[[^\]]*\])*)\]\([^)]*\)"), r"\1"),
           (re.compile(r"[*_]{1,3}(?=\S)|(?<=\S)[*_]{1,3}"), ""))
_NO_PROSE = re.compile(r"\s*(\||#|>>>|\.\.\. |:::|!!! |- *\[ \])")
_RULE = re.compile(r"\|[\s:|-]*-[\s:|-]*\|\s*")
_ITEM = re.compile(r"\s*(?:[-*+]|\d+[.)])\s+")
_SHORT = re.compile(r"\b(e\.g|i\.e|cf|vs|ch|sec|fig|figs|eq|eqs|no|al|approx|resp|St)\.(?=\s)",
                    re.IGNORECASE)
_END = re.compile(r"(?<=[.!?])[)\"'”]*\s+(?=[\"'“(]*[A-Z0-9À-Þ±])")
_WORD = re.compile(r"[^\W_]")


@dataclass(frozen=True)
class Paragraph:
    """Text without its markup, and the line where it begins."""

    line: int
    text: str

    def sentences(self) -> list[str]:
        """Split at full stops, question and exclamation marks."""
        whole = _SHORT.sub(r"\1", self.text)
        return [part for part in _END.split(whole) if count(part)]


@dataclass(frozen=True)
class Complaint:
    """What breaks a rule, where, and the remedy."""

    place: str
    line: int
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.place}:{self.line}: {self.what}; {self.remedy}"


def count(text: str) -> int:
    """Count the words, each of them with a letter or a digit."""
    return sum(1 for word in text.split() if _WORD.search(word))


def paragraphs(text: str, first_line: int = 1) -> Iterator[Paragraph]:
    """Yield the paragraphs of Markdown text; each item of a list is one."""
    for hidden in _HIDDEN:
        text = hidden.sub(lambda found: "\n" * found[0].count("\n"), text)
    gathered: list[str] = []
    begun, in_item, after_blank = first_line, False, True
    for number, line in enumerate([*text.split("\n"), ""], first_line):
        item = _ITEM.match(line)
        indented_code = line.startswith("    ") and after_blank and not in_item
        after_blank = not line.strip() or indented_code
        if gathered and (item or not line.strip() or _NO_PROSE.match(line)):
            yield Paragraph(begun, _plain(" ".join(gathered)))
            gathered = []
        in_item = bool(item) or (in_item and (not line.strip() or line.startswith(" ")))
        if not line.strip() or indented_code or _NO_PROSE.match(line):
            continue
        if not gathered:
            begun = number
        gathered.append(line[item.end():] if item else line.lstrip(" >"))


def _plain(text: str) -> str:
    for pattern, instead in _INLINE:
        text = pattern.sub(instead, text)
    return text


def complaints(place: str, parts: Iterable[tuple[str, Paragraph]]) -> list[Complaint]:
    """Hold the paragraphs, each with the file that it is from, against the three rules."""
    found: list[Complaint] = []
    lengths: list[int] = []
    first = 1
    for file, paragraph in parts:
        first = first if lengths else paragraph.line
        words = [count(sentence) for sentence in paragraph.sentences()]
        lengths += words
        if words and max(words) > LONGEST_SENTENCE:
            begins = " ".join(paragraph.sentences()[words.index(max(words))].split()[:6])
            found.append(Complaint(file, paragraph.line, f"{max(words)} words in the sentence "
                                   f"{begins!r} ...", f"split it ({LONGEST_SENTENCE} at most)"))
        if sum(words) > LONGEST_PARAGRAPH:
            found.append(Complaint(file, paragraph.line, f"{sum(words)} words in a paragraph",
                                   f"divide it ({LONGEST_PARAGRAPH} at most)"))
    mean = sum(lengths) / max(len(lengths), 1)
    if mean > MEAN_WORDS:
        found.append(Complaint(place, first, f"{mean:.1f} words in the mean of "
                               f"{len(lengths)} sentences",
                               f"give each idea its own sentence ({MEAN_WORDS} at most)"))
    return found


def of_page(page: Path) -> list[Complaint]:
    """Hold one page against the rules."""
    name, text = _name(page), page.read_text("utf-8")
    return complaints(name, ((name, each) for each in paragraphs(text))) + [
        Complaint(name, line, "a table without a line of headings",
                  "delete the empty line above, or give it headings") for line in headless(text)]


def headless(text: str) -> Iterator[int]:
    """Yield the lines at which a table begins without headings: no reader shows it as a table."""
    for hidden in _HIDDEN:
        text = hidden.sub(lambda found: "\n" * found[0].count("\n"), text)
    lines = ["", *text.split("\n"), ""]
    for number, (before, line, after) in enumerate(zip(lines, lines[1:], lines[2:],
                                                       strict=False), 1):
        if line.startswith("|") and not before.startswith("|") and not _RULE.fullmatch(after):
            yield number


def of_package(package: str) -> list[Complaint]:
    """Hold the docstrings of one public package, and of what it exports, against the rules."""
    folder = ROOT / "dfm_stage" / package
    names = exported(folder / "__init__.py")
    parts = []
    for file in sorted(folder.glob("*.py")) if package else [folder / "__init__.py"]:
        for line, text in docstrings(ast.parse(file.read_text("utf-8")), names):
            parts += [(_name(file), each) for each in paragraphs(without_fields(text), line)]
    return complaints(_name(folder), parts)


def exported(init: Path) -> set[str]:
    """Read the `__all__` of a package without importing it."""
    for node in ast.parse(init.read_text("utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def docstrings(module: ast.Module, names: set[str]) -> Iterator[tuple[int, str]]:
    """Yield the docstrings of these functions and classes, public methods included."""
    for node in module.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name not in names:
            continue
        members = node.body if isinstance(node, ast.ClassDef) else []
        methods = [m for m in members
                   if isinstance(m, ast.FunctionDef) and not m.name.startswith("_")]
        for each in (node, *methods):
            text = ast.get_docstring(each)
            if text:
                yield each.body[0].lineno, text


def without_fields(text: str) -> str:
    """Blank the titles of numpydoc sections and the lines `name : type`; keep what they say."""
    lines, in_section = text.split("\n"), False
    for number, line in enumerate(lines):
        title = number + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[number + 1].strip())
        in_section = in_section or bool(title)
        if title or re.fullmatch(r"-{3,}", line.strip()) or (in_section and line[:1].strip()):
            lines[number] = ""
        elif in_section:
            lines[number] = line.strip()
    return "\n".join(lines)


def _name(path: Path) -> str:
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name


def pages() -> list[Path]:
    """README, CONTRIBUTING and docs; not the changelog, whose items are notes."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def main(argv: list[str]) -> int:
    """Print what breaks a rule; 1 if anything does."""
    chosen = [Path(name).resolve() for name in argv] or pages()
    found = [each for page in chosen for each in of_page(page)]
    if not argv:
        found += [each for package in PUBLIC for each in of_package(package)]
    for each in found:
        print(each)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
