"""What a device has to offer to be driven, and how its driver is found by name.

A driver is one module in `drivers/encoders` or `drivers/amplifiers` whose function
`create(port, **options)` returns an object with the methods below; its name is the value of the
parameter `device`. Nothing else has to be changed.
"""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass
from typing import Any, Protocol, cast

from dfm_stage.drivers.errors import DriverError


@dataclass(frozen=True)
class EncoderSample:
    """One reading of a counter.

    Attributes
    ----------
    seq : rises by one each sample period of the device; a gap is a lost sample
    stamp_ns : when it was taken, system time
    counts : not wrapped
    elapsed_s : since the sample before, by the device's clock; 0 for the first
    """

    seq: int
    stamp_ns: int
    counts: int
    elapsed_s: float


class EncoderDevice(Protocol):
    """A counter that streams.

    Every method may raise DeviceLostError; after that only `close` and `open` are called.
    """

    sample_period_s: float
    counters: dict[str, int]

    def open(self) -> str:
        """Open the port, check what is there, set it up; return its identity in words."""

    def start(self) -> None:
        """Start streaming."""

    def stop(self) -> None:
        """Stop streaming."""

    def read(self, timeout_s: float) -> list[EncoderSample]:
        """Return the samples that came, at the latest after `timeout_s`."""

    def seek_index(self) -> None:
        """Make the next index mark the zero of the counts."""

    def index_found(self) -> bool:
        """Return whether the index mark was passed since `seek_index`; polled while reading."""

    def close(self) -> None:
        """Give the port back; never raises."""


@dataclass(frozen=True)
class AmplifierStatus:
    """What the drive says about itself; None where it was not asked this time.

    Attributes
    ----------
    trouble : why the output must be off, in words; empty when there is nothing
    travel_limit : which limit switch is active, in words; empty for none
    notes : further numbers with units for diagnostics
    """

    current_a: float | None = None
    trouble: str | None = None
    travel_limit: str | None = None
    notes: dict[str, str] | None = None


class AmplifierDevice(Protocol):
    """A current amplifier that obeys commands one at a time.

    Every method may raise DeviceLostError; after that only `close` and `open` are called.
    """

    count_a: float
    counters: dict[str, int]

    def open(self) -> str:
        """Open the port, take the output to zero and off, check; return the identity in words."""

    def arm(self) -> None:
        """Switch the output stage on at zero current.

        Raises RefusedError with the reason, and leaves it off.
        """

    def set_counts(self, counts: int) -> None:
        """Set the output to `counts` times `count_a`."""

    def disarm(self) -> None:
        """Output to zero, then off."""

    def status(self) -> AmplifierStatus:
        """Ask the drive one question; call after call all of them in turn."""

    def clear_faults(self) -> str:
        """Clear faults that the drive latched, at an operator's request; return them in words."""

    def close(self) -> None:
        """Give the port back; never raises."""


def names(kind: str) -> tuple[str, ...]:
    """Return the names of the drivers of a kind, `encoders` or `amplifiers`."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(
        importlib.import_module(f"dfm_stage.drivers.{kind}").__path__)))


def _create(kind: str, name: str, port: str, options: dict[str, Any]) -> Any:
    if name not in names(kind):
        raise DriverError(f"there is no driver {name!r} among {kind}: {', '.join(names(kind))}")
    if not port:
        raise DriverError(f"device {name} needs the parameter port, such as /dev/ttyUSB0 "
                          "(better /dev/serial/by-id/...)")
    return importlib.import_module(f"dfm_stage.drivers.{kind}.{name}").create(port, **options)


def create_encoder(name: str, port: str, **options: Any) -> EncoderDevice:
    """Return the driver of an encoder, its port not yet open."""
    return cast("EncoderDevice", _create("encoders", name, port, options))


def create_amplifier(name: str, port: str, **options: Any) -> AmplifierDevice:
    """Return the driver of an amplifier, its port not yet open."""
    return cast("AmplifierDevice", _create("amplifiers", name, port, options))
