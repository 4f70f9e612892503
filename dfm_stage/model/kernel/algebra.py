"""Matrix exponentials of small, badly scaled matrices."""

from __future__ import annotations

import numpy as np

from dfm_stage.model.kernel.compiled import at, compiled, inlined, lean
from dfm_stage.model.kernel.slots import Array


@inlined
def row_value(work: Array, row: int, state: int, n: int, u: float) -> float:
    """work[row:] . [work[state:], u] for a state of order n"""
    total: float = at(work, row + n) * u
    for j in range(n):
        total += at(work, row + j) * at(work, state + j)
    return total


@inlined
def cubic_at(coefficients: Array, r: float) -> float:
    """c0 + c1 r + c2 r^2 + c3 r^3"""
    return float(coefficients[0]
                 + r * (coefficients[1] + r * (coefficients[2] + r * coefficients[3])))


@inlined
def outside(force: Array, r: float) -> float:
    """The force from outside at r, of which `force` are the coefficients, or empty, N."""
    return cubic_at(force, r) if force.shape[0] > 0 else 0.0


@lean
def fill(a: Array, value: float) -> None:
    """a[:] = value; numba takes a third of a second to compile a slice assignment."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            a[i, j] = value


@lean
def put_scaled(a: Array, rows: int, factor: float, out: Array) -> None:
    """out = 0 but for the first rows, which are those of factor a"""
    fill(out, 0.0)
    for i in range(rows):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j] * factor


@lean
def assign(source: Array, out: Array) -> None:
    """out[:] = source"""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = source[i, j]


@lean
def largest_row(a: Array) -> float:
    """The largest sum of magnitudes in a row."""
    norm = 0.0
    for i in range(a.shape[0]):
        total = 0.0
        for j in range(a.shape[1]):
            total += abs(a[i, j])
        norm = max(norm, total)
    return norm


@lean
def multiply(a: Array, b: Array, out: Array) -> None:
    """out = a b for small matrices; `out` must be another array."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@lean
def balance(a: Array, scale: Array) -> None:
    """Scale a in place to D^-1 a D with D = diag(scale) of powers of two (Osborne 1960)."""
    n = a.shape[0]
    for i in range(n):
        scale[i] = 1.0
    for _ in range(20):
        changed = False
        for i in range(n):
            row = column = 0.0
            for j in range(n):
                if j != i:
                    row += abs(a[i, j])
                    column += abs(a[j, i])
            if row == 0.0 or column == 0.0:
                continue
            factor = 2.0 ** np.rint(0.5 * np.log2(row / column))
            if factor != 1.0:
                changed = True
                scale[i] *= factor
                for j in range(n):
                    a[i, j] /= factor
                for j in range(n):
                    a[j, i] *= factor
        if not changed:
            break


@compiled
def exponential(a: Array, out: Array) -> None:
    """out = exp(a), by balancing, Taylor series and squaring; relative error near 1e-14."""
    n = a.shape[0]
    scaled, scale = np.empty((n, n)), np.empty(n)
    assign(a, scaled)
    balance(scaled, scale)
    norm = largest_row(scaled)
    squarings = 0
    while norm > 0.5:
        norm *= 0.5
        squarings += 1
    factor = 0.5 ** squarings
    term, other = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            scaled[i, j] *= factor
            term[i, j] = out[i, j] = 1.0 if i == j else 0.0
    for order in range(1, 20):
        multiply(term, scaled, other)
        largest = 0.0
        for i in range(n):
            for j in range(n):
                term[i, j] = other[i, j] / order
                out[i, j] += term[i, j]
                largest = max(largest, abs(term[i, j]))
        if largest < 1e-18:
            break
    for _ in range(squarings):
        multiply(out, out, other)
        assign(other, out)
    for i in range(n):
        for j in range(n):
            out[i, j] *= scale[i] / scale[j]
