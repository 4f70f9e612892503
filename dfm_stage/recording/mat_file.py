"""MATLAB's .mat files, versions 4 to 7.2, in bounded time and memory whatever their sizes claim.

Source: The MathWorks, MAT-File Format. (The reader in SciPy 1.15 crashes on damaged files.)
Every element states its size; none is believed that passes the end of what it stands in.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.recording.errors import RecordingError

LARGEST_BYTES = 1 << 32
"""What a file may expand to, all its variables together."""
DEEPEST = 40
"""Structures and cells inside each other."""
_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR = 1, 2, 3, 4
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
          13: "u8", 16: "u1", 17: "u2", 18: "u4"}
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4",
            14: "i8", 15: "u8"}
_TEXTS = {1: "utf-8", 2: "utf-8", 16: "utf-8", 4: "utf-16", 17: "utf-16", 18: "utf-32"}
_COMPLEX, _LOGICAL = 0x800, 0x200
_TYPES_4 = ("f8", "f4", "i4", "i2", "u2", "u1")
_FULL_4 = 0


class MatError(RecordingError):
    """The bytes are no .mat file, or a damaged one."""


class NewerMatError(MatError):
    """A file of version 7.3, which is HDF5."""


def read_mat(data: bytes) -> dict[str, Any]:
    """The variables of a file.

    Arrays of numbers come squeezed, structures as dicts, arrays of structures and cells as lists
    (one alone as itself), rows of characters as str, anything else as None.

    Raises
    ------
    MatError
        If it is damaged, or no such file.
    """
    if len(data) >= 4 and 0 in data[:4]:
        return _version_4(data)
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise MatError("its header is not that of a .mat file")
    major = struct.unpack_from(f"{order}H", data, 124)[0] >> 8
    if major != 1:
        raise NewerMatError("is of version 7.3") if major == 2 else MatError(
            f"its version {major} is unknown")
    file, found = _File(order), {}
    at, view = _HEADER_BYTES, memoryview(data)
    while at < len(view):
        kind, content, at = file.element(view, at)
        if kind == _COMPRESSED:
            kind, content, _ = file.element(file.expanded(content), 0)
        if kind == _MATRIX:
            name, value = file.matrix(content, 0)
            found[name] = value
    return found


@dataclass
class _File:
    """Reads the elements of a file of one byte order."""

    order: str
    expanded_bytes: int = 0

    def element(self, data: memoryview, at: int) -> tuple[int, memoryview, int]:
        """The type and the content of the element at a place, and where the next begins."""
        if at + 8 > len(data):
            raise MatError("it ends inside an element")
        kind, size = struct.unpack_from(f"{self.order}II", data, at)
        if kind >> 16:                  # up to four bytes stand inside the tag
            size, kind = kind >> 16, kind & 0xFFFF
            if size > 4:
                raise MatError(f"a short element claims {size} bytes")
            return kind, data[at + 4:at + 4 + size], at + 8
        end = at + 8 + size
        if end > len(data):
            raise MatError(f"an element claims {size} bytes, {len(data) - at - 8} are there")
        return kind, data[at + 8:end], end if kind == _COMPRESSED else end + -size % 8

    def expanded(self, content: memoryview) -> memoryview:
        """What a compressed element holds."""
        room = LARGEST_BYTES - self.expanded_bytes
        try:
            unpack = zlib.decompressobj()
            data = unpack.decompress(content, room)
        except (zlib.error, MemoryError) as error:
            raise MatError(f"it cannot be decompressed: {error}") from None
        if unpack.unconsumed_tail:
            raise MatError(f"it expands to more than {LARGEST_BYTES >> 30} GiB")
        self.expanded_bytes += len(data)
        return memoryview(data)

    def matrix(self, content: memoryview, depth: int) -> tuple[str, Any]:
        """The name and the value of an array of any class."""
        if depth > DEEPEST:
            raise MatError(f"more than {DEEPEST} structures inside each other")
        if not content:
            return "", np.empty(0)
        _, flags, at = self.element(content, 0)
        if len(flags) < 4:
            raise MatError("an array without a class")
        bits = struct.unpack_from(f"{self.order}I", flags)[0]
        kind = bits & 0xFF
        if kind not in (_CELL, _STRUCT, _OBJECT, _CHAR, *_CLASSES):
            return "", None
        shape, at = self._shape(content, at)
        _, name, at = self.element(content, at)
        text = bytes(name).decode("ascii", "replace")
        if kind in _CLASSES:
            return text, self._numbers(content, at, shape, bits)
        if kind == _CHAR:
            return text, self._text(content, at)
        if kind == _OBJECT:
            _, _, at = self.element(content, at)
        return text, self._nested(content, at, math.prod(shape), kind != _CELL, depth)

    def _shape(self, content: memoryview, at: int) -> tuple[tuple[int, ...], int]:
        kind, sizes, at = self.element(content, at)
        shape = tuple(int(n) for n in self._sizes(kind, sizes))
        if not 1 <= len(shape) <= 32 or min(shape) < 0:
            raise MatError("an array of impossible size")
        return shape, at

    def _array(self, kind: int, content: memoryview) -> np.ndarray[Any, Any]:
        if kind not in _TYPES:
            raise MatError(f"numbers of the unknown type {kind}")
        dtype = np.dtype(self.order + _TYPES[kind])
        return np.frombuffer(content[:len(content) // dtype.itemsize * dtype.itemsize], dtype)

    def _sizes(self, kind: int, content: memoryview) -> np.ndarray[Any, Any]:
        found = self._array(kind, content)
        if found.dtype.kind == "f":
            raise MatError("a size that is no whole number")
        return found

    def _numbers(self, content: memoryview, at: int, shape: tuple[int, ...],
                 bits: int) -> np.ndarray[Any, Any]:
        parts = []
        for _ in range(2 if bits & _COMPLEX else 1):
            kind, data, at = self.element(content, at)
            part = self._array(kind, data)
            if part.size != math.prod(shape):
                raise MatError(f"an array has {part.size} numbers where {math.prod(shape)} "
                               "belong")
            with np.errstate(invalid="ignore"):
                parts.append(part.astype(bool if bits & _LOGICAL else _CLASSES[bits & 0xFF]))
        whole = parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]
        return whole.reshape([n for n in shape if n != 1], order="F")

    def _text(self, content: memoryview, at: int) -> str:
        if at >= len(content):
            return ""
        kind, data, _ = self.element(content, at)
        coding = _TEXTS.get(kind, "latin-1")
        ends = {"<": "-le", ">": "-be"}[self.order] if coding in ("utf-16", "utf-32") else ""
        return bytes(data).decode(coding + ends, "replace")

    def _nested(self, content: memoryview, at: int, count: int, named: bool, depth: int) -> Any:
        """Cells, or structures with their fields."""
        names = [""]
        if named:
            names, at = self._fields(content, at)
        if count * len(names) > (len(content) - at) // 8:     # each has at least its tag
            raise MatError(f"{count} cells or structures do not fit into it")
        found = []
        for _ in range(count if names else min(count, 1)):
            item = {}
            for name in names:
                kind, data, at = self.element(content, at)
                if kind != _MATRIX:
                    raise MatError("a cell or field that is no array")
                item[name] = self.matrix(data, depth + 1)[1]
            found.append(item if named else item[""])
        return found[0] if len(found) == 1 else found

    def _fields(self, content: memoryview, at: int) -> tuple[list[str], int]:
        kind, sizes, at = self.element(content, at)
        width = self._sizes(kind, sizes)[:1].sum()
        _, texts, at = self.element(content, at)
        if width < 1:
            return [], at
        rows = [bytes(texts[k:k + int(width)]) for k in range(0, len(texts), int(width))]
        return [row.partition(b"\0")[0].decode("ascii", "replace") for row in rows], at


def _version_4(data: bytes) -> dict[str, Any]:
    """The variables of a file of version 4: a head of five whole numbers, a name, the numbers."""
    found: dict[str, Any] = {}
    order = "<" if 0 <= struct.unpack_from("<i", data)[0] < 5000 else ">"
    at = 0
    while at < len(data):
        if at + 20 > len(data):
            raise MatError("it ends inside a head")
        code, rows, columns, complex_, length = struct.unpack_from(f"{order}5i", data, at)
        form, layout = code // 10 % 10, code % 10
        if not 0 <= code < 5000 or form >= len(_TYPES_4) or min(rows, columns, length) < 0:
            raise MatError("its header is not that of a .mat file")
        dtype = np.dtype(order + _TYPES_4[form])
        begin, count = at + 20 + length, rows * columns
        end = begin + count * dtype.itemsize * (2 if complex_ else 1)
        if end > len(data):
            raise MatError(f"an array claims {count} numbers, {len(data) - begin} bytes are there")
        name = data[at + 20:begin].partition(b"\0")[0].decode("ascii", "replace")
        if layout == _FULL_4 and not complex_:
            found[name] = np.frombuffer(data, dtype, count, begin).reshape(
                [n for n in (rows, columns) if n != 1], order="F")
        at = end
    return found
