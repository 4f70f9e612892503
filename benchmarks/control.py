"""Every controller on the same scans of the same stage, and what none of them may do.

The stage is config/models/raster_bench.yaml; controllers are tuned on the model that is identified
from a bag of it, recorded through the node graph. Errors are those of the plant's true position.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import BarKind, Figure
from dfm_stage.control import (
    Guard,
    Learner,
    Lqg,
    LqrSpec,
    Pid,
    PidGains,
    design_learning,
    design_lqr,
    inverse_input,
    run_on_model,
    sample_model,
    tune_lqr,
    tune_pid,
    tune_ziegler_nichols,
)
from dfm_stage.control.sampled import controller_response
from dfm_stage.control.tuning import pid_margins
from dfm_stage.errors import DfmError
from dfm_stage.model import EFFECTS, Model, Plant, load_model
from dfm_stage.trajectory import make_reference

Array = NDArray[np.float64]
Law = Pid | Lqg
PASSES = 25
TRAVEL_M, LIMIT_V = 7.7e-3, 10.0
RASTER = {"kind": "raster", "line_length_m": 5e-3, "line_time_s": 0.4, "turnaround_s": 0.1,
          "lead_in_s": 0.5}
BARS: dict[str, tuple[float, BarKind]] = {
    "inverse.line_rms_nm": (2000.0, "at most"), "learning.line_rms_nm": (100.0, "at most"),
    "pid.modulus_margin": (0.5, "at least"), "lqr.modulus_margin": (0.5, "at least"),
    "inverse.modulus_margin": (0.5, "at least"), "learning.modulus_margin": (0.5, "at least")}


@dataclass(frozen=True)
class Scan:
    """The raster: reference (N,), where the line is, first and length of its periods."""

    position: Array
    velocity: Array
    acceleration: Array
    line: NDArray[np.bool_]
    first: int
    period: int

    @classmethod
    def make(cls, periods: int, h: float) -> Scan:
        found = make_reference(RASTER, sample_period_s=h, duration_s=0.5 + periods, seed=0)
        assert found.steady is not None
        return cls(found.position, found.velocity, found.acceleration, found.steady,
                   found.start_samples, found.period_samples)

    def errors(self, true: Array, periods: int = 3) -> dict[str, tuple[float, str]]:
        """Errors of the last periods."""
        last = np.arange(true.size) >= true.size - periods * self.period
        error = (self.position - true) * 1e9
        on, off = error[last & self.line], error[last & ~self.line]
        return {"line_rms_nm": (float(np.sqrt(np.mean(on**2))), "nm"),
                "line_peak_nm": (float(np.max(np.abs(on))), "nm"),
                "turn_peak_nm": (float(np.max(np.abs(off))), "nm")}


def figures(quick: bool = False) -> list[Figure]:
    """Return the figures of all controllers."""
    stage = load_model("raster_bench")
    model, how = _identified(stage, 12.0 if quick else 40.0)
    out = _compare("", stage, model, f"design model {how}", margins=True)
    wrong = _ten_percent_off(stage)
    out += _compare(".wrong_10", stage, wrong, "designed on mass +10 %, stiffness -10 %, damping "
                    "+10 %, second mode's frequency +10 %")
    if "coulomb_friction" in EFFECTS:
        name = EFFECTS["coulomb_friction"].parameters[0].name
        rubbing = stage.with_effect("coulomb_friction", {name: 0.02})
        out += _compare(".friction", rubbing, model, "0.02 N of dry friction that the model lacks")
    out += _settling(stage, model)
    out += _paper_bars()
    out += _regulator_errors(stage)
    out += _step_times(model, 500 if quick else 5000)
    out += _random_starts(50 if quick else 1000)
    return out


def _identified(stage: Model, seconds: float) -> tuple[Model, str]:
    """Record a multisine of the stage through the node graph and identify it."""
    from dfm_stage.harness import StageGraph
    from dfm_stage.identification import Source, identify
    from dfm_stage.recording import read_record

    excitation = {"kind": "multisine", "amplitude_v": 0.08, "low_hz": 1.0, "high_hz": 70.0,
                  "period_s": seconds / 5.0}
    shake = {"name": "shake", "mode": "open_loop", "duration_s": seconds, "seed": 1,
             "axes": {"x": {"excitation": excitation}}}
    with tempfile.TemporaryDirectory(prefix="dfm_stage_bench_") as folder:
        bag = f"{folder}/bag"
        with StageGraph(model="raster_bench", lockstep=True, composed=True, bag=bag) as graph:
            graph.run(shake)
            graph.stop_recording()
        record = read_record(bag)
    start = stage.with_parameters({
        "damping": 1.3, "stiffness": 550.0, "force_constant": 1.1, "delay": 1.3e-3,
        "amplifier_time_constant": 8e-4, "second_mode.share": 0.05,
        "second_mode.frequency": 15.5, "second_mode.damping_ratio": 0.02})
    found = identify([Source("bag", record.axis("x"), record.sample_period)], model=start)
    return found.model, f"identified from a bag of {seconds:g} s multisine at 0.08 V"


def _ten_percent_off(stage: Model) -> Model:
    base = stage.base
    return stage.with_parameters({
        "mass": 1.1 * base["mass"], "stiffness": 0.9 * base["stiffness"],
        "damping": 1.1 * base["damping"], "second_mode.frequency": 1.1 * 16.02})


def _compare(suffix: str, stage: Model, model: Model, how: str,
             margins: bool = False) -> list[Figure]:
    h = stage.sample_period
    scan = Scan.make(6, h)
    tuned = {"ziegler_nichols": tune_ziegler_nichols(model), "pid": tune_pid(model, 0.52),
             "lqr": tune_lqr(model, "", 0.52)}
    feedback = _feedback(tuned["pid"].parameters)
    laws: dict[str, Law] = {
        "ziegler_nichols": Pid(_gains(tuned["ziegler_nichols"].parameters), h),
        "pid": Pid(_gains(tuned["pid"].parameters), h),
        "lqr": Lqg(design_lqr(model, LqrSpec.from_mapping(tuned["lqr"].parameters)))}
    out: list[Figure] = []

    def add(name: str, values: Mapping[str, tuple[float, str]], note: str = "") -> None:
        for what, (value, unit) in values.items():
            key = f"{name}.{what}"
            promised = BARS.get(key) if not suffix else None
            bar, kind = promised or (None, None)
            out.append(Figure(f"control.{key}{suffix}", value, unit, bar, bar_kind=kind,
                              how=f"{note}{how}"))

    for name, law in laws.items():
        true = run_on_model(stage, law, scan.position, scan.velocity, scan.acceleration)
        add(name, scan.errors(true))
    added = inverse_input(sample_model(model), scan.position)
    true = run_on_model(stage, Pid(feedback, h), scan.position, added=added)
    add("inverse", scan.errors(true), "PID and the inverse of the sampled model; ")
    add("inverse", {"effort_v": (float(np.sqrt(np.mean(added**2))), "V")}, "RMS; ")
    try:
        values, note = _learn(stage, model, feedback)
        add("learning", values, note)
    except DfmError as error:
        add("learning", {"line_rms_nm": (float("nan"), "nm")}, f"refused: {error}; ")
    if margins:
        real = sample_model(stage)
        lqr = laws["lqr"]
        assert isinstance(lqr, Lqg)
        found = {"ziegler_nichols": pid_margins(stage, _gains(
            tuned["ziegler_nichols"].parameters))[0], "pid": pid_margins(stage, feedback)[0],
            "lqr": lqr.design.margins_on(real)}
        found["inverse"] = found["learning"] = found["pid"]
        for name, each in found.items():
            add(name, {"modulus_margin": (each.modulus, "")}, "with the true stage; ")
    return out


def _gains(parameters: Mapping[str, Any]) -> PidGains:
    return PidGains.from_mapping({k: v for k, v in parameters.items() if k != "mode"})


def _feedback(parameters: Mapping[str, Any]) -> PidGains:
    """The feedback alone: it acts on the error, the inverse does the rest."""
    return _gains(parameters).changed({
        "setpoint_weight": 1.0, "derivative_weight": 1.0, "feedforward_position": 0.0,
        "feedforward_velocity": 0.0, "feedforward_acceleration": 0.0})


def _candidates(model: Model, share: float = 0.1) -> list[Any]:
    """Stages around the model: each parameter up and down by `share`."""
    names = [n for n in ("mass", "stiffness", "damping", "force_constant", "delay") if
             model.base.get(n)]
    names += [f"second_mode.{n}" for n in ("frequency", "share", "damping_ratio")
              if model.effect("second_mode")]
    values = model.parameters()
    return [sample_model(model.with_parameters({name: values[name] * factor}))
            for name in names for factor in (1.0 - share, 1.0 + share)]


def _learn(stage: Model, model: Model,
           feedback: PidGains) -> tuple[dict[str, tuple[float, str]], str]:
    """Learn for 25 passes, there and back each; errors are those of the last pass."""
    h = stage.sample_period
    scan = Scan.make(PASSES, h)
    design = design_learning(sample_model(model), lambda f: controller_response(feedback, f, h),
                             scan.period, candidates=_candidates(model))
    learner = Learner(design)
    inverse = inverse_input(sample_model(model), scan.position)
    plant, pid = Plant(stage, seed=0), Pid(feedback, h)
    read, true = np.empty(scan.position.size), np.empty(scan.position.size)
    learnt = learner.signal
    for k, r in enumerate(scan.position.tolist()):
        since = k - scan.first
        if since > 0 and since % scan.period == 0:
            learnt = learner.update(scan.position[k - scan.period:k] - read[k - scan.period:k])
        sample = plant.sample()
        read[k], true[k] = sample.reading_m, sample.position_m
        extra = inverse[k] + (learnt[since % scan.period] if since >= 0 else 0.0)
        plant.advance(pid.step(r, sample.reading_m) + float(extra))
    note = (f"pass {PASSES} there and back, contraction {design.contraction:.2f} checked against "
            f"+-10 % in each parameter{'; ' + learner.stopped if learner.stopped else ''}; ")
    return scan.errors(true, 1), note


def _settling(stage: Model, model: Model) -> list[Figure]:
    out = []
    for name, law in _laws(model).items():
        y = run_on_model(stage, law, np.full(6000, 1e-3))
        outside = np.flatnonzero(np.abs(y - 1e-3) > 1e-6)
        out.append(Figure(f"control.{name}.settling_s",
                          float(outside[-1] + 1) * stage.sample_period, "s",
                          how="1 mm step, last time further than 1 um away"))
    return out


def _laws(model: Model) -> dict[str, Law]:
    h = model.sample_period
    return {"ziegler_nichols": Pid(_gains(tune_ziegler_nichols(model).parameters), h),
            "pid": Pid(_gains(tune_pid(model, 0.52).parameters), h),
            "lqr": Lqg(design_lqr(model, LqrSpec.from_mapping(
                tune_lqr(model, "", 0.52).parameters)))}


def _paper_bars() -> list[Figure]:
    """The paper's stage: Ziegler-Nichols as it is, and the tuned PID."""
    model = load_model("paper_stage")
    zn, pid = tune_ziegler_nichols(model), tune_pid(model, 0.52)
    return [
        Figure("control.ziegler_nichols.step_um", zn.predicted["step_1mm_after_5s"] * 1e6, "um",
               5.0, bar_kind="at most", how="paper_stage, 1 mm step, largest error from 5 s on"),
        Figure("control.ziegler_nichols.sine_um", zn.predicted["sine_1mm_half_hz_peak"] * 1e6,
               "um", how="paper_stage, +-1 mm 0.5 Hz, peak after two periods, unimproved"),
        Figure("control.ziegler_nichols.paper_modulus_margin", zn.margins.modulus, "",
               how="paper_stage"),
        Figure("control.pid.sine_um", pid.predicted["sine_1mm_half_hz_peak"] * 1e6, "um", 5.0,
               bar_kind="at most", how="paper_stage, +-1 mm 0.5 Hz, peak after two periods")]


