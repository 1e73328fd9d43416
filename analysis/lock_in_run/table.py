"""The check by the rate table: do beat frequencies, harmonics and table rates of a run fit together?

Fast and slow records lie on one curve. With y = sqrt(f^2 + h^2), h = K WL, table rate W_T and azimuth a,

    y = A (W_T + w_v) + P cos(a) + Q sin(a) + B,  A = K cos(tilt),   sqrt(P^2 + Q^2) = K w_h sin(tilt)       (1)

w_v and w_h are the vertical and the horizontal earth rate, B is a bias of the gyro, zero within a bound. Three
things follow from it:

* **h by the frequencies alone.** The slow beats are pulled down and the fast ones are not. Against h by the
  harmonics this tests the harmonics: a slow channel takes from the second harmonic, not from the frequency. Beat
  over table is that difference seen at the reference rate, 1 + (h^2 - h_f^2) / (2 y^2): an error e of WL shows as
  e (WL/W)^2 there, which is little far above lock-in.
* **K cannot be found from A and h.** K times k, cos(tilt) over k and WL over k leave (1) as it is: a wrong scale
  factor is absorbed by the tilt and goes 1 : 1 into the lock-in rate.
* **K can be found with an angle or a rate of its own**: with a tilt that is known from elsewhere, K = A/cos(tilt);
  with the horizontal earth rate, which swings with the azimuth and is no multiple of the table's rate,
  K^2 = A^2 + (P^2 + Q^2)/w_h^2.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.special

from analysis.arrays import Bools, Floats, Indices
from analysis.budget import BIAS_LIMIT_DPH, LATITUDE_LIMIT_DEG
from analysis.flags import Flag
from analysis.lock_in_run.records import Method, RecordArrays, RunArrays, RunKnowledge, estimate_records
from analysis.lockin_rate import LockInEstimate
from analysis.rotation import EARTH_RATE_DPS, earth_rate_on_axis, tilt_from_fast_runs

UNLIKELY = 0.001  # a difference that chance makes less often than this is real
_TELLS_NOTHING = 0.1  # relative uncertainty of a scale factor that is not worth saying

_HARMONICS_TRUSTED = 0.1
"""Relative standard uncertainty that the lock-in rate by the harmonics has where it must not decide on K."""

Way = Literal["known tilt", "earth rate"]


@dataclass(frozen=True)
class ScaleFactorCheck:
    """K by a way of its own."""

    by: Way  # {"known tilt", "earth rate"}
    scale_factor: float  # pulses per degree
    scale_factor_u: float
    p_value: float  # probability of so large a difference from the scale factor used, with what is known of both


@dataclass(frozen=True)
class TableCheck:
    """The same records, with the rate of the table as reference instead of the beat frequency."""

    lock_in_rate: float  # deg/s
    lock_in_rate_u: float
    input_rate: float  # mean rate on the gyro's axis from table, tilt and earth rate, deg/s
    # rate by the beat over rate by the table. The uncertainty counts frequencies, harmonics, table rates, earth
    # rate and azimuth; the scale factor only in so far as it does not cancel.
    beat_over_table: float
    beat_over_table_u: float
    p_value: float  # probability of so large a difference from 1
    least_error_seen: float  # relative error of the lock-in rate from which on this check would show it
    # deg/s; the lock-in rate by how far the slow beats are pulled down and the fast ones are not
    by_frequencies: float
    by_frequencies_u: float
    # empty: nothing in the records and in what is known tests the scale factor
    scale_factors: tuple[ScaleFactorCheck, ...] = ()
    # of beat_over_table_u: what moves from one setting of the table to the next is found from few of them
    degrees_of_freedom: float = math.inf
    # the same where the lock-in rate by the harmonics may be wrong by all that its budget counts: what nobody
    # knows of detector and channel explains a difference, chance need not. nan: there is no budget yet.
    p_value_by_all: float = math.nan

    @property
    def mismatch(self) -> bool:
        """Whether beat and table differ by more than chance explains."""
        return self.p_value < UNLIKELY

    @property
    def unexplained(self) -> bool:
        """Whether they differ by more than everything explains that the budget counts."""
        return self.mismatch and not self.p_value_by_all >= UNLIKELY

    def beside_budget(self, lock_in_rate: float, others_u: float) -> TableCheck:
        """The same, knowing what the lock-in rate by the harmonics may be wrong by."""
        allowed = abs(lock_in_rate) * others_u / self.input_rate**2
        spread = Spread(self.beat_over_table_u, self.degrees_of_freedom).beside(allowed)
        return replace(self, p_value_by_all=spread.p_value(self.beat_over_table - 1))

    @property
    def scale_factor_mismatch(self) -> bool:
        """Whether a scale factor found by a way of its own is not the one used."""
        return any(one.p_value < UNLIKELY for one in self.scale_factors)


@dataclass(frozen=True)
class ByTable:
    """Lock-in rate with the table's rate as reference: value and noise, deg/s, and the rate on the axis there."""

    lock_in_rate: float
    noise_u: float
    input_rate: float
    beat_frequency: float


