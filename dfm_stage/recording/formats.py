"""What the files of a bag begin with and end in: known without a reader of bags."""

MAGIC = b"\x89MCAP0\r\n"
"""An MCAP file begins and ends with it."""
STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}
"""The storages of rosbag2 that are read, and what their files end in."""
