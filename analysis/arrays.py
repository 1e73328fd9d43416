"""What the arrays hold, in the words that signatures use."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Indices = NDArray[np.intp]

Samples = NDArray[Any]
"""float32 or float64"""
Phasors = NDArray[Any]
"""complex64 or complex128"""
