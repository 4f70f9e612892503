"""The decorator of all compiled code, and where its machine code is kept between runs.

numba notices when the file of a function changed, but not when a function that it calls, in
another file, did. So the code of this package is cached in a folder whose name is a hash of all
sources it is built from: a changed effect, wherever it is, can never run stale code.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numba.core.config

F = TypeVar("F", bound=Callable[..., Any])
_config: Any = numba.core.config
_njit: Any = numba.njit


def compiled(function: F) -> F:
    """`function` as machine code that runs without the interpreter lock, not cached itself."""
    result: F = _njit(nogil=True, error_model="numpy")(function)
    return result


def lean(function: F) -> F:
    """As `compiled`, for functions that allocate nothing: without reference counts, which cost
    more than the arithmetic in short functions of arrays."""
    result: F = _njit(nogil=True, error_model="numpy", _nrt=False)(function)
    return result


def inlined(function: F) -> F:
    """As `lean`, and part of the code of whoever calls it."""
    result: F = _njit(nogil=True, error_model="numpy", _nrt=False,
                           forceinline=True)(function)
    return result


def entry(function: F) -> F:
    """As `compiled`, with its machine code, and all it calls, kept on disk."""
    with _cache_folder():
        result: F = _njit(nogil=True, error_model="numpy", cache=True)(function)
    return result


@contextmanager
def _cache_folder() -> Iterator[None]:
    before = _config.CACHE_DIR
    _config.CACHE_DIR = str(_folder())
    try:
        yield
    finally:
        _config.CACHE_DIR = before


@lru_cache
def _folder() -> Path:
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(str(package).encode())
    sources = [*(package / "kernel").glob("*.py"), *(package / "effects").glob("*.py"),
               package / "base.py", package / "effect.py", package / "registry.py"]
    for source in sorted(sources):
        digest.update(source.read_bytes())
    name = f"dfm_stage-{digest.hexdigest()[:16]}"
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    for parent in (given, os.path.join(home, "dfm_stage"), tempfile.gettempdir()):
        if not parent:
            continue
        folder = Path(parent) / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="dfm_stage-"))
