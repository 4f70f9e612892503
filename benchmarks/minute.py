"""One record of 60 s at 1 kHz, diagnosed with the whole library: how long, and how often right.

One case of the corpus for each common effect, at severity 10, of which the first fitted record is
given alone: `diagnose` splits it by time. Each runs by itself and may use all cores.
"""

from __future__ import annotations

import os
import statistics
import time
from dataclasses import replace

from benchmarks.blind.scoring import judge
from benchmarks.blind.trial import diagnosed
from benchmarks.corpus import case_plan, make_case
from benchmarks.corpus.plan import BLOCK, EFFECTS
from benchmarks.figure import Figure

SEED = 20_261_128
SAMPLES, SEVERITY, QUICK = 60_000, 10.0, 3
LONGEST_S = 20.0


def figures(quick: bool = False) -> list[Figure]:
    """Diagnose one record for each effect of the first block of a seed."""
    specs = [s for s in case_plan(BLOCK, SEED) if s.kind == "effect" and s.severity == SEVERITY]
    seconds, right = dict[str, float](), 0
    for spec in sorted(specs, key=lambda s: s.effects)[:QUICK if quick else None]:
        case = make_case(spec, SAMPLES)
        case = replace(case, records=case.records[:1], holdout=[])
        begun = time.monotonic()
        answer = diagnosed(case)
        seconds[spec.effects[0]] = time.monotonic() - begun
        right += judge(case.label, answer).right_class
    slowest = max(seconds, key=lambda name: seconds[name])
    how = f"{len(seconds)} of {len(EFFECTS)} effects, {len(os.sched_getaffinity(0))} cores"
    return [
        Figure("minute.median_s", statistics.median(seconds.values()), "s", how=how),
        Figure("minute.longest_s", seconds[slowest], "s", LONGEST_S, bar_kind="at most",
               how=f"{how}; {slowest}"),
        Figure("minute.right", float(right), "1", how=f"{how}: named, or in its class")]
