"""Where the machine code of numba functions is kept between runs.

numba keeps it by the path of the source file, so that a checkout and the installation made from it
would both compile, and notices when that file changed, but not when a function that it calls, in
another file, did. Here it lies in a folder whose name is a hash of the contents of all sources it
is built from: copies share it, and a change anywhere can never run stale code.
"""

from __future__ import annotations

import hashlib
import inspect
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, TypeVar

import numba
import numba.core.caching
import numba.core.ccallback
import numba.core.codegen
import numba.core.compiler
import numba.core.runtime
import numba.np.linalg
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])
_log = logging.getLogger(__package__)
_caching: Any = numba.core.caching
_codegen: Any = numba.core.codegen
_compiler: Any = numba.core.compiler
_runtime: Any = numba.core.runtime


@contextmanager
def _without_blas() -> Iterator[None]:
    """Let numba load what it knows of NumPy without SciPy's BLAS.

    numba looks for that BLAS to choose how np.convolve multiplies. To import it takes longer than
    all else numba loads, and no code of ours needs it.
    """
    def unavailable() -> None:
        raise ImportError

    linalg: Any = numba.np.linalg
    usual, linalg.ensure_blas = linalg.ensure_blas, unavailable
    try:
        yield
    finally:
        linalg.ensure_blas = usual


class _Part(_codegen.JITCodeLibrary):  # type: ignore[misc]
    """Code that is optimised and becomes machine code only as part of what it is linked into.

    numba does both for every function, and again for each one that calls it: half of the time
    that it takes to compile the simulator.
    """

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Do nothing: there is no machine code that could hold the environment."""

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        """Return no address: Python cannot call a part."""
        return 0

    def finalize(self) -> None:
        """Link what it calls."""
        for library in dict.fromkeys(self._linking_libraries):
            if hasattr(library, "_reload_init"):    # from numba 0.60 on
                self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True


class _PartCompiler(_compiler.Compiler):  # type: ignore[misc]
    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any, **more: Any) -> None:
        super().__init__(typing, target, library or _Part(target.codegen(), "part"), *rest, **more)


INSIDE: dict[str, Any] = {"nogil": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True,
                          "pipeline_class": _PartCompiler}
"""Options of functions that only compiled code calls."""


def keeper(name: str, sources: Iterable[Path], takes: str) -> Callable[[F], F]:
    """Return a decorator for numba functions whose code depends on `sources`.

    Where there is no code yet, one line says that `name` is compiled and how long that `takes`.
    The code lies in `$NUMBA_CACHE_DIR`, `$XDG_CACHE_HOME/dfm_stage` or `~/.cache/dfm_stage`,
    whichever can be written first, else in the temporary folder.
    """
    @lru_cache
    def folder() -> Path:
        digest = hashlib.sha256(numba.__version__.encode())
        for source in sorted(sources, key=lambda path: path.name):
            digest.update(source.name.encode())
            digest.update(source.read_bytes())
        return _folder(f"{name}-{digest.hexdigest()[:16]}")

    @lru_cache
    def announce() -> None:
        _log.warning("compiling the %s, once on this machine: up to %s", name, takes)

    def keep(function: F) -> F:
        kept: Any = function
        if hasattr(kept, "py_func"):        # not where NUMBA_DISABLE_JIT is set
            kept._cache = _cache_in(folder(), announce)(kept.py_func)
        return function

    return keep


def callback(name: str, function: Callable[..., Any], signature: Any, made_of: object,
             **options: Any) -> Any:
    """Return `function` as a numba callback, whose `address` other machine code can call.

    It is kept like the code of a `keeper`, in a folder named by a hash of what `made_of` holds:
    the code of functions and of all they call, wherever it was written, and plain values.
    """
    found: Any = numba.core.ccallback.CFunc(function, (signature.args, signature.return_type),
                                            {}, options)
    digest = content_hash((numba.__version__, sys.version_info[:2], repr(signature), made_of))
    if function.__module__ in sys.modules:  # kept code is tied to the module it came from
        found._cache = _cache_in(_folder(f"{name}-{digest[:16]}"))(function)
    found.compile()
    return found


def content_hash(value: object) -> str:
    """Return a hash of a value, and of a function's code with all that it refers to."""
    digest = hashlib.sha256()
    for part in _content(value, set()):
        digest.update(part)
        digest.update(b"\0")
    return digest.hexdigest()


def _content(value: Any, seen: set[int]) -> Iterator[bytes]:
    value = getattr(value, "py_func", value)
    if isinstance(value, (tuple, list)):
        yield str(len(value)).encode()
        for item in value:
            yield from _content(item, seen)
    elif isinstance(value, CodeType):
        yield value.co_code
        yield repr(value.co_names).encode()
        yield from _content(value.co_consts, seen)
    elif isinstance(value, FunctionType):
        if id(value) not in seen:           # a function may call itself
            seen.add(id(value))
            yield from _content(value.__code__, seen)
            used = inspect.getclosurevars(value)
            yield from _content([*sorted(used.nonlocals.items())], seen)
            yield from _content([*sorted(used.globals.items())], seen)
            yield from _content(value.__defaults__, seen)
    elif isinstance(value, np.ndarray):
        yield repr((value.dtype, value.shape)).encode()
        yield value.tobytes()
    else:
        yield repr(getattr(value, "__name__", value)).encode()


def _cache_in(folder: Path, missed: Callable[[], None] = lambda: None) -> type:
    class Locator(_caching._CacheLocator):  # type: ignore[misc]
        def __init__(self, function: Any, file: str) -> None:
            self._line, self._py_file = function.__code__.co_firstlineno, file

        @classmethod
        def from_function(cls, function: Any, file: str) -> Locator:
            return cls(function, file)

        def get_cache_path(self) -> str:
            return str(folder)

        def get_source_stamp(self) -> str:
            return folder.name

        def get_disambiguator(self) -> str:
            return str(self._line)

    class Implementation(_caching.CompileResultCacheImpl):  # type: ignore[misc]
        _locator_classes = (Locator,)

        def reduce(self, cres: Any) -> Any:
            """Leave out what would be imported again to load the code: a later process may not
            find the module of a hook. Only code that handles Python objects has use for it."""
            *parts, environments = super().reduce(cres)
            return *parts, tuple(found for found in environments if found.globals["__name__"]
                                 .partition(".")[0] in {__package__, numba.__name__})

    class Cache(_caching.FunctionCache):  # type: ignore[misc]
        _impl_class = Implementation

        def _index_key(self, sig: Any, codegen: Any) -> Any:
            return sig, codegen.magic_tuple()       # the folder stands for the content

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            """Load kept code without what only compiling needs: numba would first load all that
            it knows of Python and NumPy, which takes longer than the code itself."""
            _runtime.rtsys.initialize(target_context)
            found = None
            with _without_blas():
                # another version may have kept it, with a module that is no more
                with suppress(ImportError), self._guard_against_spurious_io_errors():
                    found = self._load_overload(sig, target_context)
                if found is None:
                    target_context.refresh()
            if found is None:
                missed()
            return found

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
