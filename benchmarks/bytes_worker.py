"""A process that gives one target its inputs: bounded in memory, watched in time from outside.

    python -m benchmarks.bytes_worker TARGET SEED FIRST COUNT TALLY FOUND

TALLY is an array in a file, which stays true when the process dies; FOUND is the folder of the
inputs that ended wrongly, with what was said.
"""

from __future__ import annotations

import os
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from enum import IntEnum
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.bytes_targets import TARGETS, Target, fault_in, input_of
from dfm_stage.errors import DfmError

ROOM_BYTES = 5 << 29
"""Address space that a process may add to what it has after its imports."""
SLOW_S = 5.0
"""Processor time of one input that counts as a finding."""
KEPT_EACH = 3
"""Inputs kept of findings that look the same, in one process."""
WARM = 20
"""First inputs of a process, whose time and memory do not count: what is compiled and imported
then is not theirs."""


class Slot(IntEnum):
    """Places in the tally."""

    NEXT, VALUES, REFUSALS, FINDINGS, SECONDS, SLOWEST_S, SLOWEST, PEAK_MIB, PEAK = range(9)


def tally_in(path: Path) -> NDArray[np.float64]:
    """The tally in a file, made where there is none."""
    mode: Literal["r+", "w+"] = "r+" if path.exists() else "w+"
    return np.memmap(path, np.float64, mode, shape=(len(Slot),))


def ending_of(target: Target, data: bytes, path: Path) -> tuple[bool, str, str]:
    """Run one input: (whether it was refused, finding, details); no finding is an empty one."""
    if target.file:
        path.write_bytes(data)
    try:
        target.call(data, path)
    except DfmError as error:
        fault = fault_in(error)
        return True, f"{type(error).__name__} {fault}" if fault else "", str(error)[:2000]
    except Exception as error:  # noqa: BLE001 that is what is looked for
        frames = traceback.extract_tb(error.__traceback__)
        ours = [each for each in frames if "/dfm_stage/" in each.filename]
        at = (ours or frames)[-1]
        return False, f"{type(error).__name__} in {Path(at.filename).stem}.{at.name}", \
            traceback.format_exc(limit=-12)
    return False, "", ""


def keep(found: Path, target: str, number: int, data: bytes, what: str, details: str) -> None:
    """Keep an input that ended wrongly."""
    folder = found / target / re.sub(r"[^\w. -]+", "_", what)[:80]
    folder.mkdir(parents=True, exist_ok=True)
    if len(list(folder.glob("*.bin"))) < KEPT_EACH:
        (folder / f"{number}.bin").write_bytes(data)
        (folder / f"{number}.txt").write_text(details, "utf-8", "backslashreplace")


def _bound_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[0])
    limit = pages * resource.getpagesize() + ROOM_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _resident_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(name: str, seed: int, first: int, end: int, tally: NDArray[np.float64],
        found: Path) -> None:
    """Give a target the inputs from the tally's next one to `end`."""
    target = TARGETS[name]
    warnings.simplefilter("ignore")
    _bound_memory()
    baseline, warm, parent = 0.0, WARM, os.getppid()
    with tempfile.TemporaryDirectory(prefix="dfm_bytes_") as folder:
        path = Path(folder) / target.file
        for number in range(max(first, int(tally[Slot.NEXT])), end):
            if os.getppid() != parent:      # nobody is left who would read the tally
                return
            data = input_of(target, seed, number)
            tally[Slot.NEXT] = number
            begun = time.process_time()
            refused, what, details = ending_of(target, data, path)
            took = time.process_time() - begun
            warm -= 1
            if took > SLOW_S and not what and warm < 0:
                what, details = "slow", f"{took:.1f} s of processor time"
            if what:
                keep(found, name, number, data, what, details)
            tally[Slot.FINDINGS if what else Slot.REFUSALS if refused else Slot.VALUES] += 1
            tally[Slot.SECONDS] += took
            if warm < 0:
                _note_largest(tally, number, took, _resident_mib() - baseline)
            else:
                baseline = _resident_mib()
        tally[Slot.NEXT] = end


def _note_largest(tally: NDArray[np.float64], number: int, took_s: float, peak_mib: float) -> None:
    if took_s > tally[Slot.SLOWEST_S]:
        tally[Slot.SLOWEST_S], tally[Slot.SLOWEST] = took_s, number
    if peak_mib > tally[Slot.PEAK_MIB]:
        tally[Slot.PEAK_MIB], tally[Slot.PEAK] = peak_mib, number


if __name__ == "__main__":
    given, seed_text, first_text, count_text, tally_path, found_path = sys.argv[1:]
    run(given, int(seed_text), int(first_text), int(first_text) + int(count_text),
        tally_in(Path(tally_path)), Path(found_path))
