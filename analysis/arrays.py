"""What the arrays hold, in the words that signatures use; errors of the analysis."""

from collections.abc import Sequence
from typing import Any, Self

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


class Stacked:
    """A dataclass whose arrays, and parts that are such again, have the records (R, ...) as their first axis."""

    def take(self, part: slice | Indices | Bools) -> Self:
        """Some of the records."""
        values = vars(self).values()
        return type(self)(
            *[v.take(part) if isinstance(v, Stacked) else v[part] if np.ndim(v) else v for v in values]
        )

    def put(self, part: slice | Indices | Bools, other: Self) -> None:
        """Write the other's records into the places `part` of this one."""
        for own, others in zip(vars(self).values(), vars(other).values(), strict=True):
            if isinstance(own, Stacked):
                own.put(part, others)
            else:
                own[part] = others

    def where(self, chosen: Bools, other: Self) -> Self:
        """This one's records where chosen (R,), the other's elsewhere."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return type(self)(*[np.where(chosen.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in pairs])

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The records of all parts, one behind the other; a part that is alone is what is returned."""
        if len(parts) == 1:
            return parts[0]
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*[c[0].joined(c) if isinstance(c[0], Stacked) else np.concatenate(c) for c in columns])


# --------------------
# What records, or what is stated of a bench, do not give; a call that is wrong in itself is a ValueError


class NoFit(ValueError):
    """Records do not determine what was to be fitted, or a laser has no steady beat; the text says why."""


class NoTilt(ValueError):
    """Beats and table rates of the fast run do not belong together."""


class NoBudget(ValueError):
    """A result has no uncertainty budget; the text says why."""


class OutsideResponse(ValueError):
    """A frequency at which the measured response of a channel is not known."""


class OneRateOnly(ValueError):
    """A method for records at one rate was asked of records at several."""
