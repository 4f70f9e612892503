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
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, Metadata, Schema, Statistics

from dfm_stage.recording.errors import BagReadError

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD_BYTES = 31

_CHUNK_TIMES = struct.Struct("<QQQI")
_CHUNK_FIXED = 40
_FOOTER_BYTES = 37
_MAGIC_ENOUGH = 6       # of the first 8 bytes
_LOOSE_BYTES = 1 << 20
_SEARCH_BYTES = 1 << 24
_PATTERN = re.compile(
    rb"\x06.{36}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0)|\x07.{14}|\x0f\x04\0{7}", re.DOTALL)
_PATTERN_BYTES = 64


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

    def lose(self, text: str, **numbers: float) -> None:
        """Note a loss."""
        self.losses.append(Loss(f"{self.path.name}: {text}", **numbers))  # type: ignore[arg-type]


def read_at(file: int, offset: int, size: int) -> bytes:
    """Read up to `size` bytes at `offset`; shorter only at the end of the file."""
    data = os.pread(file, size, offset)
    while len(data) < size and (more := os.pread(file, size - len(data), offset + len(data))):
        data += more
    return data


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
    summary = _read_summary(file, scan)
    _Walk(file, scan, scan.size if summary is None else summary.start).run(len(MAGIC))
    if summary is not None:
        scan.schemas.update(summary.schemas)
        scan.channels.update(summary.channels)
    return scan


class _Walk:
    """The walk over the data section."""

    def __init__(self, file: int, scan: FileScan, limit: int) -> None:
        self.file = file
        self.scan = scan
        self.limit = limit
        self.chunk: ChunkPlace | None = None
        self.ended = False

    def run(self, at: int) -> None:
        scan = self.scan
        while not self.ended and at < self.limit:
            after = self.record(at)
            if after is None:
                after = self.search(at + 1)
                lost = (self.limit if after is None else after) - at
                scan.lose(f"{lost} bytes from byte {at} on are damaged or cut off and were "
                          f"skipped", bytes=lost)
                self.chunk = None
                if after is None:
                    break
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
            return self.take_chunk(at, head, length)
        if end > self.limit:
            return None
        if opcode == Opcode.MESSAGE_INDEX:
            return end if self.take_index(head, length) else None
        if opcode == Opcode.MESSAGE:
            return self.take_loose(at, length)
        if opcode == Opcode.DATA_END:
            self.ended = length == 4
            return end if self.ended else None
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA,
                      Opcode.HEADER):
            body = read_at(self.file, at + RECORD_HEAD.size, length)
            return end if opcode == Opcode.HEADER or self.take(opcode, body) else None
        if opcode >= 0x80 and RECORD_HEAD.unpack_from(
                read_at(self.file, end, 9).ljust(9, b"\0"))[0] in range(1, 16):
            self.scan.lose(f"a record of the unknown kind {opcode} at byte {at} was skipped",
                           bytes=length)
            return end
        return None

    def take_chunk(self, at: int, head: bytes, length: int) -> int | None:
        if len(head) < RECORD_HEAD.size + _CHUNK_FIXED:
            return None
        start_ns, end_ns, uncompressed, crc = _CHUNK_TIMES.unpack_from(head, 9)
        (name_length,) = struct.unpack_from("<I", head, 37)
        if name_length > 8 or len(head) < 49 + name_length:
            return None
        compression = head[41:41 + name_length].decode("ascii", "replace")
        (size,) = struct.unpack_from("<Q", head, 41 + name_length)
        if length != _CHUNK_FIXED + name_length + size:
            return None
        offset = at + RECORD_HEAD.size + _CHUNK_FIXED + name_length
        cut = offset + size > self.scan.size
        self.chunk = ChunkPlace(offset, size, compression, uncompressed, crc, start_ns, end_ns,
                                cut)
        self.scan.chunks.append(self.chunk)
        end: int = min(offset + size, self.scan.size)
        return end

    def take_index(self, head: bytes, length: int) -> bool:
        if length < 6:
            return False
        channel, size = struct.unpack_from("<HI", head, RECORD_HEAD.size)
        if size != length - 6 or size % 16:
            return False
        if self.chunk is not None and size:
            counts = self.chunk.counts = self.chunk.counts or {}
            counts[channel] = counts.get(channel, 0) + size // 16
        return True

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
        if isinstance(record, Schema):
            self.scan.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.scan.channels[record.id] = record
        elif isinstance(record, Attachment):
            if not _attachment_intact(body):
                self.scan.lose(f"the attached file {record.name} is damaged and was left out",
                               bytes=len(body))
            else:
                self.scan.attachments.append(record)
        elif isinstance(record, Metadata):
            self.scan.metadata.append(record)
        return record is not None

    def search(self, at: int) -> int | None:
        """Return where the next whole chunk, message index or end of data stands, from `at`."""
        while at < self.limit:
            block = read_at(self.file, at, _SEARCH_BYTES + _PATTERN_BYTES)
            for match in _PATTERN.finditer(block):
                if match.start() < _SEARCH_BYTES and self.plausible(block, match.start(), at):
                    return at + match.start()
            at += _SEARCH_BYTES
        return None

    def plausible(self, block: bytes, start: int, base: int) -> bool:
        opcode, length = RECORD_HEAD.unpack_from(block, start)
        if base + start + RECORD_HEAD.size + length > self.limit:
            return False
        if opcode == Opcode.CHUNK:
            (name_length,) = struct.unpack_from("<I", block, start + 37)
            at = start + 41 + name_length
            if at + 8 > len(block):
                return False
            (size,) = struct.unpack_from("<Q", block, at)
            return bool(length == _CHUNK_FIXED + name_length + size)
        if opcode == Opcode.MESSAGE_INDEX:
            (size,) = struct.unpack_from("<I", block, start + 11)
            return bool(length == size + 6 and size and size % 16 == 0)
        return True


