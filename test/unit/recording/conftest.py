"""Bags made from messages that another library serialised."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from dfm_stage.recording import BagWriter, QosProfile

ROOT = Path(__file__).parents[3]
OURS = ("Reference", "Excitation", "Measurement", "Command", "AmplifierState", "PlantState",
        "PositionCounts", "Drive")
HASH = "RIHS01_" + "ab" * 32
_PRIMITIVES: dict[str, Callable[[np.random.Generator], Any]] = {
    "bool": lambda rng: bool(rng.integers(2)),
    "byte": lambda rng: int(rng.integers(128)),  # rosbags takes it for signed
    "char": lambda rng: int(rng.integers(256)),
    "float32": lambda rng: float(np.float32(rng.normal())),
    "float64": lambda rng: float(rng.normal()),
    "string": lambda rng: "".join(rng.choice(list("abcdé "), int(rng.integers(9)))),
}


@pytest.fixture(scope="session")
def typestore() -> Typestore:
    """The standard messages and ours, as rosbags knows them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in (ROOT / "dfm_interfaces" / "msg").glob("*.msg"):
        types |= get_types_from_msg(path.read_text(), f"dfm_interfaces/msg/{path.stem}")
    store.register(types)
    return store


@pytest.fixture(scope="session")
def random_message(typestore: Typestore) -> Callable[[str, np.random.Generator], Any]:
    """Make a message of a type with random content."""

    def value(kind: Any, rng: np.random.Generator) -> Any:
        node, detail = kind
        name = node.name.lower()
        if name == "base":
            base = detail[0]
            if base in _PRIMITIVES:
                return _PRIMITIVES[base](rng)
            info = np.iinfo(base)
            return int(rng.integers(info.min, info.max, endpoint=True, dtype=base))
        if name == "name":
            return message(detail, rng)
        inner, count = detail
        count = count if name == "array" else int(rng.integers(4))
        items = [value(inner, rng) for _ in range(count)]
        base = inner[1][0]
        if inner[0].name.lower() == "base" and base != "string":
            dtype = {"bool": "?", "byte": "u1", "char": "u1"}.get(base, base)
            return np.array(items, dtype=dtype)
        return items

    def message(type_name: str, rng: np.random.Generator) -> Any:
        _, fields = typestore.fielddefs[type_name]
        return typestore.types[type_name](**{name: value(kind, rng) for name, kind in fields})

    return message


@pytest.fixture(scope="session")
def schema(typestore: Typestore) -> Callable[[str], str]:
    """The schema text of a type: ours from the .msg files, others as rosbags writes them."""

    def text(type_name: str) -> str:
        return typestore.generate_msgdef(type_name, ros_version=2)[0]

    return text


Messages = dict[str, tuple[str, list[bytes]]]


@pytest.fixture(scope="session")
def make_bag(schema: Callable[[str], str]) -> Callable[..., None]:
    """Write {topic: (type, serialised messages)} in turns, one sample a millisecond."""

    def write(folder: Path, messages: Messages, **options: Any) -> None:
        with BagWriter(folder, **options) as bag:
            bag.attach("model.yaml", "application/yaml", b"dfm_model: 1\nsample_period: 0.001\n")
            numbers = {topic: bag.add_topic(topic, kind, [QosProfile()], HASH, schema(kind))
                       for topic, (kind, _) in messages.items()}
            for k in range(max(len(data) for _, data in messages.values())):
                for topic, (_, data) in messages.items():
                    if k < len(data):
                        stamp = 10**18 + k * 10**6
                        bag.write(numbers[topic], data[k], stamp + 5, stamp, k)

    return write


@pytest.fixture
def our_messages(typestore: Typestore,
                 random_message: Callable[[str, np.random.Generator], Any]) -> Messages:
    """Fifty messages of each of our types."""
    rng = np.random.default_rng(11)
    result: Messages = {}
    for short in OURS:
        kind = f"dfm_interfaces/msg/{short}"
        result[f"/stage/x/{short.lower()}"] = (kind, [
            bytes(typestore.serialize_cdr(random_message(kind, rng), kind)) for _ in range(50)])
    return result


def flat(message: Any, prefix: str = "") -> dict[str, Any]:
    """Flatten a rosbags message the way columns are named; sequences of messages are left out."""
    result: dict[str, Any] = {}
    for name in message.__dataclass_fields__:
        value = getattr(message, name)
        if name.startswith("__msgtype"):
            continue
        if hasattr(value, "__dataclass_fields__"):
            if hasattr(value, "nanosec"):
                result[prefix + name] = value.sec * 10**9 + value.nanosec
            else:
                result |= flat(value, f"{prefix}{name}.")
        elif not (isinstance(value, list) and value and hasattr(value[0],
                                                                "__dataclass_fields__")):
            result[prefix + name] = value
    return result


@pytest.fixture(scope="session")
def flatten() -> Callable[[Any], dict[str, Any]]:
    return flat


def equal(ours: Any, theirs: Any) -> bool:
    """Whether one row of a column is the value that another decoder gives."""
    if isinstance(theirs, (list, np.ndarray)):
        return len(ours) == len(theirs) and all(map(equal, ours, theirs))
    if isinstance(theirs, float) and math.isnan(theirs):
        return bool(math.isnan(ours))
    return bool(ours == theirs)


@pytest.fixture(scope="session")
def same() -> Callable[[Any, Any], bool]:
    return equal


