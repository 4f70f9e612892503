"""The fourth-order (Euler-Bernoulli) beam equation for stages on parallel blades.

E I w'''' + rho A w_tt = 0 on every blade, its ends kept from rotating by rigid stages: solved
exactly with the dynamic stiffness of a blade between its two end deflections (Clough and Penzien,
Dynamics of Structures, ch. 17),

    D(W) = n E I / L^3 b^3 / (1 - cos b cosh b) [[s, -r], [-r, s]],
    s = sin b cosh b + cos b sinh b,  r = sin b + sinh b,

with b^4 = rho A L^4 W^2 / E I and n blades side by side. A chain of such spans from the ground,
with a stage's mass at every joint, is a single parallelogram (one span) or a double one (two).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from dfm_stage.arrays import Array, Complex
from dfm_stage.model.flexure import Blade, DoubleParallelogram, FlexureError

_SERIES = 0.3


@dataclass(frozen=True)
class Span:
    """`count` equal blades side by side between two stages."""

    blade: Blade
    count: int = 2

    @property
    def blade_period(self) -> float:
        """W / b^2 = sqrt(E I / rho A) / L^2, rad/s."""
        blade = self.blade
        return math.sqrt(blade.bending_stiffness / blade.mass_per_length) / blade.length_m**2

    def dynamic_stiffness(self, omega: complex) -> Complex:
        """Return D between the deflections of the two ends, complex (2, 2), N/m."""
        blade = self.blade
        unit = self.count * blade.bending_stiffness / blade.length_m**3
        b = np.sqrt(complex(omega) / self.blade_period)
        if abs(b) < _SERIES:
            b4 = b**4
            near = 12.0 - 13.0 / 35.0 * b4 - 59.0 / 161700.0 * b4**2
            far = -12.0 - 9.0 / 70.0 * b4 - 1279.0 / 3880800.0 * b4**2
        else:
            # Divided by cosh b, so that nothing overflows at high frequencies.
            sech, tanh = 1.0 / np.cosh(b), np.tanh(b)
            below = sech - np.cos(b)
            near = b**3 * (np.sin(b) + np.cos(b) * tanh) / below
            far = -b**3 * (np.sin(b) * sech + tanh) / below
        return np.asarray(unit * np.array([[near, far], [far, near]]), dtype=np.complex128)


@dataclass(frozen=True)
class Mode:
    """A natural frequency, W, rad/s; the stages' deflections (n,) for unit modal mass, kg^-1/2."""

    omega: float
    shape: Array

    @property
    def frequency_hz(self) -> float:
        """Natural frequency, Hz."""
        return self.omega / (2.0 * math.pi)


