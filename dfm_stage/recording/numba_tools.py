"""What the compiled loops share; importing this imports numba.

The loops are compiled on their first call and kept on disk. They run without the interpreter lock.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from dfm_stage.machine_code import INSIDE, keeper

Bytes: TypeAlias = NDArray[np.uint8]
Ints: TypeAlias = NDArray[np.int64]
Function = TypeVar("Function", bound=Callable[..., Any])

_njit: Any = numba.njit
_HERE = Path(__file__).resolve().parent
_keep = keeper("reader", [*_HERE.glob("*_kernels.py"), _HERE / "numba_tools.py",
                          _HERE / "decode_plan.py"], takes="10 s")

RECORD_HEAD = 9         # opcode, length
MESSAGE_HEAD = 31       # and channel, sequence, log time, publish time
CDR_HEAD = 4


def entry(function: Function) -> Function:
    """Compile a function that Python calls; its machine code, and all it calls, is kept."""
    result: Function = _njit(nogil=True)(function)
    return _keep(result)


compiled: Callable[[Function], Function] = _njit(**INSIDE)
"""Compile a function that only compiled code calls."""
inlined: Callable[[Function], Function] = _njit(**INSIDE, forceinline=True)
"""Compile a function into each compiled function that calls it."""


def _loader(bits: int) -> Any:
    """Return a compiled `load(data, at)`: the little-endian integer of `bits` at byte `at`."""
    word = ir.IntType(bits)
    result = getattr(types, f"uint{bits}")

    def load(_typing: Any, data: Any, _at: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            value = builder.load(builder.bitcast(builder.gep(array.data, [arguments[1]]),
                                                 word.as_pointer()))
            value.align = 1
            return value

        return result(data, types.int64), generate

    return intrinsic(load)


def _storer(bits: int) -> Any:
    """Return a compiled `store(data, at, value)` that does the reverse of `_loader`."""
    word = ir.IntType(bits)
    whole = getattr(types, f"uint{bits}")

    def store(_typing: Any, data: Any, _at: Any, _value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            place = builder.gep(array.data, [arguments[1]])
            builder.store(arguments[2], builder.bitcast(place, word.as_pointer()), align=1)
            return context.get_dummy_value()

        return types.void(data, types.int64, whole), generate

    return intrinsic(store)


u16 = _loader(16)
u32 = _loader(32)
u64 = _loader(64)
put_u32 = _storer(32)
put_u64 = _storer(64)
