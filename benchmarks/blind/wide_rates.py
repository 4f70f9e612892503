"""From the scores of the wide corpus to its figures, a row for each effect, and the misses."""

from __future__ import annotations

import csv
import io
import json
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.rates import LARGE, rate
from benchmarks.blind.scoring import Score
from benchmarks.figure import Figure

SUFFIX = ".wide"
KEPT = Path(__file__).resolve().parents[1] / "kept"
RATES, MISSES = KEPT / "wide_corpus.json", KEPT / "wide_corpus_misses.csv"
HUGE = 10.0
COLUMNS = ("case", "index", "severity", "answer", "counted", "note")


def wide_figures(scores: Sequence[Score]) -> list[Figure]:
    """Rates with Wilson intervals, the mean size of a class, and processor times."""
    large = [s for s in scores if s.kind == "effect" and s.severity >= HUGE]
    small = [s for s in scores if s.kind == "effect" and LARGE <= s.severity < HUGE]
    pairs = [s for s in scores if s.kind == "pair" and s.counted]
    left = [s for s in scores if s.kind == "left_out" and s.counted]
    nothing = [s for s in scores if s.kind == "none"]
    alike = sum(s.kind == "left_out" and not s.counted for s in scores)
    found = [
        *_single(large, "", 95.0, 98.0, "10"), *_single(small, "_small", None, None, "3"),
        rate("false_name_percent", (s.false_name for s in nothing), 1.0, "at most",
             f"with nothing missing given a name; verdict none in {_hits(nothing)}"),
        rate("pair_percent", (s.exact for s in pairs), 85.0, "at least",
             "pairs of an uncommon and a common effect at severity 10 with both named"),
        rate("spurious_third_percent", (s.spurious for s in pairs), 2.0, "at most",
             "of the same with a name that is not there"),
        rate("unknown_percent", (s.exact for s in left), 90.0, "at least",
             "left out of the library answered by unknown, or by partial with a relative; "
             f"{alike} more not counted, as a relative reaches the noise"),
        rate("confident_wrong_percent", (s.spurious for s in left), 3.0, "at most",
             "of the same given a name as certain, or one that is no relative")]
    return [_with_suffix(figure) for figure in [*found, *_times(scores)]
            if np.isfinite(figure.value)]


def _single(scores: Sequence[Score], which: str, exact: float | None, right: float | None,
            size: str) -> list[Figure]:
    """Of single effects: the name, the class, and how many effects an answer leaves open."""
    counted = [s for s in scores if s.counted]
    others = [s for s in scores if not s.counted]
    sizes = [s.class_size for s in scores if s.class_size is not None]
    return [
        rate(f"exact{which}_percent", (s.exact for s in counted), exact, "at least",
             f"uncommon effects at severity {size} named exactly; beside them {len(others)} that "
             f"have an equivalent, {sum(s.right_class for s in others)} of these in the class"),
        rate(f"class{which}_percent", (s.right_class for s in scores), right, "at least",
             f"of all at severity {size} in the right class"),
        Figure(f"diagnose.class{which}_size", statistics.fmean(sizes) if sizes else float("nan"),
               "1", None if exact is None else 1.3, bar_kind=None if exact is None else "at most",
               how=f"effects that an answer leaves in question, mean of {len(sizes)} answers in "
               "the right class")]


def _times(scores: Sequence[Score]) -> list[Figure]:
    times = [s.seconds for s in scores if s.seconds is not None]
    if not times:
        return []
    return [Figure("diagnose.case_seconds", statistics.median(times), "s", 4.0, how=(
                f"median processor time of {len(times)} cases; 90 % within "
                f"{np.percentile(times, 90.0):.1f} s"), bar_kind="at most"),
            Figure("diagnose.longest_case_seconds", max(times), "s", 60.0, how=(
                f"processor time of the longest of {len(times)} cases; "
                f"{sum(t > 60.0 for t in times)} above 60 s"), bar_kind="at most")]


def _hits(scores: Sequence[Score]) -> int:
    return sum(s.exact for s in scores)


def _with_suffix(figure: Figure) -> Figure:
    from dataclasses import replace

    return replace(figure, key=figure.key + SUFFIX)


def by_effect(scores: Sequence[Score]) -> dict[str, dict[str, list[int]]]:
    """Of each uncommon effect and kind of case: right answers, and cases, all of them."""
    table: dict[str, dict[str, list[int]]] = {}
    for s in scores:
        if s.kind not in ("effect", "pair", "left_out"):
            continue
        name = s.label.removeprefix("without ").split("+")[0]
        kind = f"{s.kind}_{s.severity:g}" if s.kind == "effect" else s.kind
        place = table.setdefault(name, {}).setdefault(kind, [0, 0])
        place[:] = [place[0] + s.exact, place[1] + 1]
    return dict(sorted(table.items()))


KINDS = {"effect_10": "alone, severity 10", "effect_3": "alone, severity 3",
         "pair": "beside a common one", "left_out": "left out"}


def effect_rows(table: Mapping[str, Mapping[str, Sequence[int]]]) -> list[str]:
    """The table of `by_effect` for a page."""
    rows = ["| effect | " + " | ".join(KINDS.values()) + " |", "|---|" + "---|" * len(KINDS)]
    for name, row in table.items():
        cells = (f"{row[kind][0]} of {row[kind][1]}" if kind in row else "" for kind in KINDS)
        rows.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return rows


def rate_rows(figures: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table of figures, as `Figure.to_dict` gives them, for a page."""
    rows = ["| figure | measured | bar | how |", "|---|---|---|---|"]
    for each in figures:
        what = each["key"].partition(".")[2].removesuffix(SUFFIX).removesuffix("_percent")
        bar = "" if each["bar"] is None else f"{each['bar_kind']} {each['bar']:g} {each['unit']}"
        missed = " **missed**" if each["met"] is False else ""
        value = f"{each['value']:.{2 if each['unit'] == '1' else 1}f} {each['unit']}"
        rows.append(f"| {what.replace('_', ' ')} | {value.removesuffix(' 1')}{missed} | "
                    f"{bar.removesuffix(' 1')} | {each['how']} |")
    return rows


def misses(scores: Sequence[Score]) -> str:
    """CSV of every answer that is not right, those that are not counted included."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows([s.label, s.index, f"{s.severity:g}", s.answer, "yes" if s.counted else "",
                     " ".join(s.notes)] for s in scores if not s.exact)
    return out.getvalue()


def summary(seed: int, scores: Sequence[Score]) -> dict[str, Any]:
    """What is kept of a run."""
    figures = [figure.to_dict() for figure in wide_figures(scores)]
    return {"seed": seed, "cases": len(scores), "by_effect": by_effect(scores), "figures": [
        {name: round(value, 3) if isinstance(value := each[name], float) else value
         for name in ("key", "value", "unit", "bar", "bar_kind", "met", "how")}
        for each in figures]}


def kept() -> dict[str, Any]:
    """The kept summary of a run."""
    found: dict[str, Any] = json.loads(RATES.read_text("utf-8"))
    return found
