"""All the laws of one axis: one is in force, the others follow it, so that it can be changed.

Every sample is `step`, which gives what the law in force asks for, then `update`, which says what
went out. A law that is not in force follows that and goes on from there without a bump. The
output of the last law fades out smoothly where `open_loop` takes over, because there nothing
follows: an input that ends at once would excite its modes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from dfm_stage.control.errors import ControlError
from dfm_stage.control.feedforward import EffectInput
from dfm_stage.control.law import OUTPUT_LIMIT, Entry, Law, Setup, checked
from dfm_stage.control.laws import LAWS, OPEN_LOOP, Laws, modes
from dfm_stage.control.shaping import ReferenceShaper, shaper
from dfm_stage.control.stage import command_limit, highest_mode
from dfm_stage.control.tuning_runs import TuningRun
from dfm_stage.model import Model
from dfm_stage.model.parameter import Option, Parameter

SHAPERS = {"none": 0, "zv": 2, "zvd": 3, "zvdd": 4}
SHAPER_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("shaper_hz", 0.0, "Hz", "frequency that the shaped reference does not excite; 0 = "
              "the highest mode of `model`", 0.0, 1e6),
    Parameter("shaper_damping", 0.0, "", "its damping ratio, where shaper_hz is given", 0.0, 0.99),
    Parameter("handover_s", 0.2, "s", "time in which the last law's output fades out where "
              "open_loop takes over", 0.0, 1e3),
)
# What holds for every law of an axis.
AXIS_PARAMETERS: tuple[Entry, ...] = (
    OUTPUT_LIMIT,
    Option("model", "", "model.yaml, a path or a name in config/models: laws may be designed on "
           "it, feedforward, notch and shaper may be taken from it, and its saturation limits the "
           "output"),
    Option("feedforward", "gains", "what the law adds for the reference: what its own gains say, "
           "or the inverse of model with its springs, friction and force constant",
           ("gains", "model")),
    Option("shaper", "none", "shape the reference so that it does not excite a mode: two, three "
           "or four impulses", tuple(SHAPERS)),
    *SHAPER_PARAMETERS,
)


class Point(NamedTuple):
    """A reference: m, m/s, m/s^2."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class Plan(NamedTuple):
    """What a set of parameter values comes to: checked and designed, ready to be taken over.

    `model` is what it was designed with.
    """

    model: Model | None
    mode: str
    limit_v: float
    effects: EffectInput | None
    shaping: tuple[float, ...]
    laws: Mapping[str, Any]


def plan_laws(values: Mapping[str, Any], model: Model | None, laws: Laws = LAWS) -> Plan:
    """Return what the parameters of a controller node come to.

    Raises
    ------
    ControlError
        If values are unusable, or ask for something of a model and there is none.
    """
    mode, by_model = values["mode"], values["feedforward"] == "model"
    if mode not in modes(laws):
        raise ControlError(f"mode must be one of {', '.join(modes(laws))}, not {mode!r}")
    limit = values[OUTPUT_LIMIT.name]
    setup = Setup(values, values["sample_period_s"],
                  limit if model is None else command_limit(model, limit), model, by_model)
    if mode != OPEN_LOOP and laws[mode].needs_model:
        setup.need_model(f"mode {mode}")
    effects = EffectInput(setup.need_model("feedforward model")) if by_model else None
    plans = {name: law.plan(setup) for name, law in laws.items()
             if model is not None or not law.needs_model}
    return Plan(model, mode, setup.output_limit_v, effects if effects and effects.any else None,
                _shaping(setup), plans)


def _shaping(setup: Setup) -> tuple[float, ...]:
    values = setup.values
    impulses = SHAPERS[values["shaper"]]
    if not impulses:
        return ()
    frequency, damping = values["shaper_hz"], values["shaper_damping"]
    if frequency == 0.0:
        if setup.model is None:
            raise ControlError("shaper needs shaper_hz, or the parameter model for its mode")
        frequency, damping = highest_mode(setup.model)
    return tuple(shaper(frequency, damping, setup.sample_period_s, impulses).tolist())


def law_of(parameters: Mapping[str, Any], model: Model,
           laws: Laws = LAWS) -> tuple[Law, EffectInput | None]:
    """Return the law that a controller's parameters ask for, at rest, and what the effects of the
    model take beside it; `model` stands for the parameter of that name.

    Raises
    ------
    ControlError
        As `plan_laws`, or if a value is not in the range of its table.
    """
    plan, kind = _plan_of(parameters, model, laws)
    return kind.start(plan.laws[kind.name], model.sample_period), plan.effects


def response_of(parameters: Mapping[str, Any], model: Model, frequency_hz: Any) -> Any:
    """Return the response from -y to u, V/m, complex (F,), of the law that parameters ask for."""
    plan, kind = _plan_of(parameters, model, LAWS)
    return kind.response(plan.laws[kind.name], frequency_hz, model.sample_period)


