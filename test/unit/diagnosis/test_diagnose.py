from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import truth

from dfm_stage.cli.diagnose_report import write_report
from dfm_stage.diagnosis import Diagnosis, DiagnosisError, diagnose, verification
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.verification import SurrogateTest
from dfm_stage.identification.periods import Periodicity
from dfm_stage.model import EFFECTS, save_model
from dfm_stage.recording import AxisRecord, Record, RecordError

K3 = 4.0e6
QUICK = [n for n in EFFECTS if n not in ("hysteresis", "presliding_friction")]


def _pair(extra=None, model=None, library=QUICK, **physics) -> Diagnosis:
    train, held = truth.multisine(1), truth.scan()
    return diagnose(
        [truth.record(train, truth.move(train, extra, **physics), 11)],
        model or truth.believed(),
        holdout=[truth.record(held, truth.move(held, extra, **physics), 12)], library=library)


@pytest.fixture(scope="module")
def cubic() -> Diagnosis:
    return _pair(lambda x, v: -K3 * x**3)


def test_a_complete_model_lacks_nothing(tmp_path):
    found = _pair()
    assert found.verdict == "none"
    write_report(found, tmp_path / "report.html", ["run"], "believed")
    assert "What would have shown" in (tmp_path / "report.html").read_text("utf-8")
    assert found.effects == ()
    assert found.gap.held_out[2] == pytest.approx(truth.NOISE, rel=0.05)


@pytest.mark.parametrize(("times", "names"), [(2.0, ("cubic_stiffness",)), (0.5, ())])
def test_an_effect_twice_the_detection_limit_is_named_and_one_of_half_is_not(times, names):
    few = ["cubic_stiffness", "quadratic_damping"]
    limit = _pair(library=few).detection_limits["cubic_stiffness"]["k3"]
    assert limit.unit == "N/m^3"
    assert _pair(lambda x, v: -times * limit.value * x**3, library=few).names == names


def test_samples_dropped_by_the_logger_are_put_in_and_told():
    def thinned(whole, seed):
        keep = np.random.default_rng(seed).random(len(whole.time)) > 1e-3
        axis = whole.axes["x"]
        return Record(whole.time[:keep.sum()], whole.sample_period,
                      {"x": AxisRecord(axis.input[keep], axis.position[keep])}, whole.provenance)

    train, held = truth.multisine(1), truth.scan()
    found = diagnose([thinned(truth.record(train, truth.move(train), 11), 0)], truth.believed(),
                     holdout=[thinned(truth.record(held, truth.move(held), 12), 1)],
                     library=QUICK, names=["train", "held"])
    assert found.verdict == "none"
    assert [w.split(" at ")[0] for w in found.warnings] == [
        "train: 12 samples seem to be missing,", "held: 10 samples seem to be missing,"]


def test_wrong_numbers_are_retuned():
    found = _pair(stiffness=4400.0, damping=3.5)
    assert found.verdict == "retune"
    assert found.base["stiffness"].value / found.base["force_constant"].value \
        == pytest.approx(4400.0 / truth.GAIN, rel=1e-4)
    assert found.model.base["damping"] == pytest.approx(3.5, rel=2e-3)


def test_a_cubic_spring_is_named_with_an_interval_that_holds_it(cubic):
    assert cubic.verdict == "named"
    assert cubic.names == ("cubic_stiffness",)
    k3 = cubic.effects[0].parameters["k3"]
    assert k3.value == pytest.approx(K3, rel=0.02)
    assert k3.ci95 is not None
    assert k3.ci95[0] > 0.0
    assert cubic.gap.held_out[2] < 1.2 * truth.NOISE < 0.5 * cubic.gap.held_out[1]
    assert cubic.model.effect("cubic_stiffness") is not None


def test_the_extended_model_does_not_touch_what_it_was_given(cubic):
    assert truth.believed().effects == ()
    assert cubic.model.base["mass"] == truth.MASS


def test_left_out_of_the_library_it_becomes_unknown():
    library = [n for n in QUICK if n not in ("cubic_stiffness", "force_constant_droop")]
    found = _pair(lambda x, v: -K3 * x**3, library=library)
    assert found.verdict == "unknown"
    assert found.description is not None
    assert found.description.parity == "odd"


def test_drag_is_not_taken_for_friction():
    found = _pair(lambda x, v: -8.0 * abs(v) * v)
    assert found.names == ("quadratic_damping",)
    assert found.effects[0].parameters["coefficient"].value == pytest.approx(8.0, rel=0.05)


