"""Models to and from python-control."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from dfm_stage.arrays import Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.stage import sample_model
from dfm_stage.model import Model

if TYPE_CHECKING:
    import control

_CLOSE = 1e-6   # relative: far above rounding, far below what a measurement tells apart


def state_space(model: Model, sample_period_s: float | None = None) -> control.StateSpace:
    """Return the linear part of a one-axis model as a sampled `control.StateSpace`.

    From held input (V or A) to position (m), exactly: modes, lag or coil, and the delay, whose
    inputs on their way are states. By default at the model's own sample period.
    """
    import control

    stage = sample_model(model, sample_period_s)
    return control.ss(stage.a, stage.b[:, None], stage.c[None, :], 0.0, stage.sample_period_s)


def model_of(system: Any, *, sample_period_s: float, mass_kg: float = 1.0, delay_s: float = 0.0,
             name: str = "from_control") -> Model:
    """Return the model of a continuous `control.StateSpace` or `TransferFunction`, V to m.

    One or two modes b / (s^2 + c s + k), behind a first-order lag where the order is odd. From
    volts to metres a mass cannot be seen, so it is chosen. What a second mode brings becomes the
    effect `second_mode`.

    Raises
    ------
    ControlError
        If the system is sampled, has several inputs or outputs, or is of another form.
    """
    import control

    given = control.ss(system)
    if given.ninputs != 1 or given.noutputs != 1:
        raise ControlError("model_of: the system has several inputs or outputs; pass one of them")
    if given.isdtime(strict=True):
        raise ControlError("model_of: the system is sampled; pass the continuous one")
    order = given.nstates
    if not 2 <= order <= 5:
        raise ControlError(f"model_of: order {order}; one mode has 2, two have 4, a lag one more")
    poles, left = np.linalg.eig(np.asarray(given.A, dtype=float))
    residues = (np.asarray(given.C) @ left)[0] * np.linalg.solve(
        left, np.asarray(given.B, dtype=complex))[:, 0]
    lag = 0.0
    if order % 2:
        real = np.flatnonzero(np.abs(poles.imag) < _CLOSE * np.abs(poles).max())
        fast = real[np.argmin(poles[real].real)] if real.size else 0
        lag = -1.0 / poles[fast].real if poles[fast].real < 0.0 else 0.0
        keep = np.arange(order) != fast
        poles, residues = poles[keep], residues[keep] * (1.0 + lag * poles[keep])
    modes = _modes(poles, residues)
    gain = sum(numerator for numerator, _, _ in modes)
    if gain == 0.0:
        raise ControlError("model_of: the modes' numerators add up to nothing")
    first = modes[0]
    model = Model(name, sample_period_s, base={
        "mass": mass_kg, "damping": first[1] * mass_kg, "stiffness": first[2] * mass_kg,
        "force_constant": gain * mass_kg,
        **({"amplifier_time_constant": lag} if lag else {}),
        **({"delay": delay_s} if delay_s else {})})
    if len(modes) > 1:
        numerator, damping, stiffness = modes[1]
        omega = math.sqrt(max(stiffness, 0.0))
        if omega == 0.0:
            raise ControlError("model_of: both modes are without a spring")
        model = model.with_effect("second_mode", {
            "share": numerator / gain, "frequency": omega / (2.0 * math.pi),
            "damping_ratio": damping / (2.0 * omega)})
    _require_same(given, modes, lag)
    return model


def _modes(poles: Complex, residues: Complex) -> list[tuple[float, float, float]]:
    """(b, c, k) of each mode b / (s^2 + c s + k), the slowest first."""
    order = np.lexsort((poles.imag, np.round(np.abs(poles), 9), np.abs(poles.imag) > 0.0))
    poles, residues = poles[order], residues[order]
    return sorted(((float(-(r * q + s * p).real), float(-(p + q).real), float((p * q).real))
                   for p, q, r, s in zip(poles[::2], poles[1::2], residues[::2], residues[1::2],
                                         strict=True)), key=lambda mode: mode[2])


def _require_same(system: Any, modes: list[tuple[float, float, float]], lag: float) -> None:
    """Hold the modes against the system; a numerator with an s or a feedthrough shows here."""
    corner = max(math.sqrt(max(k, c * c, 1e-12)) for _, c, k in modes)
    s = 1j * np.geomspace(1e-2 * corner, 1e2 * corner, 60)
    ours = sum(b / (s * s + c * s + k) for b, c, k in modes) / (1.0 + lag * s)
    theirs = np.asarray(system(s)).ravel()
    if np.max(np.abs(ours - theirs) / np.abs(theirs)) > _CLOSE:
        raise ControlError("model_of: the system is no sum of b / (s^2 + c s + k), behind a lag "
                           "if its order is odd; it has a zero or a feedthrough of its own")
