"""Choose the executor of the node processes that a benchmark starts."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def executor(name: str) -> Iterator[None]:
    """Make nodes started inside use the executor `name`: events or default."""
    before = os.environ.get("DFM_EXECUTOR")
    os.environ["DFM_EXECUTOR"] = name
    try:
        yield
    finally:
        if before is None:
            del os.environ["DFM_EXECUTOR"]
        else:
            os.environ["DFM_EXECUTOR"] = before