@dataclass(frozen=True)
class BladeChain:
    """Spans in series from the ground, a stage of `masses_kg[i]` at the end of span i."""

    spans: Sequence[Span]
    masses_kg: Sequence[float]

    def __post_init__(self) -> None:
        if not self.spans or len(self.spans) != len(self.masses_kg):
            raise FlexureError(f"{len(self.spans)} spans need as many stage masses, "
                               f"not {len(self.masses_kg)}")
        if any(not mass >= 0.0 for mass in self.masses_kg):
            raise FlexureError("a stage's mass must not be negative")

    def dynamic_stiffness(self, omega: complex) -> Complex:
        """Return forces per deflections of the stages at a frequency, complex (n, n), N/m."""
        n = len(self.spans)
        full = np.zeros((n, n), dtype=complex)
        for i, span in enumerate(self.spans):
            d = span.dynamic_stiffness(omega)
            full[i, i] += d[1, 1] - omega**2 * self.masses_kg[i]
            if i:
                full[i - 1:i + 1, i - 1:i + 1] += np.array([[d[0, 0], d[0, 1]], [d[1, 0], 0.0]])
        return full

    def compliance(self, frequency_hz: Array, loss_factor: float = 0.0,
                   damping_n_s_m: float = 0.0) -> Complex:
        """Return the last stage's deflection per force on it at frequencies (F,), m/N, (F,).

        The answer to a sinusoidal force. `loss_factor` makes the modulus complex, E (1 + i eta);
        `damping_n_s_m` acts between the last stage and the ground.
        """
        out = np.empty(np.size(frequency_hz), dtype=complex)
        for k, f in enumerate(np.atleast_1d(frequency_hz)):
            omega = 2.0 * math.pi * float(f)
            # E (1 + i eta) in D is (1 + i eta) D at the frequency over sqrt(1 + i eta).
            softer = np.sqrt(1.0 + 1j * loss_factor)
            full = (1.0 + 1j * loss_factor) * self.dynamic_stiffness(omega / softer)
            full[-1, -1] += 1j * omega * damping_n_s_m
            out[k] = np.linalg.inv(full)[-1, -1]
        return out

    def modes(self, count: int) -> list[Mode]:
        """Return the lowest modes in which stages move, in order.

        Frequencies are counted with the algorithm of Wittrick and Williams (Q. J. Mech. Appl.
        Math. 24, 1971), so none is missed. Modes of blades between stages at rest are left out.

        Raises
        ------
        FlexureError
            If `count` is not positive, or a frequency coincides with one of a blade between stages
            at rest.
        """
        if count < 1:
            raise FlexureError(f"count must be at least 1, not {count}")
        found: list[Mode] = []
        low = 1e-6 * min(span.blade_period for span in self.spans)
        high = max(span.blade_period for span in self.spans)
        number = 0
        while len(found) < count:
            number += 1
            while self._count(high) < number:
                high *= 2.0
            omega = self._bisect(number, low, high)
            mode = self._mode(omega)
            if mode is not None and not (found and abs(found[-1].omega / omega - 1.0) < 1e-9):
                found.append(mode)
            if number > 200 * count:
                raise FlexureError("no further modes in which a stage moves were found")
        return found

    def step_response(self, time_s: Array, force_n: float, damping_ratio: float = 0.0,
                      count: int = 6) -> Array:
        """Return the last stage's deflection, (N,), m, after a force is applied at t = 0.

        The sum over `count` modes, each with the damping ratio given, and the static deflection
        of the modes left out.
        """
        if not 0.0 <= damping_ratio < 1.0:
            raise FlexureError(f"damping_ratio must lie in [0, 1), not {damping_ratio:g}")
        static = float(np.linalg.inv(self.dynamic_stiffness(0.0).real)[-1, -1])
        response = np.zeros(np.shape(time_s))
        share = 0.0
        for mode in self.modes(count):
            part = float(mode.shape[-1])**2 / mode.omega**2
            rate = damping_ratio * mode.omega
            damped = mode.omega * math.sqrt(1.0 - damping_ratio**2)
            angle = damped * np.asarray(time_s)
            response += part * (1.0 - np.exp(-rate * np.asarray(time_s))
                                * (np.cos(angle) + rate / damped * np.sin(angle)))
            share += part
        return np.asarray(force_n * np.where(np.asarray(time_s) > 0.0, response + static - share,
                                             0.0))

    def _count(self, omega: float) -> int:
        """Number of natural frequencies below omega."""
        own = sum(span.count * _clamped_count(math.sqrt(omega / span.blade_period))
                  for span in self.spans)
        stages = self.dynamic_stiffness(omega).real
        return own + int(np.sum(np.linalg.eigvalsh(stages) < 0.0))

    def _bisect(self, number: int, low: float, high: float) -> float:
        while high / low > 1.0 + 1e-13:
            middle = math.sqrt(low * high)
            if middle in (low, high):
                break
            if self._count(middle) >= number:
                high = middle
            else:
                low = middle
        return math.sqrt(low * high)

    def _mode(self, omega: float) -> Mode | None:
        """Return the mode at omega, or None if it belongs to blades between stages at rest."""
        values, vectors = np.linalg.eigh(self.dynamic_stiffness(omega * (1.0 - 1e-9)).real)
        other = np.linalg.eigvalsh(self.dynamic_stiffness(omega * (1.0 + 1e-9)).real)
        below = int(np.sum(values < 0.0))
        if int(np.sum(other < 0.0)) != below + 1:
            return None
        shape = vectors[:, below]
        square, step = omega**2, 1e-5 * omega**2
        slope = (self.dynamic_stiffness(math.sqrt(square + step))
                 - self.dynamic_stiffness(math.sqrt(square - step))).real / (2.0 * step)
        modal_mass = -float(shape @ slope @ shape)
        shape = shape / math.sqrt(modal_mass)
        return Mode(omega, np.asarray(shape * np.sign(shape[-1] or 1.0)))


def _clamped_count(b: float) -> int:
    """Number of natural frequencies of a clamped-clamped blade below b, from cos b cosh b = 1."""
    if b < 4.0:
        return 0
    index = max(1, round(b / math.pi - 0.5))
    near = (index + 0.5) * math.pi
    root = brentq(lambda x: math.cos(x) - 1.0 / math.cosh(min(x, 700.0)), near - 0.5, near + 0.5)
    return index if b > root else index - 1


def manipulator_chain(manipulator: DoubleParallelogram, stage_kg: float,
                      intermediate_kg: float) -> BladeChain:
    """Return the chain of a double parallelogram with the masses of its two stages."""
    span = Span(manipulator.blade, 2)
    return BladeChain((span, span), (intermediate_kg, stage_kg))


def stage_mass_for(manipulator: DoubleParallelogram, omega: float,
                   intermediate_kg: float) -> float:
    """Return the stage's mass, kg, that puts the first natural frequency at omega, rad/s.

    Raises
    ------
    FlexureError
        If the blades and the intermediate stage alone are already slower than that.
    """
    chain = manipulator_chain(manipulator, 0.0, intermediate_kg)
    full = chain.dynamic_stiffness(omega).real
    # The stage's mass closes det(D) = 0: it equals the rest's dynamic stiffness over omega^2.
    condensed = full[1, 1] - full[1, 0] * full[0, 1] / full[0, 0]
    mass = float(condensed) / omega**2
    if not (mass > 0.0 and full[0, 0] > 0.0):
        raise FlexureError(f"the intermediate stage alone is slower than {omega:g} rad/s; make it "
                           "lighter")
    return mass
