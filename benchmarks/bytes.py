"""A million spoilt inputs: each ends in a value or in one line, in bounded time and memory.

What is read from outside is in `bytes_targets`: a table of formats with seeds, mutator and call.
Blocks of inputs run in processes of their own, `bytes_worker`. Whatever ends wrongly is kept as a
file: an error that is none of ours, an output that moved, a process that died or hung.

    ./run bench bytes --cases 1000000 --seed 1 --resume --keep out/bytes
    ./run exec python -m benchmarks.bytes TARGET SEED NUMBER FILE     # writes one input again
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.bytes_targets import ROOT, TARGETS, input_of
from benchmarks.bytes_worker import ROOM_BYTES, SLOW_S, Slot, keep, tally_in
from benchmarks.figure import Figure

FULL, QUICK, SEED = 1_000_000, 3_000, 1
KEEP = ROOT / ".dfm" / "bench" / "bytes"
BLOCK = 10_000
HANG_S = 60.0
"""Wall time of one input after which its process is killed: a busy machine is slow."""
LARGEST_MIB = 1024.0
POLL_S = 0.2


@dataclass
class Block:
    """Inputs `first` to `end` of a target; where its process is, if it has one."""

    target: str
    seed: int
    first: int
    end: int
    folder: Path
    process: subprocess.Popen[bytes] | None = None
    moved: tuple[float, float] = field(default=(-1.0, 0.0))

    @property
    def tally_path(self) -> Path:
        """The file of its tally."""
        return self.folder / f"{self.target}_{self.first}.tally"

    def start(self) -> None:
        """Start or go on."""
        self.moved = (-1.0, time.monotonic())
        tally_in(self.tally_path)       # it is there before two processes look at it
        self.process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.bytes_worker", self.target, str(self.seed),
             str(self.first), str(self.end - self.first), str(self.tally_path),
             str(self.folder / "found")], cwd=ROOT, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)

    def finished(self) -> bool:
        """Whether all is done; a process that died or hangs is noted and another started."""
        assert self.process is not None
        code = self.process.poll()
        tally = tally_in(self.tally_path)
        number = max(int(tally[Slot.NEXT]), self.first)
        if code is None:
            if number != self.moved[0]:
                self.moved = (number, time.monotonic())
            elif time.monotonic() - self.moved[1] > HANG_S:
                self.process.kill()
                self.process.wait()
                self._lost(number, "hung", f"no end after {HANG_S:g} s")
            return False
        if number >= self.end:
            return True
        self._lost(number, f"died with {code}", f"exit code {code}")
        return False

    def _lost(self, number: int, what: str, details: str) -> None:
        tally = tally_in(self.tally_path)
        keep(self.folder / "found", self.target, number,
             input_of(TARGETS[self.target], self.seed, number), what, details)
        tally[Slot.FINDINGS] += 1
        tally[Slot.NEXT] = number + 1
        self.start()


def blocks(total: int, seed: int, folder: Path) -> Iterator[Block]:
    """The blocks of a run; what stops early has seen every target."""
    counts = {target.name: max(1, total * target.share // 1000) for target in TARGETS.values()}
    for first in range(0, max(counts.values()), BLOCK):
        for name, count in counts.items():
            if first < count:
                yield Block(name, seed, first, min(first + BLOCK, count), folder)


def run(total: int, seed: int, folder: Path, jobs: int) -> None:
    """Run what of the blocks is not done; tallies and findings are left in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    todo = [block for block in blocks(total, seed, folder)
            if not block.tally_path.exists() or tally_in(block.tally_path)[Slot.NEXT] < block.end]
    running: list[Block] = []
    try:
        while todo or running:
            while todo and len(running) < jobs:
                running.append(todo.pop(0))
                running[-1].start()
            time.sleep(POLL_S)
            for block in [each for each in running if each.finished()]:
                running.remove(block)
                print(f"{block.target} to {block.end}: {len(todo) + len(running)} blocks left",
                      file=sys.stderr, flush=True)
    finally:
        for block in running:
            if block.process is not None:
                block.process.kill()
                block.process.wait()


