"""The same scan, step and rest for every controller, errors taken from the plant's truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dfm_stage.control import (
    EffectInput,
    Law,
    Learner,
    Lqg,
    Margins,
    Pid,
    PidGains,
    Tuned,
    design_learning,
    inverse_of,
    law_of,
    neighbours,
    sample_model,
    tune_lqr,
    tune_pid,
    tune_ziegler_nichols,
)
from dfm_stage.control.stage import controller_response
from dfm_stage.control.tuning import pid_margins
from dfm_stage.control.tuning_runs import GainRaising
from dfm_stage.model import Model, Plant
from dfm_stage.trajectory import Reference, make_reference

Array = NDArray[np.float64]
PASSES, PERIODS = 25, 6
MARGIN = 0.52
LIMIT_V = 10.0
STEP_M, SETTLED_M = 1e-3, 1e-6
RASTER = {"kind": "raster", "line_length_m": 5e-3, "line_time_s": 0.4, "turnaround_s": 0.1,
          "lead_in_s": 0.5}
_KNOWN: list[tuple[Model, tuple[Tuned, Tuned, Tuned]]] = []
NAMES = ("ziegler_nichols", "pid", "lqr", "inverse", "learning")


@dataclass
class Controller:
    """A law with its feedforward, tuned on a model; `tuned` says what it promises."""

    name: str
    law: Law
    model: Model
    tuned: Tuned
    forward: EffectInput | None = None
    inverse: bool = False

    @property
    def gains(self) -> PidGains | None:
        """The PID's gains, where it is one."""
        return self.law.gains if isinstance(self.law, Pid) else None


@dataclass
class ScanRun:
    """What a controller did: errors, m, on the scan's samples; volts; what else was found."""

    error: Array
    volts: Array
    scan: Reference
    settling_s: float = float("nan")
    margins: Margins | None = None
    note: str = ""
    per_pass_m: list[float] = field(default_factory=list)

    def figures(self, periods: int = 3) -> dict[str, tuple[float, str]]:
        """Return errors of the last periods, in nm, on the line and at the turnarounds."""
        last = np.arange(self.error.size) >= self.error.size - periods * self.scan.period_samples
        nm = self.error * 1e9
        on, off = nm[last & self.scan.steady], nm[last & ~self.scan.steady]
        out = {"line_rms_nm": (_rms(on), "nm"), "line_peak_nm": (_peak(on), "nm"),
               "turn_rms_nm": (_rms(off), "nm"), "turn_peak_nm": (_peak(off), "nm"),
               "effort_v": (_rms(self.volts[last]), "V")}
        if np.isfinite(self.settling_s):
            out["settling_s"] = (self.settling_s, "s")
        return out


def scan_of(periods: int, h: float) -> Reference:
    """Return the raster of the comparison."""
    return make_reference(RASTER, sample_period_s=h, duration_s=0.5 + periods)


def gains_of(tuned: Tuned) -> PidGains:
    """Return the gains among tuned parameters."""
    return PidGains.from_mapping({name: value for name, value in tuned.parameters.items()
                                  if name not in ("mode", "model", "feedforward")})


def controllers(model: Model, stage: Model) -> list[Controller]:
    """Return every controller but learning, tuned on `model`; the paper's on the `stage` itself.

    The Ziegler-Nichols gains come from raising the gain on the running stage, as the paper does.
    """
    classic = tune_ziegler_nichols(model, raised(stage).outcome)
    pid, lqr, inverse = _tuned(model)
    out = []
    for name, tuned in (("ziegler_nichols", classic), ("pid", pid), ("lqr", lqr),
                        ("inverse", inverse)):
        law, forward = law_of(tuned.parameters, model)
        out.append(Controller(name, law, model, tuned, forward, inverse=name == "inverse"))
    return out


def _tuned(model: Model) -> tuple[Tuned, Tuned, Tuned]:
    """Return PID, LQR and PID with inverse of a model, tuned once."""
    for known, found in _KNOWN:
        if known is model:
            return found
    found = (tune_pid(model, MARGIN, model_name="model.yaml"),
             tune_lqr(model, "model.yaml", MARGIN),
             tune_pid(model, MARGIN, model_name="model.yaml", feedforward="inverse"))
    _KNOWN.append((model, found))
    return found


def raised(stage: Model) -> GainRaising:
    """Raise a gain on the running stage until it oscillates, and return the finished run."""
    run, plant = GainRaising(stage.sample_period), Plant(stage, seed=3)
    while not run.ended:
        plant.advance(run.step(plant.sample().reading_m))
    return run


