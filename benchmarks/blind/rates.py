"""From scores to the figures, the confusion matrix, the failures and the detection limits."""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.scoring import Score, detection_limit, wilson
from benchmarks.figure import BarKind, Figure

LARGE = 3.0
ERASED = ("none", "trap")


def rate(key: str, hits: Iterable[bool], bar: float | None, kind: BarKind, what: str,
          bar_to: float | None = None) -> Figure:
    """The share of hits with its Wilson interval, as figure `diagnose.<key>`."""
    found = list(hits)
    low, high = wilson(sum(found), len(found))
    value = 100.0 * sum(found) / len(found) if found else float("nan")
    return Figure(f"diagnose.{key}", value, "%", bar if found else None, how=(
        f"{sum(found)} of {len(found)} {what}, Wilson {low:.1f} to {high:.1f} %"),
        bar_kind=kind if found and bar is not None else None, bar_to=bar_to)


def large_effects(scores: Iterable[Score]) -> list[Score]:
    """Single effects at severity 3 and 10 that the data can tell apart."""
    return [s for s in scores if s.kind == "effect" and s.severity >= LARGE and s.counted]


def accuracy(scores: Sequence[Score]) -> list[Figure]:
    """The rates of the verdicts; also what a baseline is measured by."""
    large = large_effects(scores)
    others = [s for s in scores if s.kind == "effect" and s.severity >= LARGE and not s.counted]
    nothing = [s for s in scores if s.kind == "none"]
    traps = [s for s in scores if s.kind == "trap"]
    retune = [s for s in scores if s.kind == "retune"]
    pairs = [s for s in scores if s.kind == "pair" and s.counted]
    left = [s for s in scores if s.kind == "left_out" and s.counted]
    skipped = sum(s.kind == "left_out" and not s.counted for s in scores)
    return [
        rate("exact_percent", (s.exact for s in large), 95.0, "at least",
              "single effects at severity 3 and 10 named exactly"),
        rate("class_percent", (s.right_class for s in large), 99.0, "at least",
              "of the same in the right class; beside them "
              f"{sum(s.exact for s in others)} of {len(others)} that the data cannot tell apart "
              "answered as expected"),
        rate("false_name_percent", (s.false_name for s in nothing), 1.0, "at most",
              "cases with nothing missing were given a name; "
              f"verdict none in {sum(s.exact for s in nothing)}"),
        rate("trap_name_percent", (s.false_name for s in traps), None, "at most",
              f"traps were given a name ({_by_trap(traps)})"),
        rate("retune_percent", (s.exact for s in retune), 95.0, "at least",
              "models with wrong numbers answered by retune; "
              f"{sum(s.false_name for s in retune)} were given a name"),
        rate("pair_percent", (s.exact for s in pairs), 85.0, "at least",
              "pairs at severity 10 with both named"),
        rate("spurious_third_percent", (s.spurious for s in pairs), 2.0, "at most",
              "pairs with a name that is not there"),
        rate("unknown_percent", (s.exact for s in left), 90.0, "at least",
              f"left out of the library answered by unknown; {skipped} more not counted, as a "
              "remaining candidate comes to 1.05 of the noise on held-out data"),
        rate("confident_wrong_percent", (s.spurious for s in left), 3.0, "at most",
              "left out of the library given a name"),
    ]


def _by_trap(traps: Sequence[Score]) -> str:
    kinds: dict[str, list[Score]] = defaultdict(list)
    for score in traps:
        kinds[score.label.removeprefix("trap ")].append(score)
    return ", ".join(f"{name} {sum(s.false_name for s in found)}/{len(found)}"
                     for name, found in sorted(kinds.items())) or "none run"


def figures_of(scores: Sequence[Score], suffix: str = "") -> list[Figure]:
    """Every figure of the contract but `seconds`, keys ending in `suffix`."""
    found = accuracy(scores)
    ratios = [s.held_out_over_floor for s in scores
              if s.held_out_over_floor is not None and s.severity >= LARGE]
    if ratios:
        found.append(Figure(
            "diagnose.held_out_over_floor", float(np.percentile(ratios, 95.0)), "1", 1.2, how=(
                f"95th percentile of {len(ratios)} correctly named; median "
                f"{statistics.median(ratios):.3f}, at most 1.2 in "
                f"{sum(r <= 1.2 for r in ratios)}"), bar_kind="at most"))
    cases = sum(bool(s.covered) for s in scores)
    found.append(rate("interval_coverage_percent", (hit for s in scores for hit in s.covered),
                       92.0, "between", f"parameter intervals of {cases} correctly named cases "
                       "hold the truth", 98.0))
    times = [s.seconds for s in scores if s.seconds is not None]
    if times:
        found.append(Figure(
            "diagnose.case_seconds", statistics.median(times), "s", 10.0, how=(
                f"median processor time of {len(times)} cases; 90 % within "
                f"{np.percentile(times, 90.0):.1f} s, longest {max(times):.1f} s"),
            bar_kind="at most"))
    return [_named(figure, suffix) for figure in found]


