"""The tables of rates in docs/benchmarks_diagnosis.md, made from the counts in `benchmarks/kept`.

    ./run exec python -m benchmarks.blind.published           # prints the tables
    ./run exec python -m benchmarks.blind.published FOLDER    # counts the answers in FOLDER first

FOLDER is what `./run bench diagnose --keep FOLDER` wrote. Of each seed in it the command keeps the
counts (`seed_<seed>.json`) and the wrong answers (`misses.csv`). The answers behind the counts are
made again, in some five hours of processor time, by

    mkdir FOLDER && echo 2006629740 >FOLDER/fresh_seed.json
    ./run bench diagnose --keep FOLDER --resume --cases 2140
"""

from __future__ import annotations

import csv
import io
import json
import re
import statistics
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.measured import read_measured, read_timing
from benchmarks.blind.measured_scoring import measured_figures
from benchmarks.blind.rates import LARGE, large_effects, limits_of, shares_by_severity
from benchmarks.blind.scoring import Score, wilson
from benchmarks.blind.wide_rates import rate_rows
from benchmarks.diagnose import SEED, read_scores
from dfm_stage.files import write_whole

KEPT = Path(__file__).resolve().parents[1] / "kept"
MISSES = KEPT / "misses.csv"
MISS_COLUMNS = ("seed", "case", "severity", "answer", "times")
MEASURED = KEPT / "measured_corpus.json"
"""Seed and figures of a run of `benchmarks.blind.measured`."""
MEASURED_MISSES = KEPT / "measured_corpus_misses.csv"
MEASURED_COLUMNS = ("group", "case", "kind", "answer", "wrong_name")
Row = tuple[str, str, str, Callable[[float], bool]]
ROWS: tuple[Row, ...] = (
    ("exact", "one effect at severity 3 or 10: exact name", "95 %", lambda r: r >= 95.0),
    ("right_class", "the same: right class", "99 %", lambda r: r >= 99.0),
    ("false_name", "nothing missing, but a name", "1 %", lambda r: r <= 1.0),
    ("trap_name", "a trap, but a name", "", lambda _: True),
    ("retune", "only wrong numbers: `retune`", "95 %", lambda r: r >= 95.0),
    ("pair", "two effects at severity 10: both named", "85 %", lambda r: r >= 85.0),
    ("third_name", "the same: a third that is not there", "2 %", lambda r: r <= 2.0),
    ("unknown", "left out of the library: `unknown`", "90 %", lambda r: r >= 90.0),
    ("wrong_name", "the same: a wrong name", "3 %", lambda r: r <= 3.0),
    ("covered", "intervals that hold the truth", "92 to 98 %", lambda r: 92.0 <= r <= 98.0))
"""Key, words, bar, and whether a rate in percent meets it."""


def tally(scores: Sequence[Score]) -> dict[str, Any]:
    """Count what the tables need: the content of a kept file.

    `rates` has hits and cases by the keys of ROWS, `by_severity` exact names, right classes and
    cases by effect and severity, `unanswered` the error by the number of the case.
    """
    of_kind = {kind: [s for s in scores if s.kind == kind] for kind in (
        "none", "trap", "retune", "pair", "left_out")}
    large = large_effects(scores)
    pairs = [s for s in of_kind["pair"] if s.counted]
    left = [s for s in of_kind["left_out"] if s.counted]
    hits: dict[str, list[bool]] = {
        "exact": [s.exact for s in large], "right_class": [s.right_class for s in large],
        "false_name": [s.false_name for s in of_kind["none"]],
        "trap_name": [s.false_name for s in of_kind["trap"]],
        "retune": [s.exact for s in of_kind["retune"]], "pair": [s.exact for s in pairs],
        "third_name": [s.spurious for s in pairs], "unknown": [s.exact for s in left],
        "wrong_name": [s.spurious for s in left],
        "covered": [hit for s in scores for hit in s.covered]}
    over = [s.held_out_over_floor for s in scores
            if s.held_out_over_floor is not None and s.severity >= LARGE]
    times = [s.seconds for s in scores if s.seconds is not None]
    return {
        "cases": len(scores),
        "rates": {key: [sum(found), len(found)] for key, found in hits.items()},
        "held_out_over_floor": {"percentile_95": round(float(np.percentile(over, 95.0)), 4),
                                "cases": len(over)},
        "seconds": {"median": round(statistics.median(times), 2),
                    "percentile_90": round(float(np.percentile(times, 90.0)), 2),
                    "longest": round(max(times), 1), "sum": round(sum(times)),
                    "cases": len(times)},
        "by_severity": shares_by_severity(scores),
        "unanswered": {str(s.index): s.notes[0] for s in scores if s.verdict == "error"}}


def kept() -> dict[str, dict[str, Any]]:
    """The kept counts by seed, the fixed seed first."""
    files = {path.stem.removeprefix("seed_"): path for path in KEPT.glob("seed_*.json")}
    return {seed: json.loads(files[seed].read_text("utf-8"))
            for seed in sorted(files, key=lambda seed: (seed != str(SEED), seed))}


