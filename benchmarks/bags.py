"""Bag to arrays: five minutes of two axes at 1 kHz, beside the readers people use today.

Every topic of ours is in the bag, 16 of them. Ours reads all of it into arrays; the peers read the
same file and stop after a fixed number of messages, each deserialised and then thrown away, which
is less than what ours does.
"""

from __future__ import annotations

import itertools
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.figure import Figure
from benchmarks.synthetic_bag import START_NS, schema_text, topic_messages, write_bag

DURATION_S = 300.0
QUICK_DURATION_S = 30.0
PEER_MESSAGES = 150_000
QUICK_PEER_MESSAGES = 30_000
ROUNDS = 5
AT_ONCE = 20
"""The recorder writes what came in 2 ms: so many messages of one axis at 1 kHz."""
ROSBAGS_BAR = 40.0
MCAP_ROS2_BAR = 80.0
_PEAK = """
import sys
from dfm_stage.recording import read_bag

def peak():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmHWM"))

read_bag(sys.argv[1])
before = peak()
bag = read_bag(sys.argv[2])
after = peak()
arrays = sum(column.nbytes for topic in bag.values() for column in (
    topic.log_time_ns, topic.publish_time_ns, topic.sequence, *topic.columns.values()))
print(before / 1024, after / 1024, arrays / 2**20)
"""


def figures(quick: bool = False) -> list[Figure]:
    """Measure reading, the memory it takes, and writing."""
    with tempfile.TemporaryDirectory(prefix="dfm_bags_") as folder:
        small, bag = Path(folder) / "small", Path(folder) / "run"
        write_bag(small, 1.0)
        count = write_bag(bag, QUICK_DURATION_S if quick else DURATION_S)
        peer_count = QUICK_PEER_MESSAGES if quick else PEER_MESSAGES
        ours, rosbags, mcap_ros2 = [], [], []
        read_ours(small)
        for _ in range(ROUNDS):
            ours.append(seconds(lambda: read_ours(bag)) / count)
            rosbags.append(read_rosbags(bag, peer_count) / peer_count)
            mcap_ros2.append(read_mcap_ros2(bag, peer_count) / peer_count)
        size = next(bag.glob("*.mcap")).stat().st_size / 2**20
        found = [*_speed(ours, rosbags, mcap_ros2, count, peer_count, size),
                 _peak(small, bag, count)]
    return [*found, _writing(quick)]


def seconds(work: Callable[[], object]) -> float:
    """Return how long a call takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def read_ours(bag: Path) -> int:
    """Read the whole bag into arrays."""
    from dfm_stage.recording import read_bag

    return read_bag(bag).message_count


def read_rosbags(bag: Path, count: int) -> float:
    """Deserialise the first messages with rosbags; return the seconds after opening."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag) as reader:
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data.partition("=" * 80)[0],
                                              connection.msgtype))
        start = time.perf_counter()
        for connection, _, raw in itertools.islice(reader.messages(), count):
            store.deserialize_cdr(raw, connection.msgtype)
        return time.perf_counter() - start


def read_mcap_ros2(bag: Path, count: int) -> float:
    """Deserialise the first messages with mcap and mcap_ros2; return the seconds it took."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with next(bag.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        start = time.perf_counter()
        for _ in itertools.islice(reader.iter_decoded_messages(), count):
            pass
        return time.perf_counter() - start


def _speed(ours: list[float], rosbags: list[float], mcap_ros2: list[float], count: int,
           peer_count: int, size_mib: float) -> list[Figure]:
    mine = statistics.median(ours)
    how = (f"{count} messages of 16 topics ({size_mib:.0f} MiB, zstd) to arrays, peers over "
           f"{peer_count} of them; medians of {len(ours)} rounds in turn")

    def over(key: str, peer: str, theirs: list[float], bar: float) -> Figure:
        value = statistics.median(theirs)
        return Figure(f"bags.{key}_over_ours", value / mine, "x", bar, f"{peer}, ns per message",
                      value * 1e9, value / mine, how, "at least")

    return [
        over("rosbags", "rosbags with deserialisation", rosbags, ROSBAGS_BAR),
        over("mcap_ros2", "mcap_ros2 decoder", mcap_ros2, MCAP_ROS2_BAR),
        Figure("bags.ns_per_message", mine * 1e9, "ns", how=f"{how}; best {min(ours) * 1e9:.0f}, "
               f"worst {max(ours) * 1e9:.0f}")]


def _peak(small: Path, bag: Path, count: int) -> Figure:
    answer = subprocess.run([sys.executable, "-c", _PEAK, str(small), str(bag)], check=True,
                            capture_output=True, text=True).stdout
    before, after, arrays = map(float, answer.split())
    return Figure("bags.peak_mib", after, "MiB", None, "the arrays returned", arrays,
                  (after - before) / arrays,
                  f"peak memory of a process that reads {count} messages; {before:.0f} MiB of it "
                  f"are there after reading a small bag; ratio: what is added over the arrays")


def _writing(quick: bool) -> Figure:
    import numpy as np
    from mcap.writer import Writer

    from dfm_stage.recording import BagWriter, QosProfile

    count = 50_000 if quick else 200_000
    rows = topic_messages("Measurement", "x", count, 1e-3, np.random.default_rng(0))
    size = rows.dtype.itemsize
    data = rows.tobytes()
    messages = [data[at:at + size] for at in range(0, len(data), size)]
    text = schema_text("Measurement")
    name = "dfm_interfaces/msg/Measurement"

    def ours() -> float:
        with tempfile.TemporaryDirectory(prefix="dfm_bags_") as folder, \
                BagWriter(Path(folder) / "bag") as bag:
            topic = bag.add_topic("/a", name, [QosProfile()], "", text)
            start = time.perf_counter()
            for first in range(0, count, AT_ONCE):
                bag.write_arrived([(topic, message, START_NS + first + k) for k, message
                                   in enumerate(messages[first:first + AT_ONCE])])
            return time.perf_counter() - start

    def theirs() -> float:
        with tempfile.TemporaryFile() as file:
            writer = Writer(file)
            writer.start("ros2")
            channel = writer.register_channel(
                "/a", "cdr", writer.register_schema(name, "ros2msg", text.encode()))
            start = time.perf_counter()
            for k, message in enumerate(messages):
                writer.add_message(channel, START_NS + k, message, START_NS + k, k)
            spent = time.perf_counter() - start
            writer.finish()
            return spent

    pairs = [(ours(), theirs()) for _ in range(ROUNDS)]
    mine = statistics.median(pair[0] for pair in pairs) / count
    peer = statistics.median(pair[1] for pair in pairs) / count
    return Figure("bags.write_ns_per_message", mine * 1e9, "ns", None, "mcap.writer.Writer",
                  peer * 1e9, peer / mine,
                  f"{count} messages of 76 bytes, {AT_ONCE} at once, time in the caller's thread; "
                  f"median of {ROUNDS}")
