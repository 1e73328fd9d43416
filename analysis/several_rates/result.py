"""What a fit over several rates gives back: values, checks, flags, sentences."""

from dataclasses import dataclass, field
from enum import IntFlag
from typing import Literal

import numpy as np

from analysis.arrays import NORMAL_95, Bools, Complexes, Floats
from analysis.several_rates.points import SAME_RATE, UsedRecords, first_of_groups, rate_mismatch
from analysis.several_rates.ratio_model import DRIFT, Reference, predicted_ratio, whitened

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


@dataclass(frozen=True, eq=False)
class FittedRecords:
    """The n records of a fit and what it says of each, worked out when asked for: a million take much memory."""

    records: UsedRecords = field(repr=False)  # UsedRecords
    parameters: Floats  # (1, N_PARAMETERS) of the fit
    lock_in_rate: float  # deg/s

    @property
    def rate(self) -> Floats:
        """deg/s, signed."""
        return self.records.records.rate

    @property
    def used(self) -> Bools:
        """Records in the fit."""
        return self.records.used

    @property
    def locked(self) -> Bools:
        """Records without a beat."""
        return self.records.records.locked

    @property
    def ratio(self) -> Complexes:
        """rho."""
        return np.concatenate([block.ratio for _, block in self.records.records.blocks()])

    @property
    def residual(self) -> Complexes:
        """What the fit leaves of the ratio; nan where it was not used."""
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
    def rate_mismatch(self) -> Floats:
        """f/(K sqrt(W^2 - WL^2)) - 1; nan where it is not known."""
        return rate_mismatch(self.records.records, self.lock_in_rate, float(self.parameters[0, DRIFT]))


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
    any_backscatter : whether unequal or turned backscatter of the beams was fitted too
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
    each : every record as given; worked out when asked for
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
    any_backscatter: bool
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
    each: FittedRecords
    at_least: float
    flags: int
    noise_model: str

    @property
    def rate(self) -> Floats:
        """Of every record, deg/s, signed, (n,)."""
        return self.each.rate

    @property
    def n_rates(self) -> int:
        """Different rates of the records used, those of each sense by themselves."""
        by_sense = [np.abs(self.rate[self.used & (sign * self.rate > 0)]) for sign in (1, -1)]
        return sum(first_of_groups([one], SAME_RATE).size for one in by_sense if one.size)

    @property
    def ratio(self) -> Complexes:
        """rho of every record, (n,)."""
        return self.each.ratio

    @property
    def residual(self) -> Complexes:
        """What the fit leaves of the ratio of every record, (n,); nan where it was not used."""
        return self.each.residual

    @property
    def deviation(self) -> Floats:
        """The same in standard uncertainties: the root of its chi-square."""
        return self.each.deviation

    @property
    def used(self) -> Bools:
        """Which records are in the fit, (n,)."""
        return self.each.used

    @property
    def locked(self) -> Bools:
        """Records without a beat, which say WL >= |W|, (n,)."""
        return self.each.locked

    @property
    def rate_mismatch(self) -> Floats:
        """f/(K sqrt(W^2 - WL^2)) - 1 of every record, (n,); nan where it is not known."""
        return self.each.rate_mismatch

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