def drive(stage: Model, controller: Controller, reference: Reference, seed: int = 0,
          each: Callable[[int, Array], Array] | None = None,
          force_n: float = 0.0) -> tuple[Array, Array]:
    """Return true position and voltage (N,) along a reference, against a constant force.

    `each(k, readings)` may give the added voltage from sample k on for the rest of the run.
    """
    x, v, a = reference.position, reference.velocity, reference.acceleration
    added = np.zeros(x.size)
    if controller.inverse:
        added = inverse_of(controller.model, x, v, a)
    law, forward, plant = controller.law, controller.forward, Plant(stage, seed=seed)
    law.reset()
    true, read, volts = np.empty(x.size), np.empty(x.size), np.empty(x.size)
    for k, (r, rv, ra) in enumerate(zip(x.tolist(), v.tolist(), a.tolist(), strict=True)):
        if each is not None:
            added = each(k, read)
        sample = plant.sample()
        true[k], read[k] = sample.position_m, sample.reading_m
        effects = forward.ahead(r, rv, ra) if forward is not None else 0.0
        asked = law.step(r, sample.reading_m, rv, ra, 0.0, effects)
        volts[k] = min(LIMIT_V, max(-LIMIT_V, asked + float(added[k])))
        law.observe(float(volts[k]) - effects)
        plant.advance(float(volts[k]), external_force_n=force_n)
    return true, volts


def compare(stage: Model, model: Model) -> dict[str, ScanRun]:
    """Return what every controller does on a stage when it was tuned on a model."""
    h = stage.sample_period
    scan = scan_of(PERIODS, h)
    step = make_reference({"kind": "hold", "position_m": STEP_M}, sample_period_s=h,
                          duration_s=6.0)
    out: dict[str, ScanRun] = {}
    for each in controllers(model, stage):
        true, volts = drive(stage, each, scan)
        run = ScanRun(scan.position - true, volts, scan)
        if not each.inverse:
            stood = drive(stage, each, step)[0]
            outside = np.flatnonzero(np.abs(stood - STEP_M) > SETTLED_M)
            run.settling_s = float(outside[-1] + 1) * h if outside.size else 0.0
        run.margins = _margins(each, stage)
        out[each.name] = run
        if each.inverse:
            out["learning"] = learned(stage, each)
            out["learning"].margins = run.margins
    return out


def _margins(controller: Controller, stage: Model) -> Margins:
    if controller.gains is not None:
        return pid_margins(stage, controller.gains)[0]
    law = controller.law
    assert isinstance(law, Lqg)
    return law.design.margins_on(sample_model(stage))


def learned(stage: Model, controller: Controller, passes: int = PASSES) -> ScanRun:
    """Learn for passes of one line there and back each; the error is that of the last one.

    Raises
    ------
    ControlError
        If the convergence condition does not hold for parameters 10 % off.
    """
    h, gains, model = stage.sample_period, controller.gains, controller.model
    assert gains is not None
    scan = scan_of(passes, h)
    period, first = scan.period_samples, scan.start_samples
    design = design_learning(sample_model(model), lambda f: controller_response(gains, f, h),
                             period, candidates=neighbours(model))
    learner = Learner(design)
    added = inverse_of(model, scan.position, scan.velocity, scan.acceleration)
    ahead = added.copy()

    def learn(k: int, read: Array) -> Array:
        since = k - first
        if since > 0 and since % period == 0:
            learner.update(scan.position[k - period:k] - read[k - period:k])
        if since >= 0 and since % period == 0:
            added[k:k + period] = ahead[k:k + period] + learner.signal
        return added

    plain = Controller("learning", controller.law, model, controller.tuned)
    true, volts = drive(stage, plain, scan, each=learn)
    error = scan.position - true
    note = (f"pass {passes} there and back, contraction {design.contraction:.2f} checked against "
            f"+-10 % in each parameter{'; ' + learner.stopped if learner.stopped else ''}")
    found = ScanRun(error, volts, scan, note=note)
    for k in range(passes):
        one = slice(first + k * period, first + (k + 1) * period)
        found.per_pass_m.append(_rms(error[one][scan.steady[one]]))
    return found


def tabled(runs: Mapping[str, ScanRun]) -> tuple[list[str], list[list[str | float | None]]]:
    """Return columns and rows of the comparison."""
    columns = ["controller", "line RMS / nm", "line peak / nm", "turn RMS / nm", "turn peak / nm",
               "effort RMS / V", "1 mm step settles / s", "modulus margin", "gain margin",
               "phase margin / deg"]
    rows: list[list[str | float | None]] = []
    for name, run in runs.items():
        values = run.figures(1 if name == "learning" else 3)
        row: list[str | float | None] = [name, *(values[key][0] for key in (
            "line_rms_nm", "line_peak_nm", "turn_rms_nm", "turn_peak_nm", "effort_v"))]
        row.append(run.settling_s if np.isfinite(run.settling_s) else None)
        m = run.margins
        row += [m.modulus, m.gain, m.phase_deg] if m is not None else [None] * 3
        rows.append(row)
    return columns, rows


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _peak(values: Array) -> float:
    return float(np.max(np.abs(values), initial=0.0))
