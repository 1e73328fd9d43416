"""A simulated ring laser gyro: what its beat does at a given rate on its axis."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from analysis import lockin_equation
from analysis.arrays import Bools, Complexes, Floats, Indices
from analysis.rotation import rate_on_axis
from analysis.two_mode_laser import Winking

_SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True)
class Gyro:
    """A ring laser gyro on a tilted axis."""

    scale_factor: float  # k, beat periods per degree, at time zero
    lock_in_rate: float  # WL, deg/s, not negative
    backscatter_phase: float  # beta of the lock-in equation, rad
    # angle between gyro axis and (vertical) table axis; site; table azimuth at which the axis points north
    tilt_deg: float
    latitude_deg: float
    north_azimuth_deg: float = 0.0
    start_phase: float = 0.0  # phase of the beat at the start of the motion, rad
    scale_factor_drift_ppm_per_hour: float = 0.0  # K grows by so much
    # A swing of the rate on the axis. Its frequency has to be far below that of the beat.
    ripple_dps: float = 0.0
    ripple_hz: float = 0.0
    winking: Winking | None = None  # gain saturation; ``None``: the lock-in equation holds

    def axis_rate(
        self, table_rate_dps: ArrayLike, azimuth_deg: ArrayLike, ripple_phase: ArrayLike = 0.0
    ) -> Floats:
        """Rate W on the gyro's axis in deg/s, from rate and azimuth of the table and the phase of the ripple."""
        azimuth = np.subtract(azimuth_deg, self.north_azimuth_deg)
        steady = rate_on_axis(table_rate_dps, self.tilt_deg, self.latitude_deg, azimuth)
        return np.asarray(steady + self.ripple_dps * np.sin(ripple_phase)) if self.ripple_dps else steady

    def ripple_phase(self, times: ArrayLike) -> Floats:
        """Phase of the ripple in rad at absolute times in s."""
        return np.asarray(2 * np.pi * np.mod(self.ripple_hz * np.asarray(times, dtype=np.float64), 1.0))

    def drift(self, times: ArrayLike) -> Floats:
        """K at absolute times in s over K at time zero."""
        return np.asarray(1.0 + self.drift_per_s * np.asarray(times, dtype=np.float64))

    @property
    def drift_per_s(self) -> float:
        """Relative growth of K in 1/s."""
        return 1e-6 * self.scale_factor_drift_ppm_per_hour / _SECONDS_PER_HOUR

    def beat_frequency(self, axis_rate: Floats) -> Floats:
        """Beat frequency in Hz at time zero, with the sign of the rate; zero where the gyro is locked."""
        frequency = lockin_equation.beat_frequency(self.scale_factor, axis_rate, self.lock_in_rate)
        turning = ~self.locked(axis_rate)
        if self.winking is not None:
            frequency[turning] *= self.winking.frequency_factor(axis_rate[turning])
        return np.asarray(np.sign(axis_rate) * frequency)

    def harmonic_ratio(self, axis_rate: Floats) -> Floats:
        """Ratio r of successive harmonics of the beat, 1 at and below the threshold."""
        size = np.maximum(np.abs(axis_rate), self.lock_in_rate)
        over_rate = np.divide(self.lock_in_rate, size, out=np.zeros_like(size), where=size > 0)
        return lockin_equation.harmonic_ratio(over_rate)

    def fringe(self, axis_rate: Floats, beat_phase: Floats) -> Complexes:
        """exp(i (phi + beta)) for given rate on the axis and slow beat phase."""
        # Shapes: axis_rate (...), beat_phase (...).
        ratio = self.harmonic_ratio(axis_rate)
        rotating = np.exp(1j * np.where(axis_rate < 0, -beat_phase, beat_phase))
        denominator = 1.0 - ratio * rotating
        at_threshold = np.abs(denominator) < 1e-12
        fringe = 1j * (ratio - rotating) / np.where(at_threshold, 1.0, denominator)
        fringe = np.where(at_threshold, 1j, fringe)
        fringe = np.where(axis_rate < 0, np.conj(fringe), fringe)
        locked = self.locked(axis_rate)
        if np.any(locked):
            sine = np.clip(axis_rate / self.lock_in_rate, -1.0, 1.0)
            fringe = np.where(locked, np.exp(1j * np.arcsin(sine)), fringe)
        return np.asarray(fringe, dtype=np.complex128)

    def without_winking(self) -> Gyro:
        """The same gyro with a laser that follows at once."""
        return self if self.winking is None else replace(self, winking=None)

    def locked(self, axis_rate: Floats) -> Bools:
        """Where the beat stands still."""
        return np.asarray((self.lock_in_rate > 0) & (np.abs(axis_rate) <= self.lock_in_rate))


