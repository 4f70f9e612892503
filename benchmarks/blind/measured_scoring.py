"""What an answer to a measured-like case is worth, and the rates of many."""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.blind.scoring import AMBIGUOUS, ERROR, NAMED, wilson
from benchmarks.figure import BarKind, Figure

PARTIAL, UNKNOWN = "partial", "unknown"
UNCOMMON = "uncommon"
"""Outsiders to the common effects that are uncommon effects of the library."""
TIMING_SLACK = 0.1
"""Samples by which a shift that was found may be wrong."""
CORRECTED = 0.01
"""Samples of an early shift from which a record's timing counts as corrected."""
MOST_HELD_OUT = 0.3
"""Share of a remainder in held-out records up to which these, too, show mostly the effect."""
PHYSICAL_BELOW = 0.0105
"""Share of a remainder up to which an interval should hold the physical value, too."""


@dataclass(frozen=True)
class MeasuredScore:
    """One case, judged.

    right: the answer is as it should be, in its class; exact: to the name; wrong_name: a name
    outside what is allowed; shown: the remainder makes at most MOST_HELD_OUT of the held-out gap,
    too; found: per record that must be told, whether its convention was;
    corrected: per record whose timing was as assumed, whether it was corrected all the same;
    held: per interval of a parameter, whether it holds the pseudo-true value, and `physical`
    whether it holds the true one.
    """

    index: int
    group: str
    row: str
    share: float
    answer: str
    right: bool
    exact: bool
    wrong_name: bool
    shown: bool = True
    found: tuple[bool, ...] = ()
    untold: tuple[bool, ...] = ()
    corrected: tuple[bool, ...] = ()
    held: tuple[bool, ...] = ()
    physical: tuple[bool, ...] = ()
    seconds: float | None = None
    note: str = ""


def judge_measured(label: Mapping[str, Any], answer: Mapping[str, Any],
                   seconds: float | None = None,
                   pseudo: Mapping[str, float] | None = None) -> MeasuredScore:
    """Judge one diagnosis (diagnosis.json of schema 1 or 2, or {"error": line}) by its label.

    pseudo: pseudo-true values of the right effect's parameters, where they were computed.
    """
    verdict = str(answer.get("verdict", ERROR)) if "error" not in answer else ERROR
    effects = [e for e in answer.get("effects", []) if isinstance(e, Mapping)]
    names = [str(e["name"]) for e in effects] if verdict in (NAMED, PARTIAL) else []
    listed = {str(n) for e in effects for n in (e["name"], *e.get("class", []))} \
        if verdict == AMBIGUOUS else set()
    right, wrong = _judged(label, verdict, set(names), listed)
    told = [_convention(truth, said) for truth, said in
            zip(label["conventions"], answer.get("conventions", []), strict=False)]
    told += [(False, False)] * (len(label["conventions"]) - len(told))
    must = [bool(c["must_be_found"]) for c in label["conventions"]]
    as_assumed = [c["input_hold"] == "zero" and c["input_shift_samples"] >= 0.0
                  for c in label["conventions"]]
    share = float(label["share"])
    only = [e for e in effects if e["name"] == label["effect"]] if names == [label["effect"]] \
        else []
    return MeasuredScore(
        int(label["index"]), _group(label), _row(label), share,
        _text(verdict, names, listed, bool(answer.get("complete", True))), right,
        right and names[:1] == [label["effect"]], wrong,
        float(label.get("remainder_share_held_out", 0.0)) <= MOST_HELD_OUT,
        tuple(found for (found, _), asked in zip(told, must, strict=True) if asked),
        tuple(not fixed for (_, fixed), asked in zip(told, must, strict=True) if not asked),
        tuple(fixed for (_, fixed), plain in zip(told, as_assumed, strict=True) if plain),
        _covered(only, pseudo or {}),
        _covered(only, label["true_effects"].get(label["effect"], {}))
        if share <= PHYSICAL_BELOW else (), seconds, str(answer.get("error", ""))[:160])


def _judged(label: Mapping[str, Any], verdict: str, names: set[str],
            listed: set[str]) -> tuple[bool, bool]:
    """Whether the answer is right, and whether it has a name that it must not have."""
    right, allowed = set(label["right"]), set(label["allowed"])
    if label["group"] == "outsider" and not right:
        wrong = verdict == NAMED or bool(names - allowed) or bool(listed - allowed)
        return not wrong and verdict in (UNKNOWN, PARTIAL, AMBIGUOUS), wrong
    if right:
        wrong = bool(names - allowed)
        return not wrong and bool((names | listed) & right), wrong
    wrong = bool((names | listed) - allowed)
    said = bool(names or listed)
    return not wrong and (said or verdict in label["expected"]), wrong


