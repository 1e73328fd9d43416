"""What a fit over several rates gives: from its minima to one value and an interval; values, checks, flags."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from typing import Literal, Self

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Bools, Complexes, Floats
from analysis.lockin_rate import size_interval
from analysis.several_rates.laser_fit import DISTORTION, POSSIBLE, LaserFit, laplace
from analysis.several_rates.points import SAME_RATE, UsedRecords, first_of_groups, rate_mismatch
from analysis.several_rates.ratio_model import (
    DRIFT,
    N_PARAMETERS,
    PHASES,
    RatioData,
    RatioFit,
    Reference,
    predicted_ratio,
    whitened,
)

Model = Literal["lock-in", "distortion", "gain", "both", "all"]


class RatesFlag(IntFlag):
    """Bits of `RatesFit.flags`; the lower-case name is the one used in JSON."""

    NOT_SIGNIFICANT = 1
    """The lock-in rate does not stand out of its uncertainty."""
    RATES_TOO_CLOSE = 2
    """Distortion costs so much that the rates cannot tell it from lock-in."""
    NOT_DETERMINED = 4
    """The relative uncertainty of the lock-in rate is above 30 %."""
    NOT_TESTED = 8
    """As many unknowns as values."""
    MISFIT = 16
    """The records scatter more than their noise explains; the uncertainty is enlarged."""
    ONE_RATE_DISAGREES = 32
    """Without one of the rates the others give another lock-in rate."""
    ONE_SENSE = 64
    """Records of one sense of rotation only."""
    GAIN_CORNER_ASSUMED_HIGH = 128
    """The gain corner was not fitted although it may matter."""
    LOCKED_RECORDS = 256
    """Some records show no beat at a rate that fits lock-in; they bound the lock-in rate from below."""
    NO_BEAT_ABOVE_LOCK_IN = 512
    """Some records show no beat at a rate where there should be one."""
    RECORDS_LEFT_OUT = 1024
    """Some records could not be used."""
    RATE_AND_BEAT_DISAGREE = 2048
    """Rates given and beat frequencies do not fit together: rate, tilt, earth rate or scale factor is wrong."""
    RATE_BELOW_LOCK_IN = 4096
    """A record shows a beat at a rate, as given, at which the gyro should be locked."""
    SEVERAL_SOLUTIONS = 8192
    """Another lock-in rate explains the records as well: `RatesFit.alternatives`; the interval holds all."""
    STATED_LIMITS_EXCEEDED = 32768
    """The records show more distortion, or a lower corner, than was stated; the usual bounds were used instead."""
    RECORDS_MISFIT = 16384
    """The records themselves depart from the lock-in waveform, by more than third-order distortion explains."""


@dataclass(frozen=True)
class ModelFit:
    """One model's answer: lock-in rate and its uncertainty (deg/s), chi-square, degrees of freedom."""

    model: Model
    lock_in_rate: float
    lock_in_rate_u: float
    chi_square: float
    degrees_of_freedom: int


@dataclass(frozen=True)
class Alternative:
    """Another minimum of chi-square, not unlikely enough to be left out."""

    lock_in_rate: float  # deg/s, of this minimum alone
    lock_in_rate_u: float
    lock_in_rate_low_95: float
    lock_in_rate_high_95: float
    distortion: float  # D there
    chi_square: float  # above that of the best


@dataclass(frozen=True)
class WithoutOneRate:
    """The fit repeated without each rate in turn; arrays of one value a rate."""

    rate: Floats  # |W|, deg/s, mean of the records left out
    lock_in_rate: Floats  # deg/s, from the others
    lock_in_rate_u: Floats
    deviation: Floats  # from the value of all, in standard uncertainties of that difference
    # chance that all is well and the rate left out fits the others no better, with as many tests as rates
    p_value: Floats


