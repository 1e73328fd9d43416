"""Records of a simulated bench with known contaminants, for the tests of what is beyond one record."""

from __future__ import annotations

import numpy as np

from analysis import beat_signal, estimate_lock_in
from analysis.ring_laser.winking import steady_beat, symmetric_laser

K = 2000.0
WL = 0.05


def both_senses(*multiples):
    return np.array([*multiples, *(-m for m in multiples)], dtype=float)


def volts(
    rate, n_records, rng, *, noise=0.01, hd2=0.0, phase=0.7, gain_corner_hz=None, n_samples=2500, periods=100.3
):
    """(n_records, n_samples) of one rate, amplitude 1, square law of second harmonic hd2; and the interval."""
    frequency = K * np.sqrt(rate**2 - WL**2)
    interval = periods / frequency / n_samples
    times = np.arange(n_samples) * interval
    starts = rng.uniform(0, 2 * np.pi, n_records)
    if gain_corner_hz is None:
        clean = beat_signal(
            times,
            scale_factor=K,
            input_rate=rate,
            lock_in_rate=WL,
            initial_phase=starts,
            backscatter_phase=phase,
        )
    else:
        beat = steady_beat(symmetric_laser(WL, scale_factor=K, gain_corner_hz=gain_corner_hz), rate)
        clean = np.array([beat.signal(times, readout_phase=-phase, start_phase=s) for s in starts])
    return clean + 2 * hd2 * clean**2 + rng.normal(scale=noise, size=clean.shape), interval


def estimates(multiples, n_records, rng, **bench):
    """One LockInEstimate of n_records a rate."""
    made = []
    for multiple in multiples:
        records, interval = volts(multiple * WL, n_records, rng, **bench)
        made.append(estimate_lock_in(records, interval, scale_factor=K, input_rate=multiple * WL))
    return made
