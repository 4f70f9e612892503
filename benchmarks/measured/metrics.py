"""Figures of an extended model on recorded data, as the sources of the records define theirs.

They are computed from the files that the diagnosis wrote, not by the code that fitted them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt

from benchmarks.measured.columns import Array, Columns
from dfm_stage.model import Model, Simulator

FINER = 8
"""Held steps a sample by which an input between its samples is followed: the middle of each is
taken, so that what is left goes with its square."""
SEARCH_STEPS = 4
EDGE_SHARE = 0.01
"""Share of a record at each end whose filtered derivatives are not compared."""
HELD = "zero"


@dataclass(frozen=True)
class Convention:
    """How the samples of an input became an input: see `conventions` in the contracts."""

    hold: str = HELD
    shift: float = 0.0

    @classmethod
    def of(cls, answer: Mapping[str, Any], record: str) -> Convention:
        """The convention that a diagnosis found for a record; of one it does not tell of, that
        of the first."""
        told = answer.get("conventions") or []
        chosen = next((each for each in told if _stem(each["record"]) == record),
                      told[0] if told else None)
        if chosen is None:
            return cls()
        shift = chosen.get("input_shift_samples", {}).get("value") or 0.0
        return cls(chosen.get("input_hold", HELD), min(float(shift), 0.0))


def _stem(name: str) -> str:
    return name.rsplit("/", maxsplit=1)[-1].removesuffix(".csv")


def acting(samples: Array, convention: Convention) -> tuple[Array, int]:
    """Return the input as held steps, (N r,), and how many a sample there are, r."""
    if convention == Convention():
        return samples, 1
    at = (np.arange(samples.size * FINER) + 0.5) / FINER - convention.shift
    if convention.hold == HELD:
        return samples[np.clip(np.floor(at).astype(int), 0, samples.size - 1)], FINER
    if convention.hold == "first":
        return np.interp(at, np.arange(samples.size), samples), FINER
    return _band_limited(samples, at[0]), FINER


def _band_limited(samples: Array, first: float) -> Array:
    """Values at first, first + 1/FINER, ... of the band-limited signal through the samples.

    The record is continued by its mirror image, so that the ends do not ring.
    """
    mirrored = np.concatenate((samples, samples[::-1]))
    spectrum = np.fft.rfft(mirrored)
    turn = 2.0 * np.pi * np.arange(spectrum.size) / mirrored.size
    fine = np.zeros(FINER * samples.size + 1, complex)
    fine[:spectrum.size] = spectrum * np.exp(1j * turn * first)
    return FINER * np.fft.irfft(fine, FINER * mirrored.size)[:FINER * samples.size]


def output_of(columns: Columns) -> tuple[str, Array]:
    """Return what was measured (position, velocity, acceleration or a name) and its samples."""
    for kind in ("position", "velocity", "acceleration"):
        for name, values in columns.items():
            if name.startswith(kind):
                return kind, values
    name = next(name for name in columns if not name.startswith(("time", "input", "reference")))
    return name, columns[name]


def input_of(columns: Columns) -> Array:
    """Return the samples of the input."""
    return next(values for name, values in columns.items() if name.startswith("input"))


def simulated(model: Model, columns: Columns, convention: Convention, free: int,
              offset: float = 0.0) -> Array:
    """Simulate a position, its first state fitted to the first `free` samples and to no other.

    Parameters
    ----------
    offset : what the sensor adds, known from elsewhere.

    Returns
    -------
    (N,) in the unit of the position, without the offset.
    """
    held, finer = acting(input_of(columns), convention)
    measured = output_of(columns)[1] - offset
    simulator = Simulator(replace(model, sample_period=model.sample_period / finer))
    start = _first_state(simulator, held[:free * finer], measured[:free], finer,
                         model.sample_period)
    return np.asarray(simulator.output(held, initial=start)[::finer])


def _first_state(simulator: Simulator, held: Array, measured: Array, finer: int,
                 period: float) -> dict[str, float]:
    """Position and velocity at the first sample by Gauss-Newton, the input before it standing."""
    state = np.array([measured[0], (measured[1] - measured[0]) / period])
    steps = np.array([1e-4 * (np.ptp(measured) or 1.0), 1e-4 * (np.ptp(measured) or 1.0) / period])

    def response(x: Array) -> Array:
        found = simulator.output(held, initial={"position": x[0], "velocity": x[1]})
        return np.asarray(found[::finer])

    for _ in range(SEARCH_STEPS):
        at = response(state)
        slopes = np.column_stack([(response(state + np.diag(steps)[i]) - at) / steps[i]
                                  for i in range(2)])
        state = state + np.linalg.lstsq(slopes, measured - at, rcond=None)[0]
    return {"position": float(state[0]), "velocity": float(state[1])}


def offset_of(model: Model, columns: Columns, convention: Convention, free: int) -> float:
    """What the sensor adds to the model's output on average over a (fitted) record."""
    measured = output_of(columns)[1]
    offset = 0.0
    for _ in range(SEARCH_STEPS):
        offset = float(np.mean(measured[free:]
                               - simulated(model, columns, convention, free, offset)[free:]))
    return offset


