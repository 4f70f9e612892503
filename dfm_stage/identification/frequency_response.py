"""Frequency response from periodic multisine records, with its uncertainty and distortions.

Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., sec. 2.4 and
4.3: with periodic excitation the mean over periods of output and input lines gives G without bias
even where the input is fed back, and what differs from period to period is noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dfm_stage.arrays import Array, Complex, Lines
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.local_polynomial import local_polynomial
from dfm_stage.identification.periods import (
    FEWEST_PERIODS,
    Periodicity,
    excited_lines,
    find_period,
    local_mean,
    settled_from,
    without_transient,
)

if TYPE_CHECKING:
    import control


ABOVE_NOISE = 2.0
"""Times the noise from which the level of lines that were not excited is distortion."""
NEIGHBOURS, FEWEST_LINES = 3, 14
"""Lines on either side over which the noise is averaged, and lines from which that is done."""


@dataclass(frozen=True)
class Distortion:
    """Levels at lines that were not excited, RMS over lines, in the unit of the output.

    `odd` and `even` include the noise; `noise` is what noise alone gives there. None where there
    are no such lines. `excited` is the level at the excited lines.
    """

    excited: float
    noise: float
    odd: float | None
    even: float | None

    def decibel(self, kind: str) -> float | None:
        """Return the level of `odd` or `even` over the excited lines, noise power removed."""
        level = self._level(kind)
        if level is None or self.excited <= 0.0:
            return None
        power = max(level**2 - self.noise**2, 0.0)
        return 10.0 * math.log10(power / self.excited**2) if power > 0.0 else -math.inf

    def significant(self, kind: str) -> bool:
        """Whether the level stands clearly (`ABOVE_NOISE` times) above the noise."""
        level = self._level(kind)
        return level is not None and level > ABOVE_NOISE * self.noise

    def _level(self, kind: str) -> float | None:
        return {"odd": self.odd, "even": self.even}[kind]


@dataclass(frozen=True)
class FrequencyResponse:
    """Measured response of sampled output to held input.

    Attributes
    ----------
    omega : (F,) rad/s
    response : (F,) complex, output unit per input unit
    variance : (F,) E|error|^2 of `response`; infinite where it could not be measured
    dof : degrees of freedom of `variance`
    lines : (F,) multiples of the base frequency, empty for a record that is not periodic
    periods_used, periods_total : how many went in and how many there were
    distortion : levels at lines that were not excited, None without such lines
    """

    omega: Array
    response: Complex
    variance: Array
    dof: float
    sample_period: float
    lines: Lines
    periods_used: int
    periods_total: int
    input_unit: str
    output_unit: str
    method: str
    distortion: Distortion | None = None
    warnings: tuple[str, ...] = field(default=())
    measured_unit: str = ""

    @property
    def distortion_unit(self) -> str:
        """Unit of the levels in `distortion`: that of the signal that was measured."""
        return self.measured_unit or self.output_unit

    def integrated(self, times: int, output_unit: str) -> FrequencyResponse:
        """The response of the position, in `output_unit`, from that of its derivative of order
        `times`. It is good for what is slow beside the sampling. An acceleration is sampled before
        a held input steps. Where no lag stands between them, it is late by half a sample more."""
        if times == 0:
            return self
        return replace(self, response=self.response / (1j * self.omega) ** times,
                       variance=self.variance / self.omega ** (2 * times),
                       output_unit=output_unit, measured_unit=self.output_unit)

    @property
    def frequency_hz(self) -> Array:
        """Frequencies (F,) in Hz."""
        return self.omega / (2.0 * math.pi)

    @property
    def unit(self) -> str:
        """Unit of `response`."""
        return f"{self.output_unit}/{self.input_unit}"

    @property
    def period(self) -> int | None:
        """Period of the excitation in samples, None where it does not repeat."""
        if self.method != "periods" or not self.lines.size:
            return None
        base = self.omega[0] / self.lines[0]
        return round(2.0 * math.pi / float(base * self.sample_period))

    def to_dict(self) -> dict[str, Any]:
        """As identify.json keeps it; a variance that could not be measured has no std."""
        return {
            "method": self.method, "unit": self.unit, "periods_used": self.periods_used,
            "periods_total": self.periods_total, "frequency_hz": self.frequency_hz.tolist(),
            "real": self.response.real.tolist(), "imag": self.response.imag.tolist(),
            "std": [math.sqrt(v) if math.isfinite(v) else None for v in self.variance],
            "lines": self.lines.tolist(),
            "distortion": None if self.distortion is None else {
                **vars(self.distortion), "unit": self.distortion_unit}}

    def to_control(self) -> control.FrequencyResponseData:
        """Return the response as `control.FRD`."""
        import control

        return control.FRD(self.response, self.omega)

    @classmethod
    def from_control(cls, given: control.FrequencyResponseData, sample_period: float, *,
                     relative_std: float = 0.01, input_unit: str = "V",
                     output_unit: str = "m") -> FrequencyResponse:
        """Return a `control.FRD`, from held input to sampled output, for `fit_transfer_function`.

        It says nothing of its noise: every point counts as good to `relative_std` of its size.

        Raises
        ------
        IdentificationError
            If it has several inputs or outputs.
        """
        response = np.asarray(given.frdata, dtype=complex)
        if response.shape[:2] != (1, 1):
            raise IdentificationError(f"a response of {response.shape[0]} outputs to "
                                      f"{response.shape[1]} inputs: pass one of them")
        order = np.argsort(given.omega)
        values = response[0, 0][order]
        return cls(np.asarray(given.omega, dtype=float)[order], values,
                   (relative_std * np.abs(values))**2, float(2 * values.size), sample_period,
                   np.empty(0, dtype=np.int64), 0, 0, input_unit, output_unit, "control.FRD")


def frequency_response(input_: Array, output: Array, sample_period: float, *,
                       reference: Array | None = None, period: int | None = None,
                       lines: Lines | None = None, drop: int | None = None,
                       poles: Sequence[complex] = (), input_unit: str = "V",
                       output_unit: str = "m") -> FrequencyResponse:
    """Measure the response from `input_` to `output` (both (N,)).

    The period is looked for in `reference` (the exciting signal of a closed loop) and in the
    input unless `period` (samples) gives it; without one, a local polynomial estimate is made of
    the whole record. Leading periods in which a transient stands out are left out, or the first
    `drop`; the free motion of known `poles` (1/s) is fitted and removed first.

    Raises
    ------
    IdentificationError
        If lengths differ, the input does not move, or fewer than two whole periods are left.
    """
    u, y = np.asarray(input_, dtype=float), np.asarray(output, dtype=float)
    if u.shape != y.shape or u.ndim != 1:
        raise IdentificationError(f"input {u.shape} and output {y.shape} must be two arrays of "
                                  "one length")
    if not (np.all(np.isfinite(u)) and np.all(np.isfinite(y))):
        raise IdentificationError("input or output holds values that are not finite: cut or "
                                  "interpolate them first")
    if np.ptp(u) == 0.0:
        raise IdentificationError("the input never moves: excite the stage")
    exciting, found = _periodicity(u, reference, period)
    if found is None:
        return _aperiodic(u, y, sample_period, reference, input_unit, output_unit)
    if len(poles):
        y = without_transient(y, found, poles, sample_period)
    if lines is None:
        lines = _lines_of(exciting, found)
    return _periodic(u, y, sample_period, found, lines, drop, input_unit, output_unit)


def _periodicity(u: Array, reference: Array | None,
                 period: int | None) -> tuple[Array, Periodicity | None]:
    """Return the signal that repeats and how; the input without one."""
    if period is not None:
        if not FEWEST_PERIODS <= period <= u.size // FEWEST_PERIODS:
            raise IdentificationError(f"a period of {period} samples does not fit twice into "
                                      f"{u.size}: record at least two periods")
        count = u.size // period
        return u, Periodicity(period, u.size - count * period, count)
    for signal in (reference, u):
        if signal is not None and np.ptp(signal) > 0.0:
            found = find_period(np.asarray(signal, dtype=float))
            if found is not None:
                return signal, found
    return u, None


def _lines_of(exciting: Array, found: Periodicity) -> Lines:
    late = np.fft.rfft(found.fold(exciting)[found.count // 2:], axis=1) / found.period
    spread = late.std(axis=0, ddof=1) / math.sqrt(len(late)) if len(late) > 1 else None
    lines = excited_lines(np.abs(late.mean(axis=0)), spread)
    if not lines.size:
        raise IdentificationError("no line of the input stands out of its noise: excite more")
    return lines


def _periodic(u: Array, y: Array, sample_period: float, found: Periodicity,
              lines: Lines, drop: int | None, input_unit: str,
              output_unit: str) -> FrequencyResponse:
    size = found.period
    inputs = np.fft.rfft(found.fold(u), axis=1) / size
    outputs = np.fft.rfft(found.fold(y), axis=1) / size
    transient = settled_from(outputs[:, lines]) if drop is None else drop
    used = found.count - transient
    if used < FEWEST_PERIODS:
        raise IdentificationError(f"{used} of {found.count} periods are left after the transient:"
                                  " record more periods")
    latest = found.count - max(found.count // 2, FEWEST_PERIODS)
    warnings = () if drop is not None or not transient == latest > 0 else (
        ("the transient lasts into the later half of the record: the frequency response still "
         "holds part of it"),)
    inputs, outputs = inputs[transient:], outputs[transient:]
    mean_u, mean_y = inputs.mean(axis=0), outputs.mean(axis=0)
    response = mean_y[lines] / mean_u[lines]
    error = outputs[:, lines] - response * inputs[:, lines]
    scatter = np.sum(np.abs(error) ** 2, axis=0) / (used - 1)
    neighbours = NEIGHBOURS if lines.size >= FEWEST_LINES else 0
    noise = local_mean(scatter, neighbours)
    variance = noise / used / np.abs(mean_u[lines]) ** 2
    distortion = _distortion(lines, mean_u, mean_y, outputs, response)
    return FrequencyResponse(
        np.asarray(2.0 * math.pi * lines / (size * sample_period)), response, variance,
        2.0 * (used - 1) * (2 * neighbours + 1), sample_period, lines, used, found.count,
        input_unit, output_unit, "periods", distortion, warnings)


def _distortion(lines: Lines, mean_u: Complex, mean_y: Complex, outputs: Complex,
                response: Complex) -> Distortion | None:
    """Compare lines inside the band that were not excited with the noise at the same lines.

    What reaches such a line through the linear path (a measured or fed-back input is not silent
    there) is removed with the response interpolated between excited lines.
    """
    band = np.arange(1, min(int(lines[-1]) + 1, mean_y.size))
    silent = np.setdiff1d(band[band >= lines[0]], lines)
    if not silent.size:
        return None
    used = outputs.shape[0]
    linear = np.interp(silent, lines, response.real) + 1j * np.interp(silent, lines,
                                                                      response.imag)
    rest = np.abs(mean_y[silent] - linear * mean_u[silent]) ** 2
    noise = np.sum(np.abs(outputs[:, silent] - mean_y[silent]) ** 2, axis=0) / (used - 1) / used
    odd, even = (float(np.sqrt(np.mean(part))) if part.size else None
                 for part in (rest[silent % 2 == 1], rest[silent % 2 == 0]))
    return Distortion(float(np.sqrt(np.mean(np.abs(mean_y[lines]) ** 2))),
                      float(np.sqrt(np.mean(noise))), odd, even)


def _aperiodic(u: Array, y: Array, sample_period: float, reference: Array | None,
               input_unit: str, output_unit: str) -> FrequencyResponse:
    found = local_polynomial(u, y, sample_period, reference=reference)
    return FrequencyResponse(
        found.omega, found.response, found.variance, found.dof, sample_period,
        np.empty(0, dtype=np.int64), 0, 0, input_unit, output_unit, "local polynomial", None,
        ("the record is not periodic: the response is a local polynomial estimate",))
