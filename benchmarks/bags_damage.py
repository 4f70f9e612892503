"""A real bag cut off and damaged, and one of an hour: what is read is right, the rest counted."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import Figure
from dfm_stage.harness import StageGraph
from dfm_stage.recording import Bag, BagReadError, Ragged, read_bag

DAMAGES, QUICK_DAMAGES, SEED = 500, 60, 1
HOUR_S, QUICK_HOUR_S = 3600, 120
SCAN = {"name": "scan", "mode": "pid", "duration_s": 4.0,
        "axes": {"x": {"reference": {"kind": "raster"}}}}
_HOUR = """
import sys
from pathlib import Path

sys.path.insert(0, sys.argv[1])
import numpy as np
from benchmarks.synthetic_bag import START_NS, TOPICS, schema_text, topic_messages
from dfm_stage.recording import BagWriter, QosProfile


def resident_mib():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS")) / 1024


folder, seconds = Path(sys.argv[2]), int(sys.argv[3])
with BagWriter(folder) as bag:
    streams = []
    for axis in "xy":
        for topic, short in TOPICS.items():
            number = bag.add_topic(f"/stage/{axis}/{topic}", f"dfm_interfaces/msg/{short}",
                                   [QosProfile()], "", schema_text(short))
            rows = topic_messages(short, axis, 1000, 1e-3, np.random.default_rng(number))
            size, data = rows.dtype.itemsize, rows.tobytes()
            streams.append((number, [data[k:k + size] for k in range(0, len(data), size)]))
    early = 0.0
    for second in range(seconds):
        for k in range(1000):
            now = START_NS + (1000 * second + k) * 1_000_000
            for number, messages in streams:
                bag.write(number, messages[k], now, now, 1000 * second + k)
        bag.flush()
        if second == min(60, seconds // 4):
            early = resident_mib()
    late, lost = resident_mib(), bag.lost
print(early, late, lost)
"""


@dataclass
class Tally:
    """What became of the damaged copies."""

    wrong: int = 0
    raised: int = 0
    silent: int = 0
    undercounted: int = 0
    refused: int = 0
    read: int = 0
    readable: int = 0


def figures(quick: bool = False, cases: int | None = None, seed: int = SEED) -> list[Figure]:
    """Damage a bag 500 times (quick: 60, or `cases`), write an hour (quick: two minutes)."""
    count = cases or (QUICK_DAMAGES if quick else DAMAGES)
    with tempfile.TemporaryDirectory(prefix="dfm_damage_") as name:
        folder = Path(name)
        with StageGraph(lockstep=True, composed=True, bag=folder / "real") as graph:
            graph.run(SCAN)
            graph.stop_recording()
        whole = next((folder / "real").glob("*.mcap")).read_bytes()
        tally = damage(whole, count, seed, folder)
        long = _hour(folder / "long", QUICK_HOUR_S if quick else HOUR_S)
    how = (f"{count} copies of a real bag ({len(whole) / 2**20:.1f} MiB), each cut off or with 1 "
           f"to 8 bits flipped, seed {seed}")

    def bad(key: str, value: int, what: str) -> Figure:
        return Figure(f"bags_damage.{key}", float(value), "bags", 0.0, bar_kind="at most",
                      how=f"{what}; {how}")

    share = 100.0 * tally.read / tally.readable
    return [
        bad("wrong", tally.wrong, "a message was read that was not written so"),
        bad("raised", tally.raised, "something else than a BagReadError was raised"),
        bad("silent", tally.silent, "messages are missing and no loss is mentioned"),
        bad("undercounted", tally.undercounted, "bits flipped, and fewer messages counted as "
            "lost than are missing"),
        Figure("bags_damage.read_percent", share, "%", how=f"messages read, of those in whole "
               f"chunks before a cut and of all after flips; {tally.refused} bags refused as a "
               f"whole; {how}"),
        *long,
    ]


def damage(whole: bytes, count: int, seed: int, folder: Path) -> Tally:
    """Read `count` damaged copies of a bag file and hold them against the whole one."""
    copy, tally, rng = folder / "copy.mcap", Tally(), np.random.default_rng(seed)
    copy.write_bytes(whole)
    truth = rows(read_bag(copy))
    total = sum(len(each) for each in truth.values())
    ends = _chunk_ends(whole)
    for k in range(count):
        cut = k % 2 == 0
        data = bytearray(whole)
        if cut:
            data = data[:int(rng.integers(1, len(whole)))]
        else:
            for _ in range(int(rng.integers(1, 9))):
                data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        copy.write_bytes(data)
        wanted = max((n for end, n in ends if end <= len(data)), default=0) if cut else total
        _judge(copy, truth, wanted, cut, tally)
    return tally


def _judge(copy: Path, truth: Mapping[str, Mapping[int, bytes]], wanted: int, cut: bool,
           tally: Tally) -> None:
    tally.readable += wanted
    total = sum(len(each) for each in truth.values())
    try:
        bag = read_bag(copy)
    except BagReadError:
        tally.refused += 1
        return
    except Exception as error:  # noqa: BLE001 that is what is looked for
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        tally.raised += 1
        return
    found = rows(bag)
    got = sum(len(each) for each in found.values())
    tally.read += min(got, wanted) if cut else got
    tally.wrong += any(truth.get(topic, {}).get(number) != row for topic, some in found.items()
                       for number, row in some.items())
    tally.silent += got < total and not bag.losses
    if not cut and bag.losses:
        tally.undercounted += sum(loss.messages for loss in bag.losses) < total - got


def rows(bag: Bag) -> dict[str, dict[int, bytes]]:
    """Return every message by topic and number: all its fields as one bytes object."""
    out = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        for name, topic in bag.items():
            columns = [topic.log_time_ns, topic.publish_time_ns,
                       *(topic[column] for column in topic)]
            out[name] = {number: repr([_cell(column, k) for column in columns]).encode()
                         for k, number in enumerate(topic.sequence.tolist())}
    return out


def _cell(column: NDArray | Ragged, k: int) -> object:
    value = column[k]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _chunk_ends(data: bytes) -> list[tuple[int, int]]:
    """(end of a chunk's record, messages up to there), by the mcap library."""
    import io

    from mcap.records import Chunk, MessageIndex
    from mcap.stream_reader import StreamReader

    stream = io.BytesIO(data)
    out: list[tuple[int, int]] = []
    messages, end = 0, 0
    for record in StreamReader(stream, emit_chunks=True).records:
        if isinstance(record, Chunk):
            end = stream.tell()
        elif isinstance(record, MessageIndex):
            messages += len(record.records)
            out.append((end, messages))
    return list(dict(out).items())


def _hour(folder: Path, seconds: int) -> list[Figure]:
    root = Path(__file__).resolve().parents[1]
    answer = subprocess.run([sys.executable, "-c", _HOUR, str(root), str(folder), str(seconds)],
                            check=True, capture_output=True, text=True).stdout
    early, late, lost = map(float, answer.split())
    size = next(folder.glob("*.mcap")).stat().st_size / 2**20
    sequence = read_bag(folder, ["/stage/y/plant"])["/stage/y/plant"].sequence
    gaps = int(np.sum(np.diff(sequence.astype(np.int64)) != 1))
    gaps += abs(len(sequence) - 1000 * seconds)
    how = (f"{seconds} s of two axes at 1 kHz, 16 topics, {size:.0f} MiB, as fast as the disk "
           "takes it")
    return [
        Figure("bags_damage.long_growth_mib", late - early, "MiB", 16.0, "at the start", early,
               late / early, "memory of the writing process at the end, above that early on; "
               f"{how}", bar_kind="at most"),
        Figure("bags_damage.long_gaps", float(gaps + lost), "messages", 0.0, bar_kind="at most",
               how=f"gaps in the numbers of one topic, and messages not recorded; {how}"),
    ]
