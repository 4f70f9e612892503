"""The lines for shells, tried in a bash."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from dfm_stage.cli.completion import bash, fish, flags_of_commands
from dfm_stage.commands import TOOLS


def completed(lines: str, *words: str) -> list[str]:
    """What bash offers for the last of the words."""
    ask = (f"COMP_WORDS=({' '.join(map(repr, words))}); COMP_CWORD={len(words) - 1}; _dfm_stage; "
           "printf '%s\\n' \"${COMPREPLY[@]}\"")
    done = subprocess.run(["bash", "-c", f"{lines}\n{ask}"], capture_output=True, text=True,
                          check=True)
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_offers_names_then_the_options_of_the_command() -> None:
    lines = bash(flags_of_commands())
    assert completed(lines, "dfm-stage", "diagnose_") == ["diagnose_batch"]
    assert completed(lines, "dfm-stage", "diagnose", "--ho") == ["--holdout"]
    assert completed(lines, "dfm-stage", "example", "--ho") == []
    assert completed(lines, "dfm-stage", "diagnose", "") == []     # files, by default


def test_every_command_is_known_to_all_shells() -> None:
    flags = flags_of_commands()
    assert flags.keys() == TOOLS.keys()
    assert "-l holdout" in fish(flags)


def test_a_command_that_cannot_start_here_is_left_out() -> None:
    code = ("import sys; sys.modules['serial'] = None; "    # as in the wheel
            "from dfm_stage.cli.completion import main; main(['bash'])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert completed(done.stdout, "dfm-stage", "diag") == ["diagnose", "diagnose_batch"]
    assert completed(done.stdout, "dfm-stage", "emul") == []
