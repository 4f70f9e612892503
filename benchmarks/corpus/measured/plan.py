"""Which measured-like cases there are: per group an endless sequence, the same whatever number is
asked for."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.corpus.measured.effects import LIBRARY, OUTSIDERS, REMAINDERS, can_meet

SHARES = (0.01, 0.03, 0.1, 0.3)
"""Of the gap's power, what a remainder makes."""
NUISANCES = (
    "complete", "retune", "flicker", "wander", "heavy_tails", "mains", "outliers", "jitter_stamps",
    "jitter_samples", "repeated_rows", "stale_samples", "lost_rows", "lost_silently",
    "inverted", "wrong_scale", "in_motion", "low_resolution", "output_late", "output_early")
GROUPS = ("remainder", "outsider", "nuisance", "convention")


@dataclass(frozen=True)
class MeasuredSpec:
    """What a case is about; with it `make_case` draws everything else.

    effect: of the library; kind: the remainder, the outsider or the nuisance; share: the
    remainder's of the gap's power.
    """

    index: int
    seed: int
    group: str
    effect: str = ""
    kind: str = ""
    share: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a file."""
        return asdict(self)


def measured_plan(group: str, cases: int, seed: int) -> list[MeasuredSpec]:
    """The first `cases` specifications of a group (of GROUPS) in the sequence of `seed`."""
    plan: list[MeasuredSpec] = []
    number = 0
    while len(plan) < cases:
        rng = np.random.default_rng(np.random.SeedSequence(
            seed, spawn_key=(20, GROUPS.index(group), number)))
        drawn = _block(group, rng)
        order = rng.permutation(len(drawn))
        plan += [MeasuredSpec(len(plan) + place, seed, group, *drawn[item])
                 for place, item in enumerate(order)]
        number += 1
    return plan[:cases]


def _block(group: str, rng: np.random.Generator) -> list[tuple[str, str, float]]:
    if group == "remainder":
        return [(effect, str(rng.choice([r for r in REMAINDERS if can_meet(effect, r)])), share)
                for effect in LIBRARY for share in SHARES]
    if group == "outsider":
        return [("", kind, 0.0) for kind in OUTSIDERS]
    if group == "nuisance":
        return [("", kind, 0.0) for kind in NUISANCES]
    return [("", "", 0.0)] * 24
