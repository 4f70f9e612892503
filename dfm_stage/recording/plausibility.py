"""Data that can be read and still look wrong, in the words of whoever measured them."""

from __future__ import annotations

import numpy as np

from dfm_stage.recording.record import FloatArray, Record

LONGEST_PERIOD_S = 0.1
SHORTEST_PERIOD_S = 2e-6
LARGEST_TRAVEL_M = 0.5
LARGEST_INPUT_V = 500.0
SPIKE = 30.0


def doubts(record: Record) -> list[str]:
    """Return a sentence for everything in the record that looks wrong."""
    found = []
    if record.sample_period > LONGEST_PERIOD_S:
        name, unit = ("micro", "us") if record.sample_period > 20 else ("milli", "ms")
        found.append(f"the sample period reads as {record.sample_period:.4g} s; if the time is in "
                     f"{name}seconds, name the column time_{unit} (or say --time-unit {unit})")
    if record.sample_period < SHORTEST_PERIOD_S:
        found.append(f"the sample period reads as {record.sample_period:.4g} s; if the time is in "
                     f"seconds, name the column time_s (or say --time-unit s)")
    for name, axis in record.axes.items():
        label = f"axis {name}: " if len(record.axes) > 1 else ""
        found += [label + text for text in _axis_doubts(axis.input, axis.input_unit,
                                                        axis.position, axis.position_unit)]
    return found


def _spikes(position: FloatArray, unit: str) -> list[str]:
    """Samples that lie far off both neighbours, which lie together."""
    if len(position) < 20:
        return []
    off = position[1:-1] - 0.5 * (position[:-2] + position[2:])
    apart = np.abs(position[2:] - position[:-2])
    usual = max(float(np.quantile(np.abs(off), 0.9)), float(np.quantile(apart, 0.9)))
    places = np.flatnonzero((np.abs(off) > SPIKE * usual) & (np.abs(off) > 5.0 * apart)) + 1
    if not len(places) or usual == 0.0:
        return []
    more = f" and {len(places) - 1} more" if len(places) > 1 else ""
    return [(f"the position jumps and comes back at sample {places[0]}{more} "
             f"({position[places[0]]:.4g} {unit}); empty cells would count as missing samples")]


def _axis_doubts(drive: FloatArray, drive_unit: str, position: FloatArray,
                 position_unit: str) -> list[str]:
    found = []
    drive, position = drive[np.isfinite(drive)], position[np.isfinite(position)]
    if not len(drive) or not len(position):
        return ["there is not one sample with both input and position"]
    if np.ptp(drive) == 0:
        found.append(f"the input is constant ({drive[0]:.4g} {drive_unit}); only what happens "
                     f"without excitation can be seen")
    if np.ptp(position) == 0:
        found.append(f"the position is constant ({position[0]:.6g} {position_unit}); is the "
                     f"encoder connected, and is this the right column?")
    found += _spikes(position, position_unit)
    travel = float(np.ptp(position))
    if position_unit == "m" and travel > LARGEST_TRAVEL_M:
        name, unit = ("micro", "um") if travel > 20 else ("milli", "mm")
        found.append(f"the position spans {travel:.4g} m; if the column is in {name}metres, name "
                     f"it position_{unit} (or say --output-unit {unit})")
    largest = float(np.abs(drive).max())
    if drive_unit == "V" and largest > LARGEST_INPUT_V:
        found.append(f"the input reaches {largest:.4g} V; if the column is in millivolts, name it "
                     f"input_mv (or say --input-unit mV)")
    return found
