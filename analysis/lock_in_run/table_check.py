"""The check by the rate table: do beat frequencies, harmonics and table rates of a run fit together?

Fast and slow records lie on one curve. With y = sqrt(f^2 + h^2), h = K WL, table rate W_T and azimuth a,

    y = A (W_T + w_v) + P cos(a) + Q sin(a),      A = K cos(tilt),   sqrt(P^2 + Q^2) = K w_h sin(tilt)       (1)

w_v and w_h are the vertical and the horizontal earth rate. Three things follow from it:

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

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.special

from analysis.arrays import Bools, Floats, Indices
from analysis.budget.unstated import LATITUDE_LIMIT_DEG
from analysis.lock_in_run.records import RunArrays, RunKnowledge
from analysis.lock_in_run.table_rate import AxisRates, Tilt
from analysis.lockin_rate import LockInEstimate
from analysis.rotation import EARTH_RATE_DPS

UNLIKELY = 0.001
"""A difference that chance makes less often than this is real."""

SEEN = 3.29
"""Standard uncertainties at which `UNLIKELY` is reached."""

_RECTANGLE = math.sqrt(3.0)
_UNIFORM = math.sqrt(12.0)
_NORTH_U = math.radians(0.1)
"""Of the azimuth that is stated for north: somebody aligned it with care."""

_TELLS_NOTHING = 0.1
"""Relative uncertainty of a scale factor that is not worth saying."""

_HARMONICS_TRUSTED = 0.1
"""Relative standard uncertainty that the lock-in rate by the harmonics has where it must not decide on K."""

_ROUNDS, _AT_ONCE = 60, 10_000
_PLACES = 5
"""A, P, Q, h^2 and the place of a record between its two readings of the azimuth."""

Way = Literal["known tilt", "earth rate"]


@dataclass(frozen=True)
class ScaleFactorCheck:
    """K by a way of its own.

    Attributes
    ----------
    by : {"known tilt", "earth rate"}
    scale_factor, scale_factor_u : float
        Pulses per degree.
    p_value : float
        Probability of so large a difference from the scale factor used, with what is known of both.
    """

    by: Way
    scale_factor: float
    scale_factor_u: float
    p_value: float


@dataclass(frozen=True)
class TableCheck:
    """The same records, with the rate of the table as reference instead of the beat frequency.

    Attributes
    ----------
    lock_in_rate, lock_in_rate_u : float
        deg/s.
    input_rate : float
        Mean rate on the gyro's axis from table, tilt and earth rate, deg/s.
    beat_over_table, beat_over_table_u : float
        Rate by the beat over rate by the table. The uncertainty counts frequencies, harmonics, table rates, earth
        rate and azimuth; the scale factor only in so far as it does not cancel.
    p_value : float
        Probability of so large a difference from 1.
    p_value_by_all : float
        The same where the lock-in rate by the harmonics may be wrong by all that its budget counts: what nobody
        knows of detector and channel explains a difference, chance need not. nan: there is no budget yet.
    by_frequencies, by_frequencies_u : float
        deg/s; the lock-in rate by how far the slow beats are pulled down and the fast ones are not.
    least_error_seen : float
        Relative error of the lock-in rate from which on this check would show it.
    scale_factors : tuple of ScaleFactorCheck
        Empty: nothing in the records and in what is known tests the scale factor.
    """

    lock_in_rate: float
    lock_in_rate_u: float
    input_rate: float
    beat_over_table: float
    beat_over_table_u: float
    p_value: float
    least_error_seen: float
    by_frequencies: float
    by_frequencies_u: float
    scale_factors: tuple[ScaleFactorCheck, ...] = ()
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
        """The same, knowing what the lock-in rate by the harmonics may be wrong by.

        Parameters
        ----------
        lock_in_rate, others_u : float
            deg/s; its standard uncertainty by all that does not cancel in the check: not noise, not K.
        """
        allowed = abs(lock_in_rate) * others_u / self.input_rate**2
        return replace(
            self, p_value_by_all=_p_value(self.beat_over_table - 1, math.hypot(self.beat_over_table_u, allowed))
        )

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
    """Test beat frequencies, harmonics and table rates of a run against each other.

    Parameters
    ----------
    run : RunArrays
    each : tuple of LockInEstimate
        Fields of shape (n,): of the slow records and of the fast ones.
    result : LockInEstimate
        Fields of shape (): the lock-in rate by the beat.
    by_table : ByTable
    axis : AxisRates
        Of the slow records.
    tilt : Tilt
        By the fast run and the scale factor of `knowledge`.
    knowledge : RunKnowledge
    """
    used = result.scale_factor
    squared = (used * float(result.lock_in_rate)) ** 2
    squared_u = 2 * used**2 * float(result.lock_in_rate) * float(result.lock_in_rate_u)
    seen = _Seen.of(run, each, knowledge)
    stated = _Stated.of(knowledge, tilt)
    start = np.array([knowledge.scale_factor * math.cos(math.radians(tilt.tilt_deg)), *stated.earth, squared, 0.0])
    curve = _fitted(seen, start, {1: stated.earth_u[0], 2: stated.earth_u[1]}, stated)
    difference, difference_u = squared - float(curve.values[3]), math.hypot(squared_u, curve.u(3))
    turning = by_table.beat_frequency**2 + squared
    pulled = math.sqrt(max(float(curve.values[3]), 0.0)) / used
    over = knowledge.scale_factor / used * (1 + difference / (2 * turning))
    over_u = difference_u / (2 * turning)
    shared = math.hypot(float(np.max(axis.common_u)), float(np.max(axis.azimuth_u)) / abs(by_table.input_rate))
    ways = [_by_tilt(curve, knowledge, stated, used)]
    if not seen.blind.any():
        far = 10 * stated.earth[0]
        free = _fitted(seen, start, {1: far, 2: far, 3: 2 * _HARMONICS_TRUSTED * squared}, stated, rate_moves=True)
        ways.append(_by_earth(free, stated, used))
    return TableCheck(
        lock_in_rate=by_table.lock_in_rate,
        lock_in_rate_u=math.hypot(by_table.noise_u, by_table.lock_in_rate * shared),
        input_rate=by_table.input_rate,
        beat_over_table=over,
        beat_over_table_u=over_u,
        p_value=_p_value(over - 1, over_u),
        least_error_seen=SEEN * difference_u / (2 * squared) if squared > 0 else math.inf,
        by_frequencies=pulled,
        by_frequencies_u=curve.u(3) / (2 * used**2 * pulled) if pulled > 0 else math.sqrt(curve.u(3)) / used,
        scale_factors=tuple(way for way in ways if way is not None),
    )


def _p_value(difference: float, u: float) -> float:
    return float(2 * scipy.special.ndtr(-abs(difference) / u)) if u > 0 else math.nan


@dataclass(frozen=True)
class _Some:
    """Some records with a beat, (m,): Hz, deg/s, rad from north, rad turned in each, table's setting."""

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
class _Seen:
    """Records of the table, slow and then fast (n,): Hz, and which of them beat; the rest is read some at a time.

    frequency, frequency_u, beating : (n,)
    settings : (s,) rates of the table at which records beat, deg/s, rising
    blind : (s,) whether the azimuth of some record there is not known
    """

    run: RunArrays
    frequency: Floats
    frequency_u: Floats
    beating: Bools
    settings: Floats
    blind: Bools
    north_deg: float

    @classmethod
    def of(cls, run: RunArrays, each: tuple[LockInEstimate, LockInEstimate], knowledge: RunKnowledge) -> _Seen:
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
        for first in range(0, self.beating.size, _AT_ONCE):
            last = first + _AT_ONCE
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
class _Stated:
    """What enters the curve from elsewhere.

    earth, earth_u : P and Q of (1) with the scale factor, north and latitude that are stated, Hz
    vertical, horizontal : of the earth rate, deg/s; latitude_u relative, of the second
    table_u, scale_u : relative
    """

    earth: tuple[float, float]
    earth_u: tuple[float, float]
    vertical: float
    horizontal: float
    latitude_u: float
    table_u: float
    scale_u: float

    @classmethod
    def of(cls, knowledge: RunKnowledge, tilt: Tilt) -> _Stated:
        latitude = math.radians(knowledge.latitude_deg)
        scale_u = knowledge.relative_scale_u
        latitude_u = math.radians(knowledge.latitude_u_deg or LATITUDE_LIMIT_DEG / _RECTANGLE) * abs(
            math.tan(latitude)
        )
        horizontal = EARTH_RATE_DPS * math.cos(latitude)
        swing = knowledge.scale_factor * horizontal * math.sin(math.radians(tilt.tilt_deg))
        return cls(
            earth=(swing, 0.0),
            earth_u=(
                max(swing * math.hypot(scale_u, latitude_u), 1e-12),
                max(swing * _NORTH_U, 1e-12),
            ),
            vertical=EARTH_RATE_DPS * math.sin(latitude),
            horizontal=horizontal,
            latitude_u=latitude_u,
            table_u=knowledge.relative_table_u,
            scale_u=scale_u,
        )


