"""The decorators of all compiled code.

Only entry points can be called from Python and are kept on disk; they carry the code of all they
call. The others have no wrappers, which would take a fifth of the time it takes to compile.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

from dfm_stage import machine_code

F = TypeVar("F", bound=Callable[..., Any])
_njit: Any = numba.njit
_PACKAGE = Path(__file__).resolve().parents[1]
_SOURCES = [*(_PACKAGE / "kernel").glob("*.py"), _PACKAGE / "base.py"]
_keep = machine_code.keeper("simulator", _SOURCES)
_INSIDE: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cpython_wrapper": True,
                           "no_cfunc_wrapper": True}
_AROUND_HOOKS = tuple((_PACKAGE / "kernel" / name).read_bytes() for name in
                      ("hooks.py", "memory.py", "slots.py"))


def compiled(function: F) -> F:
    """`function` as machine code that runs without the interpreter lock, for other such code."""
    result: F = _njit(**_INSIDE)(function)
    return result


def lean(function: F) -> F:
    """As `compiled`, for functions that allocate nothing: without reference counts, which cost
    more than the arithmetic in short functions of arrays."""
    result: F = _njit(**_INSIDE, _nrt=False)(function)
    return result


def inlined(function: F) -> F:
    """As `lean`, and part of the code of whoever calls it."""
    result: F = _njit(**_INSIDE, _nrt=False, forceinline=True)(function)
    return result


def entry(function: F) -> F:
    """As `compiled`, callable from Python, its machine code kept on disk."""
    result: F = _njit(nogil=True, error_model="numpy")(function)
    return _keep(result)


def callback(function: F, signature: Any, made_of: object) -> Any:
    """`function`, made of hooks and values, as machine code with an `address`, kept on disk."""
    return machine_code.callback("hook", function, signature, (_AROUND_HOOKS, made_of), nogil=True,
                                 error_model="numpy")
