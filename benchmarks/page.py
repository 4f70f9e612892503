"""The tables of the pages of measured figures, from kept results.

    ./run bench loop --runs 5 --json out/loop.json
    ./run exec python -m benchmarks.page out/loop.json

keeps the results as `benchmarks/kept/figures/<bench>.json`, several files of one bench as one, and
writes the tables between the markers of PAGES anew. Without an argument the tables are made from
what is kept. The `result.json` of `./run bench bytes` is kept as `benchmarks/kept/bytes.json`.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from csv import writer
from datetime import datetime, timezone
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import yaml

from benchmarks.page_wide import control_matrix, in_matrix, targets
from dfm_stage.cli.bench_runs import merged
from dfm_stage.files import write_whole
from dfm_stage.quantity import format_number

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "benchmarks" / "kept" / "figures"
BYTES = KEPT.parent / "bytes.json"
MISSED = KEPT.parent / "missed.csv"
PAGES = tuple(ROOT / "docs" / name for name in ("benchmarks.md", "benchmarks_faults.md"))
OF_ANOTHER = {"two_axes": "composed"}
"""First part of keys that are figures of a bench of another name."""
HEAD = ("figure", "value", "interval", "bar", "peer", "ratio")
NOT_MEASURED = "Not measured yet: `./run bench {}`."
YES_OR_NO = "1 = yes"
UNITS = {"us": "µs", "um": "µm", "1": "", YES_OR_NO: ""}
MARKER = re.compile(r"<!-- figures: (\w+) -->")
UNIT_SUFFIX = re.compile(r"_(percent|ms|us|um|nm|mm|s|hz|mib|gib)$")
MOST_DIGITS = 7

Plain = Mapping[str, Any]


def bench_of(key: str) -> str:
    """Return the bench that a figure's key belongs to."""
    first = key.partition(".")[0]
    return OF_ANOTHER.get(first, first)


def keep(paths: Sequence[Path], folder: Path = KEPT) -> None:
    """Keep the figures that `bench --json` wrote, one file a bench, in place of earlier ones."""
    by_bench: dict[str, list[dict[str, Any]]] = {}
    for path in paths:
        report = json.loads(path.read_text("utf-8"))
        if "targets" in report:
            write_whole(folder.parent / BYTES.name, json.dumps(report, indent=1) + "\n")
            continue
        report.setdefault("measured", datetime.fromtimestamp(
            path.stat().st_mtime, timezone.utc).date().isoformat())
        for bench in dict.fromkeys(bench_of(each["key"]) for each in report["figures"]):
            by_bench.setdefault(bench, []).append({
                **report, "commands": _own(report.get("commands", []), bench),
                "figures": [each for each in report["figures"]
                            if bench_of(each["key"]) == bench],
                "failed": [each for each in report["failed"] if each["bench"] == bench]})
    folder.mkdir(parents=True, exist_ok=True)
    shown = {bench for page in PAGES for bench in MARKER.findall(page.read_text("utf-8"))}
    for bench, reports in by_bench.items():
        if bench not in shown:
            print(f"{bench}: not kept, no page has its figures", file=sys.stderr)
        elif all(each["value"] is None for report in reports for each in report["figures"]):
            print(f"{bench}: not kept, nothing was measured", file=sys.stderr)
        else:
            write_whole(folder / f"{bench}.json",
                        json.dumps(merged(reports), indent=1) + "\n")


def _own(commands: Iterable[str], bench: str) -> list[str]:
    """Return the commands for this bench alone; options stay."""
    out = []
    for command in commands or [f"./run bench {bench}"]:
        options = re.search(r" --.*", command)
        out.append(f"./run bench {bench}{options[0] if options else ''}")
    return out


def read_kept(folder: Path = KEPT) -> dict[str, dict[str, Any]]:
    """Read the kept results of all benches."""
    return {path.stem: json.loads(path.read_text("utf-8"))
            for path in sorted(folder.glob("*.json"))}


