"""Where everything stands in an MCAP file, whole or not.

The file is walked record by record. Each kind of record that matters states its length twice, so a
damaged one is noticed; the walk then searches for the next whole chunk, message index or end of
data and goes on there. Nothing is decompressed here.
"""

from __future__ import annotations

import io
import os
import re
import struct
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Metadata, Schema, Statistics

from dfm_stage.recording.errors import BagReadError
from dfm_stage.recording.formats import MAGIC

RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD_BYTES = 31

_MOVING = threading.Lock()
_CHUNK_HEAD = struct.Struct("<BQQQQII")
_CHUNK_FIXED = 40
_FOOTER_BYTES = 37
_MAGIC_ENOUGH = 6       # of the first 8 bytes
_LOOSE_BYTES = 1 << 20
_SEARCH_BYTES = 1 << 24
_PATTERN = re.compile(
    rb"\x06.{36}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0)|\x07.{14}|\x0f\x04\0{7}", re.DOTALL)
_PATTERN_BYTES = 64
_KINDS: dict[int, type[McapRecord]] = {
    Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata}


@dataclass(frozen=True)
class Loss:
    """Something that should be in the bag and is not: in words, and in numbers where known."""

    text: str
    bytes: int = 0
    messages: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        return self.text


@dataclass
class ChunkPlace:
    """One chunk in the file.

    `counts` (messages by channel id) is what the message index says, None if there is none. A
    chunk with `cut` has fewer bytes in the file than `length`.
    """

    offset: int
    length: int
    compression: str
    uncompressed_size: int
    crc: int
    start_ns: int = 0
    end_ns: int = 0
    cut: bool = False
    counts: dict[int, int] | None = None


@dataclass
class FileScan:
    """What stands where in one file; `finished` means that its end is there and in order."""

    path: Path
    size: int
    finished: bool = False
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None
    losses: list[Loss] = field(default_factory=list)

    def define(self, record: McapRecord | None) -> None:
        """Take in a schema or channel; of several with one id the first counts."""
        if isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)

    def lose(self, text: str, **numbers: float) -> None:
        """Note a loss."""
        self.losses.append(Loss(f"{self.path.name}: {text}", **numbers))  # type: ignore[arg-type]


def read_at(file: int, offset: int, size: int) -> bytes:
    """Read up to `size` bytes at `offset`; shorter only at the end of the file."""
    data = _some_at(file, offset, size)
    while len(data) < size and (more := _some_at(file, offset + len(data), size - len(data))):
        data += more
    return data


def _some_at(file: int, offset: int, size: int) -> bytes:
    if hasattr(os, "pread"):
        return os.pread(file, size, offset)
    with _MOVING:       # Windows: a file has one place for all threads
        os.lseek(file, offset, os.SEEK_SET)
        return os.read(file, size)


def scan_file(file: int, path: Path) -> FileScan:
    """Walk the open file `file`.

    Raises
    ------
    BagReadError
        If it is not an MCAP file at all.
    """
    scan = FileScan(path, os.fstat(file).st_size)
    start = read_at(file, 0, len(MAGIC))
    same = sum(a == b for a, b in zip(start, MAGIC, strict=False))
    if same < min(len(start), _MAGIC_ENOUGH) or not start:
        what = "is empty" if not start else "is not an MCAP file (its first bytes say otherwise)"
        raise BagReadError(f"{path}: {what}; give a bag folder or an .mcap file")
    _Walk(file, scan, _take_summary(file, scan)).run(len(MAGIC))
    return scan


