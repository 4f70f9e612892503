"""model.yaml: what it accepts, how it says no, and that writing it keeps what was there."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from dfm_stage.model import (
    EFFECTS,
    Model,
    ModelError,
    ParameterError,
    load_model,
    model_from_dict,
    model_text,
    parse_model,
    save_model,
)

GOOD = """\
dfm_model: 1
name: bench    # of the second floor
sample_period: 0.001
# weighed in May
base:
  mass: 1.082   # kg
  stiffness: 650
  noise: 5.0e-8
effects:
  - name: cubic_stiffness   # found in June
    parameters: {k3: 3.0e6}
    origin: {diagnosed_from: run_017, ci95: {k3: [2.9e6, 3.1e6]}}
  - name: hysteresis
    parameters: {stiffness: 20.0, yield_displacement: 1.0e-4}
"""


def test_reads_what_the_file_says() -> None:
    model = parse_model(GOOD, "m.yaml")
    assert model.name == "bench"
    assert dict(model.base) == {"mass": 1.082, "stiffness": 650.0, "noise": 5e-8}
    assert [use.name for use in model.effects] == ["cubic_stiffness", "hysteresis"]
    assert model.effects[0].origin == {"diagnosed_from": "run_017", "ci95": {"k3": [2.9e6, 3.1e6]}}
    assert model.parameters()["hysteresis.shape"] == EFFECTS["hysteresis"].defaults["shape"]


def test_unchanged_model_is_written_unchanged() -> None:
    assert model_text(parse_model(GOOD, "m.yaml")) == GOOD


def test_changed_values_keep_every_comment(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(GOOD)
    model = load_model(path).with_parameters({"mass": 1.1, "cubic_stiffness.k3": 2e6,
                                              "damping": 1.5})
    model = model.without_effect("hysteresis").with_effect(
        "coulomb_friction", {"force": 0.02}, {"ci95": {"force": [0.019, 0.021]}})
    save_model(model, path)
    text = path.read_text()
    for comment in ("# of the second floor", "# weighed in May", "# kg", "# found in June"):
        assert comment in text
    assert "hysteresis" not in text
    again = load_model(path)
    assert again == model
    assert again.to_dict() == model.to_dict()
    assert list(tmp_path.iterdir()) == [path]


def test_dictionary_and_pickle_round_trips() -> None:
    for name in ("paper_stage", "paper_two_mode", "xy_stage", "raster_bench"):
        model = load_model(name)
        assert model_from_dict(model.to_dict()) == model
        assert pickle.loads(pickle.dumps(model)) == model  # noqa: S301
        assert parse_model(model_text(model_from_dict(model.to_dict())), "x") == model


@pytest.mark.parametrize(("old", "new", "line", "words"), [
    ("mass: 1.082", "mas: 1.082", 6, ["mas ", "did you mean mass?"]),
    ("mass: 1.082", "mass: -2", 6, ["mass = -2 kg", "[1e-06, 1e+06]"]),
    ("stiffness: 650", "stiffness: soft", 7, ["stiffness", "N/m", "'soft'"]),
    ("stiffness: 650", "stiffness: .inf", 7, ["stiffness", "finite"]),
    ("stiffness: 650", "stiffness: yes", 7, ["stiffness", "number"]),
    ("{k3: 3.0e6}", "{k4: 3.0e6}", 11, ["k4", "did you mean k3?"]),
    ("{k3: 3.0e6}", "{}", 10, ["k3", "N/m^3", "missing"]),
    ("name: cubic_stiffness", "name: cubic_stifness", 10, ["did you mean cubic_stiffness?"]),
    ("name: hysteresis", "name: cubic_stiffness", 14, ["parameter stiffness is not known"]),
    ("dfm_model: 1", "dfm_model: 7", 1, ["7", "reads 1"]),
    ("dfm_model: 1", "dfm: 1", 1, ["did you mean dfm_model?"]),
    ("sample_period: 0.001", "sample_period: 0", 3, ["sample_period", "1e-07"]),
    ("effects:", "effect:", 9, ["did you mean effects?"]),
    ("stiffness: 650", "noise: 1", 8, ["duplicate", "noise"]),
    ("{k3: 3.0e6}", "{k3: 3.0e6", 12, ["not valid YAML"]),
    ("  stiffness: 650\n", "", 5, ["damping", "stiffness"]),
])
def test_message_names_file_line_and_remedy(old: str, new: str, line: int,
                                            words: list[str]) -> None:
    with pytest.raises(ModelError) as caught:
        parse_model(GOOD.replace(old, new, 1), "stage/m.yaml")
    message = str(caught.value)
    assert message.startswith(f"stage/m.yaml:{line}: ")
    assert "\n" not in message
    for word in words:
        assert word in message


def test_yaml_tags_are_not_executed() -> None:
    with pytest.raises(ModelError):
        parse_model(GOOD.replace("bench", "!!python/object/apply:os.system ['true']", 1), "m")


def test_a_missing_model_names_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="did you mean paper_stage"):
        load_model("paper_stag")
    with pytest.raises(ModelError, match="No such file"):
        load_model(tmp_path / "no.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"name: caf\xe9")
    with pytest.raises(ModelError, match="UTF-8"):
        load_model(tmp_path / "latin.yaml")


def test_unwritable_folder_is_reported_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be written"):
        save_model(parse_model(GOOD, "m"), tmp_path / "absent" / "m.yaml")
    assert list(tmp_path.iterdir()) == []


def test_axes_and_coupling() -> None:
    model = load_model("xy_stage")
    assert model.axis_names == ("x", "y")
    assert model.parameters()["coupling.x.y.ratio"] == pytest.approx(1 / 300, rel=2e-3)
    moved = model.with_parameters({"y.mass": 2.0, "coupling.x.y.ratio": 0.01})
    assert moved.axes["y"].base["mass"] == 2.0
    assert moved.axis("x").parameters()["cross_axis_coupling.ratio"] == 0.01
    assert model.neighbour("x") == "y"
    with pytest.raises(ModelError, match="x, y"):
        model.axis()
    with pytest.raises(ModelError, match="not known"):
        model.axis("z")


def test_units_follow_drive_and_position_unit() -> None:
    model = Model("motor", 4e-4, {"mass": 0.01, "damping": 0.1}, drive="current",
                  position_unit="rad")
    assert model.parameter("force_constant").unit == "N/A"
    assert model.parameter("mass").unit == "N s^2/rad"
    assert model.parameter("damping").unit == "N s/rad"
    assert model.parameter("saturation.limit").unit == "A"
    text = model_text(model)
    assert parse_model(text, "m") == model


@pytest.mark.parametrize(("base", "effects", "drive", "words"), [
    ({"mass": 1.0, "stiffness": 1.0}, [("back_emf", {"constant": 1.0})], "current", "drive"),
    ({"mass": 1.0, "stiffness": 1.0}, [("coil_inductance", {"inductance": 1e-3})], "voltage",
     "coil_resistance"),
    ({"stiffness": 1.0}, [], "voltage", "mass"),
    ({"mass": 1.0}, [], "voltage", "damping"),
])
def test_combinations_without_meaning_are_refused(base, effects, drive, words) -> None:
    def build() -> None:
        model = Model("m", 1e-3, base, drive=drive)
        for name, values in effects:
            model = model.with_effect(name, values)

    with pytest.raises(ModelError, match=words):
        build()


def test_models_are_immutable_and_check_new_values() -> None:
    model = load_model("paper_stage")
    with pytest.raises(ModelError, match="immutable"):
        model.base["mass"] = 2.0  # type: ignore[index]
    with pytest.raises(ModelError, match="did you mean stiffness"):
        model.with_parameters({"stifness": 2.0})
    with pytest.raises(ParameterError, match="outside"):
        model.with_parameters({"mass": -1.0})
    assert model.with_parameters({"mass": 1.5}).base["mass"] == 1.5
    assert model.base["mass"] == 1.082


def test_the_papers_models_are_what_the_paper_says() -> None:
    one = load_model("paper_stage").base
    assert one["force_constant"] / one["mass"] == pytest.approx(1.0)
    assert one["damping"] / one["mass"] == pytest.approx(1.705, rel=1e-3)
    assert one["stiffness"] / one["mass"] == pytest.approx(600.7, rel=1e-3)
    two = load_model("paper_two_mode")
    share, base = two.parameters()["second_mode.share"], two.base
    # zeros of (1 - s)(z^2 + w2^2) + s (z^2 + w1^2)
    w1 = base["stiffness"] / base["mass"]
    w2 = (6.283185307179586 * two.parameters()["second_mode.frequency"]) ** 2
    assert w1 ** 0.5 == pytest.approx(23.93, abs=0.01)
    assert w2 ** 0.5 == pytest.approx(100.63, abs=0.01)
    assert ((1 - share) * w2 + share * w1) ** 0.5 == pytest.approx(97.26, abs=0.01)
    static = base["force_constant"] / base["mass"] * ((1 - share) / w1 + share / w2)
    assert static == pytest.approx(1 / 600.7, rel=1e-6)


def test_an_effect_stands_once() -> None:
    twice = GOOD + "  - name: cubic_stiffness\n    parameters: {k3: 1.0}\n"
    with pytest.raises(ModelError, match=r"m:15: effect cubic_stiffness is there already"):
        parse_model(twice, "m")


def test_the_only_axis_may_be_called_x() -> None:
    """A record with one axis without a prefix calls it so."""
    model = load_model("paper_stage")
    assert model.axis("x") is model
    with pytest.raises(ModelError, match="there is no axis y"):
        model.axis("y")
