"""Lock-in rate of a ring laser gyro from single records: the harmonic ratio, inverted exactly.

All that follows from a ratio stands here: the rate and its derivatives, the 95 % interval, the backscatter phase.
"""

from analysis.lockin_rate.estimate import LockInEstimate
from analysis.lockin_rate.interval import size_interval
from analysis.lockin_rate.rate import rate_and_slopes, with_ratio
from analysis.lockin_rate.records import estimate_lock_in, noise_model

__all__ = ["LockInEstimate", "estimate_lock_in", "noise_model", "rate_and_slopes", "size_interval", "with_ratio"]
