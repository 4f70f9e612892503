"""Every test session alone: its own ROS domain, its own folders, and no process left behind."""

from __future__ import annotations

import ctypes
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from html import unescape
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from dfm_stage.harness.domain import Domain, claim_domain
from dfm_stage.middleware.discovery import keep_to_this_machine

pytest_plugins = ["pytest_dfm_stage"]
GRACE_S = 3.0
PR_SET_CHILD_SUBREAPER = 36
HELPERS_THAT_MAY_STAY = (b"multiprocessing.resource_tracker", b"multiprocessing.forkserver",
                         b"dfm_stage.harness.fork_server")
DESK, WIDTH_USED = 1200, 0.9
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chromium-headless-shell")
PROBE = """<body><iframe src="page.html" width="390" height="900"></iframe>
<iframe src="page.html" width="1440" height="900"></iframe><script>
SCRIPT
window.onload = () => {
  const found = [...document.querySelectorAll("iframe")].map(seen);
  document.body.innerHTML = "<pre></pre>";
  document.querySelector("pre").textContent = JSON.stringify(found);
};</script></body>"""
LAYOUT = """
const light = colour => { const [r, g, b] = colour.match(/[0-9.]+/g).map(Number);
                          return 0.3 * r + 0.6 * g + 0.1 * b; };
const seen = frame => {
  const page = frame.contentDocument, all = [...page.querySelectorAll(".plot svg")];
  const shown = all.filter(e => e.getClientRects().length);
  const texts = shown.map(e => [e.getBoundingClientRect(), [...e.querySelectorAll("text")]]);
  const style = frame.contentWindow.getComputedStyle(page.body);
  return {
    width: page.documentElement.clientWidth, content: page.documentElement.scrollWidth,
    figures: page.querySelectorAll("figure").length, shown: shown.length,
    plots: shown.map(e => [e.getBoundingClientRect().width, e.getBoundingClientRect().height]),
    empty: shown.filter(e => e.querySelectorAll("path, use").length < 4).length,
    text: shown.length ? Math.min(...texts.flatMap(([_, each]) =>
      each.map(t => t.getBoundingClientRect().height))) : null,
    outside: texts.flatMap(([box, each]) => each.filter(t =>
      t.getBoundingClientRect().right > box.right + 2
      || t.getBoundingClientRect().left < box.left - 2).map(t => t.textContent)),
    ink: light(style.color), paper: light(style.backgroundColor),
    foot: page.querySelectorAll("footer dd").length,
    beside: [...page.querySelectorAll(".with-figure")].map(row => {
      const box = chosen => row.querySelector(chosen)?.getBoundingClientRect();
      const plot = box(".drawn"), aside = box("details") || box(".before") || box(".after");
      return aside ? aside.left >= plot.right : null; }),
    contents: (nav => nav && nav.getBoundingClientRect().right
      <= page.querySelector("main").getBoundingClientRect().left)(page.querySelector("nav")),
    used: Math.max(...[...page.querySelectorAll(".with-figure > *, .with-figure figure > *")]
      .map(e => e.getBoundingClientRect().right)) / page.documentElement.clientWidth,
  };
};"""
DOMAIN = pytest.StashKey[Domain]()
FOLDER = pytest.StashKey[Path]()

hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("repeatable")


def pytest_configure(config: pytest.Config) -> None:
    """Isolate before any test module, and with it ROS, is imported."""
    from pytest_dfm_stage import REACHING_OUT

    domain, folder = claim_domain(), Path(tempfile.mkdtemp(prefix="dfm_stage_test_"))
    config.stash[DOMAIN], config.stash[FOLDER] = domain, folder
    for name in REACHING_OUT:
        os.environ.pop(name, None)
    os.environ.update(
        ROS_DOMAIN_ID=str(domain.number),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        ROS_PYTHON_CHECK_FIELDS="1",
        ROS_HOME=str(folder / "ros"),
        ROS_LOG_DIR=str(folder / "log"),
        MPLBACKEND="Agg",
    )
    keep_to_this_machine()  # anew: the profile was taken out with the rest
    # worker processes of pytest-xdist ignore it, and what a test starts would inherit that
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # orphans of processes that a test started become ours, so that they are seen
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Give the domain back and remove the session's folders."""
    if DOMAIN in config.stash:
        config.stash[DOMAIN].release()
        shutil.rmtree(config.stash[FOLDER], ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give a test against the clock two more chances, which the report counts as reruns; leave
    slow ones to those who ask for them. Files with slow tests come first and those that need the
    machine alone last: nobody then waits for a long test of another process to end."""
    skip = pytest.mark.skip(reason="slow: set DFM_SLOW=1, as .ci/run does")
    for item in items:
        if item.get_closest_marker("slow") and not os.environ.get("DFM_SLOW"):
            item.add_marker(skip)
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=3))
    alone = {item.path for item in items if item.get_closest_marker("real_time")}
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path in alone, item.path not in slow))


@pytest.fixture(scope="session")
def browse(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[Any]]:
    """Open a page in a headless browser, at the width of a phone and of a desk, and return what
    the script's function `seen(frame)` gives for each.

    Where there is no browser the test that asks for it is skipped, and says so.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)

    def browsed(page: Path, script: str, *, dark: bool = False) -> list[Any]:
        if browser is None:
            pytest.skip("no Chromium here to open the page in (requirements/system.txt)")
        folder = tmp_path_factory.mktemp("browser")
        shutil.copy(page, folder / "page.html")
        (folder / "probe.html").write_text(PROBE.replace("SCRIPT", script), encoding="utf-8")
        scheme = ["--blink-settings=preferredColorScheme=0"] if dark else []
        done = subprocess.run(
            [browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom", *scheme,
             f"--user-data-dir={folder / 'profile'}", "--allow-file-access-from-files",
             "--enable-logging=stderr", "--window-size=1600,1000",
             (folder / "probe.html").as_uri()],
            capture_output=True, text=True, timeout=120, check=True)
        said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
        assert not said
        found = re.search(r"<pre>(.*?)</pre>", done.stdout, re.DOTALL)
        assert found, done.stdout[:2000]
        return list(json.loads(unescape(found[1])))

    return browsed


