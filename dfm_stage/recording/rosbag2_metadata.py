"""The `metadata.yaml` of a rosbag2 folder, version 9, and the QoS profiles inside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

INFINITE_NS = 2**63 - 1
VERSION = 9

Yaml: TypeAlias = 'bool | int | str | Sequence["Yaml"] | Mapping[str, "Yaml"] | None'
_YAML_WORDS = frozenset({"yes", "no", "on", "off", "null", "true", "false"})


@dataclass(frozen=True)
class QosProfile:
    """What a publisher offers; policies in the words rosbag2 uses ("keep_last", "reliable")."""

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    liveliness_lease_duration_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def to_dict(self) -> dict[str, Yaml]:
        """Return the profile as rosbag2 stores it; every key is required."""
        return {name.removesuffix("_ns"): value if not name.endswith("_ns") else {
            "sec": value // 10**9, "nsec": value % 10**9} for name, value in vars(self).items()}


@dataclass(frozen=True)
class TopicEntry:
    """One topic of a bag; `type_hash` is `RIHS01_...` or empty."""

    name: str
    type_name: str
    qos_profiles: tuple[QosProfile, ...]
    type_hash: str
    message_count: int = 0


@dataclass(frozen=True)
class BagInformation:
    """What `metadata.yaml` says of a bag of one file."""

    file_name: str
    topics: Sequence[TopicEntry] = ()
    start_ns: int = 0
    duration_ns: int = 0
    message_count: int = 0
    custom_data: Mapping[str, str] = field(default_factory=dict)
    ros_distro: str = "jazzy"

    def to_dict(self) -> dict[str, Yaml]:
        """Return the tree under `rosbag2_bagfile_information`."""
        start = {"nanoseconds_since_epoch": self.start_ns}
        duration = {"nanoseconds": self.duration_ns}
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": self.message_count,
            "topics_with_message_count": [_topic(entry) for entry in self.topics],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file_name],
            "files": [{"path": self.file_name, "starting_time": start, "duration": duration,
                       "message_count": self.message_count}],
            "custom_data": dict(self.custom_data) or None,
            "ros_distro": self.ros_distro,
        }


def _topic(entry: TopicEntry) -> dict[str, Yaml]:
    return {
        "topic_metadata": {
            "name": entry.name,
            "type": entry.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [profile.to_dict() for profile in entry.qos_profiles],
            "type_description_hash": entry.type_hash,
        },
        "message_count": entry.message_count,
    }


def yaml_text(value: Yaml, indent: int = 0) -> str:
    """Return `value` as block YAML; strings are double quoted, so nothing in them can escape."""
    pad = " " * indent
    if isinstance(value, Mapping) and value:
        return "".join(f"{pad}{_key(key)}:{_nested(item, indent)}" for key, item in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str) and value:
        return "".join(f"{pad}- {yaml_text(item, indent + 2).lstrip(' ')}" for item in value)
    return pad + _scalar(value) + "\n"


def _nested(value: Yaml, indent: int) -> str:
    if isinstance(value, (Mapping, Sequence)) and not isinstance(value, str) and value:
        return "\n" + yaml_text(value, indent + 2)
    return " " + _scalar(value) + "\n"


def _key(key: str) -> str:
    plain = re.fullmatch("[a-z_][a-z0-9_]+", key) and key not in _YAML_WORDS
    return key if plain else json.dumps(key, ensure_ascii=False)


def _scalar(value: Yaml) -> str:
    return "~" if value is None else json.dumps(value, ensure_ascii=False)
