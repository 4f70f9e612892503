"""All the laws of one axis: one is in force, the others follow it, so that it can be changed.

Every sample is `step`, which gives what the law in force asks for, then `tell`, which says what
went out. A law that is not in force is told the same and goes on from there without a bump. The
output of the last law fades out smoothly where `open_loop` takes over, because there nothing
follows: an input that ends at once would shake the stage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PID_PARAMETERS, PidGains
from dfm_stage.control.lqg import Lqg
from dfm_stage.control.lqr import LQR_PARAMETERS, LqrDesign, LqrSpec, design_lqr
from dfm_stage.control.model_feedforward import ModelFeedforward
from dfm_stage.control.modes import highest_mode
from dfm_stage.control.pid import Pid
from dfm_stage.control.shaping import ReferenceShaper, shaper
from dfm_stage.control.stage import command_limit
from dfm_stage.control.tuning_runs import TUNING_PARAMETERS, GainRaising, RelayRun, TuningRun
from dfm_stage.model import Model
from dfm_stage.model.parameter import Parameter

MODES = ("open_loop", "pid", "lqr")
FEEDFORWARD = ("gains", "model")
NOTCH = ("given", "model")
SHAPERS = {"none": 0, "zv": 2, "zvd": 3, "zvdd": 4}
TUNING_RUNS: dict[str, type[TuningRun]] = {"raise_gain": GainRaising, "relay": RelayRun}
LQR_SWITCHES = ("lqr_integral", "lqr_disturbance", "lqr_feedforward")
SHAPER_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("shaper_hz", 0.0, "Hz", "frequency that the shaped reference does not wake; 0 = the "
              "highest mode of `model`", 0.0, 1e6),
    Parameter("shaper_damping", 0.0, "", "its damping ratio, where shaper_hz is given", 0.0, 0.99),
    Parameter("handover_s", 0.2, "s", "time in which the last law's output fades out where "
              "open_loop takes over", 0.0, 1e3),
)
_PID_NAMES = (*(parameter.name for parameter in PID_PARAMETERS), "anti_windup")
_LQR_NAMES = (*(parameter.name for parameter in LQR_PARAMETERS), *LQR_SWITCHES)
_TUNING_NAMES = tuple(parameter.name for parameter in TUNING_PARAMETERS)


class Point(NamedTuple):
    """A reference: m, m/s, m/s^2."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class Plan(NamedTuple):
    """What a set of parameter values comes to: checked and designed, ready to be taken over."""

    mode: str
    gains: PidGains
    limit_v: float
    feedforward: ModelFeedforward | None
    shaping: tuple[float, ...]
    design: LqrDesign | None


def plan_laws(values: Mapping[str, Any], model: Model | None,
              last: LqrDesign | None = None) -> Plan:
    """Return what the parameters of a controller node come to; `last` is reused if it fits.

    Raises
    ------
    ControlError
        If values are unusable, or ask for something of a model and there is none.
    """
    for name, wanted in (("mode", "lqr"), ("feedforward", "model"), ("notch", "model")):
        if model is None and values[name] == wanted:
            raise ControlError(f"{name} {wanted} needs the parameter model: a model.yaml, or a "
                               "name in config/models")
    limit = values["output_limit_v"]
    if model is not None:
        limit = command_limit(model, limit)
    gains = PidGains(**{name: values[name] for name in _PID_NAMES}).changed(
        {"output_limit_v": limit})
    if model is not None and values["notch"] == "model":
        frequency, damping = highest_mode(model)
        gains = gains.changed({"notch_hz": frequency, "notch_depth_damping": damping})
    feedforward = None
    if model is not None and values["feedforward"] == "model":
        gains = gains.without_feedforward()
        feedforward = ModelFeedforward(model, gains)
    Pid(gains, values["sample_period_s"])
    return Plan(values["mode"], gains, limit, feedforward, _shaping(values, model),
                _design(values, model, last) if model is not None else None)


def _shaping(values: Mapping[str, Any], model: Model | None) -> tuple[float, ...]:
    impulses = SHAPERS[values["shaper"]]
    if not impulses:
        return ()
    frequency, damping = values["shaper_hz"], values["shaper_damping"]
    if frequency == 0.0:
        if model is None:
            raise ControlError("shaper needs shaper_hz, or the parameter model for its mode")
        frequency, damping = highest_mode(model)
    return tuple(shaper(frequency, damping, values["sample_period_s"], impulses).tolist())


def _design(values: Mapping[str, Any], model: Model, last: LqrDesign | None) -> LqrDesign:
    spec, period = LqrSpec.from_mapping(values), values["sample_period_s"]
    if last is not None and (last.spec, last.model, last.sample_period_s) == (spec, model, period):
        return last
    return design_lqr(model, spec, period)