def check_by_table(
    run: RunArrays,
    each: tuple[LockInEstimate, LockInEstimate],
    result: LockInEstimate,
    by_table: ByTable,
    axis: AxisRates,
    tilt: Tilt,
    knowledge: RunKnowledge,
) -> TableCheck:
    """Test beat frequencies, harmonics and table rates of a run against each other."""
    used = result.scale_factor
    squared = (used * float(result.lock_in_rate)) ** 2
    # of the square of a normal number: it does not vanish where noise leaves a lock-in rate of zero
    own_u = used * float(result.lock_in_rate_u)
    squared_u = own_u * math.sqrt(4 * squared + 2 * own_u**2)
    seen = TableReading.of(run, each, knowledge)
    stated = Stated.of(knowledge, tilt)
    along = knowledge.scale_factor * math.cos(math.radians(tilt.tilt_deg))
    start = np.array([along, *stated.earth, squared, 0.0, 0.0])
    known = {1: stated.earth_u[0], 2: stated.earth_u[1], BIAS: stated.bias_u}
    curve = fitted_curve(seen, start, known, stated)
    difference, spread = (
        squared - float(curve.values[3]),
        curve.spread(np.array([0.0, 0.0, 0.0, 1.0])).beside(squared_u),
    )
    turning = by_table.beat_frequency**2 + squared
    pulled = math.sqrt(max(float(curve.values[3]), 0.0)) / used
    over = knowledge.scale_factor / used * (1 + difference / (2 * turning))
    over_spread = spread.times(1 / (2 * turning))
    shared = math.hypot(float(np.max(axis.common_u)), float(np.max(axis.azimuth_u)) / abs(by_table.input_rate))
    ways = [_by_tilt(curve, knowledge, stated, used)]
    if not seen.blind.any():
        far = 10 * stated.earth[0]
        known |= {1: far, 2: far, 3: max(2 * _HARMONICS_TRUSTED * squared, squared_u)}
        ways.append(_by_earth(fitted_curve(seen, start, known, stated, rate_moves=True), stated, used))
    return TableCheck(
        lock_in_rate=by_table.lock_in_rate,
        lock_in_rate_u=math.hypot(by_table.noise_u, by_table.lock_in_rate * shared),
        input_rate=by_table.input_rate,
        beat_over_table=over,
        beat_over_table_u=over_spread.u,
        p_value=over_spread.p_value(over - 1),
        least_error_seen=spread.seen(UNLIKELY) / (2 * squared) if squared > 0 else math.inf,
        by_frequencies=pulled,
        by_frequencies_u=curve.u(3) / (2 * used**2 * pulled) if pulled > 0 else math.sqrt(curve.u(3)) / used,
        scale_factors=tuple(way for way in ways if way is not None),
        degrees_of_freedom=over_spread.degrees,
    )


def _by_tilt(curve: Curve, knowledge: RunKnowledge, stated: Stated, used: float) -> ScaleFactorCheck | None:
    """K = A / cos(tilt), with a tilt that is known without the gyro."""
    if not math.isfinite(knowledge.known_tilt_deg):
        return None
    tilt, tilt_u = math.radians(knowledge.known_tilt_deg), math.radians(knowledge.known_tilt_u_deg)
    found = float(curve.values[0]) / math.cos(tilt)
    # the second order counts where the axis stands upright
    by_angle = math.hypot(math.tan(tilt) * tilt_u, tilt_u**2 / math.sqrt(2))
    spread = curve.spread(np.array([1 / math.cos(tilt)])).beside(found * math.hypot(by_angle, stated.table_u))
    return _compared("known tilt", found, spread, stated, used)