@dataclass(frozen=True)
class RatesFit:
    """Lock-in rate of many records at several rates.

    lock_in_rate, lock_in_rate_u, lock_in_rate_low_95, lock_in_rate_high_95 : deg/s; of all solutions, where there
        are several
    alternatives : the other solutions, the likeliest first
    counted : which contributions of a budget the uncertainty holds already: "distortion", "third_order",
        "bandwidth", "gain_corner"
    backscatter_phase, backscatter_phase_u : rad, beta less the readout phase
    distortion, distortion_u : second harmonic that the receiver makes of a sine, over its fundamental, at the mean
        amplitude of the records; negative where it is in antiphase
    gain_time, gain_time_u : s, 1/g_c; noise may make it negative. What was not fitted is nan
    lasers : with any backscatter, the likeliest first, where a gain corner is in sight and one was found
    gain_time_limit : s, upper 95 % limit where the gain corner was not fitted, nan where the data know none
    gain_corner_hz, gain_corner_low_95_hz, gain_corner_high_95_hz : g_c/2 pi; inf where no end is seen
    lag_square, lag_square_u : s^2, square of the time constant of the receiver's pole; noise may make it negative
    bandwidth_hz, bandwidth_low_95_hz : the corner of that pole, and its lower 95 % limit
    third_order, third_order_u : as `distortion`, the third harmonic; positive in phase with a cubic law
    phase_between_senses, phase_between_senses_u : rad, by which the backscatter phase is larger in the positive
        sense
    phase_drift, phase_drift_u : rad, by which it grew evenly over the run
    lock_in_drift, lock_in_drift_u : relative, by which the lock-in rate grew; its value is that at mid-run
    scale_factor, scale_factor_u : pulses per degree that beats and rates given ask for, if those rates are right
    covariance : (10, 10) of lock_in_rate, backscatter_phase, distortion, gain_time, lag_square, third_order,
        phase_between_senses, phase_drift, its bend, lock_in_drift; zero where not fitted
    model, models : the one used, and what every model that the data allow gives
    reference : "rate": r follows from the rates given; "beat": from f/K
    chi_square, degrees_of_freedom, p_value : of the model used, of the means at each rate and sense and of what
        was known beforehand; the last is the smaller of that and of the chance of the scatter about those means
    cost : uncertainty over that of the same data with distortion and gain corner known
    left_out : the leave-one-rate-out check; empty arrays where the others would not determine the lock-in rate
    records, parameters : every record as given, and (1, 10) parameters of the fit: what it says of each record is
        worked out when asked for, since a million take much memory
    at_least : deg/s, the fastest rate at which the gyro was seen locked, 0 if none
    flags : bits of `RatesFlag`
    noise_model : what the uncertainties rest on
    """

    lock_in_rate: float
    lock_in_rate_u: float
    lock_in_rate_low_95: float
    lock_in_rate_high_95: float
    alternatives: tuple[Alternative, ...]
    counted: frozenset[str]
    backscatter_phase: float
    backscatter_phase_u: float
    distortion: float
    distortion_u: float
    gain_time: float
    gain_time_u: float
    lasers: tuple[LaserFit, ...]
    gain_time_limit: float
    lag_square: float
    lag_square_u: float
    third_order: float
    third_order_u: float
    phase_between_senses: float
    phase_between_senses_u: float
    phase_drift: float
    phase_drift_u: float
    lock_in_drift: float
    lock_in_drift_u: float
    scale_factor: float
    scale_factor_u: float
    covariance: Floats
    model: Model
    models: tuple[ModelFit, ...]
    reference: Reference
    chi_square: float
    degrees_of_freedom: int
    p_value: float
    cost: float
    left_out: WithoutOneRate
    records: UsedRecords = field(repr=False)
    parameters: Floats
    at_least: float
    flags: int
    noise_model: str

    @property
    def rate(self) -> Floats:
        """Of every record, deg/s, signed, (n,)."""
        return self.records.records.rate

    @property
    def each(self) -> Self:
        """The fit, which says itself what it makes of each record."""
        return self

    @property
    def n_rates(self) -> int:
        """Different rates of the records used, those of each sense by themselves."""
        by_sense = [np.abs(self.rate[self.used & (sign * self.rate > 0)]) for sign in (1, -1)]
        return sum(first_of_groups([one], SAME_RATE).size for one in by_sense if one.size)

    @property
    def ratio(self) -> Complexes:
        """rho of every record, (n,)."""
        return np.concatenate([block.ratio for _, block in self.records.records.blocks()])

    @property
    def residual(self) -> Complexes:
        """What the fit leaves of the ratio of every record, (n,); nan where it was not used."""
        found = np.full(self.used.shape, np.nan, dtype=np.complex128)
        for rows, data, _ in self.records.data():
            found[rows] = (data.ratio - predicted_ratio(self.parameters, data))[0]
        return found

    @property
    def deviation(self) -> Floats:
        """The same in standard uncertainties: the root of its chi-square."""
        found = np.full(self.used.shape, np.nan)
        for rows, data, _ in self.records.data():
            white = whitened(self.parameters, data)[0][0]
            found[rows] = np.hypot(white[:, 0], white[:, 1])
        return found

    @property
    def used(self) -> Bools:
        """Which records are in the fit, (n,)."""
        return self.records.used

    @property
    def locked(self) -> Bools:
        """Records without a beat, which say WL >= |W|, (n,)."""
        return self.records.records.locked

    @property
    def rate_mismatch(self) -> Floats:
        """f/(K sqrt(W^2 - WL^2)) - 1 of every record, (n,); nan where it is not known."""
        return rate_mismatch(self.records.records, self.lock_in_rate, float(self.parameters[0, DRIFT]))

    @property
    def gain_corner_hz(self) -> float:
        """g_c/2 pi."""
        return _corner(self.gain_time)

    @property
    def gain_corner_low_95_hz(self) -> float:
        """Lower end of the 95 % interval of g_c/2 pi."""
        return _corner(self.gain_time + NORMAL_95 * self.gain_time_u)

    @property
    def gain_corner_high_95_hz(self) -> float:
        """Upper end of the 95 % interval of g_c/2 pi; inf where the data do not see the corner."""
        return _corner(self.gain_time - NORMAL_95 * self.gain_time_u)

    @property
    def bandwidth_hz(self) -> float:
        """Corner of the receiver's pole."""
        return _corner(_root(self.lag_square))

    @property
    def bandwidth_low_95_hz(self) -> float:
        """Lower end of the 95 % interval of that corner."""
        return _corner(_root(self.lag_square + NORMAL_95 * self.lag_square_u))