# --------------------
# The phase of the beat of a gyro on a turning table, as a function of absolute time.
#
# The gyro follows d(phi)/dt = 2 pi K [W(t) - WL sin(phi + beta)], the lock-in equation. The rate on its axis,
#
#     W(t) = table rate * cos(tilt) + earth rate on the axis at azimuth(t) + ripple,
#
# changes so little during one beat period that the solution for constant W holds with r and the beat frequency
# following W(t):
#
#     exp(i (phi + beta)) = i (r - u) / (1 - r u),    u = exp(i psi),
#     d(psi)/dt = 2 pi K sqrt(W^2 - WL^2).
#
# While the table turns steadily, sqrt(W^2 - WL^2) is periodic in the azimuth and in the phase of the ripple: it is
# expanded once in harmonics of both and integrated term by term, so the phase is as exact after a day as after a
# second


_AZIMUTHS = 1024  # points of one turn in the expansion; the series falls as (earth rate / rate)^k
_RIPPLE_PHASES = 64
_SLEW_POINTS = 4097
_REST_DPS = 1e-9
_NEGLIGIBLE = 1e-13
_RADIANS_A_PIECE = 2.0  # of the fastest swing; 12 Chebyshev points then leave less than rounding
_LONGEST_PIECE = 100.0  # s
_KEPT_PIECES = 1000
_AHEAD = 8
_NODES = np.cos(np.pi * (np.arange(12) + 0.5) / 12)[::-1]
_TO_SERIES = np.linalg.inv(chebyshev.chebvander(_NODES, 11)).T


def beat_phase_on_table(gyro: Gyro, motion: Sequence[RateMotion], times: Floats) -> tuple[Floats, Floats]:
    """Rate on the axis and phase of the beat while the table moves."""
    # Shapes: times (n,).
    segments = tuple(motion)
    start_phases = _start_phases(gyro, segments)
    rates, phases = np.empty_like(times), np.empty_like(times)
    for number, inside in split(segments, times):
        found = _rate_and_advance(gyro, segments, number, times[inside])
        rates[inside], phases[inside] = found[0], start_phases[number] + found[1]
    return rates, phases


def axis_rate_on_table(gyro: Gyro, motion: Sequence[RateMotion], times: Floats) -> Floats:
    """Rate on the gyro's axis in deg/s while the table moves; arguments as :func:`beat_phase_on_table`."""
    segments, rates = tuple(motion), np.empty_like(times)
    for number, inside in split(segments, times):
        rates[inside] = _rate(gyro, segments[number], times[inside])
    return rates


def _rate_and_advance(gyro: Gyro, motion: tuple[RateMotion, ...], number: int, times: Floats) -> Floats:
    """Rate on the axis and advance of psi since the start of a segment, (2, n)."""
    # Both follow the turn of the table and the ripple, far slower than the samples of a record: they are worked
    # out at a few Chebyshev points of pieces of time, once, and interpolated, to rounding.
    segment = motion[number]
    length = _piece_length(gyro, segment)
    if not length:
        return _exactly(gyro, motion, number, times)
    first, last = (math.floor((float(end) - segment.start) / length) for end in (times.min(), times.max()))
    if 2 * (last - first + 1) * _NODES.size > times.size:
        return _exactly(gyro, motion, number, times)
    lines, series = _pieces(gyro, segment, first, last)
    place = (times - segment.start) / length
    which = np.minimum(np.maximum(np.floor(place), first), last)
    inside, pieces = 2 * (place - (which + 0.5)), (which - first).astype(np.intp)
    if (pieces[1:] >= pieces[:-1]).all():
        return _by_pieces(pieces, inside, lines, series)
    order, found = np.argsort(pieces, kind="stable"), np.empty((2, times.size))
    found[:, order] = _by_pieces(pieces[order], inside[order], lines, series)
    return found


