"""Spoilt .npz, .mat, MCAP and SQLite files: damage inside what is compressed and summed up."""

from __future__ import annotations

import contextlib
import io
import sqlite3
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from random import Random

import lz4.frame
import zstandard

from benchmarks.bytes_damage import NUMBERS, TEXTS, WHOLE, WORDS, damaged

MCAP_MAGIC = b"\x89MCAP0\r\n"
RAW_SHARE = 0.2
"""Inputs of a container that are damaged as plain bytes."""
BOMB_BYTES = (1 << 22, 1 << 28)
"""What a small file expands to: often, and rarely."""
MCAP_WORDS = (*TEXTS, b"float64 a\n", b"float64[] a\n", b"float64[4294967295] a\n", b"string a\n",
              b"string[<=1] a\n", b"=" * 80, b"\nMSG: a/b\n", b"a/b c\n", b"uint8[1000000000] z\n",
              b"std_msgs/Header header\n", b"cdr", b"ros2msg", b"/stage/x/measurement",
              b"dfm_interfaces/msg/Measurement", b"nan", b"int32 A=1\n", b"bool b true\n")
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD_BYTES = 40
_CHUNK, _SCHEMA, _CHANNEL, _MESSAGE, _FOOTER = 6, 3, 4, 5, 2


# .npz

def spoilt_npz(rng: Random, seeds: Sequence[bytes]) -> bytes:
    """An .npz file with damaged headers, data, names or directory."""
    data = rng.choice(seeds)
    if rng.random() < RAW_SHARE:
        return damaged(rng, data, seeds)
    with zipfile.ZipFile(io.BytesIO(data)) as source:
        members = [(name, source.read(name)) for name in source.namelist()]
    at = rng.randrange(len(members))
    name, content = members[at]
    kind = rng.randrange(8)
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    if kind < 4:
        members[at] = name, _spoilt_npy(rng, content)
    elif kind == 4:
        members[at] = name, damaged(rng, content, [each for _, each in members])
    elif kind == 5:
        named = rng.choice(WORDS) + rng.choice((".npy", "", ".npy.npy"))
        members[at] = named.replace("\0", "") or "x.npy", content
    elif kind == 6:
        members.insert(at, rng.choice(members))
    elif rng.random() < 0.02:
        count = BOMB_BYTES[rng.random() < 0.02] // 8
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({count},)}}"
        members[at] = name, _npy(header, bytes(8 * count))
        method = zipfile.ZIP_DEFLATED
    else:
        del members[at]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as target, contextlib.suppress(UserWarning):
        for name, content in members:
            target.writestr(zipfile.ZipInfo(name), content, method)
    made = out.getvalue()
    return damaged(rng, made, seeds) if rng.random() < 0.1 else made


