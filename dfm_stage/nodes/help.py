"""What a node says of itself: `--help`, written from the tables that the node is made from.

Topics and services come from `wiring`, parameters from the settings that the node declares, the
words from its module. Nothing is started for it.
"""

from __future__ import annotations

import array
import math
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from dfm_stage.nodes.base import LoopNode
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.wiring import (
    DEFAULT_NAMESPACE,
    LINKS,
    PUBLISHER_QOS,
    SERVICES,
    TOPICS,
    subscriber_qos,
)
from dfm_stage.share import door

_WIDEST, _NARROWEST = 99, 60
_END = """\
--version prints the version. Everything else stands after --ros-args, as with every ROS 2 node:
-p name:=value, --params-file FILE, -r __ns:=/stage/y, --log-level debug, --enclave NAME."""


def help_text(kind: type[LoopNode]) -> str:
    """Return what `--help` prints for a node."""
    width = min(max(shutil.get_terminal_size().columns, _NARROWEST), _WIDEST)
    arguments, _, remark = kind.example.partition("    # ")
    start = f"{door()} {kind.kind}"
    return "\n".join([
        f"usage: {start} [--help] [--version] [--ros-args -p name:=value ...]", "",
        (sys.modules[kind.__module__].__doc__ or "").strip(), "",
        f"topics, from the node's namespace ({DEFAULT_NAMESPACE} unless remapped; ~ is the node):",
        *_topics(kind), "",
        "services and actions, besides those that every ROS 2 node has:",
        *_rows([(each.name, each.type, each.what) for each in SERVICES
                if each.is_of(kind.kind)]), "",
        "parameters: default, unit, range; those marked * may change while the node runs:",
        *(line for setting in kind.all_settings({}) for line in _setting(setting, width)), "",
        "example:" if not remark else f"example, {remark}:",
        f"  {start} --ros-args {arguments}", "", _END])


def _topics(kind: type[LoopNode]) -> Iterator[str]:
    name = kind.kind
    published = [(each.topic, f"dfm_interfaces/msg/{each.type.__name__}",
                  qos_words(PUBLISHER_QOS)) for each in LINKS.values() if each.publisher == name]
    published += [(each.name, each.type, qos_words(each.qos)) for each in TOPICS.values()
                  if each.is_of(name)]
    heard = [(each.topic, f"dfm_interfaces/msg/{each.type.__name__}",
              qos_words(subscriber_qos(each, name, lockstep=False)))
             for each in LINKS.values() if name in (*each.subscribers, *each.sometimes)]
    heard += [(each.name, each.type, qos_words(each.subscriber_qos or each.qos))
              for each in TOPICS.values() if name in each.subscribers]
    loop = any(name in (each.publisher, *each.subscribers) for each in LINKS.values())
    yield "  publishes"
    yield from _rows(published, "    ")
    if heard or kind.listens_to:
        yield "  subscribes to"
        yield from _rows(heard, "    ")
    if kind.listens_to:
        yield f"    {kind.listens_to}"
    if loop:
        yield "  in lockstep those of the loop are reliable and keep all at both ends"


def qos_words(qos: QoSProfile) -> str:
    """Return a quality of service in a few words."""
    words = ["reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort",
             "keeps all" if qos.history == HistoryPolicy.KEEP_ALL else f"depth {qos.depth}"]
    if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("latched")
    return ", ".join(words)


def _rows(rows: Sequence[Sequence[str]], indent: str = "  ") -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [indent + "  ".join(cell.ljust(width) for cell, width in
                               zip(row, widths, strict=True)).rstrip() for row in rows]


def _setting(setting: Setting, width: int) -> Iterator[str]:
    head = f"  {setting.name}{' *' if setting.live else ''}"
    facts = f"{value_words(setting.default) or repr('')} {setting.unit}".rstrip()
    span = range_words(setting)
    facts += f"  ({span})" if span else ""
    yield from textwrap.wrap(facts, width, initial_indent=head.ljust(32) + "  ",
                             subsequent_indent=34 * " ", break_long_words=False)
    yield from textwrap.wrap(setting.description, width, initial_indent=8 * " ",
                             subsequent_indent=8 * " ", break_long_words=False)


def value_words(value: Any) -> str:
    """Return a parameter's value as it is written on the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple, array.array)):
        return f"[{', '.join(f'{each:g}' for each in value)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def range_words(setting: Setting) -> str:
    """Return what values a parameter may take; empty where any."""
    if setting.choices:
        return ", ".join(setting.choices)
    low, high = setting.low, setting.high
    if low == -math.inf and high == math.inf:
        return ""
    if high == math.inf or low == -math.inf:
        return f"from {low:g}" if high == math.inf else f"up to {high:g}"
    return f"{low:g} to {high:g}"
