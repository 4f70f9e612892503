"""Two versions of the diagnosis on the same cases: answers that differ, and times side by side.

    ./run exec python -m benchmarks.versions run OUT.jsonl --seed 20261121 --cases 300
    ./run exec python -m benchmarks.versions compare OLD.jsonl NEW.jsonl

The first command runs in a clone of each version, with this file beside its other benchmarks. What
was answered already is kept. The second keeps the comparison in `benchmarks/kept/versions.json`
and prints the tables of docs/benchmarks_diagnosis.md.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.blind.trial import diagnosed, one_thread_each, timed
from benchmarks.corpus import case_plan
from benchmarks.corpus.case import make_truth, shown
from dfm_stage.files import write_whole

KEPT = Path(__file__).with_name("kept") / "versions.json"
ROOT = Path(__file__).resolve().parents[1]
SHARE_WITHIN = 0.9
Answer = Mapping[str, Any]


def version() -> str:
    """Return the commit that this file lies in."""
    return subprocess.run(["git", "rev-parse", "--short=7", "HEAD"], cwd=ROOT, check=True,
                          capture_output=True, text=True).stdout.strip()


def answered(seed: int, index: int) -> dict[str, Any]:
    """Return the answer to one case, with its processor time (s)."""
    case = shown(make_truth(case_plan(index + 1, seed)[index]))
    answer, seconds = timed(partial(diagnosed, case))
    return {"commit": version(), "seed": seed, "index": index,
            "truth": list(case.label.get("true_effects", [])),
            "verdict": answer.get("verdict", answer.get("error")),
            "effects": [[each["name"], each["class"]] for each in answer.get("effects", [])],
            "seconds": round(seconds, 2)}


def run(out: Path, seed: int, cases: int, jobs: int) -> None:
    """Answer the first cases of a seed, each one line of `out`."""
    known = {each["index"] for each in read(out)} if out.exists() else set()
    one_thread_each()
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool, \
            out.open("a", encoding="utf-8") as file:
        for done in as_completed([pool.submit(answered, seed, index) for index in range(cases)
                                  if index not in known]):
            file.write(json.dumps(done.result()) + "\n")
            file.flush()


def read(path: Path) -> list[dict[str, Any]]:
    """Return the answers of a file, in the order of the cases."""
    rows = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    return sorted(rows, key=lambda row: int(row["index"]))


def words(answer: Answer) -> str:
    """Return an answer in a few words; effects of a class with the others of it."""
    told = [f"{name} (or {', '.join(other for other in kin if other != name)})"
            if len(kin) > 1 else name for name, kin in answer["effects"]]
    return f"`{answer['verdict']}`{': ' if told else ''}{', '.join(told)}"


def compared(old: Sequence[Answer], new: Sequence[Answer]) -> dict[str, Any]:
    """Compare the answers to the same cases.

    Raises
    ------
    ValueError
        If they are not the same cases of one seed.
    """
    if [(a["seed"], a["index"]) for a in old] != [(b["seed"], b["index"]) for b in new]:
        raise ValueError("the two files are not of the same cases")
    differ = [{"case": a["index"], "missing": ", ".join(a["truth"]) or "nothing",
               "before": words(a), "after": words(b)}
              for a, b in zip(old, new, strict=True) if words(a) != words(b)]
    return {"seed": old[0]["seed"], "cases": len(old), "before": side(old), "after": side(new),
            "differences": differ}


def side(answers: Sequence[Answer]) -> dict[str, Any]:
    """Return the version of answers and their processor times (s)."""
    seconds = sorted(float(each["seconds"]) for each in answers)
    return {"commit": answers[0]["commit"], "median_s": statistics.median(seconds),
            "within_s": seconds[int(SHARE_WITHIN * len(seconds))], "longest_s": seconds[-1],
            "sum_s": round(sum(seconds), 1)}


def tables(found: Mapping[str, Any]) -> list[str]:
    """Return the lines of the two tables in the documents."""
    lines = ["| version | median | 90 % within | longest | all |", "|---|---|---|---|---|"]
    lines += [f"| {name} ({each['commit']}) | {each['median_s']:.2f} s | {each['within_s']:.1f} s "
              f"| {each['longest_s']:.0f} s | {each['sum_s']:.0f} s |"
              for name in ("before", "after") for each in [found[name]]]
    lines += ["", "| case | missing | before | after |", "|---|---|---|---|"]
    lines += [f"| {each['case']} | {each['missing']} | {each['before']} | {each['after']} |"
              for each in found["differences"]]
    return lines


def kept() -> dict[str, Any]:
    """Return the comparison that is kept."""
    found: dict[str, Any] = json.loads(KEPT.read_text("utf-8"))
    return found


def main(arguments: Sequence[str]) -> int:
    """Run cases, or compare two runs."""
    parser = argparse.ArgumentParser(description="Two versions on the same cases.")
    commands = parser.add_subparsers(dest="command", required=True)
    answering = commands.add_parser("run")
    answering.add_argument("out", type=Path)
    answering.add_argument("--seed", type=int, required=True)
    answering.add_argument("--cases", type=int, required=True)
    answering.add_argument("--jobs", type=int, default=1)
    comparing = commands.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "run":
        run(options.out, options.seed, options.cases, options.jobs)
        return 0
    found = compared(read(options.old), read(options.new))
    write_whole(KEPT, json.dumps(found, indent=1) + "\n")
    print(*tables(found), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
