"""Columns of measured files: velocities, forces, numbers of samples, conventions of the input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from dfm_stage.recording import AxisRecord, Provenance, Record, RecordError, read_record, write_csv

ROWS = 60


def save(folder: Path, header: str, rows: Sequence[Sequence[float]]) -> Path:
    path = folder / "run.csv"
    path.write_text("\n".join([header, *(",".join(f"{cell!r}" for cell in row)
                                         for row in rows)]) + "\n")
    return path


def swing(k: float) -> float:
    return math.sin(0.1 * k)


def plain(folder: Path, header: str, *columns: float) -> Path:
    """A file of a millisecond a row: the time, the input k and `column` times a sine for each."""
    return save(folder, header, [[1e-3 * k, float(k), *(c * swing(k) for c in columns)]
                                 for k in range(ROWS)])


@pytest.mark.parametrize(("column", "unit", "factor"), [
    ("velocity_m_s", "m", 1.0), ("velocity_mm_s", "m", 1e-3), ("velocity_rad_s", "rad", 1.0),
    ("velocity_deg_s", "deg", 1.0), ("velocity [mm/s]", "m", 1e-3), ("x_velocity_um_s", "m", 1e-6),
])
def test_a_velocity_without_a_position_is_the_output(
        tmp_path: Path, column: str, unit: str, factor: float) -> None:
    axis = read_record(plain(tmp_path, f"time_s,x_input_v,{column}", 2.0)).axis()
    assert (axis.measures, axis.position_unit) == ("velocity", unit)
    assert axis.output_unit == f"{unit}/s"
    assert axis.velocity is None
    assert axis.position == pytest.approx([2.0 * factor * swing(k) for k in range(ROWS)])


def test_an_acceleration_is_the_output_where_there_is_nothing_else(tmp_path: Path) -> None:
    axis = read_record(plain(tmp_path, "time_s,input_v,acceleration_mm_s2", 2.0)).axis()
    assert (axis.measures, axis.position_unit) == ("acceleration", "m")
    assert np.ptp(axis.position) == pytest.approx(4e-3, rel=0.01)


def test_a_velocity_stands_beside_the_position(tmp_path: Path) -> None:
    record = read_record(plain(tmp_path, "time_s,input_v,position_um,velocity_mm_s", 5.0, 7.0))
    axis = record.axis()
    assert (axis.measures, axis.position_unit) == ("position", "m")
    assert axis.velocity == pytest.approx([7e-3 * swing(k) for k in range(ROWS)])
    assert axis.slice(slice(10, 20)).velocity == pytest.approx(axis.velocity[10:20])
    other = read_record(plain(tmp_path, "time_s,input_v,position_m,velocity_rad_s", 5.0, 7.0))
    assert other.axis().velocity is None
    assert any("velocity_rad_s was not used" in text for text in other.warnings)


def test_a_velocity_may_be_named_as_the_output(tmp_path: Path) -> None:
    path = plain(tmp_path, "time_s,input_v,position_m,velocity_mm_s", 5.0, 7.0)
    axis = read_record(path, input="input_v", output="velocity_mm_s").axis()
    assert (axis.measures, axis.position_unit) == ("velocity", "m")
    assert np.ptp(axis.position) == pytest.approx(14e-3, rel=0.01)
    path = plain(tmp_path, "t,u,w", 5.0)
    axis = read_record(path, time="t", input="u", output="w", output_unit="deg/s").axis()
    assert (axis.measures, axis.position_unit) == ("velocity", "deg")


@pytest.mark.parametrize("measures", ["position", "velocity", "acceleration"])
def test_what_was_measured_survives_the_file(tmp_path: Path, measures: str) -> None:
    beside = np.arange(9.0) if measures == "position" else None
    axis = AxisRecord(np.ones(9), np.arange(9.0)**2, "N m", "rad", velocity=beside,
                      measures=measures)  # type: ignore[arg-type]
    write_csv(Record(1e-3 * np.arange(9), 1e-3, {"x": axis}, Provenance("", "csv")),
              tmp_path / "a.csv")
    again = read_record(tmp_path / "a.csv").axis()
    assert (again.input_unit, again.output_unit) == ("N m", axis.output_unit)
    assert again.position.tolist() == axis.position.tolist()
    assert beside is None or (again.velocity is not None
                              and again.velocity.tolist() == beside.tolist())


@pytest.mark.parametrize(("column", "unit", "factor"), [
    ("input_N", "N", 1.0), ("input_n", "N", 1.0), ("input_mN", "N", 1e-3),
    ("input_Nm", "N m", 1.0), ("input_nm", "N m", 1.0), ("input_NM", "N m", 1.0),
    ("input_V", "V", 1.0), ("input_mv", "V", 1e-3), ("input_A", "A", 1.0), ("input_ma", "A", 1e-3),
    ("x_input_n", "N", 1.0), ("input [N m]", "N m", 1.0)])
def test_the_case_of_an_input_s_unit_does_not_matter(
        tmp_path: Path, column: str, unit: str, factor: float) -> None:
    prefix = "x_" if column.startswith("x_") else ""
    axis = read_record(plain(tmp_path, f"time_s,{column},{prefix}position_nm", 3.0)).axis()
    assert axis.input_unit == unit
    assert axis.input == pytest.approx(factor * np.arange(ROWS))
    assert np.ptp(axis.position) == pytest.approx(6e-9, rel=0.01)
    assert read_record(plain(tmp_path, "time_s,u,y", 3.0), input="u", output="y",
                       input_unit="N m" if "[" in column else column.rpartition("_")[2]
                       ).axis().input_unit == unit


LOST, TWICE = {20, 21, 40}, {30}


def numbered(folder: Path, header: str, *, regenerated: bool, first: int = 7,
             modulo: int = 1 << 40) -> Path:
    """Rows of sample k: time, number, input, position; some lost, one written twice."""
    samples = sorted([k for k in range(ROWS) if k not in LOST] + [*TWICE])
    return save(folder, header, [
        [1e-3 * (row if regenerated else k), (k + first) % modulo, float(k), swing(k)]
        for row, k in enumerate(samples)])


@pytest.mark.parametrize("regenerated", [True, False])
@pytest.mark.parametrize("modulo", [1 << 40, 256])
def test_what_the_logger_dropped_is_seen_by_the_numbers(
        tmp_path: Path, regenerated: bool, modulo: int) -> None:
    path = numbered(tmp_path, "time_s,seq,input_v,position_m", regenerated=regenerated,
                    first=240, modulo=modulo)
    record = read_record(path, gaps="mask")
    axis = record.axis()
    assert len(record) == ROWS
    assert record.sample_period == pytest.approx(1e-3)
    assert set(np.flatnonzero(np.isnan(axis.position))) == LOST
    known = np.isfinite(axis.position)
    assert axis.position[known] == pytest.approx([swing(k) for k in np.flatnonzero(known)])
    assert any("3 samples are missing" in text for text in record.warnings), record.warnings
    assert any("comes twice" in text for text in record.warnings), record.warnings
    longest = read_record(path)
    assert longest.axis().input.tolist() == list(range(20))
    assert any("the longest stretch" in text for text in longest.warnings)


def test_without_times_the_numbers_count(tmp_path: Path) -> None:
    path = numbered(tmp_path, "other,Sequence,input_v,position_m", regenerated=True)
    record = read_record(path, sample_period=1e-3, gaps="mask")
    assert set(np.flatnonzero(np.isnan(record.axis().position))) == LOST


@pytest.mark.parametrize("column", [
    [0.0] * ROWS, list(range(ROWS, 0, -1)), [10.0 * k for k in range(ROWS)],
    [k + 0.5 for k in range(ROWS)]])
def test_a_column_that_does_not_count_changes_nothing(
        tmp_path: Path, column: list[float]) -> None:
    rows = [[1e-3 * k, column[k], float(k), swing(k)] for k in range(ROWS)]
    record = read_record(save(tmp_path, "time_s,sample,input_v,position_m", rows))
    assert record.axis().input.tolist() == list(range(ROWS))


def test_an_input_that_does_not_stand_is_interpolated(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    times = 1e-3 * (np.arange(400) + 0.2 * rng.uniform(-1, 1, 400))
    path = save(tmp_path, "time_s,input_v,position_m",
                [[t, math.sin(200 * t), math.sin(90 * t)] for t in times.tolist()])
    errors = {}
    for hold in (None, "zero", "first", "band_limited"):
        record = read_record(path, input_hold=hold, input_shift=0.5)
        axis = record.axis()
        assert (axis.input_hold, axis.input_shift) == (hold, 0.5)
        errors[hold] = np.abs(axis.input - np.sin(200 * record.time))[5:-5].max()
    assert errors[None] == errors["zero"] > 0.03    # what stands is averaged
    assert errors["first"] == errors["band_limited"] < 1e-3


def test_time_in_a_unit_of_speed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="no unit of time"):
        read_record(plain(tmp_path, "t_m_s,u,y", 1.0), time="t_m_s", input="u", output="y")


@pytest.mark.parametrize("header", [
    "Time [s],Input [V],Position [um]", "Time_s,Input_V,Position_um", "TIME_S,INPUT_V,POSITION_UM",
])
def test_capitals_in_a_header_do_not_matter(tmp_path: Path, header: str) -> None:
    record = read_record(plain(tmp_path, header, 5.0))
    axis = record.axis("x")
    assert axis.position == pytest.approx([5e-6 * swing(k) for k in range(ROWS)])
    assert (axis.input_unit, record.sample_period) == ("V", pytest.approx(1e-3))


def test_an_axis_keeps_its_capital(tmp_path: Path) -> None:
    assert list(read_record(plain(tmp_path, "Time_s,B_Input_v,B_Position_um", 5.0)).axes) == ["B"]