def _plan_of(parameters: Mapping[str, Any], model: Model, laws: Laws) -> tuple[Plan, type[Law]]:
    name = parameters["mode"]
    if name not in laws:
        raise ControlError(f"mode must be one of {', '.join(laws)}, not {name!r}")
    values = checked((*AXIS_PARAMETERS, *laws[name].parameters), parameters, name)
    values |= {"mode": name, "sample_period_s": model.sample_period}
    return plan_laws(values, model, {name: laws[name]}), laws[name]


class LawSet:
    """The laws of one axis, run by the values of a controller's parameters.

    `by_name` are the laws there are, `mode` names the one in force, `run` is the tuning run if
    there is one, `limit_v` the largest output.
    """

    def __init__(self, values: Mapping[str, Any], plan: Plan, laws: Laws = LAWS) -> None:
        self.period_s: float = values["sample_period_s"]
        self.by_name: dict[str, Law] = {}
        self.run: TuningRun | None = None
        self._kinds = laws
        self._shaper: ReferenceShaper | None = None
        self._point: Point | tuple[float, float, float] = Point()
        self._in_control: Law | None = None
        self._forward_v = self._law_v = self._fade_from_v = 0.0
        self._fade = self._fade_samples = 0
        self._plan = plan._replace(shaping=(), laws={})
        self._take(plan)
        self._start_tuning(values)

    def _take(self, plan: Plan) -> None:
        """Run on a plan: start laws that are new, change those that are there, drop the others."""
        last, self._plan = self._plan, plan
        self.mode, self.limit_v, self._effects = plan.mode, plan.limit_v, plan.effects
        if plan.shaping != last.shaping:
            self._shaper = ReferenceShaper(plan.shaping) if plan.shaping else None
        before = self._forward_v
        self._forward_v = plan.effects.ahead(*self._point) if plan.effects else 0.0
        laws = {}
        for name, wanted in plan.laws.items():
            law = self.by_name.get(name)
            if law is None:
                law = self._kinds[name].start(wanted, self.period_s)
            elif wanted != last.laws[name] or self._forward_v != before:
                law.change(wanted, self._forward_v)
            laws[name] = law
        self.by_name = laws
        self._all = tuple(laws.values())
        self._law = laws.get(plan.mode)
        self._others = tuple(each for each in self._all if each is not self._law)
        self._observers = tuple(each for each in self._all
                                if type(each).observe is not Law.observe)

    def change(self, values: Mapping[str, Any], plan: Plan, names: set[str]) -> None:
        """Take over new values without a bump; `names` are those that changed."""
        if plan.mode == OPEN_LOOP and self.mode != OPEN_LOOP:
            self._fade_samples = self._fade = round(values["handover_s"] / self.period_s)
            self._fade_from_v = self._law_v
        self._take(plan)
        kind = self._kinds.get(self.mode)
        if "mode" in names or (kind is not None and names & kind.tuning_parameters):
            self._start_tuning(values)

    def _start_tuning(self, values: Mapping[str, Any]) -> None:
        kind = self._kinds.get(self.mode)
        self.run = kind.tuning_run(values, self.period_s) if kind is not None else None

    def step(self, reference: Any, position_m: float, samples: int, allowed: bool = True) -> float:
        """Return what the law in force asks for, V.

        `reference` has position, velocity and acceleration; `samples` have passed since the last
        call; without `allowed` no law is in force.
        """
        point = (reference.position, reference.velocity, reference.acceleration)
        if self._shaper is not None:
            point = self._shaper.step(*point)
        self._point = point
        if self._effects is not None:
            self._forward_v = self._effects.ahead(*point)
        run = self.run
        law = self._in_control = self._law if allowed and run is None else None
        if law is not None:
            return law.step(point[0], position_m, point[1], point[2], samples * self.period_s,
                            self._forward_v)
        if not allowed:
            return 0.0
        if run is not None:
            return run.step(position_m)
        if self._fade > 0:
            self._fade -= 1
            u = self._fade / self._fade_samples
            return self._fade_from_v * u * u * (3.0 - 2.0 * u)
        return 0.0

    def update(self, position_m: float, voltage: float, added: float, limited: bool) -> bool:
        """Update all laws with what goes out; return whether the one in force was limited.

        `voltage` goes out, `added` of it is not the law's; `limited` where it is not what law and
        addition asked for.
        """
        law, law_v = self._in_control, voltage - added
        self._law_v = law_v
        if law is not None and limited:
            law.applied(law_v)
        followers = self._all if law is None else self._others
        if followers:
            r, v, a = self._point
            if math.isfinite(law_v + r + position_m + v + a):
                for each in followers:
                    each.track(law_v, r, position_m, v, a, self._forward_v)
        if self._observers:
            self._observed(voltage)
        return law is not None and law.saturated

    def applied(self, voltage: float, added: float) -> None:
        """Say what the amplifier gave, where it limits or is off."""
        if self._in_control is not None:
            self._in_control.applied(voltage - added)
        self._observed(voltage)

    def _observed(self, voltage: float) -> None:
        # Under a law the stage is near its reference, so that a part of the voltage is what the
        # effects take there: that is not for an observer that does not know them.
        driving = voltage if self._in_control is None else voltage - self._forward_v
        for each in self._observers:
            each.observe(driving)
