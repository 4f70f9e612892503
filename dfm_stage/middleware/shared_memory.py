"""What a killed process does to Fast DDS's ports in shared memory, and how our nodes live with it.

A graph of this machine alone has no such ports (config/fastdds_local.xml). The notes below then
stand for UDP ports, and still tell whose endpoints were killed. The rest is for a graph that was
opened to the network.

Every Fast DDS participant reads two numbered ports in /dev/shm, and a new one takes the lowest
free numbers: those of a killed participant. Until its lease ends (config/fastdds.xml) the others
go on writing to it; where its reader stood still for longer than healthy_check_timeout_ms of our
profiles they remove the port and make it anew, and with it the mutex that should keep this apart
from the opening of the port by the next participant. Now and then that one is left with a port
that has no name any more: it looks alive and hears nobody (Fast DDS 2.14, SharedMemGlobal.hpp,
`open_port_internal` and `~Port`). Hence a note in /dev/shm for every port of our nodes, locked
while its process lives: a note without a lock is a killed node's, and its port is not taken for
LEASE_S. The note says whose endpoints its participant's were, for they still look matched.

Every healthy_check_timeout_ms each port is checked by those who have it open: a reader that waits
must have woken since the last check. From a check until the next message, or for a third of that
time, a reader that merely waits looks dead. Whoever opens its port then sleeps for that third
(`healthy_check`: 2.67 s with our profiles, 0.33 s for the ports of `ros2` tools), with the lock of
the port, in the thread in which it hears of others. So tools that came and went held the whole
graph up, and starting a node or calling a service for the first time took seconds.
`put_off_checks` dates the last check of each port into the future: there is none. That a reader
was killed is told by its locks and its lease.

Rarer, a process is killed while it holds the mutex of a neighbour's port; the others then give
that port up as broken, and it is the neighbour who hears nobody. `PortWatch` tells.

Rarer still, one is killed when it has just made the file of a port, still of no size. Whoever
writes to that port then waits for the size for ever (boost 1.7x, `managed_open_or_create_impl`),
and with it all that this process has to say. The `PortWatch` of every process that has ports there
marks such a file as broken, which ends the wait; Fast DDS then makes the port anew.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import os
import re
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 where Fast DDS puts it
PORT_BASE, DOMAIN_GAIN = 7400, 250
"""First port of domain 0, and ports of each domain (DDSI-RTPS 2.5, 9.6.2.4)."""
_LOOPBACK, _ANY_PORT = "127.0.0.1", 32768
"""From the second on a port is one that the system chose, of a socket that only sends."""
LEASE_S = 14.0
PORT_LOOK_S = 1.0
_NOTE, _SEEN_DEAD = "dfm_stage_port", b"\nkilled"
_NOTE_SIZE = 1024
"""More than a note holds: an identifier, the names of nodes, and that they were killed."""
_PARTICIPANT = 12
"""Length of what the global identifiers of all endpoints of a participant begin with, bytes."""
EMPTY_S = 0.5
"""Age from which a port of no size is one that nobody is making any more."""
_BROKEN = (3).to_bytes(4, "little")
"""boost::interprocess `CorruptedSegment`, the first word of a segment."""
_PORT = "fastrtps_port"
_NODE_WITHIN = 512
"""Bytes of a port's file in which its `PortNode` begins: at 256 in Fast DDS 2.14."""
_LAST_CHECK, _NUMBERS = struct.Struct("<q"), struct.Struct("<IIII")
_BEFORE_NUMBERS = 20
"""From `last_listeners_status_check_time_ms` to `port_id`, bytes (SharedMemGlobal.hpp)."""
_NEVER_MS = 1 << 62
_LOCK = re.compile(r"fastrtps_port(\d+)_el$")
_own: dict[str, int] = {}