def _regulator_errors(stage: Model) -> list[Figure]:
    """The LQR's steady error without and with integral action, beside its prediction."""
    out = []
    for name, spec in (("regulator", LqrSpec(lqr_integral=False, lqr_feedforward=False)),
                       ("integral", LqrSpec())):
        design = design_lqr(stage, spec)
        rest = run_on_model(stage, Lqg(design), np.full(8000, 1e-3))[-2000:]
        error = 1e-3 - float(np.mean(rest))
        predicted = design.steady_error(sample_model(stage), 1e-3)
        out.append(Figure(
            f"control.lqr.{name}_error_nm", error * 1e9, "nm",
            50.0 if name == "integral" else None, "predicted", predicted * 1e9,
            bar_kind="at most" if name == "integral" else None,
            how="1 mm held, mean of the last 2 s"))
    return out


def _step_times(model: Model, samples: int) -> list[Figure]:
    """Median time of the law inside the controller node, fed one measurement at a time."""
    import rclpy.context

    from dfm_stage.model import save_model
    from dfm_stage.nodes.controller import Controller

    out = []
    context = rclpy.context.Context()
    rclpy.init(context=context, args=[])
    with tempfile.TemporaryDirectory(prefix="dfm_stage_bench_") as folder:
        path = f"{folder}/model.yaml"
        save_model(model, path)
        for name, mode in (("pid", "pid"), ("lqr", "lqr")):
            args = ["--ros-args", "-p", f"mode:={mode}", "-p", f"model:={path}"]
            node: Any = Controller(context=context, cli_args=args)
            took: list[int] = []
            law = node._law

            def timed(*given: Any, law: Callable[..., float] = law,
                      took: list[int] = took) -> float:
                start = time.perf_counter_ns()
                volts = law(*given)
                took.append(time.perf_counter_ns() - start)
                return volts

            node._law = timed
            sent: list[float] = []
            node._out.send = lambda *fields, sent=sent: sent.append(fields[4])
            plant = Plant(load_model("raster_bench"), seed=1)
            for k in range(samples):
                reading = plant.sample().reading_m
                node._on_measurement(SimpleNamespace(seq=k, stamp_ns=k, position=reading))
                plant.advance(sent[-1])
            node.destroy_node()
            out.append(Figure(f"control.{name}.step_us", float(np.median(took)) / 1e3, "us", 20.0,
                              bar_kind="at most",
                              how=f"median of {samples} calls of the law inside the node"))
    context.try_shutdown()
    return out


