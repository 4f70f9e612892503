"""bags: list the topics and numbers of a bag, from any nodes, and export a record from it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dfm_stage.cli.command import Options, command, finite, json_option, json_text, option
from dfm_stage.cli.records import RECORDS, read_with
from dfm_stage.errors import DfmError
from dfm_stage.recording import (
    Bag,
    NotInBagError,
    Record,
    RecordError,
    Topic,
    numeric_fields,
    read_bag,
    read_record,
    write_csv,
    write_mat,
    write_npz,
)
from dfm_stage.share import door

EPILOG = """\
examples:
  ./run bags runs/multisine
  ./run bags robot.db3 --topic /joint_states
  ./run bags robot --input /joint_states.effort[0] --output /joint_states.position[0] \\
      --export run.csv
then:
  ./run diagnose robot --model m.yaml --input ... --output ...   # or run.csv
"""
WRITERS: dict[str, Callable[[Record, Path], None]] = {
    ".csv": write_csv, ".npz": write_npz, ".mat": write_mat}
OPTIONS: Options = (
    option("bag", metavar="BAG", help="bag folder, .mcap or .db3 file"),
    option("--topic", action="append", default=[], metavar="NAME",
           help="only these topics; patterns like '/arm/*' are understood"),
    option("--axis", metavar="NAME", help="axis, where the record has several"),
    option("--export", metavar="FILE",
           help="write the record to this .csv, .npz or .mat file: that of --input and "
           "--output, or of the topics of a stage"),
    *RECORDS,
    json_option("what is in the bag"),
)


@command("bags", __doc__, EPILOG, OPTIONS)
def main(options: argparse.Namespace) -> int:
    """List what a bag holds, or export a record from it; 0 done, 2 unusable input."""
    if options.export:
        return _export(options)
    bag = read_bag(options.bag, options.topic or None)
    found = _content(bag)
    if options.json:
        print(json_text(finite(found)), end="")
        return 0
    _print(found, options.bag)
    return 0


def _export(options: argparse.Namespace) -> int:
    path = Path(options.export)
    writer = WRITERS.get(path.suffix)
    if writer is None:
        raise DfmError(f"{path}: cannot be exported to; name a file in {', '.join(WRITERS)}")
    record = read_with(options, options.bag, options.axis)
    writer(record, path)
    for warning in record.warnings:
        print(f"  note: {warning}")
    print(f"{len(record)} samples every {record.sample_period:.6g} s: {path}")
    return 0


def _content(bag: Bag) -> dict[str, Any]:
    """What a bag holds, as plain data."""
    fields = numeric_fields(bag)
    topics = [{"name": topic.name, "type": topic.type_name, "messages": topic.message_count,
               "rate_hz": rate(topic), "header": any("stamp" in name.rpartition(".")[2]
                                                     for name in topic.time_columns),
               "fields": [vars(each) for each in fields[topic.name]]}
              for topic in sorted(bag.values(), key=lambda each: each.name)]
    times = [(int(each.log_time_ns.min()), int(each.log_time_ns.max())) for each in bag.values()
             if each.message_count]
    seconds = (max(last for _, last in times) - min(first for first, _ in times)) * 1e-9 \
        if times else 0.0
    return {"schema": 1, "seconds": seconds, "messages": bag.message_count, "topics": topics,
            "axes": _axes(bag.path), "left_out": dict(bag.left_out),
            "losses": [str(loss) for loss in bag.losses]}


def rate(topic: Topic) -> float:
    """Return messages a second, by their arrival; NaN of fewer than two."""
    times = topic.log_time_ns
    span = float(times.max() - times.min()) * 1e-9 if len(times) > 1 else 0.0
    return (len(times) - 1) / span if span > 0 else math.nan


def _axes(path: Path) -> list[str]:
    """The axes that a record has without naming fields; none in the bag of other nodes."""
    try:
        return list(read_record(path).axes)
    except (RecordError, NotInBagError):
        return []


def _print(found: dict[str, Any], name: str) -> None:
    print(f"{found['seconds']:.6g} s, {found['messages']} messages, {len(found['topics'])} topics")
    for topic in found["topics"]:
        often = f", {topic['rate_hz']:.6g} Hz" if math.isfinite(topic["rate_hz"]) else ""
        print(f"{topic['name']}  ({topic['type']}): {topic['messages']} messages{often}, "
              f"{'header stamps' if topic['header'] else 'no header'}")
        wide = max((len(each["path"]) for each in topic["fields"]), default=0)
        for each in topic["fields"]:
            ends = ("constant " if each["least"] == each["greatest"] else
                    f"{each['least']:.6g} to ") + f"{each['greatest']:.6g}"
            count = "" if each["count"] == topic["messages"] else f"  ({each['count']} values)"
            print(f"  {each['path']:<{wide}}  {each['type_name']:<7}  {ends}{count}")
    for topic_name, reason in found["left_out"].items():
        print(f"{topic_name}: cannot be read: {reason}")
    for loss in found["losses"]:
        print(f"  note: {loss}")
    if found["axes"]:
        print(f"a stage, axes {', '.join(found['axes'])}: {door()} identify {name}")
    else:
        print(f"any two of these: {door()} identify {name} --input FIELD --output FIELD")