def section(bench: str, kept: Mapping[str, Plain]) -> str:
    """Return what stands between the markers of a bench: its table, and how it was made."""
    if bench == "bytes" and BYTES.exists():
        return targets(json.loads(BYTES.read_text("utf-8")), number)
    if bench not in kept:
        text = NOT_MEASURED.format(bench)
    else:
        report = kept[bench]
        shown = [each for each in report["figures"] if not in_matrix(each)]
        parts = [control_matrix(report["figures"], shown_value)] if bench == "control" else []
        parts += [table(shown, runs_of(report))] if shown else []
        text = "\n\n".join([*parts, made(bench, report)])
    return text


def runs_of(report: Plain) -> int:
    """Return how often the bench was run."""
    return max((int(each.get("runs") or 1) for each in report["figures"]), default=1)


def table(figures: Sequence[Plain], runs: int = 1) -> str:
    """Return a table with a row a figure; columns that no figure fills are left out."""
    rows = [[_named(each), shown_value(each), _interval(each, runs), _bar(each), _peer(each),
             "" if each.get("ratio") is None else number(each["ratio"])] for each in figures]
    filled = [k for k in range(len(HEAD)) if any(row[k] for row in rows)]
    lines = [f"|{'|'.join(f' {row[k]} ' if row[k] else ' ' for k in filled)}|"
             for row in [HEAD, *rows]]
    return "\n".join([lines[0], "|---" * len(filled) + "|", *lines[1:]])


@cache
def names() -> dict[str, str]:
    """Return short names of figures by their keys."""
    return dict(yaml.safe_load(Path(__file__).with_name("names.yaml").read_text("utf-8")))


def _named(figure: Plain) -> str:
    key = str(figure["key"])
    plain = UNIT_SUFFIX.sub("", key.partition(".")[2]).replace("_", " ").replace(".", ", ")
    return f"{names().get(key, plain)}<br>`{key}`"


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with three digits, a whole number with all; "–" where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if float(value).is_integer() and abs(value) < 1e9:
        return f"{value:,.0f}".replace("-", "−")
    if abs(value) >= 1000.0:
        whole = round(value, digits - 1 - math.floor(math.log10(abs(value))))
        return f"{whole:,.0f}".replace("-", "−")
    return format_number(value, digits)


def _with_unit(figure: Plain, value: float | None, digits: int = 3) -> str:
    unit = "" if value is None else UNITS.get(figure["unit"], figure["unit"])
    if figure["unit"] == YES_OR_NO and value is not None:
        return "yes" if value == 1.0 else "no" if value == 0.0 else "in half of the runs"
    return f"{number(value, digits)}{' ' if unit else ''}{unit}"


def _digits(figure: Plain) -> int:
    """Return how many digits show on which side of its bar a missed figure is."""
    digits, bars = 3, [figure.get("bar"), figure.get("bar_to")]
    while (figure.get("met") is False and digits < MOST_DIGITS and figure["value"] is not None
           and number(figure["value"], digits) in [number(bar, digits) for bar in bars]):
        digits += 1
    return digits


def shown_value(figure: Plain) -> str:
    """Return the value with its unit, and a mark where it misses its bar."""
    missed = " **missed**" if figure.get("met") is False else ""
    return _with_unit(figure, figure["value"], _digits(figure)) + missed


def _interval(figure: Plain, runs: int) -> str:
    low, high = figure.get("low"), figure.get("high")
    if low is None or high is None:
        return ""
    ends = [_with_unit({**figure, "unit": YES_OR_NO if figure["unit"] == YES_OR_NO else ""}, end)
            for end in (low, high)]
    what = "" if figure.get("interval") == f"{runs} runs" else f" ({figure.get('interval')})"
    return f"{ends[0]} to {ends[1]}{what}" if ends[0] != ends[1] else f"all {ends[0]}{what}"


