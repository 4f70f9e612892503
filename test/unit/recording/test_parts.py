"""Parts of records, and records at another period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dfm_stage.recording import (
    AxisRecord,
    Provenance,
    Record,
    RecordError,
    at_period,
    filled,
    part,
    shared_period,
    split,
    without_gaps,
)


def record(count: int = 2000, period: float = 1e-3, hold: str | None = None) -> Record:
    """Sines, from 2 s on."""
    time = 2.0 + period * np.arange(count)
    drive = np.sin(20.0 * (time - 2.0))
    axis = AxisRecord(drive, np.cos(30.0 * (time - 2.0)), current=0.5 * drive, input_hold=hold,
                      extra={"excitation": 2.0 * drive}, velocity=-np.sin(30.0 * (time - 2.0)))
    return Record(time, period, {"x": axis}, Provenance("run.csv", "csv"))


def test_a_part_says_what_it_is() -> None:
    cut = part(record(), 100, 5000, "--from 0.1 --to 5")
    assert (len(cut), cut.time[0]) == (1900, pytest.approx(2.1))
    assert cut.warnings == [("--from 0.1 --to 5: samples 100 to 1999 of 2000 were used "
                            "(the record ends before)")]
    for first, last in ((2000, 3000), (5, 7), (-3, 100)):
        with pytest.raises(RecordError, match=r"run\.csv: --rows leaves"):
            part(record(), first, last, "--rows")


def test_a_split_uses_every_sample_once() -> None:
    first, rest = split(record(), 0.75)
    assert (len(first), len(rest)) == (1500, 500)
    assert np.concatenate((first.time, rest.time)).tolist() == record().time.tolist()
    for share in (0.0, 1.0, -1.0, float("nan"), 1.5, 0.9999):
        with pytest.raises(RecordError):
            split(record(), share)


def test_the_longest_stretch_without_a_gap() -> None:
    given = record()
    axis = given.axis()
    assert without_gaps(given) is given
    position, drive = axis.position.copy(), axis.input.copy()
    position[500], drive[600] = np.nan, np.nan
    found = without_gaps(replace(given, axes={"x": replace(axis, position=position, input=drive)}))
    assert (len(found), found.time[0]) == (1399, given.time[601])
    with pytest.raises(RecordError, match="no stretch"):
        without_gaps(replace(given, axes={"x": replace(axis, position=position * np.nan)}))


@pytest.mark.parametrize("hold", [None, "band_limited"])
def test_short_gaps_are_filled_in_with_the_stated_error(hold: str | None) -> None:
    given = record(hold=hold)
    axis = given.axis()
    lost = [100, 300, 301, 700, 1500, *range(1000, 1003)]
    cut = {name: array.copy() for name, array in axis.arrays().items() if name != "excitation"}
    for array in cut.values():
        array[lost] = np.nan
    found = filled(replace(given, axes={"x": replace(axis, **cut)}))
    after = found.axis()
    assert np.flatnonzero(np.isnan(after.position)).tolist() == [1000, 1001, 1002]
    error = np.nan_to_num(after.position - axis.position)
    assert np.abs(error).max() < 1e-6
    assert np.abs(np.nan_to_num(after.input - axis.input))[:1000].max() == pytest.approx(
        0.04 if hold is None else 0.0, abs=0.02 if hold is None else 1e-6)
    assert "5 samples in gaps of up to 2 were filled in" in found.warnings[-1]
    assert filled(given).warnings == []
    assert len(without_gaps(found)) == 1000


@pytest.mark.parametrize("hold", [None, "band_limited"])
@pytest.mark.parametrize("period", [0.97e-3, 1.03e-3, 1.0002e-3])
def test_a_near_period_is_bridged_with_the_stated_error(hold: str | None, period: float) -> None:
    given = record(hold=hold)
    found = at_period(given, period)
    axis, t = found.axis(), found.time - 2.0
    assert found.sample_period == period
    assert np.diff(found.time) == pytest.approx(period)
    assert given.time[-1] - period < found.time[-1] <= given.time[-1] + 1e-9
    assert axis.position == pytest.approx(np.cos(30.0 * t), abs=1e-6)
    assert axis.velocity == pytest.approx(-np.sin(30.0 * t), abs=1e-6)
    if hold is None:        # what stood acted on average half a sample late
        fine = t[:, None] + period * (np.arange(200) + 0.5) / 200
        held = given.axis().input[np.minimum((fine / 1e-3 + 1e-9).astype(int), 1999)].mean(axis=1)
        assert axis.input == pytest.approx(held, abs=2e-4)
    else:
        assert axis.input == pytest.approx(np.sin(20.0 * t), abs=1e-6)
    assert axis.current is not None
    assert axis.current == pytest.approx(0.5 * np.sin(20.0 * t), abs=1e-6)
    assert axis.extra["excitation"] == pytest.approx(2.0 * axis.input)
    assert "estimated error" in found.warnings[-1]
    assert axis.input_hold == hold


def test_clocks_may_differ_a_little() -> None:
    given = record(period=1.00002e-3)
    found = at_period(given, 1e-3)
    assert found.axis() is given.axis()
    assert (found.sample_period, found.time[-1]) == (1e-3, pytest.approx(2.0 + 1.999))
    assert "off by 20 ppm" in found.warnings[-1]
    assert at_period(given, 1.00002e-3) is given


@pytest.mark.parametrize(("periods", "wanted", "found"), [
    ((1.02e-3, 1.02005e-3), 1e-3, 1.02e-3),     # their own
    ((1.02e-3, 1.03e-3), 1e-3, 1e-3),           # they share none
    ((1.00005e-3, 1.00005e-3), 1e-3, 1e-3),     # the wanted one, by another clock
    ((2e-3, 2e-3), 1e-3, 1e-3)])                # none that is near
def test_records_of_one_period_are_fitted_at_it(
        periods: tuple[float, ...], wanted: float, found: float) -> None:
    assert shared_period([record(period=each) for each in periods], wanted) == found


def test_another_period_is_refused_with_the_way_out() -> None:
    for period in (2e-3, 0.9e-3, 1.06e-3):
        with pytest.raises(RecordError, match=r"run\.csv: .*set sample_period: 0\.001 in the"):
            at_period(record(), period)
