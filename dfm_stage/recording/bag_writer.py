"""rosbag2-compatible MCAP bags, written from messages that are already serialised.

Two threads share the work. The caller's `write` only appends the message to the chunk in memory,
about a microsecond. A thread of the writer takes the chunk when it is full, and at least every
`FLUSH_PERIOD_S` whether messages come or not, compresses it and hands it to the operating system
in one call: both leave the interpreter lock alone, so a control loop in the same process runs on.
A process killed at any moment loses what came after the last such call.

The `mcap` library's own `Writer` compresses and writes inside `add_message`, in the caller's
thread, at several times the cost per message; its record classes serve everything else here.
"""

from __future__ import annotations

import atexit
import os
import shutil
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from dfm_stage.files import write_whole
from dfm_stage.recording.bag import DROPPED_KEY
from dfm_stage.recording.errors import BagWriteError, writing
from dfm_stage.recording.mcap_sink import Chunk, McapSink
from dfm_stage.recording.message_definitions import full_name
from dfm_stage.recording.rosbag2_metadata import (
    METADATA_FILE,
    BagInformation,
    QosProfile,
    TopicEntry,
    yaml_text,
)

FLUSH_PERIOD_S = 0.4

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIXED_BYTES = 22
_INDEX_ENTRY = struct.Struct("<QQ")


