"""The answer of a diagnosis, and diagnosis.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dfm_stage.diagnosis import wording
from dfm_stage.diagnosis.evidence import Comparison, Evidence, Which
from dfm_stage.diagnosis.remainder import Description, Finding
from dfm_stage.diagnosis.verdict import Found, Kind, Verdict
from dfm_stage.identification.convention import origin_of
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model import Model


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was found: parameters, share of the gap's power it took, and why."""

    name: str
    members: tuple[str, ...]
    parameters: Mapping[str, Quantity]
    gap_share: float
    evidence: tuple[str, ...]
    chi2: float

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.name, "class": list(self.members),
                "parameters": {n: q.to_dict() for n, q in self.parameters.items()},
                "gap_share": _number(self.gap_share), "evidence": list(self.evidence)}


@dataclass(frozen=True)
class Rejected:
    """An effect that was considered and not named."""

    name: str
    held_out_rms: float | None
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.name, "held_out_rms": _number(self.held_out_rms),
                "reason": self.reason}


@dataclass(frozen=True)
class Gap:
    """RMS of measured minus simulated before, retuned and after, fitted and held out."""

    unit: str
    noise_floor: float
    noise_floor_from: str
    fit: tuple[float, float, float]
    held_out: tuple[float, float, float]

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        words = ("before", "retuned", "after")
        return {"unit": self.unit, "noise_floor": _number(self.noise_floor),
                "noise_floor_from": self.noise_floor_from,
                "fit": {w: _number(v) for w, v in zip(words, self.fit, strict=True)},
                "held_out": {w: _number(v) for w, v in zip(words, self.held_out, strict=True)}}


@dataclass(frozen=True)
class Diagnosis:
    """What was found. `model` is the extended model, `next_experiment` a mapping that
    `load_experiment` takes, or None. `detection_limits` are, where nothing was found, the sizes at
    which each effect would have been named in half of such records, `conventions` what the input
    of each record does between its samples, `shown` which of the models compared is the one
    after."""

    verdict: Kind
    sentence: str
    effects: tuple[NamedEffect, ...]
    base: Mapping[str, Quantity]
    rejected: tuple[Rejected, ...]
    gap: Gap
    description: Description | None
    next_experiment: Mapping[str, Any] | None
    warnings: tuple[str, ...]
    model: Model
    findings: Mapping[str, Sequence[Finding]] = field(default_factory=dict)
    detection_limits: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    comparisons: tuple[Comparison, ...] = ()
    shown: Which = "given"
    seconds: float = 0.0
    conventions: tuple[Mapping[str, Any], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found, in the order in which they shrank the gap."""
        return tuple(e.name for e in self.effects)

    def to_dict(self) -> dict[str, Any]:
        """diagnosis.json, schema 1."""
        return {
            "schema": 1, "verdict": self.verdict,
            "effects": [e.to_dict() for e in self.effects],
            "base": {n: q.to_dict() for n, q in self.base.items()},
            "rejected": [r.to_dict() for r in self.rejected],
            "gap": self.gap.to_dict(),
            "description": None if self.description is None else self.description.to_dict(),
            "next_experiment": None if self.next_experiment is None
            else dict(self.next_experiment),
            "warnings": list(self.warnings), "sentence": self.sentence,
            "detection_limits": {name: {n: q.to_dict() for n, q in sizes.items()}
                                 for name, sizes in self.detection_limits.items()},
            "conventions": [dict(each) for each in self.conventions],
        }


def told(e: Evidence, v: Verdict, model: Model) -> Diagnosis:
    """Put evidence and verdict together; `model` is the one to go on with."""
    shown = e.extended if v.shown == "extended" else e.retuned
    effects = tuple(_named(e, found) for found in v.effects)
    gap = Gap(e.unit, *e.noise.floor,
              (e.given.fitted.rms, e.retuned.fitted.rms, shown.fitted.rms),
              (e.given.held_out.rms, e.retuned.held_out.rms, shown.held_out.rms))
    rejected = (Rejected(r.name, r.held_out_rms, wording.rejection(r)) for r in v.rejected)
    proposal = e.next_experiment
    return Diagnosis(
        v.kind, wording.sentence(e, v), effects,
        {n: q for n, q in shown.parameters.items() if "." not in n}, tuple(rejected), gap,
        shown.description if v.remainder else None,
        None if proposal is None else wording.experiment(proposal), wording.warnings(e, v),
        _signed(model, effects, e), shown.findings,
        e.limits if v.kind in ("none", "not_excited", "retune") else {},
        e.comparisons, v.shown, conventions=e.conventions)


def _named(e: Evidence, found: Found) -> NamedEffect:
    parameters = next((x.parameters for x in e.effects if x.name == found.name), None)
    if parameters is None and e.offset is not None:
        force, half = e.offset.value * e.offset.stiffness, 1.96 * e.offset.sigma \
            * e.offset.stiffness
        parameters = {"force": Quantity(force, "N", (force - half, force + half))}
    return NamedEffect(found.name, found.members, parameters or {}, found.share,
                       tuple(wording.effect_evidence(e, found)), found.loss)


def _signed(model: Model, effects: Sequence[NamedEffect], e: Evidence) -> Model:
    """The model with the origin of what was found, and the inputs that were not held."""
    source = {"diagnosed_from": list(e.records), **origin_of(e.conventions)}
    for found in effects:
        use = model.effect(found.name)
        if use is not None:
            intervals = {n: q.to_dict()["ci95"] for n, q in found.parameters.items()
                         if q.ci95 is not None}
            model = model.with_effect(found.name, dict(use.parameters),
                                      {**source, "ci95": intervals})
    return model


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
