"""Reading `work` without the test for negative indices that numba adds to every access."""

# ruff: noqa: ARG001
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.core import config
from numba.extending import intrinsic
from numpy.typing import NDArray


def _at(typing_context: Any, array: Any, index: Any) -> Any:
    """array[index] of a one-dimensional float64 array, for index >= 0."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.load(builder.gep(data, [arguments[1]], inbounds=True))

    return types.float64(array, types.int64), build


def _at_in_python(array: Any, index: int) -> Any:
    return array[index]


_chosen: Any = _at_in_python if getattr(config, "DISABLE_JIT", False) else intrinsic(_at)
at: Callable[[NDArray[np.float64], int], float] = _chosen
