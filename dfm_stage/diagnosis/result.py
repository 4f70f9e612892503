"""The answer of a diagnosis, and diagnosis.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dfm_stage.diagnosis import wording
from dfm_stage.diagnosis.evidence import Comparison, Evidence, ModelEvidence, Offer, Which
from dfm_stage.diagnosis.margins import Constancy
from dfm_stage.diagnosis.remainder import Description, Finding
from dfm_stage.diagnosis.stretches import Stretches
from dfm_stage.diagnosis.surface import FILE, Surface
from dfm_stage.diagnosis.verdict import Found, Kind, Verdict
from dfm_stage.identification.convention import origin_of
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model import Model

SCHEMA_NOTE = ("schema 2 keeps every key of schema 1; new are the verdict partial (a reader of "
               "schema 1 should take it as unknown with a better model) and the keys complete, "
               "predictable_share, margins, constancy, predictable, judged, window_s, velocity_s, "
               "conventions, witness, stretches; in description: surface, predictable_share, "
               "position_velocity_share, formulas")


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was found, and why.

    Shares are of the held-out gap's power above the noise: of all of it, and of what is
    predictable. `margins` are those over its rivals in block standard errors. `constancy` is the
    gain of another size for every size of motion.
    """

    name: str
    members: tuple[str, ...]
    parameters: Mapping[str, Quantity]
    gap_share: float
    evidence: tuple[str, ...]
    chi2: float
    predictable_share: float | None = None
    margins: Mapping[str, float] = field(default_factory=dict)
    constancy: Constancy | None = None

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.name, "class": list(self.members),
                "parameters": {n: q.to_dict() for n, q in self.parameters.items()},
                "gap_share": _number(self.gap_share),
                "predictable_share": _number(self.predictable_share),
                "margins": {n: _number(m) for n, m in self.margins.items()},
                "constancy": None if self.constancy is None else {
                    "gain": _number(self.constancy.gain), "se": _number(self.constancy.se)},
                "evidence": list(self.evidence)}


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
    """RMS of measured minus simulated before, retuned and after, fitted and held out.

    `predictable` is the RMS, in the signal judged, that a black box would leave, `window_s` how
    often the state starts anew. `velocity_s` is the time over which a position changes, where that
    change was judged as its velocity; `predictable` is of this change then.
    """

    unit: str
    noise_floor: float
    noise_floor_from: str
    fit: tuple[float, float, float]
    held_out: tuple[float, float, float]
    predictable: float | None = None
    judged: str = "position"
    window_s: float | None = None
    velocity_s: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        words = ("before", "retuned", "after")
        return {"unit": self.unit, "noise_floor": _number(self.noise_floor),
                "noise_floor_from": self.noise_floor_from,
                "fit": {w: _number(v) for w, v in zip(words, self.fit, strict=True)},
                "held_out": {w: _number(v) for w, v in zip(words, self.held_out, strict=True)},
                "predictable": _number(self.predictable), "judged": self.judged,
                "window_s": _number(self.window_s), "velocity_s": _number(self.velocity_s)}


@dataclass(frozen=True)
class AcceptedFormula:
    """A formula that the user has added to the model, with its re-estimated parameters."""

    name: str
    force: str
    parameters: Mapping[str, Quantity]

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.name, "force": self.force,
                "parameters": {n: q.to_dict() for n, q in self.parameters.items()}}


