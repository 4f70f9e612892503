"""From a bag to arrays, in bulk: chunks are expanded and decoded by compiled loops, on all cores.

The number of messages of every topic in every chunk is known before anything is decoded, from the
message indexes, or from a first look into the chunks where there are none. So every chunk writes
straight into its place in the arrays that are returned, and nothing else grows with the bag.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from dfm_stage.processors import usable_cores
from dfm_stage.recording.bag import DROPPED_KEY, Bag, Topic, chosen_topics
from dfm_stage.recording.chunk_data import DamagedError, expand, survey_chunk
from dfm_stage.recording.decode_plan import Plan, compile_plan
from dfm_stage.recording.errors import BagReadError, DefinitionError
from dfm_stage.recording.formats import BINARY, STORAGES
from dfm_stage.recording.mcap_scan import ChunkPlace, FileScan, Loss, parse_record, scan_file
from dfm_stage.recording.message_definitions import definition_text, full_name, parse_schema
from dfm_stage.recording.rosbag2_metadata import BagFiles, find_files
from dfm_stage.recording.sqlite_bag import read_sqlite

if TYPE_CHECKING:
    from dfm_stage.recording.topic_arrays import TopicArrays

CHANNEL_IDS = 1 << 16
_ENCODINGS = ("ros2msg", "ros2idl", "")      # of definitions; of the latter two the installed
_UNWANTED = -1            # the topic number of channels that are not read


def read_bag(path: str | os.PathLike[str], topics: Iterable[str] | None = None, *,
             threads: int | None = None) -> Bag:
    """Read a bag folder, or one .mcap (whole or cut off) or .db3 file, into arrays.

    Parameters
    ----------
    topics : iterable of str, optional
        Names, which must be there, or patterns like `/stage/x/*`; all topics by default.
    threads : int, optional
        Default: one per core that this process may use.

    Returns
    -------
    Bag
        What could be read; `losses` says what could not.

    Raises
    ------
    BagReadError
        If this is not a bag, or a topic asked for is not in it.
    """
    where = Path(path)
    files = find_files(where)
    if files.files[0].suffix == STORAGES["sqlite3"]:
        return read_sqlite(where, files, topics)
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(threads or usable_cores()))
        sources = []
        for file in files.files:
            try:
                handle = os.open(file, os.O_RDONLY | BINARY)
            except OSError as error:
                raise BagReadError(f"{file}: cannot be read ({error.strerror})") from error
            stack.callback(os.close, handle)
            sources.append(_Source(handle, scan_file(handle, file)))
        return _Reader(where, files, sources, pool).read(topics)


@dataclass
class _Source:
    """One open file; `slots` gives the topic number of each channel id, -1 for none."""

    handle: int
    scan: FileScan
    slots: NDArray[np.int32] = field(
        default_factory=lambda: np.full(CHANNEL_IDS, _UNWANTED, np.int32))


Wanted = tuple[str, str, Plan]
"""A topic to read, before its size is known: name, type and how to decode it."""
Rows = Mapping[int, tuple[int, int]]
"""The rows that each topic number gets from a chunk: {slot: (first, count)}."""


@dataclass
class _Reader:
    path: Path
    files: BagFiles
    sources: list[_Source]
    pool: ThreadPoolExecutor
    left_out: dict[str, str] = field(default_factory=dict)
    damaged: set[int] = field(default_factory=set)
    chunk_losses: dict[tuple[str, int], Loss] = field(default_factory=dict)
    miscounted: list[ChunkPlace] = field(default_factory=list)
    wanted: list[Wanted] = field(default_factory=list)
    arrays: list[TopicArrays] = field(default_factory=list)

    def read(self, topics: Iterable[str] | None) -> Bag:
        self.survey()
        self.choose(topics)
        self.decode()
        if self.miscounted:
            for chunk in self.miscounted:
                chunk.counts = None
            self.miscounted.clear()
            self.survey()
            self.decode()
        return self.result()

    def survey(self) -> None:
        """Look into the chunks whose content is not known from message indexes."""
        unknown = [(source, chunk) for source in self.sources for chunk in source.scan.chunks
                   if id(chunk) not in self.damaged
                   and (chunk.counts is None or chunk.cut
                        or any(channel not in source.scan.channels for channel in chunk.counts))]
        list(self.pool.map(lambda item: self.look_into(*item), unknown))

    def look_into(self, source: _Source, chunk: ChunkPlace) -> None:
        try:
            data = expand(source.handle, chunk)
        except DamagedError as reason:
            self.lose_chunk(source, chunk, str(reason))
            return
        chunk.counts, definitions, whole = survey_chunk(data)
        self.note_rest(source, chunk, len(data) - whole, whole)
        for opcode, body in definitions:
            source.scan.define(parse_record(opcode, body))

    def lose_chunk(self, source: _Source, chunk: ChunkPlace, reason: str) -> None:
        """Note that a whole chunk cannot be read."""
        self.damaged.add(id(chunk))
        count = sum((chunk.counts or {}).values())
        seconds = max(chunk.end_ns - chunk.start_ns, 0) / 1e9
        messages = f" with {count} messages" if count else ""
        self.note(source, chunk, f"a chunk of {chunk.length} bytes{messages}, about {seconds:.3g} "
                  f"s, {reason}", chunk.length, count, seconds)

    def note_rest(self, source: _Source, chunk: ChunkPlace, rest: int, whole: int) -> None:
        """Note what a chunk lacks behind its last whole record."""
        missing = chunk.offset + chunk.length - source.scan.size
        seconds = (1.0 - min(whole / max(chunk.uncompressed_size, 1), 1.0)) * max(
            chunk.end_ns - chunk.start_ns, 0) / 1e9
        if chunk.cut:
            self.note(source, chunk, f"the last chunk was cut off, {missing} of its "
                      f"{chunk.length} bytes are missing, about {seconds:.3g} s; the whole "
                      f"messages before the cut were read, without a checksum", missing, 0,
                      seconds)
        elif rest:
            self.note(source, chunk, f"a chunk ends in {rest} bytes that are no messages, about "
                      f"{seconds:.3g} s", rest, 0, seconds)

    def note(self, source: _Source, chunk: ChunkPlace, text: str, size: int, messages: int,
             seconds: float) -> None:
        name = source.scan.path.name
        self.chunk_losses.setdefault((name, chunk.offset), Loss(
            f"{name}, byte {chunk.offset}: {text}", size, messages, seconds))

    def choose(self, topics: Iterable[str] | None) -> None:
        """Give every topic that is asked for, and can be decoded, a number."""
        chosen = chosen_topics(self.path, {channel.topic for source in self.sources
                                           for channel in source.scan.channels.values()}, topics)
        numbers: dict[str, int] = {}
        for source in self.sources:
            for channel in source.scan.channels.values():
                name = channel.topic
                if name not in chosen:
                    continue
                try:
                    wanted = understood(source.scan, channel)
                    number = numbers.setdefault(name, len(numbers))
                    if wanted != [*self.wanted, wanted][number]:
                        raise DefinitionError("its later part has another message definition")
                except DefinitionError as reason:
                    self.left_out[name] = str(reason)
                    continue
                if number == len(self.wanted):
                    self.wanted.append(wanted)
                source.slots[channel.id] = number

    def decode(self) -> None:
        from dfm_stage.recording.topic_arrays import TopicArrays

        totals: Counter[int] = Counter()
        tasks = []
        for source in self.sources:
            for chunk in source.scan.chunks:
                counts: Counter[int] = Counter()
                if id(chunk) not in self.damaged:
                    for channel, count in (chunk.counts or {}).items():
                        counts[int(source.slots[channel])] += count
                del counts[_UNWANTED]
                if counts:
                    tasks.append((source, chunk, {slot: (totals[slot], count)
                                                  for slot, count in counts.items()}))
                totals.update(counts)
        self.arrays = [TopicArrays(*wanted, totals[slot])
                       for slot, wanted in enumerate(self.wanted)]
        list(self.pool.map(lambda task: self.decode_chunk(*task), tasks))

    def decode_chunk(self, source: _Source, chunk: ChunkPlace, rows: Rows) -> None:
        from dfm_stage.recording.record_kernels import locate

        try:
            data = expand(source.handle, chunk)
        except DamagedError as reason:
            self.lose_chunk(source, chunk, str(reason))
            for slot, (first, count) in rows.items():
                self.arrays[slot].empty_rows.append((first, first + count))
            return
        counts = np.array([rows.get(slot, (0, 0))[1] for slot in range(len(self.arrays))])
        ends = np.cumsum(counts)
        cursors, offsets = ends - counts, np.empty(int(counts.sum()), np.int64)
        whole, surplus = locate(data, source.slots, cursors, ends, offsets)
        if surplus or (cursors != ends).any():
            self.miscounted.append(chunk)
            return
        self.note_rest(source, chunk, len(data) - whole, whole)
        for slot, (first, count) in rows.items():
            self.arrays[slot].decode(data, offsets[ends[slot] - count:ends[slot]], first)

    def result(self) -> Bag:
        scans = [source.scan for source in self.sources]
        losses = [*self.files.losses, *(loss for scan in scans for loss in scan.losses),
                  *(self.chunk_losses[key] for key in sorted(self.chunk_losses))]
        topics, present = {}, {}
        for arrays in self.arrays:
            topic, bad = arrays.finish(), len(arrays.bad_rows)
            topics[arrays.name], present[arrays.name] = topic, topic.message_count + bad
            if bad:
                losses.append(Loss(f"{arrays.name}: {bad} messages do not fit the definition of "
                                   f"{arrays.type_name} and were left out", messages=bad))
        losses += missing_messages(present, topics.values(), self.files, scans)
        return Bag(self.path, topics,
                   {item.name: item.data for scan in scans for item in scan.attachments},
                   {item.name: item.metadata for scan in scans for item in scan.metadata},
                   losses, self.left_out)


def understood(scan: FileScan, channel: Channel) -> Wanted:
    """Return how to read a channel; raises DefinitionError with the reason if it cannot be."""
    schema = scan.schemas.get(channel.schema_id)
    if schema is None:
        raise DefinitionError("its message definition is missing")
    if channel.message_encoding != "cdr":
        raise DefinitionError(f"its messages are encoded as {channel.message_encoding}, not cdr")
    if schema.encoding not in _ENCODINGS:
        raise DefinitionError(f"its definition is written in {schema.encoding}, not ros2msg")
    try:
        name = full_name(schema.name)
        definitions = parse_schema(_definition(schema, name), name)
    except DefinitionError as error:
        raise DefinitionError(f"its definition cannot be parsed: {error}") from error
    return channel.topic, name, compile_plan(definitions, name)


def _definition(schema: Schema, name: str) -> str:
    """Return the definition in the bag; where there is none, that of the installed message."""
    text: str = schema.data.decode("utf-8", "replace")
    if schema.encoding == "ros2msg" and text.strip():
        return text
    try:
        return definition_text(name)
    except DefinitionError:
        if schema.encoding == "ros2msg":        # a message without fields
            return text
        raise


def missing_messages(present: Mapping[str, int], topics: Iterable[Topic], files: BagFiles,
                     scans: Sequence[FileScan]) -> list[Loss]:
    """Return what the bag promises and does not hold, topic by topic."""
    losses = []
    promised: Counter[str] = Counter()
    told = [(scan, scan.statistics) for scan in scans if scan.statistics is not None]
    complete = len(told) == len(scans)
    for scan, statistics in told:
        for channel, count in statistics.channel_message_counts.items():
            if channel in scan.channels:
                promised[scan.channels[channel].topic] += count
    for name, count in (promised if complete else files.expected).items():
        missing = count - present.get(name, count)
        if missing > 0:
            losses.append(Loss(f"{name}: {missing} of {count} messages are not readable",
                               messages=missing))
    if files.end_ns is not None and not complete:
        last = max((int(topic.log_time_ns.max()) for topic in topics if topic.message_count),
                   default=files.end_ns)
        if last < files.end_ns:
            seconds = (files.end_ns - last) / 1e9
            losses.append(Loss(f"the last {seconds:.3g} s are missing", seconds=seconds))
    unknown = sum(count for scan in scans for chunk in scan.chunks
                  for channel, count in (chunk.counts or {}).items()
                  if channel not in scan.channels)
    if unknown:
        losses.append(Loss(f"{unknown} messages belong to topics whose description is missing",
                           messages=unknown))
    dropped = files.custom_data.get(DROPPED_KEY, "0")
    if dropped != "0":
        losses.append(Loss(f"the recorder itself lost {dropped} messages (disk full or too slow)",
                           messages=int(dropped) if dropped.isdigit() else 0))
    return losses
