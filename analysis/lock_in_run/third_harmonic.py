"""Third-order distortion of the receiver, by the third harmonic of the records.

The beat's own third harmonic is c3 = c2^2/c1, whatever second-order distortion adds. A cube adds a real number h
to c3 |c1|^-1 exp(-3i arg c1), the same in every record of one amplitude, and changes r by up to its share h
(`analysis.budget.unstated`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from analysis.arrays import Bools, Floats
from analysis.flags import Flag
from analysis.harmonics import fit_free_harmonics
from analysis.lock_in_run.records import RecordArrays
from analysis.lockin_rate import LockInEstimate

_HARMONICS = 4
_MOST_RECORDS = 400
_AT_ONCE = 200

_OWN_UNCERTAIN = 0.05
"""Share of the beat's own third harmonic, r^2, that a slow channel may take away."""

_UNSTEADY = int(Flag.CLIPPED | Flag.RATE_WANDER | Flag.HARMONICS_ALIASED | Flag.SECOND_HARMONIC_ABOVE_NYQUIST)


def third_order_limit(slow: RecordArrays, each: LockInEstimate, stated: float) -> float:
    """Largest third harmonic that the receiver may make of a pure sine, over the sine, as the records show it."""
    good = each.usable & ((each.flags & _UNSTEADY) == 0)
    found = list(_beside_own(slow, each, good))
    if not found:
        return stated
    beside, noise_u, own = (np.concatenate(column) for column in zip(*found, strict=True))
    weights = 1 / (noise_u**2 + (_OWN_UNCERTAIN * own) ** 2)
    weights /= weights.sum()
    seen = abs(float(weights @ beside))
    scatter = float(np.sqrt(weights**2 @ (beside - weights @ beside) ** 2)) if beside.size > 2 else 0.0
    u = math.hypot(max(float(np.sqrt(weights**2 @ noise_u**2)), scatter), _OWN_UNCERTAIN * float(own.min()))
    most = seen + 2 * u
    return most if math.isnan(stated) else max(min(stated, most), seen - 2 * u)


def _beside_own(slow: RecordArrays, each: LockInEstimate, good: Bools) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Of some records at a time: the third harmonic beside the beat's own, its noise, and r^2."""
    left = _MOST_RECORDS
    for batch in slow.batches:
        kept = np.flatnonzero(good[batch.rows] & np.isfinite(batch.volts[0]).all(axis=-1))[:left]
        left -= kept.size
        for part in (kept[first : first + _AT_ONCE] for first in range(0, kept.size, _AT_ONCE)):
            rows, volts = batch.rows[part], batch.volts[0][part]
            omega = 2 * np.pi * batch.sample_interval * each.beat_frequency[rows]
            # one step from amplitudes of zero: linear least squares at this frequency
            centred = volts - volts.mean(axis=-1, keepdims=True)
            _, _, c, _ = fit_free_harmonics(centred, None, omega, _HARMONICS, iterations=1)
            size, turn = np.abs(c[:, 0]), np.exp(-1j * np.angle(c[:, 0]))
            second, third = c[:, 1] / size * turn**2, c[:, 2] / size * turn**3
            noise_u = each.noise_rms[rows] / size * math.sqrt(2 / volts.shape[1])
            yield (third - second**2).real, noise_u, np.abs(second) ** 2
        if left <= 0:
            return