def _npy(header: str, content: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + content


def _spoilt_npy(rng: Random, content: bytes) -> bytes:
    shape = rng.choice((f"({rng.choice(WHOLE)},)", "(-1,)", "(0,)", "()", "(2, 3)", "(1,) * 9",
                        f"({rng.choice(WHOLE)}, {rng.choice(WHOLE)})", "(True,)", "(1.0,)",
                        f"({','.join(['1'] * 40)})", f"({','.join(['0'] * 33)})"))
    descr = rng.choice(("'<f8'", "'<f8'", "'>i2'", "'|O'", "'<U9'", "'|S0'", "'<c16'", "'<f16'",
                        "'<M8[ns]'", "'|V8'", "'|b1'", "[('a', '<f8')]", "'<f3'", "'<U999999999'",
                        "'<u8'", "'(9999,)<f8'", "7", "None", "['<f8']"))
    order = rng.choice((False, True, 7))
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"
    kind = rng.randrange(6)
    if kind == 0:
        header = header.replace(rng.choice("{}':,()"), rng.choice(("", "(" * 300, "\n", "é")))
    if kind == 1:
        header = rng.choice(("[" * 5000, "-" * 9000 + "1", "{'a': 9**9**9}", " " * 60_000, "{}"))
    body = content[128:] if len(content) > 128 else content
    made = bytearray(_npy(header, body))
    if kind == 2:
        made[6:8] = rng.randbytes(2)
    if kind == 3:
        made[8:10] = struct.pack("<H", rng.choice((0, 1, 65535)))
    return bytes(made)


# .mat

def spoilt_mat(rng: Random, seeds: Sequence[bytes]) -> bytes:
    """A .mat file with damaged tags, also behind its compression."""
    data = rng.choice(seeds)
    if rng.random() < RAW_SHARE or len(data) < 136:
        return damaged(rng, data, seeds)
    out, at = bytearray(data[:128]), 128
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        body = data[at + 8:at + 8 + size]
        at += 8 + size
        if kind == 15:
            with contextlib.suppress(zlib.error):
                inner = zlib.decompress(body)
                inner = _spoilt_tags(rng, inner) if rng.random() < 0.5 else inner
                if rng.random() < 0.001:
                    inner = inner[:8] + bytes(BOMB_BYTES[0])
                body = zlib.compress(inner)
        elif rng.random() < 0.5:
            body = _spoilt_tags(rng, body)
        stated = rng.choice(WHOLE) % 2**32 if rng.random() < 0.05 else len(body)
        out += struct.pack("<II", kind, stated) + body
    return bytes(out)


def _spoilt_tags(rng: Random, body: bytes) -> bytes:
    """Change words that stand where tags, sizes and dimensions stand: every four bytes."""
    out = bytearray(body)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = 4 * rng.randrange(min(len(out) // 4, 24) + 1)
        value = rng.choice((*range(20), *WHOLE)) % 2**32
        if rng.random() < 0.8:
            out[at:at + 4] = struct.pack("<I", value)
        else:
            del out[at:at + 4 * rng.choice((1, 2))]
    return bytes(out)


# MCAP

def spoilt_mcap(rng: Random, seeds: Sequence[bytes]) -> bytes:
    """An MCAP file with damaged records, also inside its chunks, their checksums made to fit."""
    data = rng.choice(seeds)
    if rng.random() < RAW_SHARE:
        return damaged(rng, data, seeds, MCAP_WORDS)
    records = mcap_records(data[8:-8])
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(records))
        kind = rng.randrange(8)
        opcode, body = records[at]
        if kind < 4:
            chunks = [k for k, (code, _) in enumerate(records) if code == _CHUNK]
            if chunks:
                at = rng.choice(chunks)
                records[at] = _CHUNK, _spoilt_chunk(rng, records[at][1])
        elif kind == 4:
            records[at] = opcode, damaged(rng, body, (), MCAP_WORDS)
        elif kind == 5:
            records[at] = rng.choice((*range(17), 128, 255)), body
        elif kind == 6:
            records.insert(at, rng.choice(records))
        elif len(records) > 1:
            del records[at]
    if rng.random() < 0.5:      # no summary, so that the records themselves are walked
        records = [(code, bytes(20) if code == _FOOTER else body) for code, body in records]
    parts = [MCAP_MAGIC]
    for opcode, body in records:
        length = rng.choice(WHOLE) % 2**64 if rng.random() < 0.005 else len(body)
        parts.append(_HEAD.pack(opcode, length) + body)
    return b"".join((*parts, MCAP_MAGIC))


def mcap_records(data: bytes) -> list[tuple[int, bytes]]:
    """The records (opcode, content) in a sound part of an MCAP file."""
    found, at = [], 0
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        found.append((opcode, data[at:at + length]))
        at += length
    return found


def _spoilt_chunk(rng: Random, body: bytes) -> bytes:
    if len(body) < _CHUNK_HEAD_BYTES:
        return body
    start, end, size, crc, name_size = struct.unpack_from("<QQQII", body)
    name = body[32:32 + name_size]
    data = body[40 + name_size:]
    kind = rng.randrange(8)
    if kind == 0:
        size = rng.choice(WHOLE) % 2**64
    elif kind == 1:
        crc = rng.choice((0, crc ^ 1))
        size = rng.choice((size, *WHOLE)) % 2**64
        data = damaged(rng, data)
    elif kind == 2:
        name = rng.choice((b"", b"lz4", b"zstd", b"bz2", b"\xff", b"zstd\0", b"ZSTD"))
    elif kind == 3 and rng.random() < 0.03:
        size = BOMB_BYTES[rng.random() < 0.02]
        name, data, crc = b"zstd", zstandard.compress(bytes(size)), 0
    else:
        with contextlib.suppress(Exception):
            inner = _expanded(name, data)
            records = mcap_records(inner)
            for _ in range(rng.choice((1, 2, 5))):
                _spoil_inner(rng, records)
            inner = b"".join(_HEAD.pack(code, len(each)) + each for code, each in records)
            if rng.random() < 0.1:
                inner = damaged(rng, inner, (), MCAP_WORDS)
            name = rng.choice((name, b"", b"zstd", b"lz4"))
            data, size, crc = _packed(name, inner), len(inner), zlib.crc32(inner)
    stated = rng.choice(WHOLE) % 2**64 if rng.random() < 0.02 else len(data)
    return struct.pack("<QQQII", start, end, size, crc, len(name)) + name + struct.pack(
        "<Q", stated) + data


def _spoil_inner(rng: Random, records: list[tuple[int, bytes]]) -> None:
    if not records:
        return
    wanted = rng.choice((_SCHEMA, _SCHEMA, _CHANNEL, _MESSAGE, _MESSAGE))
    places = [k for k, (code, _) in enumerate(records) if code == wanted]
    at = rng.choice(places) if places else rng.randrange(len(records))
    code, body = records[at]
    kind = rng.randrange(6)
    if kind < 3:
        records[at] = code, damaged(rng, body, (), MCAP_WORDS)
    elif kind == 3:
        records.insert(at, (code, body))
    elif kind == 4 and code == _MESSAGE:        # times and payload numbers at the ends of types
        out = bytearray(body)
        place = rng.choice((2, 6, 14, 26, 30, 34, 42, 50))
        out[place:place + 8] = struct.pack("<d", float(rng.choice(NUMBERS[:14]))) \
            if rng.random() < 0.5 else struct.pack("<Q", rng.choice(WHOLE) % 2**64)
        records[at] = code, bytes(out)
    else:
        del records[at]


def _expanded(name: bytes, data: bytes) -> bytes:
    if name == b"zstd":
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 24)
    return bytes(lz4.frame.decompress(data)) if name == b"lz4" else data


def _packed(name: bytes, data: bytes) -> bytes:
    return zstandard.compress(data) if name == b"zstd" else (
        bytes(lz4.frame.compress(data)) if name == b"lz4" else data)


# SQLite

def spoilt_sqlite(rng: Random, seeds: Sequence[bytes]) -> bytes:
    """A SQLite bag with odd cells or tables, or damaged pages."""
    data = rng.choice(seeds)
    if rng.random() < RAW_SHARE:
        return damaged(rng, data, seeds)
    with tempfile.TemporaryDirectory(prefix="dfm_bytes_") as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(data)
        with contextlib.closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA synchronous = OFF")
            for _ in range(rng.choice((1, 1, 2, 4))):
                with contextlib.suppress(sqlite3.Error, OverflowError):
                    _spoil_table(rng, database)
            database.commit()
        made = path.read_bytes()
    return damaged(rng, made, seeds) if rng.random() < 0.1 else made


def _spoil_table(rng: Random, database: sqlite3.Connection) -> None:
    table, columns = rng.choice((
        ("topics", ("id", "name", "type", "serialization_format")),
        ("messages", ("id", "topic_id", "timestamp", "data")),
        ("message_definitions", ("topic_type", "encoding", "encoded_message_definition"))))
    column = rng.choice(columns)
    kind = rng.randrange(6)
    if kind < 4:
        value = rng.choice((None, b"", b"\0\1\0\0", 0, -1, 2**63 - 1, -2**63, 1.5, 1e308, "x", "",
                            "a" * 1000, "dfm_interfaces/msg/Drive", "float64[] a",
                            rng.randbytes(40), "uint8[1000000000] z", "a/b c"))
        where = f"rowid % {rng.choice((1, 2, 7))} = 0"
        database.execute(
            f"UPDATE OR IGNORE {table} SET {column} = ? WHERE {where}", (value,))  # noqa: S608
    elif kind == 4:
        database.execute(rng.choice((f"DROP TABLE {table}", f"DELETE FROM {table}",  # noqa: S608
                                     f"ALTER TABLE {table} RENAME COLUMN {column} TO odd",
                                     f"ALTER TABLE {table} ADD COLUMN odd")))
    else:
        database.execute(
            "INSERT INTO topics (id, name, type, serialization_format) VALUES (?, ?, ?, 'cdr')",
            (rng.randrange(100), rng.choice(WORDS), rng.choice(WORDS)))