def rmse(model: Model, columns: Columns, convention: Convention, after: int, offset: float,
         samples: int | None = None) -> float:
    """RMS of measured minus simulated from sample `after` on, up to `samples`."""
    measured = output_of(columns)[1] - offset
    error = measured - simulated(model, columns, convention, after, offset)
    return float(np.sqrt(np.mean(error[after:samples] ** 2)))


def force_error(model: Model, columns: Columns, band_hz: float,
                convention: Convention = Convention()) -> float:
    """Relative RMS (%) of the force by inverse dynamics against the force applied.

    Both are low-passed alike, without lag; velocity and acceleration are central differences of
    the low-passed position (Janot, Gautier and Brunot 2019; Gautier 1997). A held input acts half
    a sample late, so at a sample it is the mean of this one and the one before.

    Raises
    ------
    ValueError
        If the model has a force with a memory, which inverse dynamics cannot tell.
    """
    period = model.sample_period
    weights = butter(4, 2.0 * band_hz * period)
    position = filtfilt(*weights, output_of(columns)[1])
    velocity = np.gradient(position, period)
    acceleration = np.gradient(velocity, period)
    base = defaultdict(float, model.effective_base())
    needed = (base["mass"] * acceleration + base["damping"] * velocity
              + base["stiffness"] * position - base["constant_force"]
              + base["dry_friction"] * np.sign(velocity))
    samples = input_of(columns)
    acted = samples if convention.hold != HELD else (samples + np.roll(samples, 1)) / 2.0
    applied = base["force_constant"] * acted
    for use in model.effects:
        effect = use.effect
        if effect.bristle_force is not None:
            raise ValueError(f"{use.name} has a memory")
        if effect.force is not None:
            values = tuple(use.parameters.values())
            needed -= np.array([effect.force(x, v, f, values) for x, v, f in zip(
                position.tolist(), velocity.tolist(), applied.tolist(), strict=True)])
    edge = int(EDGE_SHARE * position.size)
    kept = slice(edge, position.size - edge)
    error = filtfilt(*weights, applied - needed)[kept]
    return float(100.0 * np.linalg.norm(error) / np.linalg.norm(filtfilt(*weights, applied)[kept]))


def parameter_of(answer: Mapping[str, Any], address: str) -> Mapping[str, Any] | None:
    """A parameter as diagnosis.json tells it (`mass`, `cubic_stiffness.k3`), or None."""
    effect, _, name = address.rpartition(".")
    told: list[Mapping[str, Any]] = [
        each["parameters"] for each in answer.get("effects", ()) if each["name"] == effect
    ] if effect else [answer.get("base", {})]
    return told[0].get(name) if told else None
