"""The page of the live view and its WebSocket, on this machine only.

Anyone who can open the page can disarm the stage, and arm it: so it listens on 127.0.0.1, answers
only to that name (a page elsewhere whose name is made to point here is refused) and takes wishes
only from pages that it served itself.
"""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketHandler

from dfm_stage.errors import DfmError
from dfm_stage.live.watcher import WISHES, Watcher
from dfm_stage.reporting.style import STYLE

HOST = "127.0.0.1"
NAMES = ("127.0.0.1", "localhost")
FRAMES_HZ = 30.0
PAGE = Path(__file__).parent / "page"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}
POLICY = ("default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; "
          "frame-ancestors 'none'")


class ServerError(DfmError):
    """The page cannot be served."""


class _Local:
    """Refuses whoever came under another name than this machine's own."""

    request: Any

    def prepare(self) -> None:
        if self.request.host_name not in NAMES:
            raise HTTPError(403, "only for this machine")


class _Pages(_Local, RequestHandler):
    def get(self, name: str) -> None:
        name = name or "index.html"
        self.set_header("Content-Security-Policy", POLICY)
        self.set_header("Cache-Control", "no-store")
        file = PAGE / name
        if name == "style.css":
            self.set_header("Content-Type", "text/css")
            self.write(STYLE)
        elif file.is_file() and file.suffix in TYPES:
            self.set_header("Content-Type", f"{TYPES[file.suffix]}; charset=utf-8")
            self.write(file.read_bytes())
        else:
            raise HTTPError(404)


class _Socket(_Local, WebSocketHandler):
    def initialize(self, view: View) -> None:
        self._view = view

    def open(self) -> None:
        self._view.sockets.add(self)
        self.write_message(json.dumps({"watch_only": self._view.watch_only}))

    def on_message(self, message: str | bytes) -> None:
        try:
            wish = json.loads(message)
            what, axes = wish["do"], [str(axis) for axis in wish["axes"]]
        except (ValueError, TypeError, KeyError):
            return
        if what in WISHES and (what == "disarm" or not self._view.watch_only):
            for axis in axes:
                self._view.watcher.wish(what, axis, self._view.answer)

    def on_close(self) -> None:
        self._view.sockets.discard(self)


class View:
    """Serves until `stop`; frames go out while somebody looks.

    Parameters
    ----------
    watcher : Watcher
        Started already.
    port : int
        0 takes any that is free; `url` says which.
    watch_only : bool
        Refuse every wish but disarm.

    Raises
    ------
    ServerError
        If the port is taken.
    """

    def __init__(self, watcher: Watcher, port: int, watch_only: bool = False) -> None:
        self.watcher = watcher
        self.watch_only = watch_only
        self.sockets: set[_Socket] = set()
        self._loop = IOLoop.current()
        try:
            sockets = bind_sockets(port, HOST, family=socket.AF_INET)
        except OSError as error:
            raise ServerError(f"port {port} of {HOST} cannot be used ({error.strerror}): name "
                              "another with --port, or 0 for any") from None
        self.url = f"http://{HOST}:{sockets[0].getsockname()[1]}/"
        self._server = HTTPServer(Application([
            (r"/live", _Socket, {"view": self}), (r"/([\w.-]*)", _Pages)],
            websocket_ping_interval=10))
        self._server.add_sockets(sockets)
        self._frames = PeriodicCallback(self._send, 1e3 / FRAMES_HZ)
        self._frames.start()

    def answer(self, words: str) -> None:
        """Show what a node answered; callable from any thread."""
        self._loop.add_callback(self._tell, json.dumps({"answer": words}))

    def _send(self) -> None:
        frame = self.watcher.look()
        if self.sockets:
            self._tell(json.dumps(frame, separators=(",", ":")))

    def _tell(self, text: str) -> None:
        for each in list(self.sockets):
            each.write_message(text)

    def run(self) -> None:
        """Serve until `stop`."""
        self._loop.start()

    def stop(self) -> None:
        """End `run`; safe in a signal handler."""
        self._loop.add_callback_from_signal(self._loop.stop)

    def close(self) -> None:
        """Stop to listen."""
        self._frames.stop()
        self._server.stop()
