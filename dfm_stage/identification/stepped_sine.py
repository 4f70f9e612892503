"""Frequency response from a stepped sine, the motion still dying away taken out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.free_motion import Window, ringing_poles
from dfm_stage.identification.frequency_response import FrequencyResponse

SHORTEST_WINDOW = 12
"""Samples at a frequency: sine, offset and two modes that ring have seven coefficients."""
NO_MOTION = 1e-12
"""Amplitude of the input below which it does not move: rounding."""
Segments = Sequence[tuple[float, int, int]]


def segments_in(parameters: Mapping[str, Any], axis: str) -> list[tuple[float, int, int]]:
    """Return (frequency in Hz, first, last + 1 sample) of a bag's stepped sine.

    `parameters` are those of the record's provenance; samples count from the start of the run.

    Raises
    ------
    IdentificationError
        If the bag holds no stepped sine of that axis.
    """
    for name, node in parameters.items():
        if name.endswith(f"/{axis}/trajectory_generator") and isinstance(node, Mapping):
            run = node.get("run") or {}
            found = (run.get("excitation") or {}).get("segments")
            if found:
                return [(float(f), int(settled), int(end)) for f, _, settled, end in found]
    raise IdentificationError(f"the bag says nothing of a stepped sine on axis {axis}: record the "
                              "experiment stepped_sine")


def stepped_sine_response(input_: Array, output: Array, sample_period: float, segments: Segments,
                          *, input_unit: str = "V", output_unit: str = "m",
                          modes: int = 2) -> FrequencyResponse:
    """Return the response from `input_` to `output` (both (N,)) at the segments' frequencies.

    Parameters
    ----------
    segments : sequence of (frequency in Hz, first sample, last sample + 1)
    modes : int
        How many modes of the stage at most still ring in the windows.

    Raises
    ------
    IdentificationError
        If there are no segments, one lies outside the record, or the input has no such sine.
    """
    u, y = np.asarray(input_, dtype=float), np.asarray(output, dtype=float)
    if not segments:
        raise IdentificationError("a stepped sine needs at least one frequency")
    windows, drive = [], []
    for f, first, end in sorted(segments):
        if not 0 <= first < end <= u.size or end - first < SHORTEST_WINDOW:
            raise IdentificationError(f"the window of {f:g} Hz, samples {first} to {end}, does "
                                      f"not lie inside the record of {u.size}")
        omega = 2.0 * math.pi * f
        time = np.asarray(np.arange(end - first) * sample_period)
        known = np.column_stack((np.cos(omega * time), -np.sin(omega * time),
                                 np.ones_like(time)))
        re, im, _ = np.linalg.lstsq(known, u[first:end], rcond=None)[0]
        if math.hypot(re, im) < NO_MOTION:
            raise IdentificationError(f"the input does not move at {f:g} Hz")
        windows.append(Window(time, y[first:end], known, omega))
        drive.append(complex(re, im))
    low, high = windows[0].omega, windows[-1].omega
    poles = ringing_poles(windows, 0.5 * low, max(high, 2.0 * low), modes)
    solved = [w.solve(poles) for w in windows]
    # Near the resonance the free motion resembles the sine; the covariance counts that.
    variance = np.array([s.covariance[0, 0] + s.covariance[1, 1] for s in solved])
    amplitude = np.array([complex(s.amplitude[0], s.amplitude[1]) for s in solved])
    driven = np.array(drive)
    return FrequencyResponse(
        np.array([w.omega for w in windows]), amplitude / driven,
        np.asarray(variance / np.abs(driven) ** 2), float(np.mean([s.dof for s in solved])),
        sample_period, np.empty(0, dtype=np.int64), 0, 0, input_unit, output_unit, "stepped sine")