def _root(square: float) -> float:
    return float(np.sqrt(square)) if not square < 0 else 0.0


def _corner(gain_time: float) -> float:
    if np.isnan(gain_time):
        return float("nan")
    return float(1 / (2 * np.pi * gain_time)) if gain_time > 0 else float("inf")


# --------------------
# From the minima of a fit to one value, its uncertainty and an interval that holds all of them


@dataclass(frozen=True)
class RatesAnswer:
    """Lock-in rate of all possible minima: value of the best, uncertainty and interval of all, deg/s."""

    value: float
    u: float
    low: float
    high: float
    others: tuple[Alternative, ...]


def answer(found: RatioFit, widen: float, degrees: int) -> RatesAnswer:
    """The lock-in rate that a fit with one or several minima gives."""
    above = (found.chi_square - found.chi_square[0]) / widen
    possible = found.take(above <= POSSIBLE)
    each = [_size(possible.take(slice(row, row + 1)), widen, degrees) for row in range(possible.chi_square.size)]
    values, us = (np.array([one[k] for one in each]) for k in (0, 1))
    # where phases turn there may be several ways to one lock-in rate
    others = tuple(
        Alternative(*each[row], float(possible.parameters[row, 2]), float(above[above <= POSSIBLE][row]))
        for row in np.flatnonzero(np.abs(values - values[0]) > ANOTHER * us)
    )
    # By Laplace: the share of the probability under each minimum goes with its height and its volume.
    weights = minimum_volumes(possible) * np.exp(-0.5 * above[above <= POSSIBLE])
    weights = weights / weights.sum()
    u = math.sqrt(float(np.sum(weights * (us**2 + (values - values[0]) ** 2))))
    return RatesAnswer(float(values[0]), u, min(one[2] for one in each), max(one[3] for one in each), others)


def largest_possible(found: RatioFit, data: RatioData) -> float:
    """Lock-in rate beyond which beats would contradict their rates, deg/s; inf where they say nothing."""
    # A gyro that beats turns faster than its lock-in rate. That holds if the rates given are those at which the
    # records were taken, and not just senses: if they agree with the beats for one of the minima found.
    rate, sizes = np.abs(data.rate), np.hypot(found.parameters[:, 0], found.parameters[:, 1])
    off = np.abs(np.hypot(data.beat_rate, sizes[:, np.newaxis]) / rate - 1)
    if not np.any(np.all(off < _SAME_RATE, axis=-1)):
        return math.inf
    return float(np.sqrt(np.min((_OTHER_RATE * rate) ** 2 - data.beat_rate**2)))


def up_to(found: RatioFit, most: float) -> RatioFit:
    """The minima whose lock-in rate is not above `most`, deg/s, and at least that of the least."""
    sizes = np.hypot(found.parameters[:, 0], found.parameters[:, 1])
    return found.take(sizes <= max(most, sizes.min()))


