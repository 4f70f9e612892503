"""Records from NumPy and MATLAB files, and from measurements of others where they are at hand."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from dfm_stage.recording import RecordError, read_record

K = np.arange(100)
COLUMNS = {"time_s": K * 1e-3, "input_v": np.cos(K), "position_um": np.sin(K / 9)}


@pytest.fixture(params=["npz", "mat"])
def suffix(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def save(path: Path, arrays: dict[str, object]) -> Path:
    if path.suffix == ".npz":
        np.savez(path, **arrays)  # type: ignore[arg-type]
    else:
        scipy.io.savemat(path, arrays)
    return path


def test_named_like_columns(tmp_path: Path, suffix: str) -> None:
    record = read_record(save(tmp_path / f"a.{suffix}", COLUMNS))
    assert record.provenance.kind == suffix
    assert record.warnings == []
    assert np.allclose(record.axis().position, 1e-6 * np.sin(K / 9), rtol=1e-14)
    assert (record.axis().input == np.cos(K)).all()
    assert record.sample_period == 1e-3


def test_a_sample_rate_instead_of_time(tmp_path: Path, suffix: str) -> None:
    arrays = {"fs": 2500.0, "u": np.cos(K), "y": np.stack([K * 1e-6, K % 7 * 1e-6], axis=1)}
    path = save(tmp_path / f"a.{suffix}", arrays)
    record = read_record(path, input="u", output="y[1]", input_unit="V", output_unit="rad")
    assert record.sample_period == pytest.approx(4e-4)
    assert (record.axis().position == K % 7 * 1e-6).all()
    assert record.warnings == [
        "there is no time column; the sample period in the file, 0.0004 s, was used"]


def test_structures_and_dspace_captures(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mat", {"run": COLUMNS})
    record = read_record(path, time="run.time_s", input="run.input_v", output="run.position_um")
    assert (record.axis().input == np.cos(K)).all()
    signals = [{"Name": '"Model Root"/"Amp"/"Out1"', "Data": np.cos(K)},
               {"Name": '"Model Root"/"Encoder"/"x"', "Data": np.sin(K / 9)}]
    path = save(tmp_path / "d.mat", {"exp_001": {
        "X": {"Name": "", "Data": K * 1e-3}, "Y": np.array(signals, dtype=object)}})
    record = read_record(path, input="Out1", output="x", input_unit="V", output_unit="um")
    assert record.sample_period == 1e-3
    assert np.allclose(record.axis().position, 1e-6 * np.sin(K / 9), rtol=1e-14)


def test_files_that_do_not_fit(tmp_path: Path, suffix: str) -> None:
    uneven = save(tmp_path / f"a.{suffix}", {**COLUMNS, "input_v": K[:50] * 1.0})
    with pytest.raises(RecordError, match="differ in length: time_s 100, input_v 50"):
        read_record(uneven)
    with pytest.raises(RecordError, match="holds no arrays of numbers"):
        read_record(save(tmp_path / f"b.{suffix}", {"name": "text"}))
    broken = tmp_path / f"c.{suffix}"
    broken.write_bytes(uneven.read_bytes()[:150])
    with pytest.raises(RecordError, match=f"cannot be read as .{suffix}"):
        read_record(broken)


def test_pickles_are_not_opened(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    path = tmp_path / "trap.npz"
    np.savez(path, time_s=np.array([Trap()], dtype=object))
    with pytest.raises(RecordError, match="cannot be read as"):
        read_record(path)
    assert not (tmp_path / "sprung").exists()


MEASURED = Path(os.environ.get("DFM_MEASURED_DATA", Path(__file__).parents[4] / "shared" / "data"))


@pytest.mark.skipif(not MEASURED.is_dir(), reason="the folder of measured data is not here")
def test_measurements_of_others() -> None:
    bench = MEASURED / "motor_bench_two_inertia" / "motor_bench_multisineA.npz"
    record = read_record(bench, input="iq", output="theta_load", input_unit="A",
                         output_unit="rad")
    assert (len(record), record.sample_period) == (50_000, pytest.approx(4e-4, rel=1e-12))
    assert (record.axis().input_unit, record.axis().position_unit) == ("A", "rad")
    beam = read_record(MEASURED / "beam_ringdown" / "decay.npz", time="t", input="voltage",
                       output="strain[0]", time_unit="s", input_unit="V", output_unit="strain")
    assert (len(beam), beam.sample_period) == (29_000, pytest.approx(1e-3, rel=1e-9))
    assert beam.axis().position_unit == "strain"
    assert beam.warnings == []
