"""Which files make up a bag, and what its metadata.yaml promises."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dfm_stage.recording.errors import BagReadError
from dfm_stage.recording.mcap_scan import Loss

METADATA_FILE = "metadata.yaml"


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
    bag = BagFiles(sorted(path.glob("*.mcap"), key=_natural))
    _apply_metadata(path, bag)
    if not bag.files:
        others = [item.name for item in path.iterdir() if item.suffix in (".db3", ".zstd")]
        if others:
            raise BagReadError(f"{path}: {others[0]} is not read here; convert the bag to plain "
                               f"MCAP first (ros2 bag convert)")
        raise BagReadError(f"{path}: holds no .mcap file; give a bag folder or an .mcap file")
    return bag


def _natural(path: Path) -> list[Any]:
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]


def _apply_metadata(path: Path, bag: BagFiles) -> None:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    file = path / METADATA_FILE
    try:
        information = dict(YAML(typ="safe").load(file.read_text(encoding="utf-8"))[
            "rosbag2_bagfile_information"])
    except FileNotFoundError:
        bag.losses.append(Loss(f"{path}: has no {METADATA_FILE}; the .mcap files were read in "
                               f"the order of their names"))
    except (OSError, ValueError, YAMLError, KeyError, TypeError):
        bag.losses.append(Loss(f"{file}: is damaged and was not used"))
    else:
        _apply(information, path, bag)


def _apply(information: dict[str, Any], path: Path, bag: BagFiles) -> None:
    storage = information.get("storage_identifier")
    if storage != "mcap":
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
    except (KeyError, TypeError, ValueError):
        bag.losses.append(Loss(f"{path / METADATA_FILE}: is damaged and was used in part"))
        return
    custom = information.get("custom_data")
    if isinstance(custom, dict):
        bag.custom_data = {str(key): str(value) for key, value in custom.items()}
    bag.losses += [Loss(f"{file}: is listed in {METADATA_FILE} and missing")
                   for file in listed if not file.is_file()]
    bag.files = [file for file in listed if file.is_file()] or bag.files
