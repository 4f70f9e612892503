"""Which cases there are: an endless sequence in blocks, the same whatever number is asked for."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

EFFECTS = (
    "cubic_stiffness", "quadratic_stiffness", "coulomb_friction", "presliding_friction",
    "hysteresis", "quadratic_damping", "force_offset", "amplifier_bandwidth", "transport_delay",
    "saturation", "back_emf", "coil_inductance", "force_constant_slope", "force_constant_droop",
    "second_mode", "cross_axis_coupling", "encoder_quantization", "encoder_periodic_error",
    "creep", "thermal_drift", "periodic_disturbance", "eddy_current_damping")

CLASSES: tuple[frozenset[str], ...] = (
    frozenset({"coulomb_friction", "presliding_friction", "hysteresis"}),
    frozenset({"amplifier_bandwidth", "transport_delay", "coil_inductance"}),
    frozenset({"cubic_stiffness", "force_constant_droop"}),
    frozenset({"quadratic_stiffness", "force_constant_slope"}),
    frozenset({"quadratic_damping", "eddy_current_damping"}),
    frozenset({"creep", "thermal_drift"}))
"""Effects that some data cannot tell apart; each other effect is a class of its own."""

SEVERITIES = (0.1, 0.3, 1.0, 3.0, 10.0)
TRAPS = ("coloured_noise", "jitter", "transient", "feedback_noise", "rest", "weak",
         "free_stage")
BLOCK = 107
NONE_PER_BLOCK, RETUNE_PER_BLOCK, PAIRS_PER_BLOCK, LEFT_OUT_PER_BLOCK = 15, 6, 6, 7


@dataclass(frozen=True)
class CaseSpec:
    """What a case is about; with it `make_case` draws everything else.

    kind: none, retune, effect, pair, left_out, or trap (then `trap` says which). stream: of the
    random numbers, another one for each corpus.
    """

    stream: ClassVar[int] = 0

    index: int
    seed: int
    kind: str
    effects: tuple[str, ...] = ()
    severity: float = 0.0
    trap: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a file."""
        return asdict(self)


def class_of(name: str) -> frozenset[str]:
    """The equivalence class of an effect over all data; what leaving it out removes."""
    return next((c for c in CLASSES if name in c), frozenset({name}))


def _block(number: int, seed: int) -> list[CaseSpec]:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, number)))
    low = SEVERITIES[number % 3]
    drawn: list[tuple[str, tuple[str, ...], float, str]] = []
    drawn += [("effect", (name,), size, "") for name in EFFECTS for size in (3.0, 10.0, low)]
    drawn += [("none", (), 0.0, "")] * NONE_PER_BLOCK
    drawn += [("retune", (), 0.0, "")] * RETUNE_PER_BLOCK
    for _ in range(PAIRS_PER_BLOCK):
        pair = tuple(str(name) for name in rng.choice(EFFECTS, 2, replace=False))
        while not _can_pair(pair):
            pair = tuple(str(name) for name in rng.choice(EFFECTS, 2, replace=False))
        drawn.append(("pair", pair, 10.0, ""))
    removable = [name for name in EFFECTS if name not in ("force_offset", "back_emf")]
    for i in range(LEFT_OUT_PER_BLOCK):
        name = removable[(number * LEFT_OUT_PER_BLOCK + i) % len(removable)]
        drawn.append(("left_out", (name,), 10.0, ""))
    drawn += [("trap", (), 0.0, trap) for trap in TRAPS]
    order = rng.permutation(len(drawn))
    return [CaseSpec(number * len(drawn) + place, seed, *drawn[item])
            for place, item in enumerate(order)]


def _can_pair(pair: tuple[str, ...]) -> bool:
    """Two effects of one class hide each other, and two are not seen from volts to metres."""
    return class_of(pair[0]) != class_of(pair[1]) and not {"force_offset", "back_emf"} & set(pair)


def case_plan(cases: int, seed: int) -> list[CaseSpec]:
    """The first `cases` specifications of the sequence of `seed`."""
    plan: list[CaseSpec] = []
    number = 0
    while len(plan) < cases:
        plan += _block(number, seed)
        number += 1
    return plan[:cases]
