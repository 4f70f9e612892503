"""The notes that say whose the endpoints of a process are, as the others read them once it was
killed: all kept in a folder in the place of /dev/shm."""

from __future__ import annotations

import errno
import os

import pytest

from dfm_stage.middleware import shared_memory
from dfm_stage.middleware.shared_memory import (
    PORT_BASE,
    PortWatch,
    killed_endpoints,
    killed_neighbours,
    sign_notes,
)

OURS, THEIRS = str(PORT_BASE + 10), str(PORT_BASE + 12)
ENDPOINT = bytes(range(1, 25))


@pytest.fixture
def notes(tmp_path, monkeypatch):
    """Notes in a folder of the test, one of this process among them."""
    monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
    monkeypatch.setattr(shared_memory, "_own", {})
    shared_memory._leave_note(OURS)
    yield tmp_path
    os.close(shared_memory._own[OURS])


def test_a_killed_process_is_known_by_what_it_signed(notes):
    (notes / f"dfm_stage_port{THEIRS}").write_bytes(ENDPOINT[:12] + b"/stage/x/controller")
    for _ in range(2):
        assert killed_neighbours() == ("/stage/x/controller",)
        assert killed_endpoints() == (ENDPOINT[:12],)
    assert ENDPOINT.startswith(killed_endpoints())


def test_a_killed_process_that_had_not_signed_makes_no_other_look_killed(notes):
    (notes / f"dfm_stage_port{THEIRS}").write_bytes(b"")
    for _ in range(2):
        assert killed_neighbours() == ("a node",)
        assert not ENDPOINT.startswith(killed_endpoints())


def test_a_signature_for_which_there_is_no_room_is_written_later(notes, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "pwrite", full)
        assert not sign_notes(ENDPOINT, ["/stage/x/controller"])
    assert sign_notes(ENDPOINT, ["/stage/x/controller"])
    assert (notes / f"dfm_stage_port{OURS}").read_bytes() == ENDPOINT[:12] + b"/stage/x/controller"


@pytest.mark.parametrize("own", [set(), {THEIRS}])
def test_only_who_writes_to_ports_in_shared_memory_looks_after_them(notes, monkeypatch, own):
    monkeypatch.setattr(shared_memory, "_ports_read_here", lambda: own)
    for number in own:
        (notes / f"fastrtps_port{number}").write_bytes(b"made")
    empty = notes / f"fastrtps_port{PORT_BASE + 14}"
    empty.write_bytes(b"")
    watch = PortWatch()
    monkeypatch.setattr(shared_memory, "EMPTY_S", -1.0)
    assert not watch.lost()
    assert (empty.stat().st_size > 0) == bool(own)
