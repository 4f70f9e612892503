"""Compiled code that is kept for the next process."""

from __future__ import annotations

from pathlib import Path

from numba import float64

from dfm_stage.machine_code import callback

GONE = b"cdfm_stage.module_that_is_gone\nname\n."
"""A pickle that asks for a module that there is not."""


def test_code_kept_with_a_module_that_is_gone_is_compiled_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def made():
        return callback("twice", lambda x: 2.0 * x, float64(float64), "twice of the test")

    assert made().ctypes(1.5) == 3.0
    assert made().cache_hits == 1
    kept = list(Path(tmp_path).rglob("*.nbc"))
    assert kept
    for file in kept:
        file.write_bytes(GONE)
    again = made()
    assert again.ctypes(1.5) == 3.0
    assert again.cache_hits == 0
