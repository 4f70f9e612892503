"""The tables of rates in docs/benchmarks_diagnosis.md, made from the kept answers.

    ./run exec python -m benchmarks.blind.published

prints the tables and writes the wrong answers to `benchmarks/kept/misses.csv`. That folder holds a
.tar.xz for each seed: the folder that `./run bench diagnose --keep` writes. Unpacked into such a
folder, `--resume` goes on from there.
"""

from __future__ import annotations

import csv
import io
import json
import statistics
import sys
import tarfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.rates import LARGE, large_effects, limits
from benchmarks.blind.scoring import Score, judge, wilson
from dfm_stage.files import write_whole

KEPT = Path(__file__).resolve().parents[1] / "kept"
MISSES = KEPT / "misses.csv"
MEASURED = KEPT / "measured_corpus.json"
"""Seed and figures of a run of `benchmarks.blind.measured`; what it missed is beside it."""
Row = tuple[str, Sequence[bool], str, Callable[[float], bool]]


def archives() -> list[Path]:
    """The kept seeds, the frozen one first."""
    from benchmarks.diagnose import SEED

    return sorted(KEPT.glob("seed_*.tar.xz"), key=lambda p: (str(SEED) not in p.name, p.name))


def kept_scores(archive: Path) -> list[Score]:
    """Judge every answer of one archive by its label, in the order of the cases."""
    answers: dict[str, Any] = {}
    labels: dict[str, Any] = {}
    with tarfile.open(archive) as packed:
        for member in packed:
            file = packed.extractfile(member)
            if file is not None:
                place = answers if Path(member.name).parent.name == "answers" else labels
                place[Path(member.name).name] = json.loads(file.read())
    return [judge(labels[name], kept["answer"], kept["seconds"])
            for name, kept in sorted(answers.items())]


def rates(scores: Sequence[Score]) -> list[str]:
    """Rows of the table of rates, those that miss their bar marked."""
    large = large_effects(scores)
    of_kind = {kind: [s for s in scores if s.kind == kind] for kind in (
        "none", "trap", "retune", "pair", "left_out")}
    pairs = [s for s in of_kind["pair"] if s.counted]
    left = [s for s in of_kind["left_out"] if s.counted]
    rows: list[Row] = [
        ("one effect at severity 3 or 10: exact name", [s.exact for s in large], "95 %",
         lambda r: r >= 95.0),
        ("the same: right class", [s.right_class for s in large], "99 %", lambda r: r >= 99.0),
        ("nothing missing, but a name", [s.false_name for s in of_kind["none"]], "1 %",
         lambda r: r <= 1.0),
        ("a trap, but a name", [s.false_name for s in of_kind["trap"]], "", lambda _: True),
        ("only wrong numbers: `retune`", [s.exact for s in of_kind["retune"]], "95 %",
         lambda r: r >= 95.0),
        ("two effects at severity 10: both named", [s.exact for s in pairs], "85 %",
         lambda r: r >= 85.0),
        ("the same: a third that is not there", [s.spurious for s in pairs], "2 %",
         lambda r: r <= 2.0),
        ("left out of the library: `unknown`", [s.exact for s in left], "90 %",
         lambda r: r >= 90.0),
        ("the same: a wrong name", [s.spurious for s in left], "3 %", lambda r: r <= 3.0),
        ("intervals that hold the truth", [hit for s in scores for hit in s.covered],
         "92 to 98 %", lambda r: 92.0 <= r <= 98.0)]
    table = ["| figure | measured | cases | 95 % interval | bar |", "|---|---|---|---|---|"]
    for what, found, bar, met in rows:
        low, high = wilson(sum(found), len(found))
        rate = 100.0 * sum(found) / max(len(found), 1)
        missed = "" if met(rate) else " **missed**"
        table.append(f"| {what} | {rate:.1f} %{missed} | {sum(found)} of {len(found)} | "
                     f"{low:.0f} to {high:.0f} | {bar} |")
    over = [s.held_out_over_floor for s in scores
            if s.held_out_over_floor is not None and s.severity >= LARGE]
    times = [s.seconds for s in scores if s.seconds is not None]
    table.append("| held-out error over the floor, 95 % within | "
                 f"{np.percentile(over, 95.0):.2f} | {len(over)} | | 1.2 |")
    table.append(f"| processor time a case, median (90 %; longest) | "
                 f"{statistics.median(times):.1f} s ({np.percentile(times, 90.0):.1f}; "
                 f"{max(times):.0f}) | {len(times)} | | 10 s |")
    return table


def misses(seeds: Mapping[str, Sequence[Score]]) -> str:
    """CSV of what went wrong: seed, case, severity, answer, and how often."""
    wrong: Counter[tuple[str, ...]] = Counter()
    for seed, scores in seeds.items():
        for s in scores:
            if s.counted and not s.exact and (s.kind != "effect" or s.severity >= LARGE):
                answer = " ".join([s.answer, *s.notes[:1]])
                wrong[seed, s.label, f"{s.severity:g}" if s.severity else "", answer] += 1
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(("seed", "case", "severity", "answer", "times"))
    rows.writerows((*which, times) for which, times in sorted(wrong.items()))
    return out.getvalue()


def by_severity(scores: Sequence[Score]) -> list[str]:
    """Exact names of each effect by severity, and the severity at which half would be named."""
    found = limits(scores)
    sizes = sorted({size for row in found.values() for size in row["cases"]})
    table = ["| effect | " + " | ".join(f"{size:g}" for size in sizes)
             + " | half named at (95 % range) |", "|---|" + "---|" * (len(sizes) + 1)]
    for name, row in found.items():
        cells = [f"{row['shares'][size] * row['cases'][size]:.0f} of {row['cases'][size]}"
                 if size in row["cases"] else "" for size in sizes]
        least, most = row["range"]
        table.append(f"| `{name}` | " + " | ".join(cells)
                     + f" | {row['text']} ({least} to {most}) |")
    return table


def measured_rates(path: Path = MEASURED) -> list[str]:
    """Rows of the table of cases that look like measurements, from the figures of a run."""
    table = ["| figure | measured | bar | how |", "|---|---|---|---|"]
    for each in json.loads(path.read_text("utf-8"))["figures"]:
        what = each["key"].removeprefix("measured.").removesuffix("_percent").replace("_", " ")
        bar = "" if each["bar"] is None else \
            f"{each['bar_kind']} {each['bar']:g} {each['unit']}"
        missed = " **missed**" if each["met"] is False else ""
        table.append(f"| {what} | {each['value']:.1f} {each['unit']}{missed} | {bar} "
                     f"| {each['how']} |")
    return table


def main() -> int:
    """Print every table, and write the list of misses."""
    seeds = {archive.name.split(".")[0].removeprefix("seed_"): kept_scores(archive)
             for archive in archives()}
    for seed, found in seeds.items():
        print(f"seed {seed}: {len(found)} cases", *rates(found), "", sep="\n")
    print(*by_severity([s for found in seeds.values() for s in found]), "", sep="\n")
    print(*measured_rates(), sep="\n")
    write_whole(MISSES, misses(seeds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
