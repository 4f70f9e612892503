"""The law `pid`: two degrees of freedom, limits and anti-windup.

The law (Astrom and Hagglund, Advanced PID Control, ISA 2006, ch. 3 and sec. 13.3), with reference
r, measurement y, sample period h, filter time Tf, tracking time Tt, weights b and c:

    P_k = kp (b r_k - y_k)
    d_k = Tf / (Tf + h) d_{k-1} + ((c r_k - y_k) - (c r_{k-1} - y_{k-1})) / (Tf + h)
    v_k = N(P_k + I_k + kd d_k) + F_k
    u_k = v_k limited in size and, against u_{k-1}, in slew
    I_{k+1} = I_k + ki h (r_k - y_k) + (h / Tt) (u_k - v_k)

The derivative is the backward difference of kd s / (1 + s Tf), the integral the forward
difference of ki / s, F the feedforward, N the notch if there is one. With "clamping" the last
term is left out and the integral stands still while the output is limited and the error would
drive it further. Unless anti_windup is "none" the integral also never grows beyond what the
largest output would need with the stage at rest on its reference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.feedforward import feedforward_gains
from dfm_stage.control.gains import GAIN_PARAMETERS, PidGains
from dfm_stage.control.law import OUTPUT_LIMIT, Law, Setup
from dfm_stage.control.stage import controller_response, highest_mode, sample_model
from dfm_stage.control.tuning_runs import TUNING_PARAMETERS, GainRaising, RelayRun, TuningRun
from dfm_stage.model.parameter import Option

TUNING_RUNS: dict[str, type[TuningRun]] = {"raise_gain": GainRaising, "relay": RelayRun}
NOTCH = Option("notch", "given", "notch_hz, or the highest mode of model", ("given", "model"))
TUNING = Option("tuning", "none", "in mode pid: find the ultimate gain instead of controlling",
                ("none", *TUNING_RUNS))
_OWN_GAINS = tuple(each for each in GAIN_PARAMETERS if each is not OUTPUT_LIMIT)
# More nominal periods than this are not believed of a measured one.
_LONGEST = 10.0


class Pid(Law):
    """The PID of one axis; its plan is `PidGains`.

    `fault` is empty, or says why the last output was zero. `saturated` tells whether the last
    output was limited, in size or slew. `output_v` and `integral_v` are the last output and the
    integral part the next one starts from, V.

    An input that is not finite gives 0 V and a `fault`, and leaves integral and derivative as
    they were; the next good sample goes on from there. Of a measured period at most ten nominal
    ones are believed; 0, negative or not finite means one.

    Parameters
    ----------
    gains : PidGains
    sample_period_s : float
        Time between calls of `step` that do not say otherwise, s.

    Raises
    ------
    ControlError
        If the sample period is not positive and finite.
    """

    __slots__ = ("_aw", "_b", "_c", "_clamping", "_decay", "_derivative", "_fa", "_fp", "_fv",
                 "_gains", "_i_limit", "_kd", "_ki_h", "_kp", "_last", "_leak", "_limit", "_notch",
                 "_per_dt", "_period", "_shortfall", "_slew_h", "_steady", "fault",
                 "integral_v", "output_v", "saturated")
    name = "pid"
    parameters = (*_OWN_GAINS, NOTCH, TUNING, *TUNING_PARAMETERS)
    tuning_parameters = frozenset({TUNING.name, *(each.name for each in TUNING_PARAMETERS)})

    @classmethod
    def plan(cls, setup: Setup) -> PidGains:
        """Return the gains, with notch and feedforward of the model where these are asked for."""
        values = setup.values
        gains = PidGains(output_limit_v=setup.output_limit_v, **{
            each.name: values[each.name] for each in _OWN_GAINS})
        if values[NOTCH.name] == "model":
            frequency, damping = highest_mode(setup.need_model("notch model"))
            gains = gains.changed({"notch_hz": frequency, "notch_depth_damping": damping})
        if setup.model_forward:
            position, velocity, acceleration = feedforward_gains(
                sample_model(setup.need_model("feedforward model")), gains)
            gains = gains.changed({
                "feedforward_position": position, "feedforward_velocity": velocity,
                "feedforward_acceleration": acceleration})
        gains.notch(setup.sample_period_s)          # refuses one beyond half the rate
        return gains

    @classmethod
    def tuning_run(cls, values: Mapping[str, Any], sample_period_s: float) -> TuningRun | None:
        """Return the run that the parameter `tuning` names."""
        make = TUNING_RUNS.get(values[TUNING.name])
        return make(sample_period_s, **{each.name: values[each.name]
                                        for each in TUNING_PARAMETERS}) if make else None

    @classmethod
    def response(cls, plan: Any, frequency_hz: Array, sample_period_s: float) -> Complex:
        """Return the law from -y to u at frequencies (F,), V/m, complex (F,)."""
        return controller_response(plan, frequency_hz, sample_period_s)

    def __init__(self, gains: PidGains, sample_period_s: float) -> None:
        if not (math.isfinite(sample_period_s) and sample_period_s > 0.0):
            raise ControlError("pid: sample_period_s must be a positive number of seconds, "
                               f"not {sample_period_s!r}")
        self._period = float(sample_period_s)
        self._use(gains)
        self.reset()

    @property
    def gains(self) -> PidGains:
        """The gains in force."""
        return self._gains

    def reset(self) -> None:
        """Forget everything but the gains."""
        self.integral_v = self.output_v = self._derivative = self._shortfall = 0.0
        self.saturated = False
        self.fault = ""
        self._last: tuple[float, float, float, float, float] | None = None
        if self._notch is not None:
            self._notch.reset()

    def step(self, reference_m: float, position_m: float, velocity_m_s: float = 0.0,
             acceleration_m_s2: float = 0.0, dt_s: float = 0.0,
             forward_v: float = 0.0) -> float:
        """Return the output for one sample, V."""
        if dt_s == 0.0 or dt_s == self._period:
            ki_h, leak, aw = self._ki_h, self._leak, self._aw
            decay, per_dt, slew = self._decay, self._per_dt, self._slew_h
        else:
            ki_h, leak, aw, decay, per_dt, slew = self._coefficients(
                min(dt_s, _LONGEST * self._period) if 0.0 < dt_s < math.inf else self._period)
        last = self._last
        weighted = self._c * reference_m - position_m
        derivative = self._derivative if last is None else (
            decay * self._derivative + (weighted - self._c * last[0] + last[1]) * per_dt)
        forward = (self._fp * reference_m + self._fv * velocity_m_s
                   + self._fa * acceleration_m_s2 + forward_v)
        integral = self.integral_v
        wanted = (self._kp * (self._b * reference_m - position_m) + integral
                  + self._kd * derivative)
        if self._notch is not None and wanted - wanted == 0.0:
            wanted = self._notch.step(wanted)
        wanted += forward
        if wanted - wanted != 0.0:
            return self._faulted()
        output = min(self._limit, max(-self._limit, wanted))
        if slew:
            output = min(self.output_v + slew, max(self.output_v - slew, output))
        short = output - wanted
        error = reference_m - position_m
        if not (self._clamping and (short * error < 0.0 or self._shortfall * error < 0.0)):
            integral += ki_h * error
        self._shortfall = 0.0
        integral += aw * short - leak * integral
        bound, offset = self._i_limit, self._steady * reference_m
        if integral > bound - offset:
            integral = max(bound - offset, min(integral, self.integral_v))
        elif integral < -bound - offset:
            integral = min(-bound - offset, max(integral, self.integral_v))
        self.integral_v = integral
        self._derivative = derivative
        self._last = (reference_m, position_m, velocity_m_s, acceleration_m_s2, forward_v)
        self.saturated = short != 0.0
        self.output_v = output
        self.fault = ""
        return output

    def applied(self, output_v: float) -> None:
        """Say what really reached the actuator instead of the last output.

        An amplifier that gives less than was asked winds the integral up like a limit of one's
        own: back-calculation takes the difference back, clamping stops the next integration.
        """
        if math.isfinite(output_v):
            self._shortfall = output_v - self.output_v
            self.integral_v += self._aw * self._shortfall
            self.output_v = output_v

    def track(self, output_v: float, reference_m: float, position_m: float,
              velocity_m_s: float = 0.0, acceleration_m_s2: float = 0.0,
              forward_v: float = 0.0) -> None:
        """Follow another controller (or a hand) so that taking over from it gives no bump.

        Call it in place of `step`, each sample or once: the next `step` returns `output_v`, as
        far as the limits allow, if the stage stands still (once) or goes on as it did (each).

        Raises
        ------
        ControlError
            If an input is not finite.
        """
        now = (reference_m, position_m, velocity_m_s, acceleration_m_s2, forward_v)
        if not all(map(math.isfinite, (output_v, *now))):
            raise ControlError("pid: track needs finite numbers")
        if self._last is not None:
            moved = self._c * (reference_m - self._last[0]) - (position_m - self._last[1])
            self._derivative = self._decay * self._derivative + moved * self._per_dt
        self._last = now
        self.output_v = min(self._limit, max(-self._limit, output_v))
        self._go_on_from(self.output_v)
        self.fault = ""

    def change(self, plan: PidGains, forward_v: float = 0.0) -> None:
        """Change the gains, or the feedforward, without a bump.

        The integral takes up what the other parts change by, so that the output goes on from
        where it was. Without integral action in the new gains that share decays with the tracking
        time instead of staying for ever.
        """
        before, notched = self._parts(), self._notch is not None or plan.notch_hz > 0.0
        self._use(plan)
        if self._last is not None:
            self._last = (*self._last[:4], forward_v)
        if notched:
            self._go_on_from(self.output_v)
        else:
            self.integral_v += before - self._parts()

    def _go_on_from(self, output_v: float) -> None:
        """Choose integral and notch so that the output is this at the last inputs."""
        self.integral_v = output_v - self._parts()
        if self._notch is not None:
            self._notch.reset(output_v - self._forward())

    def _forward(self) -> float:
        """The feedforward at the last inputs, V."""
        if self._last is None:
            return 0.0
        reference, _, velocity, acceleration, added = self._last
        return self._fp * reference + self._fv * velocity + self._fa * acceleration + added

    def _parts(self) -> float:
        """All of the output at the last inputs but the integral (notch aside), V."""
        if self._last is None:
            return 0.0
        return (self._kp * (self._b * self._last[0] - self._last[1])
                + self._kd * self._derivative + self._forward())

    def _use(self, gains: PidGains) -> None:
        self._gains = gains
        self._kp, self._kd = gains.kp, gains.kd
        self._b, self._c = gains.setpoint_weight, gains.derivative_weight
        self._fp, self._fv, self._fa = (gains.feedforward_position, gains.feedforward_velocity,
                                        gains.feedforward_acceleration)
        self._steady = self._kp * (self._b - 1.0) + self._fp
        self._limit = gains.output_limit_v
        self._clamping = gains.anti_windup == "clamping"
        self._i_limit = math.inf if gains.anti_windup == "none" else gains.output_limit_v
        self._notch = gains.notch(self._period)
        (self._ki_h, self._leak, self._aw, self._decay, self._per_dt,
         self._slew_h) = self._coefficients(self._period)

    def _coefficients(self, h: float) -> tuple[float, float, float, float, float, float]:
        gains = self._gains
        share = min(1.0, h / gains.back_calculation_time_s(h))
        integrates = gains.ki > 0.0
        returned = share if integrates and gains.anti_windup == "back_calculation" else 0.0
        return (gains.ki * h, 0.0 if integrates else share, returned,
                gains.derivative_filter_s / (gains.derivative_filter_s + h),
                1.0 / (gains.derivative_filter_s + h), gains.slew_limit_v_s * h)

    def _faulted(self) -> float:
        self.fault = "reference or measurement is not a finite number"
        self.saturated = False
        self.output_v = 0.0
        self._last = None
        return 0.0
