"""Numbers in the messages of any bag, by paths such as `/joint_states.effort[joint_a]`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dfm_stage.recording.bag import Bag, Ragged, Topic
from dfm_stage.recording.errors import NotInBagError, RecordError
from dfm_stage.recording.record import FloatArray, Ints

_PATH = re.compile(r"(?P<topic>/[^.\[\]\s]+)\.(?P<field>.+)")
_PART = re.compile(r"(?P<name>[A-Za-z]\w*)(?P<indices>(?:\[[^\[\]]+\])*)")
_LABELS = ("name", "names", "joint_names")
"""Fields with the names of the elements of the sequences beside them."""
LISTED_ELEMENTS = 32
"""Of longer sequences (images, scans) the elements are not listed one by one."""


@dataclass(frozen=True)
class FieldPath:
    """A number in the messages of a topic.

    `column` is the dotted name of the field, `indices` say which element of its arrays: a number,
    or the name that the message gives to the element.
    """

    topic: str
    column: str
    indices: tuple[int | str, ...] = ()

    @classmethod
    def parse(cls, text: str) -> FieldPath:
        """Return the path that a text like `/joint_states.effort[0]` means.

        Raises
        ------
        RecordError
            If it is none.
        """
        match = _PATH.fullmatch(text.strip())
        # a name between brackets may have dots of its own
        parts = [_PART.fullmatch(part) for part in
                 re.split(r"\.(?![^\[]*\])", match["field"])] if match else [None]
        if match is None or None in parts:
            raise RecordError(f"{text!r} names no field of a topic; write it as "
                              f"/joint_states.effort[0]")
        names = [part["name"] for part in parts if part]
        indices = [index for part in parts if part
                   for index in re.findall(r"\[([^\]]+)\]", part["indices"])]
        return cls(match["topic"], ".".join(names),
                   tuple(int(index) if index.isdigit() else index for index in indices))

    def __str__(self) -> str:
        return f"{self.topic}.{self.column}{''.join(f'[{index}]' for index in self.indices)}"


def field_values(topic: Topic, path: FieldPath) -> tuple[Ints, FloatArray]:
    """Return which messages hold that number, and its values: (n,) rows, (n,) values.

    Raises
    ------
    RecordError, NotInBagError
        If there is no such field, or it is no number.
    """
    if path.column in topic.text_columns:
        raise RecordError(f"{path}: holds text, no numbers")
    column = topic[path.column]
    if isinstance(column, Ragged):
        return _element(topic, path, column)
    if column.ndim == 1:
        if path.indices:
            raise RecordError(f"{path}: is no array; leave the index out")
        return np.arange(len(column)), column.astype(np.float64)
    size = column.shape[1]
    place = _only_index(path, f"an array of {size}", size)
    return np.arange(len(column)), column[:, place].astype(np.float64)


def _only_index(path: FieldPath, what: str, size: int) -> int:
    """The number of an element of a fixed array, which stands last in the path."""
    place = path.indices[-1] if path.indices else None
    if not isinstance(place, int) or place >= size:
        raise RecordError(f"{path}: is {what}; say which element, from [0] to [{size - 1}]")
    return place


def _element(topic: Topic, path: FieldPath, column: Ragged) -> tuple[Ints, FloatArray]:
    values = column.values
    if values.ndim == 2:
        values = values[:, _only_index(path, f"a sequence of arrays of {values.shape[1]}",
                                       values.shape[1])]
    longest = int(column.lengths.max(initial=0))
    if len(path.indices) != column.values.ndim:
        raise RecordError(f"{path}: is a sequence of up to {longest}; say which element, like "
                          f"{path.topic}.{path.column}[0]")
    index = path.indices[0]
    starts = column.ends - column.lengths
    if isinstance(index, int):
        rows = np.flatnonzero(column.lengths > index)
        places = starts[rows] + index
    else:
        rows, offsets = _labelled(topic, path, index)
        has = offsets < column.lengths[rows]
        rows, places = rows[has], starts[rows[has]] + offsets[has]
    if not len(rows):
        raise RecordError(f"{path}: no message has this element; the sequence has "
                          f"{longest or 'no'} elements at most")
    return rows, values[places].astype(np.float64)


def labels_of(topic: Topic, column: str) -> Ragged | None:
    """Return the names of the elements of a sequence, as numbers of texts, if there are any."""
    *parents, _ = column.split(".")
    for depth in range(len(parents), -1, -1):
        for label in _LABELS:
            name = ".".join([*parents[:depth], label])
            found = topic.columns.get(name)
            if name in topic.text_columns and isinstance(found, Ragged):
                return found
    return None


def _labelled(topic: Topic, path: FieldPath, label: str) -> tuple[Ints, Ints]:
    """Return the messages that name an element so, and the place of it in each."""
    codes = labels_of(topic, path.column)
    if codes is None:
        raise RecordError(f"{path}: the messages name no elements; give the number of one, like "
                          f"[0]")
    known = np.unique(codes.values)
    wanted = known[topic.texts[known] == label]
    if not len(wanted):
        raise RecordError(f"{path}: there is no {label!r}, only "
                          f"{', '.join(sorted(topic.texts[known])) or 'nothing'}")
    hits = np.flatnonzero(codes.values == wanted[0])
    rows, first = np.unique(np.searchsorted(codes.ends, hits, side="right"), return_index=True)
    return rows, hits[first] - (codes.ends - codes.lengths)[rows]


@dataclass(frozen=True)
class BagField:
    """A number that a bag holds: path, type, how many, from the least to the greatest."""

    path: str
    type_name: str
    count: int
    least: float
    greatest: float


def numeric_fields(bag: Bag) -> dict[str, list[BagField]]:
    """Return the numbers in every topic; of long sequences only as a whole."""
    return {name: list(_fields(topic)) for name, topic in bag.items()}


def _fields(topic: Topic) -> Iterator[BagField]:
    for name, column in topic.columns.items():
        if name in topic.text_columns or name in topic.time_columns:
            continue
        values = column.values if isinstance(column, Ragged) else column
        if not values.size:
            continue
        for path in _paths(topic, name):
            try:
                _, numbers = field_values(topic, FieldPath.parse(path))
            except (RecordError, NotInBagError):    # a whole sequence
                numbers = values.astype(np.float64).ravel()
            finite = numbers[np.isfinite(numbers)]
            ends = (float(finite.min()), float(finite.max())) if len(finite) else (np.nan, np.nan)
            yield BagField(path, str(values.dtype), len(numbers), *ends)


def _paths(topic: Topic, name: str) -> list[str]:
    """The paths of a field: itself, or each of its elements, by their names where they have."""
    column, path = topic.columns[name], f"{topic.name}.{name}"
    if not isinstance(column, Ragged):
        size = 1 if column.ndim == 1 else column.shape[1]
        if column.ndim == 1 or size > LISTED_ELEMENTS:
            return [path if column.ndim == 1 else f"{path}[0..{size - 1}]"]
        return [f"{path}[{k}]" for k in range(size)]
    longest = int(column.lengths.max())
    inner = [""] if column.values.ndim == 1 else [f"[{k}]" for k in range(column.values.shape[1])]
    if longest * len(inner) > LISTED_ELEMENTS:
        return [f"{path}[0..{longest - 1}]"]
    codes, each = labels_of(topic, name), [str(k) for k in range(longest)]
    if codes is not None:
        named = list(dict.fromkeys(topic.texts[codes.values].tolist()))
        if len(named) >= longest and all(re.fullmatch(r"[^\[\]]*\D[^\[\]]*", n) for n in named):
            each = named
    return [f"{path}[{k}]{rest}" for k in each for rest in inner]
