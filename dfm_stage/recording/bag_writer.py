"""rosbag2-compatible MCAP bags, written from messages that are already serialised.

Two threads share the work. The caller adds the messages it brings to arrays that are there. When
they are enough for a chunk, and at least every `FLUSH_PERIOD_S` whether messages come or not, a
thread of the writer lays them out (`chunk`), compresses them and hands them to the operating
system. All three leave the interpreter lock alone, so a control loop in the same process runs on.
Arrays are used again: memory that is new to the process costs the loop time, too. A process killed
at any moment loses what came after the last chunk.

The `mcap` library's own `Writer` compresses and writes inside `add_message`, in the caller's
thread, at several times the cost per message; its record classes serve everything else here.
"""

from __future__ import annotations

import atexit
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np
from mcap.records import Attachment, Channel, Schema

from dfm_stage.files import write_whole
from dfm_stage.recording.bag import DROPPED_KEY
from dfm_stage.recording.chunk import Arrival, Layout, Messages, memory, unnumbered
from dfm_stage.recording.errors import BagWriteError, writing
from dfm_stage.recording.mcap_sink import McapSink
from dfm_stage.recording.message_definitions import full_name
from dfm_stage.recording.numba_tools import Ints
from dfm_stage.recording.rosbag2_metadata import (
    METADATA_FILE,
    BagInformation,
    QosProfile,
    TopicEntry,
    yaml_text,
)

FLUSH_PERIOD_S = 0.4
CHUNK_BYTES = 1 << 20
"""Large chunks are quick to read."""
_ROOM = 4
"""Messages of a chunk that wait together have so many times its room, as their columns may take
more than what they say. What is not needed of that is never touched."""

_LATEST_NS = 2**64 - 1