def _by_pieces(pieces: Indices, places: Floats, lines: Floats, series: Floats) -> Floats:
    """Lines and series (as `_pieces` gives them) of rising pieces, at places in them between -1 and 1: (2, n)."""
    chebyshevs, twice = np.empty((_NODES.size, places.size)), 2 * places
    chebyshevs[0], chebyshevs[1] = 1.0, places
    for order in range(2, _NODES.size):
        np.multiply(twice, chebyshevs[order - 1], out=chebyshevs[order])
        chebyshevs[order] -= chebyshevs[order - 2]
    found = np.empty((2, places.size))
    ends = np.searchsorted(pieces, np.arange(series.shape[-1] + 1)).tolist()
    for piece, (start, stop) in enumerate(pairwise(ends)):
        np.matmul(series[..., piece].T, chebyshevs[:, start:stop], out=found[:, start:stop])
    # the line is far larger: what it adds comes last, and is rounded once
    constants, slopes = lines.take(pieces, axis=-1) if series.shape[-1] > 1 else lines
    return np.asarray(constants + slopes * places + found)


def _exactly(gyro: Gyro, motion: tuple[RateMotion, ...], number: int, times: Floats) -> Floats:
    return np.stack([_rate(gyro, motion[number], times), _advance(gyro, motion, number, times)])


def _pieces(gyro: Gyro, segment: RateMotion, first: int, last: int) -> tuple[Floats, Floats]:
    """Straight lines (2, 2, n) and Chebyshev series (order, 2, n) of what is left, of n pieces of time."""
    # Without the line what is left is small, and so is its rounding.
    known = _known_pieces(gyro, segment)
    missing = [piece for piece in range(first, last + 1) if piece not in known]
    if missing:
        if missing[0] - 1 in known:  # who goes on from piece to piece wants the next ones too
            missing += range(last + 1, last + 1 + _AHEAD)
        if len(known) > _KEPT_PIECES:
            known.clear()
            missing = list(range(first, last + 1))
        length = _piece_length(gyro, segment)
        middles, elapsed = segment.start + length * (np.array(missing) + 0.5), 0.5 * length * _NODES
        times = middles[:, np.newaxis] + elapsed
        cycles = _cycles(gyro, segment, middles, elapsed)
        phases = _advance(gyro, (segment,), 0, middles)[:, np.newaxis] + 2 * np.pi * cycles
        at_nodes = np.stack([_rate(gyro, segment, times.ravel()).reshape(times.shape), phases])
        slopes = (at_nodes[..., -1:] - at_nodes[..., :1]) / (_NODES[-1] - _NODES[0])
        means = at_nodes.mean(axis=-1, keepdims=True)
        series = (at_nodes - means - slopes * _NODES) @ _TO_SERIES
        lines = np.stack([means, slopes])[..., 0]
        for place, piece in enumerate(missing):
            known[piece] = lines[..., place, np.newaxis], series[:, place].T[..., np.newaxis]
    found = [known[piece] for piece in range(first, last + 1)]
    if len(found) == 1:
        return found[0]
    return np.concatenate([line for line, _ in found], axis=-1), np.concatenate([one for _, one in found], axis=-1)


@lru_cache(maxsize=8)
def _known_pieces(gyro: Gyro, segment: RateMotion) -> dict[int, tuple[Floats, Floats]]:
    """Those that were worked out already, by their number."""
    return {}


@lru_cache(maxsize=64)
def _piece_length(gyro: Gyro, segment: RateMotion) -> float:
    """Length in s of pieces of time that are short beside the turn of the table and the ripple; 0 for a slew."""
    if segment.acceleration_dps2 != 0.0:
        return 0.0
    _, orders, _ = _frequency_series(gyro, *_turning(segment))
    turn, ripple = np.abs(orders).max(axis=0, initial=1.0)
    fastest = float(turn * math.radians(abs(segment.rate_dps)) + ripple * 2 * np.pi * gyro.ripple_hz)
    return min(_RADIANS_A_PIECE / fastest, _LONGEST_PIECE) if fastest > 0 else _LONGEST_PIECE


