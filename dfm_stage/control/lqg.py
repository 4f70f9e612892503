"""An LQR with its Kalman filter, one sample per call, with the same manners as `Pid`."""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.control.errors import ControlError
from dfm_stage.control.lqr import LqrDesign


class Lqg:
    """The controller of one axis.

    `fault` is empty, or says why the last output was zero. `saturated` tells whether the last
    output was limited. `output_v` is the last output, `force_n` the estimated force (0 without
    `lqr_disturbance`).

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

    __slots__ = ("_a", "_b", "_bumpless_s", "_correct", "_decay", "_drifts", "_go_on", "_ki",
                 "_ki_h", "_known", "_law_output", "_limit", "_next", "_offset", "_period", "_r",
                 "_short", "_start", "_through", "_v", "_wa", "design", "fault", "integral_v",
                 "output_v", "saturated")

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
    def sample_period_s(self) -> float:
        """The sample period, s."""
        return self._period

    @property
    def force_n(self) -> float:
        """The estimated force at the last sample, N."""
        return float(self._next[-1]) if self._drifts else 0.0

    def set_output_limit(self, output_limit_v: float) -> None:
        """Change the largest absolute output, V."""
        self._limit = output_limit_v

    def reset(self) -> None:
        """Forget everything but the design."""
        self.integral_v = 0.0
        self.output_v = 0.0
        self.saturated = False
        self.fault = ""
        self._offset = 0.0
        self._known = False
        self._go_on = math.nan
        self._law_output = self._short = 0.0
        self._next = np.zeros(self._b.size)

    def step(self, reference_m: float, position_m: float, velocity_m_s: float = 0.0,
             acceleration_m_s2: float = 0.0, dt_s: float = 0.0) -> float:
        """Return the output for one sample, V; arguments as `Pid.step`.

        After missed samples (`dt_s`) the filter runs on over them with the last output. An input
        that is not finite gives 0 V and a `fault`; the filter then goes on without a measurement.
        """
        x = self._predicted(position_m, dt_s)
        product = self._a @ x
        n = self._b.size
        innovation = position_m - float(product[n + 1])
        law = (float(product[n]) + self._through * innovation + self._r * reference_m
               + self._v * velocity_m_s + self._wa * acceleration_m_s2)
        if law - law != 0.0:
            return self._faulted(x)
        if self._go_on == self._go_on:
            self._continue_at(self._go_on, law)
        wanted = law + self.integral_v + self._offset
        limit = self._limit
        output = min(limit, max(-limit, wanted))
        self.saturated = output != wanted
        error = reference_m - position_m
        if self._ki and (wanted - output) * error <= 0.0 and self._short * error <= 0.0:
            self.integral_v += self._ki_h * error
        self._short = 0.0
        self._offset *= self._decay
        self._next = product[:n] + self._correct * innovation
        self.output_v = self._law_output = output
        if self.fault:
            self.fault = ""
        return output

    def applied(self, output_v: float, short_v: float = 0.0) -> None:
        """Say what really reached the actuator instead of the last output; the filter uses it.

        `short_v` is by how much that is less than was asked, V: the integral then does not grow
        further in that direction.
        """
        if math.isfinite(output_v):
            self.output_v = output_v
            self._short = short_v

    def track(self, output_v: float, reference_m: float, position_m: float,
              velocity_m_s: float = 0.0, acceleration_m_s2: float = 0.0) -> None:
        """Follow another controller: the filter learns, and the next `step` gives no bump.

        Call it in place of `step`, each sample; `output_v` is what the other controller gave.

        Raises
        ------
        ControlError
            If an input is not finite.
        """
        if not all(map(math.isfinite, (output_v, reference_m, position_m, velocity_m_s,
                                       acceleration_m_s2))):
            raise ControlError("lqg: track needs finite numbers")
        x = self._predicted(position_m, 0.0)
        product = self._a @ x
        n = self._b.size
        innovation = position_m - float(product[n + 1])
        law = (float(product[n]) + self._through * innovation + self._r * reference_m
               + self._v * velocity_m_s + self._wa * acceleration_m_s2)
        self._next = product[:n] + self._correct * innovation
        self.output_v = self._law_output = min(self._limit, max(-self._limit, output_v))
        self._continue_at(self.output_v, law)
        self.fault = ""

    def set_design(self, design: LqrDesign) -> None:
        """Change the design without a bump.

        The next `step` goes on at the present output. The filter keeps what it knows where the
        new design has the same states of the stage, else it starts again from the next reading.

        Raises
        ------
        ControlError
            If the design is for another sample period.
        """
        if design.sample_period_s != self._period:
            raise ControlError(f"lqg: the design is for samples every {design.sample_period_s:g} "
                               f"s, the controller runs every {self._period:g} s")
        before, old = self._next, self.design.stage.b.size
        self._use(design)
        n = design.stage.b.size
        self._next = np.zeros(self._b.size)
        if n == old:
            shared = min(before.size, self._b.size)
            self._next[:shared] = before[:shared]
        else:
            self._known = False
        self._go_on = self._law_output

    def _continue_at(self, output_v: float, law: float) -> None:
        short = output_v - law
        self.integral_v, self._offset = (short, 0.0) if self._ki else (0.0, short)
        self._go_on = math.nan

    def _predicted(self, position_m: float, dt_s: float) -> np.ndarray:
        """Return the filter's prediction for this sample; the first one starts from rest."""
        if not self._known:
            if not math.isfinite(position_m):
                return self._next
            self._known = True
            return np.asarray(self._start * position_m)
        x = self._next + self._b * self.output_v
        if dt_s > 1.5 * self._period:
            missed = min(round(dt_s / self._period) - 1, 10) if math.isfinite(dt_s) else 0
            a = self.design.filter.A
            for _ in range(missed):
                x = a @ x + self._b * self.output_v
        return np.asarray(x)

    def _faulted(self, x: np.ndarray) -> float:
        self.fault = "reference or measurement is not a finite number"
        self.saturated = False
        self.output_v = self._law_output = 0.0
        self._next = self.design.filter.A @ x
        return 0.0