ANOTHER = 0.5  # standard uncertainties by which another solution differs at least

_SAME_RATE, _OTHER_RATE = 0.1, 1.5
"""Shares by which a rate may be off and still be that of its beat, and a factor by which none is off."""


def widened(said: RatesAnswer, share_u: float) -> RatesAnswer:
    """The answer with one more unknown beside what it counts, of standard deviation `share_u` of its value."""
    extra = share_u * said.value
    reach = NORMAL_95 * extra
    low = said.value - math.hypot(said.value - said.low, reach)
    high = said.value + math.hypot(said.high - said.value, reach)
    return RatesAnswer(said.value, math.hypot(said.u, extra), max(low, 0.0), high, said.others)


def polar_covariance(fit: RatioFit) -> Floats:
    """Covariance (P, P) of |z|, its angle, and the other parameters, of the first set."""
    x, y = fit.parameters[0, :2]
    size = max(float(np.hypot(x, y)), 1e-300)
    turn = np.eye(N_PARAMETERS)
    turn[0, :2], turn[1, :2] = (x / size, y / size), (-y / size**2, x / size**2)
    return np.asarray(turn @ fit.covariance[0] @ turn.T)


def lock_in_u(fit: RatioFit) -> float:
    """Standard uncertainty of |z| of the first set."""
    return float(size_us(fit)[0])


def size_us(fits: RatioFit) -> Floats:
    """Standard uncertainty of every |z|, (B,), deg/s."""
    z = fits.parameters[:, :2]
    along = z / np.maximum(np.hypot(z[:, 0], z[:, 1]), 1e-300)[:, np.newaxis]
    return np.asarray(np.sqrt(np.einsum("bi,bij,bj->b", along, fits.covariance[:, :2, :2], along)))


def _size(fit: RatioFit, widen: float, degrees: int) -> tuple[float, float, float, float]:
    """Value freed of the bias that noise gives to the size of a complex number, its u and 95 % interval."""
    covariance = polar_covariance(fit) * widen
    size = float(np.hypot(*fit.parameters[0, :2]))
    # a phase that turns makes the angle uncertain, and the size none the larger
    turns = PHASES.start + np.flatnonzero(np.diagonal(covariance)[PHASES] > 0)
    shared = covariance[turns, 1:2]
    by_turns = float(np.vecdot(shared[:, 0], np.linalg.solve(covariance[np.ix_(turns, turns)], shared)[:, 0]))
    across = size**2 * max(float(covariance[1, 1]) - by_turns, 0.0)
    u = float(np.sqrt(covariance[0, 0]))
    student = float(scipy.special.stdtrit(degrees, 0.975)) / NORMAL_95 if degrees else 1.0
    low, high = size_interval(size / (u * student))
    return float(np.sqrt(max(size**2 - across, 0.0))), u, float(low) * u * student, float(high) * u * student


def minimum_volumes(possible: RatioFit) -> Floats:
    """Root of the determinant of each covariance, without what is held."""
    held = np.diagonal(possible.covariance, axis1=-2, axis2=-1) == 0
    matrices = possible.covariance + np.eye(N_PARAMETERS) * held[:, np.newaxis, :]
    scale = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    correlation = matrices / scale[:, :, np.newaxis] / scale[:, np.newaxis, :]
    volume = np.sqrt(np.maximum(np.linalg.det(correlation), 1e-300))
    relative = (scale / scale[0]).prod(axis=-1)
    return np.asarray(volume * relative)


def answer_of_lasers(found: Sequence[LaserFit], widen: float, reference: Reference) -> RatesAnswer:
    """The lock-in rate that lasers fitted to the beat give."""
    points, best = found[0].model.data.points, found[0].chi_square
    scale = 2 * math.pi * points.records.records.scale_factor
    of_all, *each = ([one / scale for one in a] for a in laplace(found, widen, per_rate=reference == "rate"))
    others = tuple(
        Alternative(
            own[0], own[1], own[2], own[3], float(laser.parameters[DISTORTION]), (laser.chi_square - best) / widen
        )
        for laser, own in zip(found, each, strict=False)  # parts of one valley are no others
        if abs(own[0] - of_all[0]) > ANOTHER * own[1]
    )
    return RatesAnswer(of_all[0], of_all[1], of_all[2], of_all[3], others)
