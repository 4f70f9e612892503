"""Several runs of the same benchmarks as one: each figure's median, its range, and its bar."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

Plain = Mapping[str, Any]


def judged(value: float | None, bar: float | None, kind: str | None,
           bar_to: float | None = None) -> bool | None:
    """Return whether a bar is met; None where nothing is to be judged. NaN and None meet none."""
    if bar is None or kind is None:
        return None
    if value is None:
        return False
    if kind == "at least":
        return value >= bar
    if kind == "at most":
        return value <= bar
    return bar_to is not None and bar <= value <= bar_to


def combined(runs: Iterable[Iterable[Plain]]) -> list[dict[str, Any]]:
    """Return one figure a key: the median over the runs that have it, with their range.

    A figure of one run stays as it is. A bar is judged on the median, if more than half of the
    runs judged it.
    """
    by_key: dict[str, list[Plain]] = {}
    for figure in (figure for figures in runs for figure in figures):
        by_key.setdefault(str(figure["key"]), []).append(figure)
    return [dict(some[0]) if len(some) == 1 else _of_several(some) for some in by_key.values()]


def _of_several(some: Sequence[Plain]) -> dict[str, Any]:
    out = dict(some[-1])
    for name in ("value", "peer_value", "ratio"):
        told = [float(each[name]) for each in some if each.get(name) is not None]
        out[name] = median(told) if told else None
    ends = [end for each in some for end in _range(each)]
    runs = sum(_runs(each) for each in some)
    without = sum(each["value"] is None for each in some)
    kinds = [each["bar_kind"] for each in some if each.get("bar_kind") is not None]
    out |= {"low": min(ends, default=None), "high": max(ends, default=None), "runs": runs,
            "interval": f"{runs - without} of {runs} runs" if without else f"{runs} runs",
            "bar_kind": kinds[-1] if 2 * len(kinds) > len(some) else None}
    return {**out, "met": judged(out["value"], out.get("bar"), out["bar_kind"],
                                 out.get("bar_to"))}


def _runs(figure: Plain) -> int:
    return int(figure.get("runs") or 1)


def _range(figure: Plain) -> list[float]:
    """Return the ends of what runs gave; an interval that is no range over runs does not count."""
    ends = [figure.get(name) for name in ("low", "high")] if _runs(figure) > 1 else []
    return [float(end) for end in (ends or [figure["value"]]) if end is not None]


def merged(reports: Sequence[Plain]) -> dict[str, Any]:
    """Return what several runs of `bench --json` wrote as one; the machine is that of the last.

    Raises
    ------
    KeyError, TypeError, ValueError
        If something else is given.
    """
    machine = dict(reports[-1]["machine"])
    loads = [load for each in reports if (facts := each["machine"])
             for load in (facts.get("load_range") or [facts.get("load_1min")])
             if load is not None]
    if len(reports) > 1 and loads:
        machine["load_range"] = [min(loads), max(loads)]
    return {"machine": machine,
            **{name: value for each in reports for name in ("measured", "commit", "versions")
               if (value := each.get(name))},
            "commands": list(dict.fromkeys(
                command for each in reports for command in each.get("commands", ()))),
            "figures": combined(each["figures"] for each in reports),
            "failed": [failure for each in reports for failure in each.get("failed", ())]}
