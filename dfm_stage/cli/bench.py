"""./run bench [NAME ...]: run the benchmarks, print their figures, write them as JSON."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import difflib
import importlib
import inspect
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.cli.bench_report import table, write_page
from dfm_stage.cli.bench_runs import merged
from dfm_stage.cli.command import command_parser, option, paint
from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole
from dfm_stage.processors import usable_cores

ROOT = Path(__file__).resolve().parents[2]
STDERR = 2
PR_SET_PDEATHSIG = 1
EPILOG = """\
examples:
  ./run bench loop lockstep --json out/loop.json
  ./run bench loop --runs 5 --json out/loop.json
  ./run bench diagnose --cases 100 --seed 7 --resume --keep out/diagnose
  ./run bench real --data ~/records --keep out/real
  ./run bench --from out/loop.json --from out/all.json --page out/bench.html
"""
CASE_OPTIONS = (
    option("--cases", type=int, metavar="N", help="how many cases"),
    option("--seed", type=int, metavar="S", help="the seed they are drawn with"),
    option("--resume", action="store_true", help="keep the cases answered already"),
    option("--keep", type=Path, metavar="DIR", help="the folder of the answers"),
    option("--jobs", type=int, metavar="N", help="how many processes at once"),
)
RECORD_OPTIONS = (
    option("--data", type=Path, metavar="DIR", help="your copies of the records, a folder each"),
    option("--only", metavar="NAME", help="this record alone"),
)
OPTIONS = (
    option("names", nargs="*", metavar="NAME", help="which; all without a name"),
    option("--json", type=Path, metavar="FILE", help="write machine and figures"),
    option("--page", type=Path, metavar="FILE", help="write all of it as one page (.html)"),
    option("--from", dest="results", type=Path, action="append", default=[], metavar="FILE",
           help="measure nothing: take what --json wrote, and write the --page or print the "
           "table; of a figure that several files have, the median and the range"),
    option("--runs", type=int, default=1, metavar="N",
           help="run each N times in turn: a figure is the median, with its range"),
    option("--quick", action="store_true", help="shorter runs, rougher figures"),
    option("--list", action="store_true", help="print the names and stop"),
    ("for benchmarks of many cases (diagnose, diagnose_wide)", CASE_OPTIONS),
    ("for records that others measured (real)", RECORD_OPTIONS),
    option("--folder", type=Path, default=ROOT / "benchmarks", help=argparse.SUPPRESS),
    option("--child", nargs=2, help=argparse.SUPPRESS),
)


class BenchError(DfmError):
    """A benchmark that cannot be run as asked."""


def available(folder: Path) -> list[str]:
    """Names of the benchmarks in a folder: the modules that define `figures`."""
    return sorted(
        path.stem for path in folder.glob("*.py") if "\ndef figures(" in path.read_text("utf-8")
    )


def machine() -> dict[str, Any]:
    """What the figures depend on; nothing that names the machine or its folders."""
    return {
        "cpu": _cpu_model(),
        "cores": usable_cores(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "load_1min": os.getloadavg()[0],
    }


def _cpu_model() -> str:
    with contextlib.suppress(OSError):
        if found := re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8"),
                              re.MULTILINE):
            return found[1].strip()
    return platform.machine()


def run_one(name: str, folder: Path, quick: bool,
            extra: Mapping[str, Any] | None = None) -> list[dict[str, Any]]:
    """Figures of one benchmark, run in a process of its own: nothing of another is measured.

    `extra` are arguments of its `figures` beyond quick. Raises BenchError when it fails, however
    it fails.
    """
    with tempfile.TemporaryDirectory(prefix="dfm_stage_bench_") as scratch:
        answer = Path(scratch) / "figures.json"
        command = [sys.executable, "-m", "dfm_stage", "bench", "--child", str(answer),
                   str(os.getpid()), "--folder", str(folder),
                   *(["--quick"] if quick else []), name]
        for given, value in (extra or {}).items():
            command += [f"--{given}"] if value is True else [f"--{given}", str(value)]
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=STDERR) as child:
            try:
                code = child.wait()
            except BaseException:
                child.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(10)
                child.kill()
                raise
        if code != 0:
            raise BenchError(f"benchmark {name} failed ({'signal' if code < 0 else 'exit code'} "
                             f"{abs(code)}): its own message is above")
        return list(json.loads(answer.read_text("utf-8")))


def _end_with(parent: int) -> None:
    """Be interrupted when the process `parent`, which started this one, ends in whatever way."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT, 0, 0, 0)
    if os.getppid() != parent:
        raise KeyboardInterrupt


def _extra(options: argparse.Namespace) -> dict[str, Any]:
    """The options that only some benchmarks take, as far as they were given."""
    names = (flag.removeprefix("--") for (flag,), _ in (*CASE_OPTIONS, *RECORD_OPTIONS))
    return {name: value for name in names
            if (value := getattr(options, name)) not in (None, False)}


