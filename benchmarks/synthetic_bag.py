"""A bag as two axes would leave it: every topic of ours, written without ROS.

Messages with a frame name of fixed length have a fixed layout, so that whole topics are laid out
as one numpy array and handed to the writer row by row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording import BagWriter, QosProfile
from dfm_stage.recording.message_definitions import (
    SEPARATOR,
    Field,
    parse_schema,
)

START_NS = 1_700_000_000_000_000_000
INTERFACES = Path(__file__).resolve().parents[1] / "dfm_interfaces" / "msg"
_STANDARD = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
}
_SIZES = {"bool": "?", "float64": "<f8", "uint32": "<u4", "int32": "<i4", "int64": "<i8"}
TOPICS = {
    "reference": "Reference", "excitation": "Excitation", "measurement": "Measurement",
    "command": "Command", "amplifier": "AmplifierState", "plant": "PlantState",
    "sim/position_counts": "PositionCounts", "sim/drive": "Drive"}


def schema_text(short_name: str) -> str:
    """Return the schema text of one of our messages, from this checkout alone."""
    parts = [(INTERFACES / f"{short_name}.msg").read_text(encoding="utf-8")]
    parts += [f"{SEPARATOR}\nMSG: {name}\n{text}" for name, text in _STANDARD.items()]
    return "".join(parts)


def layout(definitions: Mapping[str, Sequence[Field]], type_name: str, frame: bytes) -> np.dtype:
    """Return the layout of a serialised message whose only text is `frame`."""
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    at = 0

    def add(name: str, dtype: str, align: int) -> None:
        nonlocal at
        at += -at % align
        names.append(name)
        formats.append(dtype)
        offsets.append(4 + at)
        at += np.dtype(dtype).itemsize

    def walk(type_name: str, prefix: str) -> None:
        for field in definitions[type_name]:
            name = prefix + field.name
            if field.base == "string":
                add(name + "#", "<u4", 4)
                add(name, f"S{len(frame) + 1}", 1)
            elif field.base in _SIZES:
                add(name, _SIZES[field.base], np.dtype(_SIZES[field.base]).itemsize)
            else:
                walk(field.base, name + ".")

    walk(type_name, "")
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": 4 + at})


def topic_messages(short_name: str, axis: str, count: int, period_s: float,
                   rng: np.random.Generator) -> NDArray[np.void]:
    """Return `count` serialised messages, shape (count,), with plausible content."""
    type_name = f"dfm_interfaces/msg/{short_name}"
    frame = axis.encode()
    dtype = layout(parse_schema(schema_text(short_name), type_name), type_name, frame)
    rows = np.zeros(count, dtype)
    rows.view(np.uint8).reshape(count, -1)[:, 1] = 1
    k = np.arange(count)
    stamps = START_NS + np.round(k * period_s * 1e9).astype(np.int64)
    position = 1e-3 * np.sin(2 * np.pi * 3.0 * k * period_s)
    counts = np.round((position + 5e-8 * rng.standard_normal(count)) / 5e-8).astype(np.int64)
    voltage = 0.6 * np.sin(2 * np.pi * 3.0 * k * period_s) + 1e-3 * rng.standard_normal(count)
    values = {
        "header.stamp.sec": stamps // 10**9, "header.stamp.nanosec": stamps % 10**9,
        "measurement_stamp.sec": stamps // 10**9, "measurement_stamp.nanosec": stamps % 10**9,
        "header.frame_id#": len(frame) + 1, "header.frame_id": frame, "seq": k,
        "measurement_seq": k, "voltage": voltage, "enabled": True, "current": voltage / 8.0,
        "counts": counts, "resolution": 5e-8,
        "position": counts * 5e-8 if short_name == "Measurement" else position,
        "velocity": np.gradient(position, period_s), "force": voltage * 1.082,
        "acceleration": -position * (2 * np.pi * 3.0)**2}
    for name in dtype.names or ():
        if name in values:
            rows[name] = values[name]
    return rows


def write_bag(folder: Path, duration_s: float, period_s: float = 0.001,
              axes: Sequence[str] = ("x", "y"), seed: int = 1, compression: str = "zstd") -> int:
    """Write a bag with every topic of every axis; return the number of messages."""
    count = round(duration_s / period_s)
    block = 5000
    rng = np.random.default_rng(seed)
    with BagWriter(folder, compression=compression, backlog_bytes=1 << 32) as bag:
        bag.attach("model.yaml", "application/yaml", b"dfm_model: 1\nname: synthetic\n")
        streams = []
        for axis in axes:
            for topic, short_name in TOPICS.items():
                type_name = f"dfm_interfaces/msg/{short_name}"
                number = bag.add_topic(f"/stage/{axis}/{topic}", type_name, [QosProfile()],
                                       "RIHS01_" + "0" * 64, schema_text(short_name))
                streams.append((number, topic_messages(short_name, axis, count, period_s, rng)))
        for start in range(0, count, block):
            stop = min(start + block, count)
            rows = []
            for _, messages in streams:
                size = messages.dtype.itemsize
                data = messages[start:stop].tobytes()
                rows.append([data[at:at + size] for at in range(0, len(data), size)])
            for k in range(stop - start):
                now = START_NS + round((start + k) * period_s * 1e9) + 200_000
                for (number, _), ready in zip(streams, rows, strict=True):
                    bag.write(number, ready[k], now, now - 100_000, start + k)
    return count * len(streams)


__all__ = ["START_NS", "TOPICS", "schema_text", "topic_messages", "write_bag"]
