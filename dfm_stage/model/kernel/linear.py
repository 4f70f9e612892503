"""Whole records of linear models: one exact step per sample, unrolled for small orders.

p[k] is the input that acts before the switch inside sample k, p[k + 1] the one after it:
s[k + 1] = a s[k] + old p[k] + new p[k + 1] + constant + (ext f[k] for a force from outside).
Each function writes the states before every step to `out`, shape (n, N).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.kernel.compiled import compiled

Array = NDArray[np.float64]


@compiled
def steps(a: Array, old: Array, new: Array, constant: Array, state: Array, p: Array, first: int,
          out: Array) -> None:
    """Advance `state` by out.shape[1] samples."""
    n = state.shape[0]
    if n == 2:
        _steps_2(a, old, new, constant, state, p, first, out)
    elif n == 3:
        _steps_3(a, old, new, constant, state, p, first, out)
    elif n == 4:
        _steps_4(a, old, new, constant, state, p, first, out)
    else:
        _steps_n(a, old, new, constant, state, p, first, out)


@compiled
def _steps_2(a: Array, old: Array, new: Array, constant: Array, state: Array, p: Array,
             first: int, out: Array) -> None:
    a00, a01, a10, a11 = a[0, 0], a[0, 1], a[1, 0], a[1, 1]
    o0, o1, w0, w1, c0, c1 = old[0], old[1], new[0], new[1], constant[0], constant[1]
    s0, s1 = state[0], state[1]
    for k in range(out.shape[1]):
        out[0, k] = s0
        out[1, k] = s1
        u, v = p[first + k], p[first + k + 1]
        z0 = (a00 * s0 + a01 * s1) + (o0 * u + (w0 * v + c0))
        s1 = (a10 * s0 + a11 * s1) + (o1 * u + (w1 * v + c1))
        s0 = z0
    state[0], state[1] = s0, s1


@compiled
def _steps_3(a: Array, old: Array, new: Array, constant: Array, state: Array, p: Array,
             first: int, out: Array) -> None:
    a00, a01, a02 = a[0, 0], a[0, 1], a[0, 2]
    a10, a11, a12 = a[1, 0], a[1, 1], a[1, 2]
    a20, a21, a22 = a[2, 0], a[2, 1], a[2, 2]
    o0, o1, o2, w0, w1, w2 = old[0], old[1], old[2], new[0], new[1], new[2]
    c0, c1, c2 = constant[0], constant[1], constant[2]
    s0, s1, s2 = state[0], state[1], state[2]
    for k in range(out.shape[1]):
        out[0, k] = s0
        out[1, k] = s1
        out[2, k] = s2
        u, v = p[first + k], p[first + k + 1]
        z0 = (a00 * s0 + a01 * s1) + (a02 * s2 + (o0 * u + (w0 * v + c0)))
        z1 = (a10 * s0 + a11 * s1) + (a12 * s2 + (o1 * u + (w1 * v + c1)))
        s2 = (a20 * s0 + a21 * s1) + (a22 * s2 + (o2 * u + (w2 * v + c2)))
        s0, s1 = z0, z1
    state[0], state[1], state[2] = s0, s1, s2


@compiled
def _steps_4(a: Array, old: Array, new: Array, constant: Array, state: Array, p: Array,
             first: int, out: Array) -> None:
    a00, a01, a02, a03 = a[0, 0], a[0, 1], a[0, 2], a[0, 3]
    a10, a11, a12, a13 = a[1, 0], a[1, 1], a[1, 2], a[1, 3]
    a20, a21, a22, a23 = a[2, 0], a[2, 1], a[2, 2], a[2, 3]
    a30, a31, a32, a33 = a[3, 0], a[3, 1], a[3, 2], a[3, 3]
    o0, o1, o2, o3 = old[0], old[1], old[2], old[3]
    w0, w1, w2, w3 = new[0], new[1], new[2], new[3]
    c0, c1, c2, c3 = constant[0], constant[1], constant[2], constant[3]
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    for k in range(out.shape[1]):
        out[0, k] = s0
        out[1, k] = s1
        out[2, k] = s2
        out[3, k] = s3
        u, v = p[first + k], p[first + k + 1]
        z0 = (a00 * s0 + a01 * s1) + (a02 * s2 + a03 * s3) + (o0 * u + (w0 * v + c0))
        z1 = (a10 * s0 + a11 * s1) + (a12 * s2 + a13 * s3) + (o1 * u + (w1 * v + c1))
        z2 = (a20 * s0 + a21 * s1) + (a22 * s2 + a23 * s3) + (o2 * u + (w2 * v + c2))
        s3 = (a30 * s0 + a31 * s1) + (a32 * s2 + a33 * s3) + (o3 * u + (w3 * v + c3))
        s0, s1, s2 = z0, z1, z2
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3


@compiled
def _steps_n(a: Array, old: Array, new: Array, constant: Array, state: Array, p: Array,
             first: int, out: Array) -> None:
    n = state.shape[0]
    after = np.empty(n)
    for k in range(out.shape[1]):
        u, v = p[first + k], p[first + k + 1]
        for i in range(n):
            out[i, k] = state[i]
            total = old[i] * u + (new[i] * v + constant[i])
            for j in range(n):
                total += a[i, j] * state[j]
            after[i] = total
        state[:] = after


@compiled
def steps_with_force(a: Array, old: Array, new: Array, constant: Array, ext: Array, state: Array,
                     p: Array, force: Array, first: int, out: Array) -> None:
    """As `steps`, with the force force[k] . [1, r, r^2, r^3] at r = (t - t_k) / T in sample k."""
    n = state.shape[0]
    after = np.empty(n)
    for k in range(out.shape[1]):
        u, v = p[first + k], p[first + k + 1]
        for i in range(n):
            out[i, k] = state[i]
            total = old[i] * u + (new[i] * v + constant[i])
            for j in range(n):
                total += a[i, j] * state[j]
            for j in range(4):
                total += ext[i, j] * force[first + k, j]
            after[i] = total
        state[:] = after
