"""Rates that are wrong, each in its own way: how far beats and rates of several points depart from each other.

With the rate as reference an error of a rate goes into the lock-in rate, and no ratio shows it: in both senses
at 1.2, 2 and 4 WL a table that misses every rate by 0.1 % makes four times what the noise of the ratios does. The
beats show it. A share d of a rate, and a share e of the lock-in rate, move the beat by

    f/(K sqrt(W^2 - WL^2)) - 1 = common + (d W^2 + e WL^2)/(W^2 - WL^2)

so what is left of the beats beside a factor of all of them (scale factor, tilt), and beside what is not known of
WL, is the error of the rates.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.special

from analysis.several_rates.least_squares import RatioFit
from analysis.several_rates.points import Points
from analysis.several_rates.ratio_records import MISMATCH
from analysis.several_rates.solutions import lock_in_u

UNLIKELY = 0.001
MATTERS = 0.3
"""Table noise below this share of the relative u of the lock-in rate is left alone: it adds 5 % at most."""

_LEAST_U = 1e-5
"""Of a beat over its rate: what the motion of any table leaves in a mean over a record."""

_NORMAL_95 = 1.959964


def table_noise(points: Points, fit: RatioFit) -> float:
    """Relative standard uncertainty of the rates of the points, beyond what was stated, as their beats show it.

    0 where that is chance or does not matter. 0 as well where it is more than `MISMATCH`: no table is that bad,
    some rate is another one, or coupling moves the beats; the tests of the fit then say which. From few points it
    is larger, by Student's factor.
    """
    data, records = points.points, points.records
    size, rate = float(np.hypot(*fit.parameters[0, :2])), np.abs(data.rate)
    freedom = rate.size - 1
    if data.reference != "rate" or freedom < 1 or not 0 < size < rate.min():
        return 0.0
    square, known = (size / rate) ** 2, lock_in_u(fit) / size
    seen = (data.beat_rate / np.sqrt((rate - size) * (rate + size)) - 1) * (1 - square)
    u = math.hypot(_LEAST_U, float(np.max((records.rate_u / np.abs(records.records.rate))[records.used])))
    columns = np.stack([1 - square, square], axis=-1) / u
    # that WL is known from the ratios is one more value
    white = np.concatenate([columns, [[0.0, 1 / known]]])
    aim = np.append(seen / u, 0.0)
    found = np.linalg.lstsq(white, aim, rcond=None)[0]
    left = float(np.sum((aim - white @ found) ** 2))
    if scipy.special.chdtrc(freedom, left) > UNLIKELY:
        return 0.0
    share = u * math.sqrt(left / freedom - 1)
    if not MATTERS * known < share < MISMATCH:
        return 0.0
    return share * float(scipy.special.stdtrit(freedom, 0.975)) / _NORMAL_95