def _run_child(name: str, folder: Path, quick: bool, answer: Path, extra: dict[str, Any]) -> int:
    sys.path.insert(0, str(folder.parent))
    module = importlib.import_module(f"{folder.name}.{name}")
    taken = inspect.signature(module.figures).parameters
    for given in extra:
        if given not in taken:
            print(f"bench: benchmark {name} takes no --{given}: leave it out", file=sys.stderr)
            return 2
    answer.write_text(json.dumps(
        [figure.to_dict() for figure in module.figures(quick=quick, **extra)]), "utf-8")
    return 0


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(content, indent=1) + "\n")
    except OSError as error:
        raise BenchError(f"cannot write {path}: {error.strerror}: name another --json") from error


def _chosen(asked: Sequence[str], folder: Path) -> list[str]:
    names = available(folder)
    if not names:
        raise BenchError(f"no benchmarks in {folder}: run ./run bench in a checkout")
    for name in asked:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            raise BenchError(f"there is no benchmark {name!r}: " + (
                f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"))
    return list(dict.fromkeys(asked)) or names


def main(argv: Sequence[str] | None = None) -> int:
    """0 when every benchmark ran, 1 when one failed, 2 for a name or file that cannot be used."""
    options = command_parser(
        "bench", "Run the benchmarks; each figure stands beside its bar and its peer.", EPILOG,
        OPTIONS).parse_args(argv)
    for name in ("keep", "data"):
        if path := getattr(options, name):
            setattr(options, name, path.resolve())
    folder = options.folder.resolve()
    if options.child:
        answer, parent = options.child
        _end_with(int(parent))
        return _run_child(options.names[0], folder, options.quick, Path(answer),
                          _extra(options))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        if options.results:
            return _shown(_merged(options.results), options)
        names = _chosen(options.names, folder)
        if options.runs < 1:
            raise BenchError(f"--runs {options.runs}: give 1 or more")
        if options.list:
            print("\n".join(names))
            return 0
        return _run_all(names, folder, options)
    except DfmError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _merged(files: Sequence[Path]) -> dict[str, Any]:
    """Results of several files as one: of a figure measured twice, the median and the range."""
    reports = []
    for file in files:
        try:
            reports.append(json.loads(file.read_text("utf-8")))
            merged(reports[-1:])
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
            raise BenchError(f"{file}: not what bench --json writes ({error}): name such a file "
                             "with --from") from None
    return merged(reports)


def _blank(command: str) -> dict[str, Any]:
    """A report without figures: on which machine, when, by which command, of which commit."""
    today = datetime.now(timezone.utc).date().isoformat()
    out = {"machine": machine(), "measured": today, "commands": [command], "figures": [],
           "failed": []}
    with contextlib.suppress(OSError, subprocess.CalledProcessError):
        out["commit"] = subprocess.run(
            ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude=*"],
            capture_output=True, text=True, check=True).stdout.strip()
    return out


def _command(names: Sequence[str], options: argparse.Namespace) -> str:
    """How to repeat it; a folder of this machine is no part of it."""
    words = ["./run bench", *names, *(["--quick"] if options.quick else [])]
    words += [f"--{name} {value}" for name in ("cases", "seed", "only")
              if (value := getattr(options, name)) is not None]
    words += ["--data DIR"] if options.data else []
    return " ".join([*words, *([f"--runs {options.runs}"] if options.runs > 1 else [])])


def _run_all(names: Sequence[str], folder: Path, options: argparse.Namespace) -> int:
    reports: list[dict[str, Any]] = []
    todo = [(turn, name) for turn in range(options.runs) for name in names]
    for index, (turn, name) in enumerate(todo, start=1):
        if turn == len(reports):
            reports.append(_blank(_command(options.names, options)))
            if options.json:
                _write_json(options.json, merged(reports))
        print(f"[{index}/{len(todo)}] {name} ...", file=sys.stderr, flush=True)
        begin = time.monotonic()
        try:
            reports[-1]["figures"] += run_one(name, folder, options.quick, _extra(options))
        except BenchError as error:
            reports[-1]["failed"].append({"bench": name, "reason": str(error)})
            print(f"bench: {error}", file=sys.stderr)
        print(f"[{index}/{len(todo)}] {name}: {time.monotonic() - begin:.1f} s", file=sys.stderr)
        if options.json:
            _write_json(options.json, merged(reports))
    return _shown(merged(reports), options)


def _shown(report: Mapping[str, Any], options: argparse.Namespace) -> int:
    """Print the table, and write the page if asked; 1 when a benchmark failed."""
    if options.page:
        options.page.parent.mkdir(parents=True, exist_ok=True)
        write_page(report["figures"], options.page, report["machine"], report["failed"],
                   report["commands"])
    print(table(report["figures"]))
    judged = [figure["met"] for figure in report["figures"] if figure["met"] is not None]
    facts, failed = report["machine"], len(report["failed"])
    print(f"\n{len(report['figures'])} figures,",
          paint(f"{sum(judged)} of {len(judged)} bars met", "good" if all(judged) else "warn")
          + f", {failed} benchmark{'' if failed == 1 else 's'} failed")
    if facts:
        print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_1min']:.2f} at the "
              "start")
    if options.page:
        print(f"page: {options.page}")
    return 1 if report["failed"] else 0