@dataclass(frozen=True)
class _Curve:
    """A, P, Q, h^2 and what else was fitted, with their covariance."""

    values: Floats
    covariance: Floats

    def u(self, place: int) -> float:
        return math.sqrt(self.covariance[place, place])


def _fitted(
    seen: _Seen, start: Floats, known: dict[int, float], stated: _Stated, *, rate_moves: bool = False
) -> _Curve:
    """Curve (1) by least squares; `known` holds the standard uncertainties of start values that are known.

    Every setting of the table has an error of its own, and where nobody knows the azimuth, an earth rate of its
    own. A scatter beyond the noise of the frequencies enlarges that noise; with `rate_moves` it is the same in Hz
    for all (Paule and Mandel, J. Res. NBS 87, 377).
    """
    values = np.concatenate([start, np.zeros(2 * seen.settings.size)])
    prior = _prior(seen, known)
    aim, moving, stretch = prior @ values, 0.0, 1.0
    free = max(int(seen.beating.sum()) - seen.settings.size - 1, 1)
    for _ in range(_ROUNDS):
        known_left = (aim - prior @ values)[:, np.newaxis]
        equations = _Equations(np.hstack([prior, known_left]))
        for some in seen.blocks():
            equations.add(*_linearised(values, some, stated), np.sqrt((stretch * some.frequency_u) ** 2 + moving))
        white = equations.triangle
        size = np.linalg.norm(white[:, :-1], axis=0)
        inverse = np.linalg.pinv(white[:, :-1] / size, rcond=1e-12) / size[:, np.newaxis]
        change = inverse @ white[:, -1]
        values = values + change
        covariance = inverse @ inverse.T
        if np.all(np.abs(change) < 1e-6 * np.sqrt(np.diagonal(covariance))):
            beyond_noise = equations.chi_square - free
            if beyond_noise <= 0.01 * free:
                break
            if rate_moves:
                moving += beyond_noise / equations.slope_by_variance
            else:
                stretch *= math.sqrt(1 + beyond_noise / free)
    return _Curve(values, covariance)


