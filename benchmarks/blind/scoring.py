"""What an answer is worth: diagnosis.json against the label, case by case."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

NAMED, PARTIAL, AMBIGUOUS, ERROR = "named", "partial", "ambiguous", "error"
FLOOR_SLACK = 1.05


@dataclass(frozen=True)
class Score:
    """One case, judged.

    exact: what the label expects, to the name. right_class: that, or a name or ambiguity within
    the class. counted: whether the case belongs in the denominator of its kind. names: what was
    named. spurious: a name beyond the true ones. covered: per parameter, whether the interval
    holds the truth. held_out_over_floor: gap left on held-out data over the noise's RMS.
    class_size: how many effects the answer leaves in question, where it is in the right class.
    """

    index: int
    kind: str
    label: str
    answer: str
    verdict: str
    names: tuple[str, ...]
    severity: float
    exact: bool
    right_class: bool
    counted: bool
    false_name: bool
    spurious: bool
    covered: tuple[bool, ...] = ()
    held_out_over_floor: float | None = None
    seconds: float | None = None
    class_size: int | None = None
    notes: tuple[str, ...] = field(default=())


def judge(label: Mapping[str, Any], answer: Mapping[str, Any],
          seconds: float | None = None) -> Score:
    """Judge one diagnosis (the content of diagnosis.json, or {"error": line}) by its label."""
    verdict = str(answer.get("verdict", ERROR)) if "error" not in answer else ERROR
    found = [effect for effect in answer.get("effects", []) if isinstance(effect, Mapping)]
    claims = verdict in (NAMED, AMBIGUOUS)
    names = tuple(str(effect["name"]) for effect in found) if verdict == NAMED else ()
    listed = {str(n) for e in found for n in [e["name"], *e.get("class", [])]} if claims else set()
    kind, truth = str(label["kind"]), [str(name) for name in label["effects"]]
    exact, right, counted, spurious = _by_kind(label, verdict, names, listed, answer)
    solved = verdict == NAMED and exact and bool(truth)
    return Score(
        index=int(label["index"]), kind=kind, label=label_text(label),
        answer=_answer_text(verdict, names, listed), verdict=verdict, names=names,
        severity=float(label["severity"]), exact=exact, right_class=right, counted=counted,
        false_name=claims and kind in ("none", "trap", "retune"), spurious=spurious,
        covered=_covered(label, found) if solved else (),
        held_out_over_floor=_held_out(label, answer) if solved else None, seconds=seconds,
        class_size=max((len(set(e.get("class", [])) | {e["name"]}) for e in found), default=None)
        if right and kind == "effect" and claims else None,
        notes=(str(answer["error"]),) if "error" in answer else ())


def label_text(label: Mapping[str, Any]) -> str:
    """The row of the confusion matrix that a label belongs to."""
    if label["kind"] == "trap":
        return f"trap {label['trap']}"
    if label["kind"] == "left_out":
        return f"without {'+'.join(label['effects'])}"
    return "+".join(label["effects"]) or str(label["kind"])


def _answer_text(verdict: str, names: tuple[str, ...], listed: set[str]) -> str:
    if verdict == NAMED:
        return "+".join(sorted(names))
    if verdict == AMBIGUOUS:
        return f"ambiguous {{{', '.join(sorted(listed))}}}"
    return verdict


def _by_kind(label: Mapping[str, Any], verdict: str, names: tuple[str, ...], listed: set[str],
             answer: Mapping[str, Any]) -> tuple[bool, bool, bool, bool]:
    """exact, right class, counted, spurious."""
    truth = {str(name) for name in label["effects"]}
    group = {str(name) for name in label["class"]} or truth
    expected = [str(v) for v in label["expected"]]
    kind = label["kind"]
    separable = bool(label.get("separable", True))
    if kind == "left_out" and "relatives" in label:
        told = {str(e["name"]) for e in answer.get("effects", []) if isinstance(e, Mapping)}
        strange = bool((told | listed) - set(label["relatives"]))
        exact = verdict == "unknown" or (verdict == PARTIAL and not strange)
        wrong = verdict == NAMED or (verdict in (PARTIAL, AMBIGUOUS) and strange)
        return exact, exact, separable, wrong
    if kind == "left_out":
        exact = verdict == "unknown"
        return exact, exact, not _stand_in(label, answer), verdict == NAMED
    if kind == "pair":
        both = verdict == NAMED and truth <= set(names)
        return both, both, separable, bool(set(names) - truth) and verdict == NAMED
    if kind != "effect":
        return verdict in expected, verdict in expected, True, verdict == NAMED
    if expected == [AMBIGUOUS]:
        exact = verdict == AMBIGUOUS and bool(truth & listed)
    elif expected == [NAMED]:
        exact = verdict == NAMED and set(names) == truth
    else:
        exact = verdict in expected
    within = verdict in (NAMED, AMBIGUOUS) and bool(listed) and set(names) <= group and (
        verdict == NAMED or bool(truth & listed)) and len(names) <= 1
    return (exact, exact or within, separable and expected == [NAMED],
            verdict == NAMED and bool(set(names) - group))


def _stand_in(label: Mapping[str, Any], answer: Mapping[str, Any]) -> bool:
    """Whether a remaining candidate comes to within 5 % of the noise on held-out data."""
    reached = [e.get("held_out_rms") for e in answer.get("rejected", [])]
    if answer.get("verdict") in (NAMED, AMBIGUOUS):
        reached.append(answer.get("gap", {}).get("held_out", {}).get("after"))
    known = [float(r) for r in reached if r is not None and math.isfinite(float(r))]
    return bool(known) and min(known) <= FLOOR_SLACK * floor(label)


def floor(label: Mapping[str, Any]) -> float:
    """RMS of what no model explains: the noise and the rounding (m)."""
    rounding = float(label["true_base"].get("encoder_resolution", 0.0)) / math.sqrt(12.0)
    step = label["true_effects"].get("encoder_quantization", {}).get("step", 0.0)
    return math.hypot(float(label["noise"]), rounding, float(step) / math.sqrt(12.0))


def _held_out(label: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    after = answer.get("gap", {}).get("held_out", {}).get("after")
    return None if after is None else float(after) / floor(label)


def _covered(label: Mapping[str, Any], found: list[Mapping[str, Any]]) -> tuple[bool, ...]:
    hits = []
    for effect in found:
        truth = label["true_effects"].get(effect["name"])
        if truth is None:
            continue
        for name, value in effect.get("parameters", {}).items():
            interval = value.get("ci95") if isinstance(value, Mapping) else None
            if interval is None or name not in truth:
                continue
            low, high = float(interval[0]), float(interval[1])
            true = float(truth[name])
            if name == "phase":
                middle = 0.5 * (low + high)
                true = middle + math.remainder(true - middle, 2.0 * math.pi)
            hits.append(low <= true <= high)
    return tuple(hits)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a rate, in percent; 0 to 100 without cases."""
    if count == 0:
        return 0.0, 100.0
    z, rate = 1.959963984540054, hits / count
    centre = (rate + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z / (1.0 + z * z / count) * math.sqrt(
        rate * (1.0 - rate) / count + z * z / (4.0 * count * count))
    return 100.0 * max(centre - half, 0.0), 100.0 * min(centre + half, 1.0)


def detection_limit(shares: Mapping[float, float]) -> float | None:
    """Severity at which half of the cases are named, between the ones tried by logarithm.

    `shares` is severity -> share named; None where half is not crossed. Shares are first made to
    rise with severity (running mean of violators).
    """
    sizes = sorted(shares)
    rising: list[list[float]] = []
    for size in sizes:
        rising.append([shares[size], 1.0])
        while len(rising) > 1 and rising[-2][0] > rising[-1][0]:
            (a, m), (b, n) = rising[-2], rising.pop()
            rising[-1] = [(a * m + b * n) / (m + n), m + n]
    levels = [value for value, times in rising for _ in range(int(times))]
    for i in range(1, len(sizes)):
        if levels[i - 1] < 0.5 <= levels[i]:
            part = (0.5 - levels[i - 1]) / (levels[i] - levels[i - 1])
            return float(sizes[i - 1] * (sizes[i] / sizes[i - 1]) ** part)
    return None
