"""Which cases the wide corpus has: an endless sequence in blocks, the same for any number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmarks.corpus.plan import EFFECTS, CaseSpec
from benchmarks.corpus.uncommon import UNCOMMON
from benchmarks.corpus.wide.kin import can_pair

NONE_PER_BLOCK = 10
STAGE = len(UNCOMMON)
BLOCK = 4 * STAGE + NONE_PER_BLOCK


@dataclass(frozen=True)
class WideSpec(CaseSpec):
    """A case of the wide corpus, with random numbers of its own."""

    stream: ClassVar[int] = 2


def _block(number: int, seed: int) -> list[WideSpec]:
    """Each uncommon effect at severity 10, left out, beside a common one, at severity 3; then
    nothing missing."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3, number)))
    drawn: list[tuple[str, tuple[str, ...], float]] = []
    for kind, size in (("effect", 10.0), ("left_out", 10.0), ("pair", 10.0), ("effect", 3.0)):
        for name in rng.permutation(UNCOMMON):
            effects: tuple[str, ...] = (str(name),)
            if kind == "pair":
                beside = [common for common in EFFECTS if can_pair(str(name), common)]
                effects += (str(rng.choice(beside)),)
            drawn.append((kind, effects, size))
    drawn += [("none", (), 0.0)] * NONE_PER_BLOCK
    return [WideSpec(number * BLOCK + place, seed, *each) for place, each in enumerate(drawn)]


def wide_plan(cases: int, seed: int) -> list[WideSpec]:
    """The first `cases` specifications of the sequence of `seed`."""
    blocks = range(-(-cases // BLOCK))
    return [spec for number in blocks for spec in _block(number, seed)][:cases]