def _named(figure: Figure, suffix: str) -> Figure:
    from dataclasses import replace

    return replace(figure, key=figure.key + suffix)


def beside(ours: Sequence[Figure], others: Mapping[str, Sequence[Score]]) -> list[Figure]:
    """Our figures with the first baseline as peer, and the figures of every baseline."""
    from dataclasses import replace

    found = list(ours)
    for number, (name, scores) in enumerate(others.items()):
        theirs = {figure.key: figure for figure in accuracy(scores)}
        if number == 0:
            found = [figure if figure.key not in theirs else replace(
                figure, peer=name, peer_value=theirs[figure.key].value) for figure in found]
        found += [replace(figure, key=f"{figure.key}.{name}", bar=None, bar_kind=None)
                  for figure in theirs.values()]
    return found


def shares_by_severity(scores: Iterable[Score]) -> dict[str, dict[str, list[int]]]:
    """Count exact names, right classes and cases, by effect and by severity in words."""
    found: dict[str, dict[float, list[int]]] = defaultdict(lambda: defaultdict(lambda: [0, 0, 0]))
    for score in scores:
        if score.kind == "effect":
            place = found[score.label][score.severity]
            place[:] = [place[0] + score.exact, place[1] + score.right_class, place[2] + 1]
    return {name: {f"{size:g}": three for size, three in sorted(row.items())}
            for name, row in sorted(found.items())}


def limits(scores: Sequence[Score]) -> dict[str, dict[str, Any]]:
    """Per effect: shares named exactly and cases by severity, detection limit and its range."""
    table = {}
    for name, row in shares_by_severity(scores).items():
        counts = {float(size): (exact, cases) for size, (exact, _, cases) in row.items()}
        shares = {size: hits / cases for size, (hits, cases) in counts.items()}
        text, ends = limits_of(counts)
        table[name] = {"shares": shares, "cases": {size: n for size, (_, n) in counts.items()},
                       "limit": detection_limit(shares), "text": text, "range": ends}
    return table


def limits_of(counts: Mapping[float, tuple[int, int]]) -> tuple[str, tuple[str, str]]:
    """Detection limit in words, of hits and cases by severity, and its range: the limits at the
    upper and lower ends of the shares' Wilson intervals."""
    bounds = {size: wilson(*each) for size, each in counts.items()}
    high, low = (_limit_text({size: b[end] / 100.0 for size, b in bounds.items()})
                 for end in (1, 0))
    return _limit_text({size: hits / cases for size, (hits, cases) in counts.items()}), (high, low)


def _limit_text(shares: Mapping[float, float]) -> str:
    limit = detection_limit(shares)
    if limit is not None:
        return f"{limit:.2f}"
    return f"below {min(shares):g}" if shares[min(shares)] >= 0.5 else "not reached"


def confusion(scores: Iterable[Score]) -> dict[str, Counter[str]]:
    """Row: what was there (effects at severity 3 and more); column: the answer."""
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for score in scores:
        if score.kind != "effect" or score.severity >= LARGE:
            rows[score.label][score.answer] += 1
    return dict(sorted(rows.items()))


def report(scores: Sequence[Score], others: Mapping[str, Sequence[Score]]) -> str:
    """Confusion matrix, failures and detection limits as text."""
    lines = ["CONFUSION (effects at severity 3 and 10; answers by number)"]
    lines += [f"  {name:34s} " + ", ".join(f"{answer} {n}" for answer, n in row.most_common())
              for name, row in confusion(scores).items()]
    lines += ["", "DETECTION LIMITS (half of the cases named exactly; range by Wilson intervals)"]
    for name, row in limits(scores).items():
        least, most = row["range"]
        lines.append(f"  {name:26s} limit {row['text']:>11s} ({least} to {most})   " + "  ".join(
            f"{size:g}: {share:.2f} ({row['cases'][size]})"
            for size, share in row["shares"].items()))
    wrong: Callable[[Score], bool] = lambda s: s.counted and not s.exact and (  # noqa: E731
        s.kind != "effect" or s.severity >= LARGE)
    lines += ["", "FAILURES"]
    lines += [f"  case {s.index:5d}  {s.label:34s} severity {s.severity:g}: {s.answer} "
              f"{' '.join(s.notes)[:120]}" for s in scores if wrong(s)]
    for name, theirs in others.items():
        rates = ", ".join(f"{f.key.removeprefix('diagnose.')} {f.value:.1f}"
                          for f in accuracy(theirs))
        lines += ["", f"BASELINE {name}: {rates}"]
    return "\n".join(lines)
