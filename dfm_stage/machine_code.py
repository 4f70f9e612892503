"""Where the machine code of numba functions is kept between runs.

numba keeps it by the path of the source file, so that a checkout and the installation made from it
would both compile, and notices when that file changed, but not when a function that it calls, in
another file, did. Here it lies in a folder whose name is a hash of the contents of all sources it
is built from: copies share it, and a change anywhere can never run stale code.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numba.core.caching

F = TypeVar("F", bound=Callable[..., Any])
_caching: Any = numba.core.caching


def keeper(name: str, sources: Iterable[Path]) -> Callable[[F], F]:
    """Return a decorator for numba functions whose code depends on `sources`.

    The code lies in `$NUMBA_CACHE_DIR`, `$XDG_CACHE_HOME/dfm_stage` or `~/.cache/dfm_stage`,
    whichever can be written first, else in the temporary folder.
    """
    @lru_cache
    def cache() -> type:
        digest = hashlib.sha256(numba.__version__.encode())
        for source in sorted(sources, key=lambda path: path.name):
            digest.update(source.name.encode())
            digest.update(source.read_bytes())
        return _cache_in(_folder(f"{name}-{digest.hexdigest()[:16]}"))

    def keep(function: F) -> F:
        kept: Any = function
        if hasattr(kept, "py_func"):        # not where NUMBA_DISABLE_JIT is set
            kept._cache = cache()(kept.py_func)
        return function

    return keep


def _cache_in(folder: Path) -> type:
    class Locator:
        def __init__(self, function: Any, file: str) -> None:
            self._line, self._py_file = function.__code__.co_firstlineno, file

        @classmethod
        def from_function(cls, function: Any, file: str) -> Locator:
            return cls(function, file)

        def get_cache_path(self) -> str:
            return str(folder)

        def ensure_cache_path(self) -> None:
            folder.mkdir(parents=True, exist_ok=True)

        def get_source_stamp(self) -> str:
            return folder.name

        def get_disambiguator(self) -> str:
            return str(self._line)

    class Implementation(_caching.CompileResultCacheImpl):  # type: ignore[misc]
        _locator_classes = (Locator,)

    class Cache(_caching.FunctionCache):  # type: ignore[misc]
        _impl_class = Implementation

    return Cache


def _folder(name: str) -> Path:
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
    return Path(tempfile.mkdtemp(prefix=f"{name}-"))
