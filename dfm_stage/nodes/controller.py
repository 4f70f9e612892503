"""controller: one command for each measurement, by the control law of `mode`, plus excitation.

In lockstep it waits for the reference and excitation of the same sample. In real time it answers
at once, with the reference that was sent ahead for this sample. If that is late, it takes the last
one and counts this. The other laws follow the active one (`LawSet`), so that the output does not
jump when `mode` changes. A guard watches travel and divergence in every mode. Once it has tripped,
the output stays zero until `mode` is set again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from dfm_stage.control import (
    AXIS_PARAMETERS,
    DEFAULT_LAW,
    GUARD_PARAMETERS,
    LAWS,
    Guard,
    Law,
    LawSet,
    Plan,
    Point,
    laws_with,
    modes,
    plan_laws,
)
from dfm_stage.middleware.watch import Recent
from dfm_stage.model import Model, load_model
from dfm_stage.nodes.base import LoopNode
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.process import run_node
from dfm_stage.nodes.sample_period import SAMPLE_PERIOD

_AT_ZERO = Point()
_LAW_FILES = "law_files"
_MODEL = "model"


@lru_cache(maxsize=8)
def _axis_model(name: str, _changed_ns: int, axis: str) -> Model:
    """Return one axis of a model; read again when its file has changed."""
    model = load_model(name)
    return model.axis(axis) if model.axes else model


def settings_of(laws: Mapping[str, type[Law]]) -> tuple[Setting, ...]:
    """Return the parameters of a controller that knows these laws."""
    return (
        Setting("mode", DEFAULT_LAW, "control law; open_loop passes the excitation on as it is",
                choices=modes(laws), live=True),
        Setting(_LAW_FILES, "", "Python files with further laws for mode, separated by `:`; "
                "their parameters are declared beside those of the others"),
        SAMPLE_PERIOD,
        Setting("amplifier_feedback", False, "count what the amplifier says it gave (topic "
                "amplifier) in place of what was asked, where it limits or is off"),
        *(Setting.of(entry, live=True) for entry in (
            *AXIS_PARAMETERS, *GUARD_PARAMETERS,
            *(entry for law in laws.values() for entry in law.parameters))))


_KEPT_AHEAD = 64
_LATE_NS = 10**9
"""A measurement older than the last by less than this is that of a second encoder_driver of the
same name, and would be taken for a jump; by more, the clock was set back."""


class Ahead(Recent[Any]):
    """Messages that are sent ahead, by the sample they are for."""

    last: Any = None

    def take(self, seq: int) -> bool:
        """Make the message for sample `seq` the `last`, or the newest older one.

        Returns whether it was the one for this very sample; older ones are forgotten.
        """
        exact = self.pop(seq, None)
        if exact is None or self:
            for each in [each for each in self if (seq - each) & 0x80000000 == 0]:
                self.last = self.pop(each)
        if exact is not None:
            self.last = exact
        return exact is not None


class Controller(LoopNode):
    """Answers every `measurement` with a `command`."""

    kind = "controller"
    example = "-p mode:=lqr -p model:=paper_stage"
    settings_table = settings_of(LAWS)

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._known = laws_with(self.settings[_LAW_FILES])
        self._guard = self._new_guard()
        self._seq = 0
        self._last_seq: int | None = None
        self._answered_ns = -_LATE_NS
        self._sent_v = self._added_v = 0.0
        self._measurement: Any = None
        self._amplifier: Any = None
        self._references, self._excitations = Ahead(_KEPT_AHEAD), Ahead(_KEPT_AHEAD)
        self._out = self.link_publisher("command")
        self.link_subscription("measurement", self._on_measurement)
        self.link_subscription("reference", partial(self._on_ahead, self._references))
        self.link_subscription("excitation", partial(self._on_ahead, self._excitations))
        if self.settings["amplifier_feedback"]:
            self.link_subscription("amplifier", self._on_amplifier)
        self.begin()

    def start_work(self) -> None:
        """Make the laws that were planned from the parameters."""
        values = self.settings.values
        self._laws = LawSet(values, self.settings.plan, self._known)

    # Parameters

    def _new_guard(self) -> Guard:
        return Guard(self.settings[SAMPLE_PERIOD.name],
                     *(self.settings[parameter.name] for parameter in GUARD_PARAMETERS))

    @classmethod
    def settings_for(cls, overrides: Mapping[str, Any]) -> tuple[Setting, ...]:
        """Return the settings with those of the laws in `law_files`."""
        given = overrides.get(_LAW_FILES)
        return settings_of(laws_with(str(given.value))) if given is not None else (
            cls.settings_table)

    def check_settings(self, values: dict[str, Any]) -> Plan:
        """Return the plan of the laws; refuse gains and models that they cannot work with.

        The file of the model is read where `model` is set, and only there: one that was replaced
        meanwhile must neither change the law unasked nor keep an operator from setting the mode.
        """
        name, model = values[_MODEL], None
        if self.settings.plan is not None and _MODEL not in self.settings.asked:
            model = self.settings.plan.model
        elif name:
            changed_ns = Path(name).stat().st_mtime_ns if Path(name).is_file() else 0
            model = _axis_model(name, changed_ns, self.axis)
        return plan_laws(values, model, self._known)

    def settings_applied(self, names: set[str]) -> None:
        """Take over new gains and modes without a bump."""
        self._laws.change(self.settings.values, self.settings.plan, names)
        if "mode" in names or names & {parameter.name for parameter in GUARD_PARAMETERS}:
            self._guard = self._new_guard()
            self.warnings_active.pop("guard", None)
        self.publish_config()

    def config(self) -> dict[str, Any]:
        """Return what the laws say of themselves and the state of a tuning run."""
        out = {name: said for name, law in self._laws.by_name.items() if (said := law.config())}
        run = self._laws.run
        if run is not None:
            out["tuning"] = {"ended": run.ended, "failure": run.failure}
            if run.outcome is not None:
                out["tuning"] |= {"ultimate_gain_v_m": run.outcome.gain_v_m,
                                  "ultimate_period_s": run.outcome.period_s}
        return out

    # The loop

    def _on_measurement(self, measurement: Any) -> None:
        if self.lockstep:
            self._measurement = measurement
            self._answer_when_complete()
            return
        if 0 <= self._answered_ns - measurement.stamp_ns < _LATE_NS:
            self.count("measurements_late")
            return
        self._measurement, self._answered_ns = measurement, measurement.stamp_ns
        for ahead in (self._references, self._excitations):
            if not ahead.take(measurement.seq) and ahead.last is not None:
                self.count("reference_late")
        self._answer(measurement)

    def _on_ahead(self, ahead: Ahead, message: Any) -> None:
        ahead.keep(message.seq, message)
        if self.lockstep:
            self._answer_when_complete()

    def _on_amplifier(self, state: Any) -> None:
        self._amplifier = state
        if self.lockstep:
            self._answer_when_complete()
        elif state.measurement_seq == self._last_seq:
            self._count_what_was_given(state)

    def _answer_when_complete(self) -> None:
        measurement = self._measurement
        if (measurement is not None and measurement.seq in self._references
                and measurement.seq in self._excitations):
            state = self._amplifier
            if state is not None:
                if state.measurement_seq != self._last_seq:
                    return
                self._count_what_was_given(state)
            self._references.take(measurement.seq)
            self._excitations.take(measurement.seq)
            self._answer(measurement)

    def _count_what_was_given(self, state: Any) -> None:
        if state.voltage != self._sent_v:
            self.count("amplifier_gave_less")
            self._laws.applied(state.voltage, self._added_v)
            self._sent_v = state.voltage

    def _answer(self, measurement: Any) -> None:
        samples = 1 if self._last_seq is None else (measurement.seq - self._last_seq) & 0xFFFFFFFF
        self._last_seq = measurement.seq
        if samples != 1:
            if 0 < samples < 0x80000000:
                self.count("samples_missed", samples - 1)
            else:  # an encoder that has started anew numbers anew
                samples = 1
        excitation = self._excitations.last
        added = excitation.voltage if excitation is not None else 0.0
        laws, position = self._laws, measurement.position
        law = self._law(self._references.last or _AT_ZERO, position, samples)
        wanted, limit = law + added, laws.limit_v
        voltage = limit if wanted > limit else max(wanted, -limit)
        saturated = voltage != wanted
        if not math.isfinite(wanted):
            voltage, saturated = 0.0, True
            self.count("not_finite")
        if not self._guard.check(position, voltage, limit, samples):
            self._let_go()
            voltage = added = 0.0
        saturated = laws.update(position, voltage, added, voltage != wanted) or saturated
        if saturated:
            self.count("saturated")
        self._sent_v, self._added_v = voltage, added
        self._seq = (self._seq + 1) & 0xFFFFFFFF
        self._out.send(measurement.stamp_ns if self.lockstep else self.now_ns(), self._seq,
                       measurement.seq, measurement.stamp_ns, voltage, saturated)

    def _law(self, reference: Any, position: float, samples: int) -> float:
        run = self._laws.run
        before = run is not None and run.ended
        law = self._laws.step(reference, position, samples, not self._guard.tripped)
        if run is not None and run.ended != before:
            self.publish_config()
        return law

    def _let_go(self) -> None:
        words = f"output is zero until mode is set again: {self._guard.tripped}"
        if self.warnings_active.put("guard", words):
            self.count("guard_trips")
            self.get_logger().warning(words)

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
        state = self._amplifier
        if state is not None and state.measurement_seq != self._last_seq:
            return "amplifier", self._last_seq or 0
        return None


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Controller, args)