def _group(label: Mapping[str, Any]) -> str:
    """The group of the plan; uncommon effects of the library apart from other outsiders."""
    return UNCOMMON if label["group"] == "outsider" and label["right"] else str(label["group"])


def _row(label: Mapping[str, Any]) -> str:
    if label["group"] == "remainder":
        return f"{label['effect']} beside {label['kind']}"
    return str(label["kind"]) or str(label["conventions"][0]["input_hold"])


def _text(verdict: str, names: Sequence[str], listed: set[str], complete: bool) -> str:
    if verdict == AMBIGUOUS:
        return f"ambiguous {{{', '.join(sorted(listed))}}}"
    if names:
        rest = "" if complete or verdict == PARTIAL else " and a remainder"
        return f"{verdict} {'+'.join(sorted(names))}{rest}"
    return verdict


def _convention(truth: Mapping[str, Any], said: Mapping[str, Any]) -> tuple[bool, bool]:
    """Whether a record's convention was found, and whether its timing was corrected."""
    hold = str(said.get("input_hold", "zero"))
    shift = said.get("input_shift_samples", {})
    value = float(shift.get("value", 0.0) if isinstance(shift, Mapping) else shift)
    corrected = bool(said.get("estimated", False)) and (hold != "zero" or value < -CORRECTED)
    same = hold == truth["input_hold"]
    if not same and truth["hold_must_be_found"]:
        return False, corrected
    # a held input acts half a sample late
    acts = value + 0.5 * ((hold == "zero") - (truth["input_hold"] == "zero"))
    early = float(truth["input_shift_samples"])
    late = early + float(truth["late_samples"])
    # what comes late is a delay's and not a convention's: it need not be said
    within = min(early, 0.0) - TIMING_SLACK <= acts <= late + TIMING_SLACK
    return within, corrected


def judge_timing(truth: Mapping[str, Any], said: Mapping[str, Any]) -> tuple[bool, bool]:
    """Of a record alone (`held_record`, `convention_record`): found, and corrected in vain."""
    complete = {"hold_must_be_found": True, "must_be_found": True, **truth}
    found, corrected = _convention(complete, said)
    plain = truth["input_hold"] == "zero" and truth["input_shift_samples"] >= 0.0
    return found, corrected and plain


def _covered(effects: Sequence[Mapping[str, Any]],
             truth: Mapping[str, float]) -> tuple[bool, ...]:
    hits = []
    for effect in effects:
        for name, value in effect.get("parameters", {}).items():
            interval = value.get("ci95") if isinstance(value, Mapping) else None
            if interval is not None and name in truth and name != "phase":
                hits.append(float(interval[0]) <= truth[name] <= float(interval[1]))
    return tuple(hits)


def _rate(key: str, hits: Iterable[bool], bar: float | None, kind: BarKind, what: str,
          bar_to: float | None = None) -> Figure:
    found = list(hits)
    low, high = wilson(sum(found), len(found))
    value = 100.0 * sum(found) / len(found) if found else float("nan")
    judged = bool(found) and bar is not None
    return Figure(f"measured.{key}", value, "%", bar if judged else None, how=(
        f"{sum(found)} of {len(found)} {what}, Wilson {low:.1f} to {high:.1f} %"),
        bar_kind=kind if judged else None, bar_to=bar_to if judged else None)


Timing = Mapping[str, Sequence[int]]
"""Of `timing_rates`: hits and cases of "held", "found" and "untold"."""


