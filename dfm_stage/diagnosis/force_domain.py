"""Records in the force domain: what the actuator gave, and what each term of a model would give.

    G * (force_constant u(t - late)) = G * (mass x'' + damping x' + stiffness x - missing force)

The same Gaussian filter G is applied to every term, so that derivatives of a noisy position exist
and no term is shifted against another. Nonlinear terms are computed from a motion that is filtered
as lightly as the noise allows, and then filtered like all others. No effect is known by its name:
its hooks are run along the measured motion.
Source of the equation: Masri and Caughey, J. Appl. Mech. 46 (1979) 433 (restoring force); Janot,
Vandanjon and Gautier, IEEE Trans. Control Syst. Technol. 22 (2014) 132 (inverse dynamic model).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.spectra import density
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.along import Motion, force_along, friction_along
from dfm_stage.model.effect import Effect, reads
from dfm_stage.model.kernel import along
from dfm_stage.model.kernel.hooks import address
from dfm_stage.model.linear import linear_part
from dfm_stage.model.parameter import BASE_BY_NAME
from dfm_stage.transforms import longer_length

CONTINUED = 400
"""Samples by which a signal is continued at its ends before it is filtered."""
EDGE = 4.0
"""Filter widths at each end of a record that are left out: the filter reaches into what was
continued."""
STRIDE = 0.8
"""Filter widths between the samples that are kept: the filter leaves nothing to see between."""
WIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0)
"""Standard deviations of the filter that are tried, in samples."""
QUIET = 0.03
"""Noise of a filtered position, speed or acceleration over its RMS that nonlinear terms bear."""
STILL = 3.0
"""Speed over its noise below which the point may rest."""
RESTS, RESTS_PERIOD = 20, 0.05
"""Samples in a row, and share of the motion's mean period, at such speeds that are a rest, where
friction may have any value. A reversal of a sine is at such speeds for 0.02 of its period."""
REACH = 2.0
"""Filter widths around a rest that are left out with it."""
LEAST_MOVING = 0.1
"""Share of a record that must move: of one that hardly does, rests are kept for want of more."""
HELD_LATE = 0.3
"""Samples: an input that acts earlier was not held (a held one is late by half a sample)."""


class Grid:
    """The frequencies of one record that is continued at its ends, for filters without delay."""

    def __init__(self, size: int, period: float) -> None:
        self.size, self.period = size, period
        self.pad = min(CONTINUED, size - 1)
        self.length = longer_length(size + 2 * self.pad)
        turns = np.arange(self.length // 2 + 1, dtype=np.float64)
        self.omega: Array = turns * (2.0 * math.pi / (self.length * period))

    def spectrum(self, signal: Array) -> Complex:
        """Of `signal` (N,), continued oddly about its ends and faded into its mean."""
        pad, mean = self.pad, float(np.mean(signal))
        fade = 0.5 - 0.5 * np.cos(math.pi * np.arange(pad) / max(pad, 1))
        before = 2.0 * signal[0] - signal[pad:0:-1]
        after = 2.0 * signal[-1] - signal[-2:-2 - pad:-1]
        whole = np.concatenate((mean + (before - mean) * fade, signal,
                                mean + (after - mean) * fade[::-1],
                                np.full(self.length - self.size - 2 * pad, mean)))
        return np.asarray(np.fft.rfft(whole))

    def signal(self, spectrum: Complex) -> Array:
        """(N,) of a spectrum as above."""
        return np.asarray(np.fft.irfft(spectrum, self.length)[self.pad:self.pad + self.size])

    def gauss(self, width: float) -> Array:
        """The filter of standard deviation `width` (samples)."""
        return np.asarray(np.exp(-0.5 * (self.omega * width * self.period) ** 2))


@dataclass(frozen=True)
class Timing:
    """How late the input acts, in s; `held` where it is held from sample to sample."""

    late: float
    lag: float
    held: bool


@dataclass(frozen=True)
class Trajectory:
    """Position, speed and acceleration (N,) that nonlinear terms are computed from, and the noise
    (m/s) that the speed keeps."""

    x: Array
    v: Array
    a: Array
    speed_noise: float


class RunForces:
    """One run: its motion at the filter's width, and the terms of the equation of forces."""

    def __init__(self, run: Observation, width: float) -> None:
        self.run, self.width = run, width
        self.grid = Grid(run.output.size, run.sample_period)
        self.y_spectrum = self.grid.spectrum(run.output)
        self.x_spectrum = self.y_spectrum if run.order == 0 else self.grid.spectrum(run.position)
        self.u_spectrum = self.grid.spectrum(run.input)
        self.noise = noise_density(run.output)

    @cached_property
    def gauss(self) -> Array:
        """The filter of every term."""
        return self.grid.gauss(self.width)

    def at_width(self, width: float) -> RunForces:
        """The same run behind another filter."""
        other = object.__new__(RunForces)
        other.__dict__.update({k: v for k, v in self.__dict__.items()
                               if k in _OF_RUN})
        other.width = width
        return other

    def sharp(self) -> RunForces:
        """The same motion and the same samples with terms behind no filter."""
        other = self.at_width(0.0)
        other.__dict__.update(trajectory=self.trajectory, kept=self.kept)
        return other

    def derivative(self, order: int, width: float | None = None) -> Array:
        """The derivative (N,) of the position of this order, behind a filter."""
        grid = self.grid
        gauss = self.gauss if width is None else grid.gauss(width)
        measured = self.run.order if order >= self.run.order else 0
        spectrum = self.y_spectrum if measured else self.x_spectrum
        return grid.signal(spectrum * gauss * (1j * grid.omega) ** (order - measured))

    def filtered(self, signal: Array) -> Array:
        """`signal` (N,) behind the filter."""
        return self.grid.signal(self.grid.spectrum(signal) * self.gauss)

    def drive(self, timing: Timing, order: int = 0, signal: Array | None = None) -> Array:
        """The input (N,) as it acts, V or A, or its derivative in V/s^order."""
        omega, period = self.grid.omega, self.grid.period
        spectrum = self.u_spectrum if signal is None else self.grid.spectrum(signal)
        late = np.exp(-1j * omega * timing.late) / (1.0 + 1j * omega * timing.lag)
        if timing.held:             # the delay of half a sample stands in `late`
            late = late * np.sinc(0.5 * omega * period / math.pi)
        return self.grid.signal(spectrum * late * self.gauss * (1j * omega) ** order)

    def operated(self, operator: Complex) -> Array:
        """A linear operator (F,) on the position, behind the filter."""
        return self.grid.signal(self.x_spectrum * operator * self.gauss)

    def noise_rms(self, stiffness: Complex | Array, width: float) -> float:
        """RMS that the noise of the output leaves of an operator (F,) on the position."""
        power = np.abs(stiffness) ** 2
        if self.run.order:
            power[1:] /= self.grid.omega[1:] ** (2 * self.run.order)
            power[0] = 0.0
        power *= self.grid.gauss(width) ** 2
        return math.sqrt(self.noise * float(np.mean(power)))

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion, as lightly filtered as its noise allows and never more than the rest."""
        found = []
        for order in range(3):
            operator = self.grid.omega ** order
            width = next((w for w in (0.5, *WIDTHS) if w >= self.width or self.noise_rms(
                operator, w) < QUIET * float(np.std(self.derivative(order, w)))), self.width)
            width = min(width, self.width)
            found.append((self.derivative(order, width), self.noise_rms(operator, width)))
        return Trajectory(found[0][0], found[1][0], found[2][0], found[1][1])

    @cached_property
    def kept(self) -> Array:
        """Which samples (n,) take part: not those at the ends, at rest, or between two others."""
        edge = math.ceil(EDGE * self.width)
        keep = np.zeros(self.grid.size, dtype=bool)
        keep[max(edge, self.run.skip):self.grid.size - edge] = True
        moving = keep & np.logical_not(self._rests())
        if np.sum(moving) > LEAST_MOVING * np.sum(keep):
            keep = moving
        stride = max(1, int(STRIDE * self.width))
        return np.asarray(np.flatnonzero(keep[::stride]) * stride)

    def _rests(self) -> Array:
        t = self.trajectory
        slow = np.abs(t.v) < STILL * t.speed_noise
        period = 2.0 * math.pi * float(np.std(t.x)) / max(float(np.std(t.v)), 1e-300)
        shortest = max(RESTS, RESTS_PERIOD * period / self.grid.period)
        reach = round(REACH * self.width)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], slow.view(np.int8), [0]))))
        rests = np.zeros(slow.size, dtype=bool)
        for first, last in edges.reshape(-1, 2):
            if last - first >= shortest:
                rests[max(0, first - reach):last + reach] = True
        return rests


def noise_density(output: Array) -> float:
    """The variance (m^2) of white noise that a position (N,) has at the highest frequencies.

    Of second differences, so that a drift or a jump at the ends does not leak there.
    """
    frequencies, power = density(np.diff(output, 2), min(1024, output.size // 4))
    top = frequencies > TOP
    return float(np.median(0.5 * power[top] / (2.0 * np.sin(math.pi * frequencies[top])) ** 4))


TOP = 0.375
"""Cycles per sample above which a position is taken to be noise."""


_OF_RUN = ("run", "grid", "x_spectrum", "y_spectrum", "u_spectrum", "noise")
"""What does not depend on the filter."""


@dataclass(frozen=True)
class Linear:
    """The linear part as fitted in the force domain: mass, damping and stiffness, SI."""

    mass: float
    damping: float
    stiffness: float

    def operator(self, omega: Array) -> Complex:
        """Force per position (F,), N/m."""
        s = 1j * omega
        return np.asarray(self.mass * s * s + self.damping * s + self.stiffness)

    def force(self, t: Trajectory) -> Array:
        """The force (N,) that moves the linear part along a motion."""
        return np.asarray(self.mass * t.a + self.damping * t.v
                          + self.stiffness * (t.x - np.mean(t.x)))


class Terms:
    """Computes the force that each effect would give along the measured motion of `runs`."""

    def __init__(self, runs: Sequence[RunForces], model: Model, linear: Linear,
                 timing: Timing) -> None:
        self.runs, self.model, self.linear, self.timing = runs, model, linear, timing
        self.gain = model.base.get("force_constant", 1.0)
        kept = linear.mass if linear.mass > 0.0 else model.base["mass"]
        self.needed: dict[int, Complex] = {}
        self.bare = Model("bare", model.sample_period, drive=model.drive, base={
            name: BASE_BY_NAME[name].inside(value) for name, value in (
                ("mass", kept), ("damping", linear.damping), ("stiffness", linear.stiffness))})

    def parts(self, name: str,
              parameters: Mapping[str, float]) -> Callable[[RunForces], Array] | None:
        """What gives the force (N,) of an effect on the stage along a run, filtered; None where
        it has none in the force domain."""
        effect = EFFECTS[name]
        values = np.array([parameters.get(n, d) for n, d in effect.defaults.items()])
        found = [part for applies, part in _PARTS if applies(effect)]
        if not found:
            return None
        return lambda run: np.asarray(np.sum([part(self, run, effect, values)
                                              for part in found], axis=0))

    def motion(self, run: RunForces) -> Motion:
        """The measured motion; what the actuator gives is what moves the linear part, because a
        term made of the input would predict itself."""
        t = run.trajectory
        return Motion.of(self.model, t.x, t.v, self.linear.force(t), run.grid.period)

    def moved(self, run: RunForces, effect: Effect, values: Array) -> Array:
        """A force along the motion."""
        return run.filtered(force_along(effect, values, self.motion(run)))

    def added(self, run: RunForces, effect: Effect, values: Array) -> Array:
        """What is added to the command."""
        changed = np.array(run.run.input)
        along.additions_along(address("added", [(effect, 0)]), values, run.grid.period, changed)
        return run.drive(self.timing, signal=changed - run.run.input) * self.gain

    def dry(self, run: RunForces, effect: Effect, values: Array) -> Array:
        """Dry friction by the sign that a noisy speed has on average."""
        from scipy.special import erf

        t = run.trajectory
        noise = math.sqrt(2.0) * max(t.speed_noise, 1e-9 * float(np.std(t.v)), 1e-300)
        return run.filtered(-friction_along(effect, values, self.motion(run)) * erf(t.v / noise))

    def constant(self, run: RunForces, _: Effect, values: Array) -> Array:
        """A constant force."""
        return np.full(run.grid.size, values[0])

    def limited(self, run: RunForces, _: Effect, values: Array) -> Array:
        """What a limit of the command takes away."""
        cut = np.clip(run.run.input, -values[0], values[0]) - run.run.input
        return run.drive(self.timing, signal=cut) * self.gain

    def other(self, run: RunForces, effect: Effect, values: Array) -> Array:
        """A force per metre of the neighbouring axis."""
        if run.run.other is None or effect.other_force is None:
            return np.zeros(run.grid.size)
        return run.filtered(run.run.other * effect.other_force(tuple(values)))

    def sensed(self, run: RunForces, effect: Effect, values: Array) -> Array:
        """An error of the reading, as the force that would have moved the stage so."""
        empty, out = np.empty(0), np.zeros(run.grid.size)
        other = run.run.other if run.run.other is not None else empty
        along.senses_along(address("sense", [(effect, 0)]), values, run.trajectory.x,
                           run.grid.period, other, out)
        return run.grid.signal(run.grid.spectrum(out) * run.gauss
                               * self.linear.operator(run.grid.omega))

    def stamped(self, run: RunForces, effect: Effect, values: Array) -> Array:
        """A linear part: by how much less force per position the stage needs with it."""
        if effect.start is not None and effect.wave is not None:
            w = 2.0 * math.pi * values[[p.name for p in effect.parameters].index(
                effect.wave.parameter)]
            phase = values[[p.name for p in effect.parameters].index(effect.wave.phase)]
            return run.filtered(values[0] * np.sin(w * run.run.time + phase))
        whole = self.bare.with_effect(effect.name, dict(zip(effect.defaults, values.tolist(),
                                                            strict=True)))
        omega = run.grid.omega
        changed = np.zeros(omega.size, dtype=complex)
        needed = 1.0 / _response(whole, omega[1:])
        if effect.late is not None:     # beside the timing of the input, which is free
            needed *= np.exp(-1j * omega[1:] * linear_part(whole).lag_s)
        if run.grid.length not in self.needed:
            self.needed[run.grid.length] = 1.0 / _response(self.bare, omega[1:])
        changed[1:] = self.needed[run.grid.length] - needed
        return run.operated(changed)


def _response(model: Model, omega: Array) -> Complex:
    """Position per force (F,), by the poles: there are thousands of frequencies."""
    part = linear_part(model)
    poles, vectors = np.linalg.eig(part.a)
    residues = (part.c @ vectors) * np.linalg.solve(vectors, part.b.astype(complex))
    return np.asarray((residues / (1j * omega[:, None] - poles)).sum(axis=1))


_Part = Callable[[Terms, RunForces, Effect, Array], Array]
_PARTS: tuple[tuple[Callable[[Effect], bool], _Part], ...] = (
    (lambda e: any((e.force, e.advance, e.flow)), Terms.moved),
    (lambda e: e.added is not None, Terms.added),
    (lambda e: e.friction is not None or e.adds_to == "dry_friction", Terms.dry),
    (lambda e: e.adds_to == "constant_force", Terms.constant),
    (lambda e: e.adds_to == "command_limit", Terms.limited),
    (lambda e: e.other_force is not None, Terms.other),
    (lambda e: e.sense is not None, Terms.sensed),
    (lambda e: e.stamp is not None, Terms.stamped))
"""Which effects have a part, and the force of it."""


def not_judged(effect: Effect, spring: bool = True, driven: bool = True) -> str | None:
    """Why an effect has no term in the equation of forces, in words; None where it has."""
    if not driven and effect.stamp is not None and effect.wave is None:
        return "without an input it is not to be told from the stage's own linear part"
    if effect.late is not None and effect.stamp is None:
        return "the timing of the input is free: it stands for every slight delay"
    if effect.sense is not None and not (spring or effect.couples or reads(effect.sense, 0)):
        return "without a spring a drift of the reading is a constant force"
    if effect.rounds:
        return "a rounded reading is noise in the force domain"
    if not any(applies(effect) for applies, _ in _PARTS):
        return "it has no force along a measured motion"
    return None


def shifted(timing: Timing, by: float, period: float) -> Timing:
    """The timing `by` s later."""
    late = timing.late + by
    return replace(timing, late=late, held=late > HELD_LATE * period)
