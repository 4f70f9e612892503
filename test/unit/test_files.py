"""A file appears whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dfm_stage.files import write_whole


def test_text_and_bytes_replace_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    path.write_text("before")
    write_whole(path, "µm\n")
    assert path.read_bytes() == "µm\n".encode()
    write_whole(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert list(tmp_path.iterdir()) == [path]


def test_readable_as_any_new_file(tmp_path: Path) -> None:
    written, opened = tmp_path / "a", tmp_path / "b"
    write_whole(written, "x")
    opened.touch()
    assert written.stat().st_mode == opened.stat().st_mode


def test_a_failure_leaves_what_was_there_and_nothing_else(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.json"
    path.write_text("before")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        write_whole(path, "after")
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_no_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        write_whole(tmp_path / "nowhere" / "x", "x")
