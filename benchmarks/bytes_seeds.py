"""Write the seeds of `bytes`: small files by the project's own writers, kept so that an input's
number and seed give its bytes on every machine. `python -m benchmarks.bytes_seeds`"""

from __future__ import annotations

import contextlib
import sqlite3
import tempfile
from pathlib import Path

import numpy as np
import scipy.io

from benchmarks.bytes_devices import AmplifierSession, EncoderSession, transcript
from benchmarks.bytes_targets import SEEDS
from benchmarks.synthetic_bag import START_NS, TOPICS, schema_text, topic_messages, write_bag
from dfm_stage.recording.record import AxisRecord, Provenance, Record
from dfm_stage.recording.table_files import write_csv, write_mat, write_npz

SAMPLES = 40


def record(axes: int) -> Record:
    """A short record of a swept sine."""
    rng = np.random.default_rng(1)
    time = np.arange(SAMPLES, dtype=np.float64) * 1e-3
    made = {"xy"[k]: AxisRecord(np.sin(30.0 * time * (k + 1)),
                                1e-3 * np.cumsum(rng.standard_normal(SAMPLES)), "V", "m")
            for k in range(axes)}
    return Record(time, 1e-3, made, Provenance("seed", "csv"))


def write(folder: Path = SEEDS) -> None:
    """Write all seeds."""
    folder.mkdir(parents=True, exist_ok=True)
    for axes in (1, 2):
        for ending, writer in (("csv", write_csv), ("npz", write_npz), ("mat", write_mat)):
            writer(record(axes), folder / f"record_{axes}.{ending}")
    (folder / "other_names.csv").write_bytes(
        b"# of another program\ntime_ms;input_mv;position_um;note\n"
        + b"".join(b"%d;%d,5;1e-%d;\n" % (k, k % 7, k % 5) for k in range(30)))
    tables = {"t": np.arange(30) * 0.01, "data": np.ones((30, 2), np.float32), "fs": 100.0,
              "flag": np.arange(30) % 2 == 0, "text": np.array(["a", "b"])}
    np.savez_compressed(folder / "matrix.npz", **tables)
    scipy.io.savemat(folder / "structures.mat", {
        "run": {"X": {"Data": np.arange(30.0)}, "Y": [{"Name": '"a"/"pos"', "Data": np.ones(30)}]},
        "cell": np.array(["a", 1.0, np.ones(3)], dtype=object), "text": "abc",
        "whole": np.arange(30, dtype=np.int16), "complex": np.ones(3) * 1j, "Ts": 0.01})
    scipy.io.savemat(folder / "version_4.mat", {"time_s": np.arange(30.0), "u": np.ones(30)},
                     format="4")
    with tempfile.TemporaryDirectory() as name:
        for compression in ("zstd", "lz4", "none"):
            with contextlib.suppress(ValueError):
                bag = Path(name) / compression
                write_bag(bag, 0.02, axes=("x",), compression=compression)
                (folder / f"{compression}.mcap").write_bytes(
                    next(bag.glob("*.mcap")).read_bytes())
                (folder / "metadata.yaml").write_bytes((bag / "metadata.yaml").read_bytes())
    _sqlite(folder / "rosbag2.db3")
    (folder / "copley.bin").write_bytes(transcript(AmplifierSession))
    (folder / "qsb.bin").write_bytes(transcript(EncoderSession))


def _sqlite(path: Path) -> None:
    """A SQLite bag: the tables that rosbag2 writes, with the messages of three topics."""
    path.unlink(missing_ok=True)
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.executescript(
            "PRAGMA page_size = 512; VACUUM;"
            "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
            "serialization_format TEXT, offered_qos_profiles TEXT);"
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB);"
            "CREATE TABLE message_definitions (id INTEGER PRIMARY KEY, topic_type TEXT, "
            "encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT);"
            "CREATE INDEX timestamp_idx ON messages (timestamp ASC);")
        rng = np.random.default_rng(1)
        for number, topic in enumerate(("reference", "measurement", "command"), 1):
            short = TOPICS[topic]
            kind = f"dfm_interfaces/msg/{short}"
            database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')",
                             (number, f"/stage/x/{topic}", kind))
            database.execute("INSERT INTO message_definitions VALUES (?, ?, 'ros2msg', ?, '')",
                             (number, kind, schema_text(short)))
            rows = topic_messages(short, "x", 10, 1e-3, rng)
            database.executemany(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
                [(number, START_NS + k * 10**6, row.tobytes()) for k, row in enumerate(rows)])
        database.commit()


if __name__ == "__main__":
    write()
