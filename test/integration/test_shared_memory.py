"""Ports in shared memory after a process was killed: not taken too soon, and missed when lost."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import rclpy

from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.domain import claim_domain
from dfm_stage.middleware import shared_memory
from dfm_stage.middleware.discovery import OPEN, PEERS, PROFILES
from dfm_stage.middleware.shared_memory import (
    DOMAIN_GAIN,
    LEASE_S,
    PORT_BASE,
    SHARED_MEMORY,
    PortWatch,
    killed_endpoints,
    killed_neighbours,
)
from dfm_stage.nodes.process import helper_node
from dfm_stage.share import config_folder

SETTLED_S = 0.5
CONTROLLER = ("controller", "--ros-args", "-r", "__ns:=/stage/x")


@pytest.fixture(autouse=True)
def with_shared_memory(monkeypatch):
    """As a graph that is opened to named hosts: alone on this machine it has no such ports."""
    monkeypatch.setenv(PEERS, "127.0.0.1")
    monkeypatch.setenv(PROFILES, str(config_folder() / OPEN))


@pytest.fixture
def domain():
    with claim_domain() as claimed:
        for left in files_of(claimed.number):  # by nodes that a test before killed
            left.unlink(missing_ok=True)
        yield claimed.number


def files_of(domain: int) -> list[Path]:
    """The ports of a domain in shared memory, their locks and the notes beside them."""
    first = PORT_BASE + DOMAIN_GAIN * domain
    return [path for path in SHARED_MEMORY.glob("*_port*")
            if (number := re.fullmatch(r"(?:sem\.)?\w+_port_?(\d+)\w*", path.name))
            and 0 <= int(number[1]) - first < DOMAIN_GAIN]


@contextlib.contextmanager
def running_node(domain: int, end: int = signal.SIGKILL, *command: str):
    """Start a node (a controller); yield its process id and the port it reads; end it."""
    node = subprocess.Popen([sys.executable, "-m", "dfm_stage", *(command or CONTROLLER)],
                            env={**os.environ, "ROS_DOMAIN_ID": str(domain)})
    left: set[Path] = set()
    try:
        while not own_ports(node.pid):
            time.sleep(0.05)
        time.sleep(SETTLED_S)  # while it starts it also looks into the ports of others
        (port,) = own_ports(node.pid)
        note = port.with_name(port.name.replace("fastrtps_port", "dfm_stage_port"))
        while not note.exists():
            time.sleep(0.05)
        left = {path for path in mapped(node.pid) if "port" not in path.name}
        yield node.pid, port
    finally:
        node.send_signal(end)
        node.wait()
        for path in left:  # what a killed one cannot tidy up
            path.unlink(missing_ok=True)
            path.with_name(f"{path.name}_el").unlink(missing_ok=True)


def own_ports(pid: int) -> list[Path]:
    """The ports of its domain that a process reads: it has them mapped and their locks open."""
    locks = opened(pid)
    numbers = {path: re.fullmatch(r"fastrtps_port(\d+)", path.name) for path in mapped(pid)}
    # those with lower numbers do not depend on the domain
    return [path for path, number in numbers.items() if number and int(number[1]) > PORT_BASE
            and path.with_name(f"{path.name}_el") in locks]


def locked_ports(pid: int) -> list[Path]:
    """The ports of whose locks a process has one open."""
    return [path.with_name(path.name.removesuffix("_el")) for path in opened(pid)
            if re.fullmatch(r"fastrtps_port\d+_el", path.name)]


def mapped(pid: int) -> set[Path]:
    maps = Path(f"/proc/{pid}/maps").read_text("utf-8")
    return {SHARED_MEMORY / name for name in re.findall(r" /dev/shm/(fastrtps_\w+)$", maps,
                                                        re.MULTILINE)}


def opened(pid: int) -> set[Path]:
    found = set()
    for each in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            found.add(each.readlink())
    return found


def test_the_port_of_a_killed_node_is_left_alone(domain):
    with running_node(domain) as (_, port):
        pass
    with running_node(domain) as (_, other):
        assert other != port


@pytest.mark.slow
def test_the_others_know_that_a_neighbour_was_killed(domain, monkeypatch):
    with running_node(domain) as (_, port):
        own = int(port.name.removeprefix("fastrtps_port")) + 2
        monkeypatch.setattr(shared_memory, "_own", {"7001": 0, str(own): 0})
        assert not killed_neighbours()
        while not port.with_name(f"dfm_stage_port{own - 2}").stat().st_size:  # not signed yet
            time.sleep(0.05)
    for _ in range(2):  # the first look adds to the note that its process was killed
        assert killed_neighbours() == ("/stage/x/controller",)
    monkeypatch.setattr(shared_memory, "_own", {"7001": 0, str(own + DOMAIN_GAIN): 0})
    assert not killed_neighbours()  # that is another domain


@pytest.mark.slow
def test_the_endpoints_of_a_killed_node_are_told_from_those_of_the_next(domain):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, args=[])
    try:
        looking = helper_node("looking", "/", context)

        def endpoints(count: int) -> set[bytes]:
            deadline = time.monotonic() + 20.0
            while len(found := looking.get_publishers_info_by_topic(
                    "/stage/x/controller/config")) < count and time.monotonic() < deadline:
                time.sleep(0.05)
            return {bytes(each.endpoint_gid) for each in found}

        with running_node(domain):
            (first,) = endpoints(1)
            assert not first.startswith(killed_endpoints())
        with running_node(domain, signal.SIGINT):
            both = endpoints(2)  # the killed one's still look matched
            assert {each for each in both if each.startswith(killed_endpoints())} == {first}
        looking.destroy_node()
    finally:
        context.try_shutdown()


@pytest.mark.slow
def test_after_its_lease_it_is_taken_again(domain):
    with running_node(domain) as (_, port):
        pass
    for note in files_of(domain):
        if note.name.startswith("dfm_stage_port"):
            note.write_text("\nkilled")
            os.utime(note, (0, time.time() - LEASE_S - 1.0))
    with running_node(domain) as (_, other):
        assert other == port


@pytest.mark.slow
def test_the_port_of_a_node_that_ended_is_taken_again(domain):
    with running_node(domain, signal.SIGINT) as (_, port):
        pass
    with running_node(domain, signal.SIGINT) as (_, other):
        assert other == port


@pytest.mark.slow
def test_a_node_whose_port_was_taken_away_begins_anew(domain):
    with running_node(domain, signal.SIGINT) as (pid, port):
        port.unlink()
        while not any(each.exists() for each in own_ports(pid)):  # the test's own time-out ends it
            time.sleep(0.1)


ANNOUNCES = """
import rclpy, sys, time
from std_msgs.msg import Empty
from dfm_stage.nodes.process import helper_node
input()
context = rclpy.Context()
rclpy.init(context=context, domain_id=int(sys.argv[1]), args=[])
node = helper_node("speaker", "/", context)
for number in range(30):
    node.create_publisher(Empty, f"/topic_{number}", 1)
    time.sleep(0.05)
