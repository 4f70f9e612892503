"""The Riccati differential equation of a regulator that has a finite time, and its limit.

For x' = A x + B u and the cost of the integral of x'Q x + u'R u plus x(t_f)' P_f x(t_f), the
optimal input is u(t) = -L(t) x(t) with L = R^-1 B' P and

    -P' = P A + A' P - P B R^-1 B' P + Q,    P(t_f) = P_f

(Anderson and Moore, Optimal Control: Linear Quadratic Methods, 1990, sec. 2.3). A cost that
weights the end with one half and the way with one has the boundary value P_f / 2 instead.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array
from dfm_stage.control.errors import ControlError

_GROWTH = 2.0   # exponent of the largest growth between two restarts


def finite_horizon(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, P_f: ArrayLike,
                   times: ArrayLike) -> Array:
    """Return P at `times` (N,), the last of which is the end t_f, as an array (N, n, n).

    P = Y X^-1, where (X, Y) obeys the linear Hamiltonian system [[A, -B R^-1 B'], [-Q, -A']].
    It is advanced backwards by the matrix exponential, started anew from (I, P) so often that
    nothing grows by more than e^2 in between: the modified Davison-Maki method (Kenney and
    Leipnik, IEEE Trans. Autom. Control 30(10), 1985). There is no step-size error.

    Parameters
    ----------
    A, B, Q, R, P_f : array_like
        (n, n), (n, m) or (n,), (n, n), (m, m) or a number, (n, n). Q and P_f symmetric and not
        negative, R symmetric and positive.
    times : array_like
        (N,) s, rising.

    Raises
    ------
    ControlError
        If a shape does not fit, a number is not finite, a weight is not symmetric or has a wrong
        sign, or the times do not rise.
    """
    from scipy.linalg import expm, matrix_balance

    a, b, q, r = _checked(A, B, Q, R)
    n = len(a)
    end = _weight(P_f, "P_f", n)
    t = np.asarray(times, dtype=np.float64)
    if t.ndim != 1 or t.size == 0 or not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0.0):
        raise ControlError("times must be a list of rising numbers of seconds")
    # State x = s z: the same problem in z has matrices of like size.
    s = np.diag(matrix_balance(a, permute=False)[1])
    a, b = a * s / s[:, None], b / s[:, None]
    q, p = q * np.outer(s, s), end * np.outer(s, s)
    hamiltonian = np.block([[a, -b @ np.linalg.solve(r, b.T)], [-q, -a.T]])
    rate = float(np.max(np.abs(np.linalg.eigvals(hamiltonian).real), initial=0.0))
    out = np.empty((t.size, n, n))
    out[-1] = end
    exponential, of = np.empty(0), math.nan
    for k in range(t.size - 2, -1, -1):
        span = float(t[k + 1] - t[k])
        parts = max(1, math.ceil(rate * span / _GROWTH))
        if span / parts != of:
            of = span / parts
            exponential = expm(-hamiltonian * of)
        for _ in range(parts):
            both = exponential @ np.vstack((np.eye(n), p))
            p = np.linalg.solve(both[:n].T, both[n:].T)
            p = 0.5 * (p + p.T)
        out[k] = p / np.outer(s, s)
    return out


def algebraic(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike) -> Array:
    """Return the P (n, n) that the equation above tends to as the end moves away.

    Raises
    ------
    ControlError
        As `finite_horizon`, or if there is no stabilising solution.
    """
    from scipy.linalg import LinAlgError, solve_continuous_are

    a, b, q, r = _checked(A, B, Q, R)
    try:
        return np.asarray(solve_continuous_are(a, b, q, r))
    except LinAlgError as error:
        raise ControlError("riccati: there is no stabilising solution; a mode that is not damped "
                           f"must be reached by B and weighted by Q ({error})") from error


def feedback_gain(P: ArrayLike, B: ArrayLike, R: ArrayLike) -> Array:
    """Return L = R^-1 B' P, shape (..., m, n), for P of shape (..., n, n)."""
    p = np.asarray(P, dtype=np.float64)
    b = np.asarray(B, dtype=np.float64).reshape(p.shape[-1], -1)
    r = np.asarray(R, dtype=np.float64).reshape(b.shape[1], b.shape[1])
    return np.asarray(np.linalg.solve(r, b.T) @ p)


def _checked(A: ArrayLike, B: ArrayLike, Q: ArrayLike,
             R: ArrayLike) -> tuple[Array, Array, Array, Array]:
    a = np.asarray(A, dtype=np.float64)
    if a.ndim != 2 or a.shape[0] != a.shape[1] or a.size == 0 or not np.all(np.isfinite(a)):
        raise ControlError(f"A must be square and finite, not of shape {a.shape}")
    b = np.asarray(B, dtype=np.float64)
    if b.ndim not in (1, 2) or b.shape[0] != len(a) or not np.all(np.isfinite(b)):
        raise ControlError(f"B must be finite and have {len(a)} rows, not shape {b.shape}")
    b = b.reshape(len(a), -1)
    r = _weight(R, "R", b.shape[1])
    if np.min(np.linalg.eigvalsh(r)) <= 0.0:
        raise ControlError("R must be positive: every input has to cost something")
    return a, b, _weight(Q, "Q", len(a)), r


def _weight(values: ArrayLike, name: str, size: int) -> Array:
    w = np.asarray(values, dtype=np.float64)
    w = w.reshape(1, 1) if w.size == 1 and size == 1 else w
    if w.shape != (size, size) or not np.all(np.isfinite(w)):
        raise ControlError(f"{name} must be finite with shape ({size}, {size}), not {w.shape}")
    largest = float(np.max(np.abs(w), initial=0.0))
    if np.max(np.abs(w - w.T)) > 1e-9 * largest:
        raise ControlError(f"{name} must be symmetric")
    if np.min(np.linalg.eigvalsh(w)) < -1e-9 * largest:
        raise ControlError(f"{name} must not have negative eigenvalues")
    return np.asarray(0.5 * (w + w.T))
