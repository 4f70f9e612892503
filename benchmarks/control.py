"""Every controller on the same scans of the same stage, and what none of them may do.

The stage is config/models/raster_bench.yaml; controllers are tuned on the model that is identified
from a bag of it, recorded through the node graph. Errors are those of the plant's true position.
The page with the plots goes to out/bench/control.html, or into the folder of --keep.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.control_page import write_page
from benchmarks.control_safety import diverging, random_starts, step_times
from benchmarks.control_scan import (
    NAMES,
    RASTER,
    Controller,
    ScanRun,
    compare,
    controllers,
    drive,
    gains_of,
    raised,
)
from benchmarks.figure import BarKind, Figure
from dfm_stage.control import (
    Lqg,
    LqrSpec,
    Pid,
    design_lqr,
    parameter_text,
    sample_model,
    tune_pid,
    tune_ziegler_nichols,
)
from dfm_stage.errors import DfmError
from dfm_stage.model import CoupledPlant, Model, load_model
from dfm_stage.trajectory import make_reference

FORCE_N = 0.3
WITHOUT_KNOWING = ("line_rms_nm", "line_peak_nm", "turn_peak_nm", "modulus_margin")
BARS: dict[str, tuple[float, BarKind]] = {
    "pid.line_rms_nm": (2000.0, "at most"), "lqr.line_rms_nm": (2000.0, "at most"),
    "inverse.line_rms_nm": (2000.0, "at most"), "learning.line_rms_nm": (100.0, "at most"),
    "pid.modulus_margin": (0.5, "at least"), "lqr.modulus_margin": (0.5, "at least"),
    "inverse.modulus_margin": (0.5, "at least"), "learning.modulus_margin": (0.5, "at least")}


def figures(quick: bool = False, keep: Path | None = None) -> list[Figure]:
    """Return the figures of all controllers; write the page into `keep`."""
    folder = keep or Path("out/bench")
    folder.mkdir(parents=True, exist_ok=True)
    stage = load_model("raster_bench")
    seconds = 12.0 if quick else 40.0
    out: list[Figure] = []
    with tempfile.TemporaryDirectory(prefix="dfm_stage_bench_") as scratch:
        model = _identified("raster_bench", _blurred(stage), seconds, Path(scratch))
        paper = _identified("paper_stage", load_model("paper_stage").with_parameters(
            {"damping": 1.3, "stiffness": 550.0, "force_constant": 1.2, "delay": 1.3e-3}),
            seconds, Path(scratch))
        how = f"identified from a bag of {seconds:g} s multisine at 0.08 V"
        tuned = controllers(model, stage)
        scenarios = _scenarios(stage, model)
        for suffix, runs in scenarios.items():
            out += _of_scenario(suffix, runs, how)
        out += _on_the_graph(tuned, Path(scratch))
        out += _paper_bars(load_model("paper_stage"), paper, how)
        out += _regulator_errors(stage, model)
        out += _two_axes()
        out += step_times(tuned, 500 if quick else 5000, Path(scratch))
        out += diverging(stage)
        out += random_starts(controllers(stage, stage), stage, 50 if quick else 1000)
    print(f"page: {write_page(scenarios, out, folder)}", file=sys.stderr)
    return out


def _scenarios(stage: Model, model: Model) -> dict[str, dict[str, ScanRun]]:
    """Return what all controllers did, by what their model knows of the stage."""
    base = stage.base
    wrong = stage.with_parameters({
        "mass": 1.1 * base["mass"], "stiffness": 0.9 * base["stiffness"],
        "damping": 1.1 * base["damping"], "second_mode.frequency": 1.1 * 16.02})

    def extended(one: Model) -> Model:
        return (one.with_effect("cubic_stiffness", {"k3": 2e7})
                .with_effect("coulomb_friction", {"force": 0.02})
                .with_effect("force_constant_slope", {"slope": 10.0}))

    pairs = {"": (stage, model), ".wrong_10": (stage, wrong),
             ".friction": (stage.with_effect("coulomb_friction", {"force": 0.02}), model),
             ".effects": (extended(stage), model),
             ".redesigned": (extended(stage), extended(model))}
    out = {}
    for suffix, (real, design) in pairs.items():
        try:
            out[suffix] = compare(real, design)
        except DfmError as error:
            print(f"{suffix}: {error}", file=sys.stderr)
    return out


def _of_scenario(suffix: str, runs: dict[str, ScanRun], how: str) -> list[Figure]:
    out = []
    notes = {"": f"model {how}", ".wrong_10": "model with mass +10 %, stiffness -10 %, damping "
             "+10 %, second mode's frequency +10 %", ".friction": "0.02 N of dry friction that "
             "the model lacks", ".effects": "cubic stiffness, friction, force constant's slope "
             "that the model lacks", ".redesigned": "the same effects, known to the model"}
    for name in NAMES:
        run = runs[name]
        values = run.figures(1 if name == "learning" else 3)
        if run.margins is not None:
            values["modulus_margin"] = (run.margins.modulus, "")
        for what, (value, unit) in values.items():
            if suffix and what not in WITHOUT_KNOWING:
                continue
            bar, kind = (BARS.get(f"{name}.{what}") if not suffix else None) or (None, None)
            out.append(Figure(f"control.{name}.{what}{suffix}", value, unit, bar, bar_kind=kind,
                              how="; ".join(filter(None, (run.note, notes[suffix])))))
    return out


def _blurred(stage: Model) -> Model:
    """Where identification starts from: nothing of it is right."""
    return stage.with_parameters({
        "damping": 1.3, "stiffness": 550.0, "force_constant": 1.1, "delay": 1.3e-3,
        "amplifier_time_constant": 8e-4, "second_mode.share": 0.05,
        "second_mode.frequency": 15.5, "second_mode.damping_ratio": 0.02})


def _identified(plant: str, start: Model, seconds: float, folder: Path) -> Model:
    """Record a multisine of the stage through the node graph and identify it."""
    from dfm_stage.cli.graph_run import run_on_graph
    from dfm_stage.identification import Source, identify

    excitation = {"kind": "multisine", "amplitude_v": 0.08, "low_hz": 1.0, "high_hz": 70.0,
                  "period_s": seconds / 5.0}
    record = run_on_graph({"name": "shake", "mode": "open_loop", "duration_s": seconds, "seed": 1,
                           "axes": {"x": {"excitation": excitation}}}, folder / plant, model=plant)
    return identify([Source("bag", record.axis("x"), record.sample_period)], model=start).model


def _on_the_graph(tuned: list[Controller], folder: Path) -> list[Figure]:
    """The tuned PID's scan through the node graph, beside what the model predicts."""
    from dfm_stage.cli.graph_run import run_on_graph
    from dfm_stage.cli.tune_verify import compare as beside

    pid = next(each for each in tuned if each.name == "pid")
    file = folder / "pid_graph.yaml"
    file.write_text(parameter_text({"/stage/x/controller": pid.tuned.parameters}), "utf-8")
    run = {"name": "scan", "mode": "pid", "duration_s": 4.5, "controller": str(file),
           "axes": {"x": {"reference": RASTER}}}
    record = run_on_graph(run, folder / "pid_scan", model="raster_bench")
    found = beside(record, "x", run, pid.model, pid.tuned)
    return [Figure("control.pid.graph_line_rms_nm", found.achieved_rms_m * 1e9, "nm",
                   peer="predicted on the identified model",
                   peer_value=found.predicted_rms_m * 1e9,
                   ratio=found.achieved_rms_m / found.predicted_rms_m,
                   how="r - y as measured, on the node graph in lockstep")]