def _bar(figure: Plain) -> str:
    bar = figure.get("bar")
    if bar is None:
        return ""
    if figure.get("bar_kind") == "between":
        text = f"{number(bar)} to {_with_unit(figure, figure['bar_to'])}"
    elif figure["unit"] == YES_OR_NO:
        text = _with_unit(figure, bar)
    else:
        text = f"{figure.get('bar_kind') or ''} {_with_unit(figure, bar)}".strip()
    return f"{text}, undecided" if figure.get("met") is None else text


def _peer(figure: Plain) -> str:
    if not figure.get("peer"):
        return ""
    if figure["peer_value"] is None:
        return f"{figure['peer']}: failed"
    same = "" if figure["unit"] in ("x", "") else f" {UNITS.get(figure['unit'], figure['unit'])}"
    return f"{figure['peer']}: {number(figure['peer_value'])}{same}".rstrip()


def made(bench: str, report: Plain) -> str:
    """Return in a line how the figures were made, when, and on what."""
    facts, runs = report["machine"], runs_of(report)
    several = {int(each.get("runs") or 1) for each in report["figures"]} == {runs} != {1}
    commands = [f"`{re.sub(r' --runs [0-9]+', '', command)}"
                f"{f' --runs {runs}' if several else ''}`" for command in report["commands"]]
    known = facts.get("load_range") or [facts.get("load_1min")]
    loads = " to ".join(dict.fromkeys(f"{load:.1f}" for load in known if load is not None))
    ranges = "" if runs == 1 else (
        f", {'' if several else 'up to '}{runs} runs: medians with their ranges")
    failed = len(report["failed"])
    versions = f"With {report['versions']}. " if report.get("versions") else ""
    return (f"{' and '.join(dict.fromkeys(commands))}, {report['measured']}, "
            f"{facts['cores']} cores, load {loads or 'not recorded'}{ranges}. "
            f"{f'{failed} of the runs failed. ' if failed else ''}{versions}"
            f"[Details of each figure](../benchmarks/kept/figures/{bench}.json).")


def missed(kept: Mapping[str, Plain]) -> str:
    """Return all missed and all undecided bars as CSV."""
    text = StringIO()
    out = writer(text, lineterminator="\n")
    columns = ("key", "value", "unit", "low", "high", "interval", "bar_kind", "bar", "bar_to")
    out.writerow([*columns, "verdict", "measured", "how"])
    for report in kept.values():
        for each in report["figures"]:
            if each.get("bar") is not None and not each.get("met"):
                verdict = "undecided" if each["met"] is None else "missed"
                out.writerow([*(_cell(each.get(name)) for name in columns), verdict,
                              report["measured"], each["how"]])
    return text.getvalue()


def _cell(value: Any) -> Any:
    return f"{value:.4g}" if isinstance(value, float) and not value.is_integer() else value


def put(text: str, tables: Mapping[str, str]) -> str:
    """Return a page with the text between its markers replaced, by the name of the marker.

    Raises
    ------
    ValueError
        If a marker is not there.
    """
    for name, made_anew in tables.items():
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        head, found, rest = text.partition(begin)
        _, closed, tail = rest.partition(end)
        if not found or not closed:
            raise ValueError(f"no markers {begin} and {end}")
        text = f"{head}{begin}\n\n{made_anew}\n\n{end}{tail}"
    return text


def with_figures(text: str, kept: Mapping[str, Plain]) -> str:
    """Return a page with its tables made anew."""
    return put(text, {f"figures: {bench}": section(bench, kept)
                      for bench in MARKER.findall(text)})


def main(argv: Sequence[str] | None = None) -> int:
    """Keep the results named, if any; write the tables of the pages and the list of misses."""
    keep([Path(name) for name in (sys.argv[1:] if argv is None else argv)])
    kept = read_kept()
    for page in PAGES:
        write_whole(page, with_figures(page.read_text("utf-8"), kept))
    write_whole(MISSED, missed(kept))
    return 0


if __name__ == "__main__":
    sys.exit(main())
