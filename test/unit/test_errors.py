"""The message of an error is one line, whatever it quotes."""

from __future__ import annotations

import pytest

from dfm_stage.errors import LONGEST, DfmError
from dfm_stage.recording.errors import MissingPackageError, NotInBagError


@pytest.mark.parametrize("kind", [DfmError, NotInBagError, MissingPackageError])
@pytest.mark.parametrize(("quoted", "shown"), [
    ("plain é µm", "plain é µm"), ("a\nb\r\nc\u2028d\x85e", "a b c d e"),
    ("\x1b[2J\0", "\\x1b[2J\\x00"), ("\u202e", "\\u202e"), ("it's", "it's")])
def test_one_line_that_no_terminal_obeys(kind: type[DfmError], quoted: str, shown: str) -> None:
    assert str(kind(quoted)) == shown


def test_a_long_message_keeps_both_ends() -> None:
    text = str(DfmError("file.yaml: " + "x" * 10**6 + "; rename it"))
    assert len(text) <= LONGEST
    assert text.startswith("file.yaml: x")
    assert text.endswith("x; rename it")
