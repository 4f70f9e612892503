"""The tables of docs/measured_stages.md, from the table of records and from kept results.

    ./run bench real --data DIR --keep out/real
    ./run exec python -m benchmarks.measured.page out/real/results.json

keeps the results (figures only) as `benchmarks/kept/measured_stages.json` and writes the page's
tables anew. Without an argument the tables are made from what is kept.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.measured.records import Expected, MeasuredRecord, load_records
from benchmarks.page import put
from dfm_stage.files import write_whole

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "benchmarks" / "kept" / "measured_stages.json"
PAGE = ROOT / "docs" / "measured_stages.md"
NOT_RUN = "not run"
MOST_NAMES = 2
"""Alternatives that a cell of the table of answers spells out."""


@dataclass(frozen=True)
class Result:
    """What came out of one record; `figures` by the last part of their keys."""

    verdict: str
    names: tuple[str, ...]
    judged: str
    reason: str
    seconds: float
    figures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def write_results(path: Path, results: Mapping[str, Result]) -> None:
    """Keep results, those of other records that the file has already with them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    before = json.loads(path.read_text("utf-8")) if path.exists() else {}
    content = {**before, **{name: asdict(each) for name, each in results.items()}}
    write_whole(path, json.dumps(content, indent=1) + "\n")


def read_results(path: Path = KEPT) -> dict[str, Result]:
    """Read kept results; none where nothing was run."""
    if not path.exists():
        return {}
    return {name: Result(**{**each, "names": tuple(each["names"])})
            for name, each in json.loads(path.read_text("utf-8")).items()}


def answers(results: Mapping[str, Result],
            table: Mapping[str, MeasuredRecord] | None = None) -> str:
    """What was expected of each record, and what was answered."""
    rows = ["| record | expected | answered | judged | left, % | time, s |",
            "|---|---|---|---|---|---|"]
    listed = table or load_records()
    for name, record in listed.items():
        row = [f"[{name}](#{name}){' *' if record.set_rules else ''}", _wanted(record)]
        result = results.get(name)
        if result is None:
            row += [NOT_RUN, "", "", ""]
        else:
            told = ", ".join(f"`{each.replace('|', '` or `')}`" for each in result.names)
            judged = result.judged if result.judged == "right" else f"**{result.judged}**"
            left = result.figures.get("held_out_left_percent", {}).get("value")
            row += [f"{result.verdict}{': ' + told if told else ''}", judged,
                    "" if left is None else f"{left:.3g}", f"{result.seconds:.0f}"]
        rows.append("| " + " | ".join(row) + " |")
    return "\n".join([*_totals(results, listed), *rows])


def _totals(results: Mapping[str, Result], table: Mapping[str, MeasuredRecord]) -> list[str]:
    """How many answers are right, silent and wrong, and of the blind ones; no line where none is
    there."""
    def of(names: Sequence[str]) -> str:
        counts = Counter(results[n].judged for n in names)
        return ", ".join(f"{counts[each]} {each}" for each in ("right", "silent", "wrong"))

    run = [n for n in table if n in results]
    blind = [n for n in run if not table[n].set_rules]
    if not run:
        return []
    words = f"All {len(run)} records: {of(run)}."
    return [f"{words} The {len(blind)} blind ones: {of(blind)}.", ""]


def _wanted(record: MeasuredRecord) -> str:
    """The names that were expected, in few words; without verdicts, and without those of many
    relatives."""
    expected = record.expected
    if expected.required:
        return ", and ".join(map(_few, expected.required))
    if expected.complete is False:
        return "an effect of no library"
    if not {"none", "retune"} & set(expected.verdicts):
        return _few(expected.first)
    return "nothing" + (f", or one of {len(expected.first)} effects" if expected.first else "")


def _few(names: Sequence[str]) -> str:
    """Alternatives, of which the first ones are spelled out."""
    shown = [f"`{name}`" for name in names[:MOST_NAMES]]
    more = [f"{len(names) - MOST_NAMES} more"] if len(names) > MOST_NAMES else []
    return " or ".join((*shown, *more))


def _expected(record: MeasuredRecord) -> str:
    """In words."""
    expected = record.expected
    verdicts = ", ".join(f"`{each}`" for each in expected.verdicts)
    open_end = ", not complete" if expected.complete is False else ""
    if expected.required:
        return f"{_groups(expected)}: {verdicts}{open_end}"
    if not expected.first:
        return verdicts
    return (f"{verdicts}; first name: {' or '.join(f'`{each}`' for each in expected.first)}"
            f"{open_end}")


