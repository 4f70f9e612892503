"""Killed, stopped and restarted nodes during a scan: safe, explained, recovered, nothing lost."""

from __future__ import annotations

import ctypes
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.fault_campaign import Campaign, draw
from benchmarks.fault_sight import TRAVEL_M
from benchmarks.figure import Figure

FULL, QUICK, SEED = 200, 20, 1
PR_SET_CHILD_SUBREAPER = 36
GRACE_S = 3.0


def figures(quick: bool = False, cases: int | None = None, seed: int = SEED) -> list[Figure]:
    """Measure 200 faults (quick: 20, or `cases`), drawn with `seed`."""
    count = cases or (QUICK if quick else FULL)
    # orphans of a killed node would become children of this process, and so be seen
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    with tempfile.TemporaryDirectory(prefix="dfm_faults_") as folder:
        tally = Campaign(Path(folder)).run(draw(count, seed))
    left = _processes_left()
    outcomes = tally.outcomes
    unsafe = [each for each in outcomes if not each.safe]
    silent = [each for each in outcomes if each.explained is False]
    gone = [each for each in outcomes if not each.recovered]
    for title, some in (("unsafe", unsafe), ("unexplained", silent), ("not recovered", gone)):
        for each in some:
            print(f"{title}: {each.fault}: {each.words}")
    for words in tally.lost_words:
        print(f"lost: {words}")
    took = np.array([each.took_s for each in outcomes if each.recovered] or [np.nan])
    safe = [each.safe_s for each in outcomes if each.safe] or [np.nan]
    cut = sum(each.cut for each in outcomes)
    how = (f"of {len(outcomes)} faults (SIGKILL, SIGSTOP for 0.05 to 2 s, restart; each node in "
           f"turn, seed {seed}) during a raster at 1 kHz in six processes; {cut} of them stopped "
           f"the loop; repeated, as the witness itself heard nothing any more: {tally.deaf}")
    return [
        Figure("faults.count", float(len(outcomes)), "faults", None, how=how),
        Figure("faults.unsafe", float(len(unsafe)), "faults", 0.0, bar_kind="at most",
               how="the output was neither at zero nor under control 3 s later, or the travel "
               f"was passed; median {np.median(safe):.2f} s until it was, worst "
               f"{np.max(safe):.2f}; seen in the bag alone, the witness being behind: "
               f"{sum(each.by_bag for each in outcomes)}"),
        Figure("faults.travel_mm", 1e3 * tally.travelled, "mm", 1e3 * TRAVEL_M,
               bar_kind="at most", how="furthest in all bags, also while it was repaired"),
        Figure("faults.unexplained", float(len(silent)), "faults", 0.0, bar_kind="at most",
               how="a node was gone or the output cut, and diagnostics did not say why"),
        Figure("faults.not_recovered", float(len(gone)), "faults", 0.0, bar_kind="at most",
               how="the scan did not run again after starting the node, clear, arm, start"),
        Figure("faults.operator_starved", float(sum(each.recovered_by_bag for each in outcomes)),
               "faults", 0.0, bar_kind="at most", how="the scan ran again, as the bag shows, and "
               "the operator did not hear of it within 30 s"),
        Figure("faults.recovery_s", float(np.median(took)), "s", None,
               how=f"start of the node to scan at work, median; worst {np.max(took):.2f}"),
        Figure("faults.processes_left", float(left), "processes", 0.0, bar_kind="at most",
               how="after the graph was closed"),
        Figure("faults.messages_lost", float(tally.lost), "messages", 0.0, bar_kind="at most",
               how=f"of {tally.witnessed} that a second subscriber heard, not in the bag; a "
               "killed recorder may lose its last second"),
        Figure("faults.lost_while_paused", float(tally.lost_while_paused), "messages",
               how="of the same, published while the recorder itself was stopped (history: 2 s)"),
    ]


def _processes_left() -> int:
    deadline = time.monotonic() + GRACE_S
    while (left := len(_children())) and time.monotonic() < deadline:
        time.sleep(0.05)
    return left


def _children() -> list[str]:
    text = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text("utf-8")
    return [pid for pid in text.split() if "resource_tracker" not in _command(pid)]


def _command(pid: str) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text("utf-8", "replace")
    except OSError:
        return ""
