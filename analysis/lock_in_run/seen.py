"""What the records of one rate say of the lock-in rate, while those of others are still to be taken."""

from __future__ import annotations

import math
from dataclasses import dataclass

from analysis.budget.unstated import LOWEST_GAIN_CORNER_HZ, SECOND_ORDER_LIMIT
from analysis.combine import combine_estimates
from analysis.flags import FATAL
from analysis.lock_in_run.estimates import Method, estimate_records, only_beats
from analysis.lock_in_run.records import RecordArrays

_SURE = 4.0
"""Standard uncertainties within which a value surely lies: rates that are chosen anew by chance cost the run."""


@dataclass(frozen=True)
class LockInSeen:
    """A lock-in rate, and between which values it surely lies, deg/s."""

    lock_in_rate: float
    least: float
    most: float

    @property
    def spread(self) -> float:
        """Of the values that are possible, a factor."""
        return self.most / max(self.least, 1e-3 * self.most)


def lock_in_seen(records: RecordArrays, scale_factor: float) -> LockInSeen | None:
    """Say what records at one rate say of the lock-in rate; ``None`` if they show none.

    Distortion and a gain corner of which nobody knows anything count in it: the first adds to the second harmonic
    or takes from it, the second takes from it where the beat is fast.
    """
    mean = combine_estimates(only_beats(estimate_records(records, Method(scale_factor))))
    rate, rate_u = float(mean.lock_in_rate), float(mean.lock_in_rate_u)
    if int(mean.flags) & int(FATAL) or not (rate > 0 and math.isfinite(rate_u)):
        return None
    # second order d puts the lock-in rate off by 2 W d
    off = math.hypot(_SURE * rate_u, 2 * abs(float(mean.input_rate)) * SECOND_ORDER_LIMIT)
    lost = math.hypot(1.0, float(mean.beat_frequency) / LOWEST_GAIN_CORNER_HZ)
    return LockInSeen(rate, max(rate - off, 0.0), (rate + off) * lost)
