"""The live view beside a running graph: frames, buttons, who is let in, the page itself."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from dfm_stage.harness import StageGraph

MOVE = {"name": "move", "mode": "pid", "duration_s": 3.0, "axes": {"x": {
    "reference": {"kind": "sine", "amplitude_m": 1e-3, "frequency_hz": 2.0}}}}


class Looker(threading.Thread):
    """Collects what the page would get, and sends what its buttons would."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self._url = url.replace("http", "ws") + "live"
        self._wishes: list[dict[str, Any]] = []
        self._ending = False
        self.frames: list[dict[str, Any]] = []
        self.answers: list[str] = []
        self.start()

    def wish(self, **what: Any) -> None:
        self._wishes.append(what)

    def end(self) -> None:
        self._ending = True
        self.join()

    def run(self) -> None:
        asyncio.run(self._look())

    async def _look(self) -> None:
        socket = await websocket_connect(self._url)
        while not self._ending:
            while self._wishes:
                await socket.write_message(json.dumps(self._wishes.pop(0)))
            frame = json.loads(await socket.read_message() or "{}")
            if "axes" in frame:
                self.frames.append(frame)
            elif "answer" in frame:
                self.answers.append(frame["answer"])
        socket.close()

    def axis(self) -> dict[str, Any]:
        return dict(self.frames[-1]["axes"].get("/stage/x", {})) if self.frames else {}


@pytest.fixture(scope="module")
def view() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    with subprocess.Popen([sys.executable, "-m", "dfm_stage", "view", "--port", "0"],
                          stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = re.match(r"(http://127\.0\.0\.1:\d+/) ", process.stdout.readline())
            assert found
            yield found[1], process
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 130


def fetch(url: str, host: str | None = None) -> tuple[int, str]:
    request = urllib.request.Request(url, headers={"Host": host} if host else {})  # noqa: S310
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:  # noqa: S310
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, ""


def test_everything_the_page_needs_is_served_and_nothing_else(
        view: tuple[str, subprocess.Popen[str]]) -> None:
    url, _ = view
    code, page = fetch(url)
    assert code == 200
    for name in re.findall(r'(?:href|src)="([\w.-]+)"', page):
        assert fetch(url + name)[0] == 200, name
    assert fetch(url + "server.py")[0] == 404
    assert fetch(url + "..%2fserver.py")[0] == 404
    assert "http" not in re.sub(r"http://www.w3.org\S*", "", page)


def test_only_this_machine_under_its_own_name_is_let_in(
        view: tuple[str, subprocess.Popen[str]]) -> None:
    url, _ = view
    assert fetch(url, host="stage.example.org")[0] == 403

    async def from_elsewhere(**headers: str) -> None:
        await websocket_connect(HTTPRequest(url.replace("http", "ws") + "live", headers=headers))

    for headers in ({"Origin": "http://stage.example.org"},
                    {"Origin": "http://stage.example.org", "Host": "stage.example.org"}):
        with pytest.raises(HTTPClientError, match="403"):
            asyncio.run(from_elsewhere(**headers))


def test_frames_and_buttons(view: tuple[str, subprocess.Popen[str]], tmp_path: Path) -> None:
    url, _ = view
    looker = Looker(url)
    with StageGraph(composed=True, lockstep=True, domain_id=int(os.environ["ROS_DOMAIN_ID"]),
                    bag=tmp_path / "bag") as graph:
        graph.spin_until(lambda: "/stage/x" in (looker.frames or [{"axes": {}}])[-1]["axes"],
                         20.0, "the axis on the page")
        graph.run(MOVE)
        graph.spin(1.5)
        assert looker.axis()["enabled"] is True
        assert looker.axis()["faults"] == []
        looker.wish(do="disarm", axes=["/stage/x"])
        graph.spin_until(lambda: bool(looker.answers), 10.0, "an answer")
        assert looker.answers[0].startswith("/stage/x/amplifier_driver/disarm: ")
        looker.wish(do="format", axes=["/stage/x"])
        looker.wish(do="arm", axes=["/stage/x"])
        graph.spin_until(lambda: len(looker.answers) > 1, 10.0, "a second answer")
        assert "arm: armed" in looker.answers[1]
        names = {node["name"] for node in looker.frames[-1]["nodes"]}
        assert {"/stage/x/controller", "/stage/sim_plant"} <= names
    looker.end()
    record = graph.record()
    axis = record.axis()
    rows = [row for frame in looker.frames for row in frame["axes"].get("/stage/x", {})
            .get("rows", [])]
    assert len(rows) > 100
    sample = {round(t, 6): k for k, t in enumerate(record.time)}
    known = [(sample[round(t, 6)], *row) for t, *row in rows if round(t, 6) in sample]
    assert len(known) > 100
    assert axis.reference is not None
    for k, position, reference, volts, _ in known:
        assert position == axis.position[k]
        assert reference in (None, axis.reference[k])
        assert volts in (None, axis.input[k])
    assert sum(reference is not None for _, _, reference, _, _ in known) > 100


def test_a_port_that_is_taken_is_one_line(view: tuple[str, subprocess.Popen[str]]) -> None:
    port = view[0].rstrip("/").rpartition(":")[2]
    done = subprocess.run([sys.executable, "-m", "dfm_stage", "view", "--port", port],
                          capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "--port" in done.stderr


def test_the_page_in_a_browser(view: tuple[str, subprocess.Popen[str]], tmp_path: Path) -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser",
                                                   "google-chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium here to open the live view in (requirements/system.txt)")
    shot = tmp_path / "view.png"
    done = subprocess.run(
        [browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
         f"--user-data-dir={tmp_path / 'profile'}", "--window-size=390,900",
         "--virtual-time-budget=2000", f"--screenshot={shot}", view[0]],
        capture_output=True, text=True, timeout=120, check=True)
    assert not [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert shot.stat().st_size > 5000
