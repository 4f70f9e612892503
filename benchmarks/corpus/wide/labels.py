"""What is right for a case of the wide corpus, decided by its specification and its stage."""

from __future__ import annotations

from typing import Any

from benchmarks.corpus.plan import CaseSpec, class_of
from benchmarks.corpus.stage import Stage
from benchmarks.corpus.uncommon import PARAMETERS
from benchmarks.corpus.wide.kin import class_of_uncommon, left_out_with, relatives


def left_out(name: str) -> frozenset[str]:
    """What a library does without where an effect, common or not, is left out."""
    return left_out_with(name) if name in PARAMETERS else class_of(name)


def expected_of_uncommon(spec: CaseSpec, stage: Stage) -> tuple[list[str], list[str], str]:
    """Verdicts that are right, the class that may be named as ambiguous, and why; the first
    effect is an uncommon one."""
    name = spec.effects[0]
    if spec.kind == "left_out":
        return ["unknown", "partial"], [], "partial only with a relative"
    if spec.kind == "pair":
        return ["named"], [], ""
    group = sorted(class_of_uncommon(name))
    if name == "sensor_lag" and stage.current_noise is None:
        return ["ambiguous"], group, (
            "without a current record a lag of the reading is one of the amplifier")
    return ["named"], group, ""


def said_of(spec: CaseSpec) -> dict[str, Any]:
    """What the label of a left-out uncommon effect has beside that of others."""
    if spec.kind != "left_out" or spec.effects[0] not in PARAMETERS:
        return {}
    return {"relatives": sorted(relatives(spec.effects[0]))}