@dataclass(frozen=True)
class Diagnosis:
    """The answer of a diagnosis.

    `model` is the extended model, and `complete` is true if it leaves only noise. `gap` compares
    the models before and after; `shown` tells which model is "after". `next_experiment` is a
    mapping for `load_experiment`, or None.

    `conventions` tell what the input of each record does between its samples. `stretches` are the
    parts used of long records. `witness` are the effects that the force domain finds by itself.
    `surface` is the force that is still missing, where it exceeds the noise. `formulas` are
    offered for that force, and `accepted` were added to the model. If nothing was found,
    `detection_limits` has the size at which half of such records would name each effect."""

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
    complete: bool = True
    witness: Mapping[str, Any] | None = None
    surface: Surface | None = None
    formulas: tuple[Offer, ...] = ()
    accepted: tuple[AcceptedFormula, ...] = ()
    stretches: tuple[Stretches, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found, in the order in which they shrank the gap."""
        return tuple(e.name for e in self.effects)

    def to_dict(self) -> dict[str, Any]:
        """diagnosis.json, schema 2."""
        return {
            "schema": 2, "schema_note": SCHEMA_NOTE, "verdict": self.verdict,
            "complete": self.complete,
            "effects": [e.to_dict() for e in self.effects],
            "base": {n: q.to_dict() for n, q in self.base.items()},
            "rejected": [r.to_dict() for r in self.rejected],
            "gap": self.gap.to_dict(),
            "description": self._described(),
            "next_experiment": None if self.next_experiment is None
            else dict(self.next_experiment),
            "warnings": list(self.warnings), "sentence": self.sentence,
            "detection_limits": {name: {n: q.to_dict() for n, q in sizes.items()}
                                 for name, sizes in self.detection_limits.items()},
            "conventions": [dict(each) for each in self.conventions],
            "witness": None if self.witness is None else dict(self.witness),
            **({"accepted": [each.to_dict() for each in self.accepted]} if self.accepted else {}),
            "stretches": [each.to_dict() for each in self.stretches],
        }

    def _described(self) -> dict[str, Any] | None:
        """What is left: in the reading, and as a force, where there is anything."""
        left, force = self.description, self.surface
        if force is None:
            return None if left is None else {
                **left.to_dict(), "surface": None, "predictable_share": None,
                "position_velocity_share": None, "formulas": []}
        left = left or Description(None, None, None, force.frequency_hz, "unclear")
        return {**left.to_dict(), "surface": FILE, "predictable_share": force.predictable_share,
                "position_velocity_share": force.position_velocity_share,
                "formulas": [offer.to_dict() for offer in self.formulas]}


def told(e: Evidence, v: Verdict, model: Model) -> Diagnosis:
    """Put evidence and verdict together; `model` is the one to go on with."""
    shown = e.extended if v.shown == "extended" else e.retuned
    effects = tuple(_named(e, found) for found in v.effects)
    given, retuned = (e.given, e.retuned) if e.accepted is None else (
        e.accepted.given, e.accepted.retuned)
    gap = Gap(e.unit, *e.noise.floor,
              (given.fitted.rms, retuned.fitted.rms, shown.fitted.rms),
              (given.held_out.rms, retuned.held_out.rms, shown.held_out.rms),
              e.judged.predictable, e.judged.signal, e.judged.window_s,
              e.judged.velocity_s)
    rejected = (Rejected(r.name, r.held_out_rms, wording.rejection(r)) for r in v.rejected)
    proposal = e.next_experiment
    return Diagnosis(
        v.kind, wording.sentence(e, v), effects,
        {n: q for n, q in shown.parameters.items() if "." not in n}, tuple(rejected), gap,
        shown.description if v.remainder else None,
        None if proposal is None else wording.experiment(proposal), wording.warnings(e, v),
        _signed(model, effects, e), shown.findings,
        e.limits if v.kind in ("none", "not_excited", "retune") else {},
        e.comparisons, v.shown, conventions=e.conventions, complete=v.complete,
        witness=e.witness, surface=e.surface if v.remainder else None,
        formulas=e.formulas, accepted=_accepted(e, shown))


def _named(e: Evidence, found: Found) -> NamedEffect:
    seen = next((x for x in e.effects if x.name == found.name), None)
    parameters = None if seen is None else seen.parameters
    if parameters is None and e.offset is not None:
        force, half = e.offset.value * e.offset.stiffness, 1.96 * e.offset.sigma \
            * e.offset.stiffness
        parameters = {"force": Quantity(force, "N", (force - half, force + half))}
    return NamedEffect(found.name, found.members, parameters or {}, found.share,
                       tuple(wording.effect_evidence(e, found)), found.loss,
                       found.predictable_share,
                       {} if seen is None else {r.name: r.margin for r in seen.rivals},
                       None if seen is None else seen.constancy)


def _accepted(e: Evidence, shown: ModelEvidence) -> tuple[AcceptedFormula, ...]:
    """The formulas that were accepted, with the intervals of the model that is told."""
    return () if e.accepted is None else tuple(
        AcceptedFormula(f.name, f.text, {
            p.name: shown.parameters.get(f"{f.name}.{p.name}",
                                         Quantity(p.value, p.unit or "", None))
            for p in f.parameters}) for f in e.accepted.formulas)


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
