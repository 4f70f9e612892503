"""Diagnoses of records that others measured: `./run bench real --data DIR [--only NAME]`.

DIR holds the reader's own copies, a folder for each record; where each comes from stands in
`benchmarks/measured/records.yaml`, with the answer that was expected before it was run. A record
that is not there is left out, with a line that says where to get it. Records that were used to
set rules are also looked for in DFM_SHARED_DATA or ../shared/data. With `--keep` the CSV files,
models and diagnoses stay in a folder of their own each, and results.json beside them, from which
`python -m benchmarks.measured.page` makes the tables of docs/measured_stages.md.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.figure import Figure
from benchmarks.measured.judging import Judgement, judge, names_of
from benchmarks.measured.metrics import (
    Convention,
    force_error,
    offset_of,
    parameter_of,
    rmse,
)
from benchmarks.measured.page import Result, write_results
from benchmarks.measured.records import load_records
from benchmarks.measured.trial import Trial, run
from dfm_stage.errors import DfmError

LONGEST_CPU_S = 60.0
"""Processor time (s) promised for the records that were used to set rules."""


class RealError(DfmError):
    """Measured records that cannot be found as asked."""


def figures(quick: bool = False, *, data: Path | None = None, only: str | None = None,
            keep: Path | None = None) -> list[Figure]:
    """Diagnose every record that is there; `quick` the smallest of them only.

    Raises
    ------
    RealError
        If `data` is no folder, or `only` names a record that is not in the table.
    """
    table = load_records()
    if only is not None and only not in table:
        raise RealError(f"--only {only}: there is no such record among {', '.join(table)}")
    if data is not None and not data.is_dir():
        raise RealError(f"--data {data}: no such folder; it holds a folder for each record")
    wanted = [only] if only else (["servo_link"] if quick else list(table))
    folders = [data] if data else []
    with tempfile.TemporaryDirectory(prefix="dfm_stage_real_") as scratch:
        work = keep or Path(scratch)
        results: dict[str, Result] = {}
        found: list[Figure] = []
        for name in wanted:
            record = table[name]
            source = record.where([*folders, *([shared()] if record.development else [])])
            if source is None:
                found.append(Figure(f"real.{name}.right", math.nan, "",
                                    how=f"left out: {record.how_to_get}"))
                continue
            trial = run(record, source, work / name)
            own = figures_of(trial)
            found += own
            results[name] = result_of(trial, own)
        write_results(work / "results.json", results)
    return found


def shared() -> Path:
    """The folder of the records for development."""
    named = os.environ.get("DFM_SHARED_DATA")
    return Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"


def verdict_of(trial: Trial) -> Judgement:
    """The judgement of a trial; one without an answer is silent."""
    if not trial.answer:
        return Judgement("silent", f"no answer: {trial.complaint}")
    return judge(trial.record.expected, trial.answer)


def result_of(trial: Trial, own: list[Figure]) -> Result:
    """What the docs tell of a trial."""
    judgement = verdict_of(trial)
    return Result(trial.answer.get("verdict", "error"), names_of(trial.answer), judgement.judged,
                  judgement.reason, trial.seconds,
                  {figure.key.split(".", 2)[2]: figure.to_dict() for figure in own})


def figures_of(trial: Trial) -> list[Figure]:
    """The figures of one trial; a figure that its source publishes has that as its peer."""
    name, development = trial.record.name, trial.record.development
    judgement = verdict_of(trial)
    said = ", ".join(names_of(trial.answer)) or "no name"
    found = [
        Figure(f"real.{name}.right", float(judgement.judged == "right"), "",
               1.0 if development else None, bar_kind="at least" if development else None,
               how=f"{judgement.judged}: {judgement.reason}; "
               f"{trial.answer.get('verdict', 'error')}: {said}"),
        Figure(f"real.{name}.seconds", trial.seconds, "s",
               LONGEST_CPU_S if development else None,
               bar_kind="at most" if development else None,
               how="processor time of the command, reading and compiling with it")]
    if trial.answer:
        found += [*_gap(trial), *_parameters(trial), *_predictions(trial), *_forces(trial)]
    return found


def _gap(trial: Trial) -> list[Figure]:
    gap = trial.answer["gap"]
    before, after = (gap["held_out"].get(when) for when in ("before", "after"))
    if not before or after is None:
        return []
    where = gap.get("judged", "output")
    return [Figure(f"real.{trial.record.name}.held_out_left_percent", 100.0 * after / before, "%",
                   how=f"held-out RMS {before:.3g} before, {after:.3g} {gap['unit']} after; "
                   f"judged in {where}")]


def _parameters(trial: Trial) -> list[Figure]:
    found = []
    held = []
    for address, published in trial.record.parameters.items():
        told = parameter_of(trial.answer, address)
        key = f"real.{trial.record.name}.{address.replace('.', '_')}"
        if told is None or told.get("value") is None:
            found.append(_missing(key, published))
            held.append(False)
            continue
        value = abs(told["value"]) if published.get("absolute") else told["value"]
        wide = published["value"] * published.get("bar", math.nan) / 100.0
        ends = [abs(end) if published.get("absolute") else end for end in told.get("ci95") or ()]
        inside = bool(ends) and min(ends) <= published["value"] <= max(ends)
        held.append(inside)
        found.append(Figure(
            key, value, published["unit"], published["value"] - wide if wide == wide else None,
            "published", published["value"], value / published["value"],
            f"95 % interval {_digits(ends)}, which {'holds' if inside else 'does not hold'} "
            "the published value", "between" if wide == wide else None,
            published["value"] + wide if wide == wide else None))
    if held:
        promised = 100.0 if trial.record.development else None
        found.append(Figure(
            f"real.{trial.record.name}.intervals_hold_percent", 100.0 * sum(held) / len(held), "%",
            promised, how=f"published values inside the 95 % interval told, of {len(held)}",
            bar_kind="at least" if promised else None))
    return found


def _missing(key: str, published: Mapping[str, Any]) -> Figure:
    wide = published["value"] * published.get("bar", math.nan) / 100.0
    promised = wide == wide
    return Figure(key, math.nan, published["unit"],
                  published["value"] - wide if promised else None, "published",
                  published["value"], how="not named", bar_kind="between" if promised else None,
                  bar_to=published["value"] + wide if promised else None)


def _predictions(trial: Trial) -> list[Figure]:
    how = trial.record.rmse
    if how is None:
        return []
    model, after, scale = trial.model, int(how["after"]), float(how["scale"])
    fitted = next(iter(trial.record.fit))
    offset = offset_of(model, trial.parts[fitted], Convention.of(trial.answer, fitted), after)

    def value(each: Mapping[str, Any]) -> float:
        return scale * rmse(model, trial.parts[each["hold"]],
                            Convention.of(trial.answer, each["hold"]), after, offset,
                            each.get("samples"))

    words = f"RMSE from sample {after} on; first state by the samples before, offset by the fit"
    return _against_published(trial, how["figures"], "rmse", how["unit"], value, words)


def _forces(trial: Trial) -> list[Figure]:
    how = trial.record.force
    if how is None:
        return []
    model, band = trial.model, float(how["band_hz"])

    def value(each: Mapping[str, Any]) -> float:
        return force_error(model, trial.parts[each["part"]], band,
                           Convention.of(trial.answer, each["part"]))

    return _against_published(trial, how["figures"], "force_error", "%", value,
                              f"inverse dynamics below {band:g} Hz")


def _digits(ends: Sequence[float]) -> str:
    """An interval in four digits."""
    return f"[{', '.join(f'{end:.4g}' for end in ends)}]" if ends else "unknown"


def _against_published(trial: Trial, asked: Mapping[str, Mapping[str, Any]], what: str, unit: str,
                       value: Callable[[Mapping[str, Any]], float],
                       words: str) -> list[Figure]:
    found = []
    for name, each in asked.items():
        try:
            figure, note = value(each), words
        except (DfmError, ValueError) as error:
            figure, note = math.nan, f"not computed: {error}"
        found.append(Figure(f"real.{trial.record.name}.{what}_{name}", figure, unit, each["bar"],
                            each["peer"], each["peer_value"], figure / each["peer_value"], note,
                            "at most"))
    return found
