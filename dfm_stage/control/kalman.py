"""The steady Kalman filter of a sampled stage, with or without a force that drifts.

    x[k+1] = A x[k] + B u[k] + w[k],    y[k] = c x[k] + v[k]
    x^[k] = x-[k] + K (y[k] - c x-[k]),    x-[k+1] = A x^[k] + B u[k]

K is the limit of the filter's gain, P c' / (c P c' + r) with P from the algebraic Riccati
equation (Anderson and Moore, Optimal Filtering, 1979, ch. 4). On a linear time-invariant stage the
gain gets there within the first second and stays; with it fixed, a sample costs two products with
a matrix instead of a covariance update. `KalmanDesign.reference_filter` is filterpy's filter with
the same matrices, for comparison and for whoever wants the covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.control.errors import ControlError
from dfm_stage.control.stage import Sampled

Array = NDArray[np.float64]
UNKNOWN_NOISE_M = 5e-8


@dataclass(frozen=True)
class KalmanDesign:
    """A (n, n), B, c, gain (n,), noise covariance Q (n, n) and r (m^2), covariance P (n, n).

    With a drifting force the last state is that force in N.
    """

    A: Array
    B: Array
    c: Array
    gain: Array
    Q: Array
    r: float
    P: Array
    drifting_force: bool

    def reference_filter(self) -> Any:
        """Return filterpy's KalmanFilter with these matrices, its covariance in the steady state.

        Its order of calls is update(y), then predict(u).
        """
        from filterpy.kalman import KalmanFilter

        n = self.B.size
        found = KalmanFilter(dim_x=n, dim_z=1, dim_u=1)
        found.F, found.B, found.H = self.A, self.B[:, None], self.c[None]
        found.Q, found.R, found.P = self.Q, np.array([[self.r]]), self.P.copy()
        found.x = np.zeros((n, 1))
        return found


def kalman(stage: Sampled, *, noise_m: float, force_n: float,
           drift_n_per_root_s: float = 0.0) -> KalmanDesign:
    """Return the steady filter of a stage.

    Parameters
    ----------
    stage : Sampled
        With the direction `g` of a force.
    noise_m : float
        RMS of the reading's noise; rounding to a count q adds q^2 / 12.
    force_n : float
        RMS of a white force, held over each sample: how far the model is trusted.
    drift_n_per_root_s : float
        Above zero: a force that wanders by this much in a second is estimated too.

    Raises
    ------
    ControlError
        If a number is not above zero (the drift: below), or the stage cannot be observed.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    for name, value in (("noise_m", noise_m), ("force_n", force_n)):
        if not (math.isfinite(value) and value > 0.0):
            raise ControlError(f"kalman: {name} must be a number above zero, not {value!r}")
    if not (math.isfinite(drift_n_per_root_s) and drift_n_per_root_s >= 0.0):
        raise ControlError("kalman: drift_n_per_root_s must not be below zero, "
                           f"not {drift_n_per_root_s!r}")
    a, b, c = stage.a, stage.b, stage.c
    q = force_n**2 * np.outer(stage.g, stage.g)
    if drift_n_per_root_s > 0.0:
        n = b.size
        a = np.block([[a, stage.g[:, None]], [np.zeros((1, n)), np.ones((1, 1))]])
        b, c = np.append(b, 0.0), np.append(c, 0.0)
        q = np.pad(q, (0, 1))
        q[n, n] = drift_n_per_root_s**2 * stage.sample_period_s
    # In units of the reading's noise everything is of a size that the solver likes.
    try:
        p = solve_discrete_are(a.T, c[:, None], q / noise_m**2, np.eye(1)) * noise_m**2
    except (LinAlgError, ValueError) as error:
        raise ControlError(f"kalman: the stage's states cannot be told from its position "
                           f"({error})") from error
    r = noise_m**2
    return KalmanDesign(a, b, c, p @ c / (c @ p @ c + r), q, r, p, drift_n_per_root_s > 0.0)


def reading_noise_m(base: dict[str, float]) -> float:
    """Return the RMS of noise and rounding of a model's reading, at least 1 pm.

    A model that says nothing of either, as one identified from a bag may, is taken to have
    50 nm: no noise at all would make the filter believe every count.
    """
    if "noise" not in base and "encoder_resolution" not in base:
        return UNKNOWN_NOISE_M
    return math.sqrt(max(base.get("noise", 0.0)**2
                         + base.get("encoder_resolution", 0.0)**2 / 12.0, 1e-24))
