"""Faults of nodes and of what they live on, during a scan: safe, explained, recovered.

    ./run exec python -m benchmarks.faults FOLDER SUM RESULT...

adds up the runs of several seeds, whose outcomes `--keep FOLDER` and results `--json RESULT` are
there, into one result, SUM.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.fault_block import kept, run_block
from benchmarks.fault_kinds import KINDS, draw
from benchmarks.fault_outcome import Fault, Outcome, Tally
from benchmarks.fault_sight import TRAVEL_M
from benchmarks.figure import Figure
from benchmarks.private import PRIVATE, private_mounts
from dfm_stage.cli.bench_runs import merged
from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole

FULL, QUICK, SEED, BLOCK = 200, 20, 1, 25
PR_SET_CHILD_SUBREAPER = 36
GRACE_S = 3.0
ANSWER_S, RECOVERY_S, RECOVERY_P99_S = 2.0, 0.5, 5.0


def figures(quick: bool = False, cases: int | None = None, seed: int = SEED,
            resume: bool = False, keep: Path | None = None,
            only: str | None = None) -> list[Figure]:
    """Measure 200 faults (quick: 20, or `cases`), drawn with `seed`, `only` of this kind.

    They run in blocks of 25, each in a process of its own, whose outcomes are kept in `keep`.
    With `resume` a block that is there is not run again.
    """
    if only not in {None, *KINDS}:
        raise DfmError(f"there is no kind of fault {only!r}: choose {', '.join(KINDS)}")
    faults, why = _possible(draw(cases or (QUICK if quick else FULL), seed, only))
    # orphans of a killed node would become children of this process, and so be seen
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    tallies, left = [], 0
    with tempfile.TemporaryDirectory(prefix="dfm_faults_") as scratch:
        folder = (keep or Path(scratch)) / f"seed_{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        for name, block in _blocks(faults, only):
            tally = kept(block, folder / name) if resume else None
            tallies.append(tally or run_block(block, folder / name))
            left += 0 if tally else _orphans()
    tally = Tally.of_all(tallies)
    _print(tally)
    return _figures(tally, f"seed {seed}{why}", left)


def _figures(tally: Tally, seeds: str, left: float) -> list[Figure]:
    return [*_outcomes(tally, seeds), *_operator(tally), *_messages(tally),
            Figure("faults.orphans", left, "processes", 0.0, bar_kind="at most",
                   how="after each block of faults was over")]


def main(arguments: Sequence[str]) -> int:
    """Add up runs of several seeds: a median would hide what happened once."""
    folder, out, *results = map(Path, arguments)
    reports = [json.loads(path.read_text("utf-8")) for path in results]
    seeds = sorted(folder.glob("seed_*"))
    tally = Tally.of_all([Tally.from_dict(json.loads(path.read_text("utf-8")))
                          for seed in seeds for path in sorted(seed.glob("*.json"))])
    left = sum(each["value"] for report in reports for each in report["figures"]
               if each["key"] == "faults.orphans")
    names = ", ".join(seed.name.removeprefix("seed_") for seed in seeds)
    write_whole(out, json.dumps({**merged(reports), "figures": [
        each.to_dict() for each in _figures(tally, f"seeds {names}", left)]}, indent=1) + "\n")
    return 0


def _possible(faults: Sequence[Fault]) -> tuple[list[Fault], str]:
    """Return the faults that this machine permits, and in words what is left out."""
    if private_mounts():
        os.environ[PRIVATE] = "1"  # each block will have them
    why = {kind.name: kind.impossible() for kind in KINDS.values()}
    missing = sorted({each.kind for each in faults if why[each.kind]})
    words = "".join(f"; no {name}: {why[name]}" for name in missing)
    return [each for each in faults if not why[each.kind]], words


def _blocks(faults: Sequence[Fault], only: str | None) -> Iterator[tuple[str, list[Fault]]]:
    """Yield file names and faults; those that need another clock are in blocks of their own."""
    for faked in (False, True):
        some = [each for each in faults if KINDS[each.kind].faked_clock == faked]
        for start in range(0, len(some), BLOCK):
            name = "_".join(filter(None, ("clock" if faked else "block", only)))
            yield f"{name}_{start // BLOCK:03d}.json", some[start:start + BLOCK]


def _print(tally: Tally) -> None:
    for title, some in (
            ("unsafe", [each for each in tally.outcomes if not each.safe]),
            ("unexplained", [each for each in tally.outcomes if each.explained is False]),
            ("not recovered", [each for each in tally.outcomes if not each.recovered])):
        for each in some:
            print(f"{title}: {each.fault}: {each.words}")
    for words in tally.lost_words:
        print(f"lost: {words}")
    print(f"{'kind':20}{'count':>6}{'unsafe':>8}{'silent':>8}{'not back':>9}{'cut':>5}"
          f"{'answer s':>10}{'back s':>8}")
    for name in KINDS:
        if some := [each for each in tally.outcomes if each.fault.kind == name]:
            print(f"{name:20}{len(some):6}{sum(not each.safe for each in some):8}"
                  f"{sum(each.explained is False for each in some):8}"
                  f"{sum(not each.recovered for each in some):9}"
                  f"{sum(each.cut for each in some):5}"
                  f"{max(each.answered_s for each in some):10.2f}"
                  f"{float(np.median([each.took_s for each in some])):8.2f}")


def _outcomes(tally: Tally, seeds: str) -> list[Figure]:
    outcomes = tally.outcomes
    safe = [each.safe_s for each in outcomes if each.safe] or [np.nan]
    took = np.array([each.took_s for each in outcomes if each.recovered] or [np.nan])
    how = (f"of {len({each.fault.kind for each in outcomes})} kinds, each on each of its targets "
           f"in turn, {seeds}, during a raster at 1 kHz in six processes; "
           f"repeated, as the witness itself heard nothing any more: {tally.deaf}")
    return [
        Figure("faults.injected", float(len(outcomes)), "faults", None, how=how),
        Figure("faults.stopped_loop", float(sum(each.cut for each in outcomes)), "faults",
               how="of them, during which the loop was cut"),
        _count("unsafe", [each for each in outcomes if not each.safe],
               "the output was neither at zero nor under control 3 s later, or the travel "
               f"was passed; median {np.median(safe):.2f} s until it was, worst "
               f"{np.max(safe):.2f}; seen in the bag alone, the witness being behind: "
               f"{sum(each.by_bag for each in outcomes)}"),
        Figure("faults.travel_mm", 1e3 * tally.travelled, "mm", 1e3 * TRAVEL_M,
               bar_kind="at most", how="furthest in all bags, also while it was repaired"),
        _count("unexplained", [each for each in outcomes if each.explained is False],
               "a node was gone or the output cut, and diagnostics did not say why"),
        _count("not_recovered", [each for each in outcomes if not each.recovered],
               "the scan did not run again after starting the node, clear, arm, start"),
        Figure("faults.recovery_s", float(np.median(took)), "s", RECOVERY_S, bar_kind="at most",
               how=f"start of the node to scan at work, median; worst {np.max(took):.2f}"),
        Figure("faults.recovery_p99_s", float(np.percentile(took, 99)), "s", RECOVERY_P99_S,
               bar_kind="at most", how="the same, 99 % within"),
    ]


def _count(name: str, some: Sequence[Outcome], how: str) -> Figure:
    return Figure(f"faults.{name}", float(len(some)), "faults", 0.0, bar_kind="at most", how=how)


def _operator(tally: Tally) -> list[Figure]:
    answered = [each.answered_s for each in tally.outcomes] or [np.nan]
    return [
        _count("operator_starved", [each for each in tally.outcomes if each.recovered_by_bag],
               "the scan ran again, as the bag shows, and the operator did not hear of it within "
               "30 s"),
        Figure("faults.operator_answer_s", float(np.max(answered)), "s", ANSWER_S,
               bar_kind="at most", how="longest wait for a service or a parameter, of all faults; "
               f"median {np.median(answered):.2f} s, longer than {ANSWER_S:g} s after "
               f"{sum(each > ANSWER_S for each in answered)} of them"),
    ]


def _messages(tally: Tally) -> list[Figure]:
    return [
        Figure("faults.messages_lost", float(tally.lost), "messages", 0.0, bar_kind="at most",
               how=f"of {tally.witnessed} that a second subscriber heard, not in the bag; a "
               "killed recorder, or one whose disk is full, may lose its last second"),
        Figure("faults.lost_at_kill", float(tally.lost_at_kill), "messages",
               how="of the same, published from 5 ms before their publisher was killed until it "
               "had ended"),
        Figure("faults.lost_while_paused", float(tally.lost_while_paused), "messages",
               how="of the same, published while the recorder itself was stopped (history: 2 s)"),
        Figure("faults.lost_of_seconds", float(tally.lost_of_seconds), "messages",
               how="of the same, published by a second node of a name before the recorder met it"),
    ]


def _orphans() -> int:
    deadline = time.monotonic() + GRACE_S
    while (left := len(_children())) and time.monotonic() < deadline:
        time.sleep(0.05)
    return left


def _children() -> list[str]:
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass  # orphans that have ended
    text = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text("utf-8")
    return [pid for pid in text.split() if "resource_tracker" not in _command(pid)]


def _command(pid: str) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text("utf-8", "replace")
    except OSError:
        return ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
