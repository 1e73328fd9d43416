"""Signals at the inputs of the oscilloscope, as functions of absolute time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from analysis.arrays import Floats
from analysis.ring_laser.beat import beat_phase_on_table
from analysis.ring_laser.detector import Detector, detector_signal
from analysis.ring_laser.gyro import Gyro
from analysis.ring_laser.motion import Motion, split

_SAME_NOISE_S = 20e-6
_POINTS_A_PERIOD = 6
_NEGLIGIBLE = 1e-4  # harmonics below this share of the fundamental do not count
_DISTORTED = 3.0  # the detector's cube makes three of one
_SHARPEST = 0.9  # ratio of successive harmonics


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


def smooth_interval(gyro: Gyro, detector: Detector, motion: Sequence[Motion], start: float, stop: float) -> float:
    """Distance in s of points between which polynomials of the fifth degree give the signal of the detector.

    They leave 1e-4 of its amplitude. 0 where the gyro locks or unlocks: there are no such points then.

    Parameters
    ----------
    start, stop : float
        Absolute times in s between which the signal is wanted.
    """
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    reached = segments[pieces[0][0] : pieces[-1][0] + 1]
    return min(_smooth_interval(gyro, detector, segment) for segment in reached)


@lru_cache(maxsize=64)
def _smooth_interval(gyro: Gyro, detector: Detector, segment: Motion) -> float:
    """Of one piece of motion: a number of points for each period of the fastest harmonic that counts."""
    if _resting_volts(gyro, detector, segment) is not None:
        return 1.0 / (_POINTS_A_PERIOD * max(detector.pump_hz, 1.0))
    if segment.acceleration_dps2:
        return 0.0
    rates = gyro.axis_rate(segment.rate_dps, np.arange(0.0, 360.0, 10.0))
    low, high = (float(limit(np.abs(rates))) for limit in (np.min, np.max))
    low, high = low - abs(gyro.ripple_dps), high + abs(gyro.ripple_dps)
    ratio = float(gyro.harmonic_ratio(np.array(low)))
    if low <= gyro.lock_in_rate or ratio >= _SHARPEST or np.ptp(np.sign(rates)):
        return 0.0
    harmonics = _DISTORTED + (math.log(_NEGLIGIBLE) / math.log(ratio) if ratio > 0 else 0.0)
    fastest = gyro.scale_factor * high * harmonics + abs(gyro.ripple_hz) + detector.pump_hz
    return 1.0 / (_POINTS_A_PERIOD * fastest)


@dataclass(frozen=True)
class NoisySignal:
    """A signal at an input with white noise: its two parts can be looked at one by one.

    Attributes
    ----------
    smooth : callable
        Absolute times in s -> V, without noise.
    noise_rms : float
        V in each sample.
    seed : int
        Not negative.
    stream : int
        Another number, another noise: one for each channel.
    interval : callable
        Two absolute times in s -> the distance in s of points between which polynomials of the fifth degree give
        the smooth part; 0 where that is not known.
    """

    smooth: Callable[[Floats], Floats]
    noise_rms: float
    seed: int
    stream: int = 0
    interval: Callable[[float, float], float] = lambda start, stop: 0.0

    def __call__(self, times: Floats) -> Floats:
        """Volts at absolute times in s."""
        return self.smooth(times) + self.noise(times)

    def noise(self, times: Floats) -> Floats:
        """The noise alone, V: another acquisition, another noise, the same for the same sample times."""
        if self.noise_rms == 0 or times.size == 0:
            return np.zeros(times.shape)
        # an input stage that looks at delays of nanoseconds sees one noise
        stamp = math.floor(float(times.flat[0]) / _SAME_NOISE_S) & (2**63 - 1)
        words = [self.seed, stamp, times.size, self.stream] if self.stream else [self.seed, stamp, times.size]
        return self.noise_rms * np.random.default_rng(words).standard_normal(times.shape)


def with_detector_noise(
    signal: Callable[[Floats], Floats], rms: float, seed: int, stream: int = 0
) -> Callable[[Floats], Floats]:
    """Add white noise to a signal, the same for the same seed and the same sample times.

    Returns
    -------
    callable
        Absolute times in s -> V: a :class:`NoisySignal`, or `signal` itself without noise.
    """
    return NoisySignal(signal, rms, seed, stream) if rms else signal