def rows(total: int, seed: int, folder: Path) -> list[dict[str, Any]]:
    """What became of each target's inputs."""
    found: dict[str, dict[str, Any]] = {}
    for block in blocks(total, seed, folder):
        tally = tally_in(block.tally_path)
        row = found.setdefault(block.target, {
            "target": block.target, "inputs": 0, "values": 0, "refusals": 0, "findings": 0,
            "processor_s": 0.0, "slowest_s": 0.0, "slowest": 0, "peak_mib": 0.0, "peak": 0})
        row["inputs"] += int(tally[[Slot.VALUES, Slot.REFUSALS, Slot.FINDINGS]].sum())
        row["values"] += int(tally[Slot.VALUES])
        row["refusals"] += int(tally[Slot.REFUSALS])
        row["findings"] += int(tally[Slot.FINDINGS])
        row["processor_s"] += float(tally[Slot.SECONDS])
        for largest, where in ((Slot.SLOWEST_S, Slot.SLOWEST), (Slot.PEAK_MIB, Slot.PEAK)):
            if tally[largest] > row[largest.name.lower()]:
                row[largest.name.lower()] = round(float(tally[largest]), 3)
                row[where.name.lower()] = int(tally[where])
    return [{**row, "processor_s": round(row["processor_s"], 1)} for row in found.values()]


def kinds_of_findings(folder: Path) -> list[str]:
    """The findings that were kept, in words."""
    return sorted(f"{path.parent.name}: {path.name}" for path in (folder / "found").glob("*/*"))


def figures(quick: bool = False, *, cases: int | None = None, seed: int = SEED,
            resume: bool = False, keep: Path | None = None,
            jobs: int | None = None) -> list[Figure]:
    """Run a million inputs (quick: 3000, or `cases`) and count the ends.

    `keep` is the folder of tallies and findings. With `resume` blocks that are done there are not
    run again. `result.json` there has a row for each target.
    """
    total = cases or (QUICK if quick else FULL)
    folder = (keep or KEEP) / f"seed_{seed}_{total}"
    if not resume:
        for path in folder.glob("*.tally"):
            path.unlink()
    run(total, seed, folder, jobs or len(os.sched_getaffinity(0)))
    table = rows(total, seed, folder)
    kinds = kinds_of_findings(folder)
    (folder / "result.json").write_text(json.dumps(
        {"seed": seed, "targets": table, "kinds_of_findings": kinds}, indent=1) + "\n", "utf-8")
    for row in table:
        print(" ".join(f"{key} {value}" for key, value in row.items()), file=sys.stderr)
    slowest = max(table, key=lambda row: row["slowest_s"])
    largest = max(table, key=lambda row: row["peak_mib"])
    count = sum(row["inputs"] for row in table)
    how = f"{count} inputs of {len(table)} targets, seed {seed}"
    return [
        Figure("bytes.inputs", float(count), "inputs", how=how + "; "
               f"{sum(row['values'] for row in table)} ended in a value, "
               f"{sum(row['refusals'] for row in table)} in one line"),
        Figure("bytes.findings", float(sum(row["findings"] for row in table)), "inputs", 0.0,
               bar_kind="at most", how="raised something else, moved an output, died, hung or "
               f"took too long{': ' if kinds else ''}{'; '.join(kinds)}"),
        Figure("bytes.slowest_s", slowest["slowest_s"], "s", SLOW_S, bar_kind="at most",
               how=f"processor time of one input: {slowest['target']} {slowest['slowest']}"),
        Figure("bytes.peak_mib", largest["peak_mib"], "MiB", LARGEST_MIB, bar_kind="at most",
               how="most memory that inputs of one process took beyond what it has when warm: "
               f"{largest['target']} {largest['peak']}; address space limited to "
               f"{ROOM_BYTES / 2**30:g} GiB more"),
    ]


def main(arguments: Sequence[str]) -> int:
    """Write one input as a file again."""
    target, seed, number, path = arguments
    Path(path).write_bytes(input_of(TARGETS[target], int(seed), int(number)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