def test_a_constant_force_is_ambiguous_unless_the_zero_is_trusted():
    def push(x: float, v: float) -> float:
        return 2e-3

    open_ = _pair(push)
    assert open_.verdict == "ambiguous"
    assert set(open_.effects[0].members) == {"force_offset", "encoder_zero"}
    trusted = _pair(push, model=truth.believed(encoder_zero=0.0))
    assert trusted.names == ("force_offset",)
    assert trusted.effects[0].parameters["force"].value == pytest.approx(2e-3, rel=0.02)


def test_a_drift_may_resemble_itself_shifted_and_a_vibration_may_not_resemble_its_neighbours():
    # of a slow ramp most is still there when it is shifted
    assert SurrogateTest(4.7e6, original=4.8e4, without=4.8e6, best=7.0e5).passed(per_run=True)
    assert not SurrogateTest(4.7e6, original=8.0e5, without=4.8e6, best=7.0e5).passed(per_run=True)
    assert not SurrogateTest(4.7e6, original=4.8e4, without=4.8e6, best=7.0e5,
                        outstanding=3.0).passed(per_run=True)


def test_the_neighbours_of_a_vibration_lie_close_where_the_input_does_not_repeat():
    """Farther away a wandering reading has less power by itself, and any line of it stands out."""
    run = Observation("run", np.sin(np.arange(10_000.0) ** 2 / 9e4), np.zeros(10_000), 1e-3)
    assert verification._neighbours(0.35, [run]) == pytest.approx([0.15, 0.55, 0.75])
    repeating = replace(run, periodicity=Periodicity(2000, 0, 5))
    assert verification._neighbours(5.25, [repeating]) == pytest.approx([4.25, 4.75, 5.75, 6.25])


def test_a_drift_of_the_reading_is_named():
    seconds = truth.PERIOD * np.arange(truth.SAMPLES)
    records = [truth.record(feed, truth.move(feed) + rate * seconds, seed)
               for feed, rate, seed in ((truth.multisine(1), 4e-7, 11), (truth.scan(), 3e-7, 12))]
    found = diagnose(records[:1], truth.believed(), holdout=records[1:], library=QUICK)
    assert found.names == ("thermal_drift",)
    assert found.effects[0].parameters["rate"].value == pytest.approx(4e-7, rel=0.05)


def test_a_record_at_rest_shows_nothing():
    still = np.zeros(truth.SAMPLES)
    found = diagnose([truth.record(still, still, 5)], truth.believed(),
                     holdout=[truth.record(still, still, 6)], library=QUICK)
    assert found.verdict == "not_excited"
    assert found.next_experiment is not None
    assert found.detection_limits


def test_a_next_experiment_is_one_the_generator_takes():
    from dfm_stage.trajectory import load_experiment

    still = np.zeros(truth.SAMPLES)
    found = diagnose([truth.record(still, still, 5)], truth.believed(), library=QUICK)
    asked = load_experiment(found.next_experiment)
    assert np.max(np.abs(asked.excitation("x", 1e-3).voltage)) > 0.0
    assert any("held out" in w for w in found.warnings)


def test_the_next_experiment_parts_what_was_ambiguous():
    """Slowly moved, a stiffening spring and a coil whose force falls off look alike."""
    from dfm_stage.trajectory import load_experiment

    def spring(x: float, v: float) -> float:
        return -K3 * x**3

    time = truth.PERIOD * np.arange(truth.SAMPLES)
    slow = 0.7 * np.sin(0.4 * np.pi * time) + 0.3 * np.sin(0.6 * np.pi * time)
    first = truth.record(slow, truth.move(slow, spring), 11)
    found = diagnose([first], truth.believed(), library=QUICK)
    assert found.verdict == "ambiguous"
    assert set(found.effects[0].members) == {"cubic_stiffness", "force_constant_droop"}

    asked = load_experiment(found.next_experiment)
    voltage = asked.excitation("x", truth.PERIOD).voltage
    moved = truth.move(voltage, spring)
    assert np.max(np.abs(voltage)) <= np.max(np.abs(slow))
    assert np.ptp(moved) <= 1.15 * np.ptp(first.axes["x"].position)
    again = diagnose([first, truth.record(voltage, moved, 13)], truth.believed(), library=QUICK)
    assert again.names == ("cubic_stiffness",)
    assert again.verdict == "named"
    assert "part cubic stiffness and force constant droop by" in asked.description


def test_json_has_the_agreed_shape(cubic):
    data = json.loads(json.dumps(cubic.to_dict(), allow_nan=False))
    assert data["schema"] == 2
    assert {"verdict", "effects", "base", "rejected", "gap", "description", "next_experiment",
            "warnings"} <= set(data)
    assert set(data["gap"]) == {"unit", "noise_floor", "noise_floor_from", "fit", "held_out",
                                "predictable", "judged", "window_s",
                                "velocity_s"}
    effect = data["effects"][0]
    assert {"name", "class", "parameters", "gap_share", "evidence", "predictable_share", "margins",
            "constancy"} <= set(effect)
    assert set(effect["parameters"]["k3"]) == {"value", "unit", "ci95"}
    assert all(r["reason"] for r in data["rejected"])