def _rate(gyro: Gyro, segment: RateMotion, times: Floats) -> Floats:
    return gyro.axis_rate(segment.rate_at(times), segment.azimuth_at(times), gyro.ripple_phase(times))


@lru_cache(maxsize=16)
def _start_phases(gyro: Gyro, motion: tuple[RateMotion, ...]) -> tuple[float, ...]:
    """Return psi at the start of each segment."""
    phases = [gyro.start_phase]
    for number, following in enumerate(motion[1:]):
        phases.append(phases[-1] + float(_advance(gyro, motion, number, np.array([following.start]))[0]))
    return tuple(phases)


def _advance(gyro: Gyro, motion: tuple[RateMotion, ...], number: int, times: Floats) -> Floats:
    """Advance of psi in rad since the start of a segment."""
    segment = motion[number]
    if segment.acceleration_dps2 != 0.0:
        return np.interp(times, *_slew_phase(gyro.without_winking(), segment, motion[number + 1].start))
    return np.asarray(2 * np.pi * _cycles(gyro, segment, np.array([segment.start]), times - segment.start)[0])


def _cycles(gyro: Gyro, segment: RateMotion, starts: Floats, elapsed: Floats) -> Floats:
    """Advance of psi in turns from each of some starts in a steady segment, after each of some times: (m, n)."""
    turn_rate = segment.rate_dps if abs(segment.rate_dps) >= _REST_DPS else 0.0
    mean, orders, terms = _frequency_series(gyro, *_turning(segment))
    speeds = orders @ np.array([math.radians(turn_rate), 2 * np.pi * gyro.ripple_hz])
    at_start = np.stack([np.radians(segment.azimuth_at(starts) % 360.0), gyro.ripple_phase(starts)])
    begun = terms * np.exp(1j * (orders @ at_start).T)
    cycles = mean * elapsed + (begun @ _integral(speeds, elapsed[:, np.newaxis]).T).real
    if growth := gyro.drift_per_s:
        moment = mean * elapsed**2 / 2 + (begun @ _first_moment(speeds, elapsed[:, np.newaxis]).T).real
        cycles = cycles * (1.0 + growth * starts[:, np.newaxis]) + growth * moment
    return np.asarray(cycles)


def _turning(segment: RateMotion) -> tuple[float, float | None]:
    """Rate of a table that turns, and where one rests that does not."""
    return segment.rate_dps, segment.azimuth_deg % 360.0 if abs(segment.rate_dps) < _REST_DPS else None


def _integral(speeds: Floats, elapsed: Floats) -> Complexes:
    """Integral of exp(i speed t) from 0 to the time elapsed; this form keeps short times exact."""
    half = 0.5 * speeds * elapsed
    turned = np.exp(1j * half)
    sinc = np.divide(turned.imag, half, out=np.ones_like(half), where=half != 0.0)
    return np.asarray(elapsed * sinc * turned)


def _first_moment(speeds: Floats, elapsed: Floats) -> Complexes:
    """Integral of t exp(i speed t) from 0 to the time elapsed, good to eight digits."""
    turned = speeds * elapsed
    small = np.abs(turned) < 1e-3
    safe = np.where(small, 1.0, turned)
    whole = (np.exp(1j * safe) * (1.0 - 1j * safe) - 1.0) / safe**2
    return np.asarray(elapsed**2 * np.where(small, 0.5 + 1j * turned / 3.0, whole))


