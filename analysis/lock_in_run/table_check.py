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

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.lock_in_run.records import RunArrays, RunKnowledge
from analysis.lock_in_run.table_curve import BIAS, Curve, Seen, Spread, Stated, fitted_curve
from analysis.lock_in_run.table_rate import AxisRates, Tilt
from analysis.lockin_rate import LockInEstimate

UNLIKELY = 0.001
"""A difference that chance makes less often than this is real."""

_TELLS_NOTHING = 0.1
"""Relative uncertainty of a scale factor that is not worth saying."""

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
    squared_u = 2 * used**2 * float(result.lock_in_rate) * float(result.lock_in_rate_u)
    seen = Seen.of(run, each, knowledge)
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
        known |= {1: far, 2: far, 3: 2 * _HARMONICS_TRUSTED * squared}
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