def _paper_bars(stage: Model, model: Model, how: str) -> list[Figure]:
    """The paper's stage: Ziegler-Nichols as it is, and the tuned PID from an identified model."""
    h = stage.sample_period
    zn = tune_ziegler_nichols(stage, raised(stage).outcome)
    tuned = tune_pid(model, 0.52)
    classic = Controller("ziegler_nichols", Pid(gains_of(zn), h), stage, zn)
    pid = Controller("pid", Pid(gains_of(tuned), h), model, tuned)
    sine = make_reference({"kind": "sine", "amplitude_m": 1e-3, "frequency_hz": 0.5},
                          sample_period_s=h, duration_s=12.0)
    step = make_reference({"kind": "steps", "levels_m": [0.0, 1e-3], "dwell_s": 0.5},
                          sample_period_s=h, duration_s=9.0)
    late = slice(round(5.5 / h), None)

    def peak(controller: Controller) -> float:
        true = drive(stage, controller, sine)[0]
        return 1e6 * float(np.max(np.abs(true - sine.position)[round(4.0 / h):]))

    after = np.abs(drive(stage, classic, step)[0] - step.position)[late]
    return [
        Figure("control.ziegler_nichols.step_um", 1e6 * float(np.max(after)), "um", 5.0,
               bar_kind="at most", how="paper_stage, gain raised on the loop, 1 mm step, largest "
               "error from 5 s on"),
        Figure("control.ziegler_nichols.sine_um", peak(classic), "um",
               how="paper_stage, +-1 mm 0.5 Hz, peak after two periods, unimproved"),
        Figure("control.ziegler_nichols.paper_modulus_margin", zn.margins.modulus, "",
               how="paper_stage, unimproved"),
        Figure("control.pid.sine_um", peak(pid), "um", 5.0, bar_kind="at most",
               how=f"paper_stage, +-1 mm 0.5 Hz without a ramp, peak after two periods; {how}")]


