"""Signals at the inputs of the oscilloscope, as functions of absolute time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.arrays import Floats
from analysis.ring_laser.beat import beat_phase_on_table
from analysis.ring_laser.detector import Detector, amplitudes_at, detector_signal, volts_between
from analysis.ring_laser.gyro import Gyro
from analysis.ring_laser.motion import Motion, split

UNSEEN = 5e-4
"""Of the amplitude: a twentieth of a level on a full screen."""

_SAME_NOISE_S = 20e-6
_POINTS_A_PERIOD = 6  # of the light, where nothing beats
_LEFT = 1e-4  # of the amplitude, by the polynomials between the points
_NODE_POLYNOMIAL = 16.9 / 720  # of six points at even steps, largest between the outer two, over 6!
_SHARPEST = 0.9  # ratio of successive harmonics


def beat_signal_on_table(gyro: Gyro, detector: Detector, motion: Sequence[Motion], times: Floats) -> Floats:
    """Volts at the detector while the table moves.

    Shapes: times (n,).
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
    """
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    reached = segments[pieces[0][0] : pieces[-1][0] + 1]
    return min(_smooth_interval(gyro, detector, segment) for segment in reached)


@lru_cache(maxsize=64)
def _smooth_interval(gyro: Gyro, detector: Detector, segment: Motion) -> float:
    """Of one piece of motion: polynomials are off by that of their nodes times the sixth derivative over 6!."""
    if _resting_volts(gyro, detector, segment) is not None:
        return 1.0 / (_POINTS_A_PERIOD * max(detector.pump_hz, 1.0))
    if segment.acceleration_dps2:
        return 0.0
    low, high, sense = _rates_in(gyro, segment)
    if low <= gyro.lock_in_rate or gyro.harmonic_ratio(np.array(low)) >= _SHARPEST or not sense:
        return 0.0
    # harmonics are largest at the slowest rate, or, behind a high-pass, at the fastest
    slow, fast = (np.abs(amplitudes_at(gyro, detector, sense * rate)[1:]) for rate in (low, high))
    amplitudes = np.zeros(max(slow.size, fast.size))
    amplitudes[: slow.size] = slow
    amplitudes[: fast.size] = np.maximum(amplitudes[: fast.size], fast)
    if not amplitudes.any():  # there is light, and no beat
        return 1.0 / (_POINTS_A_PERIOD * max(detector.pump_hz, 1.0))
    beats = gyro.scale_factor * high * np.arange(1, amplitudes.size + 1) + abs(gyro.ripple_hz)
    swings = amplitudes @ (beats + detector.pump_hz) ** 6 + abs(detector.offset) * detector.pump_hz**6
    sixth_derivative = float(amplitudes @ beats**6 + detector.pump_ripple * swings) * (2 * math.pi) ** 6
    return float((_LEFT * amplitudes.max() / (_NODE_POLYNOMIAL * sixth_derivative)) ** (1 / 6))


def signal_bounds(
    gyro: Gyro, detector: Detector, motion: Sequence[Motion], start: float, stop: float
) -> tuple[float, float]:
    """Volts that the signal of the detector does not leave between two absolute times in s; inf: not known."""
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    bounds = [_bounds(gyro, detector, piece) for piece in segments[pieces[0][0] : pieces[-1][0] + 1]]
    return min(low for low, _ in bounds), max(high for _, high in bounds)


@lru_cache(maxsize=64)
def _bounds(gyro: Gyro, detector: Detector, segment: Motion) -> tuple[float, float]:
    """Of one piece of motion."""
    low, high = -math.inf, math.inf
    if (resting := _resting_volts(gyro, detector, segment)) is not None:
        low = high = resting
    elif not segment.acceleration_dps2:
        slowest, fastest, sense = _rates_in(gyro, segment)
        if sense and slowest > gyro.lock_in_rate:
            low, high = volts_between(gyro, detector, slowest, fastest, sense)
    swing = detector.pump_ripple * max(abs(low), abs(high)) if detector.pump_ripple else 0.0
    return low - swing, high + swing


def signal_above(
    gyro: Gyro, detector: Detector, motion: Sequence[Motion], corner_hz: float, start: float, stop: float
) -> Callable[[Floats], Floats] | None:
    """The signal behind an AC coupling of one pole, between two absolute times in s.

    Light and rate that swing a little do not show in what the coupling does: their share of it is left out.
    """
    segments = tuple(motion)
    pieces = split(segments, np.array([start, stop]))
    if len(pieces) > 1 or not _coupling_shows_no_swing(gyro, detector, segments[pieces[0][0]], corner_hz):
        return None
    coupled = replace(detector, coupling_hz=corner_hz, pump_ripple=0.0)

    def volts(times: Floats) -> Floats:
        beat = beat_signal_on_table(gyro, coupled, segments, times)
        if not detector.pump_ripple:
            return beat
        swing = detector.swing(times)
        return np.asarray(
            beat * swing + detector.offset * (swing - 1)
        )  # what swings faster than the corner passes

    return volts


@lru_cache(maxsize=64)
def _coupling_shows_no_swing(gyro: Gyro, detector: Detector, segment: Motion, corner_hz: float) -> bool:
    """Whether a beat goes on steadily enough to know it behind an AC coupling."""
    if not _smooth_interval(gyro, detector, segment):
        return False
    if _resting_volts(gyro, detector, segment) is not None:
        return not detector.pump_ripple
    slowest = float(gyro.beat_frequency(np.array([_rates_in(gyro, segment)[0]]))[0])
    sideways = (
        gyro.scale_factor * gyro.ripple_dps * corner_hz / slowest**2
    )  # of the side bands that the ripple makes
    faint = detector.pump_ripple < 2 * UNSEEN and detector.pump_hz > 2 * corner_hz
    return sideways < UNSEEN and (faint or not detector.pump_ripple)


def _rates_in(gyro: Gyro, segment: Motion) -> tuple[float, float, int]:
    """Slowest and fastest rate on the axis in a turn of the table, deg/s, and their sense; 0: both."""
    rates = gyro.axis_rate(segment.rate_dps, np.arange(0.0, 360.0, 10.0))
    sizes, ripple = np.abs(rates), abs(gyro.ripple_dps)
    senses = np.sign(rates)
    sense = int(senses[0]) if (senses == senses[0]).all() else 0
    return float(np.min(sizes)) - ripple, float(np.max(sizes)) + ripple, sense


@dataclass(frozen=True)
class NoisySignal:
    """A signal at an input with white noise: its two parts can be looked at one by one."""

    smooth: Callable[[Floats], Floats]  # absolute times in s -> V, without noise
    noise_rms: float  # V in each sample
    seed: int  # not negative
    stream: int = 0  # another number, another noise: one for each channel
    # two absolute times in s -> the distance in s of points between which polynomials of the fifth degree give the
    # smooth part; 0 where that is not known
    interval: Callable[[float, float], float] = lambda start, stop: 0.0
    # two absolute times in s -> V that the smooth part does not leave between them
    bounds: Callable[[float, float], tuple[float, float]] = lambda start, stop: (-math.inf, math.inf)
    # A corner in Hz and two absolute times in s -> the smooth part behind a high-pass of one pole, between these
    # times; ``None`` where that is not known
    above: Callable[[float, float, float], Callable[[Floats], Floats] | None] = lambda corner, start, stop: None
    # starts (absolute, s) and times behind each, a corner in Hz (0: none) and its settling time in s -> the mean
    # of the smooth part, behind that high-pass, over all starts; ``None`` where that is not known
    mean: Callable[[Floats, Floats, float, float], Floats | None] = lambda starts, times, corner, settling: None

    def __call__(self, times: Floats) -> Floats:
        """Volts at absolute times in s."""
        return self.smooth(times) + self.noise(times)

    def noise(self, times: Floats) -> Floats:
        """The noise alone, V: another acquisition, another noise, the same for the same sample times."""
        if self.noise_rms == 0 or times.size == 0:
            return np.zeros(times.shape)
        # an input stage that looks at delays of nanoseconds sees one noise
        stamp = math.floor(float(times.flat[0]) / _SAME_NOISE_S) & (2**63 - 1)
        numbers = (self.seed, stamp, times.size, self.stream) if self.stream else (self.seed, stamp, times.size)
        generator = np.random.Generator(np.random.PCG64(_words(*numbers)))
        return self.noise_rms * generator.standard_normal(times.shape)


def _words(*numbers: int) -> NDArray[np.uint32]:
    """The seed that NumPy makes of these numbers, none of them negative: their 32-bit words, the lowest first."""
    words = []
    for number in numbers:
        words.append(number & 0xFFFFFFFF)
        while number := number >> 32:
            words.append(number & 0xFFFFFFFF)
    return np.array(words, dtype=np.uint32)


def with_detector_noise(
    signal: Callable[[Floats], Floats], rms: float, seed: int, stream: int = 0
) -> Callable[[Floats], Floats]:
    """Add white noise to a signal, the same for the same seed and the same sample times."""
    return NoisySignal(signal, rms, seed, stream) if rms else signal