@lru_cache(maxsize=64)
def _frequency_series(
    gyro: Gyro, table_rate_dps: float, resting_at_deg: float | None
) -> tuple[float, Floats, Complexes]:
    """Beat frequency as mean + Re sum terms * exp(i (k azimuth + l ripple phase)), orders being the (k, l)."""
    rows = _AZIMUTHS if resting_at_deg is None else 1
    columns = _RIPPLE_PHASES if gyro.ripple_dps else 1
    azimuth = np.arange(rows) * (360.0 / rows) + (resting_at_deg or 0.0)
    ripple = np.arange(columns) * (2 * np.pi / columns)
    rate = gyro.axis_rate(np.full((rows, columns), table_rate_dps), azimuth[:, np.newaxis], ripple)
    # the half with k > 0, and of k = 0 the half with l > 0: the frequency is real
    spectrum = np.fft.fft2(gyro.beat_frequency(rate)) / rate.size
    k = np.fft.fftfreq(rows, 1 / rows)[:, np.newaxis] + np.zeros(columns)
    el = np.fft.fftfreq(columns, 1 / columns) + np.zeros((rows, 1))
    largest = max(float(np.abs(spectrum).max()), 1e-300)
    kept = ((k > 0) | ((k == 0) & (el > 0))) & (np.abs(spectrum) > _NEGLIGIBLE * largest)
    orders = np.stack([k[kept], el[kept]], axis=-1)
    return float(spectrum[0, 0].real), orders, np.asarray(2.0 * spectrum[kept])


@lru_cache(maxsize=8)
def _slew_phase(gyro: Gyro, segment: RateMotion, end: float) -> tuple[Floats, Floats]:
    """Times in a slew and psi since its start: cumulative trapezoidal rule; nobody measures in a slew."""
    grid = np.linspace(segment.start, end, _SLEW_POINTS)
    frequency = gyro.beat_frequency(_rate(gyro, segment, grid)) * gyro.drift(grid)
    steps = 0.5 * (frequency[1:] + frequency[:-1]) * np.diff(grid)
    return grid, 2 * np.pi * np.concatenate([[0.0], np.cumsum(steps)])


# --------------------
# A gyro whose body dithers: no beat is steady, and the phase is integrated in time where it is looked at


@dataclass(frozen=True)
class Dither:
    """Motion of the body: amplitude cos(2 pi f t), with another amplitude in every period."""

    rate: float  # peak, deg/s
    frequency: float  # Hz
    noise: float = 0.0  # of the amplitude, as a share of it
    seed: int = 0

    def rate_at(self, times: Floats) -> Floats:
        """Rate of the body in deg/s at absolute times in s."""
        cycles = times * self.frequency
        period = np.floor(cycles)
        whole, place = period.astype(np.int64), cycles - period
        first = int(whole.min()) - 1
        needed = range(first, int(whole.max()) + 3)
        draws = [np.random.default_rng([self.seed, number & 0xFFFFFFFF]).standard_normal() for number in needed]
        known = self.rate * (1 + self.noise * np.array(draws))
        before, begin, end, after = (known[whole - first + n] for n in (-1, 0, 1, 2))
        slopes = (end - before) / 2, (after - begin) / 2
        bent = begin + place * slopes[0] + place**2 * (3 * (end - begin) - 2 * slopes[0] - slopes[1])
        bent += place**3 * (2 * (begin - end) + slopes[0] + slopes[1])
        return np.asarray(bent * np.cos(2 * np.pi * place))


