"""The set of laws: changes without a bump, handing over, what the model decides, files."""

from __future__ import annotations

from types import SimpleNamespace

import control
import numpy as np
import pytest

from dfm_stage.control import (
    AXIS_PARAMETERS,
    GUARD_PARAMETERS,
    LAWS,
    ControlError,
    LawSet,
    Pid,
    PidGains,
    ReferenceShaper,
    highest_mode,
    laws_with,
    margins,
    parameter_text,
    plan_laws,
    read_parameters,
    sample_model,
    shape,
    shaper,
)
from dfm_stage.control.laws import LawFileError
from dfm_stage.control.stage import closed_loop_poles, controller_response
from dfm_stage.model import Plant, load_model

H = 1e-3
OF_LAWS = [entry for law in LAWS.values() for entry in law.parameters]
DEFAULTS = {entry.name: entry.default for entry in (*AXIS_PARAMETERS, *GUARD_PARAMETERS, *OF_LAWS)
            } | {"mode": "pid", "sample_period_s": H}
NOTCHED = PidGains(kp=3100.0, ki=38000.0, kd=94.0, notch_hz=70.0, notch_depth_damping=0.05)


class Rig:
    """Laws that drive a plant along a sine."""

    def __init__(self, name: str = "raster_bench", model=None, **values) -> None:
        self.values = {**DEFAULTS, **values}
        self.model = model or load_model(name)
        self.laws = LawSet(self.values, plan_laws(self.values, self.model))
        self.plant = Plant(self.model, seed=2)
        self.k = 0

    def set(self, **values) -> None:
        self.values |= values
        self.laws.change(self.values, plan_laws(self.values, self.model), set(values))

    def run(self, samples: int, added: float = 0.0) -> np.ndarray:
        out = []
        for _ in range(samples):
            w, t = 3.0, self.k * H
            r = SimpleNamespace(position=1e-3 * np.sin(w * t), velocity=3e-3 * np.cos(w * t),
                                acceleration=-9e-3 * np.sin(w * t))
            y = self.plant.sample().reading_m
            wanted = self.laws.step(r, y, 1) + added
            volts = min(self.laws.limit_v, max(-self.laws.limit_v, wanted))
            self.laws.update(y, volts, added, volts != wanted)
            self.plant.advance(volts)
            out.append(volts)
            self.k += 1
        return np.array(out)


def test_every_change_goes_on_from_the_output_there_was() -> None:
    rig = Rig()
    volts = [rig.run(1500)]
    usual = float(np.max(np.abs(np.diff(volts[0][500:]))))
    for change in ({"mode": "lqr"}, {"mode": "pid"}, {"feedforward": "model"},
                   {"notch_hz": 90.0}, {"mode": "lqr"}, {"notch": "model"}, {"mode": "pid"},
                   {"notch": "given", "notch_hz": 0.0}, {"feedforward": "gains"},
                   {"kp": 2500.0, "feedforward_position": 500.0}, {"mode": "open_loop"}):
        rig.set(**change)
        volts.append(rig.run(1))
        assert abs(volts[-1][0] - volts[-2][-1]) < 2.0 * usual, change
        volts.append(rig.run(400))
    assert not np.any(volts[-1][200:])          # the handover is over
    assert np.max(np.abs(np.diff(volts[-1]))) < 2.0 * usual
    rig.set(mode="pid")
    assert abs(rig.run(1)[0]) < 0.05            # the stage swings freely by now: kp v h


def test_an_lqr_follows_better_with_what_the_effects_take() -> None:
    model = load_model("raster_bench").with_effect("cubic_stiffness", {"k3": 3e8}).with_effect(
        "coulomb_friction", {"force": 0.02})
    error = {}
    for feedforward in ("gains", "model"):
        rig = Rig(model=model, mode="lqr", feedforward=feedforward)
        rig.run(2500)
        k = rig.k
        rig.run(1)
        y = []
        for _ in range(2000):
            y.append(rig.plant.sample().position_m - 1e-3 * np.sin(3.0 * rig.k * H))
            rig.run(1)
        assert rig.k == k + 2001
        error[feedforward] = float(np.sqrt(np.mean(np.square(y))))
    assert error["model"] < 0.3 * error["gains"]
    for mode in ("pid", "lqr", "pid"):
        held = rig.run(1)[0]
        rig.set(mode=mode)
        assert abs(rig.run(1)[0] - held) < 0.03, mode


