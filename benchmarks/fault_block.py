"""A block of faults in a process of its own, and where permitted with a /dev/shm of its own.

What a fault leaves in shared memory ends with the block, and a full one is nobody else's.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.fault_campaign import Campaign
from benchmarks.fault_kinds import FAKETIME_FILE, KINDS, faketime
from benchmarks.fault_ledger import CLOCK_AHEAD_S
from benchmarks.fault_outcome import Fault, Tally
from benchmarks.private import run_module
from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole

PR_SET_PDEATHSIG = 1


def run_block(faults: Sequence[Fault], answer: Path) -> Tally:
    """Suffer faults in a process of its own; return their tally, which is in the file `answer`.

    Raises
    ------
    DfmError
        If the process fails.
    """
    with tempfile.TemporaryDirectory(prefix="dfm_faults_") as folder:
        asked = Path(folder) / "faults.json"
        asked.write_text(json.dumps([vars(fault) for fault in faults]), "utf-8")
        bags = Path(folder) / "bags"
        bags.mkdir()
        run_module("benchmarks.fault_block", [str(asked), str(bags), str(answer)], bags)
    if (tally := kept(faults, answer)) is None:
        raise DfmError(f"{answer} is not the outcome of the faults that were asked for")
    return tally


def kept(faults: Sequence[Fault], answer: Path) -> Tally | None:
    """Return the tally of these very faults from the file `answer`, or None."""
    try:
        tally = Tally.from_dict(json.loads(answer.read_text("utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return tally if [each.fault for each in tally.outcomes] == [*faults] else None


def _faked_clock(folder: Path) -> dict[str, str]:
    """Return the environment in which children, not this process, have a clock that a file sets.

    Their monotonic clock stays, as it does where the clock of a machine is set. They look at the
    file once a second each, so they do not agree for as long as that.
    """
    file = folder / "clock"
    file.write_text(f"{CLOCK_AHEAD_S:+g}\n", "ascii")
    return {"LD_PRELOAD": str(faketime()), FAKETIME_FILE: str(file),
            "FAKETIME_CACHE_DURATION": "1", "DONT_FAKE_MONOTONIC": "1", "NO_FAKE_STAT": "1"}


def main() -> int:
    """Suffer the faults of a file, with bags in a folder, and write the tally to a third."""
    parser = argparse.ArgumentParser()
    for name in ("faults", "bags", "answer"):
        parser.add_argument(name, type=Path)
    given = parser.parse_args()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT, 0, 0, 0)  # end with who asked
    faults = [Fault(**each) for each in json.loads(given.faults.read_text("utf-8"))]
    faked = any(KINDS[fault.kind].faked_clock for fault in faults)
    if faked:
        os.environ.update(_faked_clock(given.bags))
    try:
        tally = Campaign(given.bags, CLOCK_AHEAD_S if faked else 0.0).run(faults)
    except KeyboardInterrupt:
        return 130
    write_whole(given.answer, json.dumps(tally.to_dict(), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