def _groups(expected: Expected) -> str:
    """One of each group must be named."""
    groups = [" or ".join(f"`{name}`" for name in group) for group in expected.required]
    return groups[0] if len(groups) == 1 else " and ".join(
        f"({group})" if " or " in group else group for group in groups)


def figures_beside_published(results: Mapping[str, Result],
                             table: Mapping[str, MeasuredRecord] | None = None) -> str:
    """Each figure that a source publishes, and ours."""
    rows = ["| record | figure | ours | published | bar | how |", "|---|---|---|---|---|---|"]
    for name in table or load_records():
        result = results.get(name)
        for key, figure in ({} if result is None else result.figures).items():
            if figure.get("peer_value") is None:
                continue
            ours = "–" if figure["value"] is None else \
                f"{_number(figure['value'])} {figure['unit']}{_missed(figure)}"
            rows.append(f"| `{name}` | {key.replace('_', ' ')} | {ours} "
                        f"| {_number(figure['peer_value'])} {figure['unit']} | "
                        f"{_bar(figure)} | {figure['how']} |")
    if len(rows) == 2:
        rows.append(f"| | | {NOT_RUN} | | | |")
    return "\n".join(rows)


def _bar(figure: Mapping[str, Any]) -> str:
    if figure.get("bar_kind") == "between":
        return f"{_number(figure['bar'])} to {_number(figure['bar_to'])}"
    return "" if figure.get("bar") is None else f"{figure['bar_kind']} {_number(figure['bar'])}"


def _missed(figure: Mapping[str, Any]) -> str:
    return " **missed**" if figure.get("met") is False else ""


def _number(value: float | None) -> str:
    return "none" if value is None or not math.isfinite(value) else f"{value:.4g}"


def sources(table: Mapping[str, MeasuredRecord] | None = None) -> str:
    """What each record is, where it is from, how it is split, what was said of it before."""
    parts = []
    for name, r in (table or load_records()).items():
        used = " This record set rules." if r.set_rules else ""
        held = ", ".join(f"`{part}` ({words})" for part, words in r.hold.items())
        fitted = ", ".join(f"`{part}` ({words})" for part, words in r.fit.items())
        parts += [f"### {name}", f"{r.what[0].upper()}{r.what[1:]}.{used}", "",
                  f"- Source: {r.source}. Licence: {r.licence}.",
                  f"- Files, in `DIR/{r.folder or name}`: "
                  + ", ".join(f"`{file}`" for file in r.files) + ".",
                  f"- Given: {r.rate}.",
                  f"- Fitted: {fitted}. Held out: {held or 'the last 30 %'}.",
                  f"- Started from: {_start(r)}.",
                  f"- Expected: {_expected(r)}.", *_also(r),
                  f"- Reason: {r.expected.why.strip()}",
                  *(f"- Published: {each}." for each in r.published),
                  f"- `./run bench real --data DIR --only {name}`", ""]
    return "\n".join(parts).rstrip()


def _start(record: MeasuredRecord) -> str:
    model = (", ".join(f"{name} {value:g}" for name, value in record.model["base"].items())
             if record.model else f"its `{record.model_file}`")
    return f"{model}; `{' '.join(record.options)}`" if record.options else model


def _also(record: MeasuredRecord) -> list[str]:
    others = [name for name in dict.fromkeys(record.expected.also)
              if name not in record.expected.first]
    return [f"- Also accepted: {', '.join(f'`{name}`' for name in others)}."] if others else []


def with_tables(text: str, results: Mapping[str, Result]) -> str:
    """The page with its tables made anew."""
    return put(text, {"answers": answers(results), "figures": figures_beside_published(results),
                      "records": sources()})


def main(argv: list[str] | None = None) -> int:
    """Keep the results named, if any, and write the page's tables."""
    given = sys.argv[1:] if argv is None else argv
    missing = [path for path in given if not Path(path).is_file()]
    if missing:
        print(f"{missing[0]}: no such file; give the results.json of ./run bench real --keep",
              file=sys.stderr)
        return 2
    for path in given:
        write_results(KEPT, read_results(Path(path)))
    PAGE.write_text(with_tables(PAGE.read_text("utf-8"), read_results()), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