@contextlib.contextmanager
def avoiding_dead_ports() -> Iterator[None]:
    """To be held while a participant (the first node of a context) is made."""
    with contextlib.ExitStack() as held:
        for note, number in _named(_NOTE):
            if number not in _own and _killed_lately(note):
                _hold(number, held)
        yield
    take_back_notes()
    for number in (_ports_read_here() | _sockets_here()) - _own.keys():
        _leave_note(number)
    put_off_checks()


def sign_notes(endpoint: Sequence[int], nodes: Sequence[str]) -> bool:
    """Write into this process's notes whose they are: the identifier of any endpoint here, and
    the full names of the nodes. Return whether all are signed; /dev/shm may be full."""
    words = bytes(endpoint[:_PARTICIPANT]) + " and ".join(nodes).encode()
    signed = True
    for descriptor in _own.values():
        try:
            os.pwrite(descriptor, words[:_NOTE_SIZE - len(_SEEN_DEAD)], 0)
        except OSError:
            signed = False
    return signed


def killed_neighbours() -> tuple[str, ...]:
    """Return the nodes of the domains of this process that were killed within their lease.

    Names of nodes that shared a process are one text; a process that had not signed is `a node`.
    """
    return tuple(sorted({words[_PARTICIPANT:].decode("utf-8", "replace") or "a node"
                         for words in _notes_of_killed()}))


def killed_endpoints() -> tuple[bytes, ...]:
    """Return what the identifiers of endpoints begin with that were killed within their lease.

    Those of a process that had not signed are not known.
    """
    return tuple({words[:_PARTICIPANT] for words in _notes_of_killed()
                  if len(words) >= _PARTICIPANT})


def _notes_of_killed() -> Iterator[bytes]:
    domains = {_domain(number) for number in _own} - {None}
    for note, number in _named(_NOTE):
        if number not in _own and _domain(number) in domains and _killed_lately(note):
            with contextlib.suppress(OSError):
                yield note.read_bytes().removesuffix(_SEEN_DEAD)


def _named(beginning: str) -> Iterator[tuple[Path, str]]:
    """Yield the files there are of a beginning and a number. A `glob` takes ten times as long,
    and what killed processes left adds up to a thousand names."""
    try:
        names = os.listdir(SHARED_MEMORY)
    except OSError:
        return
    for name in names:
        if name.startswith(beginning) and (number := name[len(beginning):]).isdecimal():
            yield SHARED_MEMORY / name, number


def _domain(number: str) -> int | None:
    """The domain of a port; None of the lower ports, which all domains share."""
    above = int(number) - PORT_BASE
    return above // DOMAIN_GAIN if above >= 0 else None


def take_back_notes() -> None:
    """To be called when a participant of a process that goes on has ended."""
    for number in _own.keys() - _ports_read_here() - _sockets_here():
        _take_back(number)