def measured_figures(scores: Sequence[MeasuredScore],
                     timing: Timing | None = None) -> list[Figure]:
    """The rates against what was promised."""
    of = {group: [s for s in scores if s.group == group]
          for group in ("remainder", UNCOMMON, "outsider", "nuisance", "convention")}
    beside, outside, nothing = of["remainder"], of["outsider"], of["nuisance"]
    found = [
        _rate("no_answer_percent", (s.answer == ERROR for s in scores), 0.0, "at most",
              "cases without an answer: an error, or out of time"),
        _rate("remainder_right_percent", (s.right for s in beside), 90.0, "at least",
              "effects that make at least 70 % of the gap named in their class; "
              f"to the name {sum(s.exact for s in beside)}"),
        _rate("remainder_shown_right_percent", (s.right for s in beside if s.shown), 90.0,
              "at least", "of those whose effect makes as much of the held-out gap, too, named "
              "in their class"),
        _rate("remainder_wrong_percent", (s.wrong_name for s in beside), 2.0, "at most",
              "of the same with a name outside the class"),
        _rate("outsider_wrong_percent", (s.wrong_name for s in outside), 3.0, "at most",
              "effects outside the library given a name that is no relative, or a certain one; "
              f"answered rightly {sum(s.right for s in outside)}"),
        _rate("uncommon_right_percent", (s.right for s in of[UNCOMMON]), None, "at least",
              "uncommon effects alone named in their class; "
              f"{sum(s.wrong_name for s in of[UNCOMMON])} with another name"),
        _rate("nothing_wrong_percent", (s.wrong_name for s in nothing), 1.0, "at most",
              "complete models and nuisances given a name; "
              f"verdict right in {sum(s.right for s in nothing)}"),
        _rate("convention_right_percent", (s.right for s in of["convention"]), None, "at least",
              "cases by other conventions answered rightly; "
              f"{sum(s.wrong_name for s in of['convention'])} with a wrong name"),
        _rate("convention_found_percent", (hit for s in scores for hit in s.found), 95.0,
              "at least", "records less than 0.2 sample late whose convention was "
              "found; beside them not corrected where lag hides it "
              f"{sum(hit for s in scores for hit in s.untold)} of "
              f"{sum(len(s.untold) for s in scores)}"),
        _rate("false_timing_percent", (hit for s in scores for hit in s.corrected), 0.0,
              "at most", "records of a held input whose timing was corrected"),
        _rate("interval_pseudo_true_percent", (hit for s in scores for hit in s.held), 90.0,
              "between", "intervals beside a remainder hold the pseudo-true value", 98.0),
        _rate("interval_physical_percent", (hit for s in scores for hit in s.physical), 90.0,
              "at least", "intervals beside a remainder of at most 1 % hold the physical value")]
    times = [s.seconds for s in scores if s.seconds is not None]
    if times:
        found.append(Figure(
            "measured.case_seconds", statistics.median(times), "s", how=(
                f"median processor time of {len(times)} cases; 90 % within "
                f"{np.percentile(times, 90.0):.1f} s, longest {max(times):.1f} s")))
    return found + _timing_figures(timing or {})


def _timing_figures(timing: Timing) -> list[Figure]:
    """The rates of records of which only the convention was asked."""
    def hits(name: str) -> list[bool]:
        found, cases = timing[name]
        return [True] * found + [False] * (cases - found)

    return [] if not timing else [
        _rate("record_false_timing_percent", hits("held"), 0.0, "at most",
              "records of a held input alone whose timing was corrected"),
        _rate("record_convention_found_percent", hits("found"), 95.0, "at least",
              "records alone, less than 0.2 sample late, whose convention was found; beside them "
              f"not corrected where lag hides it {timing['untold'][0]} of {timing['untold'][1]}")]


def measured_report(scores: Sequence[MeasuredScore], timing: Timing | None = None) -> str:
    """Rates, the remainder's by its share, answers by kind, and what was wrong, as text."""
    lines = ["RATES"]
    lines += [f"  {f.key:38s} {f.value:6.1f} {f.unit}  bar {f.bar}  {f.how}"
              for f in measured_figures(scores, timing)]
    lines += ["", "REMAINDER BY SHARE OF THE GAP'S POWER"]
    by_share: dict[float, list[MeasuredScore]] = defaultdict(list)
    for score in scores:
        if score.group == "remainder":
            by_share[score.share].append(score)
    for share, found in sorted(by_share.items()):
        low, high = wilson(sum(s.right for s in found), len(found))
        lines.append(f"  {100 * share:3.0f} %: right {sum(s.right for s in found)} of "
                     f"{len(found)} ({low:.0f} to {high:.0f} %), wrong name "
                     f"{sum(s.wrong_name for s in found)}")
    lines += ["", "ANSWERS BY KIND"]
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for score in scores:
        row = score.row.partition(" beside ")[0]
        rows[f"{score.group} {row}"][score.answer] += 1
    lines += [f"  {name:44s} " + ", ".join(f"{answer} {n}" for answer, n in row.most_common())
              for name, row in sorted(rows.items())]
    lines += ["", "NOT RIGHT"]
    lines += [f"  {s.group} {s.index:5d}  {s.row:48s} {s.answer} "
              f"{'WRONG NAME ' if s.wrong_name else ''}"
              f"{'' if s.shown else '(held-out records show it less) '}{s.note}"
              for s in scores if not s.right]
    return "\n".join(lines)