def _by_earth(curve: Curve, stated: Stated, used: float) -> ScaleFactorCheck | None:
    """K^2 = A^2 + (P^2 + Q^2) / w_h^2, nothing being known of K, north and tilt."""
    a, p, q = curve.values[:3].tolist()
    if not (stated.horizontal > 0 and math.isfinite(curve.u(1))):
        return None
    turned = (p**2 + q**2) / stated.horizontal**2
    found = math.sqrt(a**2 + turned)
    slope = np.array([a, p / stated.horizontal**2, q / stated.horizontal**2]) / found
    return _compared(
        "earth rate", found, curve.spread(slope).beside(turned / found * stated.latitude_u), stated, used
    )


def _compared(by: Way, found: float, spread: Spread, stated: Stated, used: float) -> ScaleFactorCheck | None:
    if not spread.u < _TELLS_NOTHING * used:
        return None
    return ScaleFactorCheck(by, found, spread.u, spread.beside(used * stated.scale_u).p_value(found - used))


# --------------------
# The rate table: tilt of the gyro's axis from the fast run, rate on the axis, and what that says of WL


_UNIFORM = math.sqrt(12)
"""Width over standard deviation: a record lies somewhere between two readings of the azimuth."""

_EAST, _NORTH = 90.0, 0.0
_AT_ONCE = 1 << 14


@dataclass(frozen=True)
class Tilt:
    """Angle between gyro axis and table axis, deg.

    Its standard uncertainty counts the frequencies, the scale factor and the rate of the table.
    """

    tilt_deg: float
    tilt_u_deg: float


@dataclass(frozen=True)
class AxisRates:
    """Rates on the gyro's axis by the table."""

    rates: Floats  # (n,): deg/s, signed, one for each record
    # (n,): Relative standard uncertainty of them that all records share: tilt, with the scale factor by which it
    # was found, and an azimuth that nobody knows
    common_u: Floats
    # (n,): deg/s; standard uncertainty from the place of a record between two readings of the azimuth. It is much
    # the same for all records at one rate.
    azimuth_u: Floats


def axis_rate_is_known(run: RunArrays, knowledge: RunKnowledge) -> bool:
    """Whether the fast run has all its senses, and every slow record a table rate."""
    senses = 2 if knowledge.both_senses else 1
    return bool(np.isfinite(run.slow.table_rate).all()) and np.unique(run.fast.table_rate).size == senses


def find_tilt(fast: RecordArrays, knowledge: RunKnowledge, lock_in_rate: float = math.nan) -> Tilt:
    """Find the tilt from the records of the fast run."""
    each = fast_estimates(fast, knowledge)
    frequency, frequency_u = each.beat_frequency, each.beat_frequency_u
    pulling: float | Floats = lock_in_rate
    if not math.isfinite(lock_in_rate):
        # lock-in pulls the beat down by (WL/W)^2 / 2, nearly 2 r^2; a ratio in the noise bounds it
        seen = (each.flags & int(Flag.RATIO_NOT_SIGNIFICANT)) == 0
        seen &= seen.mean() > 0.5  # otherwise it is one by chance
        pulling = np.where(seen, each.lock_in_rate, 0.0)
        unknown = np.where(seen, 4 * each.ratio * each.ratio_u, 2 * (each.ratio**2 + each.ratio_u**2))
        frequency_u = np.hypot(frequency_u, frequency * unknown)
    oriented = bool(np.isfinite(fast.azimuth).all())
    fit = tilt_from_fast_runs(
        frequency,
        frequency_u,
        fast.table_rate,
        scale_factor=knowledge.scale_factor,
        latitude_deg=knowledge.latitude_deg,
        azimuth_deg=fast.azimuth - knowledge.north_azimuth_deg if oriented else None,
        azimuth_u_deg=fast.turned / _UNIFORM if oriented else 0.0,
        lock_in_rate=pulling,
        scale_factor_u=knowledge.scale_factor * knowledge.relative_scale_u,
        table_rate_u=knowledge.relative_table_u,
        by_scatter=True,
    )
    return Tilt(fit.tilt_deg, fit.tilt_u_deg)


