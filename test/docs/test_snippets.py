"""What README and docs show runs, and says what it is said to say."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
from functools import cache
from pathlib import Path

import pytest
from pages import PAGES, blocks, marks
from running import run_page

from dfm_stage.commands import NODES, TOOLS, module_of

FRONT_DOOR = {"test", "lint", "docs", "shell", "exec", "setup"}
RUNNABLE = [page for page in PAGES if {block.language for block in blocks(page)}
            & {"python", "console", "yaml"} and "real_time" not in marks(page)]
SLOW = [page for page in RUNNABLE if "slow" in marks(page)]
COMMAND = re.compile(r"(?:\$ )?\./run +(\S+)(.*)")


@pytest.mark.parametrize("page", [page for page in RUNNABLE if page not in SLOW],
                         ids=lambda page: page.name)
def test_the_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(page, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("page", SLOW, ids=lambda page: page.name)
def test_the_page_runs_with_what_is_slow(page: Path, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(page, tmp_path)


@cache
def _help(name: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out), pytest.raises(SystemExit) as ended:
        importlib.import_module(module_of(name)).main(["--help"])
    assert ended.value.code == 0
    return out.getvalue()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_shown_exists_with_its_options(page: Path) -> None:
    shown = [line for block in blocks(page) for line in block.code.splitlines()]
    shown += re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8"))
    for line in shown:
        found = COMMAND.match(line.strip())
        if not found or found[1].isupper() or found[1].startswith(("<", "-")):
            continue
        name, rest = found[1], found[2].partition(" #")[0].partition("--ros-args")[0]
        assert name in {*NODES, *TOOLS, *FRONT_DOOR}, line
        if name in TOOLS:
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest):
                assert option in _help(name), f"{page.name}: {line}: {option}"


@pytest.mark.parametrize("name", sorted(TOOLS))
def test_help_shows_an_example_that_parses(name: str) -> None:
    said = _help(name)
    examples = [line.strip() for line in said.splitlines() if line.strip().startswith("./run ")]
    examples += re.findall(r"example: (\./run .*)", said)
    assert any(example.startswith(f"./run {name}") for example in examples)
    for example in examples:
        other = example.split()[1]
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", example.partition(" #")[0]):
            assert other in NODES or option in _help(other)
