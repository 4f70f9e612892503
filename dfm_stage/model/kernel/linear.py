"""Whole records of linear models: one exact step per sample.

p[k] is the input that acts before the switch inside sample k, p[k + 1] the one after it:
s[k + 1] = a s[k] + old p[k] + new p[k + 1] + constant + (ext f[k] for a force from outside).
Each function advances `state` by `count` samples and writes the states before every step to the
columns of `out`, shape (n, count or more).

The loops for orders up to six are written out by a small generator, with all coefficients in
registers, sums as balanced trees and exact zeros left out: modes do not act on each other, nor on
the amplifier, unless something couples them.
"""

from __future__ import annotations

from collections.abc import Callable

from dfm_stage.model.kernel.compiled import lean
from dfm_stage.model.kernel.slots import Array

Steps = Callable[[Array, Array, Array, Array, Array, Array, int, int, Array], None]


def _tree(terms: list[str]) -> str:
    if len(terms) == 1:
        return terms[0]
    half = (len(terms) + 1) // 2
    return f"({_tree(terms[:half])} + {_tree(terms[half:])})"


def _unrolled(order: int, blocks: tuple[tuple[int, ...], ...] = ()) -> Steps:
    """`steps` for one order; each block (i, ...) says that row i uses these columns only."""
    used = {i: range(order) for i in range(order)}
    used.update({columns[0]: columns[1:] for columns in blocks})  # type: ignore[misc]
    lines = ["def steps(a, old, new, constant, state, p, first, count, out):"]
    for i in range(order):
        lines += [f"    a{i}{j} = a[{i}, {j}]" for j in used[i]]
        lines += [f"    o{i}, w{i}, c{i}, s{i} = old[{i}], new[{i}], constant[{i}], state[{i}]"]
    lines += ["    v = p[first]", "    for k in range(count):"]
    lines += [f"        out[{i}, k] = s{i}" for i in range(order)]
    lines += ["        u = v", "        v = p[first + k + 1]"]
    for i in range(order):
        terms = [f"a{i}{j} * s{j}" for j in used[i]]
        lines += [f"        z{i} = {_tree(terms)} + (o{i} * u + (w{i} * v + c{i}))"]
    lines += [f"        s{i} = z{i}" for i in range(order)]
    lines += [f"    state[{i}] = s{i}" for i in range(order)]
    scope: dict[str, Steps] = {}
    exec("\n".join(lines), scope)  # noqa: S102 (text of our own)
    return lean(scope["steps"])


_steps_2, _steps_3, _steps_4, _steps_5, _steps_6 = (_unrolled(n) for n in range(2, 7))
_lagged = _unrolled(3, ((2, 2),))
_two_modes = _unrolled(4, ((0, 0, 1), (1, 0, 1), (2, 2, 3), (3, 2, 3)))
_two_modes_lagged = _unrolled(5, ((0, 0, 1, 2), (1, 0, 1, 2), (2, 2), (3, 2, 3, 4), (4, 2, 3, 4)))


@lean
def steps(a: Array, old: Array, new: Array, constant: Array, ext: Array, state: Array, p: Array,
          force: Array, first: int, count: int, out: Array) -> None:
    """Advance by `count` samples with the fastest loop that fits `a`.

    The force force[k] . [1, r, r^2, r^3], r = (t - t_k) / T, acts in sample k; it may be empty.
    """
    n = state.shape[0]
    if force.shape[0] > 0 or n > 6:
        return _steps_n(a, old, new, constant, ext, state, p, force, first, count, out)
    if n == 2:
        return _steps_2(a, old, new, constant, state, p, first, count, out)
    if n == 3 and _none(a[2:, :2]):
        return _lagged(a, old, new, constant, state, p, first, count, out)
    if n == 3:
        return _steps_3(a, old, new, constant, state, p, first, count, out)
    if n == 4 and _none(a[:2, 2:]) and _none(a[2:, :2]):
        return _two_modes(a, old, new, constant, state, p, first, count, out)
    if n == 4:
        return _steps_4(a, old, new, constant, state, p, first, count, out)
    if (n == 5 and _none(a[:2, 3:]) and _none(a[3:, :2]) and _none(a[2:3, :2])
            and _none(a[2:3, 3:])):
        return _two_modes_lagged(a, old, new, constant, state, p, first, count, out)
    if n == 5:
        return _steps_5(a, old, new, constant, state, p, first, count, out)
    return _steps_6(a, old, new, constant, state, p, first, count, out)


@lean
def _none(part: Array) -> bool:
    for i in range(part.shape[0]):
        for j in range(part.shape[1]):
            if part[i, j] != 0.0:
                return False
    return True


@lean
def _steps_n(a: Array, old: Array, new: Array, constant: Array, ext: Array, state: Array, p: Array,
             force: Array, first: int, count: int, out: Array) -> None:
    n, powers = state.shape[0], force.shape[1] if force.shape[0] > 0 else 0
    for k in range(count):
        u, v = p[first + k], p[first + k + 1]
        for i in range(n):
            out[i, k] = state[i]
        for i in range(n):
            total = old[i] * u + (new[i] * v + constant[i])
            for j in range(n):
                total += a[i, j] * out[j, k]
            for j in range(powers):
                total += ext[i, j] * force[first + k, j]
            state[i] = total
