"""Signals at the inputs of the oscilloscope, as functions of absolute time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from station.simulated_gyro.beat import beat_phase_on_table
from station.simulated_gyro.detector import Detector, detector_signal
from station.simulated_gyro.gyro import Gyro
from station.simulated_gyro.motion import Segment, split

Array = NDArray[np.float64]


def beat_signal_on_table(gyro: Gyro, detector: Detector, motion: Sequence[Segment], times: Array) -> Array:
    """Volts at the detector while the table moves.

    Parameters
    ----------
    gyro : Gyro
    detector : Detector
    motion : sequence of Segment
        In order of time; the last one goes on for ever, the first one also holds before its start.
    times : ndarray, shape (n,)
        Absolute times, s.

    Returns
    -------
    ndarray, shape (n,)
        V, without noise.
    """
    rates, phases = beat_phase_on_table(gyro, motion, times)
    volts = np.empty_like(times)
    for number, inside in split(tuple(motion), times):
        steady = motion[number].acceleration_dps2 == 0.0
        laser = gyro if steady else gyro.without_winking()
        volts[inside] = detector_signal(laser, detector, rates[inside], phases[inside])
    return np.asarray(volts * detector.swing(times)) if detector.pump_ripple else volts


def with_detector_noise(
    signal: Callable[[Array], Array], rms: float, seed: int, stream: int = 0
) -> Callable[[Array], Array]:
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

    def noisy(times: Array) -> Array:
        if times.size == 0:
            return signal(times)
        # picoseconds of the first sample: another acquisition, another noise
        stamp = round(float(times.flat[0]) * 1e12) & (2**63 - 1)
        rng = np.random.default_rng([seed, stamp, times.size, stream] if stream else [seed, stamp, times.size])
        return signal(times) + rms * rng.standard_normal(times.shape)

    return noisy
