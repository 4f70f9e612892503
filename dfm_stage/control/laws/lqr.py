"""The law `lqr`: a regulator with its Kalman filter, designed on the model.

With x the filter's state, e = y - c x the innovation, K the filter's gain and L that of the
regulator, one sample is

    u = -L (x + K e) + r N + integral,    x[k+1] = A (x + K e) + B u

where u in the second equation is the voltage that really drives the stage (`observe`).
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.law import Law, Setup
from dfm_stage.control.lqr import SPEC_PARAMETERS, LqrDesign, LqrSpec, design_lqr
from dfm_stage.model import Model

# The last designs: what a check of parameters designed is not designed again to be used.
_DESIGNS: deque[LqrDesign] = deque(maxlen=4)
# More missed samples than this are not predicted over.
_MOST_MISSED = 10


class LqrPlan(NamedTuple):
    """What `Lqg` runs on."""

    design: LqrDesign
    output_limit_v: float


def _designed(model: Model, spec: LqrSpec, period: float) -> LqrDesign:
    for each in _DESIGNS:
        if (each.spec, each.model, each.sample_period_s) == (spec, model, period):
            return each
    _DESIGNS.append(design_lqr(model, spec, period))
    return _DESIGNS[-1]


class Lqg(Law):
    """The LQR of one axis with its Kalman filter.

    `fault` is empty, or says why the last output was zero. `saturated` tells whether the last
    output was limited. `output_v` is the voltage that drives the stage, as far as it is known,
    `force_n` the estimated force (0 without `lqr_disturbance`).

    After missed samples (`dt_s`) the filter runs on over them with the last output. An input that
    is not finite gives 0 V and a `fault`; the filter then goes on without a measurement.

    Parameters
    ----------
    design : LqrDesign
    output_limit_v : float
        Largest absolute output, V.
    bumpless_s : float
        Without integral action, what `track` took over dies out with this time constant, s.

    Raises
    ------
    ControlError
        If a limit or time is not above zero.
    """

    __slots__ = ("_a", "_asked", "_b", "_bumpless_s", "_correct", "_decay", "_drifts", "_forward",
                 "_go_on", "_ki", "_ki_h", "_known", "_law_output", "_limit", "_next", "_offset",
                 "_period", "_r", "_short", "_start", "_through", "_v", "_wa", "design", "fault",
                 "integral_v", "output_v", "saturated")
    name = "lqr"
    parameters = SPEC_PARAMETERS
    needs_model = True

    @classmethod
    def plan(cls, setup: Setup) -> LqrPlan:
        """Return the design on the model."""
        return LqrPlan(_designed(setup.need_model("mode lqr"), LqrSpec.from_mapping(setup.values),
                                 setup.sample_period_s), setup.output_limit_v)

    @classmethod
    def start(cls, plan: LqrPlan, _sample_period_s: float) -> Lqg:
        """Return a law at rest; its sample period is that of the design."""
        return cls(*plan)

    @classmethod
    def response(cls, plan: LqrPlan, frequency_hz: Array, _sample_period_s: float) -> Complex:
        """Return the law from -y to u at frequencies (F,), V/m, complex (F,)."""
        return plan.design.response(frequency_hz)

    def __init__(self, design: LqrDesign, output_limit_v: float = 10.0,
                 bumpless_s: float = 0.1) -> None:
        for name, value in (("output_limit_v", output_limit_v), ("bumpless_s", bumpless_s)):
            if not (math.isfinite(value) and value > 0.0):
                raise ControlError(f"lqg: {name} must be a number above zero, not {value!r}")
        self._limit, self._bumpless_s = output_limit_v, bumpless_s
        self._use(design)
        self.reset()

    def _use(self, design: LqrDesign) -> None:
        self.design = design
        f, h = design.filter, design.sample_period_s
        # One product gives the prediction, the feedback and the expected reading.
        self._a = np.ascontiguousarray(np.vstack((f.A, -design.gain, f.c)))
        self._correct = f.A @ f.gain
        self._through = float(-design.gain @ f.gain)
        self._b = f.B
        self._r, self._v, self._wa = (float(each) for each in design.reference_gain)
        self._ki, self._ki_h = design.integral_gain, design.integral_gain * h
        self._decay = math.exp(-h / self._bumpless_s)
        self._start, self._drifts = design.start, f.drifting_force
        self._period = h

    @property
    def force_n(self) -> float:
        """The estimated force at the last sample, N."""
        return float(self._next[-1]) if self._drifts else 0.0

    def reset(self) -> None:
        """Forget everything but the design."""
        self.integral_v = self.output_v = self._offset = 0.0
        self._asked = self._forward = self._law_output = self._short = 0.0
        self.saturated = self._known = False
        self.fault = ""
        self._go_on = math.nan
        self._next = np.zeros(self._b.size)

    def step(self, reference_m: float, position_m: float, velocity_m_s: float = 0.0,
             acceleration_m_s2: float = 0.0, dt_s: float = 0.0, forward_v: float = 0.0) -> float:
        """Return the output for one sample, V."""
        x, law, after = self._filtered(reference_m, position_m, velocity_m_s, acceleration_m_s2,
                                       dt_s)
        if law - law != 0.0:
            return self._faulted(x)
        if self._go_on == self._go_on:
            self._continue_at(self._go_on - forward_v, law)
        wanted = law + self.integral_v + self._offset
        output = min(self._limit, max(-self._limit, wanted))
        self.saturated = output != wanted
        error = reference_m - position_m
        if self._ki and (wanted - output) * error <= 0.0 and self._short * error <= 0.0:
            self.integral_v += self._ki_h * error
        self._short = 0.0
        self._offset *= self._decay
        self._next = after
        self.output_v = self._law_output = output
        self._forward, self._asked = forward_v, output + forward_v
        self.fault = ""
        return self._asked

    def applied(self, output_v: float) -> None:
        """Say what of the last output went out: the integral does not grow further that way."""
        if math.isfinite(output_v):
            self._short = self._asked - output_v

    def observe(self, voltage_v: float) -> None:
        """Say what drives the linear part of the stage: the filter's prediction uses it."""
        if math.isfinite(voltage_v):
            self.output_v = voltage_v

    def track(self, output_v: float, reference_m: float, position_m: float,
              velocity_m_s: float = 0.0, acceleration_m_s2: float = 0.0,
              forward_v: float = 0.0) -> None:
        """Follow another controller: the filter learns, and the next `step` gives no bump.

        Call it in place of `step`, each sample; `output_v` is what the other controller gave.

        Raises
        ------
        ControlError
            If an input is not finite.
        """
        if not all(map(math.isfinite, (output_v, reference_m, position_m, velocity_m_s,
                                       acceleration_m_s2, forward_v))):
            raise ControlError("lqg: track needs finite numbers")
        _, law, self._next = self._filtered(reference_m, position_m, velocity_m_s,
                                            acceleration_m_s2, 0.0)
        self.output_v = min(self._limit, max(-self._limit, output_v - forward_v))
        self._law_output, self._forward = self.output_v, forward_v
        self._continue_at(self.output_v, law)
        self.fault = ""

    def change(self, plan: LqrPlan, forward_v: float = 0.0) -> None:
        """Change design, limit or feedforward without a bump.

        The next `step` goes on at the present output. The filter keeps what it knows where the
        new design has the same states of the stage, else it starts again from the next reading.

        Raises
        ------
        ControlError
            If the design is for another sample period.
        """
        design, self._limit = plan
        if design.sample_period_s != self._period:
            raise ControlError(f"lqg: the design is for samples every {design.sample_period_s:g} "
                               f"s, the controller runs every {self._period:g} s")
        if design is self.design and forward_v == self._forward:
            return
        before, old = self._next, self.design.stage.b.size
        if design is not self.design:
            self._use(design)
            self._next = np.zeros(self._b.size)
            if design.stage.b.size == old:
                shared = min(before.size, self._b.size)
                self._next[:shared] = before[:shared]
            else:
                self._known = False
        self._go_on = self._law_output + self._forward

    def config(self) -> dict[str, Any]:
        """Return the margins of the loop."""
        found = self.design.margins
        return {"modulus_margin": found.modulus, "gain_margin": found.gain,
                "phase_margin_deg": found.phase_deg, "crossover_hz": found.crossover_hz}

    def _continue_at(self, output_v: float, law: float) -> None:
        short = output_v - law
        self.integral_v, self._offset = (short, 0.0) if self._ki else (0.0, short)
        self._go_on = math.nan

    def _filtered(self, reference_m: float, position_m: float, velocity_m_s: float,
                  acceleration_m_s2: float, dt_s: float) -> tuple[Any, float, Any]:
        """Return the prediction for this sample, the law without integral, V, and the next
        prediction without this sample's voltage. The first sample starts from rest."""
        if self._known:
            x = self._next + self._b * self.output_v
            if dt_s > 1.5 * self._period:
                x = self._run_on(x, dt_s)
        elif math.isfinite(position_m):
            self._known = True
            x = self._start * position_m
        else:
            x = self._next
        product = self._a @ x
        n = self._b.size
        innovation = position_m - float(product[n + 1])
        law = (float(product[n]) + self._through * innovation + self._r * reference_m
               + self._v * velocity_m_s + self._wa * acceleration_m_s2)
        return x, law, product[:n] + self._correct * innovation

    def _run_on(self, x: Any, dt_s: float) -> Any:
        """Return the prediction after missed samples, with the last output."""
        missed = min(round(dt_s / self._period) - 1, _MOST_MISSED) if math.isfinite(dt_s) else 0
        for _ in range(missed):
            x = self.design.filter.A @ x + self._b * self.output_v
        return x

    def _faulted(self, x: Any) -> float:
        self.fault, self.saturated = "reference or measurement is not a finite number", False
        self.output_v = self._law_output = self._asked = self._forward = 0.0
        self._next = self.design.filter.A @ x
        return 0.0