def parse_record(opcode: int, body: bytes) -> McapRecord | None:
    """Return the record with this content, None if it makes no sense."""
    kinds: dict[int, type[McapRecord]] = {
        Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.ATTACHMENT: Attachment,
        Opcode.METADATA: Metadata, Opcode.STATISTICS: Statistics}
    kind = kinds.get(opcode)
    if kind is None:
        return None
    stream = ReadDataStream(io.BytesIO(body))
    try:
        record: McapRecord = kind.read(stream)  # type: ignore[attr-defined]
    except (McapError, ValueError, struct.error, OverflowError, MemoryError):
        return None
    return record if stream.count == len(body) else None


def _attachment_intact(body: bytes) -> bool:
    crc = int.from_bytes(body[-4:], "little")
    return crc in (0, zlib.crc32(body[:-4]))


@dataclass
class _Summary:
    """The part between the data and the footer: where it starts, what it repeats."""

    start: int
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)


def _read_summary(file: int, scan: FileScan) -> _Summary | None:
    """Read the summary if it is there and sound; sets `finished` and `statistics`."""
    at = scan.size - _FOOTER_BYTES
    footer = read_at(file, max(at, 0), _FOOTER_BYTES)
    if (len(footer) < _FOOTER_BYTES or footer[-8:] != MAGIC
            or footer[:9] != RECORD_HEAD.pack(Opcode.FOOTER, 20)):
        return None
    start, _, crc = struct.unpack_from("<QQI", footer, RECORD_HEAD.size)
    if start == 0:
        scan.finished = True
        return _Summary(at)
    if start >= at:
        return None
    content = read_at(file, start, at - start)
    if crc and zlib.crc32(footer[:25], zlib.crc32(content)) != crc:
        return None
    scan.finished = True
    summary = _Summary(start)
    for opcode, body in records_in(content):
        record = parse_record(opcode, body)
        if isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
        elif isinstance(record, Statistics):
            scan.statistics = record
    return summary


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
