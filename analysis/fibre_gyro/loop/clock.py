"""Output periods in whole sample pairs: each holds the pairs that end in it, so times are exact on average."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.coil import FibreCoil


class OutputClock:
    """Time and sample pairs since the start of a gyro.

    Examples
    --------
    >>> clock = OutputClock(FibreCoil())
    >>> ends, pairs = clock.next_outputs(3, 0.01)
    >>> ends.tolist(), pairs.tolist()
    ([0.01, 0.02, 0.03], [1021, 1021, 1021])
    """

    def __init__(self, coil: FibreCoil) -> None:
        self.pair_time = 2.0 * coil.transit_time
        self.time, self.pairs = 0.0, 0

    def next_outputs(self, n_outputs: int, period: float) -> tuple[Floats, Ints]:
        """End of each of the next output periods, s, and its number of pairs; the clock goes on."""
        if n_outputs < 1:
            raise ValueError(f"the number of outputs must be at least 1, not {n_outputs}")
        if not self.pair_time <= period < np.inf:
            raise ValueError(
                f"the output period must be at least one sample pair, {self.pair_time:.4g} s, not {period!r}"
            )
        ends: Floats = self.time + period * np.arange(1, n_outputs + 1, dtype=np.float64)
        last = np.rint(ends / self.pair_time).astype(np.int64)
        in_output: Ints = last - np.concatenate(([self.pairs], last[:-1]))
        self.time, self.pairs = float(ends[-1]), int(last[-1])
        return ends, in_output

    def next_pairs(self, pairs: int) -> None:
        """Go on by some pairs."""
        self.pairs += pairs
        self.time = self.pairs * self.pair_time
