"""The arrays of one topic while a bag is read: allocated once, filled chunk by chunk."""

from __future__ import annotations

import itertools
import math
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.bag import Array, Ragged, Topic
from dfm_stage.recording.decode_kernels import decode
from dfm_stage.recording.decode_plan import Column, Op, Plan
from dfm_stage.recording.numba_tools import Bytes, Ints

_RECORD_COLUMNS = (Column("log_time_ns", "i8"), Column("publish_time_ns", "i8"),
                   Column("sequence", "u4"))
_ALIGNMENT = 64
LARGEST_BYTES = 1 << 40
"""More than any memory; a system that promises more than it has would agree."""
_local = threading.local()


def _scratch(rows: int) -> Ints:
    """Return (at least `rows`, 2) int64 that this thread may write on."""
    held: Ints | None = getattr(_local, "entries", None)
    if held is None or len(held) < rows:
        held = _local.entries = np.empty((rows, 2), np.int64)
    return held


@dataclass
class _RaggedPart:
    """What one chunk adds to the ragged columns: bytes of each, and bytes used after each row."""

    row: int
    values: dict[Column, NDArray[np.uint8]]
    ends: NDArray[np.int64]


@dataclass
class TopicArrays:
    """Columns of `rows` messages in one block of memory; `decode` may be called by many threads,
    each for rows of its own."""

    name: str
    type_name: str
    plan: Plan
    rows: int
    bad_rows: list[int] = field(default_factory=list)
    empty_rows: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        try:
            self._allocate()
        except MemoryError:         # a definition may claim arrays of any size
            self.plan = Plan(left_out=["all fields: they need more memory than there is"],
                             instructions=[(Op.REST, 0, 0, -1)])
            self._allocate()
        self._program = self.plan.program
        self._texts: dict[bytes, int] = {}
        self._parts: list[_RaggedPart] = []
        self._lock = threading.Lock()

    def _allocate(self) -> None:
        sizes = [column.stored_dtype.itemsize * column.count * self.rows
                 for column in (*_RECORD_COLUMNS, *self.plan.fixed)]
        places = [0, *itertools.accumulate(-(-size // _ALIGNMENT) * _ALIGNMENT for size in sizes)]
        if places[-1] > LARGEST_BYTES:
            raise MemoryError
        self._arena = np.empty(places[-1], np.uint8)
        self._bases = np.array(places[:-1], np.int64)

    def decode(self, data: Bytes, offsets: Ints, row: int) -> None:
        """Decode the messages whose records stand at `offsets` in `data`, from `row` on."""
        count = len(offsets)
        n_ragged = len(self.plan.ragged)
        ragged = np.empty((n_ragged, -(-len(data) // 8) * 8), np.uint8)
        ends = np.empty((n_ragged, count), np.int64)
        entries = _scratch(len(data) // 4 + 1)
        bad = np.empty(count, np.int64)
        n_bad, n_texts = decode(data, offsets, row, self._program, self._arena,
                                        self._bases, ragged, ends, entries, bad)
        if n_bad:
            self.bad_rows += (row + bad[:n_bad]).tolist()
        if n_texts:
            self._translate(data, entries[:n_texts], row, count, ragged, ends)
        if n_ragged:
            self._parts.append(_RaggedPart(row, {
                column: ragged[index, :ends[index, -1]].copy()
                for index, column in enumerate(self.plan.ragged)}, ends))

    def _translate(self, data: Bytes, entries: Ints, row: int, count: int,
                   ragged: NDArray[np.uint8], ends: Ints) -> None:
        """Replace the codes of this chunk's texts by those of the topic."""
        with self._lock:
            codes = [self._texts.setdefault(data[start:start + size].tobytes(), len(self._texts))
                     for start, size in entries.tolist()]
        if all(code == number for number, code in enumerate(codes)):
            return
        mapping = np.array(codes, np.int32)
        for column, base in zip(self.plan.fixed, self._bases[len(_RECORD_COLUMNS):], strict=True):
            if not column.dtype:
                part = self._view(column, int(base))[row:row + count]
                part[...] = np.take(mapping, part, mode="clip")
        for index, column in enumerate(self.plan.ragged):
            if not column.dtype and count:
                values = ragged[index, :ends[index, -1]].view(np.int32)
                values[...] = mapping[values]

    def _view(self, column: Column, base: int) -> Array:
        dtype = column.stored_dtype
        shape = (self.rows,) if column.count == 1 else (self.rows, column.count)
        return self._arena[base:][:dtype.itemsize * math.prod(shape)].view(dtype).reshape(shape)

    def finish(self) -> Topic:
        """Return the topic; rows that could not be filled are taken out."""
        keep = np.ones(self.rows, np.bool_)
        keep[self.bad_rows] = False
        for first, after in self.empty_rows:
            keep[first:after] = False
        part = slice(None) if keep.all() else keep
        columns: dict[str, Array | Ragged] = {
            column.name: self._view(column, int(base))[part] for column, base in zip(
                [*_RECORD_COLUMNS, *self.plan.fixed], self._bases, strict=True)}
        record = [columns.pop(column.name) for column in _RECORD_COLUMNS]
        columns |= {column.name: self._join(index, column, keep)
                    for index, column in enumerate(self.plan.ragged)}
        texts: Any = np.array([text.decode("utf-8", "replace") for text in self._texts] or [""],
                              dtype=object)
        return Topic(
            self.name, self.type_name, record[0], record[1], record[2],  # type: ignore[arg-type]
            columns, texts,
            frozenset(column.name for column in (*self.plan.fixed, *self.plan.ragged)
                      if not column.dtype),
            frozenset(column.name for column in (*self.plan.fixed, *self.plan.ragged)
                      if column.time),
            list(self.plan.left_out))

    def _join(self, index: int, column: Column, keep: NDArray[np.bool_]) -> Ragged:
        dtype = column.stored_dtype
        lengths = np.zeros(self.rows, np.int64)
        parts = sorted(self._parts, key=lambda part: part.row)
        for part in parts:
            lengths[part.row:part.row + part.ends.shape[1]] = np.diff(part.ends[index], prepend=0)
        # A column is given back as soon as it is joined: memory holds one of them twice, not all.
        values = np.concatenate([part.values.pop(column) for part in parts]
                                or [np.empty(0, np.uint8)]).view(dtype)
        if column.count > 1:
            values = values.reshape(-1, column.count)
        lengths //= dtype.itemsize * column.count
        if not keep.all():
            values, lengths = values[np.repeat(keep, lengths)], lengths[keep]
        return Ragged(values, np.cumsum(lengths))
