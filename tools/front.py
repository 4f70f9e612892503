"""Entry of ./run: a Python 3.10 to 3.13 for door.main (this file is valid on any Python 3)."""

import os
import signal
import sys

NAMES = ("python3.13", "python3.12", "python3.11", "python3.10")


def suitable():
    """Whether this interpreter is one that the ROS wheels are built for."""
    return (
        (3, 10) <= sys.version_info[:2] <= (3, 13)
        and sys.implementation.name == "cpython"
        and "t" not in getattr(sys, "abiflags", "")
    )


def hand_over():
    """Replace this process by a suitable interpreter, or end with one line."""
    import subprocess

    tried = os.environ.get("DFM_FRONT_TRIED")
    for name in () if tried or os.environ.get("DFM_PYTHON") else NAMES:
        try:
            found = subprocess.call(
                [name, "-c", ""], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        except OSError:
            continue
        if found == 0:
            os.environ["DFM_FRONT_TRIED"] = "1"
            os.execvp(name, [name, "-I", "-S", os.path.abspath(__file__)] + sys.argv[1:])
    sys.stderr.write(
        "run: %s is Python %s, needed is CPython 3.10 to 3.13: install python3.12 "
        "python3.12-venv python3.12-dev, or name one in DFM_PYTHON\n"
        % (sys.executable, sys.version.split()[0])
    )
    sys.exit(2)


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `./run | head` is no error
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, lambda number, _: os._exit(128 + number))
    if not suitable():
        hand_over()
    os.environ.pop("DFM_FRONT_TRIED", None)
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
    import door

    sys.exit(door.main(sys.argv[1:]))
