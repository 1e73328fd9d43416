"""Signals at the inputs of the oscilloscope, as functions of absolute time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from analysis.arrays import Floats
from analysis.ring_laser.beat import beat_phase_on_table
from analysis.ring_laser.detector import Detector, detector_signal
from analysis.ring_laser.gyro import Gyro
from analysis.ring_laser.motion import Motion, split

_SAME_NOISE_S = 20e-6


def beat_signal_on_table(gyro: Gyro, detector: Detector, motion: Sequence[Motion], times: Floats) -> Floats:
    """Volts at the detector while the table moves.

    Parameters
    ----------
    motion : sequence of Motion
        In order of time; the last one goes on for ever, the first one also holds before its start.
    times : ndarray, shape (n,)
        Absolute times, s.

    Returns
    -------
    ndarray, shape (n,)
        V, without noise.
    """
    segments, volts = tuple(motion), np.empty_like(times)
    for number, inside in split(segments, times):
        resting = _resting_volts(gyro, detector, segments[number])
        if resting is not None:
            volts[inside] = resting
            continue
        rates, phases = beat_phase_on_table(gyro, segments, times[inside])
        seen_by = (gyro, detector)
        if segments[number].acceleration_dps2 != 0.0:
            # nobody measures in a slew, and its rates are too many to work out all of their beats
            seen_by = (gyro.without_winking(), detector.without_filters())
        volts[inside] = detector_signal(*seen_by, rates, phases)
    return np.asarray(volts * detector.swing(times)) if detector.pump_ripple else volts


@lru_cache(maxsize=64)
def _resting_volts(gyro: Gyro, detector: Detector, segment: Motion) -> float | None:
    """The constant of a locked gyro on a table at rest; ``None`` where the beat moves."""
    if segment.rate_dps or segment.acceleration_dps2 or gyro.ripple_dps:
        return None
    rate = np.atleast_1d(gyro.axis_rate(0.0, segment.azimuth_deg))
    if not gyro.locked(rate).all():
        return None
    return float(detector_signal(gyro, detector, rate, np.zeros(1))[0])


def with_detector_noise(
    signal: Callable[[Floats], Floats], rms: float, seed: int, stream: int = 0
) -> Callable[[Floats], Floats]:
    """Add white noise to a signal, the same for the same seed and the same sample times.

    Parameters
    ----------
    signal : callable
        Absolute times in s -> V.
    rms : float
        V in each sample.
    seed : int
        Not negative.
    stream : int, optional
        Another number, another noise: one for each channel.

    Returns
    -------
    callable
        Absolute times in s -> V.
    """
    if rms == 0:
        return signal

    def noisy(times: Floats) -> Floats:
        if times.size == 0:
            return signal(times)
        # another acquisition, another noise; but an input stage that looks at delays of nanoseconds sees one noise
        stamp = math.floor(float(times.flat[0]) / _SAME_NOISE_S) & (2**63 - 1)
        rng = np.random.default_rng([seed, stamp, times.size, stream] if stream else [seed, stamp, times.size])
        return signal(times) + rms * rng.standard_normal(times.shape)

    return noisy
