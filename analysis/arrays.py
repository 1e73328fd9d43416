"""What the arrays hold, in the words that signatures use; errors of the analysis."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Indices = NDArray[np.intp]

Samples = NDArray[Any]  # float32 or float64
Phasors = NDArray[Any]  # complex64 or complex128

NORMAL_95 = 1.959963984540054  # standard uncertainties to each end of the 95 % interval of a normal distribution


# --------------------
# What records, or what is stated of a bench, do not give; a call that is wrong in itself is a ValueError


class NoFit(ValueError):
    """The records do not determine what was to be fitted; the text says what would."""


class NoTilt(ValueError):
    """Beats and table rates of the fast run do not belong together."""


class NoBudget(ValueError):
    """A result has no uncertainty budget; the text says why."""


class OutsideResponse(ValueError):
    """A frequency at which the measured response of a channel is not known."""


class OneRateOnly(ValueError):
    """A method for records at one rate was asked of records at several."""
