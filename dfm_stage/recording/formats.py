"""What the files of a bag begin with and end in: known without a reader of bags."""

from __future__ import annotations

import os

MAGIC = b"\x89MCAP0\r\n"
"""An MCAP file begins and ends with it."""
STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}
"""The storages of rosbag2 that are read, and what their files end in."""
BINARY: int = getattr(os, "O_BINARY", 0)
"""For `os.open`, as Windows would otherwise change line ends on the way."""