def _random_starts(count: int) -> list[Figure]:
    """Starts, forces and stages drawn at random, controllers tuned on the nominal stage."""
    stage = load_model("raster_bench")
    out = []
    for name, law in _laws(stage).items():
        rng = np.random.default_rng(11)
        outside, furthest = 0, 0.0
        for seed in range(count):
            base = stage.base
            real = stage.with_parameters({n: base[n] * rng.uniform(0.8, 1.2) for n in (
                "mass", "damping", "stiffness", "force_constant", "delay")})
            plant = Plant(real, seed=seed)
            plant.reset(position=rng.uniform(-5e-3, 5e-3), velocity=rng.uniform(-0.05, 0.05))
            force, at = rng.uniform(-1.0, 1.0), int(rng.integers(0, 300))
            worst = _reach(plant, law, Guard(stage.sample_period), float(force), at)
            furthest = max(furthest, worst)
            outside += worst > TRAVEL_M
        out.append(Figure(f"control.{name}.random_outside", float(outside), "", 0.0,
                          bar_kind="at most",
                          how=f"of {count} starts with forces up to 1 N and parameters +-20 %; "
                          f"furthest {furthest * 1e3:.2f} mm of {TRAVEL_M * 1e3:g}; the output "
                          f"never exceeds its {LIMIT_V:g} V"))
    return out


def _reach(plant: Plant, law: Law, guard: Guard, force_n: float, at: int) -> float:
    law.reset()
    furthest = 0.0
    for k in range(600):
        sample = plant.sample()
        furthest = max(furthest, abs(sample.position_m))
        volts = law.step(0.0, sample.reading_m)
        assert abs(volts) <= LIMIT_V
        if not guard.check(sample.reading_m, volts, LIMIT_V):
            volts = 0.0
        law.applied(volts)
        plant.advance(volts, external_force_n=force_n if k >= at else 0.0)
    return furthest
