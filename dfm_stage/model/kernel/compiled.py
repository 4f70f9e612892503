"""How everything here is compiled: the decorators, and what numba lacks.

Only entry points can be called from Python and are kept on disk; they carry the code of all they
call. The others have no wrappers, which would take a fifth of the time it takes to compile. What
numba lacks is unchecked access, addresses, and calls of machine code by its address.
"""

# ruff: noqa: ARG001
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba.core.cgutils
from llvmlite import ir
from numba.extending import intrinsic

from dfm_stage import machine_code

F = TypeVar("F", bound=Callable[..., Any])
types: Any = numba.types
_tuples: Any = numba.core.cgutils
POINTER: Any = types.CPointer(types.float64)
_njit: Any = numba.njit
_PACKAGE = Path(__file__).resolve().parents[1]
_SOURCES = [*(_PACKAGE / "kernel").glob("*.py"), _PACKAGE / "parameter.py"]
_keep = machine_code.keeper("simulator", _SOURCES, takes="half a minute")
_INSIDE: dict[str, Any] = {**machine_code.INSIDE, "error_model": "numpy"}
_AROUND_HOOKS = tuple((_PACKAGE / "kernel" / name).read_bytes() for name in
                      ("collocated.py", "hooks.py", "compiled.py", "slots.py"))


def compiled(function: F) -> F:
    """`function` as machine code that runs without the interpreter lock, for other such code."""
    # said outright: else it is as its first caller is, and a lean one cannot return arrays
    return cast("F", _njit(**_INSIDE, _nrt=True)(function))


def lean(function: F) -> F:
    """As `compiled`, for functions that allocate nothing: without reference counts, which cost
    more than the arithmetic in short functions of arrays."""
    return cast("F", _njit(**_INSIDE, _nrt=False)(function))


def inlined(function: F) -> F:
    """As `lean`, and part of the code of whoever calls it."""
    return cast("F", _njit(**_INSIDE, _nrt=False, forceinline=True)(function))


def entry(function: F) -> F:
    """As `compiled`, callable from Python, its machine code kept on disk."""
    return _keep(cast("F", _njit(nogil=True, error_model="numpy")(function)))


def callback(function: F, signature: Any, made_of: object) -> Any:
    """`function`, made of hooks and values, as machine code with an `address`, kept on disk."""
    return machine_code.callback("hook", function, signature, (_AROUND_HOOKS, made_of), nogil=True,
                                 error_model="numpy")


def _element(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
    return builder.gep(data, [arguments[1]], inbounds=True)


def _at(typing_context: Any, array: Any, index: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_element(context, builder, signature, arguments))

    return array.dtype(array, types.int64), build


def _pointer(typing_context: Any, array: Any, index: Any) -> Any:
    return POINTER(array, types.int64), _element


at: Callable[..., Any] = intrinsic(_at)
"""at(array, index) of a one-dimensional array for index >= 0, without the test for the sign."""

pointer: Callable[..., Any] = intrinsic(_pointer)
"""pointer(array, index): address of an element, >= 0, of a float64 array as it lies in memory."""


def caller(signature: Any) -> Callable[..., Any]:
    """call(address, arguments) for machine code of this signature, arguments being a tuple."""

    def typed(typing_context: Any, address: Any, arguments: Any) -> Any:
        def build(context: Any, builder: Any, here: Any, values: Any) -> Any:
            given = [context.cast(builder, value, kind, wanted) for value, kind, wanted in zip(
                _tuples.unpack_tuple(builder, values[1]), here.args[1], signature.args,
                strict=True)]
            nothing = signature.return_type == types.void
            result = (ir.VoidType() if nothing
                      else context.get_value_type(signature.return_type))
            kind = ir.FunctionType(result, [value.type for value in given])
            found = builder.call(builder.inttoptr(values[0], kind.as_pointer()), given)
            return context.get_dummy_value() if nothing else found

        return signature.return_type(types.int64, arguments), build

    return cast("Callable[..., Any]", intrinsic(typed))


def values_at(first: int, count: int) -> Callable[..., Any]:
    """load(p) -> the tuple of the numbers p[first], ..., p[first + count - 1]."""

    def load(typing_context: Any, p: Any) -> Any:
        result = types.UniTuple(types.float64, count)

        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            index = [context.get_constant(types.intp, first + i) for i in range(count)]
            return context.make_tuple(builder, result, [
                builder.load(builder.gep(arguments[0], [i], inbounds=True)) for i in index])

        return result(p), build

    return cast("Callable[..., Any]", intrinsic(load))