def test_open_loop_from_the_start_is_the_excitation_alone() -> None:
    assert np.all(Rig(mode="open_loop").run(50, added=0.07) == 0.07)


def test_the_model_limits_the_output_to_what_has_an_effect() -> None:
    model = load_model("raster_bench").with_effect("saturation", {"limit": 1.5})
    rig = Rig(model=model)
    assert rig.laws.limit_v == rig.laws.by_name["pid"].gains.output_limit_v == 1.5
    free = plan_laws({**DEFAULTS}, None)
    assert free.limit_v == 10.0


@pytest.mark.parametrize("anti_windup", ["back_calculation", "clamping"])
def test_the_integral_does_not_wind_up_while_the_amplifier_gives_less(anti_windup) -> None:
    """The law asks for 2.3 V to hold 4 mm; the amplifier gives 1 V at most, and says so."""
    overshoot = {}
    for told in (True, False):
        rig = Rig(anti_windup=anti_windup, slew_limit_v_s=0.0)
        laws, plant = rig.laws, rig.plant
        y = np.empty(7000)
        for k in range(7000):
            r = SimpleNamespace(position=4e-3 if k < 4000 else 0.5e-3, velocity=0.0,
                                acceleration=0.0)
            sample = plant.sample()
            y[k] = sample.position_m
            asked = laws.step(r, sample.reading_m, 1)
            laws.update(sample.reading_m, asked, 0.0, False)
            given = min(1.0, max(-1.0, asked))
            if told and given != asked:
                laws.applied(given, 0.0)
            plant.advance(given)
        overshoot[told] = np.sum(np.abs(y[4000:] - 0.5e-3)) * H
    assert overshoot[True] < 0.6 * overshoot[False]


def test_what_needs_a_model_says_so() -> None:
    for values, word in (({"mode": "lqr"}, "mode lqr"), ({"feedforward": "model"}, "feedforward"),
                         ({"notch": "model"}, "notch model"), ({"shaper": "zv"}, "shaper_hz")):
        with pytest.raises(ControlError, match=word):
            plan_laws({**DEFAULTS, **values}, None)


def test_a_law_by_another_name_does_the_same() -> None:
    """Nothing but the registry knows what the laws are called."""
    class Classic(LAWS["pid"]):
        name = "classic"

    laws = {"classic": Classic}
    values = {**DEFAULTS, "mode": "classic", "feedforward": "model"}
    one, two = Rig(feedforward="model"), Rig()
    two.laws = LawSet(values, plan_laws(values, two.model, laws), laws)
    assert np.array_equal(one.run(500), two.run(500))


@pytest.mark.parametrize(("law", "complaint"), [
    ("import nothing_of_this_name", "ModuleNotFoundError"),
    ("x = 1", "defines no class derived from Law"),
    ("from dfm_stage.control import Law\nclass A(Law):\n    name = 'a'", "all of its methods"),
    ("from dfm_stage.control import Pid\nclass A(Pid):\n    name = 'pid'", "name of its own"),
    ("from dfm_stage.control import Pid\nclass A(Pid):\n    name = 'a'",
     "parameters of the law a must begin with a_, unlike kp"),
])
def test_a_file_that_is_no_law_says_why(tmp_path, law: str, complaint: str) -> None:
    (tmp_path / "law.py").write_text(law, encoding="utf-8")
    with pytest.raises(LawFileError, match=rf"law\.py: .*{complaint}"):
        laws_with(str(tmp_path / "law.py"))
    with pytest.raises(LawFileError, match="no such file"):
        laws_with(str(tmp_path / "none.py"))
    assert tuple(LAWS) == ("pid", "lqr")


def test_a_plan_changes_nothing_that_runs() -> None:
    rig, other = Rig(), Rig()
    rig.run(100)
    plan_laws({**rig.values, "mode": "lqr", "kp": 10.0, "shaper": "zvd"}, rig.model)
    other.run(100)
    assert np.array_equal(rig.run(100), other.run(100))