def _regulator_errors(stage: Model, model: Model) -> list[Figure]:
    """The LQR's steady error without and with integral action, beside its prediction."""
    out = []
    hold = make_reference({"kind": "hold", "position_m": 1e-3}, duration_s=8.0,
                          sample_period_s=stage.sample_period)
    for name, force, spec in (
            ("regulator", 0.0, LqrSpec(lqr_integral=False, lqr_feedforward=False)),
            ("integral", 0.0, LqrSpec()),
            ("force", FORCE_N, LqrSpec(lqr_integral=False)),
            ("force_estimated", FORCE_N, LqrSpec(lqr_integral=False, lqr_disturbance=True)),
            ("force_integral", FORCE_N, LqrSpec())):
        design = design_lqr(model, spec)
        law = Controller("lqr", Lqg(design), model, tune_pid(model))
        error = 1e-3 - float(np.mean(drive(stage, law, hold, force_n=force)[0][-2000:]))
        predicted = design.steady_error(sample_model(model), 1e-3, force)
        judged = name not in ("regulator", "force")
        out.append(Figure(
            f"control.lqr.{name}_error_nm", abs(error) * 1e9, "nm", 50.0 if judged else None,
            "predicted from the identified model", abs(predicted) * 1e9,
            None if judged else error / predicted, bar_kind="at most" if judged else None,
            how=f"1 mm held{f' against {force:g} N' if force else ''}, mean of the last 2 s"))
    return out


def _two_axes() -> list[Figure]:
    """Both axes of the coupled stage in one scan, each under its own tuned PID."""
    model = load_model("xy_stage")
    h = model.sample_period
    plant = CoupledPlant(model, seed=1)
    scans = [make_reference({"kind": "lissajous", "amplitude_m": 1e-3, "pattern_s": 4.0,
                             "cycles": cycles, "ramp_s": 1.0}, sample_period_s=h, duration_s=6.0)
             for cycles in (4, 3)]
    laws = [Pid(gains_of(tune_pid(model.axis(axis), 0.52)), h) for axis in plant.axes]
    points = [np.column_stack((s.position, s.velocity, s.acceleration)).tolist() for s in scans]
    true = np.empty((2, scans[0].position.size))
    for k in range(true.shape[1]):
        samples = plant.sample()
        true[:, k] = [each.position_m for each in samples]
        plant.advance([law.step(p[k][0], s.reading_m, p[k][1], p[k][2])
                       for law, p, s in zip(laws, points, samples, strict=True)])
    return [Figure(f"control.xy.{axis}_rms_nm",
                   1e9 * float(np.sqrt(np.mean((s.position - y)[2000:]**2))), "nm",
                   how="Lissajous of 1 mm with 1 and 0.75 Hz on the coupled stage, PID tuned on "
                   "each axis alone")
            for axis, s, y in zip(plant.axes, scans, true, strict=True)]