@dataclass
class _Walk:
    """The walk over the data section."""

    file: int
    scan: FileScan
    limit: int
    chunk: ChunkPlace | None = None
    ended: bool = False

    def run(self, at: int) -> None:
        scan = self.scan
        while not self.ended and at < self.limit:
            after = self.record(at)
            if after is None:
                after = self.search(at + 1)
                scan.lose(f"{after - at} bytes from byte {at} on are damaged or cut off and were "
                          f"skipped", bytes=after - at)
                self.chunk = None
            at = after
        if self.ended and not scan.finished:
            scan.lose("the index at the end is damaged or cut off; the file was read without it")
        elif not self.ended and not scan.finished:
            scan.lose("the file stops without an index: the recording was cut off, and what came "
                      "after the last message here is missing")

    def record(self, at: int) -> int | None:
        """Take in the record at `at`; return where the next one stands, None if it is damaged."""
        head = read_at(self.file, at, _PATTERN_BYTES)
        if len(head) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack_from(head)
        end: int = at + RECORD_HEAD.size + length
        if opcode == Opcode.CHUNK:
            chunk = _chunk_at(at, head, self.scan.size)
            if chunk is None:
                return None
            self.chunk = chunk
            self.scan.chunks.append(chunk)
            return min(chunk.offset + chunk.length, self.scan.size)
        if end > self.limit:
            return None
        if opcode == Opcode.MESSAGE:
            return self.take_loose(at, length)
        if opcode == Opcode.MESSAGE_INDEX:
            sound = self.take_index(_index_in(head, length))
        elif opcode == Opcode.DATA_END:
            sound = self.ended = length == 4
        elif opcode in _KINDS:
            sound = self.take(opcode, read_at(self.file, at + RECORD_HEAD.size, length))
        else:
            sound = opcode == Opcode.HEADER or self.skip_unknown(opcode, at, end)
        return end if sound else None

    def skip_unknown(self, opcode: int, at: int, end: int) -> bool:
        """Note a record of a kind to come; whether it is one shows what stands behind it."""
        following = read_at(self.file, end, RECORD_HEAD.size)
        if opcode < 0x80 or not following or following[0] not in range(1, 16):
            return False
        self.scan.lose(f"a record of the unknown kind {opcode} at byte {at} was skipped",
                       bytes=end - at - RECORD_HEAD.size)
        return True

    def take_index(self, index: tuple[int, int] | None) -> bool:
        if index is not None and index[1] and self.chunk is not None:
            counts = self.chunk.counts = self.chunk.counts or {}
            counts[index[0]] = counts.get(index[0], 0) + index[1]
        return index is not None

    def take_loose(self, at: int, length: int) -> int | None:
        """Gather messages outside chunks into pieces that are then treated as plain chunks."""
        if length < MESSAGE_HEAD_BYTES - RECORD_HEAD.size:
            return None
        size = RECORD_HEAD.size + length
        chunk = self.chunk
        if (chunk is None or chunk.compression or chunk.offset + chunk.length != at
                or chunk.counts or chunk.length > _LOOSE_BYTES):
            chunk = self.chunk = ChunkPlace(at, 0, "", 0, 0)
            self.scan.chunks.append(chunk)
        chunk.length += size
        chunk.uncompressed_size += size
        return at + size

    def take(self, opcode: int, body: bytes) -> bool:
        record = parse_record(opcode, body)
        self.scan.define(record)
        if isinstance(record, Metadata):
            self.scan.metadata.append(record)
        elif isinstance(record, Attachment) and (
                int.from_bytes(body[-4:], "little") in (0, zlib.crc32(body[:-4]))):
            self.scan.attachments.append(record)
        elif isinstance(record, Attachment):
            self.scan.lose(f"the attached file {record.name} is damaged and was left out",
                           bytes=len(body))
        return record is not None

    def search(self, at: int) -> int:
        """Return where the next whole chunk, message index or end of data stands, from `at`; the
        limit if there is none."""
        while at < self.limit:
            block = read_at(self.file, at, _SEARCH_BYTES + _PATTERN_BYTES)
            for match in _PATTERN.finditer(block):
                if match.start() < _SEARCH_BYTES and self.plausible(
                        block[match.start():match.start() + _PATTERN_BYTES], at + match.start()):
                    return at + match.start()
            at += _SEARCH_BYTES
        return self.limit

    def plausible(self, head: bytes, at: int) -> bool:
        """Return whether the record that begins with `head` can be what its opcode says."""
        opcode, length = RECORD_HEAD.unpack_from(head)
        if at + RECORD_HEAD.size + length > self.limit:
            return False
        if opcode == Opcode.CHUNK:
            return _chunk_at(at, head, self.scan.size) is not None
        return opcode != Opcode.MESSAGE_INDEX or (_index_in(head, length) or (0, 0))[1] > 0


def _chunk_at(at: int, head: bytes, file_size: int) -> ChunkPlace | None:
    """Return the chunk whose record begins with `head` at byte `at`; None if its two lengths
    disagree."""
    if len(head) < RECORD_HEAD.size + _CHUNK_FIXED:
        return None
    _, length, start_ns, end_ns, uncompressed, crc, name_length = _CHUNK_HEAD.unpack_from(head)
    if name_length > 8 or len(head) < 49 + name_length:
        return None
    (size,) = struct.unpack_from("<Q", head, 41 + name_length)
    if length != _CHUNK_FIXED + name_length + size:
        return None
    offset = at + RECORD_HEAD.size + _CHUNK_FIXED + name_length
    return ChunkPlace(offset, size, head[41:41 + name_length].decode("ascii", "replace"),
                      uncompressed, crc, start_ns, end_ns, offset + size > file_size)


def _index_in(head: bytes, length: int) -> tuple[int, int] | None:
    """Return (channel, messages) of a message index; None if its two lengths disagree."""
    if length < 6:
        return None
    channel, size = struct.unpack_from("<HI", head, RECORD_HEAD.size)
    return None if size != length - 6 or size % 16 else (channel, size // 16)


def parse_record(opcode: int, body: bytes) -> McapRecord | None:
    """Return the record with this content, None if it makes no sense."""
    kind = Statistics if opcode == Opcode.STATISTICS else _KINDS.get(opcode)
    if kind is None:
        return None
    stream = ReadDataStream(io.BytesIO(body))
    try:
        record: McapRecord = kind.read(stream)  # type: ignore[attr-defined]
    except (McapError, ValueError, struct.error, OverflowError, MemoryError):
        return None
    return record if stream.count == len(body) else None


def _take_summary(file: int, scan: FileScan) -> int:
    """Take in the summary before the footer if it is there and sound; return where data end."""
    at = scan.size - _FOOTER_BYTES
    footer = read_at(file, max(at, 0), _FOOTER_BYTES)
    if (len(footer) < _FOOTER_BYTES or footer[-8:] != MAGIC
            or footer[:9] != RECORD_HEAD.pack(Opcode.FOOTER, 20)):
        return scan.size
    start, _, crc = struct.unpack_from("<QQI", footer, RECORD_HEAD.size)
    content = read_at(file, start, at - start) if 0 < start < at else b""
    if start >= at or (start and crc and zlib.crc32(footer[:25], zlib.crc32(content)) != crc):
        return scan.size
    scan.finished = True
    for opcode, body in records_in(content):
        record = parse_record(opcode, body)
        scan.define(record)
        if isinstance(record, Statistics):
            scan.statistics = record
    return start or at


def records_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, content) of the whole records in `data`."""
    at = 0
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size
        if at + length > len(data):
            return
        yield opcode, data[at:at + length]
        at += length
