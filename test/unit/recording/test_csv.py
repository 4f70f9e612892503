"""CSV files to records and back, and what is said about those that are not as they should be."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from dfm_stage.recording import (
    AxisRecord,
    BagWriteError,
    Provenance,
    Record,
    RecordError,
    RecordingError,
    read_record,
    write_csv,
)

SETTINGS = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
PERIODS = st.sampled_from([1e-3, 2e-4, 1 / 2048, 1 / 3000, 0.05])
VALUES = st.floats(-1e-2, 1e-2).map(lambda value: value + 0.0)


def table(rows: int = 50, period: float = 0.001, header: str = "time_s,input_v,position_m",
          digits: int = 9) -> list[str]:
    """Lines of a sound file: input alternates 0.5 and -0.5, position is a slow sine in 1e-4."""
    return [header] + [f"{k * period:.{digits}f},{0.5 * (-1)**k},{1e-4 * math.sin(k / 9):.12g}"
                       for k in range(rows)]


def save(folder: Path, lines: list[str], name: str = "run.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@SETTINGS
@given(st.data())
def test_a_record_survives_the_file(tmp_path: Path, data: st.DataObject) -> None:
    count = data.draw(st.integers(4, 60))
    period = data.draw(PERIODS)
    start = data.draw(st.sampled_from([0.0, 5.25, -1.0]))
    units = data.draw(st.sampled_from([("V", "m"), ("A", "m"), ("V", "rad"), ("V", "deg")]))

    def array() -> np.ndarray:
        return np.array(data.draw(st.lists(VALUES, min_size=count, max_size=count)))

    axes = {name: AxisRecord(array(), array(), *units,
                             array() if data.draw(st.booleans()) else None,
                             array() if data.draw(st.booleans()) else None)
            for name in data.draw(st.sampled_from([("x",), ("x", "y"), ("left", "right")]))}
    record = Record(start + period * np.arange(count), period, axes, Provenance("", "csv"))
    path = tmp_path / "record.csv"
    write_csv(record, path)
    again = read_record(path)
    assert again.sample_period == pytest.approx(period, rel=1e-12)
    assert np.allclose(again.time, record.time, rtol=0, atol=1e-9 * period * count)
    assert list(again.axes) == list(axes)
    for name, axis in axes.items():
        back = again.axis(name)
        assert (back.input_unit, back.position_unit) == units
        for key, values in axis.arrays().items():
            assert (back.arrays()[key] == values).all()
        assert set(back.arrays()) == set(axis.arrays())
    assert all("constant" in text for text in again.warnings)


@pytest.mark.parametrize(("header", "scales"), [
    ("time_s,input_v,position_m", (1, 1, 1)),
    ("time_ms,input_mv,position_um", (1e3, 1e3, 1e6)),
    ("Time_us,Input_V,Position_nm", (1e6, 1, 1e9)),
    ("time [ms],input [V],position [µm]", (1e3, 1, 1e6)),
    ("time_ns,input_kv,position_mm", (1e9, 1e-3, 1e3)),
])
def test_units_become_si(tmp_path: Path, header: str, scales: tuple[float, ...]) -> None:
    k = np.arange(40)
    columns = [k * 1e-3, np.cos(k), 1e-4 * np.sin(k / 9)]
    lines = [header.lower()] + [",".join(repr(float(column[i] * scale)) for column, scale
                                         in zip(columns, scales, strict=True)) for i in k]
    record = read_record(save(tmp_path, lines))
    assert record.warnings == []
    assert record.sample_period == pytest.approx(1e-3, rel=1e-12)
    assert np.allclose(record.axis().input, columns[1], rtol=1e-14)
    assert np.allclose(record.axis().position, columns[2], rtol=1e-14)
    assert (record.axis().input_unit, record.axis().position_unit) == ("V", "m")


def test_other_names_and_units_by_option(tmp_path: Path) -> None:
    path = save(tmp_path, table(header="t,u,phi"))
    record = read_record(path, time="t", input="u", output="phi", time_unit="ms",
                         input_unit="mV", output_unit="rad", axis="motor")
    assert record.sample_period == pytest.approx(1e-6)
    assert (record.axis("motor").input == 0.5e-3 * (-1.0)**np.arange(50)).all()
    assert record.axis().position_unit == "rad"
    assert record.axis().position[9] == pytest.approx(1e-4 * math.sin(1.0), rel=1e-11)
    guessed = read_record(path, time="t", input="u", output="phi")
    assert len(guessed.warnings) == 3
    assert all("the unit of column" in text for text in guessed.warnings)
    rotary = read_record(save(tmp_path, table(header="time_s,input_v,position_mrad"), "b.csv"))
    assert rotary.axis().position_unit == "mrad"
    with pytest.raises(RecordError, match="'w' for the input; there are the columns t, u, phi"):
        read_record(path, time="t", input="w", output="phi")
    with pytest.raises(RecordError, match="both the input and the output"):
        read_record(path, time="t", input="u")
    with pytest.raises(RecordError, match=r"--time.*--input.*--output"):
        read_record(path, time="t")


def test_several_axes_by_prefix(tmp_path: Path) -> None:
    lines = ["time_s,x_input_v,x_position_um,y_input_v,y_position_um,y_current_ma,z_input_v,note"]
    lines += [f"{k * 1e-3:.3f},{k % 3},{k % 5},{k % 7},{k % 11},{k},0,text {k}" for k in range(30)]
    path = save(tmp_path, lines)
    record = read_record(path)
    assert list(record.axes) == ["x", "y"]
    assert np.allclose(record.axis("y").current, np.arange(30) * 1e-3)
    assert record.axis("x").current is None
    assert record.warnings == ["axis z was left out: it has no column with a position",
                               "columns not used: z_input_v, note"]
    assert list(read_record(path, axis="y").axes) == ["y"]
    with pytest.raises(RecordError, match="no axis q; choose one of x, y"):
        read_record(path, axis="q")


def test_the_ways_programs_write_csv(tmp_path: Path) -> None:
    plain = read_record(save(tmp_path, table()))
    lines = table()
    german = [lines[0].replace(",", ";")] + [line.replace(",", ";").replace(".", ",")
                                             for line in lines[1:]]
    quoted = ['"' + line.replace(",", '","') + '"' for line in lines]
    commented = ["# from the bench", "", "% 2024", *lines[:20], "", "# pause", *lines[20:]]
    for name, text in {"german": "\n".join(german), "tabs": "\n".join(lines).replace(",", "\t"),
                       "quoted": "\n".join(quoted), "commented": "\n".join(commented),
                       "bom": "\ufeff" + "\n".join(lines), "dos": "\r\n".join(lines) + "\r\n",
                       "spaces": "\n".join(lines).replace(",", " , ")}.items():
        path = tmp_path / f"{name}.csv"
        path.write_bytes(text.encode())
        record = read_record(path)
        assert record.warnings == [], name
        assert (record.axis().position == plain.axis().position).all(), name
        assert (record.axis().input == plain.axis().input).all(), name
        assert record.sample_period == plain.sample_period == 0.001, name


def said(path: Path) -> str:
    """The error of reading a file."""
    with pytest.raises(RecordError) as caught:
        read_record(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


def test_defects_are_named_with_their_line(tmp_path: Path) -> None:
    def broken(row: int, new: str | None) -> Path:
        lines = table()
        lines[row:row + 1] = [] if new is None else [new]
        return save(tmp_path, lines)

    assert "line 18, column input_v: 'oops' is not a number" in said(broken(17, "0.016,oops,0"))
    assert "line 18 has 2 cells and the header 3" in said(broken(17, "0.016,0.5"))
    assert "line 18: time goes back from 0.015 to 0.002 s" in said(broken(17, "0.002,0.5,0"))
    for cell in ("", "nan", "NaN", "inf"):
        record = read_record(broken(17, f"0.016,0.5,{cell}"))
        assert record.warnings[0] == ("line 18: position_m is empty or not finite; those samples "
                                      "count as missing")
        assert record.warnings[1:] == [
            "1 samples are missing before line 19 (0.002 s at 0.015 s)",
            "the longest stretch without a gap was kept: 33 of 49 samples, line 19 to line 51"]
        assert len(record) == 33
        assert record.time[0] == pytest.approx(0.017)
    record = read_record(broken(17, None))
    assert record.warnings[0] == "1 samples are missing before line 18 (0.002 s at 0.015 s)"
    masked = read_record(broken(17, None), gaps="mask")
    assert np.flatnonzero(np.isnan(masked.axis().position)).tolist() == [16]
    assert len(masked) == 50
    record = read_record(broken(17, "0.016,0.5,0\n0.016,0.7,0"))
    assert record.warnings == ["line 19: repeats the time 0.016 s; repeated rows were left out"]
    assert len(record) == 50
    record = read_record(broken(50, "0.0"))
    assert record.warnings == ["line 51, the last one, was cut off and left out"]
    assert len(record) == 49


def test_a_number_cut_off_at_the_end_is_not_believed(tmp_path: Path) -> None:
    lines = [f"{k * 1e-3:.4f},{k % 2},{1e-5 * (k + 1):.8e}" for k in range(50)]
    text = "\n".join(["time_s,input_v,position_m", *lines])
    for cut, left in ((0, 50), (4, 49), (1, 49), (14, 49)):
        path = tmp_path / "cut.csv"
        path.write_text(text[:len(text) - cut])
        record = read_record(path)
        assert len(record) == left
        assert (left == 50) == ("line 51, the last one, was cut off and left out"
                                not in record.warnings)


def test_a_spike_is_pointed_at(tmp_path: Path) -> None:
    time = np.arange(400) * 1e-3
    position = 1e-5 * np.sin(20.0 * time) + 1e-8 * np.random.default_rng(0).normal(size=400)
    for height, told in ((0.0, False), (5.0, True), (1e-4, True)):
        position[123] += height
        lines = [f"{t!r},{k % 2},{x!r}" for k, (t, x) in enumerate(
            zip(time.tolist(), position.tolist(), strict=True))]
        found = read_record(save(tmp_path, ["time_s,input_v,position_m", *lines])).warnings
        assert any("at sample 123" in text for text in found) == told
        position[123] -= height


def test_files_that_hold_no_record(tmp_path: Path) -> None:
    numbers = table()[1:]
    assert "the first line must name the columns" in said(save(tmp_path, numbers))
    assert "is empty" in said(save(tmp_path, [""]))
    assert "one column only" in said(save(tmp_path, ["time_s", "1"]))
    assert "has a header and no rows" in said(save(tmp_path, table()[:1]))
    assert "only 2 usable rows" in said(save(tmp_path, table()[:3]))
    assert "names the column a twice" in said(save(tmp_path, ["a,a", "1,2"]))
    assert "no time column among" in said(save(tmp_path, table(header="a,input_v,position_m")))
    assert "no input and position columns" in said(save(tmp_path, table(header="time_s,a,b")))
    assert "two columns for input" in said(save(tmp_path, table(
        header="time_s,input_v,input_mv").copy()))
    assert "is not a text file" in said((tmp_path / "z.csv").write_bytes(b"a\0b") and
                                        tmp_path / "z.csv")
    assert "cannot be read" in said(tmp_path / "none.csv")
    assert "time stands still" in said(save(tmp_path, table(period=1e-4, digits=3)))
    rng = np.random.default_rng(2)
    ragged = [f"{t:.6f},1,2" for t in np.cumsum(rng.exponential(1e-3, 60))]
    assert "there is no sample period" in said(save(tmp_path, [table()[0], *ragged]))
    with pytest.raises(RecordError, match="choose one of longest, mask"):
        read_record(save(tmp_path, table()), gaps="guess")


def test_a_sample_period_takes_the_place_of_time(tmp_path: Path) -> None:
    path = save(tmp_path, table(period=1e-4, digits=3))
    record = read_record(path, sample_period=1e-4)
    assert len(record) == 50
    assert record.sample_period == 1e-4
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(RecordError, match="sample period"):
            read_record(path, sample_period=wrong)


@pytest.mark.parametrize(("scale", "header", "words"), [
    ((1e3, 1, 1), "time_s,input_v,position_m", "name the column time_ms"),
    ((1e6, 1, 1), "time_s,input_v,position_m", "name the column time_us"),
    ((1e-3, 1, 1), "time_s,input_v,position_m", "name the column time_s"),
    ((1, 1, 1e7), "time_s,input_v,position_m", "name it position_um"),
    ((1, 1, 1e4), "time_s,input_v,position_m", "name it position_mm"),
    ((1, 1e4, 1), "time_s,input_v,position_m", "name it input_mv"),
    ((1, 0, 1), "time_s,input_v,position_m", "input is constant (0 V)"),
    ((1, 1, 0), "time_s,input_v,position_m", "position is constant (0 m)"),
])
def test_what_looks_wrong_is_said(tmp_path: Path, scale: tuple[float, float, float], header: str,
                                  words: str) -> None:
    k = np.arange(60)
    columns = (k * 1e-3 * scale[0], 0.5 * np.cos(k) * scale[1], 1e-4 * np.sin(k / 7) * scale[2])
    lines = [header] + [",".join(f"{column[i]:.12g}" for column in columns) for i in k]
    warnings = read_record(save(tmp_path, lines)).warnings
    assert len(warnings) == 1
    assert words in warnings[0]


def test_rounded_time_is_even_time(tmp_path: Path) -> None:
    record = read_record(save(tmp_path, table(rows=400, period=1 / 2048, digits=6)))
    assert record.warnings == []
    assert record.sample_period == pytest.approx(1 / 2048, rel=1e-6)
    coarse = read_record(save(tmp_path, table(rows=400, period=1 / 2048, digits=5)))
    assert len(coarse.warnings) == 1
    assert "time is rounded to 1e-05 s" in coarse.warnings[0]
    plain = [float(line.split(",")[2]) for line in table(rows=400, period=1 / 2048)[1:]]
    assert (coarse.axis().position == plain).all()


TEXT = st.one_of(
    st.text(max_size=200),
    st.lists(st.lists(st.one_of(st.floats().map(repr), st.sampled_from(["", "a", "1,5", '"'])),
                      min_size=2, max_size=4).map(",".join), max_size=12).map(
        lambda rows: "\n".join(["time_s,input_v,position_m", *rows])))


@SETTINGS
@given(TEXT)
@example("time_s,input_v,position_m\n0,1,2\n1,2,3\n2,3,4")
@example('time_s,input_v,position_m\n"0,1,2\n1,2,3')
@example("time_s,input_v,position_m\n1e308,1,1\n-1e308,1,1\n0,0,0")
@example("time_s,input_v,position_m\n0,1,1\n5e-324,1,1\n1e-323,0,0")
@example("time_s,input_v,position_m\n0,1e308,1\n1,-1e308,1\n2,0,0\n3,1e308,-1e308")
def test_no_text_breaks_the_reader(tmp_path: Path, text: str) -> None:
    path = tmp_path / "any.csv"
    path.write_text(text, encoding="utf-8", errors="replace")
    try:
        record = read_record(path)
    except RecordingError as error:
        if "\n" in str(error):
            raise
    else:
        assert len(record) >= 3
        assert all("\n" not in warning for warning in record.warnings)


@SETTINGS
@given(st.binary(max_size=300), st.sampled_from(["a.csv", "a.npz", "a.mat", "a.mcap", "a.dat"]))
def test_no_bytes_break_the_reader(tmp_path: Path, data: bytes, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(RecordingError) as caught:
        read_record(path)
    assert "\n" not in str(caught.value)


def test_writing_is_all_or_nothing(tmp_path: Path) -> None:
    record = read_record(save(tmp_path, table()))
    (tmp_path / "folder.csv").mkdir()
    for place in (tmp_path / "folder.csv", tmp_path / "none" / "x.csv"):
        with pytest.raises(BagWriteError) as caught:
            write_csv(record, place)
        assert str(place) in str(caught.value)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.csv", "run.csv"]


@pytest.mark.parametrize(("header", "given", "axes"), [
    ("time_s,position_m", {}, {"x"}), ("time_s,position_m", {"output": "position_m"}, {"x"}),
    ("time_s,x_position_m,y_position_m", {}, {"x", "y"}),
    ("time_s,input_a,position_m", {}, {"x"}), ("time_s,input_v", {"output": "input_v"}, {"x"}),
    ("time_s,reading", {"output": "reading", "output_unit": "um"}, {"x"})])
def test_where_nothing_drove_the_stage_the_input_is_zero(tmp_path, header, given, axes):
    rows = [f"{1e-3 * k:.3f}," + ",".join(["1.5"] * header.count(",")) for k in range(20)]
    found = read_record(save(tmp_path, [header, *rows]), input="none", **given)
    assert set(found.axes) == axes
    for axis in found.axes.values():
        assert np.array_equal(axis.input, np.zeros(20))
        assert axis.position[0] == pytest.approx(1.5e-6 if given.get("output_unit") else 1.5)


def test_a_column_called_none_is_a_column(tmp_path):
    rows = [f"{1e-3 * k:.3f},{k},1.5" for k in range(20)]
    path = save(tmp_path, ["time_s,none,position_m", *rows])
    found = read_record(path, input="none", output="position_m", input_unit="V")
    assert np.array_equal(found.axes["x"].input, np.arange(20.0))


def test_a_table_without_an_input_says_how_to_read_it(tmp_path):
    path = save(tmp_path, ["time_s,position_m", "0.0,1.0", "0.1,1.0", "0.2,1.0"])
    with pytest.raises(RecordError, match="--input none"):
        read_record(path)
