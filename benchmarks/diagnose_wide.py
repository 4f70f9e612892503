"""Blind trials of the diagnosis with the uncommon effects: alone, in pairs, and left out.

The cases come from `benchmarks.corpus.wide`. Answers and labels are kept as those of `diagnose`.

    ./run bench diagnose_wide --cases 180 --keep DIR --resume
    ./run exec python -m benchmarks.diagnose_wide DIR/seed_S    # prints and keeps the tables
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.blind.trial import Job, add_rivals
from benchmarks.blind.wide_rates import (
    MISSES,
    RATES,
    effect_rows,
    kept,
    misses,
    rate_rows,
    summary,
    wide_figures,
)
from benchmarks.corpus.case_files import write_whole
from benchmarks.corpus.wide import wide_plan
from benchmarks.corpus.wide.plan import BLOCK
from benchmarks.diagnose import read_scores, run_all
from benchmarks.figure import Figure

SEED = 1_125_698_143
"""Drawn when the corpus was frozen, before its first run."""
KEEP = Path(__file__).resolve().parents[1] / ".dfm" / "bench" / "diagnose_wide"
QUICK_CASES = 4


def figures(quick: bool = False, *, cases: int | None = None, seed: int | None = None,
            resume: bool = False, keep: Path | None = None,
            jobs: int | None = None) -> list[Figure]:
    """Rates of the first cases of a seed.

    `keep` is the folder of the answers. With `resume` cases answered there are not run again.
    """
    home, chosen = keep or KEEP, SEED if seed is None else seed
    folder, workers = home / f"seed_{chosen}", jobs or len(os.sched_getaffinity(0))
    todo = [Job(spec, folder, baselines=False, resume=resume, rivals=False)
            for spec in wide_plan(cases or (QUICK_CASES if quick else BLOCK), chosen)]
    answers = run_all(todo, workers)
    run_all([job for job in todo if job.answer_path in answers], workers, add_rivals)
    scores = read_scores(answers)
    found = summary(chosen, scores)
    text = "\n".join([*rate_rows(found["figures"]), "", *effect_rows(found["by_effect"]), "",
                      misses(scores)])
    write_whole(folder / "report.txt", text)
    print(text, flush=True)
    return wide_figures(scores)


def main(arguments: Sequence[str]) -> int:
    """Keep rates and misses of the folder of a seed, if one is given; print the kept tables."""
    for folder in map(Path, arguments):
        scores = read_scores(sorted(folder.glob("answers/*.json")))
        found = summary(int(folder.name.removeprefix("seed_")), scores)
        write_whole(RATES, json.dumps(found, indent=1) + "\n")
        write_whole(MISSES, misses(scores))
    if not RATES.exists():
        print("no rates are kept yet; give the folder of a seed", file=sys.stderr)
        return 1
    found = kept()
    print(f"{found['cases']} cases of seed {found['seed']}", *rate_rows(found["figures"]), "",
          *effect_rows(found["by_effect"]), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
