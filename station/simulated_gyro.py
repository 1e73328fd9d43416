"""The beat of a simulated ring laser on a turning table, as a function of absolute time.

The gyro follows d(phi)/dt = 2 pi K [W(t) - WL sin(phi + beta)], the lock-in equation. The rate on its axis,

    W(t) = table rate * cos(tilt) + earth rate on the axis at azimuth(t),

changes so little during one beat period that the solution for constant W holds with r and the beat frequency
following W(t):

    exp(i (phi + beta)) = i (r - u) / (1 - r u),    u = exp(i psi),
    d(psi)/dt = 2 pi K sqrt(W^2 - WL^2).

While the table turns steadily, sqrt(W^2 - WL^2) is periodic in the azimuth: it is expanded once in harmonics
of the azimuth and integrated term by term, so the phase is as exact after a day as after a second.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis import lockin_equation
from analysis.rotation import rate_on_axis

Array = NDArray[np.float64]

_AZIMUTHS = 1024  # points of one turn in the expansion; the series falls as (earth rate / rate)^k
_SLEW_POINTS = 4097
_REST_DPS = 1e-9


@dataclass(frozen=True)
class Segment:
    """A piece of the table's motion with constant acceleration.

    Attributes
    ----------
    start : float
        Absolute time, s.
    azimuth_deg, rate_dps, acceleration_dps2 : float
        At the start; the acceleration holds for the whole segment.
    """

    start: float
    azimuth_deg: float
    rate_dps: float
    acceleration_dps2: float = 0.0

    def azimuth_at(self, times: Array) -> Array:
        """Table azimuth in deg, not wrapped, at absolute times in s."""
        elapsed = times - self.start
        return self.azimuth_deg + (self.rate_dps + 0.5 * self.acceleration_dps2 * elapsed) * elapsed

    def rate_at(self, times: Array) -> Array:
        """Table rate in deg/s at absolute times in s."""
        return self.rate_dps + self.acceleration_dps2 * (times - self.start)


@dataclass(frozen=True)
class Gyro:
    """A ring laser gyro on a tilted axis.

    Attributes
    ----------
    scale_factor : float
        K, beat periods per degree.
    lock_in_rate : float
        WL, deg/s, not negative.
    backscatter_phase, readout_phase : float
        beta of the lock-in equation and the phase at which the detector reads the fringes, rad.
    tilt_deg, latitude_deg, north_azimuth_deg : float
        Angle between gyro axis and (vertical) table axis; site; table azimuth at which the axis points north.
    amplitude, offset : float
        Of the detector signal, V.
    start_phase : float
        psi at the start of the motion, rad.
    """

    scale_factor: float
    lock_in_rate: float
    backscatter_phase: float
    readout_phase: float
    tilt_deg: float
    latitude_deg: float
    north_azimuth_deg: float = 0.0
    amplitude: float = 1.0
    offset: float = 0.0
    start_phase: float = 0.0

    def axis_rate(self, table_rate_dps: ArrayLike, azimuth_deg: ArrayLike) -> Array:
        """Rate W on the gyro's axis in deg/s, from rate and azimuth of the table."""
        return rate_on_axis(
            table_rate_dps, self.tilt_deg, self.latitude_deg, np.subtract(azimuth_deg, self.north_azimuth_deg)
        )

    def beat_frequency(self, axis_rate: Array) -> Array:
        """Beat frequency in Hz with the sign of the rate; zero where the gyro is locked."""
        frequency = lockin_equation.beat_frequency(self.scale_factor, axis_rate, self.lock_in_rate)
        return np.asarray(np.sign(axis_rate) * frequency)


def harmonic_ratio(axis_rate: Array, lock_in_rate: float) -> Array:
    """Ratio r of successive harmonics of the beat, 1 at and below the threshold.

    Parameters
    ----------
    axis_rate : ndarray
        W, deg/s, either sign.
    lock_in_rate : float
        WL, deg/s.

    Returns
    -------
    ndarray
        r = A2/A1 = A3/A2 = ...
    """
    size = np.maximum(np.abs(axis_rate), lock_in_rate)
    return lockin_equation.harmonic_ratio(np.divide(lock_in_rate, size, out=np.zeros_like(size), where=size > 0))


def detector_signal(gyro: Gyro, axis_rate: Array, beat_phase: Array) -> Array:
    """Volts at the detector for given rate on the axis and slow beat phase.

    Parameters
    ----------
    gyro : Gyro
    axis_rate : ndarray, shape (...)
        W, deg/s.
    beat_phase : ndarray, shape (...)
        psi, rad, growing with positive and falling with negative rate.

    Returns
    -------
    ndarray, shape (...)
        Offset + amplitude * sin(phi + readout phase), V. A locked gyro rests where sin(phi + beta) = W/WL.
    """
    ratio = harmonic_ratio(axis_rate, gyro.lock_in_rate)
    rotating = np.exp(1j * np.where(axis_rate < 0, -beat_phase, beat_phase))
    denominator = 1.0 - ratio * rotating
    at_threshold = np.abs(denominator) < 1e-12
    fringe = 1j * (ratio - rotating) / np.where(at_threshold, 1.0, denominator)
    fringe = np.where(at_threshold, 1j, fringe)
    fringe = np.where(axis_rate < 0, np.conj(fringe), fringe)
    if gyro.lock_in_rate > 0:
        sine = np.clip(axis_rate / gyro.lock_in_rate, -1.0, 1.0)
        locked = np.abs(axis_rate) <= gyro.lock_in_rate
        fringe = np.where(locked, np.exp(1j * np.arcsin(sine)), fringe)
    turned = fringe * np.exp(1j * (gyro.readout_phase - gyro.backscatter_phase))
    return np.asarray(gyro.offset + gyro.amplitude * turned.imag, dtype=np.float64)


