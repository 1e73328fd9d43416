"""The beat of a ring laser whose intensities answer to the backscatter ("winking") with finite speed.

Two beams of intensity I1, I2 (1 without backscatter) and beat phase psi obey the semiclassical equations of a
two-mode ring laser (Aronowitz; Spreeuw et al., Phys. Rev. A 42, 4315 (1990)):

    d(ln I1)/dt = G1 + 2 a2 sqrt(I2/I1) cos(psi + eps/2),   G1 = g [J1 (1 - I1) + xi J2 (1 - I2)]/(1 + xi)
    d(ln I2)/dt = G2 + 2 a1 sqrt(I1/I2) cos(psi - eps/2),   G2 = g [J2 (1 - I2) + xi J1 (1 - I1)]/(1 + xi)   (1)
    d(psi)/dt   = 2 pi K W + h (G1 - G2)/2 - a1 sqrt(I1/I2) sin(psi - eps/2) - a2 sqrt(I2/I1) sin(psi + eps/2)

g relaxation rate of the common intensity (rad/s; g/2 pi is the gain corner), xi cross over self saturation, a1 and
a2 backscatter of the beams (rad/s), eps the sum of their phases. Beams are unequal by J = 1 +- imbalance, and what
saturates the gain of a beam turns its frequency by h (dispersion of the gain: pulling off the centre of the line).
With infinite g this is the lock-in equation with

    2 pi K WL exp(i beta) = a1 (1 - i h) exp(-i eps/2) + a2 (1 + i h) exp(i eps/2).                    (2)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial

from analysis.arrays import Bools, Complexes, Floats, Indices, NoFit

POINTS = 512
"""Of one beat period; harmonics up to half of it, far more than a gyro at 1.05 times its threshold shows."""

STANDSTILL = 1e-4
"""A phase that turns by less than this share of its free speed counts as locked; no integrator gets through."""

FEWEST = 33  # points of the phase to begin with; twice as many until the last harmonics are `NEGLIGIBLE_LINE`

FEWEST_LINES = 16  # on either side of a spectrum to begin with, in the same way
NEGLIGIBLE_LINE = 1e-13
NUMBERS = 7  # of a laser
ROUNDS = 30
LONGEST_STEP = 0.5
LAST_HARMONIC = 1e-8  # share by which the first harmonic that is left out would count: 0.002 u in what is seen
CONVERGED = 1e-6  # Newton's method squares its error: the next step would be rounding

DETOUR = (4.0, 2.0, 1.5, 1.2, 1.1, 1.05, 1.02, 1.01, 1.0)
"""Rates, over the one wanted, by which a solution is reached that Newton's method does not find at once."""


@dataclass(frozen=True)
class TwoModeLaser:
    """Ring laser of equations (1)."""

    scale_factor: float  # k, pulses per degree
    backscatter: tuple[float, float]  # (float, float): a1 and a2, rad/s
    phase_sum: float  # eps, rad
    gain_rate: float  # g, rad/s
    cross_saturation: float  # xi, 0 <= xi < 1
    beam_imbalance: float = 0.0  # (J1 - J2)/2, J1 + J2 = 2
    gain_dispersion: float = 0.0  # h

    def __post_init__(self) -> None:
        if not np.isfinite([self.scale_factor, *self.numbers]).all():
            raise ValueError("every parameter of the laser must be finite")
        if self.scale_factor <= 0 or self.gain_rate <= 0 or min(self.backscatter) < 0:
            raise ValueError("scale_factor and gain_rate must be positive, backscatter must not be negative")
        if not 0 <= self.cross_saturation < 1:
            raise ValueError(f"cross_saturation must be at least 0 and below 1, not {self.cross_saturation!r}")
        if abs(self.beam_imbalance) >= 1:
            raise ValueError(f"beam_imbalance must be between -1 and 1, not {self.beam_imbalance!r}")

    @property
    def coupling(self) -> complex:
        """Right side of equation (2), rad/s."""
        a1, a2 = np.multiply(self.backscatter, 1 + 1j * self.gain_dispersion * np.array([-1.0, 1.0]))
        return complex(a1 * np.exp(-0.5j * self.phase_sum) + a2 * np.exp(0.5j * self.phase_sum))

    @property
    def numbers(self) -> Floats:
        """a1, a2, eps/2, xi, g, imbalance and h, (`NUMBERS`,)."""
        of_gain = self.cross_saturation, self.gain_rate, self.beam_imbalance, self.gain_dispersion
        return np.array([*self.backscatter, self.phase_sum / 2, *of_gain])

    @property
    def lock_in_rate(self) -> float:
        """WL of equation (2), deg/s."""
        return abs(self.coupling) / (2 * np.pi * self.scale_factor)

    @property
    def backscatter_phase(self) -> float:
        """beta of equation (2), rad."""
        return float(np.angle(self.coupling))


