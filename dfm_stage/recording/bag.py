"""A bag in memory: topics as columns, what was attached, and what is missing."""

from __future__ import annotations

import fnmatch
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.errors import NotInBagError
from dfm_stage.recording.mcap_scan import Loss

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

Array: TypeAlias = NDArray[Any]

# Names by which the writer and the reader of a bag know things.
MODEL_ATTACHMENT = "model.yaml"
PARAMETERS_ATTACHMENT = "parameters.yaml"
VERSIONS_ATTACHMENT = "versions.json"
DROPPED_KEY = "messages_dropped"     # custom data of metadata.yaml: messages the recorder lost


def chosen_topics(path: Path, names: Collection[str], patterns: Iterable[str] | None) -> set[str]:
    """Return the topics that names, which must be there, or patterns ask for; all by default.

    Raises
    ------
    NotInBagError
        If a topic asked for is not among `names`.
    """
    if patterns is None:
        return set(names)
    chosen: set[str] = set()
    for pattern in patterns:
        if pattern not in names and not set("*?[") & set(pattern):
            raise NotInBagError(f"{path}: no topic {pattern}; there are "
                                f"{', '.join(sorted(names)) or 'none'}")
        chosen |= set(fnmatch.filter(names, pattern))
    return chosen


@dataclass(frozen=True)
class Ragged:
    """One sequence per message: `values[ends[i-1]:ends[i]]` belongs to message i.

    `values` has shape (total,) or, where each element is a fixed array, (total, n).
    """

    values: Array
    ends: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ends)

    def __getitem__(self, index: int) -> Array:
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        index %= len(self)
        return self.values[self.ends[index - 1] if index else 0:self.ends[index]]

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Elements of each message."""
        return np.diff(self.ends, prepend=0)


@dataclass(frozen=True)
class Topic(Mapping[str, Any]):
    """The messages of one topic, in the order of the file, as columns by field name.

    Values are arrays of one row per message, `Ragged` for sequences; nested fields have dotted
    names, times are int64 nanoseconds, text comes as arrays of str objects.

    Attributes
    ----------
    log_time_ns, publish_time_ns : (N,) int64
    sequence : (N,) uint32
    text_columns, time_columns : names of the columns of text, and of times in ns
    left_out : list of str
        Fields that are not in the columns, each with the reason.
    """

    name: str
    type_name: str
    log_time_ns: NDArray[np.int64]
    publish_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    columns: Mapping[str, Array | Ragged]
    texts: Array
    text_columns: frozenset[str]
    time_columns: frozenset[str] = frozenset()
    left_out: list[str] = field(default_factory=list)

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return len(self.log_time_ns)

    def __getitem__(self, name: str) -> Any:
        try:
            column = self.columns[name]
        except KeyError:
            raise NotInBagError(f"{self.name}: {self.type_name} has no field {name!r}; there are "
                               f"{', '.join(self.columns)}") from None
        if name not in self.text_columns:
            return column
        if isinstance(column, Ragged):
            return Ragged(self.texts[column.values], column.ends)
        return self.texts[column]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def to_pandas(self) -> DataFrame:
        """Return the fields as columns over the time at which each message was recorded.

        The index `log_time` is in ns since the epoch, as datetime64. Fixed arrays give a column an
        element (`name[0]`); a sequence is one array in each row; times stay int64, ns.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.
        """
        from dfm_stage.recording.frames import data_frame

        return data_frame(dict(self), "log_time", self._when(), self._about())

    def to_xarray(self) -> Dataset:
        """Return the fields as variables over `log_time`; fixed arrays have a second dimension.

        Raises
        ------
        MissingPackageError
            If xarray is not installed.
        """
        from dfm_stage.recording.frames import data_set

        found: Dataset = data_set(dict(self), "log_time", self._when(), self._about())
        return found

    def _when(self) -> Array:
        return self.log_time_ns.astype("datetime64[ns]")

    def _about(self) -> dict[str, str]:
        return {"topic": self.name, "type": self.type_name}


@dataclass(frozen=True)
class Bag(Mapping[str, Topic]):
    """What `read_bag` returns: topics by name.

    Attributes
    ----------
    path : Path
    attachments : dict of name to bytes
    metadata : dict of name to dict
        The metadata records of the files.
    losses : list of Loss
        What is missing or damaged, worst first where it is known; empty for a sound bag.
    left_out : dict of topic to reason
        Topics that could not be put into arrays at all.
    """

    path: Path
    topics: Mapping[str, Topic]
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Topic:
        try:
            return self.topics[name]
        except KeyError:
            raise NotInBagError(f"{self.path}: no topic {name}; there are "
                               f"{', '.join(sorted(self.topics)) or 'none'}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.topics)

    def __len__(self) -> int:
        return len(self.topics)

    @property
    def message_count(self) -> int:
        """Messages read, all topics together."""
        return sum(topic.message_count for topic in self.topics.values())
