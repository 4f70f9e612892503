"""view: the loop as it runs, on a page for this machine: positions, errors, faults, arm, stop."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Sequence

from dfm_stage.cli.command import command_parser, run_command

PORT = 8042
EPILOG = """\
examples:
  ./run view                       # then open http://127.0.0.1:8042/
  ./run view --open --watch-only   # in the browser at once; nothing but disarm can be asked for
The page finds every axis of the ROS domain by itself, before or after it was opened, and shows
30 frames a second. Escape disarms all axes. config/foxglove/stage.json is the same for Foxglove.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Serve until Ctrl-C (130) or SIGTERM (0); 2 where the port is taken."""
    parser = command_parser("view", __doc__, EPILOG)
    parser.add_argument("--port", type=int, default=PORT, metavar="N",
                        help="port of 127.0.0.1, 0 for any (default: %(default)s)")
    parser.add_argument("--watch-only", action="store_true", help="no button but disarm")
    parser.add_argument("--open", action="store_true", help="open it in the browser")
    options = parser.parse_args(argv)
    return run_command(lambda: _view(options))


def _view(options: argparse.Namespace) -> int:
    from dfm_stage.live.server import View
    from dfm_stage.live.watcher import Watcher

    asked: list[int] = []
    watcher = Watcher()
    try:
        view = View(watcher, options.port, options.watch_only)

        def stop(number: int, _frame: object) -> None:
            asked.append(number)
            view.stop()

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
        watcher.start()
        print(f"{view.url} (Ctrl-C ends it)", flush=True)
        if options.open:
            import webbrowser

            webbrowser.open(view.url)
        view.run()
        view.close()
    finally:
        watcher.close()
    return 130 if signal.SIGINT in asked else 0


if __name__ == "__main__":
    raise SystemExit(main())
