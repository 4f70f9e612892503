"""A kind of signal: its name, its parameter table and the function that makes it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array
from dfm_stage.model.parameter import Option, Parameter, ParameterError, nearest
from dfm_stage.trajectory.errors import TrajectoryError, place

Signal = TypeVar("Signal")
Movement = tuple[Array, Array, Array, NDArray[np.bool_], int, int]
"""Position, velocity, acceleration, what counts (N,); samples of the period and of the start."""
MOST_SAMPLES = 20_000_000
_WHOLE = 1e-6


@dataclass(frozen=True)
class Timing:
    """The sample grid a signal is made on: t_k = k * sample_period_s for k < count."""

    sample_period_s: float
    count: int
    seed: int = 0

    @staticmethod
    def over(sample_period_s: float, duration_s: float, seed: int = 0) -> Timing:
        """Return the grid with round(duration_s / sample_period_s) samples.

        Raises
        ------
        TrajectoryError
            If a number is not positive and finite or the duration is less than one sample.
        """
        for name, number in (("sample_period_s", sample_period_s), ("duration_s", duration_s)):
            if not (math.isfinite(number) and number > 0.0):
                raise TrajectoryError(f"{name} must be a positive number of seconds, "
                                      f"not {number!r}", name)
        count = round(min(duration_s / sample_period_s, 2.0 * MOST_SAMPLES))
        if count > MOST_SAMPLES:
            raise TrajectoryError(f"duration_s = {duration_s:g} s has more than {MOST_SAMPLES} "
                                  f"samples of {sample_period_s:g} s; shorten it, or repeat a "
                                  "shorter signal", "duration_s")
        if count < 1:
            raise TrajectoryError(f"duration_s = {duration_s:g} s is shorter than one sample of "
                                  f"{sample_period_s:g} s", "duration_s")
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise TrajectoryError(f"seed must be a whole number from 0, not {seed!r}", "seed")
        return Timing(float(sample_period_s), count, int(seed))


@dataclass(frozen=True)
class Values:
    """The checked settings of one signal, defaults filled in; `where` is its dotted place."""

    settings: Mapping[str, Any]
    where: str = ""

    def number(self, name: str) -> float:
        """Return a real setting."""
        return float(self.settings[name])

    def whole(self, name: str) -> int:
        """Return a setting that counts something."""
        value = self.number(name)
        if value != int(value):
            raise self.error(name, f"{name} = {value:g} must be a whole number")
        return int(value)

    def flag(self, name: str) -> bool:
        """Return a switch."""
        return bool(self.settings[name])

    def word(self, name: str) -> str:
        """Return a choice."""
        return str(self.settings[name])

    def numbers(self, name: str) -> Array:
        """Return a list setting, shape (n,)."""
        return np.asarray(self.settings[name], dtype=float)

    def samples(self, seconds: float, name: str, timing: Timing) -> int:
        """Return how many samples `seconds` are; anything but a whole number is refused."""
        exact = seconds / timing.sample_period_s
        if not abs(exact) <= MOST_SAMPLES:
            raise self.error(name, f"{name} = {seconds:g} s has more than {MOST_SAMPLES} samples "
                                   f"of {timing.sample_period_s:g} s; shorten it")
        count = round(exact)
        if abs(exact - count) > _WHOLE * max(1.0, exact):
            near = max(1, count) * timing.sample_period_s
            raise self.error(name, f"{name} = {seconds:g} s is {exact:.6g} samples of "
                                   f"{timing.sample_period_s:g} s, not a whole number; "
                                   f"use {near:.9g} s")
        return count

    def error(self, name: str, message: str) -> TrajectoryError:
        """Return the error that names the setting it is about."""
        return TrajectoryError(place(self.where, message), f"{self.where}.{name}".lstrip("."))


@dataclass(frozen=True)
class Kind(Generic[Signal]):
    """One kind of signal. `parameters` are real numbers, `options` everything else."""

    name: str
    description: str
    parameters: tuple[Parameter, ...]
    build: Callable[[Values, Timing], Signal] = field(repr=False)
    options: tuple[Option, ...] = ()

    def made(self, values: Values, timing: Timing) -> Signal:
        """Return the signal of checked settings.

        Raises
        ------
        TrajectoryError
            If they do not fit together, or are beyond what numbers and memory hold.
        """
        try:
            with np.errstate(all="ignore"):     # what is not finite is refused by the limits
                return self.build(values, timing)
        except (ArithmeticError, MemoryError, np.linalg.LinAlgError) as error:
            raise TrajectoryError(place(values.where, f"{self.name} is beyond what can be "
                                        f"computed ({str(error) or 'memory'}); use smaller "
                                        "numbers"), values.where) from None

    def checked(self, spec: Mapping[str, Any], where: str = "") -> Values:
        """Return every setting of this kind, from `spec` or its default.

        Raises
        ------
        TrajectoryError
            If `spec` has an unknown setting, or one of a wrong type or outside its range.
        """
        known: dict[str, Parameter | Option] = {p.name: p for p in self.parameters}
        known.update({o.name: o for o in self.options})
        settings: dict[str, Any] = {name: entry.default for name, entry in known.items()}
        for name, value in spec.items():
            if name == "kind":
                continue
            key = f"{where}.{name}".lstrip(".")
            if name not in known:
                raise TrajectoryError(place(where, f"{self.name} has no setting {name!r}, "
                                                   f"{nearest(name, known)}"), key)
            try:
                settings[name] = known[name].checked(value, where)
            except ParameterError as error:
                raise TrajectoryError(str(error), key) from None
        return Values(settings, where)


def choose(spec: object, kinds: Mapping[str, Kind[Signal]],
           where: str = "") -> tuple[Kind[Signal], Values]:
    """Return the kind a specification asks for and its checked settings.

    Raises
    ------
    TrajectoryError
        If `spec` is no mapping, has no `kind` or an unknown one, or a bad setting.
    """
    if not isinstance(spec, Mapping):
        raise TrajectoryError(place(where, f"must be a mapping such as {{kind: sine}}, "
                                           f"not {spec!r}"), where)
    if "kind" not in spec:
        raise TrajectoryError(place(where, f"kind is missing; {nearest('', kinds)}"), where)
    name = spec["kind"]
    if not isinstance(name, str) or name not in kinds:
        raise TrajectoryError(place(where, f"there is no kind {name!r}, {nearest(name, kinds)}"),
                              f"{where}.kind".lstrip("."))
    kind = kinds[name]
    return kind, kind.checked(spec, where)