def _killed_lately(note: Path) -> bool:
    try:
        descriptor = os.open(note, os.O_RDWR | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        if not os.read(descriptor, _NOTE_SIZE).endswith(_SEEN_DEAD):
            os.write(descriptor, _SEEN_DEAD)  # the lease ends this long after, at the latest
        if time.time() - os.fstat(descriptor).st_mtime < LEASE_S:
            return True
        note.unlink(missing_ok=True)
    except OSError:
        pass  # its process lives
    finally:
        os.close(descriptor)
    return False


def _hold(number: str, held: contextlib.ExitStack) -> None:
    """Take a port, and the lock of its reader in shared memory, until `held` is closed: Fast DDS
    goes to the next port."""
    with contextlib.suppress(OSError):
        taken = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        taken.bind((_LOOPBACK, int(number)))
    lock = SHARED_MEMORY / f"{_PORT}{number}_el"
    with contextlib.suppress(OSError):
        descriptor = os.open(lock, os.O_RDONLY | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        held.callback(os.close, descriptor)
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)  # others may start at once


def _ports_read_here() -> set[str]:
    """Return the numbers of the ports whose lock this process has open."""
    with contextlib.suppress(OSError):
        return {lock[1] for link in _links() if (lock := _LOCK.search(link))}
    return set()


def _sockets_here() -> set[str]:
    """Return the numbers of the ports on loopback that this process reads."""
    with contextlib.suppress(OSError):
        lines = [line.split() for line in
                 Path("/proc/self/net/udp").read_text("ascii").splitlines()[1:]]
        numbers = {f"socket:[{line[9]}]": int(line[1].partition(":")[2], 16) for line in lines}
        return {str(numbers[link]) for link in _links()
                if numbers.get(link, _ANY_PORT) < _ANY_PORT}
    return set()


def _links() -> Iterator[str]:
    """Yield what this process has open."""
    for descriptor in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            yield os.readlink(f"/proc/self/fd/{descriptor}")


def _leave_note(number: str) -> None:
    with contextlib.suppress(OSError):
        descriptor = os.open(SHARED_MEMORY / f"{_NOTE}{number}",
                             os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # of a process that lives and has given the port back
            os.close(descriptor)
            return
        os.ftruncate(descriptor, 0)
        _own[number] = descriptor


def _take_back(number: str) -> None:
    (SHARED_MEMORY / f"{_NOTE}{number}").unlink(missing_ok=True)
    os.close(_own.pop(number))


def mark_empty_ports() -> None:
    """Mark ports that were never finished as broken: who waits for one goes on."""
    for port, _ in _named(_PORT):
        with contextlib.suppress(OSError):
            found = os.stat(port)
            if found.st_size == 0 and time.time() - found.st_ctime > EMPTY_S:
                with port.open("r+b") as file:
                    file.write(_BROKEN)


def put_off_checks() -> None:
    """Have no port of the domains that this process is in checked for a reader that stands still.

    A port whose beginning is not that of Fast DDS 2.14 is left alone.
    """
    domains = {_domain(number) for number in _own}
    for port, number in _named(_PORT):
        if _domain(number) in domains:
            with contextlib.suppress(OSError):
                _put_off_checks(port, int(number))


def _put_off_checks(port: Path, number: int) -> None:
    descriptor = os.open(port, os.O_RDWR | os.O_NOFOLLOW)
    try:
        head = os.pread(descriptor, _NODE_WITHIN, 0)
        for at in range(_BEFORE_NUMBERS, len(head) - _NUMBERS.size, 4):
            named, _, timeout_ms, wait_ms = _NUMBERS.unpack_from(head, at)
            if named == number and timeout_ms and wait_ms == timeout_ms // 3:
                checked = at - _BEFORE_NUMBERS
                if 0 < _LAST_CHECK.unpack_from(head, checked)[0] < _NEVER_MS:
                    os.pwrite(descriptor, _LAST_CHECK.pack(_NEVER_MS), checked)
                return
    finally:
        os.close(descriptor)


class PortWatch:
    """Tells whether the ports that this process reads are still the ones that others find."""

    def __init__(self) -> None:
        ports = [SHARED_MEMORY / f"{_PORT}{number}" for number in _ports_read_here()]
        self._files = {port: _inode(port) for port in ports}
        self._missing = 0

    def lost(self) -> bool:
        """Look; True when a port was missing twice in a row and was not made anew from here.

        Where this process has no port in shared memory it writes to none, and there is nothing to
        look at.
        """
        if not self._files:
            return False
        mark_empty_ports()
        put_off_checks()
        changed = [port for port, known in self._files.items()
                   if not known or _inode(port) != known]
        if changed:
            maps = Path("/proc/self/maps").read_text("utf-8", "replace")
            for port in [each for each in changed if f" {each}\n" in maps]:
                self._files[port] = _inode(port)
                changed.remove(port)
        self._missing = self._missing + 1 if changed else 0
        return self._missing > 1


def _inode(path: Path) -> int:
    try:
        return path.stat().st_ino
    except OSError:
        return 0


@atexit.register
def _forget() -> None:
    """A clean end: the ports are free for anybody."""
    for number in list(_own):
        _take_back(number)
