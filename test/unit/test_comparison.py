"""A model beside records, against the same found by scipy and least squares."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal

from dfm_stage.cli import check as check_command
from dfm_stage.cli import compare as compare_command
from dfm_stage.cli import simulate as simulate_command
from dfm_stage.comparison import ComparisonError, check, simulate, with_gap
from dfm_stage.model import Model, save_model
from dfm_stage.recording import AxisRecord, Provenance, Record, write_csv

PERIOD, COUNT, NOISE = 1e-3, 4000, 2e-7
START, OFFSET = (3e-4, -0.01), 5e-5
TRUE = Model("true", PERIOD, base={"mass": 1.0, "damping": 2.0, "stiffness": 600.0,
                                   "force_constant": 1.5})
SOFT = replace(TRUE.with_parameters({"stiffness": 560.0}), name="soft")


def discrete(model: Model) -> tuple[np.ndarray, np.ndarray]:
    base = model.base
    a = np.array([[0.0, 1.0], [-base["stiffness"], -base["damping"]]]) / base["mass"]
    a[0] = 0.0, 1.0
    b = np.array([[0.0], [base["force_constant"] / base["mass"]]])
    ad, bd, *_ = scipy.signal.cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), PERIOD)
    return ad, bd


def response(model: Model, volts: np.ndarray, start: tuple[float, float]) -> np.ndarray:
    ad, bd = discrete(model)
    state, out = np.array(start), []
    for u in volts:
        out.append(state[0])
        state = ad @ state + bd[:, 0] * u
    return np.array(out)


@pytest.fixture(scope="module")
def record() -> Record:
    rng = np.random.default_rng(3)
    volts = np.repeat(rng.normal(size=COUNT // 20), 20)
    noise = NOISE * rng.standard_normal(COUNT)
    position = OFFSET + response(TRUE, volts, START) + noise
    axis = AxisRecord(volts, position, input_hold="zero", input_shift=0.0)
    return Record(PERIOD * np.arange(COUNT), PERIOD, {"x": axis}, Provenance("made", "csv"))


def expected(model: Model, record: Record, first: int) -> np.ndarray:
    """The response with state and offset by least squares over the first samples."""
    axis = record.axis()
    forced = response(model, axis.input, (0.0, 0.0))
    nothing = np.zeros_like(axis.input)
    free = np.column_stack([response(model, nothing, (1.0, 0.0)),
                            response(model, nothing, (0.0, 1.0)), np.ones(COUNT)])
    found = np.linalg.lstsq(free[:first], (axis.position - forced)[:first], rcond=None)[0]
    return forced + free @ found


@pytest.mark.parametrize("initial", [120, 1000])
def test_state_and_offset_come_from_the_first_samples(record: Record, initial: int) -> None:
    found = simulate(SOFT, record, initial=initial)
    wanted = expected(SOFT, record, initial)
    np.testing.assert_allclose(found.simulated, wanted, atol=1e-4 * np.std(wanted))
    left = (record.axis().position - wanted)[initial:]
    assert found.rms == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-4)
    assert found.skipped == initial
    spread = np.std(record.axis().position[initial:])
    assert found.fit_percent == pytest.approx(100.0 * (1.0 - found.rms / spread), rel=1e-4)


def test_the_true_model_leaves_the_noise(record: Record) -> None:
    assert simulate(TRUE, record).rms == pytest.approx(NOISE, rel=0.03)
    assert simulate(SOFT, record).rms > 20 * NOISE


def test_more_first_samples_than_there_are_are_refused(record: Record) -> None:
    with pytest.raises(ComparisonError, match="first 4000 of 4000"):
        simulate(TRUE, record, initial=COUNT)


def test_a_check_holds_a_model_to_its_stored_gap(record: Record) -> None:
    assert check(with_gap(TRUE, NOISE, "m"), [record]).holds
    aged = check(with_gap(SOFT, NOISE, "m"), [record])
    assert not aged.holds
    assert check(with_gap(SOFT, NOISE, "m"), [record], factor=1.1 * aged.worst.rms / NOISE).holds
    assert check(SOFT, [record], gap=aged.worst.rms).holds
    with pytest.raises(ComparisonError, match="--gap"):
        check(TRUE, [record])
    with pytest.raises(ComparisonError, match="stored in rad"):
        check(with_gap(TRUE, NOISE, "rad"), [record])


@pytest.fixture
def files(record: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_csv(record, Path("log.csv"))
    save_model(with_gap(TRUE, NOISE, "m"), "true.yaml")
    save_model(with_gap(SOFT, NOISE, "m"), "soft.yaml")


HELD = ["--input-hold", "zero", "--input-shift", "0"]


@pytest.mark.usefixtures("files")
def test_simulate_writes_the_response_and_its_figures(
        record: Record, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["soft.yaml", "log.csv", "--initial", "120", "--json"]
    assert simulate_command.main([*asked, *HELD]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(Path("simulated/simulation.json").read_text("utf-8"))
    assert {"rms", "unit", "fit_percent", "samples", "skipped"} <= printed.keys()
    assert (printed["samples"], printed["skipped"], printed["unit"]) == (COUNT, 120, "m")
    table = np.genfromtxt("simulated/response.csv", delimiter=",", names=True)
    assert table.dtype.names == ("time_s", "measured_m", "simulated_m")
    left = (table["measured_m"] - table["simulated_m"])[120:]
    assert printed["rms"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-4)


@pytest.mark.usefixtures("files")
def test_compare_orders_nothing_and_shows_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert compare_command.main(["soft.yaml", "true.yaml", "--record", "log.csv", *HELD]) == 0
    said = capsys.readouterr().out
    assert said.index("soft") < said.index("true")
    found = json.loads(Path("compared/comparison.json").read_text("utf-8"))["records"][0]["models"]
    assert [each["model"] for each in found] == ["soft.yaml", "true.yaml"]
    assert found[0]["rms"] > 20 * found[1]["rms"]
    page = Path("compared/report.html").read_text("utf-8")
    assert "true comes nearest" in page


@pytest.mark.usefixtures("files")
def test_check_ends_with_1_where_the_model_does_not_hold(
        capsys: pytest.CaptureFixture[str]) -> None:
    assert check_command.main(["true.yaml", "log.csv", *HELD]) == 0
    assert check_command.main(["soft.yaml", "log.csv", "--json", *HELD]) == 1
    found = json.loads(capsys.readouterr().out.partition("{")[2].join(("{", "")))
    assert (found["holds"], found["factor"], found["stored"]) == (False, 1.5, NOISE)
    assert found["ratio"] == pytest.approx(found["gap"] / NOISE)
    assert check_command.main(["soft.yaml", "log.csv", "--factor", "20000", *HELD]) == 0
    assert check_command.main(["missing.yaml", "log.csv"]) == 2