def rates(counts: Mapping[str, Any]) -> list[str]:
    """Rows of the table of rates of one seed, those that miss their bar marked."""
    table = ["| figure | measured | cases | 95 % interval | bar |", "|---|---|---|---|---|"]
    for key, words, bar, met in ROWS:
        hits, cases = counts["rates"][key]
        low, high = wilson(hits, cases)
        rate = 100.0 * hits / max(cases, 1)
        missed = "" if met(rate) else " **missed**"
        table.append(f"| {words} | {rate:.1f} %{missed} | {hits} of {cases} | "
                     f"{low:.0f} to {high:.0f} | {bar} |")
    over, times = counts["held_out_over_floor"], counts["seconds"]
    table.append("| held-out error over the floor, 95 % within | "
                 f"{over['percentile_95']:.2f} | {over['cases']} | | 1.2 |")
    table.append("| processor time a case, median (90 %; longest) | "
                 f"{times['median']:.1f} s ({times['percentile_90']:.1f}; {times['longest']:.0f}) "
                 f"| {times['cases']} | | 10 s |")
    return table


def misses(seeds: Mapping[str, Sequence[Score]]) -> str:
    """CSV of what went wrong, the kept rows of other seeds included."""
    wrong: Counter[tuple[str, ...]] = Counter()
    for seed, scores in seeds.items():
        for s in scores:
            if s.counted and not s.exact and (s.kind != "effect" or s.severity >= LARGE):
                answer = " ".join([s.answer, *s.notes[:1]])
                wrong[seed, s.label, f"{s.severity:g}" if s.severity else "", answer] += 1
    rows = [(*which, str(times)) for which, times in wrong.items()]
    rows += [tuple(row.values()) for row in kept_misses() if row["seed"] not in seeds]
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(MISS_COLUMNS)
    table.writerows(sorted(rows))
    return out.getvalue()


def kept_misses() -> list[dict[str, str]]:
    """The rows of the kept list of wrong answers."""
    with MISSES.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def effects_by_severity(seeds: Sequence[Mapping[str, Any]]) -> dict[str, dict[float, list[int]]]:
    """Exact names, right classes and cases of all seeds together, by effect and severity."""
    found: dict[str, dict[float, list[int]]] = {}
    for counts in seeds:
        for name, row in counts["by_severity"].items():
            for size, three in row.items():
                place = found.setdefault(name, {}).setdefault(float(size), [0, 0, 0])
                place[:] = [a + b for a, b in zip(place, three, strict=True)]
    return {name: dict(sorted(row.items())) for name, row in sorted(found.items())}


def by_severity(seeds: Sequence[Mapping[str, Any]]) -> list[str]:
    """Exact names of each effect by severity, and the severity at which half would be named."""
    found = effects_by_severity(seeds)
    sizes = sorted({size for row in found.values() for size in row})
    table = ["| effect | " + " | ".join(f"{size:g}" for size in sizes)
             + " | half named at (95 % range) |", "|---|" + "---|" * (len(sizes) + 1)]
    for name, row in found.items():
        cells = [f"{row[size][0]} of {row[size][2]}" if size in row else "" for size in sizes]
        text, (least, most) = limits_of({size: (each[0], each[2]) for size, each in row.items()})
        table.append(f"| `{name}` | " + " | ".join(cells) + f" | {text} ({least} to {most}) |")
    return table


def measured_rates(path: Path = MEASURED) -> list[str]:
    """Rows of the table of cases that look like measurements, from the figures of a run."""
    return rate_rows(json.loads(path.read_text("utf-8"))["figures"])


def keep(folder: Path) -> None:
    """Count the answers of every seed in the folder of a bench, and keep counts and misses."""
    seeds = {place.name.removeprefix("seed_"): read_scores(sorted(place.glob("answers/*.json")))
             for place in sorted(folder.glob("seed_*"))}
    for seed, scores in seeds.items():
        text = json.dumps(tally(scores), indent=1)
        text = re.sub(r"\[[\d\s,]*\]", lambda counts: " ".join(counts[0].split()), text)
        write_whole(KEPT / f"seed_{seed}.json", text + "\n")
    write_whole(MISSES, misses(seeds))


def keep_measured(folder: Path) -> None:
    """Keep the rates and the wrong answers of one seed of `benchmarks.blind.measured`."""
    scores, timing = read_measured(folder), read_timing(folder)
    figures = [{name: each[name] for name in ("key", "value", "unit", "bar", "bar_kind", "met",
                                              "how")}
               for each in (figure.to_dict() for figure in measured_figures(scores, timing))
               if each["value"] is not None]
    for each in figures:
        each["value"] = round(each["value"], 3)
    write_whole(MEASURED, json.dumps({
        "seed": int(folder.name.removeprefix("seed_")), "cases": len(scores),
        "figures": figures}, indent=1) + "\n")
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(MEASURED_COLUMNS)
    table.writerows(sorted((s.group, s.index, s.row, s.answer, "yes" if s.wrong_name else "")
                           for s in scores if not s.right))
    write_whole(MEASURED_MISSES, out.getvalue())


def main(arguments: Sequence[str]) -> int:
    """Keep the counts of the folders that are given, `bench diagnose`'s or a seed's of
    `benchmarks.blind.measured`; print every table."""
    for folder in map(Path, arguments):
        (keep_measured if folder.name.startswith("seed_") else keep)(folder)
    seeds = kept()
    for seed, counts in seeds.items():
        print(f"seed {seed}: {counts['cases']} cases", *rates(counts), "", sep="\n")
    print(*by_severity(list(seeds.values())), "", sep="\n")
    print(*measured_rates(), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