print("announced", flush=True)
"""


@pytest.mark.slow
def test_a_port_that_was_never_finished_stops_nobody_for_long(domain):
    speaker = subprocess.Popen([sys.executable, "-c", ANNOUNCES, str(domain)], text=True,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        with running_node(domain) as (_, port):  # its port, as one killed while it made it leaves
            port.unlink()
            port.touch()
            said, _ = speaker.communicate("\n", timeout=20.0)
        assert said == "announced\n"
    finally:
        speaker.kill()
        speaker.wait()


@pytest.mark.slow
def test_a_harness_whose_port_was_taken_away_says_so():
    with StageGraph(nodes=("sim_plant",)) as graph:
        for port in own_ports(os.getpid()):
            port.unlink()
        with pytest.raises(HarnessError, match="own port in shared memory is gone"):
            graph.spin_until(lambda: False, 4.0, "nothing")


def test_a_port_that_went_before_anybody_looked_is_missed(tmp_path, monkeypatch):
    monkeypatch.setattr(shared_memory, "SHARED_MEMORY", tmp_path)
    with (tmp_path / "fastrtps_port65001_el").open("w"):
        watch = PortWatch()
        assert [watch.lost(), watch.lost()] == [False, True]


@pytest.mark.slow
def test_a_recorder_that_begins_anew_goes_on_in_another_folder(domain, tmp_path):
    bag = tmp_path / "bag"
    with running_node(domain, signal.SIGINT, "recorder", "--ros-args", "-p",
                      f"bag:={bag}") as (pid, port):
        port.unlink()
        while not (tmp_path / "bag_1").exists():
            time.sleep(0.1)
        deadline = time.monotonic() + 5.0  # while it starts it keeps the lost port locked
        while not (kept := all(each.exists() for each in locked_ports(pid))) \
                and time.monotonic() < deadline:
            time.sleep(0.1)
        assert kept  # or it begins anew, again and again
    assert (bag / "metadata.yaml").exists()
    assert (tmp_path / "bag_1" / "metadata.yaml").exists()


@pytest.mark.slow
def test_a_port_is_taken_though_a_process_that_gave_it_back_still_has_its_note(domain):
    taken: list[tuple[Path, Path]] = []
    for _ in range(3):  # a number is also passed over while another process looks into its lock
        with running_node(domain, signal.SIGINT) as (_, port):
            pass
        note = SHARED_MEMORY / port.name.replace("fastrtps_port", "dfm_stage_port")
        with note.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            with running_node(domain, signal.SIGINT) as (_, other):
                taken.append((port, other))
        note.unlink()
        if port == other:
            return
    pytest.fail(f"given back and taken instead: {taken}")


def last_check_ms(port: Path) -> int:
    """When a port was last checked: the first field of the structure at byte 256."""
    return int.from_bytes(port.read_bytes()[256:264], "little", signed=True)


def ports_in(domain: int) -> list[Path]:
    return [path for path in files_of(domain) if re.fullmatch(r"fastrtps_port\d+", path.name)]


def test_no_port_is_ever_checked_for_a_reader_that_merely_waits(domain):
    """Whoever opened it meanwhile slept for a third of the time, and held others up."""
    a_year_ms = 365 * 86_400_000
    now_ms = 1000 * time.time()
    with running_stranger(domain):
        before = {port: last_check_ms(port) for port in ports_in(domain)}
        assert any(abs(checked - now_ms) < 60_000 for checked in before.values())
        with running_node(domain) as (_, own):
            deadline = time.monotonic() + 10.0
            while not all(last_check_ms(port) > now_ms + a_year_ms for port in ports_in(domain)):
                assert time.monotonic() < deadline
                time.sleep(0.05)
            assert own in ports_in(domain)


@contextlib.contextmanager
def running_stranger(domain: int):
    """A plain rclpy node with Fast DDS as it is by default; it waits and says nothing."""
    code = ("import rclpy, sys\nrclpy.init()\nnode = rclpy.create_node('stranger')\n"
            "print('here', flush=True)\nsys.stdin.read()")
    environment = {name: value for name, value in os.environ.items()
                   if name != "FASTRTPS_DEFAULT_PROFILES_FILE"}
    stranger = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, text=True,
                                stdout=subprocess.PIPE,
                                env={**environment, "ROS_DOMAIN_ID": str(domain)})
    try:
        assert stranger.stdout.readline() == "here\n"
        yield stranger
    finally:
        stranger.stdin.close()
        stranger.wait(10.0)
        stranger.stdout.close()


def test_a_file_that_is_no_port_of_fast_dds_is_left_alone(tmp_path):
    file = tmp_path / "fastrtps_port7412"
    for content in (b"", bytes(100), bytes(range(256)) * 4, (7412).to_bytes(4, "little") * 200):
        file.write_bytes(content)
        shared_memory._put_off_checks(file, 7412)
        assert file.read_bytes() == content