def test_the_same_records_give_the_same_answer(cubic):
    again = _pair(lambda x, v: -K3 * x**3)
    assert again.to_dict() == cubic.to_dict()


@pytest.mark.parametrize(("change", "said"), [
    ({"library": ["cubic_stifness"]}, "cubic_stifness"), ({"records": []}, "no record")])
def test_what_cannot_be_used_is_said_in_one_line(change, said):
    still = np.zeros(truth.SAMPLES)
    given = {"records": [truth.record(still, still, 5)], **change}
    with pytest.raises(DiagnosisError, match=said) as error:
        diagnose(given.pop("records"), truth.believed(), **given)
    assert "\n" not in str(error.value)


def test_a_model_at_another_rate_is_refused():
    still = np.zeros(truth.SAMPLES)
    with pytest.raises(RecordError, match="sampled every"):
        diagnose([truth.record(still, still, 5)], replace(truth.believed(), sample_period=5e-4))


def test_a_clock_that_is_off_by_a_few_ppm_is_taken_for_the_model_s():
    """Jittered stamps told a period 1.1 ppm longer, and the record was refused."""
    feed = truth.multisine(1)
    whole = truth.record(feed, truth.move(feed), 5)
    off = replace(whole, time=1.00001 * whole.time, sample_period=1.00001 * whole.sample_period)
    found = diagnose([off], truth.believed(), holdout=[whole], library=("coulomb_friction",))
    assert found.verdict == "none"
    assert any("10 ppm" in warning for warning in found.warnings)


def test_the_command_writes_all_files(tmp_path, capsys):
    from dfm_stage.cli.diagnose import main

    feed = truth.multisine(1)
    move = truth.move(feed, lambda x, v: -K3 * x**3)
    noise = truth.NOISE * np.random.default_rng(3).standard_normal(feed.size)
    rows = np.column_stack([truth.PERIOD * np.arange(feed.size), feed, move + noise])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", comments="",
               header="time_s,input_v,position_m")
    save_model(truth.believed(), tmp_path / "model.yaml")
    out = tmp_path / "out"
    code = main([str(tmp_path / "run.csv"), "--model", str(tmp_path / "model.yaml"), "--out",
                 str(out), "--without", "hysteresis,presliding_friction"])
    assert code == 0
    assert json.loads((out / "diagnosis.json").read_text())["verdict"] == "named"
    assert "cubic_stiffness" in (out / "model.yaml").read_text()
    page = (out / "report.html").read_text()
    assert "cubic stiffness" in page
    digits = hashlib.sha256((tmp_path / "run.csv").read_bytes()).hexdigest()[:12]
    assert f"run.csv (sha256 {digits})" in page
    assert "http" not in page.split("</style>", 1)[1].replace("http://www.w3.org", "")
    assert "named" in capsys.readouterr().out


def test_a_model_given_is_kept_where_another_takes_its_place(tmp_path, capsys):
    from dfm_stage.cli.diagnose import main

    feed = truth.multisine(1)[:2000]
    noise = truth.NOISE * np.random.default_rng(3).standard_normal(feed.size)
    rows = np.column_stack([truth.PERIOD * np.arange(feed.size), feed, truth.move(feed) + noise])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", comments="",
               header="time_s,input_v,position_m")
    given = tmp_path / "model.yaml"
    texts = []
    for name in ("first", "second"):
        save_model(replace(truth.believed(), name=name), given)
        texts.append(given.read_bytes())
        for record in ("none.csv", "run.csv", "run.csv"):
            main([str(tmp_path / record), "--model", str(given), "--out", str(tmp_path),
                  "--library", "back_emf", "--no-report"])
            if record == "run.csv":
                given.write_bytes(texts[-1])
    assert [path.read_bytes() for path in (tmp_path / "model_given.yaml",
                                           tmp_path / "model_given_2.yaml")] == texts
    assert not (tmp_path / "model_given_3.yaml").exists()
    assert capsys.readouterr().err.count("is kept as") == 4


def test_unusable_input_is_exit_code_2(tmp_path, capsys):
    from dfm_stage.cli.diagnose import main

    save_model(truth.believed(), tmp_path / "model.yaml")
    assert main([str(tmp_path / "none.csv"), "--model", str(tmp_path / "model.yaml"), "--out",
                 str(tmp_path / "out")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()[-1:]) == 1
