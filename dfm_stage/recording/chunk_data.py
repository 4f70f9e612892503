"""The content of chunks: expanded, checked, and as much as there is of one that was cut off."""

from __future__ import annotations

import threading
import zlib
from typing import TypeAlias

import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray

from dfm_stage.recording.errors import RecordingError
from dfm_stage.recording.mcap_scan import ChunkPlace, read_at, records_in

Bytes: TypeAlias = NDArray[np.uint8]

LARGEST_CHUNK = 1 << 32
_MANY_DEFINITIONS = 4096
_local = threading.local()


class DamagedError(RecordingError):
    """The content of a chunk is not what was written; nothing of it can be trusted."""


def expand(file: int, chunk: ChunkPlace) -> Bytes:
    """Return the records of a chunk of the open file, as bytes.

    Of a chunk that was cut off, what can still be expanded; it is not covered by a checksum.

    Raises
    ------
    DamagedError
        If it cannot be expanded, or fails its checksum.
    """
    data = read_at(file, chunk.offset, chunk.length)
    try:
        if chunk.compression == "":
            records, checked = data, chunk.crc == 0
        elif chunk.compression == "zstd":
            records, checked = _expand_zstd(data, chunk)
        elif chunk.compression == "lz4":
            records, checked = _expand_lz4(data, chunk), False
        else:
            raise DamagedError(f"is compressed in an unknown way ({chunk.compression!r})")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedError("cannot be decompressed") from error
    if not chunk.cut:
        if len(records) != chunk.uncompressed_size:
            raise DamagedError("has not the size it states")
        if not checked and chunk.crc and zlib.crc32(records) != chunk.crc:
            raise DamagedError("fails its checksum")
    return np.frombuffer(records, dtype=np.uint8)


def _expand_lz4(data: bytes, chunk: ChunkPlace) -> bytes:
    frame = lz4.frame.LZ4FrameDecompressor()
    records: bytes = frame.decompress(data, min(chunk.uncompressed_size, LARGEST_CHUNK) + 1)
    if not (chunk.cut or frame.eof):
        raise DamagedError("has not the size it states")
    return records


def _expand_zstd(data: bytes, chunk: ChunkPlace) -> tuple[bytes, bool]:
    """Return (records, whether a checksum inside the data has been verified)."""
    if chunk.cut:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data), True
    frame = zstandard.get_frame_parameters(data)
    known = frame.content_size not in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR)
    size = frame.content_size if known else chunk.uncompressed_size
    if size != chunk.uncompressed_size or size > LARGEST_CHUNK:
        raise DamagedError("has not the size it states")
    if not hasattr(_local, "zstd"):
        _local.zstd = zstandard.ZstdDecompressor()
    return _local.zstd.decompress(data, max_output_size=size), bool(frame.has_checksum)


def survey_chunk(data: Bytes) -> tuple[dict[int, int], list[tuple[int, bytes]], int]:
    """Look through the records of a chunk without decoding them.

    Returns
    -------
    (messages by channel id, (opcode, content) of schemas and channels, bytes in whole records)
    """
    from dfm_stage.recording.record_kernels import survey

    counts = np.zeros(1 << 16, np.int64)
    places = np.empty(_MANY_DEFINITIONS, np.int64)
    whole, found = survey(data, counts, places)
    lengths = [int.from_bytes(data[at + 1:at + 9].tobytes(), "little")
               for at in places[:min(found, _MANY_DEFINITIONS)]]
    definitions = [next(records_in(data[at:at + 9 + length].tobytes()))
                   for at, length in zip(places, lengths, strict=False)]
    return ({int(channel): int(counts[channel]) for channel in np.flatnonzero(counts)},
            definitions, int(whole))