class Laws:
    """The laws of one axis, run by the values of a controller's parameters.

    `mode` is the one in force, `run` the tuning run if there is one, `limit_v` the largest output.
    """

    def __init__(self, values: Mapping[str, Any], plan: Plan) -> None:
        self.period_s: float = values["sample_period_s"]
        self.pid = Pid(plan.gains, self.period_s)
        self.lqg: Lqg | None = None
        self.run: TuningRun | None = None
        self.mode: str = plan.mode
        self.limit_v: float = plan.limit_v
        self._feedforward = plan.feedforward
        self._forward_v = self._effects_v = 0.0
        self._shaper: ReferenceShaper | None = None
        self._shaping: tuple[float, ...] = ()
        self._point: Point | tuple[float, float, float] = Point()
        self._law_v = 0.0
        self._controls = True
        self._fade = self._fade_samples = 0
        self._fade_from_v = 0.0
        self._take(plan)
        self._start_tuning(values)

    def _take(self, plan: Plan) -> None:
        self.limit_v = plan.limit_v
        if plan.shaping != self._shaping:
            self._shaping = plan.shaping
            self._shaper = ReferenceShaper(plan.shaping) if plan.shaping else None
        if plan.design is None:
            self.lqg = None
        elif self.lqg is None:
            self.lqg = Lqg(plan.design, plan.limit_v)
        else:
            self.lqg.set_output_limit(plan.limit_v)
            if self.lqg.design is not plan.design:
                self.lqg.set_design(plan.design)

    def change(self, values: Mapping[str, Any], plan: Plan, names: set[str]) -> None:
        """Take over new values without a bump; `names` are those that changed."""
        if plan.gains != self.pid.gains:
            self.pid.set_gains(plan.gains)
        self._feedforward = plan.feedforward
        if plan.feedforward is None:
            self._forward_v = self._effects_v = 0.0
        if names & {"feedforward", "model"} and self.mode == "pid":
            self._follow_with_pid()
        self._take(plan)
        if plan.mode == "open_loop" and self.mode != "open_loop":
            self._fade_samples = self._fade = round(values["handover_s"] / self.period_s)
            self._fade_from_v = self._law_v
        self.mode = plan.mode
        if names & {"mode", "tuning", *_TUNING_NAMES}:
            self._start_tuning(values)

    def _follow_with_pid(self) -> None:
        """Let the PID go on from what went out last, with the feedforward there is now."""
        last = self.pid.last_position_m
        if last is not None:
            self._forward_v = self._feedforward.at(*self._point) if self._feedforward else 0.0
            self.pid.track(self._law_v, self._point[0], last, self._point[1], self._point[2],
                           self._forward_v)

    def _start_tuning(self, values: Mapping[str, Any]) -> None:
        make = TUNING_RUNS.get(values["tuning"]) if self.mode == "pid" else None
        self.run = make(self.period_s, **{name: values[name] for name in _TUNING_NAMES}
                        ) if make else None

    def step(self, reference: Any, position_m: float, samples: int, allowed: bool = True) -> float:
        """Return what the law in force asks for, V.

        `reference` has position, velocity and acceleration; `samples` have passed since the last
        call; without `allowed` no law is in force.
        """
        if self._shaper is None:
            point = (reference.position, reference.velocity, reference.acceleration)
        else:
            point = self._shaper.step(reference.position, reference.velocity,
                                      reference.acceleration)
        self._point = point
        if self._feedforward is not None:
            linear, self._effects_v = self._feedforward.parts(*point)
            self._forward_v = linear + self._effects_v
        mode, run = self.mode, self.run
        self._controls = allowed and run is None
        if not allowed:
            return 0.0
        if run is not None:
            return run.step(position_m)
        if mode == "pid":
            return self.pid.step(point[0], position_m, point[1], point[2], samples * self.period_s,
                                 self._forward_v)
        if mode == "lqr" and self.lqg is not None:
            return self._effects_v + self.lqg.step(point[0], position_m, point[1], point[2],
                                                   samples * self.period_s)
        if self._fade > 0:
            self._fade -= 1
            u = self._fade / self._fade_samples
            return self._fade_from_v * u * u * (3.0 - 2.0 * u)
        return 0.0

    def tell(self, position_m: float, voltage: float, added: float, limited: bool) -> bool:
        """Tell all laws what goes out; return whether the one in force was limited.

        `voltage` goes out, `added` of it is not the law's; `limited` where it is not what law and
        addition asked for.
        """
        pid, lqg, law = self.pid, self.lqg, voltage - added
        self._law_v = law
        r, v, a = self._point
        by_pid = self._controls and self.mode == "pid"
        by_lqr = self._controls and self.mode == "lqr"
        usable = math.isfinite(law + r + position_m + v + a)
        if by_pid:
            if limited:
                pid.applied(law)
        elif usable:
            pid.track(law, r, position_m, v, a, self._forward_v)
        if lqg is not None:
            # What cancels the effects is not for a filter that does not know them.
            effects = self._effects_v if by_pid or by_lqr else 0.0
            if not by_lqr and usable:
                lqg.track(law - self._effects_v, r, position_m, v, a)
            lqg.applied(voltage - effects)
        return (by_pid and pid.saturated) or (by_lqr and lqg is not None and lqg.saturated)

    def applied(self, voltage: float, added: float) -> None:
        """Say what the amplifier gave, where that is not what was told: it limits or is off."""
        if self._controls and self.mode == "pid":
            self.pid.applied(voltage - added)
        if self.lqg is not None:
            effects = self._effects_v if self._controls and self.mode != "open_loop" else 0.0
            self.lqg.applied(voltage - effects, self._law_v + added - voltage)
