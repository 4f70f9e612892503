"""Records and topics as pandas and xarray have them, and one line where they are missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from dfm_stage.errors import DfmError
from dfm_stage.recording import Bag, Record, read_bag, read_record, write_csv

N = 20
JOINTS, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseWithCovariance"
LOGGED = 10**18 + 10**6 * np.arange(N) + 5     # as make_bag does
STAMPS = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(N)


@pytest.fixture
def record(tmp_path: Path) -> Record:
    t = 0.5 + 1e-2 * np.arange(N)
    lines = ["time_s,x_input_v,x_position_m,y_input_v,y_position_m,y_current_a",
             *(f"{a},{a},{2 * a},{3 * a},{4 * a},{5 * a}" for a in t)]
    (tmp_path / "two.csv").write_text("\n".join(lines))
    return read_record(tmp_path / "two.csv")


@pytest.fixture
def topics(tmp_path: Path, typestore: Typestore, make_bag: Callable[..., None]) -> Bag:
    """A topic with text, a stamp and sequences that grow, and one with a fixed array."""
    types, joints, poses = typestore.types, [], []
    for k, stamp in enumerate(STAMPS.tolist()):
        header = types["std_msgs/msg/Header"](
            types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "base")
        joints.append(types[JOINTS](header, ["a", "b"], np.arange(k % 3, dtype=float),
                                    np.empty(0), np.empty(0)))
        poses.append(types[POSE](types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](float(k), 0.0, 0.0),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)), k + np.arange(36.0)))
    make_bag(tmp_path / "bag", {
        name: (kind, [bytes(typestore.serialize_cdr(each, kind)) for each in messages])
        for name, kind, messages in (("/joints", JOINTS, joints), ("/pose", POSE, poses))})
    return read_bag(tmp_path / "bag")


def test_a_record_is_what_pandas_reads_from_its_csv(record: Record, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    write_csv(record, tmp_path / "again.csv")
    read = pandas.read_csv(tmp_path / "again.csv", index_col="time_s")
    found = record.to_pandas()
    pandas.testing.assert_frame_equal(found, read)
    assert found.attrs["sample_period_s"] == pytest.approx(1e-2)
    assert found.attrs["source"].endswith("two.csv")


def test_what_else_a_record_holds_comes_along(record: Record) -> None:
    pytest.importorskip("pandas")
    extra = {"plant_position": np.arange(float(N))}
    axis = record.axes["x"]
    with_extra = Record(record.time, record.sample_period, {
        "x": type(axis)(axis.input, axis.position, extra=extra)}, record.provenance)
    found = with_extra.to_pandas()
    assert list(found) == ["input_v", "position_m", "plant_position"]
    assert found["plant_position"].tolist() == list(range(N))


def test_a_topic_in_pandas(topics: Bag) -> None:
    pandas = pytest.importorskip("pandas")
    found = topics.topics["/joints"].to_pandas()
    assert found.index.name == "log_time"
    assert (found.index == pandas.to_datetime(LOGGED)).all()
    assert found["header.stamp"].tolist() == STAMPS.tolist()
    assert set(found["header.frame_id"]) == {"base"}
    assert [list(each) for each in found["name"]] == [["a", "b"]] * N
    assert [len(each) for each in found["position"]] == [k % 3 for k in range(N)]
    wide = topics.topics["/pose"].to_pandas()
    assert wide["covariance[35]"].tolist() == [k + 35.0 for k in range(N)]
    assert wide["pose.position.x"].tolist() == list(range(N))


def test_a_record_in_xarray_has_units(record: Record) -> None:
    pytest.importorskip("xarray")
    found = record.to_xarray()
    assert dict(found.sizes) == {"time_s": N}
    assert found["time_s"].attrs == {"units": "s"}
    assert found["y_current_a"].attrs == {"units": "A"}
    assert found["x_position_m"].attrs == {"units": "m"}
    half = found.sel(time_s=slice(0.5, 0.595))
    assert half["y_position_m"].values == pytest.approx(4 * (0.5 + 1e-2 * np.arange(10)))


def test_a_topic_in_xarray(topics: Bag) -> None:
    pytest.importorskip("xarray")
    found = topics.topics["/pose"].to_xarray()
    assert found["covariance"].dims == ("log_time", "covariance_element")
    assert found["covariance"].sel(log_time=LOGGED[3].astype("datetime64[ns]")).values[2] == 5.0
    assert [len(each) for each in topics.topics["/joints"].to_xarray()["position"].values] == [
        k % 3 for k in range(N)]


@pytest.mark.parametrize("name", ["pandas", "xarray"])
def test_where_it_is_missing_one_line_says_so(name: str, record: Record, topics: Bag,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(asked: str) -> None:
        raise ModuleNotFoundError(f"No module named {asked!r}", name=asked)

    monkeypatch.setattr("dfm_stage.recording.frames.import_module", refuse)
    for each in (record, topics["/pose"]):
        with pytest.raises(ImportError, match=f"pip install {name}") as caught:
            getattr(each, f"to_{name}")()
        assert isinstance(caught.value, DfmError)
        assert "\n" not in str(caught.value)
