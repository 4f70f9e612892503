"""view: a page that shows the running loop: positions, errors, faults; arm and stop."""

from __future__ import annotations

import argparse
import signal

from dfm_stage.cli.command import command, option

EPILOG = """\
examples:
  ./run view                       # then open http://127.0.0.1:8042/
  ./run view --open --watch-only   # in the browser at once; nothing but disarm can be asked for
The page finds every axis of the ROS domain by itself, before or after it was opened, and shows
30 frames a second. Escape disarms all axes. config/foxglove/stage.json is the same for Foxglove,
config/plotjuggler/stage.xml for PlotJuggler.
"""
OPTIONS = (
    option("--port", type=int, default=8042, metavar="N",
           help="port of 127.0.0.1, 0 for any (default: %(default)s)"),
    option("--watch-only", action="store_true", help="no button but disarm"),
    option("--open", action="store_true", help="open it in the browser"),
)


@command("view", __doc__, EPILOG, OPTIONS, lambda _: True)
def main(options: argparse.Namespace) -> int:
    """Serve until Ctrl-C (130) or SIGTERM (0); 2 where the port is taken."""
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

