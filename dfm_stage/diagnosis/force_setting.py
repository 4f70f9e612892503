"""The filter and the timing behind which records are judged in the force domain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.blocks import Blocks, block_edges, jackknife
from dfm_stage.diagnosis.decisions import BLOCKS
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.force_domain import (
    EDGE,
    STRIDE,
    WIDTHS,
    Linear,
    RunForces,
    Timing,
    shifted,
)
from dfm_stage.model import Model
from dfm_stage.model.linear import linear_part

SHORTEST_KEPT = 40
"""Kept samples of the shortest block."""
FEWEST = 6
"""Blocks without which there is no standard error."""
NOISE_SHARE = 0.01
"""Share of the missing force's power that noise may make up: the narrowest filter that keeps
below it is taken."""
BIASED = 0.3
"""Noise of the acceleration over its RMS behind a filter that is wide enough: noise in a term
lowers its coefficient by the square, and with the mass what is taken for noise."""
EARLIEST, LATEST = -2.0, 4.0
"""Samples around the model's delay where the input's timing is looked for."""
TIMED = 4
"""Steps of the search for the timing; it is nearly linear."""
DRIFT_DEGREE = 6
"""Degree up to which polynomials over a record are taken for drift of an integrated position."""
NO_FORCE = 1e-6
"""Share of the force of inertia below which the input does nothing."""


@dataclass(frozen=True)
class Setting:
    """Filtered `runs` with their `timing`; the base columns (n, k) and their `names`, the target
    (n,), and the linear part that they give.

    The target is the actuator's force; of a stage that nothing drives, the force that its given
    mass shows by its acceleration.

    With `offset` every record has an offset of its own: all columns are taken off their means, or
    off their slow drift where the position is integrated.
    """

    runs: Sequence[RunForces]
    timing: Timing
    names: tuple[str, ...]
    columns: Array
    target: Array
    linear: Linear
    offset: bool

    def stacked(self, of: Callable[[RunForces], Array]) -> Array:
        """What `of` gives (N,) or (c, N) of each run, over the kept samples, (n,) or (n, c)."""
        return _stacked(self.runs, self.offset, of)

    def stacked_features(self, of: Callable[[Sequence[RunForces]], Sequence[Array]]) -> Array:
        """The same of what `of` gives (c, N) of all runs together."""
        found = dict(zip(map(id, self.runs), of(self.runs), strict=True))
        return self.stacked(lambda run: found[id(run)])


def _stacked(runs: Sequence[RunForces], offset: bool, of: Callable[[RunForces], Array]) -> Array:
    parts = [of(run)[..., run.kept] for run in runs]
    if offset:
        parts = [_without_drift(run, part) for run, part in zip(runs, parts, strict=True)]
    return np.asarray(np.concatenate(parts, axis=-1).T)


def _without_drift(run: RunForces, part: Array) -> Array:
    """Take `part` (..., n) off its mean; where the position is integrated off its slow drift, too,
    because that of the noise is in the position."""
    if run.run.order == 0:
        return np.asarray(part - part.mean(axis=-1, keepdims=True))
    along = np.linspace(-1.0, 1.0, run.grid.size)[run.kept]
    slow = np.linalg.qr(np.polynomial.legendre.legvander(along, DRIFT_DEGREE))[0]
    return np.asarray(part - part @ slow @ slow.T)


def setting(runs: Sequence[RunForces], model: Model, timing: Timing) -> Setting:
    """Compute base columns and target, and fit the linear part."""
    gain, mass = model.base.get("force_constant", 1.0), model.base["mass"]
    spring = model.base.get("stiffness", 0.0) > 0.0
    offset = spring and ("encoder_zero" not in model.base or runs[0].run.order > 0)
    driven = any(run.run.driven for run in runs)
    orders = {**({"mass": 2} if driven else {}), "damping": 1, **(
        {"stiffness": 0} if spring else {})}
    terms = _stacked(runs, offset, lambda run: np.array([
        run.derivative(order) for order in orders.values()]))
    if driven:
        names: tuple[str, ...] = (*orders, "late")
        columns = np.column_stack((terms, _stacked(
            runs, offset, lambda run: gain * run.drive(timing, 1))))
        target = _stacked(runs, offset, lambda run: gain * run.drive(timing))
    else:
        names, columns = tuple(orders), terms
        target = _stacked(runs, offset, lambda run: -mass * run.derivative(2))
    found = {"mass": mass, "stiffness": 0.0, **dict(zip(
        names, least_squares(columns, target).tolist(), strict=True))}
    linear = Linear(found["mass"], found["damping"], found["stiffness"])
    if linear.mass <= 0.0 or linear.stiffness < 0.0:    # a gap so gross says nothing of them
        linear = Linear(mass, *(model.base.get(n, 0.0) for n in ("damping", "stiffness")))
    return Setting(runs, timing, names, columns, target, linear, offset)


def least_squares(columns: Array, target: Array) -> Array:
    """Coefficients (k,) of `columns` (n, k), which may differ in size by decades."""
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(columns / norms, target, rcond=1e-12)[0] / norms)


def settled(runs: Sequence[RunForces], model: Model, fitted: int,
            above: float = 0.0) -> tuple[Setting, float, tuple[float, float]]:
    """Find the filter, `above` some width, and the timing that suit the records, of which so many
    are fitted.

    Also returns the share of the missing force's power that is noise, and the timing in samples
    with its standard error.

    Raises
    ------
    DiagnosisError
        If the records are too short for any filter, or the input does nothing.
    """
    period = runs[0].run.sample_period
    timing = Timing(model.effective_base().get("delay", 0.0) + 0.5 * period,
                    linear_part(model).lag_s, True)
    mass = model.base["mass"]
    found, clear = _filtered(runs, model, timing, fitted, above)
    if "late" not in found.names:
        return found, _noise_share(found, mass) if clear else 1.0, (timing.late / period, 0.0)
    inertia = mass * float(np.std(found.columns[:, 0]))
    if float(np.std(found.target)) <= NO_FORCE * inertia:
        raise DiagnosisError("the input does next to nothing: a look at forces cannot use it")
    timing, error = _timed(found, model)
    found = setting(found.runs, model, timing)
    share = _noise_share(found, mass) if clear else 1.0
    return found, share, (timing.late / period, error / period)


def _filtered(runs: Sequence[RunForces], model: Model, timing: Timing, fitted: int,
              above: float) -> tuple[Setting, bool]:
    """The narrowest filter behind which noise is a small share of what is missing, and whether
    the acceleration stands out of the noise there."""
    widths = [w for w in WIDTHS if w > above and all(_blocks(run, w) for run in runs)
              and sum(_blocks(run, w) for run in runs[:fitted]) >= FEWEST]
    if not widths:
        raise DiagnosisError("the records are too short for a look at forces")
    biased = {w: max(run.noise_rms(run.grid.omega**2, w)
                     / max(float(np.std(run.derivative(2, w))), 1e-300) for run in runs)
              for w in widths}
    usable = [w for w in widths if biased[w] < BIASED]
    tried = []
    for width in usable or [min(widths, key=lambda w: biased[w])]:
        found = setting([run.at_width(width) for run in runs], model, timing)
        tried.append((found, _noise_share(found, model.base["mass"])))
        if tried[-1][1] < NOISE_SHARE:
            break
    return min(tried, key=lambda each: each[1])[0], bool(usable)


def _blocks(run: RunForces, width: float) -> int:
    """How many of the shortest blocks a filter leaves of a run."""
    left = run.grid.size - max(run.run.skip, EDGE * width) - EDGE * width
    return int(max(left, 0.0) / max(int(STRIDE * width), 1)) // SHORTEST_KEPT


def _noise_share(found: Setting, mass: float) -> float:
    """Share of the missing force's power that noise makes up, by the fitted mass; by the given
    one where that is lower by more than noise makes it, as it is beside a gross gap."""
    left = found.target - found.columns @ least_squares(found.columns, found.target)
    low = found.linear.mass < (1.0 - BIASED**2) * mass
    linear = replace(found.linear, mass=mass) if low else found.linear
    noise = sum(run.kept.size * run.noise_rms(linear.operator(run.grid.omega), run.width)
                ** 2 for run in found.runs) / max(left.size, 1)
    return min(noise / max(float(np.mean(left**2)), 1e-300), 1.0)


def _general(run: RunForces) -> Array:
    """Forces (4, N) that any stage may have."""
    t = run.trajectory
    return np.array([run.filtered(f) for f in (
        t.x**2, t.x**3, np.abs(t.v) * t.v, t.v / np.hypot(t.v, t.speed_noise + 1e-300))])


def _timed(begun: Setting, model: Model) -> tuple[Timing, float]:
    """When the input acts, found beside general forces, and its standard error, s.

    A straight search over whole and half samples first, then Newton steps: the coefficient of the
    input's derivative is how much later it acts.
    """
    runs, first = begun.runs, begun.timing
    period = runs[0].run.sample_period
    general = begun.stacked(_general)
    place = begun.names.index("late")

    def at(late: float) -> tuple[Array, Array]:
        found = setting(runs, model, shifted(first, late, period))
        return np.column_stack((found.columns, general)), found.target

    def left(late: float) -> float:
        columns, target = at(late)
        return float(np.mean((target - columns @ least_squares(columns, target)) ** 2))

    low, high = EARLIEST * period, LATEST * period
    late = float(min(np.arange(EARLIEST, LATEST + 0.25, 0.5) * period, key=left))
    for _ in range(TIMED):
        step = float(least_squares(*at(late))[place])
        late = min(max(late + min(max(step, -period), period), low), high)
    columns, target = at(late)
    edges, _ = block_edges([target.size], BLOCKS, SHORTEST_KEPT)
    blocks = Blocks(np.column_stack((columns, target)), edges, np.ones(edges.size - 1))
    found = blocks.fit(range(columns.shape[1]), columns.shape[1])
    error = float(jackknife(found.left_out)[place])
    return shifted(first, late, period), error if math.isfinite(error) else math.inf
