"""The `metadata.yaml` of a rosbag2 folder, version 9: written, and read to find its files.

It holds the QoS profiles of the topics and promises how many messages there are.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from dfm_stage.recording.errors import BagReadError
from dfm_stage.recording.formats import STORAGES
from dfm_stage.recording.mcap_scan import Loss

METADATA_FILE = "metadata.yaml"
INFINITE_NS = 2**63 - 1
VERSION = 9

Yaml: TypeAlias = 'bool | int | str | Sequence["Yaml"] | Mapping[str, "Yaml"] | None'
_YAML_WORDS = frozenset({"yes", "no", "on", "off", "null", "true", "false"})


@dataclass
class BagFiles:
    """The files of a bag in order; `expected` holds the message count of each topic, if known."""

    files: list[Path]
    expected: dict[str, int] = field(default_factory=dict)
    end_ns: int | None = None
    custom_data: Mapping[str, str] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)


def find_files(path: Path) -> BagFiles:
    """Return the files of a bag folder, or of a single file.

    Raises
    ------
    BagReadError
        If there is none, or they are stored in a way that is not read here.
    """
    if path.is_file():
        return BagFiles([path])
    if not path.is_dir():
        raise BagReadError(f"{path}: there is no such file or folder")
    bag = BagFiles(next((found for suffix in STORAGES.values()
                         if (found := sorted(path.glob(f"*{suffix}"), key=_natural))), []))
    _apply_metadata(path, bag)
    if not bag.files:
        others = [item.name for item in path.iterdir() if item.suffix == ".zstd"]
        if others:
            raise BagReadError(f"{path}: {others[0]} is not read here; convert the bag to plain "
                               f"MCAP first (ros2 bag convert)")
        raise BagReadError(f"{path}: holds no .mcap or .db3 file; give a bag folder or such a "
                           f"file")
    return bag


def _natural(path: Path) -> list[Any]:
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]


def _suffix(bag: BagFiles) -> str:
    return bag.files[0].suffix if bag.files else ".mcap"


def _apply_metadata(path: Path, bag: BagFiles) -> None:
    from dfm_stage.yaml_text import YamlError, load_yaml, text_of

    file = path / METADATA_FILE
    try:
        information = dict(load_yaml(text_of(file))[
            "rosbag2_bagfile_information"])
    except FileNotFoundError:
        bag.losses.append(Loss(f"{path}: has no {METADATA_FILE}; the {_suffix(bag)} files were "
                               f"read in the order of their names"))
    except (OSError, ValueError, YamlError, KeyError, TypeError):
        bag.losses.append(Loss(f"{file}: is damaged and was not used"))
    else:
        _apply(information, path, bag)


def _apply(information: dict[str, Any], path: Path, bag: BagFiles) -> None:
    storage = str(information.get("storage_identifier"))
    if storage not in STORAGES:
        raise BagReadError(f"{path}: is stored as {storage}; convert it to MCAP first "
                           f"(ros2 bag convert)")
    if str(information.get("compression_mode") or "none").lower() != "none":
        raise BagReadError(f"{path}: whole files or messages are compressed by rosbag2; convert "
                           f"it first (ros2 bag convert), compression inside MCAP is read")
    try:
        listed = [path / Path(str(name)).name for name in information["relative_file_paths"]]
        for entry in information["topics_with_message_count"]:
            name = str(entry["topic_metadata"]["name"])
            bag.expected[name] = bag.expected.get(name, 0) + int(entry["message_count"])
        start = int(information["starting_time"]["nanoseconds_since_epoch"])
        duration = int(information["duration"]["nanoseconds"])
        bag.end_ns = start + duration if information["message_count"] else None
    except (KeyError, TypeError, ValueError, OverflowError):
        bag.losses.append(Loss(f"{path / METADATA_FILE}: is damaged and was used in part"))
        return
    custom = information.get("custom_data")
    if isinstance(custom, dict):
        bag.custom_data = {str(key): str(value) for key, value in custom.items()}
    bag.losses += [Loss(f"{file}: is listed in {METADATA_FILE} and missing")
                   for file in listed if not file.is_file()]
    bag.files = [file for file in listed if file.is_file()] or bag.files


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
            "topics_with_message_count": [{"topic_metadata": {
                "name": entry.name,
                "type": entry.type_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": [profile.to_dict() for profile in entry.qos_profiles],
                "type_description_hash": entry.type_hash,
            }, "message_count": entry.message_count} for entry in self.topics],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file_name],
            "files": [{"path": self.file_name, "starting_time": start, "duration": duration,
                       "message_count": self.message_count}],
            "custom_data": dict(self.custom_data) or None,
            "ros_distro": self.ros_distro,
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