class BagWriter:
    """A new bag folder: `metadata.yaml` and one MCAP file named after the folder.

    Parameters
    ----------
    directory : path
        The bag folder; it must not exist, its parents are made.
    compression : str
        `zstd`, `lz4` or `none`.
    chunk_bytes : int
        A chunk is written when its messages reach this size, or after FLUSH_PERIOD_S.
    backlog_bytes : int
        What may wait for a slow disk. Beyond it messages are dropped and counted in `lost`; the
        caller is never held up.
    custom_data : mapping, optional
        Goes into metadata.yaml.

    Attributes
    ----------
    message_count : messages accepted by `write` so far
    lost : messages accepted that did not reach the file: disk refused, or far too slow
    error : why nothing is written any more, or None

    Raises
    ------
    BagWriteError
        If the folder exists, cannot be made or cannot be written.
    """

    def __init__(self, directory: str | os.PathLike[str], *, compression: str = "zstd",
                 chunk_bytes: int = 1 << 20, backlog_bytes: int = 256 << 20,
                 ros_distro: str = "jazzy", custom_data: Mapping[str, str] | None = None) -> None:
        self.directory = Path(directory)
        self.file_path = self.directory / f"{self.directory.resolve().name}_0.mcap"
        with writing(self.directory):
            self.directory.parent.mkdir(parents=True, exist_ok=True)
            self.directory.mkdir()
        self._information = BagInformation(self.file_path.name, ros_distro=ros_distro,
                                           custom_data=dict(custom_data or {}))
        try:
            self._sink = McapSink(self.file_path, compression)
            self._write_metadata_yaml()
        except BagWriteError:
            shutil.rmtree(self.directory, ignore_errors=True)
            raise
        self._chunk_bytes = chunk_bytes
        self._backlog_limit = backlog_bytes
        self._topics: list[TopicEntry] = []
        self._schemas: dict[str, Schema] = {}
        self.message_count = self.lost = self._waiting_bytes = 0
        self.error: BagWriteError | None = None
        self._chunk = Chunk()
        self._lock = threading.Lock()
        self._work = threading.Condition(self._lock)
        self._done = threading.Condition(self._lock)
        self._jobs: list[Callable[[], None]] = []
        self._busy = self._flush_now = self._closing = False
        self._process = os.getpid()
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    def add_topic(self, name: str, type_name: str, qos_profiles: Sequence[QosProfile],
                  type_hash: str, definition_text: str) -> int:
        """Announce a topic and return the id that `write` wants.

        Parameters
        ----------
        type_hash : str
            `RIHS01_...`, or empty if unknown.
        definition_text : str
            The schema text, see `message_definitions.definition_text`.

        Raises
        ------
        BagWriteError
            If the topic is there already, or its type with another definition.
        """
        type_name = full_name(type_name)
        with self._lock:
            self._check_open()
            if any(topic.name == name for topic in self._topics):
                raise BagWriteError(f"{self.directory}: topic {name} was added before")
            data = definition_text.encode()
            schema = self._schemas.get(type_name)
            if schema is None:
                schema = self._schemas[type_name] = Schema(
                    id=len(self._schemas) + 1, data=data, encoding="ros2msg", name=type_name)
                self._queue(lambda: self._sink.write_schema(schema))
            elif schema.data != data:
                raise BagWriteError(f"{self.directory}: {type_name} has two definitions; "
                                    f"the processes run different versions of it")
            self._topics.append(TopicEntry(name, type_name, tuple(qos_profiles), type_hash))
            topic_id = len(self._topics)
            profiles = [profile.to_dict() for profile in qos_profiles]
            channel = Channel(
                id=topic_id, topic=name, message_encoding="cdr", schema_id=schema.id,
                metadata={"offered_qos_profiles": yaml_text(profiles) if profiles else "",
                          "topic_type_hash": type_hash})
            self._queue(lambda: self._sink.write_channel(channel))
            self._start_chunk(self._chunk)
        return topic_id

    def write(self, topic_id: int, data: bytes, log_time_ns: int, publish_time_ns: int,
              sequence: int = 0) -> None:
        """Add one message; returns before it is on disk.

        Parameters
        ----------
        data : bytes
            The serialised message with its 4-byte CDR header, unchanged as it came.
        log_time_ns, publish_time_ns : int
            When it was received and published, ns since the epoch.
        sequence : int
            The publisher's counter; its low 32 bits are kept.

        Raises
        ------
        BagWriteError
            If the writer is closed, has failed (`error`; the message counts as lost), or an
            argument is impossible.
        """
        self.write_all([(topic_id, data, log_time_ns, publish_time_ns, sequence)])

    def write_all(self, messages: Sequence[tuple[int, bytes, int, int, int]]) -> None:
        """Add messages, the arguments of `write` each; one that is refused keeps no other out.

        Raises
        ------
        BagWriteError
            As `write`.
        """
        refused: BagWriteError | None = None
        with self._lock:
            if self.error is not None and not self._closing:
                self.message_count += len(messages)
                self.lost += len(messages)
            self._check_open()
            head, entry, kind, fixed = (
                _MESSAGE_HEAD.pack, _INDEX_ENTRY.pack, Opcode.MESSAGE.value, _MESSAGE_FIXED_BYTES)
            chunk = self._chunk
            records, indexes = chunk.records, chunk.indexes
            for topic_id, data, log_ns, publish_ns, sequence in messages:
                try:
                    begin = head(kind, fixed + len(data), topic_id, sequence & 0xFFFFFFFF,
                                 log_ns, publish_ns)
                    indexes[topic_id] += entry(log_ns, len(records))
                except (struct.error, IndexError) as error:
                    refused = BagWriteError(f"{self.directory}: message of topic {topic_id} at "
                                            f"{log_ns} ns refused: {error}")
                    continue
                records += begin
                records += data
                self.message_count += 1
                if len(records) >= self._chunk_bytes:
                    self._hand_over()
                    chunk = self._chunk
                    records, indexes = chunk.records, chunk.indexes
        if refused is not None:
            raise refused

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a file into the bag; it stands before every message written after this call."""
        now = time.time_ns()
        attachment = Attachment(create_time=now, log_time=now, name=name, media_type=media_type,
                                data=data)
        with self._lock:
            self._check_open()
            self._hand_over()
            self._queue(lambda: self._sink.write_attachment(attachment))

    def flush(self) -> None:
        """Return when everything written so far has been handed to the operating system.

        Raises
        ------
        BagWriteError
            If that fails.
        """
        with self._lock:
            self._flush_now = True
            self._work.notify()
            while (self._flush_now or self._busy or self._jobs) and self._thread.is_alive():
                self._done.wait(FLUSH_PERIOD_S)
            if self.error is not None:
                raise self.error

    def close(self) -> None:
        """Write what is left, the index and metadata.yaml. A second call does nothing.

        Raises
        ------
        BagWriteError
            If the bag is not complete; what was written before stays readable.
        """
        with self._lock:
            if self._closing or os.getpid() != self._process:
                return
            self._closing = True
            self._work.notify()
        atexit.unregister(self.close)
        self._thread.join()
        try:
            self._finish()
        finally:
            self._sink.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._closing:
            raise BagWriteError(f"{self.directory}: the bag is closed")
        if self.error is not None:
            raise self.error

    def _start_chunk(self, chunk: Chunk) -> None:
        chunk.indexes += [bytearray() for _ in range(len(self._topics) + 1 - len(chunk.indexes))]

    def _queue(self, job: Callable[[], None]) -> None:
        self._jobs.append(lambda: self._do(job))
        self._work.notify()

    def _hand_over(self) -> None:
        """Queue the chunk in memory and begin another; the lock is held."""
        chunk = self._chunk
        if not chunk.records:
            return
        self._chunk = Chunk()
        self._start_chunk(self._chunk)
        size = len(chunk.records)
        if self._waiting_bytes + size > self._backlog_limit:
            self.lost += chunk.message_count
            return
        self._waiting_bytes += size
        self._jobs.append(lambda: self._write_chunk(chunk))
        self._work.notify()

    def _write_chunk(self, chunk: Chunk) -> None:
        try:
            self._do(lambda: self._sink.write_chunk(chunk))
        finally:
            with self._lock:
                self._waiting_bytes -= len(chunk.records)
                if self.error is not None:
                    self.lost += chunk.message_count

    def _do(self, job: Callable[[], None]) -> None:
        """Run a job of the sink, unless one failed before: no hole is followed by more data."""
        if self.error is None:
            try:
                job()
            except BagWriteError as error:
                self.error = error

    def _run(self) -> None:
        while True:
            with self._lock:
                if not (self._jobs or self._flush_now or self._closing):
                    self._work.wait(FLUSH_PERIOD_S)
                if self._flush_now or self._closing or not self._jobs:
                    self._hand_over()
                jobs, self._jobs = self._jobs, []
                self._flush_now = False
                self._busy = bool(jobs)
            for job in jobs:
                job()
            with self._lock:
                self._busy = False
                self._done.notify_all()
                if self._closing and not self._jobs and not self._chunk.records:
                    return

    def _finish(self) -> None:
        sink = self._sink
        custom = dict(self._information.custom_data)
        if self.lost:
            custom[DROPPED_KEY] = str(self.lost)
        written = sink.message_count
        self._information = replace(
            self._information, message_count=written, custom_data=custom,
            start_ns=sink.start_ns if written else 0,
            duration_ns=sink.end_ns - sink.start_ns if written else 0,
            topics=[replace(topic, message_count=sink.counts.get(index, 0))
                    for index, topic in enumerate(self._topics, 1)])
        try:
            sink.write_metadata("rosbag2",
                                {"serialized_metadata": yaml_text(self._information.to_dict())})
            sink.finish()
            self._write_metadata_yaml()
        except BagWriteError as error:
            self.error = self.error or error
        if self.lost:
            reason = self.error or f"{self.file_path}: the disk is too slow"
            raise BagWriteError(f"{reason} ({self.lost} of {self.message_count} messages "
                                f"were not recorded)")
        if self.error is not None:
            raise self.error

    def _write_metadata_yaml(self) -> None:
        path = self.directory / METADATA_FILE
        with writing(path):
            write_whole(path, yaml_text(
                {"rosbag2_bagfile_information": self._information.to_dict()}))
