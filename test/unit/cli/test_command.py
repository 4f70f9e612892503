"""What the commands share: exit codes, one line per error, folders, names, progress."""

from __future__ import annotations

import io
import os
import signal
import time
from pathlib import Path

import pytest

from dfm_stage import __main__
from dfm_stage.cli.command import finite, names_in, new_folder, paint, run_command, write_output
from dfm_stage.cli.progress import Progress, steps
from dfm_stage.commands import NODES, TOOLS
from dfm_stage.errors import DfmError


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def _raise(error: BaseException) -> int:
    raise error


@pytest.mark.parametrize(("error", "code", "line"), [
    (DfmError("x.csv, line 3: no number"), 2, "error: x.csv, line 3: no number\n"),
    (KeyboardInterrupt(), 130, "stopped\n"),
])
def test_an_end_that_was_not_planned_is_one_line(
        error: BaseException, code: int, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(lambda: _raise(error)) == code
    assert capsys.readouterr().err == line


def test_colours_are_for_terminals_that_want_them(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    assert paint("x", "bad", Terminal()) == "\x1b[31mx\x1b[0m"
    assert paint("x", "bad", io.StringIO()) == "x"
    monkeypatch.setenv("TERM", "dumb")
    assert paint("x", "bad", Terminal()) == "x"
    monkeypatch.delenv("TERM")
    monkeypatch.setenv("NO_COLOR", "1")
    assert paint("x", "bad", Terminal()) == "x"


@pytest.mark.parametrize("arguments", [
    ["identify", "absent.csv"], ["identify"], ["diagnose", "absent.csv", "--model", "paper_stage"],
    ["diagnose", "absent.csv", "--model", "absent"], ["tune"], ["tune", "--model", "absent"],
    ["characterize", "all", "--bag", "absent"], ["paper", "--model", "absent"],
    ["learn", "absent", "--model", "paper_stage"], ["learn", "--replay", "absent"],
    ["bench", "absent"], ["bench", "--from", "absent"], ["demo", "--model", "absent"],
    ["emulate", "qsb_d", "--link", "absent/port"], ["example", "/dev/null/folder"], ["absent"],
])
def test_what_cannot_be_used_is_one_line_and_code_2(
        arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert __main__.main(arguments) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert not said.out


@pytest.mark.parametrize("tool", ["identify", "diagnose"])
def test_ctrl_c_ends_with_130_and_leaves_no_half_file(
        tool: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10.0)

    monkeypatch.setattr("dfm_stage.cli.records.read_record", interrupted)
    out = tmp_path / "out"
    assert __main__.main([tool, "a.csv", "--model", "paper_stage", "--out", str(out)]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "stopped"
    assert not out.exists()


def test_the_work_decides_otherwise() -> None:
    assert run_command(lambda: 1) == 1
    with pytest.raises(ZeroDivisionError):
        run_command(lambda: 1 // 0)


def test_a_folder_with_something_in_it_is_not_written_to(tmp_path: Path) -> None:
    assert new_folder(tmp_path / "a" / "b").is_dir()
    assert new_folder(tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    for taken in (tmp_path, tmp_path / "file"):
        with pytest.raises(DfmError, match=r"not empty.*--out"):
            new_folder(taken)
    with pytest.raises(DfmError, match=r"cannot be made a folder.*--out"):
        new_folder(tmp_path / "file" / "below")
    with pytest.raises(DfmError, match=r"cannot be written.*--out"):
        write_output(tmp_path / "nowhere" / "x.json", "{}")


def test_names_and_numbers() -> None:
    assert names_in(["a, b", "", "c"]) == ["a", "b", "c"]
    assert finite({"a": [1.0, float("nan")], "b": (float("inf"), "x")}) == {
        "a": [1.0, None], "b": [None, "x"]}


def test_short_work_says_nothing_where_there_is_no_terminal() -> None:
    said = io.StringIO()
    with steps("identify", stream=said) as step:
        step("reading")
    with Progress("scan", said) as progress:
        progress(0.5)
    assert said.getvalue() == ""


def test_long_work_says_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    said = io.StringIO()
    with steps("identify", stream=said) as step, Progress("scan", said) as progress:
        step("reading")
        now = 3.0
        step("model")
        progress(0.5)
        progress(0.6)
    assert said.getvalue() == "identify: model\nscan [############............]  50 %, 3 s left\n"


def test_a_terminal_gets_one_line_that_is_wiped_at_the_end() -> None:
    said = Terminal()
    with steps("identify", stream=said) as step:
        step("frequency response")
        step("model")
    last_words = said.getvalue().split("\r")
    assert last_words[1].startswith("identify: frequency response, 0 s")
    assert last_words[2].startswith("identify: model, 0 s")
    assert last_words[-2:] == [" " * len(last_words[2].rstrip()), ""]
    quiet = Terminal()
    with steps("identify", quiet=True, stream=quiet) as step:
        step("model")
    assert quiet.getvalue() == ""


def test_the_list_of_all_names_has_each_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert __main__.main(["--help"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()
              if line.startswith("  ")]
    assert sorted(listed) == sorted([*NODES, *TOOLS])
