"""controller: one command for every measurement, by the law that `mode` names, plus excitation.

In lockstep it waits for reference and excitation of the same sample. In real time it answers at
once with the reference that was sent ahead for this sample, or, where that is late, with the last
one (counted). The laws that are not in force follow the one that is, so that `mode` changes
without a bump. A guard watches travel and divergence; once it let go, the output stays zero until
`mode` is set again.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from dfm_stage.control import (
    GUARD_PARAMETERS,
    LQR_PARAMETERS,
    PID_PARAMETERS,
    TUNING_PARAMETERS,
    ControlError,
    GainRaising,
    Guard,
    Lqg,
    LqrDesign,
    LqrSpec,
    Pid,
    PidGains,
    RelayRun,
    TuningRun,
    design_lqr,
)
from dfm_stage.control.gains import ANTI_WINDUP
from dfm_stage.model import load_model
from dfm_stage.nodes.base import LoopNode, run_node
from dfm_stage.nodes.parameters import Setting

_MODES = ("open_loop", "pid", "lqr")
_RUNS: dict[str, type[TuningRun]] = {"raise_gain": GainRaising, "relay": RelayRun}
_LQR_SWITCHES = ("lqr_integral", "lqr_disturbance", "lqr_feedforward")
_LQR_NAMES = (*(parameter.name for parameter in LQR_PARAMETERS), *_LQR_SWITCHES)
_PID_NAMES = (*(parameter.name for parameter in PID_PARAMETERS), "anti_windup")
_TUNING_NAMES = tuple(parameter.name for parameter in TUNING_PARAMETERS)


class _AtZero(NamedTuple):
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


_AT_ZERO = _AtZero()


_KEPT_AHEAD = 64


class Ahead:
    """Messages that are sent ahead, by the sample they are for."""

    def __init__(self) -> None:
        self._by_seq: dict[int, Any] = {}
        self.last: Any = None

    def __contains__(self, seq: int) -> bool:
        return seq in self._by_seq

    def put(self, message: Any) -> None:
        """Keep a message until its sample comes; of many that never come, the newest."""
        self._by_seq[message.seq] = message
        if len(self._by_seq) > _KEPT_AHEAD:
            del self._by_seq[next(iter(self._by_seq))]

    def take(self, seq: int) -> bool:
        """Make the message for sample `seq` the `last`, or the newest older one.

        Returns whether it was the one for this very sample; older ones are forgotten.
        """
        exact = self._by_seq.pop(seq, None)
        if exact is None or self._by_seq:
            older = [each for each in self._by_seq if (seq - each) & 0x80000000 == 0]
            for each in older:
                self.last = self._by_seq.pop(each)
        if exact is not None:
            self.last = exact
        return exact is not None


class Controller(LoopNode):
    """Answers every `measurement` with a `command`."""

    kind = "controller"
    settings_table = (
        Setting("mode", "pid", "control law; open_loop passes the excitation on as it is",
                choices=_MODES, live=True),
        Setting("sample_period_s", 0.001, "sample period of the loop", "s", 1e-5, 1.0),
        *(Setting.of(parameter, live=True) for parameter in PID_PARAMETERS),
        Setting("anti_windup", "back_calculation", "what keeps the integral from winding up",
                choices=ANTI_WINDUP, live=True),
        Setting("model", "", "model.yaml that lqr is designed on, a path or a name in "
                "config/models", live=True),
        *(Setting.of(parameter, live=True) for parameter in LQR_PARAMETERS),
        Setting("lqr_integral", True, "integral action on the tracking error", live=True),
        Setting("lqr_disturbance", False, "estimate a drifting force and take it off the output",
                live=True),
        Setting("lqr_feedforward", True, "add the model's own input for the reference; without "
                "it, it is the paper's regulator", live=True),
        *(Setting.of(parameter, live=True) for parameter in GUARD_PARAMETERS),
        Setting("tuning", "none", "in mode pid: find the ultimate gain instead of controlling",
                choices=("none", *_RUNS), live=True),
        *(Setting.of(parameter, live=True) for parameter in TUNING_PARAMETERS),
    )
    _designed: tuple[tuple[Any, ...], LqrDesign] | None = None

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._period: float = self.settings["sample_period_s"]
        self._pid = Pid(self._gains(self.settings.values), self._period)
        self._lqg: Lqg | None = None
        self._use_design()
        self._guard = self._new_guard()
        self._run: TuningRun | None = None
        self._mode: str = self.settings["mode"]
        self._limit: float = self.settings["output_limit_v"]
        self._start_tuning()
        self._seq = 0
        self._last_seq: int | None = None
        self._measurement: Any = None
        self._references = Ahead()
        self._excitations = Ahead()
        self._out = self.link_publisher("command")
        self.link_subscription("measurement", self._on_measurement)
        self.link_subscription("reference", self._on_reference)
        self.link_subscription("excitation", self._on_excitation)
        self.publish_config()

    # Parameters

    @staticmethod
    def _gains(values: dict[str, Any]) -> PidGains:
        return PidGains(**{name: values[name] for name in _PID_NAMES})

    def _new_guard(self) -> Guard:
        return Guard(self._period, *(self.settings[parameter.name]
                                     for parameter in GUARD_PARAMETERS))

    def check_settings(self, values: dict[str, Any]) -> None:
        """Refuse gains and models that the laws cannot work with."""
        self._gains(values)
        if values["mode"] == "lqr" and not values["model"]:
            raise ControlError("mode lqr needs the parameter model: a model.yaml, or a name in "
                               "config/models")
        if values["model"]:
            self._design(values)

    def _design(self, values: dict[str, Any]) -> LqrDesign:
        """Return the LQR for these values; the last one is kept."""
        key = (values["model"], values["sample_period_s"], *(values[n] for n in _LQR_NAMES))
        if self._designed is None or self._designed[0] != key:
            model = load_model(values["model"])
            if model.axes:
                model = model.axis(self.get_namespace().rpartition("/")[2])
            design = design_lqr(model, LqrSpec.from_mapping(values), values["sample_period_s"])
            self._designed = (key, design)
        return self._designed[1]

    def _use_design(self) -> None:
        if not self.settings["model"]:
            self._lqg = None
            return
        design = self._design(self.settings.values)
        if self._lqg is None:
            self._lqg = Lqg(design, self.settings["output_limit_v"])
            return
        self._lqg.set_output_limit(self.settings["output_limit_v"])
        if self._lqg.design is not design:
            self._lqg.set_design(design)

    def _start_tuning(self) -> None:
        make = _RUNS.get(self.settings["tuning"]) if self._mode == "pid" else None
        self._run = make(self._period, **{name: self.settings[name] for name in _TUNING_NAMES}
                         ) if make else None

    def settings_applied(self, names: set[str]) -> None:
        """Take over new gains and modes without a bump."""
        self._limit = self.settings["output_limit_v"]
        if names & set(_PID_NAMES):
            self._pid.set_gains(self._gains(self.settings.values))
        if names & {"model", "output_limit_v", *_LQR_NAMES}:
            self._use_design()
        self._mode = self.settings["mode"]
        if names & {"mode", "tuning", *_TUNING_NAMES}:
            self._start_tuning()
        if "mode" in names or names & {parameter.name for parameter in GUARD_PARAMETERS}:
            self._guard = self._new_guard()
            self.warnings_active.pop("guard", None)
        self.publish_config()

    def config(self) -> dict[str, Any]:
        """Return margins of the LQR and the state of a tuning run."""
        out: dict[str, Any] = {}
        if self._lqg is not None:
            found = self._lqg.design.margins
            out["lqr"] = {"modulus_margin": found.modulus, "gain_margin": found.gain,
                          "phase_margin_deg": found.phase_deg,
                          "crossover_hz": found.crossover_hz}
        run = self._run
        if run is not None:
            out["tuning"] = {"ended": run.ended, "failure": run.failure}
            if run.outcome is not None:
                out["tuning"] |= {"ultimate_gain_v_m": run.outcome.gain_v_m,
                                  "ultimate_period_s": run.outcome.period_s}
        return out

    # The loop

    def _on_measurement(self, measurement: Any) -> None:
        self._measurement = measurement
        if self.lockstep:
            self._answer_when_complete()
            return
        for ahead in (self._references, self._excitations):
            if not ahead.take(measurement.seq) and ahead.last is not None:
                self.count("reference_late")
        self._answer(measurement)

    def _on_reference(self, reference: Any) -> None:
        self._references.put(reference)
        if self.lockstep:
            self._answer_when_complete()

    def _on_excitation(self, excitation: Any) -> None:
        self._excitations.put(excitation)
        if self.lockstep:
            self._answer_when_complete()

    def _answer_when_complete(self) -> None:
        measurement = self._measurement
        if (measurement is not None and measurement.seq in self._references
                and measurement.seq in self._excitations):
            self._references.take(measurement.seq)
            self._excitations.take(measurement.seq)
            self._answer(measurement)

    def _answer(self, measurement: Any) -> None:
        samples = 1 if self._last_seq is None else (measurement.seq - self._last_seq) & 0xFFFFFFFF
        self._last_seq = measurement.seq
        if samples != 1:
            self.count("samples_missed", samples - 1)
        excitation = self._excitations.last
        added = excitation.voltage if excitation is not None else 0.0
        reference = self._references.last or _AT_ZERO
        law = self._law(reference, measurement.position, samples)
        wanted = law + added
        voltage = min(max(wanted, -self._limit), self._limit)
        saturated = voltage != wanted
        if not math.isfinite(wanted):
            voltage, saturated = 0.0, True
            self.count("not_finite")
        if not self._guard.check(measurement.position, voltage, self._limit, samples):
            self._let_go()
            voltage = added = 0.0
        saturated = self._tell(reference, measurement.position, voltage, added,
                               voltage != wanted) or saturated
        if saturated:
            self.count("saturated")
        self._seq += 1
        stamp = measurement.stamp_ns if self.lockstep else self.now_ns()
        self._out.send(stamp, self._seq, measurement.seq, measurement.stamp_ns, voltage,
                       saturated)

    def _law(self, reference: Any, position: float, samples: int) -> float:
        run = self._run
        if self._guard.tripped:
            return 0.0
        if run is not None:
            before, law = run.ended, run.step(position)
            if run.ended != before:
                self.publish_config()
            return law
        if self._mode == "pid":
            return self._pid.step(reference.position, position, reference.velocity,
                                  reference.acceleration, samples * self._period)
        if self._mode == "lqr" and self._lqg is not None:
            return self._lqg.step(reference.position, position, reference.velocity,
                                  reference.acceleration, samples * self._period)
        return 0.0

    def _tell(self, reference: Any, position: float, voltage: float, added: float,
              limited: bool) -> bool:
        """Tell all laws what goes out; return whether the one in force was limited."""
        pid, lqg, law = self._pid, self._lqg, voltage - added
        following = (law, reference.position, position, reference.velocity,
                     reference.acceleration)
        usable = math.isfinite(sum(following))
        controls = self._run is None and not self._guard.tripped
        by_pid, by_lqr = controls and self._mode == "pid", controls and self._mode == "lqr"
        if by_pid:
            if limited:
                pid.applied(law)
        elif usable:
            pid.track(*following)
        if lqg is not None:
            if not by_lqr and usable:
                lqg.track(*following)
            lqg.applied(voltage)
        return (by_pid and pid.saturated) or (by_lqr and lqg is not None and lqg.saturated)

    def _let_go(self) -> None:
        if "guard" not in self.warnings_active:
            self.count("guard_trips")
            self.warnings_active["guard"] = (f"output is zero until mode is set again: "
                                             f"{self._guard.tripped}")
            self.get_logger().warning(self.warnings_active["guard"])

    def waiting_for(self) -> tuple[str, int] | None:
        """Return which part of the answer is missing."""
        measurement = self._measurement
        if measurement is None:
            return "measurement", 0
        if self._last_seq == measurement.seq:
            return None
        for name, part in (("reference", self._references), ("excitation", self._excitations)):
            if measurement.seq not in part:
                return f"{name} (or for an experiment to start)", measurement.seq
        return None


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Controller, args)