def fast_estimates(fast: RecordArrays, knowledge: RunKnowledge) -> LockInEstimate:
    """Estimate each record of the fast run, fields of shape (n,)."""
    return estimate_records(fast, Method(knowledge.scale_factor))


def axis_rates(slow: RecordArrays, tilt: Tilt, knowledge: RunKnowledge) -> AxisRates:
    """Work out the rate on the axis during each record from table rate, tilt and earth rate."""

    def earth_rate(azimuth_deg: float | Floats) -> Floats:
        return earth_rate_on_axis(knowledge.latitude_deg, tilt.tilt_deg, azimuth_deg)

    found = AxisRates(*(np.empty(len(slow)) for _ in range(3)))
    vertical = earth_rate(_EAST)
    tilt_part = math.tan(math.radians(tilt.tilt_deg)) * math.radians(tilt.tilt_u_deg)
    # the horizontal part at an azimuth that nobody knows: a cosine has a mean square of one half
    swing = abs(float(earth_rate(_NORTH) - vertical)) / math.sqrt(2)
    for first in range(0, len(slow), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        middle = (slow.azimuth_start[some] + slow.azimuth_end[some]) / 2
        oriented = np.isfinite(middle)
        # then only the vertical part of the earth rate is left: that at east
        azimuth = np.where(oriented, middle - knowledge.north_azimuth_deg, _EAST)
        rates = slow.table_rate[some] * math.cos(math.radians(tilt.tilt_deg)) + earth_rate(azimuth)
        slope = np.abs(earth_rate(azimuth + 90.0) - vertical)
        turned = np.abs(slow.azimuth_end[some] - slow.azimuth_start[some])
        found.rates[some] = rates
        found.azimuth_u[some] = np.where(oriented, slope * np.radians(turned) / _UNIFORM, 0.0)
        found.common_u[some] = np.hypot(tilt_part, np.where(oriented, 0.0, swing / np.abs(rates)))
    return found


# --------------------
# Beat frequencies over the rates of a table, by least squares: the curve that `table_check` tests them with.
#
#     sqrt(f^2 + h^2) = A (W_T + w_v) + P cos(a) + Q sin(a) + B
#
# with h = K WL, table rate W_T, vertical earth rate w_v, azimuth a and a bias B of the gyro


BIAS, _PLACES = 4, 6  # a, P, Q, h^2, B, and the place of a record between its two readings of the azimuth

_RECTANGLE = math.sqrt(3.0)
_UNIFORM_CURVE = math.sqrt(12.0)
_NORTH_U = math.radians(0.1)  # of the azimuth that is stated for north: somebody aligned it with care
_FEWEST = 3  # degrees of freedom: fewer tell next to nothing of a variance

_ROUNDS, _CURVES_AT_ONCE = 60, 10_000
_STILL = 1e-6  # of the swing of the earth rate: what does not move


@dataclass(frozen=True)
class _Some:
    """_Some records with a beat, (m,): Hz, deg/s, rad from north, rad turned in each, table's setting."""

    frequency: Floats
    frequency_u: Floats
    table_rate: Floats
    azimuth: Floats
    turned: Floats
    setting: Indices

    @property
    def oriented(self) -> Bools:
        """Whether the azimuth of each is known."""
        return np.isfinite(self.azimuth)


@dataclass(frozen=True)
class TableReading:
    """Records of the table, slow and then fast (n,): Hz, and which beat; the rest is read some at a time."""

    run: RunArrays
    frequency: Floats  # (n,)
    frequency_u: Floats
    beating: Bools
    settings: Floats  # (s,) rates of the table at which records beat, deg/s, rising
    blind: Bools  # (s,) whether the azimuth of some record there is not known
    north_deg: float

    @classmethod
    def of(
        cls, run: RunArrays, each: tuple[LockInEstimate, LockInEstimate], knowledge: RunKnowledge
    ) -> TableReading:
        """Of a run and the estimates of each of its slow and fast records, fields of shape (n,)."""
        table = (run.slow.table_rate, run.fast.table_rate)
        beating = [one.usable & (one.beat_frequency_u > 0) for one in each]
        settings = np.unique(
            np.concatenate([np.unique(rate[there]) for rate, there in zip(table, beating, strict=True)])
        )
        seen = cls(
            run,
            np.concatenate([one.beat_frequency for one in each]),
            np.concatenate([one.beat_frequency_u for one in each]),
            np.concatenate(beating),
            settings,
            np.zeros(settings.size, dtype=bool),
            knowledge.north_azimuth_deg,
        )
        for some in seen.blocks():
            seen.blind[some.setting[~some.oriented]] = True
        return seen

    def blocks(self) -> Iterator[_Some]:
        """Records that beat, some at a time."""
        slow, fast = self.run.slow, self.run.fast
        for first in range(0, self.beating.size, _CURVES_AT_ONCE):
            last = first + _CURVES_AT_ONCE
            rows = slice(first, last), slice(max(first - len(slow), 0), max(last - len(slow), 0))
            there = self.beating[first:last]

            def of(name: str, rows: tuple[slice, slice] = rows, there: Bools = there) -> Floats:
                parts = [getattr(one, name)[some] for one, some in zip((slow, fast), rows, strict=True)]
                return np.asarray(np.concatenate(parts)[there], dtype=np.float64)

            table_rate, start, end = of("table_rate"), of("azimuth_start"), of("azimuth_end")
            yield _Some(
                self.frequency[first:last][there],
                self.frequency_u[first:last][there],
                table_rate,
                np.radians((start + end) / 2 - self.north_deg),
                np.radians(end - start),
                np.searchsorted(self.settings, table_rate),
            )


@dataclass(frozen=True)
class Stated:
    """What enters the curve from elsewhere."""

    earth: tuple[float, float]  # P and Q with the scale factor, north and latitude that are stated, Hz
    earth_u: tuple[float, float]
    vertical: float  # of the earth rate, deg/s; latitude_u relative, of the second
    horizontal: float
    latitude_u: float
    bias_u: float  # of B, Hz
    table_u: float  # relative
    scale_u: float

    @property
    def swing(self) -> float:
        """Of the earth rate at a phase that nobody knows, Hz; a cosine has a mean square of one half there."""
        return math.hypot(*self.earth) / math.sqrt(2)

    @classmethod
    def of(cls, knowledge: RunKnowledge, tilt: Tilt) -> Stated:
        """Of what is known of the bench; the tilt is that by the fast run."""
        latitude = math.radians(knowledge.latitude_deg)
        scale_u = knowledge.relative_scale_u
        latitude_u = math.radians(knowledge.latitude_u_deg or LATITUDE_LIMIT_DEG / _RECTANGLE) * abs(
            math.tan(latitude)
        )
        horizontal = EARTH_RATE_DPS * math.cos(latitude)
        swing = knowledge.scale_factor * horizontal * math.sin(math.radians(tilt.tilt_deg))
        return cls(
            earth=(swing, 0.0),
            earth_u=(max(swing * math.hypot(scale_u, latitude_u), 1e-12), max(swing * _NORTH_U, 1e-12)),
            vertical=EARTH_RATE_DPS * math.sin(latitude),
            horizontal=horizontal,
            latitude_u=latitude_u,
            bias_u=knowledge.scale_factor * BIAS_LIMIT_DPH / 3600 / _RECTANGLE,
            table_u=knowledge.relative_table_u,
            scale_u=scale_u,
        )


@dataclass(frozen=True)
class Spread:
    """A standard uncertainty, and the degrees of freedom that it was found with."""

    u: float
    degrees: float

    def beside(self, known_u: float) -> Spread:
        """Together with another one that is known."""
        u = math.hypot(self.u, known_u)
        return Spread(u, self.degrees * (u / self.u) ** 4 if self.u > 0 else math.inf)

    def times(self, factor: float) -> Spread:
        """Of so many times the number."""
        return Spread(abs(factor) * self.u, self.degrees)

    def p_value(self, difference: float) -> float:
        """Probability of so large a difference, nan without an uncertainty."""
        if not self.u > 0:
            return math.nan
        beyond = -abs(difference) / self.u
        known = math.isinf(self.degrees)
        return 2 * float(scipy.special.ndtr(beyond) if known else scipy.special.stdtr(self.degrees, beyond))

    def seen(self, unlikely: float) -> float:
        """Difference that has this probability."""
        known = math.isinf(self.degrees)
        low = scipy.special.ndtri(unlikely / 2) if known else scipy.special.stdtrit(self.degrees, unlikely / 2)
        return -self.u * float(low)


@dataclass(frozen=True)
class Curve:
    """A, P, Q, h^2 and what else was fitted, with their covariance."""

    values: Floats
    covariance: Floats
    still: Floats  # covariance if nothing moved from one setting of the table to the next
    degrees: int  # of freedom that the size of that motion was found with

    def u(self, place: int) -> float:
        """Standard uncertainty of one value."""
        return math.sqrt(self.covariance[place, place])

    def spread(self, slope: Floats) -> Spread:
        """Of a number with this slope by the first values."""
        # By Welch and Satterthwaite: the noise is known, what moves between settings is found from few of them.
        first = slope.size
        variance, still = (float(slope @ c[:first, :first] @ slope) for c in (self.covariance, self.still))
        share = max(1 - still / variance, 0.0) if variance > 0 else 0.0
        return Spread(math.sqrt(variance), self.degrees / share**2 if share > 0 else math.inf)


def fitted_curve(
    seen: TableReading, start: Floats, known: dict[int, float], stated: Stated, *, rate_moves: bool = False
) -> Curve:
    """Fit the curve by least squares; `known` holds the standard uncertainties of start values that are known."""
    # Every setting of the table has an error of its own, and where nobody knows the azimuth, an earth rate of its
    # own. A scatter beyond the noise of the frequencies enlarges that noise; with `rate_moves` it is the same in
    # Hz for all (Paule and Mandel, J. Res. NBS 87, 377). What the records of a setting have in common beyond that,
    # as a ripple in step with them makes it, or coupling at a slow rate, is as large in Hz at every setting; its
    # size is found in the same way.
    settings = seen.settings.size
    values = np.concatenate([start, np.zeros(2 * settings)])
    moving, stretch = 0.0, 1.0
    told = 4 if rate_moves else 2  # of the first values, by the records
    few = settings - told < _FEWEST
    free = max(int(seen.beating.sum()) - settings - few, 1)
    for _ in range(_ROUNDS):
        equations = _TableEquations.none(settings, values.size)
        for some in seen.blocks():
            noise = np.sqrt((stretch * some.frequency_u) ** 2 + moving)
            equations.add(*_linearised(values, some, stated), noise, some.setting)
        # too few settings do not tell what moves from one to the next
        about_curve = float(np.sum(equations.moments[4])), float(np.sum(equations.moments[5]))
        chi_square, slope_by_variance = about_curve if few else equations.within_settings()
        beyond = chi_square - free
        as_expected = abs(beyond) <= 0.01 * free or (beyond < 0 and moving == 0 and stretch == 1)
        system = _System(seen, start, known, values, stated.swing, equations.triangle)
        common = 0.0 if few else system.common_to_a_setting(chi_square, settings - told)
        change, covariance = system.solved(common)
        values = values + change
        if as_expected and np.all(np.abs(change) < 1e-6 * np.sqrt(np.diagonal(covariance))):
            break
        if not as_expected and rate_moves:
            moving = max(moving + beyond / slope_by_variance, 0.0)
        elif not as_expected:
            stretch = max(stretch * math.sqrt(chi_square / free), 1.0)
    return Curve(values, covariance, system.solved(0.0)[1], settings - told)


@dataclass
class _TableEquations:
    """The triangle, by QR of some records at a time, that stands for the equations of all; right side last."""

    triangle: Floats
    # (6, s) sums over the records of a setting, by which they scatter about a mean: the distance to the power 0, 1
    # and 2, each over the noise to the power 2 and 4
    moments: Floats

    @staticmethod
    def none(n_settings: int, n_values: int) -> _TableEquations:
        return _TableEquations(np.empty((0, n_values + 1)), np.zeros((6, n_settings)))

    def add(self, left: Floats, slopes: Floats, noise: Floats, setting: Indices) -> None:
        """Distances of some records from the curve, Hz, their derivatives by all values, and their noise."""
        equations = np.column_stack([slopes, left]) / noise[:, np.newaxis]
        self.triangle = np.asarray(np.linalg.qr(np.concatenate([self.triangle, equations]), mode="r"))
        for row, (power, of_noise) in enumerate(itertools.product((0, 1, 2), (2, 4))):
            np.add.at(self.moments[row], setting, left**power / noise**of_noise)

    def within_settings(self) -> tuple[float, float]:
        """Chi-square of the records about the means of their settings, and how it falls with the variance."""
        n2, n4, l2, l4, ll2, ll4 = self.moments
        mean = l2 / np.maximum(n2, 1e-300)
        return float(np.sum(ll2 - mean * l2)), float(np.sum(ll4 - 2 * mean * l4 + mean**2 * n4))


@dataclass(frozen=True)
class _System:
    """The equations of the records, and of what is known before them."""

    seen: TableReading
    start: Floats
    known: dict[int, float]
    values: Floats
    swing: float
    of_records: Floats

    def _rows(self, common: float) -> Floats:
        """Equations of what is known: some of the first values, the place in a record, errors of the settings."""
        settings = self.seen.settings.size
        own = np.hypot(np.where(self.seen.blind, 1.0, _STILL), common / self.swing if self.swing > 0 else 0.0)
        weights = np.concatenate([[_UNIFORM_CURVE], np.ones(settings), 1 / own])
        rows = np.zeros((len(self.known) + weights.size, self.values.size + 1))
        for row, (place, u) in enumerate(self.known.items()):
            rows[row, place], rows[row, -1] = 1 / u, (self.start[place] - self.values[place]) / u
        rows[len(self.known) :, _PLACES - 1 : -1] = np.diag(weights)
        rows[len(self.known) :, -1] = -weights * self.values[_PLACES - 1 :]
        return rows

    def _white(self, common: float) -> Floats:
        return np.asarray(np.linalg.qr(np.concatenate([self._rows(common), self.of_records]), mode="r"))

    def common_to_a_setting(self, within: float, degrees: int) -> float:
        """Standard deviation, Hz, of what the records of a setting have in common."""
        # Chi-square beyond that `within` the settings is then as expected for so many degrees of freedom.
        least, most = (share * self.swing for share in (_STILL, 1 / _STILL))
        if not least > 0:
            return 0.0
        expected = max(within, self._chi_square(most)) + degrees
        if self._chi_square(least) <= expected:
            return 0.0
        while most > least * (1 + 1e-9):  # halved: scipy.optimize takes longer to import than all of this
            middle = math.sqrt(least * most)
            least, most = (least, middle) if self._chi_square(middle) <= expected else (middle, most)
        return math.sqrt(least * most)

    def _chi_square(self, common: float) -> float:
        return float(self._white(common)[-1, -1] ** 2)

    def solved(self, common: float) -> tuple[Floats, Floats]:
        """Change of the values, and their covariance."""
        white = self._white(common)[:-1]
        size = np.linalg.norm(white[:, :-1], axis=0)
        inverse = np.linalg.pinv(white[:, :-1] / size, rcond=1e-12) / size[:, np.newaxis]
        return np.asarray(inverse @ white[:, -1]), np.asarray(inverse @ inverse.T)


def _linearised(values: Floats, seen: _Some, stated: Stated) -> tuple[Floats, Floats]:
    """Distance of the records from the curve, Hz, and its derivatives by all values."""
    along, north, east, squared, bias, place = values[:_PLACES]
    error, earth = np.split(values[_PLACES:], 2)
    settings = error.size
    own = np.eye(settings)[seen.setting]
    azimuth = np.where(seen.oriented, seen.azimuth + place * seen.turned, 0.0)
    cos, sin = np.where(seen.oriented, (np.cos(azimuth), np.sin(azimuth)), 0.0)
    moved = np.where(seen.oriented, seen.turned * (east * cos - north * sin), 0.0)
    swing = stated.swing
    sense = np.sign(seen.table_rate)
    table = seen.table_rate * stated.table_u
    rate = seen.table_rate + stated.vertical + table * error[seen.setting]
    y = along * rate + north * cos + east * sin + bias + swing * earth[seen.setting]
    left = np.sqrt(np.maximum(seen.frequency**2 + squared, 0.0)) - sense * y
    ones = np.ones(y.size)
    columns = [rate, cos, sin, -sense / (2 * np.abs(y)), ones, moved, *(along * table * own.T), *(swing * own.T)]
    return left, np.asarray(sense[:, np.newaxis] * np.stack(columns, axis=-1))