def symmetric_laser(
    lock_in_rate: float,
    *,
    scale_factor: float,
    gain_corner_hz: float,
    phase_sum: float = 0.0,
    cross_saturation: float = 0.5,
    backscatter_ratio: float = 1.0,
    beam_imbalance: float = 0.0,
    gain_dispersion: float = 0.0,
) -> TwoModeLaser:
    """Laser that locks at a given rate (deg/s), its backscatter a2 over a1 1 where nobody says otherwise."""
    of_gain = 2 * np.pi * gain_corner_hz, cross_saturation, beam_imbalance, gain_dispersion
    unit = TwoModeLaser(scale_factor, (1.0, backscatter_ratio), phase_sum, *of_gain)
    first = lock_in_rate / unit.lock_in_rate
    return replace(unit, backscatter=(first, backscatter_ratio * first))


@dataclass(frozen=True)
class SteadyBeat:
    """Periodic signals of a laser turning at constant rate, as harmonics: x = Re sum c_n exp(2 pi i n f t)."""

    frequency: float  # Hz, positive
    beat: Complexes  # (n,) of sqrt(I1 I2) exp(i psi), two-sided, order -n/2 .. n/2 - 1
    beams: Complexes  # (2, n) of I1 and I2, the same order


def steady_beat(laser: TwoModeLaser, input_rate: float) -> SteadyBeat:
    """Periodic solution of equations (1) at a constant rate; `NoFit` where there is no steady beat.

    The phase is the independent variable, and the intensities are periodic in it: their values at even steps over
    one turn follow from Newton's method with the derivative of their Fourier series. Neither slow transients nor a
    gain far faster than the beat (a stiff equation) matter.

    Examples
    --------
    With fast gain, the beat of the lock-in equation: A2/A1 = tan(asin(0.5)/2).

    >>> laser = symmetric_laser(0.05, scale_factor=2000, gain_corner_hz=1e6)
    >>> beat = steady_beat(laser, 0.1)
    >>> middle = beat.beat.size // 2
    >>> round(float(abs(beat.beat[middle + 2] / beat.beat[middle + 1])), 4), round(beat.frequency, 2)
    (0.2679, 173.21)
    """
    psi, logs, slowness = _path(laser, input_rate)
    turned, weight = beat_phase(psi, slowness)
    intensities = np.exp(logs)
    signals = np.stack([np.sqrt(intensities[0] * intensities[1]) * np.exp(1j * psi), *intensities])
    # harmonics in time from a path in phase: c_n = (1/T) integral of x exp(-i n w t) (dt/dpsi) over psi
    count, lines = FEWEST_LINES // 2, signals
    while count < POINTS // 2 and np.max(np.abs(lines[:, [0, 1, -2, -1]])) > NEGLIGIBLE_LINE:
        count *= 2
        powers = np.multiply.accumulate(np.tile(np.exp(-1j * turned), (count, 1)))
        kernel = np.concatenate([np.conj(powers[::-1]), np.ones((1, POINTS)), powers[:-1]]) * weight / POINTS
        lines = signals @ kernel.T
    lines = np.pad(lines, ((0, 0), (POINTS // 2 - count,) * 2))
    return SteadyBeat(_frequency(slowness), lines[0], lines[1:])


def _frequency(slowness: Floats) -> float:
    """Beats in a second, by the time that the phase takes for a radian at even steps of one turn."""
    return 1 / (2 * np.pi * float(np.mean(slowness)))


@lru_cache(maxsize=1024)
def _path(laser: TwoModeLaser, input_rate: float) -> tuple[Floats, Floats, Floats]:
    """Over one turn of the phase (`POINTS`,): it, ln I1 and ln I2 (2, n), and its time for a radian."""
    values = np.zeros((2, FEWEST))
    for rate in [input_rate, *(input_rate * np.array(DETOUR))]:
        found = _periodic(laser, float(rate), values)
        if found is not None:
            values = found
        if found is not None and rate == input_rate:
            psi = _phases(POINTS, input_rate)
            # An even number of points has no place for the highest line of the longest solution; it is rounding.
            lines = np.fft.rfft(values)[:, : POINTS // 2] * (POINTS / values.shape[1])
            logs = np.fft.irfft(lines, POINTS)
            sagnac = np.array([2 * np.pi * laser.scale_factor * input_rate])
            speed = _motion(laser.numbers[np.newaxis], sagnac, psi[np.newaxis], logs[np.newaxis])[0][0]
            return psi, logs, 1 / np.abs(speed)
    raise NoFit(
        f"the gyro is locked at {input_rate:.6g} deg/s, or its backscatter is too strong for its gain: "
        "there is no steady beat"
    )


def _periodic(laser: TwoModeLaser, input_rate: float, start: Floats) -> Floats | None:
    """ln I1 and ln I2 (2, n) at n even steps of the phase over one turn, n as large as it must be; or None."""
    n, sagnac = start.shape[1], np.array([2 * np.pi * laser.scale_factor * input_rate])
    while True:
        values, _, found = periodic_states(laser.numbers[np.newaxis], sagnac, start[np.newaxis])
        if not found[0]:
            return None
        lines = np.abs(np.fft.rfft(values[0])) / n
        if n >= POINTS or np.max(lines[:, -n // 8 :]) < NEGLIGIBLE_LINE:
            return np.asarray(values[0])
        n = 2 * n - 1
        start = np.asarray(np.fft.irfft(np.fft.rfft(values[0]), n) * n / values.shape[-1])


def periodic_states(
    lasers: Floats, sagnac: Floats, start: Floats, angular: Floats | None = None
) -> tuple[Floats, Floats, Bools]:
    """Periodic solutions of equations (1) of B lasers (B, `NUMBERS`), as of a `TwoModeLaser`, by Newton's method.

    It starts at ln I1 and ln I2 (B, 2, n) at n even steps of the phase over one turn, in the order of time, n odd,
    and at 2 pi K W (B,), signed, of which only the sense holds where beats (B,) were seen, rad/s. It returns both,
    and whether each was found: where the phase stands still none is.
    """
    values = start
    for _ in range(ROUNDS):
        missing, jacobian, found = _newton(lasers, sagnac, values, angular)
        try:
            step = np.asarray(np.linalg.solve(jacobian, missing[..., np.newaxis])[..., 0], np.float64)
        except np.linalg.LinAlgError:  # one of them, whose phase stands, must not end the others
            whole = np.isfinite(jacobian).all(axis=(1, 2))
            step = np.full_like(missing, np.nan)
            step[whole] = (np.linalg.pinv(jacobian[whole]) @ missing[whole, :, np.newaxis])[..., 0]
        size = np.max(np.abs(step), axis=1)
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(size, 1e-300))[:, np.newaxis]
        values, sagnac = _stepped(values, sagnac, step, angular)
        if not np.any(found & (size >= CONVERGED)):
            break
    return values, sagnac, found & (size < CONVERGED)


def steps_of_a_turn(ratios: Complexes) -> tuple[int, int]:
    """Steps of the phase, and harmonics, that solutions with these second over their first harmonics take."""
    # each harmonic counts by as much as it has; backscatters that nearly cancel in the ratio swing the beams
    steepest = float(np.clip(np.max(np.abs(ratios)), 0.2, 0.8))
    lines = math.ceil(math.log(LAST_HARMONIC) / 2 / math.log(steepest))
    return 1 + 4 * lines, lines


def states_beside(
    lasers: Floats, known: Floats, sagnac: Floats, values: Floats, angular: Floats
) -> tuple[Floats, Floats]:
    """Values (B P, 2, n) and sagnac (B P,) of B sets of lasers, (B, P, `NUMBERS`), near to one set.

    So near to `known` (P, `NUMBERS`), whose solutions and beats (P,) are given, that one step of Newton's will do.
    """
    sets = len(lasers)
    slopes = _newton(known, sagnac, values, angular)[1]
    sagnac, values, angular = np.tile(sagnac, sets), np.tile(values, (sets, 1, 1)), np.tile(angular, sets)
    # the slopes are those of the known ones: the same for all that are near to it
    missing = _newton(lasers.reshape(-1, NUMBERS), sagnac, values, angular, slopes=False)[0]
    step = np.linalg.solve(slopes, missing.reshape(sets, len(known), -1).transpose(1, 2, 0)).transpose(2, 0, 1)
    return _stepped(values, sagnac, np.asarray(step, np.float64).reshape(missing.shape), angular)


def lines_in_time(lasers: Floats, sagnac: Floats, values: Floats, count: int) -> tuple[Floats, Complexes, Floats]:
    """Of solutions of :func:`periodic_states`: phases (B, n), the lines of what is seen there, beats in rad/s.

    A signal x (B, n) at these phases is Re sum c_m exp(i m w t), c_m = sum_k x_k lines_mk; lines (B, count, n).
    """
    n = values.shape[-1]
    psi = np.sign(sagnac)[:, np.newaxis] * _phases(n, 1.0)
    speed = _motion(lasers, sagnac, psi, values)[0]
    turned, weight = beat_phase(psi, 1 / np.abs(speed))
    powers = np.multiply.accumulate(np.tile(np.exp(-1j * turned), (count, 1, 1)))
    lines = np.asarray(np.moveaxis(powers, 0, 1) * (2 * weight / n)[:, np.newaxis], np.complex128)
    return psi, lines, 1 / np.mean(1 / np.abs(speed), axis=1)


def _stepped(values: Floats, sagnac: Floats, step: Floats, angular: Floats | None) -> tuple[Floats, Floats]:
    values = values + step[:, : values[0].size].reshape(values.shape)
    return values, sagnac if angular is None else sagnac + angular * step[:, -1]


def _newton(
    lasers: Floats, sagnac: Floats, values: Floats, angular: Floats | None, *, slopes: bool = True
) -> tuple[Floats, Floats, Bools]:
    """What equations (1) miss (B, m), how that moves with the unknowns (B, m, m), and where the phase turns."""
    count, _, n = values.shape
    sense, at = np.sign(sagnac), np.arange(n)
    psi = sense[:, np.newaxis] * _phases(n, 1.0)
    derive = sense[:, np.newaxis, np.newaxis] * _derivative(n)
    speed, growth, pull, feed = _motion(lasers, sagnac, psi, values)
    turns = np.min(speed * sense[:, np.newaxis], axis=1) > STANDSTILL * np.abs(sagnac)
    slope = values @ derive.swapaxes(1, 2)
    missing = np.empty((count, 2 * n + (angular is not None)))
    missing[:, : 2 * n] = (growth - speed[:, np.newaxis] * slope).reshape(count, -1)
    if angular is not None:
        # one more unknown, and the time that the phase takes for a turn
        share = (angular * sense)[:, np.newaxis] / speed / n
        missing[:, -1] = 1 - share.sum(axis=1)
    jacobian = np.zeros((count, missing.shape[1], missing.shape[1] if slopes else 0))
    if slopes:
        speed_by, growth_by = _slopes(lasers, values, pull, feed)
        for beam in range(2):
            jacobian[:, beam * n : (beam + 1) * n, beam * n : (beam + 1) * n] = speed[:, :, np.newaxis] * derive
            for other in range(2):
                part = slope[:, beam] * speed_by[:, other] - growth_by[:, beam, other]
                jacobian[:, beam * n + at, other * n + at] += part
        if angular is not None:
            jacobian[:, :-1, -1] = slope.reshape(count, -1) * angular[:, np.newaxis]
            jacobian[:, -1, :-1] = -np.tile(share / speed, 2) * speed_by.reshape(count, -1)
            jacobian[:, -1, -1] = -angular * np.sum(share / speed, axis=1)
    return missing, jacobian, np.asarray(turns)


@lru_cache(maxsize=8)
def _derivative(n: int) -> Floats:
    """By the phase, of a function whose values at n even steps of a turn are given, n odd: (n, n)."""
    steps = np.subtract.outer(np.arange(n), np.arange(n))
    with np.errstate(divide="ignore"):
        matrix = 0.5 * np.where(steps % 2 == 0, 1.0, -1.0) / np.sin(np.pi * steps / n)
    np.fill_diagonal(matrix, 0.0)
    return matrix


def _motion(
    lasers: Floats, sagnac: Floats, psi: Floats, values: Floats
) -> tuple[Floats, Floats, tuple[Floats, Floats], tuple[Floats, Floats]]:
    """d psi/dt (B, n), d ln I/dt (B, 2, n); what each backscatter takes from the first and adds to the second."""
    a1, a2, half, xi, gain_rate, imbalance, dispersion = lasers.T[..., np.newaxis]
    gain = gain_rate / (1 + xi)
    first, second = 1 - np.exp(values).swapaxes(0, 1)
    first, second = gain * (1 + imbalance) * first, gain * (1 - imbalance) * second
    ratio = np.exp((values[:, 0] - values[:, 1]) / 2)
    pull = a1 * ratio * np.sin(psi - half), a2 / ratio * np.sin(psi + half)
    feed = 2 * a2 / ratio * np.cos(psi + half), 2 * a1 * ratio * np.cos(psi - half)
    speed = sagnac[:, np.newaxis] + dispersion * (1 - xi) / 2 * (first - second) - pull[0] - pull[1]
    growth = first + xi * second + feed[0], second + xi * first + feed[1]
    return np.asarray(speed), np.stack(growth, axis=1), pull, feed


def _slopes(
    lasers: Floats, values: Floats, pull: tuple[Floats, Floats], feed: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Derivatives of what :func:`_motion` gives by the two ln I: (B, 2, n) and (B, 2, 2, n)."""
    xi, gain_rate, imbalance, dispersion = lasers.T[3:, :, np.newaxis]
    gain = gain_rate / (1 + xi)
    first, second = np.exp(values).swapaxes(0, 1)
    first, second = gain * (1 + imbalance) * first, gain * (1 - imbalance) * second
    turned, by_gain = (pull[1] - pull[0]) / 2, dispersion * (1 - xi) / 2
    by_first = np.stack([-first - feed[0] / 2, -xi * second + feed[0] / 2], axis=1)
    by_second = np.stack([-xi * first + feed[1] / 2, -second - feed[1] / 2], axis=1)
    speed = np.stack([turned - by_gain * first, by_gain * second - turned], axis=1)
    return speed, np.stack([by_first, by_second], axis=1)


def beat_phase(psi: Floats, slowness: Floats) -> tuple[Floats, Floats]:
    """Phase of the fundamental (..., n) at even steps of psi, from 0 on, and dt/dpsi over its mean."""
    n = psi.shape[-1]
    weight = slowness / np.mean(slowness, axis=-1, keepdims=True)
    ripple = np.fft.rfft(weight)
    ripple[..., 1:] /= 1j * np.arange(1, ripple.shape[-1])
    ripple[..., 0] = 0
    # the integral of its own speed
    wave = np.fft.irfft(ripple, n)
    return np.asarray(np.abs(psi) + wave - wave[..., :1]), weight


def _phases(n: int, input_rate: float) -> Floats:
    """n phases over one turn, in the order of time."""
    return np.asarray(np.sign(input_rate) * 2 * np.pi * np.arange(n) / n)


@dataclass(frozen=True)
class Winking:
    """Gain saturation of a laser; its beat and its beams on the grid of rates."""

    scale_factor: float  # pulses per degree
    lock_in_rate: float  # deg/s, at low rates
    gain_corner_hz: float  # relaxation rate of the common intensity over 2 pi
    phase_sum: float = 0.0  # sum of the phases of the backscatter, rad: 0 is the dissipative kind, which locks
    cross_saturation: float = 0.5  # over self saturation
    backscatter_ratio: float = 1.0  # a2 over a1
    beam_imbalance: float = 0.0
    gain_dispersion: float = 0.0

    def frequency_factor(self, rates: Floats) -> Floats:
        """Beat frequency at rates in deg/s over that of the lock-in equation; all beyond the lock-in rate."""
        factors = np.ones(rates.shape)
        for sense in (1, -1):
            inside = np.flatnonzero(np.sign(rates) == sense)

            def factor(point: int, _: Indices, sense: int = sense) -> float:
                return self.frequency(point, sense) / (self.scale_factor * beat_rate_at(point))

            factors[inside] = interpolate(rates[inside], self.lock_in_rate, factor)
        return factors

    def frequency(self, point: int, sense: int) -> float:
        """Beat frequency in Hz at a point of the grid."""
        return _frequency(_path(symmetric_laser(**vars(self)), sense * rate_at(point, self.lock_in_rate))[2])

    def fringe(self, point: int, sense: int) -> Complexes:
        """Light of the fringes, sqrt(I1 I2) exp(i (phi + beta)), over one period, evenly in time."""
        turn = np.exp(1j * symmetric_laser(**vars(self)).backscatter_phase)
        return np.asarray(_over_a_period(_beat(self, point, sense).beat) * turn)

    def light(self, point: int, sense: int) -> Floats:
        """Light of the single beams I1 and I2 over the same period, (2, n)."""
        return np.stack([_over_a_period(beam).real for beam in _beat(self, point, sense).beams])


@lru_cache(maxsize=1024)
def _beat(winking: Winking, point: int, sense: int) -> SteadyBeat:
    return steady_beat(symmetric_laser(**vars(winking)), sense * rate_at(point, winking.lock_in_rate))


def _over_a_period(harmonics: Complexes) -> Complexes:
    """Values of a series with the orders -n/2 ... n/2 - 1 at n even steps of one period."""
    return np.asarray(np.fft.ifft(np.fft.ifftshift(harmonics)) * harmonics.size)


# --------------------
# A grid of rates, at whose points a beat is worked out once, and the interpolation between them.
#
# The grid is even in the logarithm of sqrt(W^2 - WL^2), on which everything about a beat depends smoothly


STEP = 0.05
FINER = 100
"""Points of a finer grid in one step: between them straight lines are good to 1e-7 of a second harmonic."""
_OFFSETS = (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0)  # six points around a place between 0 and 1
_TO_POWERS = np.linalg.inv(np.vander(_OFFSETS, increasing=True))  # makes a polynomial of what stands at these
_LOWEST_DPS = 1e-9


def beat_rate_at(point: int) -> float:
    """Value of sqrt(W^2 - WL^2) in deg/s at a point of the grid."""
    return math.exp(STEP * point)


def rate_at(point: int, lock_in_rate: float) -> float:
    """Rate W in deg/s, positive, at a point of the grid."""
    return math.hypot(beat_rate_at(point), lock_in_rate)


def interpolate(rates: Floats, lock_in_rate: float, at_point: Callable[[int, Indices], Floats | float]) -> Floats:
    """Interpolate between the points of the grid, by polynomials of the fifth degree."""
    # Shapes: rates (n,).
    place = grid_place(np.abs(rates), lock_in_rate)
    cells = np.floor(place).astype(np.intp)
    values = np.empty(rates.shape)
    for cell in np.unique(cells):
        inside = np.flatnonzero(cells == cell)
        at_points = np.array([at_point(int(cell + offset), inside) for offset in _OFFSETS])
        values[inside] = polynomial.polyval(place[inside] - cell, _TO_POWERS @ at_points, tensor=False)
    return values


def weights_at(place: float) -> list[tuple[int, float]]:
    """Points of the grid around one place, and their weights."""
    cell = math.floor(place)
    weights = six_weights(np.array([place - cell]))[0].tolist()
    return [(int(cell + offset), weight) for offset, weight in zip(_OFFSETS, weights, strict=True)]


def six_weights(places: Floats) -> Floats:
    """Weights of the points -2, -1, ... 3 around places (n,) between 0 and 1, (n, 6)."""
    return np.asarray(np.vander(places, len(_OFFSETS), increasing=True) @ _TO_POWERS)


def grid_place(size: Floats, lock_in_rate: float) -> Floats:
    """Places on the grid, in steps of it, of rates (deg/s, positive) beyond the lock-in rate."""
    beat_rate = np.sqrt((size - lock_in_rate) * (size + lock_in_rate))
    return np.asarray(np.log(np.maximum(beat_rate, _LOWEST_DPS)) / STEP)
