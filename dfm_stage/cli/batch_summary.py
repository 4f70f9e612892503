"""The summary of many diagnoses of one stage: summary.html, summary.json and summary.csv."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.cli.command import Tone, finite, write_json, write_output
from dfm_stage.diagnosis.history import Answer, Change, History
from dfm_stage.reporting import (
    Drawing,
    Link,
    Page,
    Quantity,
    Table,
    display_unit,
    new_figure,
    page_style,
)
from dfm_stage.reporting.table import Cell

MEANINGS = {
    "none": "nothing is missing", "retune": "only the base parameters are wrong",
    "named": "effects are missing in the model", "partial": "effects explain a part of the gap",
    "ambiguous": "several effects explain the gap alike",
    "unknown": "no effect of the library explains the gap",
    "not_excited": "the motion is small beside what the model leaves as noise"}
DATES = {"recording": "Times are those of the recordings.",
         "file": "The records do not all say when they were made: times are those of their files.",
         "order": "The records do not say when they were made, and their files were written "
         "together: they stand in the order in which they were given."}
MOST_TOLD = 3
"""Effects, and changes, in the first sentence."""
MOST_DRAWN = 8
"""Parameters that are drawn over time, the clearest changes first."""


def write_summary(found: History, failed: Sequence[Mapping[str, str]], out: Path,
                  model: str) -> str:
    """Write the three files into `out`, and return the summary in a sentence.

    `failed` are the records that were not answered: `run`, and the reason in `words`.

    Raises
    ------
    DfmError
        If the folder cannot be written.
    """
    said = sentence(found, failed)
    write_json(out / "summary.json", finite(_plain(found, failed, said)))
    write_output(out / "summary.csv", _csv(found, failed))
    _page(found, failed, out, model, said).write(out / "summary.html")
    return said


def sentence(found: History, failed: Sequence[Mapping[str, str]]) -> str:
    """How many were answered, what was found most often, and what changes."""
    count = len(found.answers)
    said = f"{count} of {count + len(failed)} diagnosed"
    if found.effects:
        said += ": " + ", ".join(f"{name.replace('_', ' ')} in {number}"
                                 for name, number in list(found.effects.items())[:MOST_TOLD])
    elif count:
        said += ", and no effect is missing in any"
    real = [change.words for change in found.changes if change.real]
    alone = [change.words for change in found.changes if change.outlying and not change.real]
    told = (words[:1].upper() + words[1:] for words in (real + alone)[:MOST_TOLD])
    return ". ".join((said, *told)) + "."


def _plain(found: History, failed: Sequence[Mapping[str, str]], said: str) -> dict[str, Any]:
    count = len(found.answers)
    return {
        "schema": 1, "sentence": said, "records": count + len(failed), "diagnosed": count,
        "dated_by": found.dated_by, "per": found.per, "verdicts": found.verdicts,
        "effects": [{"name": name, "records": number, "share": number / count}
                    for name, number in found.effects.items()],
        "changes": [change.to_dict() for change in found.changes],
        "failed": [dict(each) for each in failed],
        "answers": [{"folder": a.name, "time": time, "date": _date(found, a),
                     "verdict": a.verdict, "effects": list(a.effects),
                     "parameters": {n: q.to_dict() for n, q in a.parameters.items()}}
                    for a, time in zip(found.answers, found.times.tolist(), strict=True)]}


def _csv(found: History, failed: Sequence[Mapping[str, str]]) -> str:
    """A line a record; of each parameter its value and interval."""
    names = list(dict.fromkeys(n for a in found.answers for n in a.parameters))
    units = {n: q.unit for a in found.answers for n, q in a.parameters.items()}
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["record", "date", f"time_{found.per}", "verdict", "effects", "reason", *(
        f"{n} ({units[n]}){end}" for n in names for end in ("", " low", " high"))])
    for a, time in zip(found.answers, found.times.tolist(), strict=True):
        cells: list[object] = [a.name, _date(found, a), time, a.verdict, " ".join(a.effects), ""]
        for name in names:
            q = a.parameters.get(name)
            cells += ["", "", ""] if q is None else [q.value, *(q.ci95 or ("", ""))]
        rows.writerow(cells)
    for each in failed:
        rows.writerow([each["run"], "", "", "", "", each["words"], *[""] * (3 * len(names))])
    return text.getvalue()


def _date(found: History, answer: Answer) -> str:
    if found.dated_by == "order":
        return ""
    seconds = answer.recorded_s if found.dated_by == "recording" else answer.written_s
    return datetime.fromtimestamp(seconds or 0.0, timezone.utc).strftime("%Y-%m-%d %H:%M:%S")


def _page(found: History, failed: Sequence[Mapping[str, str]], out: Path, model: str,
          said: str) -> Page:
    page = Page("Diagnoses of one stage")
    badge, tone = _badge(found, failed)
    page.lead(said, badge, tone)
    _verdicts(page, found, failed)
    _effects(page, found)
    _over_time(page, found)
    _stand_out(page, found, out)
    if failed:
        page.section("Not answered")
        page.table(("record", "reason"), [[e["run"], e["words"]] for e in failed])
    _records(page, found, out)
    return page.provenance({"Model": model, "Records": len(found.answers) + len(failed),
                            "Dates": DATES[found.dated_by]})


def _badge(found: History, failed: Sequence[Mapping[str, str]]) -> tuple[str, Tone]:
    if any(change.real for change in found.changes):
        return "changes", "warn"
    if any(change.outlying for change in found.changes):
        return "some stand out", "warn"
    return ("incomplete", "warn") if failed or not found.answers else ("steady", "good")


def _verdicts(page: Page, found: History, failed: Sequence[Mapping[str, str]]) -> None:
    page.section("Verdicts")
    rows: list[list[Cell]] = [[kind.replace("_", " "), number, MEANINGS[kind]]
                              for kind, number in found.verdicts.items()]
    if failed:
        rows.append(["not answered", len(failed), "see below for the reasons"])
    page.table(("verdict", "records", "meaning"), rows)


def _effects(page: Page, found: History) -> None:
    if not found.effects:
        return
    page.section("Effects", "In how many records each effect was found missing in the model, and "
                 "its sizes.")
    rows: list[list[Cell]] = []
    for name, number in found.effects.items():
        own = [a.effects[name] for a in found.answers if name in a.effects]
        sizes = {p: [each["parameters"][p] for each in own if p in each["parameters"]]
                 for p in dict.fromkeys(p for each in own for p in each["parameters"])}
        for k, (parameter, each) in enumerate(sizes.items()):
            values = [q["value"] for q in each]
            unit = each[0]["unit"]
            rows.append([name if k == 0 else "", f"{number} ({number / len(found.answers):.0%})"
                         if k == 0 else "", parameter, *(
                Quantity(v, unit) for v in (min(values), statistics.median(values), max(values)))])
    page.table(("effect", "records", "parameter", "least", "median", "largest"), rows)


def _over_time(page: Page, found: History) -> None:
    if not found.changes:
        return
    page.section("Over time", f"{DATES[found.dated_by]} Each line is fitted to the records that "
                 "do not stand out. Bars and the band about it are 95 % intervals. Records whose "
                 "model is incomplete are left out.")
    drawn = found.changes[:MOST_DRAWN]
    for change in drawn:
        page.figure(_drawn(change), change.words[:1].upper() + change.words[1:] + ".")
    rest = found.changes[MOST_DRAWN:]
    if rest:
        page.table(("parameter", "change"), [[c.parameter, c.words] for c in rest])


def _drawn(change: Change) -> Drawing:
    """A parameter of every record, the line through them and its band."""
    values = np.array([q.value for q in change.values])
    factor, unit = display_unit((float(np.max(np.abs(values))),), change.unit)
    halves = np.array([q.half_width if np.isfinite(q.half_width) else 0.0
                       for q in change.values])
    alone = np.isin(np.arange(values.size), change.outlying)
    figure, axis = new_figure(1, 2.6)
    along = np.linspace(float(np.min(change.times)), float(np.max(change.times)), 60)
    with page_style():
        for which, colour, label in ((~alone, "C0", "records"), (alone, "C1", "stand out")):
            if np.any(which):
                axis.errorbar(change.times[which], factor * values[which], factor * halves[which],
                              linestyle="", marker="o", markersize=3.5, elinewidth=0.8,
                              color=colour, label=label)
        axis.plot(along, factor * change.at(along), color="C2", linewidth=1.3, label="line")
        half = factor * change.half_band(along)
        axis.fill_between(along, factor * change.at(along) - half,
                          factor * change.at(along) + half, color="C2", alpha=0.2, linewidth=0)
        axis.set(xlabel="record" if change.per == "record" else f"time ({change.per}s)",
                 ylabel=f"{change.parameter} ({unit})")
        axis.ticklabel_format(axis="y", useOffset=False)
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
    return Drawing(figure, Table(("", "value"), [
        ["records", len(values)], [f"change a {change.per}", str(change.slope)],
        ["at the beginning", Quantity(float(change.at(along[:1])[0]), change.unit)],
        ["at the end", Quantity(float(change.at(along[-1:])[0]), change.unit)]]))


def _stand_out(page: Page, found: History, out: Path) -> None:
    rows: list[list[Cell]] = [
        [_link(change.names[k], out), change.parameter, change.values[k],
         Quantity(float(change.at(change.times[k:k + 1])[0]), change.unit)]
        for change in found.changes for k in change.outlying]
    if rows:
        page.section("Records that stand out", "Their values lie further from the line than "
                     "chance explains. Look at these records first.")
        page.table(("record", "parameter", "value", "line"), rows)


def _records(page: Page, found: History, out: Path) -> None:
    page.section("All records", "In order of time. Each name leads to its report.")
    rows: list[list[Cell]] = []
    for a in found.answers:
        gap = a.content["gap"]
        before, after = (gap["held_out"][word] for word in ("before", "after"))
        rows.append([_link(a.name, out), _date(found, a), a.verdict.replace("_", " "),
                     ", ".join(a.effects), *(None if v is None else Quantity(v, gap["unit"])
                                             for v in (before, after))])
    page.table(("record", "date (UTC)", "verdict", "effects", "RMS before", "RMS after"), rows)


def _link(name: str, out: Path) -> Link:
    """The record's report, or its answer where no report was asked for."""
    file = next((f for f in ("report.html", "diagnosis.json") if (out / name / f).exists()), "")
    return Link(name, f"{name}/{file}")

