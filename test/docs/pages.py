"""The Markdown pages of the repository: their code blocks, headings and links.

What the first line of a block says decides what is done with it:

- ```` ```python ````: run, all blocks of a page in one namespace, in a folder of the page's own;
  a comment line `# ...` after a print is what must come out;
- ```` ```console ````: lines after `$ ` are run there, the other lines are what must come out
  (`...` stands for anything);
- ```` ```yaml ````: loaded as the model or experiment that it is;
- a second word `slow`: its page runs only where DFM_SLOW is set, as `.ci/run` does;
- a second word `real_time`: the same, and the page has the machine to itself;
- a second word `file`: a file of the package, named in a comment; the page's Python then runs in a
  copy of the package that has it;
- a second word `fragment`: a part that does not stand alone; it has to compile.

An HTML comment `<!-- before ... -->` above a block holds Python that is run before it and that
readers do not see.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
_BLOCK = re.compile(r"(?:^<!-- before\n(?P<before>.*?)^-->\n)?"
                    r"^```(?P<info>[^\n]*)\n(?P<code>.*?)^```$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"\[(?:[^\]\[]|\[[^\]]*\])*\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Block:
    """A fenced block, and the hidden Python before it."""

    page: Path
    line: int
    language: str
    mark: str
    code: str
    before: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page from top to bottom."""
    text = page.read_text(encoding="utf-8")
    for found in _BLOCK.finditer(text):
        line = text.count("\n", 0, found.start("code")) + 1
        words = [*found["info"].split(), "", ""]
        yield Block(page, line, words[0], words[1], found["code"], found["before"] or "")


def marks(page: Path) -> set[str]:
    """Return the second words of the blocks of a page."""
    return {block.mark for block in blocks(page)}


def prose(page: Path) -> str:
    """Return a page without its blocks."""
    return _BLOCK.sub("", page.read_text(encoding="utf-8"))


def links(page: Path) -> list[str]:
    """Return where the links and pictures of a page point to."""
    return [found[1] for found in _LINK.finditer(prose(page))]


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives the headings of a page."""
    seen: dict[str, int] = {}
    out = set()
    for title in re.findall(r"^#{1,6} +(.*?) *$", prose(page), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        count = seen.get(slug, 0)
        seen[slug] = count + 1
        out.add(f"{slug}-{count}" if count else slug)
    return out