def beat_signal_on_table(gyro: Gyro, motion: Sequence[Segment], times: Array) -> Array:
    """Volts at the detector while the table moves.

    Parameters
    ----------
    gyro : Gyro
    motion : sequence of Segment
        In order of time; the last one goes on for ever, the first one also holds before its start.
    times : ndarray, shape (n,)
        Absolute times, s.

    Returns
    -------
    ndarray, shape (n,)
        V, without noise.
    """
    volts = np.empty_like(times)
    for segment, start_phase, inside in _split(gyro, tuple(motion), times):
        at = times[inside]
        rate = gyro.axis_rate(segment.rate_at(at), segment.azimuth_at(at))
        volts[inside] = detector_signal(gyro, rate, start_phase + _advance(gyro, segment, at))
    return volts


def axis_rate_on_table(gyro: Gyro, motion: Sequence[Segment], times: Array) -> Array:
    """Rate on the gyro's axis in deg/s while the table moves; arguments as :func:`beat_signal_on_table`."""
    rates = np.empty_like(times)
    for segment, _, inside in _split(gyro, tuple(motion), times):
        at = times[inside]
        rates[inside] = gyro.axis_rate(segment.rate_at(at), segment.azimuth_at(at))
    return rates


def with_detector_noise(signal: Callable[[Array], Array], rms: float, seed: int) -> Callable[[Array], Array]:
    """Add white noise to a signal, the same for the same seed and the same sample times.

    Parameters
    ----------
    signal : callable
        Absolute times in s -> V.
    rms : float
        V in each sample.
    seed : int
        Not negative.

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
        rng = np.random.default_rng([seed, stamp, times.size])
        return signal(times) + rms * rng.standard_normal(times.shape)

    return noisy


def _split(gyro: Gyro, motion: tuple[Segment, ...], times: Array) -> list[tuple[Segment, float, NDArray[np.intp]]]:
    """Sort times into segments: each with its phase at the start and the indices that fall into it."""
    starts = np.array([segment.start for segment in motion])
    which = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    phases = _start_phases(gyro, motion)
    return [(motion[i], phases[i], np.flatnonzero(which == i)) for i in np.unique(which)]


@lru_cache(maxsize=64)
def _start_phases(gyro: Gyro, motion: tuple[Segment, ...]) -> tuple[float, ...]:
    """Return psi at the start of each segment."""
    phases = [gyro.start_phase]
    for segment, following in itertools.pairwise(motion):
        phases.append(phases[-1] + float(_advance(gyro, segment, np.array([following.start]))[0]))
    return tuple(phases)


def _advance(gyro: Gyro, segment: Segment, times: Array) -> Array:
    """Advance of psi in rad since the start of the segment."""
    if segment.acceleration_dps2 != 0.0:
        return _advance_by_quadrature(gyro, segment, times)
    elapsed = times - segment.start
    if abs(segment.rate_dps) < _REST_DPS:
        rate = gyro.axis_rate(np.array([segment.rate_dps]), np.array([segment.azimuth_deg]))
        return np.asarray(2 * np.pi * gyro.beat_frequency(rate)[0] * elapsed)
    mean, orders, terms = _azimuth_series(gyro, segment.rate_dps)
    turn_rate = math.radians(segment.rate_dps)
    # the integral of exp(i k azimuth) over the time; expm1-like form keeps short times exact
    half = 0.5 * orders * turn_rate * elapsed[:, np.newaxis]
    middle = np.exp(1j * (orders * math.radians(segment.azimuth_deg % 360.0) + half))
    integral = elapsed[:, np.newaxis] * np.sinc(half / np.pi) * middle
    return np.asarray(2 * np.pi * (mean * elapsed + (integral @ terms).real))


@lru_cache(maxsize=64)
def _azimuth_series(gyro: Gyro, table_rate_dps: float) -> tuple[float, Array, NDArray[np.complex128]]:
    """Beat frequency over one turn as mean + Re sum terms * exp(i orders * azimuth)."""
    azimuth = np.arange(_AZIMUTHS) * (360.0 / _AZIMUTHS)
    rate = gyro.axis_rate(np.full(_AZIMUTHS, table_rate_dps), azimuth)
    spectrum = np.fft.rfft(gyro.beat_frequency(rate)) / _AZIMUTHS
    largest = max(float(np.abs(spectrum).max()), 1e-300)
    orders = np.flatnonzero(np.abs(spectrum[:-1]) > 1e-14 * largest)
    orders = orders[orders > 0]
    return float(spectrum[0].real), orders.astype(np.float64), 2.0 * spectrum[orders]


def _advance_by_quadrature(gyro: Gyro, segment: Segment, times: Array) -> Array:
    """Advance while the table slews: cumulative trapezoidal rule; slews are short."""
    if times.size == 0:
        return np.empty(0)
    end = max(float(times.max()), segment.start + 1e-9)
    begin = min(float(times.min()), segment.start)
    grid = np.unique(np.append(np.linspace(begin, end, _SLEW_POINTS), segment.start))
    frequency = gyro.beat_frequency(gyro.axis_rate(segment.rate_at(grid), segment.azimuth_at(grid)))
    steps = 0.5 * (frequency[1:] + frequency[:-1]) * np.diff(grid)
    phase = 2 * np.pi * np.concatenate([[0.0], np.cumsum(steps)])
    return np.interp(times, grid, phase) - np.interp(segment.start, grid, phase)