class DitheredFringe:
    """exp(i (phi + beta)) (1 + m) of a dithered gyro, m being the light that follows the coupling (2.12).

    Picard's rounds for phi = integral of 2 pi K [W - WL sin(phi + beta)] over a stretch about the times that are
    asked for, at `_POINTS_A_BEAT` steps of the fastest beat. The next stretch goes on from it; after a pause of
    more than a stretch the phase is another one.
    """

    def __init__(self, gyro: Gyro, dither: Dither, bias: Callable[[Floats], Floats], pole_hz: float) -> None:
        self._gyro, self._dither, self._bias, self._pole_hz = gyro, dither, bias, pole_hz
        self._times = self._phases = self._light = np.zeros(1)

    def __call__(self, times: Floats) -> Complexes:
        """Of absolute times in s, behind the receiver's pole; without lock-in where they span too much."""
        first, last = float(times.min()), float(times.max())
        if not (self._times[0] <= first and last <= self._times[-1]):
            self._go_on(first, last)
        phase = np.interp(times, self._times, self._phases) + self._gyro.backscatter_phase
        light = np.interp(times, self._times, self._light)
        beat = self._gyro.scale_factor * (self._dither.rate_at(times) + self._bias(times))
        return np.asarray(np.exp(1j * phase) * (1 + light) / (1 + 1j * beat / self._pole_hz))

    def _go_on(self, first: float, last: float) -> None:
        from scipy.integrate import cumulative_trapezoid  # heavy, as is the next, and few gyros dither
        from scipy.signal import lfilter

        gyro, reach = self._gyro, max(last - first, 2 / self._dither.frequency)
        begin, end = first - reach, last + 3 * reach
        fastest = gyro.scale_factor * (self._dither.rate * (1 + 4 * self._dither.noise) + gyro.lock_in_rate)
        points = min(math.ceil((end - begin) * fastest * _POINTS_A_BEAT), _MOST_POINTS)
        times, step = np.linspace(begin, end, points, retstep=True)
        start = float(np.interp(begin, self._times, self._phases))
        if not self._times[0] <= begin <= self._times[-1]:
            draw = np.random.default_rng([self._dither.seed, int(begin * 1e6) & 0xFFFFFFFF])
            start = float(draw.uniform(0, 2 * np.pi))
        bias = np.interp(times, times[[0, -1]], self._bias(times[[0, -1]]))
        free = start + 2 * np.pi * gyro.scale_factor * cumulative_trapezoid(
            self._dither.rate_at(times) + bias, dx=step, initial=0
        )
        pull = 2 * np.pi * gyro.scale_factor * gyro.lock_in_rate * (points < _MOST_POINTS)
        phases, light = free, np.zeros(points)
        for _ in range(_PICARD_ROUNDS):
            coupled = np.sin(phases + gyro.backscatter_phase)
            change = free - pull * cumulative_trapezoid(coupled, dx=step, initial=0) - phases
            phases = phases + change
            if np.max(np.abs(change)) < _PICARD_ENDS:
                break
        if gyro.winking is not None and pull:
            corner = 2 * np.pi * gyro.winking.gain_corner_hz
            kept = math.exp(-corner * step)
            drive = pull / corner * (1 - kept) * np.cos(phases + gyro.backscatter_phase)
            light = np.asarray(lfilter([1.0], [1.0, -kept], drive))
        self._times, self._phases, self._light = times, phases, light


_POINTS_A_BEAT, _MOST_POINTS = 24, 4_000_000
_PICARD_ROUNDS, _PICARD_ENDS = 60, 1e-7  # rad


# --------------------
# The motion of the rate table, piece by piece


Array = NDArray[np.float64]


class RateMotion(Protocol):
    """A piece of the table's motion with constant acceleration, from an absolute time `start` (s) on.

    Any object with these attributes will do, as long as it does not change: phases that it led to are kept.
    """

    def __hash__(self) -> int:
        """Of its values."""

    @property
    def start(self) -> float:
        """Absolute time, s."""

    @property
    def azimuth_deg(self) -> float:
        """Azimuth at the start."""

    @property
    def rate_dps(self) -> float:
        """Rate at the start."""

    @property
    def acceleration_dps2(self) -> float:
        """Acceleration of the whole piece."""

    def azimuth_at(self, times: Array) -> Array:
        """Table azimuth in deg, not wrapped, at absolute times in s."""

    def rate_at(self, times: Array) -> Array:
        """Table rate in deg/s at absolute times in s."""


Inside = NDArray[np.intp] | slice


def split(motion: tuple[RateMotion, ...], times: Array) -> list[tuple[int, Inside]]:
    """Sort times into pieces: number of the piece, and the indices of the times that fall into it."""
    # Shapes: times (n,).
    if times.size == 0:
        return []
    starts = [piece.start for piece in motion]
    first, last = (max(bisect.bisect_right(starts, t) - 1, 0) for t in (float(times.min()), float(times.max())))
    if first == last:
        return [(first, slice(None))]
    which = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    return [(int(i), np.flatnonzero(which == i)) for i in np.unique(which)]
