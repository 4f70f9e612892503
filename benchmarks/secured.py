"""The graph under SROS2, Enforce: it runs, it keeps others out; what security costs.

It needs a Fast DDS with DDS security and the commands `ros2` and `ros2 security`. Where they are
absent nothing is measured, and the one figure says so.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import loop
from benchmarks.composed import bare_sleep
from benchmarks.fault_scene import CONTROLLER
from benchmarks.figure import Figure
from benchmarks.private import run_module
from benchmarks.secured_checks import (
    ONCE,
    STARTS_S,
    Check,
    kept_out,
    lockstep_scan,
    make_keys,
    node_without_a_right,
    operators,
    real_time_scan,
    refused_a_right,
    secured,
    strangers,
    visited,
)
from dfm_stage.errors import DfmError
from dfm_stage.harness.domain import claim_domain
from dfm_stage.harness.stage_graph import LAYOUTS
from dfm_stage.middleware.security import built_without

RUNS = 3
TRIED = {250.0: ("no", "thrice"), 1000.0: ("no", "thrice", "once")}
"""By the rate, Hz, how often a message is protected: by the governance of `ros2 security` thrice,
by our own once."""
FULL_S, QUICK_S = 20.0, 4.0
COSTS = {"age_p50_ms": ("ms", "median age of a command at the amplifier"),
         "age_p99_ms": ("ms", "99 % of the ages within"),
         "cpu": ("% of a core", "all six processes together")}


def figures(quick: bool = False) -> list[Figure]:
    """Try the checks once, and measure the cost in turns, runs of 20 s (quick: 4 s)."""
    if why := _absent():
        return [Figure("secured.checks", math.nan, "checks", how=f"none was run: {why}")]
    with tempfile.TemporaryDirectory(prefix="dfm_secured_") as folder:
        answer = Path(folder) / "found.json"
        (work := Path(folder) / "work").mkdir()
        run_module("benchmarks.secured", [str(work), str(answer),
                                          str(QUICK_S if quick else FULL_S)], work)
        found = json.loads(answer.read_text("utf-8"))
    checks = [Check(*each) for each in found["checks"]]
    out = [Figure("secured.checks", float(sum(each.passed for each in checks)), "checks",
                  float(len(checks)), how="passed, of those below", bar_kind="at least")]
    out += [Figure(f"secured.{each.key}", float(each.passed), "1 = yes", 1.0, how=each.seen,
                   bar_kind="at least") for each in checks]
    return out + [each for rate_hz, kinds in TRIED.items() for kind in kinds if kind != "no"
                  for each in _costs(found["runs"], rate_hz, kind)]


def _absent() -> str:
    """Return in a line what this needs and there is not."""
    if built_without():
        return "the Fast DDS of this environment was built without DDS security"
    return "" if shutil.which("ros2") else "there is no ros2 command on the PATH"


def _costs(runs: list[dict[str, Any]], rate_hz: float, kind: str) -> list[Figure]:
    """What protection of a kind costs at a rate, beside none."""
    at = f"{rate_hz:g}hz" + ("_once" if kind == "once" else "")
    by_kind = {which: [each for each in runs if each["rate_hz"] == rate_hz
                       and each["protected"] == which] for which in (kind, "no")}
    tried, plain = by_kind[kind], by_kind["no"]
    out = []
    for name, (unit, what) in COSTS.items():
        values = [[each[name] for each in of if name in each] for of in (tried, plain)]
        with_, without = (float(np.median(each)) if each else math.nan for each in values)
        seen = "; ".join(f"{words}: " + ", ".join(f"{value:.3g}" for value in each)
                         for words, each in zip(("secured", "unsecured"), values, strict=True))
        out.append(Figure(f"secured.{name}_{at}", with_, unit, None, "unsecured, in turns",
                          without, with_ / without, f"{what}, median of runs ({seen})"))
    done = [each for each in tried if "error" not in each]
    said = "; ".join(each["error"] for each in tried if "error" in each)
    slept = "; ".join(f"{each['sleep_p99_ms']:.3f} ms at load {each['load']:.2f}"
                      for each in (*tried, *plain))
    return [*out,
            Figure(f"secured.scans_{at}", float(len(done)), "scans", float(len(tried)),
                   how=f"recorded, success, with {sum(each['lost'] for each in done):g} messages "
                   f"missing in their bags{'; ' * bool(said)}{said}", bar_kind="at least"),
            Figure(f"secured.sleep_p99_ms_{at}", max(
                each["sleep_p99_ms"] for each in (*tried, *plain)), "ms",
                   how="lateness of a bare sleep of 1 ms at the nodes' priority before each run, "
                   f"those without security last: {slept}")]


def main() -> None:
    """Try everything in a domain of its own; write what was found as JSON."""
    folder, answer, duration_s = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    with claim_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain.number)
        keys, other = make_keys(folder / "keys"), make_keys(folder / "other")
        once = make_keys(folder / "once", ONCE)
        checks = []
        for check in _checks(folder, keys, other, once, domain.number):
            print(f"{'ok    ' if check.passed else 'FAILED'} {check.key}: {check.seen}",
                  file=sys.stderr, flush=True)
            checks.append(check)
        by_kind = {"no": None, "thrice": keys, "once": once}
        runs = [_run(rate_hz, kind, by_kind[kind], domain.number, duration_s)
                for rate_hz, kinds in TRIED.items() for _ in range(RUNS) for kind in kinds]
    answer.write_text(json.dumps({
        "checks": [[each.key, each.passed, each.seen] for each in checks], "runs": runs}))


def _checks(folder: Path, keys: Path, other: Path, once: Path, domain_id: int
            ) -> Iterator[Check]:
    for layout in LAYOUTS:
        yield from lockstep_scan(keys, layout, folder / layout, domain_id, 2.0)
    yield node_without_a_right(keys)
    with secured(keys), visited(domain_id, folder / "bag") as graph:
        secret = strangers(graph, {"unsecured": ("stranger", None),
                                   "other_ca": ("controller", other)})
        yield from operators(graph, keys, folder)
        yield real_time_scan(graph)
    with secured(once), visited(domain_id) as graph:
        kept_once = strangers(graph, {"once_unsecured": ("stranger", None),
                                      "once_other_ca": ("controller", other)})
        yield from refused_a_right(graph, once, "once_")
    with secured(None), visited(domain_id) as graph:
        seen = strangers(graph, {"open": ("stranger", None)})
    for found in (secret, kept_once):
        yield from kept_out(found, seen["open"])


def _run(rate_hz: float, kind: str, keys: Path | None, domain_id: int, duration_s: float
         ) -> dict[str, Any]:
    out: dict[str, Any] = {"rate_hz": rate_hz, "protected": kind,
                           "sleep_p99_ms": bare_sleep(1000).p99, "load": os.getloadavg()[0]}
    with secured(keys):
        try:
            found = loop.measure(duration_s, "events", {"line_length_m": 1e-3}, rate_hz,
                                 domain_id=domain_id, start_timeout_s=STARTS_S,
                                 parameters={"controller": CONTROLLER})
        except DfmError as error:
            print(f"protected: {kind}: {error}", file=sys.stderr, flush=True)
            return {**out, "error": str(error)}
        out |= {"cpu": found["cpu"], "lost": found["lost"],
                "age_p50_ms": float(np.percentile(found["age"], 50)),
                "age_p99_ms": float(np.percentile(found["age"], 99))}
    print(json.dumps(out), file=sys.stderr, flush=True)
    return out


if __name__ == "__main__":
    main()
