"""An MCAP file being written: records in, bytes on disk, the index kept for the end.

One thread at a time. Everything rare goes through the record classes of the `mcap` library; chunks
are written here, because their messages arrive already serialised (see `bag_writer`). A failed
write is cut off again, so that the file always ends with a whole record.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from dfm_stage.recording.chunk import Chunk
from dfm_stage.recording.errors import BagWriteError, writing
from dfm_stage.recording.formats import BINARY, MAGIC
from dfm_stage.recording.mcap_scan import RECORD_HEAD

COMPRESSIONS = ("zstd", "lz4", "none")

_CHUNK_HEAD = struct.Struct("<QQQI")
_INDEX_HEAD = struct.Struct("<BQHI")


class McapSink:
    """A new MCAP file of profile `ros2`.

    Parameters
    ----------
    path : Path
        Must not exist.
    compression : str
        One of `zstd`, `lz4`, `none`; by chunk. zstd frames carry a checksum.
    library : str
        Who wrote the file.

    Raises
    ------
    BagWriteError
        If the file exists or cannot be created.
    """

    def __init__(self, path: Path, compression: str = "zstd", library: str = "dfm_stage") -> None:
        if compression not in COMPRESSIONS:
            raise BagWriteError(f"compression {compression!r}: choose one of {COMPRESSIONS}")
        self.path = path
        self.compression = "" if compression == "none" else compression
        self.counts: dict[int, int] = {}
        self.start_ns = 2**64 - 1
        self.end_ns = 0
        compressors: dict[str, Callable[[memoryview], bytes | bytearray]] = {
            "zstd": zstandard.ZstdCompressor(level=1, write_checksum=True).compress,
            "lz4": partial(lz4.frame.compress, content_checksum=True), "none": bytes}
        self._compress = compressors[compression]
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._end = 0
        with writing(path):
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | BINARY,
                                 0o644)
        try:
            self._append(MAGIC + _bytes_of(Header("ros2", library)))
        except BagWriteError:
            os.close(self._file)
            raise

    @property
    def message_count(self) -> int:
        """Messages on disk."""
        return sum(self.counts.values())

    def write_schema(self, schema: Schema) -> None:
        """Write one schema; raises BagWriteError as everything here does when the disk refuses."""
        self._append(_bytes_of(schema))
        self._schemas.append(schema)

    def write_channel(self, channel: Channel) -> None:
        """Write one channel; its schema must be there."""
        self._append(_bytes_of(channel))
        self._channels.append(channel)
        self.counts[channel.id] = 0

    def write_attachment(self, attachment: Attachment) -> None:
        """Write one attachment."""
        data = _bytes_of(attachment)
        self._attachments.append(AttachmentIndex(
            offset=self._append(data), length=len(data), log_time=attachment.log_time,
            create_time=attachment.create_time, data_size=len(attachment.data),
            name=attachment.name, media_type=attachment.media_type))

    def write_metadata(self, name: str, content: dict[str, str]) -> None:
        """Write one metadata record."""
        data = _bytes_of(Metadata(name=name, metadata=content))
        self._metadata.append(MetadataIndex(offset=self._append(data), length=len(data),
                                            name=name))

    def write_chunk(self, chunk: Chunk) -> None:
        """Compress and write one chunk and its message indexes."""
        records, compression = self._compress(chunk.records.data), self.compression.encode()
        head = (_CHUNK_HEAD.pack(chunk.start_ns, chunk.end_ns, len(chunk.records),
                                 zlib.crc32(chunk.records.data))
                + struct.pack("<I", len(compression)) + compression
                + struct.pack("<Q", len(records)))
        chunk_length = RECORD_HEAD.size + len(head) + len(records)
        parts: list[Any] = []
        index_offsets = {}
        position = self._end + chunk_length
        for channel, index in chunk.indexes.items():
            index_offsets[channel] = position
            parts += [_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + index.nbytes, channel,
                                       index.nbytes), index.data]
            position += _INDEX_HEAD.size + index.nbytes
        offset = self._append(RECORD_HEAD.pack(Opcode.CHUNK, chunk_length - RECORD_HEAD.size)
                              + head, records, b"".join(parts))
        self._chunk_indexes.append(ChunkIndex(
            message_start_time=chunk.start_ns, message_end_time=chunk.end_ns,
            chunk_start_offset=offset, chunk_length=chunk_length,
            message_index_offsets=index_offsets,
            message_index_length=position - offset - chunk_length, compression=self.compression,
            compressed_size=len(records), uncompressed_size=len(chunk.records)))
        for channel, index in chunk.indexes.items():
            self.counts[channel] += len(index)
        self.start_ns = min(self.start_ns, chunk.start_ns)
        self.end_ns = max(self.end_ns, chunk.end_ns)

    def finish(self) -> None:
        """Write the end of the data, the summary and the footer."""
        start = self._end + len(data_end := _bytes_of(DataEnd(0)))
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels),
            channel_message_counts=self.counts, chunk_count=len(self._chunk_indexes),
            message_count=self.message_count, metadata_count=len(self._metadata),
            message_start_time=self.start_ns if self.message_count else 0,
            message_end_time=self.end_ns, schema_count=len(self._schemas))
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]), (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata)]
        summary = RecordBuilder()
        offsets = []
        for opcode, records in groups:
            group_start = summary.count
            for record in records:
                record.write(summary)
            if records:
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=start + group_start,
                                             group_length=summary.count - group_start))
        offset_start = start + summary.count
        for entry in offsets:
            entry.write(summary)
        content = _content(summary)
        crc = zlib.crc32(content + struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start))
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc)
        self._append(data_end + content + _bytes_of(footer) + MAGIC)

    def close(self) -> None:
        """Close the file; `finish` first, or it stays without an index."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _append(self, *parts: bytes | bytearray) -> int:
        """Write all parts at the end, one after the other; return their offset, or leave the file
        as it was. They are not joined: that would hold the interpreter lock."""
        offset = self._end
        try:
            with writing(self.path):
                for part in parts:
                    view = memoryview(part)
                    while view:
                        os.lseek(self._file, self._end, os.SEEK_SET)
                        written = os.write(self._file, view)
                        self._end += written
                        view = view[written:]
        except BagWriteError:
            self._end = offset
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, offset)
            raise
        return offset


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _content(builder)


def _content(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]