def test_the_lqr_does_not_wind_up_where_less_than_it_asks_for_goes_out() -> None:
    integral = {}
    reference = SimpleNamespace(position=1e-3, velocity=0.0, acceleration=0.0)
    for limited in (True, False):
        laws = Rig(mode="lqr").laws
        for _ in range(30):
            asked = laws.step(reference, 0.0, 1)
            laws.update(0.0, asked - 0.2 * limited, 0.0, limited)
        integral[limited] = laws.by_name["lqr"].integral_v
    assert 0.0 < integral[True] < 0.2 * integral[False]


def test_the_highest_mode_is_the_second_or_else_the_first() -> None:
    assert highest_mode(load_model("raster_bench")) == pytest.approx((16.02, 0.01), rel=1e-9)
    assert highest_mode(load_model("paper_stage")) == pytest.approx((24.51 / 2 / np.pi, 0.0348),
                                                                    rel=2e-3)


@pytest.mark.parametrize("impulses", [2, 3, 4])
def test_a_reference_is_shaped_sample_by_sample_as_at_once(impulses: int) -> None:
    weights = shaper(15.3, 0.01, H, impulses)
    r = 1e-3 + np.cumsum(np.random.default_rng(0).normal(size=400)) * 1e-5
    one = ReferenceShaper(weights)
    found = np.array([one.step(x, 2.0 * x, -x) for x in r.tolist()])
    assert np.allclose(found[:, 0], shape(r, weights), atol=1e-15)
    padded = shape(np.concatenate(([0.0], 2.0 * r)), weights)[1:]
    assert np.allclose(found[:, 1], padded, atol=1e-15)


def test_a_notch_in_the_loop_is_that_of_python_control() -> None:
    z = control.tf("z")
    z = control.tf([1, 0], [1], H)
    t = np.tan(np.pi * 70.0 * H)
    s = (z - 1) / (z + 1) / t
    notch = (s * s + 0.1 * s + 1) / (s * s + 0.6 * s + 1)
    f = np.array([1.0, 20.0, 69.0, 70.0, 200.0])
    plain = controller_response(NOTCHED.changed({"notch_hz": 0.0}), f, H)
    assert np.allclose(controller_response(NOTCHED, f, H),
                       plain * notch(np.exp(2j * np.pi * f * H)), rtol=1e-8)


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_loop_with_a_notch_diverges_where_its_poles_say(factor: float) -> None:
    stage = sample_model(load_model("paper_stage"))
    scale = margins(stage, NOTCHED).gain * factor
    gains = NOTCHED.changed({"kp": 3100.0 * scale, "ki": 38000.0 * scale, "kd": 94.0 * scale,
                             "output_limit_v": 1e6})
    assert (np.max(np.abs(closed_loop_poles(stage, gains))) < 1.0) == (factor < 1.0)
    pid, x, track = Pid(gains, H), np.zeros(stage.b.size), []
    for _ in range(5000):
        track.append(float(stage.c @ x))
        x = stage.a @ x + stage.b * pid.step(1e-6, track[-1])
    assert (np.ptp(track[4000:]) < np.ptp(track[1500:2500])) == (factor < 1.0)


def test_a_parameter_file_comes_back_by_axis_and_node(tmp_path) -> None:
    gains = {"mode": "pid", "kp": 3.1e-20, "ki": 2.0, "lqr_integral": True}
    path = tmp_path / "p.yaml"
    path.write_text(parameter_text({"/stage/x/controller": gains, "/**/controller": {"kp": 7.0},
                                    "/stage/x/trajectory_generator": {"inverse_model": "m"}},
                                   ["why", ""]), encoding="utf-8")
    assert read_parameters(path, "x") == gains
    assert read_parameters(path, "y") == {"kp": 7.0}
    assert read_parameters(path, "x", "trajectory_generator") == {"inverse_model": "m"}
    path.write_text("kp: 5.0\n", encoding="utf-8")
    assert read_parameters(path, "x") == {"kp": 5.0}
    for text in ("- 1\n", "a: [\n"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ControlError, match=r"p\.yaml"):
            read_parameters(path, "x")
    with pytest.raises(ControlError, match="cannot read"):
        read_parameters(tmp_path / "none.yaml", "x")