class BagWriter:
    """A new bag folder: `metadata.yaml` and one MCAP file named after the folder.

    Parameters
    ----------
    directory : path
        The bag folder; it must not exist, its parents are made.
    compression : str
        `zstd`, `lz4` or `none`.
    chunk_bytes : int
        A chunk is written when its messages reach about this size, or after FLUSH_PERIOD_S.
    backlog_bytes : int
        What may wait for a slow disk. Beyond it messages are dropped and counted in `lost`; the
        caller is never held up.
    custom_data : mapping, optional
        Goes into metadata.yaml.
    log_stamps : bool
        In `write_arrived`, the stamp in a message stands for the time at which it came: it was
        published by a simulated clock.

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
                 chunk_bytes: int = CHUNK_BYTES, backlog_bytes: int = 256 << 20,
                 ros_distro: str = "jazzy", custom_data: Mapping[str, str] | None = None,
                 log_stamps: bool = False) -> None:
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
        self._layout = Layout(log_stamps)
        self._topics: list[TopicEntry] = []
        self._stamped = [False]  # topics are numbered from 1
        self._schemas: dict[str, Schema] = {}
        self.message_count = self.lost = 0
        self._waiting_bytes = self._new_bytes = 0
        self.error: BagWriteError | None = None
        self._emptied: list[Messages] = []
        self._lock = threading.Lock()
        self._work = threading.Condition(self._lock)
        self._jobs: list[Callable[[], None] | Messages] = []
        self._flush_now = self._closing = False
        self._process = os.getpid()
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    def add_topic(self, name: str, type_name: str, qos_profiles: Sequence[QosProfile],
                  type_hash: str, definition_text: str, stamped: bool = False) -> int:
        """Announce a topic and return the id that `write` wants.

        Parameters
        ----------
        type_hash : str
            `RIHS01_...`, or empty if unknown.
        definition_text : str
            The schema text, see `message_definitions.definition_text`.
        stamped : bool
            Its messages begin with a std_msgs/Header.

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
            self._stamped.append(stamped)
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
        good = []
        for message in messages:
            topic_id, _, log_ns, publish_ns, _ = message
            if (0 < topic_id <= len(self._topics) and 0 <= log_ns <= _LATEST_NS
                    and 0 <= publish_ns <= _LATEST_NS):
                good.append(message)
            else:
                refused = BagWriteError(f"{self.directory}: message of topic {topic_id} at "
                                        f"{log_ns} ns refused")
        if good:
            topics, data, log, publish, sequences = zip(*good, strict=True)
            times = np.array((log, publish, [each & 0xFFFFFFFF for each in sequences]), np.uint64)
            self._accept(topics, data, times.view(np.int64).T)
        if refused is not None:
            raise refused

    def write_arrived(self, arrivals: Sequence[Arrival]) -> None:
        """Add messages as they came: topic id, data, and the system time of that (ns).

        They are numbered topic by topic. A stamped message was published at its stamp, another
        one when it came.

        Raises
        ------
        BagWriteError
            If the writer is closed or has failed, or a topic was not announced.
        """
        if not arrivals:
            return
        topics, data, came_ns = zip(*arrivals, strict=True)
        if min(topics) < 1 or max(topics) > len(self._topics):
            raise BagWriteError(f"{self.directory}: messages refused: one of their topics was not "
                                "announced")
        self._accept(topics, data, unnumbered(came_ns))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a file into the bag; it stands before every message written after this call."""
        now = time.time_ns()
        attachment = Attachment(create_time=now, log_time=now, name=name, media_type=media_type,
                                data=data)
        with self._lock:
            self._check_open()
            self._queue(lambda: self._sink.write_attachment(attachment))

    def flush(self) -> None:
        """Return when everything written so far has been handed to the operating system.

        Raises
        ------
        BagWriteError
            If that fails.
        """
        done = threading.Event()
        with self._lock:
            self._jobs.append(done.set)
            self._flush_now = True
            self._work.notify()
        while not done.wait(FLUSH_PERIOD_S) and self._thread.is_alive():
            pass
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

    def _queue(self, job: Callable[[], None]) -> None:
        self._jobs.append(lambda: self._do(job))

    def _accept(self, topics: Sequence[int], data: Sequence[bytes], times: Ints) -> None:
        """Queue messages, unless too many wait."""
        count, content = len(data), sum(map(len, data))
        size = memory(count, content)
        with self._lock:
            full = self._waiting_bytes + size > self._backlog_limit
            if not self._closing:
                self.message_count += count
                self.lost += count if full or self.error is not None else 0
            self._check_open()
            if full:
                return
            self._waiting_bytes += size
            self._new_bytes += content
            self._room_for(size).add(topics, data, times)
            if self._new_bytes >= self._chunk_bytes:
                self._work.notify()

    def _room_for(self, size: int) -> Messages:
        """Return the messages at the end of the queue, with room for `size` bytes of memory."""
        last = self._jobs[-1] if self._jobs else None
        if not (isinstance(last, Messages) and last.size < self._chunk_bytes and last.fits(size)):
            room = _ROOM * self._chunk_bytes
            last = (Messages(size) if size > room else
                    self._emptied.pop() if self._emptied else Messages(room))
            self._jobs.append(last)
        return last

    # In the writer's thread

    def _work_off(self, jobs: Sequence[Callable[[], None] | Messages]) -> None:
        for job in jobs:
            if isinstance(job, Messages):
                self._write_messages(job)
            else:
                job()

    def _write_messages(self, messages: Messages) -> None:
        """Write messages as a chunk, and keep their arrays for those to come."""
        count, size = messages.count, messages.memory
        try:
            chunk = self._layout.chunk(messages, self._stamped)
            self._do(lambda: self._sink.write_chunk(chunk))
        finally:
            with self._lock:
                self._waiting_bytes -= size
                if self.error is not None:
                    self.lost += count
                if not self._emptied and messages.room == _ROOM * self._chunk_bytes:
                    messages.clear()
                    self._emptied.append(messages)

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
                if not (self._new_bytes >= self._chunk_bytes or self._flush_now or self._closing):
                    self._work.wait(FLUSH_PERIOD_S)
                jobs, self._jobs, self._new_bytes = self._jobs, [], 0
                self._flush_now = False
            expected = self._sink.message_count + sum(
                job.count for job in jobs if isinstance(job, Messages))
            try:
                self._work_off(jobs)
            except Exception as error:  # noqa: BLE001 (whoever writes must hear of it)
                self._fail(jobs, expected - self._sink.message_count, error)
            with self._lock:
                if self._closing and not self._jobs:
                    return

    def _fail(self, jobs: Sequence[Callable[[], None] | Messages], lost: int,
              error: Exception) -> None:
        """Write nothing more after an error that is not the disk's; so many messages of `jobs` are
        lost, and who waits for a flush goes on."""
        failed = BagWriteError(f"{self.file_path}: {type(error).__name__}: {error}")
        with self._lock:
            self.error = self.error or failed
            self.lost += lost
        for job in jobs:
            if not isinstance(job, Messages):
                job()

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