@pytest.fixture(scope="session")
def opens_well(browse: Callable[..., list[Any]]) -> Callable[..., None]:
    """Judge the layout of a page in a browser, on a phone and on a desk."""

    def judge(page: Path, *, dark: bool = False) -> None:
        for seen in browse(page, LAYOUT, dark=dark):
            assert seen["content"] <= seen["width"], "the page is wider than the window"
            assert seen["shown"] == seen["figures"], "a figure is not shown once"
            for width, height in seen["plots"]:
                assert width > 0.6 * min(seen["width"], 960)
                assert height > 60
            assert seen["empty"] == 0, "a plot has no lines in it"
            assert seen["outside"] == [], "text sticks out of a plot"
            assert seen["text"] is None or seen["text"] > 9, "text too small to read"
            assert (seen["paper"] < 128 < seen["ink"]) if dark else (
                seen["ink"] < 128 < seen["paper"])
            assert seen["foot"], "no provenance"
            desk = seen["width"] > DESK
            assert all(each in (None, desk) for each in seen["beside"]), (
                "tables do not stand beside their figures on a desk alone")
            assert seen["contents"] in (None, desk), "contents are not beside the page on a desk"
            assert not desk or seen["used"] is None or seen["used"] > WIDTH_USED, (
                "the width of a desk is empty")

    return judge


@pytest.fixture
def ros() -> Iterator[Callable[[], Any]]:
    """Make ROS contexts as a node process does; they leave with the test.

    One that `rclpy.init` makes alone writes into shared memory, and so do those that the next
    tests make in this process.
    """
    import rclpy

    from dfm_stage.middleware.discovery import loopback_alone

    made: list[Any] = []

    def begin() -> Any:
        made.append(rclpy.Context())
        with loopback_alone():
            rclpy.init(context=made[-1], args=[])
        return made[-1]

    yield begin
    for context in made:
        context.try_shutdown()
        context.destroy()


@pytest.fixture(autouse=True)
def no_process_left_behind() -> Iterator[None]:
    """Fail a test that leaves a running process behind, and end that process."""
    before = running_children()
    yield
    deadline = time.monotonic() + GRACE_S
    while (left := running_children().keys() - before.keys()) and time.monotonic() < deadline:
        time.sleep(0.02)
    if left:
        names = running_children()
        for pid, _ in left:
            end_process_tree(pid)
        commands = "; ".join(names.get(process, "?") for process in sorted(left))
        pytest.fail(f"left {len(left)} process(es) running: {commands}", pytrace=False)


def running_children() -> dict[tuple[int, str], str]:
    """Command lines of this process's children that still run, by process id and start time."""
    found = {}
    for entry in Path("/proc/self/task").glob("*/children"):
        for pid in map(int, _read(entry).split()):
            # after the name in brackets: state, parent, ..., start time (proc(5), fields 3 to 22)
            fields = _read(Path(f"/proc/{pid}/stat")).rpartition(b")")[2].split()
            command = _read(Path(f"/proc/{pid}/cmdline")).replace(b"\0", b" ").strip()
            if not fields or fields[0] in (b"Z", b"X"):
                continue
            if not any(helper in command for helper in HELPERS_THAT_MAY_STAY):
                found[pid, fields[19].decode()] = command.decode(errors="replace")
    return found


def end_process_tree(pid: int) -> None:
    """Kill a process and its descendants."""
    for entry in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, _read(entry).split()):
            end_process_tree(child)
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""
