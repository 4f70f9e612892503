"""The array types that signatures name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Complex", "Lines"]

Array = NDArray[np.float64]
"""Real numbers."""
Complex = NDArray[np.complex128]
"""Complex numbers, such as a spectrum or a frequency response."""
Lines = NDArray[np.int64]
"""Whole numbers, such as lags or the numbers of DFT lines."""