@dataclass
class _Equations:
    """The triangle that stands for the equations of all records, over their noise; right side in its last column.

    It comes out of a QR decomposition, some records at a time: those of a million need no room. It begins with the
    equations of what is known before.

    chi_square, slope_by_variance : of the records' distances from the curve, and how it falls with their variance
    """

    triangle: Floats
    chi_square: float = 0.0
    slope_by_variance: float = 0.0

    def add(self, left: Floats, slopes: Floats, noise: Floats) -> None:
        """Distances of some records from the curve, Hz, their derivatives by all values, and their noise."""
        equations = np.column_stack([slopes, left]) / noise[:, np.newaxis]
        self.triangle = np.asarray(np.linalg.qr(np.concatenate([self.triangle, equations]), mode="r"))
        self.chi_square += float(np.sum((left / noise) ** 2))
        self.slope_by_variance += float(np.sum(left**2 / noise**4))


def _prior(seen: _Seen, known: dict[int, float]) -> Floats:
    """Rows of what is known before: some of the first values, the place in a record, errors and earth rates."""
    settings = seen.settings.size
    weights = np.concatenate([[_UNIFORM], np.ones(settings), np.where(seen.blind, 1.0, 1e6)])
    rows = np.zeros((len(known) + weights.size, _PLACES + 2 * settings))
    for row, (place, u) in enumerate(known.items()):
        rows[row, place] = 1 / u
    rows[len(known) :, _PLACES - 1 :] = np.diag(weights)
    return rows


