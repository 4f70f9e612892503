"""The reader of .mat files against SciPy's writer and reader, and against lies about sizes."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
import scipy.io

from dfm_stage.recording import mat_file
from dfm_stage.recording.mat_file import MatError, NewerMatError, read_mat

VARIABLES: dict[str, Any] = {
    "run": {"X": {"Data": np.arange(30.0)}, "Y": [{"Name": "a", "Data": np.ones(3)},
                                                  {"Name": "b", "Data": np.ones(4)}]},
    "text": "abcé", "whole": np.arange(30, dtype=np.int16).reshape(5, 6), "Ts": 0.01,
    "complex": np.ones(3) * 1j, "flag": np.array([True, False]), "none": np.empty((0, 0)),
    "single": np.ones((2, 3, 4), np.float32), "large": np.uint64(2**63),
    "cell": np.array(["a", 1.0, np.ones(3)], dtype=object), "column": np.arange(5.0)[:, None],
    "structure": np.array([(1, 2.0)], dtype=[("p", "i4"), ("q", "f8")])}


def saved(variables: dict[str, Any], **options: Any) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, variables, **options)
    return file.getvalue()


def require_same(ours: Any, theirs: Any, where: str) -> None:
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs), where
        for name in theirs:
            require_same(ours[name], theirs[name], f"{where}.{name}")
    elif isinstance(theirs, list) or (isinstance(theirs, np.ndarray) and theirs.dtype == object):
        assert len(ours) == len(theirs), where
        for own, other in zip(ours, theirs, strict=True):
            require_same(own, other, f"{where}[]")
    elif isinstance(theirs, str):
        assert ours == theirs, where
    elif np.size(theirs):
        assert np.shape(ours) == np.shape(theirs), where
        assert np.array_equal(ours, theirs), where
        assert ours.dtype == bool or ours.dtype.kind == np.asarray(theirs).dtype.kind, where


@pytest.mark.parametrize(("names", "options"), [
    (list(VARIABLES), {"do_compression": False}), (list(VARIABLES), {"do_compression": True}),
    (["whole", "Ts", "column"], {"format": "4"})])
def test_as_scipy_reads_it(names: list[str], options: dict[str, Any]) -> None:
    data = saved({name: VARIABLES[name] for name in names}, **options)
    theirs = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    ours = read_mat(data)
    assert set(ours) == set(names)
    require_same(ours, {name: theirs[name] for name in names}, "")


@pytest.mark.parametrize("cut", range(1, 400, 13))
def test_a_file_that_ends_early_is_refused(cut: int) -> None:
    whole = saved({"a": np.arange(30.0), "b": {"c": 1.0}})
    with pytest.raises(MatError):
        read_mat(whole[:-cut])


def test_sizes_that_lie(monkeypatch: pytest.MonkeyPatch) -> None:
    data = saved({"a": np.arange(30.0)})
    for at, value, words in ((132, 2**31, "claims 2147483648 bytes"), (160, 2**31 - 1, "numbers"),
                             (132, 0xFFFFFFFF, "bytes"), (144, 200, "")):
        lie = bytearray(data)
        struct.pack_into("<I", lie, at, value)
        if words:
            with pytest.raises(MatError, match=words):
                read_mat(bytes(lie))
        else:
            read_mat(bytes(lie))
    monkeypatch.setattr(mat_file, "LARGEST_BYTES", 1 << 20)
    packed = zlib.compress(bytes(1 << 21))
    bomb = data[:128] + struct.pack("<II", 15, len(packed)) + packed
    with pytest.raises(MatError, match="expands to more than"):
        read_mat(bomb)


def test_cells_inside_cells_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mat_file, "DEEPEST", 3)
    deep: Any = 1.0
    for _ in range(6):
        cell = np.empty(1, dtype=object)
        cell[0] = deep
        deep = cell
    with pytest.raises(MatError, match="more than 3 structures"):
        read_mat(saved({"a": deep}))


def test_other_versions() -> None:
    data = bytearray(saved({"a": 1.0}))
    data[124:126] = b"\0\2"
    with pytest.raises(NewerMatError):
        read_mat(bytes(data))
    with pytest.raises(MatError, match="header"):
        read_mat(b"MATLAB 5.0 MAT-file")


@pytest.mark.parametrize("size", [np.nan, np.inf, 8.0])
def test_a_size_is_a_whole_number(size: float) -> None:
    structure = io.BytesIO()
    scipy.io.savemat(structure, {"s": {"field": np.arange(3.0)}}, do_compression=False)
    data = structure.getvalue()
    width = struct.pack("<HHI", 5, 4, len("field") + 1)     # one number in the tag itself
    assert width in data
    with pytest.raises(MatError, match="no whole number"):
        read_mat(data.replace(width, struct.pack("<HHf", 7, 4, size)))
