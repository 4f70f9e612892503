"""Fitting a model of the stage to records: between `Model` and output-error estimation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dfm_stage.identification.coordinates import to_physical
from dfm_stage.identification.criterion import ACCURATE
from dfm_stage.identification.decisions import SAME_PERIOD
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.output_error import estimate
from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.result import Estimate, SegmentFit
from dfm_stage.identification.run import Run
from dfm_stage.identification.system import System
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.linear import linear_part

DYNAMIC = ("damping", "stiffness", "force_constant", "amplifier_time_constant", "delay")
"""Base parameters that are free unless something else is asked for, where the model has them."""

@dataclass(frozen=True)
class ModelFit:
    """`model` with the estimated values, and the `estimate` they come from."""

    model: Model
    estimate: Estimate

    @property
    def fits(self) -> tuple[SegmentFit, ...]:
        """How each run was explained."""
        return self.estimate.segments


def default_free(model: Model) -> tuple[str, ...]:
    """Return what is estimated unless told otherwise: base dynamics and all effects.

    Mass is held, because volts to metres show ratios only.
    """
    base = [n for n in DYNAMIC if n in model.base or n == "force_constant"]
    return (*base, *expand_names(model, [use.name for use in model.effects]))


def expand_names(model: Model, names: Iterable[str]) -> tuple[str, ...]:
    """Replace effect names by the addresses of their parameters, and check every address.
    Refinements that the model does not make use of are named in full or left out.

    Raises
    ------
    ModelError
        If the model has no such parameter.
    """
    found: list[str] = []
    for name in names:
        use = model.effect(name)
        group = [name] if use is None else [
            f"{name}.{p}" for p in EFFECTS[name].needed(use.parameters)]
        for address in group:
            model.parameter(address)
            head = address.partition(".")[0]
            if "." in address and model.effect(head) is None:
                raise IdentificationError(f"{address}: the model has no effect {head}; add it to "
                                          "the model first")
            if address not in found:
                found.append(address)
    return tuple(found)


def fit_model(model: Model, runs: Sequence[Run], free: Sequence[str] | None = None, *,
              noise: str = "auto", starts: Sequence[Mapping[str, float]] = (),
              max_iterations: int = 60, tolerance: float = ACCURATE) -> ModelFit:
    """Estimate the parameters `free` of a one-axis `model` from `runs`.

    `starts` are other values to begin from, by address; parameters left out of one keep the
    model's. Effects that bring coordinates of their own are searched in those. `noise` and
    `tolerance` as in `estimate`.

    Raises
    ------
    IdentificationError
        If a run does not suit the model or is too short.
    ModelError
        If an address is not known.
    """
    names = default_free(model) if free is None else expand_names(model, free)
    for run in runs:
        _check(run, model)
    system = System(model, _named_apart(runs), names)
    held = {n: v for n, v in model.parameters().items() if n not in names}
    found = estimate(system, noise=noise, starts=[system.vector(start) for start in starts],
                     held=held, max_iterations=max_iterations, tolerance=tolerance)
    found = to_physical(found, system.groups, model)
    fitted = model
    if found.status != "failed":
        fitted = model.with_parameters({n: found.value(n) for n in names})
    return ModelFit(fitted, found)


def evaluate(model: Model, run: Run, *, noise: str = "auto") -> SegmentFit:
    """Simulate `model` on a run it was not fitted to; only the start and the offset are free.

    Raises
    ------
    IdentificationError
        If the model cannot be simulated on it.
    """
    found = fit_model(model, [run], (), noise=noise).estimate
    if found.status == "failed":
        raise IdentificationError(f"{run.name}: {found.message}")
    return found.segments[0]


def linear_plant(model: Model) -> LinearPlant:
    """Return the linear part of a one-axis model with the figures of its modes.

    A mode is a position whose derivative is the velocity that stands after it; its stiffness and
    damping are those that act at once, without what relaxes (creep).
    """
    part = linear_part(model)
    a = part.a
    modes = tuple(Mode(float(part.c[q] * part.gain * part.g[q + 1]), float(0.0 - a[q + 1, q + 1]),
                       float(0.0 - a[q + 1, q])) for q in range(part.motion - 1)
                  if a[q, q + 1] == 1.0 and np.count_nonzero(a[q]) == 1)
    return LinearPlant(modes, part.lag_s, part.delay_s, part)


def _check(run: Run, model: Model) -> None:
    if run.input.shape != run.output.shape or run.input.ndim != 1:
        raise IdentificationError(f"{run.name}: input {run.input.shape} and output "
                                  f"{run.output.shape} must be two arrays of one length")
    if abs(run.sample_period / model.sample_period - 1.0) > SAME_PERIOD:
        raise IdentificationError(f"{run.name}: sampled every {run.sample_period:g} s, but "
                                  f"the model steps by {model.sample_period:g} s: "
                                  "resample the record or change the model")
    if not np.all(np.isfinite(run.input)):
        raise IdentificationError(f"{run.name}: the input holds values that are not finite: "
                                  "cut or interpolate them first")
    if run.start == "periodic" and (run.period is None or run.input.size % run.period):
        raise IdentificationError(f"{run.name}: a periodic run is a whole number of periods: "
                                  "cut it and give the period in samples")


def _named_apart(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return the runs with names made different where two are alike."""
    seen: dict[str, int] = {}
    out = []
    for run in runs:
        seen[run.name] = seen.get(run.name, 0) + 1
        out.append(run if seen[run.name] == 1
                   else replace(run, name=f"{run.name}#{seen[run.name]}"))
    return tuple(out)