def _linearised(values: Floats, seen: _Some, stated: _Stated) -> tuple[Floats, Floats]:
    """Distance of the records from the curve, Hz, and its derivatives by all values."""
    along, north, east, squared, place = values[:_PLACES]
    error, earth = np.split(values[_PLACES:], 2)
    settings = error.size
    own = np.eye(settings)[seen.setting]
    azimuth = np.where(seen.oriented, seen.azimuth + place * seen.turned, 0.0)
    cos, sin = np.where(seen.oriented, (np.cos(azimuth), np.sin(azimuth)), 0.0)
    moved = np.where(seen.oriented, seen.turned * (east * cos - north * sin), 0.0)
    # a cosine at a phase that nobody knows has a mean square of one half
    swing = math.hypot(*stated.earth) / math.sqrt(2)
    sense = np.sign(seen.table_rate)
    table = seen.table_rate * stated.table_u
    rate = seen.table_rate + stated.vertical + table * error[seen.setting]
    y = along * rate + north * cos + east * sin + swing * earth[seen.setting]
    left = np.sqrt(np.maximum(seen.frequency**2 + squared, 0.0)) - sense * y
    columns = [rate, cos, sin, -sense / (2 * np.abs(y)), moved, *(along * table * own.T), *(swing * own.T)]
    return left, np.asarray(sense[:, np.newaxis] * np.stack(columns, axis=-1))


def _by_tilt(curve: _Curve, knowledge: RunKnowledge, stated: _Stated, used: float) -> ScaleFactorCheck | None:
    """K = A / cos(tilt), with a tilt that is known without the gyro."""
    if not math.isfinite(knowledge.known_tilt_deg):
        return None
    tilt, tilt_u = math.radians(knowledge.known_tilt_deg), math.radians(knowledge.known_tilt_u_deg)
    found = float(curve.values[0]) / math.cos(tilt)
    # the second order counts where the axis stands upright
    by_angle = math.hypot(math.tan(tilt) * tilt_u, tilt_u**2 / math.sqrt(2))
    u = found * math.hypot(curve.u(0) / float(curve.values[0]), by_angle, stated.table_u)
    return _compared("known tilt", found, u, stated, used)


def _by_earth(curve: _Curve, stated: _Stated, used: float) -> ScaleFactorCheck | None:
    """K^2 = A^2 + (P^2 + Q^2) / w_h^2, nothing being known of K, north and tilt."""
    a, p, q = curve.values[:3].tolist()
    if not (stated.horizontal > 0 and math.isfinite(curve.u(1))):
        return None
    turned = (p**2 + q**2) / stated.horizontal**2
    found = math.sqrt(a**2 + turned)
    slope = np.array([a, p / stated.horizontal**2, q / stated.horizontal**2]) / found
    u = math.sqrt(float(slope @ curve.covariance[:3, :3] @ slope))
    return _compared("earth rate", found, math.hypot(u, turned / found * stated.latitude_u), stated, used)


def _compared(by: Way, found: float, u: float, stated: _Stated, used: float) -> ScaleFactorCheck | None:
    if not u < _TELLS_NOTHING * used:
        return None
    return ScaleFactorCheck(by, found, u, _p_value(found - used, math.hypot(u, used * stated.scale_u)))
