"""SQLite bags (`.db3`) of rosbag2: the messages of their tables, through the decoder of MCAP bags.

The decoder takes messages as MCAP records; here these are put around the rows of the database.
"""

from __future__ import annotations

import contextlib
import sqlite3
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dfm_stage.recording.bag import Bag, chosen_topics
from dfm_stage.recording.decode_plan import compile_plan
from dfm_stage.recording.errors import BagReadError, DefinitionError
from dfm_stage.recording.mcap_scan import Loss
from dfm_stage.recording.message_definitions import definition_text, full_name, parse_schema
from dfm_stage.recording.rosbag2_metadata import BagFiles

if TYPE_CHECKING:
    from dfm_stage.recording.topic_arrays import TopicArrays

_RECORD = struct.Struct("<BQHIQQ")      # opcode, length, channel, sequence, log and publish time
_MESSAGE, _HEAD_BYTES = 5, 22
_BATCH = 4096                           # messages that are decoded at a time
_DAMAGED = (sqlite3.DatabaseError, UnicodeDecodeError)     # the latter in its own message, too
_SOUND = ("FROM messages WHERE typeof(timestamp) = 'integer' AND timestamp >= 0 "
          "AND typeof(data) = 'blob'")      # a table of SQLite takes values of any type


@dataclass
class _Topic:
    """One topic: its type, its message count, and where it is in each file."""

    type_name: str
    encoding: str
    places: list[tuple[sqlite3.Connection, int, int]]
    definition: str | None = None

    @property
    def count(self) -> int:
        return sum(count for _, _, count in self.places)


def read_sqlite(path: Path, files: BagFiles, topics: Iterable[str] | None) -> Bag:
    """Read the SQLite files of a bag into arrays; parameters as those of `read_bag`.

    Raises
    ------
    BagReadError
        If a file is no SQLite bag, or a topic asked for is not in it.
    """
    losses = list(files.losses)
    left_out: dict[str, str] = {}
    read = {}
    with contextlib.ExitStack() as stack:
        found: dict[str, _Topic] = {}
        for file in files.files:
            connection = stack.enter_context(contextlib.closing(_opened(file)))
            _survey(connection, file, found)
        chosen = chosen_topics(path, found, topics)
        for name in (each for each in found if each in chosen):
            try:
                arrays = _arrays(name, found[name])
            except DefinitionError as reason:
                left_out[name] = str(reason)
                continue
            losses += _fill(arrays, found[name])
            read[name] = arrays.finish()
            if arrays.bad_rows:
                losses.append(Loss(f"{name}: {len(arrays.bad_rows)} messages do not fit the "
                                   f"definition of {arrays.type_name} and were left out",
                                   messages=len(arrays.bad_rows)))
        losses += [Loss(f"{name}: {count - found[name].count} of {count} messages are missing",
                        messages=count - found[name].count)
                   for name, count in files.expected.items()
                   if name in found and count > found[name].count]
    return Bag(path, read, losses=losses, left_out=left_out)


def _opened(file: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)
    connection.text_factory = lambda data: data.decode("utf-8", "replace")
    return connection


def _survey(connection: sqlite3.Connection, file: Path, found: dict[str, _Topic]) -> None:
    """Add what one file holds."""
    try:
        rows = connection.execute(
            "SELECT id, name, type, serialization_format FROM topics "
            "WHERE typeof(id) = 'integer'").fetchall()
        counts = dict(connection.execute(
            f"SELECT topic_id, COUNT(*) {_SOUND} GROUP BY topic_id"
        ).fetchall())
        has = connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"
                                 ).fetchone()
        texts = dict(connection.execute(
            "SELECT topic_type, CAST(encoded_message_definition AS TEXT) "
            "FROM message_definitions WHERE encoding = 'ros2msg'").fetchall()) if has else {}
    except _DAMAGED as error:
        raise BagReadError(f"{file}: is no readable SQLite bag ({error})") from error
    for number, name, type_name, encoding in rows:
        topic = found.setdefault(str(name), _Topic(str(type_name), str(encoding), []))
        topic.places.append((connection, int(number), int(counts.get(number, 0))))
        topic.definition = topic.definition or texts.get(type_name) or None


def _arrays(name: str, topic: _Topic) -> TopicArrays:
    """Return the empty arrays of a topic.

    The definition is the bag's, else, as older bags have none, that of the installed type.
    """
    from dfm_stage.recording.topic_arrays import TopicArrays

    if topic.encoding != "cdr":
        raise DefinitionError(f"its messages are encoded as {topic.encoding}, not cdr")
    type_name = full_name(topic.type_name)
    definitions = parse_schema(topic.definition or definition_text(type_name), type_name)
    return TopicArrays(name, type_name, compile_plan(definitions, type_name), topic.count)


def _fill(arrays: TopicArrays, topic: _Topic) -> list[Loss]:
    row, losses = 0, []
    for connection, number, count in topic.places:
        end = row + count
        try:
            for data, offsets in _batches(connection, number, row, count):
                arrays.decode(data, offsets, row)
                row += len(offsets)
            reason = "their index contradicts them"
        except _DAMAGED as error:
            reason = str(error)
        if row < end:
            losses.append(Loss(f"{arrays.name}: {end - row} messages are not readable ({reason})",
                               messages=end - row))
            arrays.empty_rows.append((row, end))
        row = end
    return losses


def _batches(connection: sqlite3.Connection, topic: int, row: int, count: int
             ) -> Iterator[tuple[Any, Any]]:
    """Yield messages in the order of their times, as (records of MCAP, where each begins).

    In a damaged file the index by which SQLite chooses may contradict the table.
    """
    cursor = connection.execute(f"SELECT timestamp, data {_SOUND} "
                                "AND topic_id = ? ORDER BY timestamp, id LIMIT ?", (topic, count))
    while fetched := cursor.fetchmany(_BATCH):
        messages = [(stamp, data) for stamp, data in fetched
                    if isinstance(stamp, int) and stamp >= 0 and isinstance(data, bytes)]
        if not messages:
            continue
        sizes = [_RECORD.size + len(data) for _, data in messages]
        records = b"".join(part for k, (stamp, data) in enumerate(messages, row) for part in (
            _RECORD.pack(_MESSAGE, _HEAD_BYTES + len(data), 0, k & 0xFFFFFFFF, stamp, stamp),
            data))
        row += len(messages)
        yield (np.frombuffer(records, np.uint8),
               np.cumsum([0, *sizes[:-1]], dtype=np.int64))
