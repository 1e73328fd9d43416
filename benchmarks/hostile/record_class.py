"""What a class of hostile records is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from analysis.arrays import Floats

Kind = Literal["ideal", "cure", "detect", "blind"]
"""ideal: nothing is wrong, and no flag may say so.
cure: the interval must cover.
detect: a wrong number must carry a warning, or none be given.
blind: one record cannot see it; shown for what it costs."""


@dataclass(frozen=True)
class HostileRecord:
    """One record and the truth behind it.

    volts : (n_samples,) V, or codes
    sample_interval : s, as the scope states it
    scale_factor : pulses per degree
    lock_in_rate : deg/s
    input_rate : deg/s, signed; the mean where it moves
    """

    volts: Floats
    sample_interval: float
    scale_factor: float
    lock_in_rate: float
    input_rate: float


@dataclass(frozen=True)
class RecordClass:
    """A way in which records go wrong; `make` draws one, with gyro, beat and size of the defect at random."""

    name: str
    kind: Kind
    make: Callable[[np.random.Generator], HostileRecord]
