"""Lock-in rate from beat and single beams together: what their modulation settles that the beat leaves open.

Backscatter modulates the two beams at the beat frequency ("winking"). Let C = a1 e^(-i eps/2) + a2 e^(i eps/2) and
D = a2 e^(i eps/2) - a1 e^(-i eps/2), both turned by the readout phase, and g and g_d the rates at which sum and
difference of the beams relax. Far above lock-in AC over DC of beams 1 and 2, against the phase of the beat, is

    m = i C/(g + i w) +- i D/(g_d + i w),     the conjugate of both numerators in the other sense      (1)

while the beat's second harmonic over its fundamental is -C/(2 w) g/(g + i w), and WL = |C|/(2 pi K). So the beams
show the phase of C, which distortion of the receiver hides, D, which no harmonic shows, and g.

The fit is not of first order: every setting is the periodic solution of the equations of a two-mode laser
(`analysis.two_mode_laser`) at the beat that was seen, and its signals go through three receivers. One
least-squares fit has the harmonics of the beat, the beams and the rates of the table as its data, and whatever may
spoil them as its unknowns, each with a bound.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Bools, Complexes, Floats, Indices, NoFit
from analysis.beam_swings import BeamModulation, BeamsFlag
from analysis.budget import SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT, BenchKnowledge, lowest_bandwidth
from analysis.frequency_method import fit_frequencies
from analysis.lockin_rate import size_interval
from analysis.several_rates import RatesFit, prior_of
from analysis.several_rates.points import Points, gather, with_noise
from analysis.several_rates.ratio_model import SENSES, RatioData, in_standard_uncertainties, nearest_series
from analysis.two_mode_laser import lines_in_time, periodic_states, states_beside, steps_of_a_turn

# --------------------
# What is fitted, and what is known of it beforehand


N_PARAMETERS = 25

# Both backscatters, turned by the readout phase: complex logarithms of a1 e^(-i eps/2) and a2 e^(i eps/2), rad/s.
# In logarithms the valleys of chi-square are straight
FIRST, SECOND = slice(0, 2), slice(2, 4)
# logarithm of g (rad/s), cross over self saturation
GAIN, SATURATION = 4, 5
# of the beat's receiver: second and third order, time of its pole (s)
DISTORTION, LAG, THIRD_ORDER = 6, 7, 8
# what changes: phase between the senses, over the run, its bend (rad), backscatter (relative)
BETWEEN, TURN, BEND, DRIFT = 9, 10, 11, 12
# of each beam's receiver: logarithm of the level's error, crosstalk of the beat and of the other beam, delay (s)
LEVEL, CROSSTALK, OTHER_BEAM, DELAY = slice(13, 15), slice(15, 17), slice(17, 19), slice(19, 21)
# error of the AC coupling's corner (Hz); light of the beams in the beat's receiver, over that of the fringes
CORNER, PEDESTAL = 21, 22
# of the rates of the table: their common relative error, and a constant (deg/s)
SCALE, BIAS = 23, 24


@dataclass(frozen=True)
class BeamsKnowledge:
    """What is known of the beams' channels and of the table's rates; nan: nothing, then the usual bounds hold."""

    level_u: float = math.nan  # relative, of the DC levels
    crosstalk_limit: float = math.nan  # volts in a beam's channel for a volt of the beat, or of the other beam
    ac_corner_hz: float = 0.0  # of the AC coupling that was taken out; 0: there is none
    bandwidth_hz: float = math.nan  # lowest corner of the beams' receivers, one pole each
    scale_u: float = math.nan  # relative, of scale factor and rates, common to all settings
    rate_u: float = math.nan  # relative, of each rate by itself
    dead_band: float = math.nan  # lock-in rate by the dead band, deg/s, and its standard uncertainty
    dead_band_u: float = math.nan


LEVEL_LIMIT = 0.03  # DC accuracy of an oscilloscope of eight bits, and what its ranges differ by
CROSSTALK_LIMIT = 0.01  # -40 dB between two channels
CORNER_LIMIT = 0.2  # relative, of a capacitor in an input
_SATURATION, _SATURATION_U, _MOST_SATURATION = 0.5, 0.25, 0.95
_GAIN, _GAIN_U = math.log(2 * math.pi * 1000.0), 3.0  # a gain corner of 10 Hz to 100 kHz
_PEDESTAL, _PEDESTAL_U = 1.0, 0.6  # a photodiode behind a beam splitter, or two that take the difference
_BIAS = 0.005 / math.sqrt(3.0)  # deg/s: the earth rate
_RECTANGLE = math.sqrt(3.0)


@dataclass(frozen=True)
class BeamsData:
    """Everything that one fit compares, of P points."""

    points: Points
    swing: Complexes  # (P, 2) modulation of the beams, and the reciprocal of its u, 0 where there is none
    swing_weight: Floats
    over: Floats  # (P, 2) amplitude of the beat over the level
    rate_weight: Floats  # (P,) reciprocal of the u of each rate, deg/s; 0 where nobody knows it
    beat_u: Floats  # (P,) Hz
    mean: Floats  # (N_PARAMETERS,) known beforehand, and its standard deviation
    sd: Floats
    ac_corner_hz: float  # of the coupling that was taken out of the beams
    harmonics: bool = True  # whether ratio and third harmonic count


# --------------------
# The model: a periodic solution for every setting, seen by three receivers


_FAILED = 1e6  # in standard uncertainties, where there is no solution
_DETOUR = (0.3, 0.6, 0.8, 0.9, 1.0)  # of the backscatter, on the way to all of it


def _lasers(parameters: Floats, data: BeamsData) -> tuple[Floats, Floats]:
    """Lasers of B sets at P points for :func:`periodic_states`, (B, P, 5), and their readout phases (B, P)."""
    some, column = data.points.points, parameters[:, np.newaxis]
    turned = column[..., BETWEEN] * np.sign(some.rate) / 2 + column[..., TURN] * some.when
    turned = turned + column[..., BEND] * (6 * some.when**2 - 0.5)
    then = (1 + column[..., DRIFT] * some.when) * np.exp(1j * turned)
    first, second = (_backscatter(column[..., part]) * then for part in (FIRST, SECOND))
    half = np.angle(second * np.conj(first)) / 2
    saturation = np.clip(column[..., SATURATION], 0.0, _MOST_SATURATION) + 0 * half
    gain = np.exp(np.minimum(column[..., GAIN], 30.0)) + 0 * half
    numbers = np.stack([np.abs(first), np.abs(second), half, saturation, gain], axis=-1)
    return numbers, -np.angle(first * np.exp(1j * half))


def _backscatter(part: Floats) -> Complexes:
    """A complex number (...), rad/s, from its logarithm (..., 2)."""
    return np.asarray(np.exp(np.clip(part[..., 0], -30.0, 30.0) + 1j * part[..., 1]))


class LaserModel:
    """The model of some data; of several sets of parameters the last is solved, others must be beside it."""

    def __init__(self, data: BeamsData, near: LaserFit | None = None) -> None:
        self.data, some = data, data.points.points
        self.states = np.zeros((some.rate.size, 2, steps_of_a_turn(some.ratio)))
        self.sagnac = np.sign(some.rate) * some.angular  # what was found last is where the next search begins
        self.softer = 1.0  # times as much noise as there is
        if near is not None:
            near.model.predicted(near.parameters[np.newaxis])  # leaves its states there
            self.states, self.sagnac = near.model.states, near.model.sagnac

    def residual(self, parameters: Floats) -> Floats:
        """Everything in its standard uncertainties for parameters (B, N_PARAMETERS): (B, values)."""
        data, some = self.data, self.data.points.points
        ratio, third, swing, sagnac, found = self.predicted(parameters)
        of_ratio, of_third = in_standard_uncertainties(some.ratio - ratio, some.third - third, some)
        of_swing = (data.swing - swing) * data.swing_weight
        rate = sagnac / (2 * np.pi * data.points.records.records.scale_factor)
        known = some.rate * (1 + parameters[:, SCALE, np.newaxis]) + parameters[:, BIAS, np.newaxis]
        of_rate = (known - rate) * data.rate_weight
        fixed = data.sd > 0
        before = (data.mean - parameters)[:, fixed] / data.sd[fixed]
        counts = float(data.harmonics)
        with np.errstate(invalid="ignore"):
            of_ratio, of_third = counts * of_ratio, counts * of_third
        parts = of_ratio, of_third, of_swing.real, of_swing.imag, of_rate
        seen = [part.reshape(len(parameters), -1) / self.softer for part in parts]
        whole = np.concatenate([*seen, before], axis=-1)
        return np.where(found[:, np.newaxis] & np.isfinite(whole), whole, _FAILED)

    def predicted(self, parameters: Floats) -> tuple[Complexes, Floats, Complexes, Floats, Bools]:
        """Ratio, third harmonic (B, P), modulation of the beams (B, P, 2), 2 pi K W (B, P); sets that have any."""
        data, angular, column = self.data, self.data.points.points.angular, parameters[:, np.newaxis]
        (numbers, readout), shape = _lasers(parameters, data), (len(parameters), angular.size)
        light = self._light(numbers.reshape(-1, 5))
        # records turn while they are taken: their mean is that of two
        parts = []
        for beside, weight in zip(data.points.beside, data.points.beside_weights, strict=True):
            turning = column[..., TURN] + 6 * column[..., BEND] * (2 * data.points.points.when + beside)
            seen = self._seen(parameters, readout - turning * beside, light)
            parts.append([each.reshape(*shape, -1) * weight[:, np.newaxis] for each in seen])
        ratio, third, swing = (one + other for one, other in zip(*parts, strict=True))
        swing = swing / (1 + 1j * angular[:, np.newaxis] * column[..., DELAY])
        swing = swing + column[..., CROSSTALK] * data.over + column[..., OTHER_BEAM] * swing[..., ::-1]
        hertz, stated = angular[:, np.newaxis] / (2 * np.pi), data.ac_corner_hz
        corner = (hertz - 1j * stated) / (hertz - 1j * (stated + column[..., CORNER, np.newaxis]))
        swing = np.exp(column[..., LEVEL]) * swing * corner
        found = np.asarray(light.found[light.of_set].reshape(shape).all(axis=1))
        return ratio[..., 0], third[..., 0].real, swing, light.sagnac[light.of_set].reshape(shape), found

    def _seen(self, parameters: Floats, readout: Floats, light: _Light) -> tuple[Complexes, Floats, Complexes]:
        """Ratio and third harmonic (B P,), and swing of the beams (B P, 2) in front of their receivers."""
        lines = self._lines(parameters, readout.reshape(-1, 1), light)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            w, value = nearest_series(lines, lines[:, 1] / lines[:, 0])
            turn = np.abs(value) / value
            left = lines[:, 2] - (1 - np.abs(w) ** 2) * value * np.conj(w) ** 2
            third = (left * turn**3).real / np.abs(value)
        beams = np.einsum("bik,bk->bi", light.beams, light.kernel[:, 0])[light.of_set]
        return np.conj(w) * turn, third, beams * (np.abs(lines[:, 0]) / lines[:, 0])[:, np.newaxis]

    def _light(self, numbers: Floats) -> _Light:
        """Periodic solutions for the lasers (B P, 5) of all sets: each different one once."""
        some, n = self.data.points.points, self.states.shape[-1]
        place = np.tile(np.arange(some.rate.size), len(numbers) // some.rate.size)
        # most parameters leave the laser as it is
        _, which, back = np.unique(
            np.column_stack([numbers, place]), axis=0, return_index=True, return_inverse=True
        )
        lasers, at = numbers[which], place[which]
        last = numbers[-some.rate.size :]
        values, sagnac, found = _by_degrees(last, self.sagnac, self.states, some.angular)
        if found.all():
            self.states, self.sagnac = values, sagnac
        if found.all() and len(lasers) > len(last):
            values, sagnac = states_beside(lasers, last, at, sagnac, values, some.angular)
        else:
            values, sagnac = values[at], sagnac[at]
        psi, kernel, _ = lines_in_time(lasers, sagnac, values, n // 2)
        return _Light(psi, np.exp(values), kernel, sagnac, found[at], back.ravel())

    def _lines(self, parameters: Floats, readout: Floats, light: _Light) -> Complexes:
        """Harmonics (B P, n // 2) of the beat behind its receiver, over its amplitude."""
        some, column, back = self.data.points.points, parameters[:, np.newaxis], light.of_set
        fringes = np.sqrt(light.beams.prod(axis=1))[back] * np.sin(light.psi[back] + readout)
        pedestal = np.repeat(parameters[:, PEDESTAL], some.rate.size)[:, np.newaxis]
        signal = fringes + pedestal * (light.beams.mean(axis=1) - 1)[back]
        # how much light there is the records say, in `amplitude`: the laser gives the shape
        signal /= np.abs(np.einsum("bk,bk->b", signal, light.kernel[back, 0]))[:, np.newaxis]
        x = some.angular * column[..., LAG]
        amplitude = some.amplitude * np.hypot(1.0, x)  # before the pole
        curved = (column[..., DISTORTION] * amplitude).reshape(-1, 1)
        cubic = column[..., THIRD_ORDER] * amplitude**2
        cubic = (cubic / (1 - 3 * cubic)).reshape(-1, 1)
        signal = (signal + 4 * cubic * signal**3) / (1 + 3 * cubic) + 2 * curved * signal**2
        lines = np.einsum("bk,bmk->bm", signal, light.kernel[back])
        return np.asarray(lines / (1 + 1j * x.reshape(-1, 1) * np.arange(1, lines.shape[1] + 1)))


@dataclass(frozen=True)
class _Light:
    """Periodic solutions of L different lasers at n even steps of their phase."""

    psi: Floats  # (L, n)
    beams: Floats  # (L, 2, n) I1 and I2
    kernel: Complexes  # (L, n // 2, n) gives the harmonics in time
    sagnac: Floats  # (L,) 2 pi K W, and whether there is a solution
    found: Bools
    of_set: Indices  # (B P,) which of them each set has at each point


def _by_degrees(lasers: Floats, sagnac: Floats, start: Floats, angular: Floats) -> tuple[Floats, Floats, Bools]:
    """As :func:`periodic_states`; where it finds none, by way of weaker backscatter."""
    values, rates, found = periodic_states(lasers, sagnac, start, angular)
    lost = np.flatnonzero(~found)
    if lost.size:
        free = np.sign(sagnac[lost]) * angular[lost]
        some, then = np.zeros_like(start[lost]), free
        for share in _DETOUR:
            weaker = lasers[lost] * np.array([share, share, 1.0, 1.0, 1.0])
            some, then, there = periodic_states(weaker, then, some, angular[lost])
            some, then = np.where(there[:, np.newaxis, np.newaxis], some, 0.0), np.where(there, then, free)
        values[lost], rates[lost], found[lost] = some, then, there
    return values, rates, found


# --------------------
# The fit


POSSIBLE = 9.0  # chi-square above the best up to which another solution is possible
UNLIKELY = 0.001
_HOPELESS, _GOOD = 100.0, 2.0  # chi-square over the values: no laser is near; much worse places are left alone
_SETTLED = 1e-9  # a step that changes chi-square by less, relatively, was the last one
_TRIES, _EVALUATIONS = 10, 60  # steps of a first look, and of the search to the end
_SMALL = 1e-6  # step of a parameter of which nothing is known
_SOFTER = (1000.0, 100.0, 10.0)  # times the noise, in a first look
_SHOWN = 0.05  # u of a turn over that beforehand, where records show it
_TURNED = np.array([-1.5, -0.5, 0.5, 1.5])  # of the same, turns from which a search begins where they do not
_NO_LEVEL_U, _FREED_U = 3.0, 0.03  # of the logarithm of an unknown level; of the push taken out of beats, relative


@dataclass(frozen=True)
class Route:
    """One way to the lock-in rate, deg/s."""

    name: Literal["harmonics", "beams", "frequencies", "dead band"]
    lock_in_rate: float
    lock_in_rate_u: float
    lock_in_rate_low_95: float
    lock_in_rate_high_95: float


@dataclass(frozen=True)
class BeamsFit:
    """Lock-in rate of many records with their single beams.

    lock_in_rate, lock_in_rate_u, lock_in_rate_low_95, lock_in_rate_high_95 : deg/s, for the scale factor as given
    backscatter_1, backscatter_1_u, backscatter_2, backscatter_2_u : rad/s, a1 and a2
    phase_sum, phase_sum_u : rad, eps, between 0 and 2 pi
    backscatter_phase, backscatter_phase_u : rad, beta less the readout phase
    gain_rate, gain_rate_low_95, gain_rate_high_95 : rad/s, at which the sum of the beams relaxes
    distortion, distortion_u : as in `RatesFit`
    beside : value and u of what else a `RatesFit` has by the same name, and of "lag": s, the pole of the receiver
    rate, beat_frequency, corrected_frequency, corrected_frequency_u : (p,) of every setting and visit: deg/s, Hz,
        and the beat that the gyro would have without backscatter, signed as the rate
    modulation, modulation_u, fitted : (p, 2) AC over DC of both beams against the phase of the beat, as it was
        seen and as the fit has it
    push : (p,) share by which the difference of the beams makes each beat faster than the lock-in equation says
    routes, routes_chi_square, routes_p_value : the lock-in rate by each way, and whether they agree
    chi_square, degrees_of_freedom, p_value : of all data and of what was known beforehand
    flags : bits of `BeamsFlag`
    """

    lock_in_rate: float
    lock_in_rate_u: float
    lock_in_rate_low_95: float
    lock_in_rate_high_95: float
    backscatter_1: float
    backscatter_1_u: float
    backscatter_2: float
    backscatter_2_u: float
    phase_sum: float
    phase_sum_u: float
    backscatter_phase: float
    backscatter_phase_u: float
    gain_rate: float
    gain_rate_low_95: float
    gain_rate_high_95: float
    distortion: float
    distortion_u: float
    beside: dict[str, tuple[float, float]]
    rate: Floats
    beat_frequency: Floats
    corrected_frequency: Floats
    corrected_frequency_u: Floats
    modulation: Complexes
    modulation_u: Floats
    fitted: Complexes
    push: Floats
    routes: tuple[Route, ...]
    routes_chi_square: float
    routes_p_value: float
    chi_square: float
    degrees_of_freedom: int
    p_value: float
    flags: int

    def push_at(self, rate: Floats, frequency: Floats) -> Floats:
        """The same for records (n,): that of the settings of their sense, by their beat in Hz."""
        push = np.zeros(rate.shape)
        for sense in (1, -1):
            mine, there = np.sign(rate) == sense, np.flatnonzero(np.sign(self.rate) == sense)
            there = there[np.argsort(self.beat_frequency[there])]
            if there.size:
                push[mine] = np.interp(frequency[mine], self.beat_frequency[there], self.push[there])
        return push


def fit_beams(
    fit: RatesFit,
    modulation: BeamModulation,
    knowledge: BeamsKnowledge | None = None,
    receiver: BenchKnowledge | None = None,
) -> BeamsFit:
    """Lock-in rate from the beat's harmonics, the beams' modulation and the rates of all records together.

    Parameters
    ----------
    fit : RatesFit
        Of the same records by their beat alone, from `fit_rates` with ``reference="beat"``.
    modulation : BeamModulation
        Of every record of that fit, in its order.
    knowledge : BeamsKnowledge, optional
        What is known of the beams' channels and of the table; without it the usual bounds hold.
    receiver : BenchKnowledge, optional
        Of the beat's receiver, as for `fit_rates`.

    Raises
    ------
    NoFit
        No record with a beam that can be used, or no laser that fits the records.
    """
    gathered = gather(fit.each.records)
    # drifts of the beat's fit may stand for what it does not know
    steady = np.where(np.arange(fit.each.parameters.shape[1]) > SENSES, 0.0, fit.each.parameters)
    scatter, degrees = gathered.scatter(steady, turning=True)
    if degrees > 0 and float(scipy.special.chdtrc(degrees, scatter)) < UNLIKELY:
        gathered = with_noise(gathered, (scatter / degrees - 1) * gathered.covariance)
    data = beams_data(gathered, modulation, knowledge or BeamsKnowledge(), receiver or BenchKnowledge())
    found = _solutions(data)
    best, points = found[0], data.points.points
    weights = [data.swing_weight, points.ratio] * 2 + [data.rate_weight, points.third_weight]
    degrees = sum(int(np.count_nonzero(one)) for one in weights) - int(np.count_nonzero(np.isinf(data.sd)))
    p_value = float(scipy.special.chdtrc(degrees, best.chi_square)) if degrees > 0 else math.nan
    widen = max(best.chi_square / max(degrees, 1), 1.0) if p_value < UNLIKELY else 1.0
    scale = 2 * np.pi * data.points.records.records.scale_factor
    answers = [one.coupling(widen)[0] for one in found]
    # by Laplace, as in the fit of the beat alone
    likely = np.exp([-0.5 * (one.chi_square - best.chi_square) / widen + one.log_volume for one in found])
    likely /= likely.sum()
    value = answers[0][0]
    u = math.sqrt(sum(w * (a[1] ** 2 + (a[0] - value) ** 2) for w, a in zip(likely, answers, strict=True)))
    low, high = min(a[2] for a in answers), max(a[3] for a in answers)
    routes, push = _routes(fit, data, best), best.push()
    if knowledge is not None and (u_of_band := knowledge.dead_band_u) > 0:
        reach, band = NORMAL_95 * u_of_band, knowledge.dead_band
        routes += (Route("dead band", band, u_of_band, max(band - reach, 0.0), band + reach),)
    ways = np.array([(route.lock_in_rate, max(route.lock_in_rate_u, 1e-300) ** -2) for route in routes])
    routes_chi = float(ways[:, 1] @ (ways[:, 0] - np.average(ways[:, 0], weights=ways[:, 1])) ** 2)
    routes_p = float(scipy.special.chdtrc(len(routes) - 1, routes_chi)) if len(routes) > 1 else math.nan
    conditions = {
        BeamsFlag.MISFIT: p_value < UNLIKELY,
        BeamsFlag.ROUTES_DIFFER: routes_p < UNLIKELY,
        BeamsFlag.SEVERAL_SOLUTIONS: len(found) > 1,
        BeamsFlag.NOT_SIGNIFICANT: not value > 3.3 * u,
    }
    flags = modulation.flags | int(sum(bit for bit, raised in conditions.items() if raised))
    values, covariance = best.parameters, best.covariance * widen
    us, phase = np.sqrt(np.diagonal(covariance)), best.coupling(widen)[1]
    first, second = math.exp(values[0]), math.exp(values[2])
    gain, gain_u = float(values[GAIN]), float(us[GAIN])
    corrected, corrected_u = best.corrected(widen)
    return BeamsFit(
        lock_in_rate=value / scale,
        lock_in_rate_u=u / scale,
        lock_in_rate_low_95=low / scale,
        lock_in_rate_high_95=high / scale,
        backscatter_1=first,
        backscatter_1_u=first * float(us[0]),
        backscatter_2=second,
        backscatter_2_u=second * float(us[2]),
        phase_sum=float(values[3] - values[1]) % (2 * math.pi),
        phase_sum_u=math.sqrt(max(float(covariance[3, 3] + covariance[1, 1] - 2 * covariance[1, 3]), 0.0)),
        backscatter_phase=phase[0],
        backscatter_phase_u=phase[1],
        gain_rate=math.exp(gain),
        gain_rate_low_95=math.exp(gain - NORMAL_95 * gain_u),
        gain_rate_high_95=math.exp(min(gain + NORMAL_95 * gain_u, 700.0)),
        distortion=float(values[DISTORTION]),
        distortion_u=float(us[DISTORTION]),
        beside={name: (float(values[place]), float(us[place])) for name, place in _BESIDE.items()},
        rate=points.rate,
        beat_frequency=points.angular / (2 * np.pi),
        corrected_frequency=corrected,
        corrected_frequency_u=corrected_u,
        modulation=np.where(data.swing_weight > 0, data.swing, np.nan),
        modulation_u=1 / np.maximum(data.swing_weight, 1e-300),
        fitted=best.model.predicted(best.parameters[np.newaxis])[2][0],
        push=push,
        routes=routes,
        routes_chi_square=routes_chi,
        routes_p_value=routes_p,
        chi_square=best.chi_square,
        degrees_of_freedom=degrees,
        p_value=p_value,
        flags=flags,
    )


_BESIDE = {"third_order": THIRD_ORDER, "lag": LAG, "phase_drift": TURN, "lock_in_drift": DRIFT}
_BESIDE |= {"phase_between_senses": BETWEEN}


def beams_data(points: Points, swings: BeamModulation, known: BeamsKnowledge, bench: BenchKnowledge) -> BeamsData:
    """The points with the beams of their records, and what is known of everything beforehand."""
    records = points.records
    swing, weight, over = _swings(points, swings)
    if not weight.any():
        raise NoFit("no record with a single beam that could be used")
    some, rate_weight = points.points, np.zeros(len(weight))
    if not records.records.rate_of_beat:
        own = TABLE_RATE_LIMIT / _RECTANGLE if math.isnan(known.rate_u) else known.rate_u
        by_azimuth = np.zeros(len(weight))
        for rows, data, _ in records.data():
            np.maximum.at(by_azimuth, points.places[data], records.rate_u[rows])
        rate_weight = 1 / np.hypot(by_azimuth, own * np.abs(some.rate))
    mean, sd = _beforehand(some, over, known, bench)
    if swings.flags & BeamsFlag.NO_LEVEL:
        sd[LEVEL] = _NO_LEVEL_U
    for part in (LEVEL, CROSSTALK, OTHER_BEAM, DELAY):
        sd[part] *= weight.any(axis=0)
    sd[[SCALE, BIAS]] *= rate_weight.any()
    beats = np.zeros((2, len(weight)))
    for _, block in records.blocks():
        beats += points.places.sums(block, np.ones(block.rate.shape), block.beat_frequency_u**2)
    beat_u = np.sqrt(beats[1]) / beats[0]
    return BeamsData(points, swing, weight, over, rate_weight, beat_u, mean, sd, known.ac_corner_hz)


def _swings(points: Points, modulation: BeamModulation) -> tuple[Complexes, Floats, Floats]:
    """Mean modulation of the records of each point, the reciprocal of its u, and beat over level, (P, 2)."""
    records, places = points.records, points.places

    def line_of(numbers: Complexes | Floats, beam: int) -> tuple[Complexes, Complexes, Floats]:
        weights = np.nan_to_num(modulation.modulation_u[:, beam] ** -2.0)
        values = np.nan_to_num(numbers[:, beam].astype(np.complex128))
        return points.lines((data, weights[rows], values[rows]) for rows, data, _ in records.data())

    lines = [line_of(modulation.modulation, beam) for beam in range(2)]
    mean, slope, total = (np.stack(each) for each in zip(*lines, strict=True))
    over = np.stack([line_of(modulation.beat_over_level, beam)[0].real for beam in range(2)], axis=1)
    # records of one setting that scatter by more than their noise, about a line in time: phases may turn
    spread, freedom = 0.0, -2 * int(np.count_nonzero(total) + np.count_nonzero(slope))
    for rows, data, _ in records.data():
        some, place = modulation.take(rows), places[data]
        line = mean[:, place] + slope[:, place] * (data.when - points.points.when[place])
        left = np.abs(some.modulation - line.T) / some.modulation_u
        spread, freedom = spread + float(np.nansum(left**2)), freedom + 2 * int(np.isfinite(left).sum())
    unlikely = freedom > 0 and float(scipy.special.chdtrc(freedom, spread)) < UNLIKELY
    weight = np.sqrt(total) / (math.sqrt(spread / freedom) if unlikely else 1.0)
    return np.asarray(mean.T), weight.T, over


def _beforehand(
    some: RatioData, over: Floats, known: BeamsKnowledge, bench: BenchKnowledge
) -> tuple[Floats, Floats]:
    """Mean and standard deviation of every parameter before there are data, (N_PARAMETERS,) each."""
    slowest, corner = float(some.angular.min()) / (2 * np.pi), bench.gain
    before = prior_of(bench, slowest).seen_by(some)
    mean, sd = np.zeros(N_PARAMETERS), np.full(N_PARAMETERS, np.inf)
    mine = [DISTORTION, LAG, THIRD_ORDER, BETWEEN, TURN, BEND, DRIFT]
    mean[mine], sd[mine] = before.mean[[2, *range(4, 10)]], before.sd[[2, *range(4, 10)]]
    longest = math.sqrt(sd[LAG] * _RECTANGLE)  # that is of the square of a time
    mean[LAG], sd[LAG] = longest / 2, longest / 2 / _RECTANGLE
    if bench.bandwidth.corrected:
        mean[LAG], sd[LAG] = 0.0, longest / _RECTANGLE  # of what is left
    mean[GAIN], sd[GAIN] = _GAIN, _GAIN_U
    if corner.u_hz > 0:
        mean[GAIN], sd[GAIN] = math.log(2 * math.pi * corner.hz), corner.u_hz / corner.hz
    mean[SATURATION], sd[SATURATION] = _SATURATION, _SATURATION_U
    mean[PEDESTAL], sd[PEDESTAL] = _PEDESTAL, _PEDESTAL_U
    sd[LEVEL] = LEVEL_LIMIT / _RECTANGLE if math.isnan(known.level_u) else known.level_u
    crosstalk = CROSSTALK_LIMIT if math.isnan(known.crosstalk_limit) else known.crosstalk_limit
    sd[CROSSTALK] = sd[OTHER_BEAM] = crosstalk / _RECTANGLE
    largest = over.max(axis=0)
    if largest.all():
        sd[OTHER_BEAM] *= largest / largest[::-1]  # it is a share of volts, and the levels differ
    bandwidth = lowest_bandwidth(slowest) if math.isnan(known.bandwidth_hz) else known.bandwidth_hz
    mean[DELAY], sd[DELAY] = np.array([1.0, 1 / _RECTANGLE]) / (4 * np.pi * bandwidth)
    sd[CORNER] = CORNER_LIMIT * known.ac_corner_hz / _RECTANGLE
    by_limits = math.hypot(SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT) / _RECTANGLE
    sd[SCALE], sd[BIAS] = by_limits if math.isnan(known.scale_u) else known.scale_u, _BIAS
    return mean, sd


@dataclass(frozen=True)
class LaserFit:
    """One minimum of chi-square."""

    model: LaserModel
    parameters: Floats
    covariance: Floats  # (N_PARAMETERS, N_PARAMETERS), 0 where held
    chi_square: float
    log_volume: float
    values: int  # residuals that there are

    @classmethod
    def at(cls, model: LaserModel, parameters: Floats) -> LaserFit:
        """What the slopes of the model say about some parameters."""
        free = np.flatnonzero(model.data.sd > 0)
        residual = model.residual(parameters[np.newaxis])[0]
        slopes = _jacobian(model, parameters, free)
        size = np.maximum(np.linalg.norm(slopes, axis=0), 1e-100)
        eigenvalues, vectors = np.linalg.eigh((slopes / size).T @ (slopes / size))
        eigenvalues = np.maximum(eigenvalues, 1e-14)
        covariance = np.zeros((N_PARAMETERS, N_PARAMETERS))
        covariance[np.ix_(free, free)] = (vectors / eigenvalues) @ vectors.T / np.outer(size, size)
        volume = -0.5 * float(np.sum(np.log(eigenvalues))) - float(np.sum(np.log(size)))
        return cls(model, parameters, covariance, float(residual @ residual), volume, residual.size)

    def apart(self, other: LaserFit) -> Floats:
        """Differences of both backscatters from another's: of logarithms, and rad."""
        difference = self.parameters[:4] - other.parameters[:4]
        difference[1::2] = np.angle(np.exp(1j * difference[1::2]))
        return difference

    def coupling(self, widen: float) -> tuple[tuple[float, ...], tuple[float, float]]:
        """|C| freed of the bias of its size, its u and 95 % interval (rad/s), and the phase of C with its u."""
        first, second = (complex(_backscatter(self.parameters[part])) for part in (FIRST, SECOND))
        both, whole = np.hstack([[[c.real, -c.imag], [c.imag, c.real]] for c in (first, second)]), first + second
        spread = both @ self.covariance[:4, :4] @ both.T * widen
        size = max(abs(whole), 1e-300)
        along, across = np.array([whole.real, whole.imag]) / size, np.array([-whole.imag, whole.real]) / size
        u, across_u = (math.sqrt(max(float(way @ spread @ way), 1e-300)) for way in (along, across))
        low, high = size_interval(size / u)
        # a phase that turns makes the angle uncertain, and the size none the larger
        turns = BETWEEN + np.flatnonzero(np.diagonal(self.covariance)[BETWEEN:DRIFT] > 0)
        shared = self.covariance[turns, :4] @ (across @ both)
        by_turns = widen * float(shared @ np.linalg.solve(self.covariance[np.ix_(turns, turns)], shared))
        freed = math.sqrt(max(size**2 - max(across_u**2 - by_turns, 0.0), 0.0))
        return (freed, u, float(low) * u, float(high) * u), (float(np.angle(whole)), across_u / size)

    def push(self) -> Floats:
        """Share by which each beat is faster than the lock-in equation says, (P,)."""
        sagnac = self.model.predicted(self.parameters[np.newaxis])[3][0]
        coupling = abs(complex(_backscatter(self.parameters[FIRST]) + _backscatter(self.parameters[SECOND])))
        by_lock_in = np.sqrt(np.maximum(sagnac**2 - coupling**2, 1e-300))
        return np.asarray(self.model.data.points.points.angular / by_lock_in - 1)

    def corrected(self, widen: float) -> tuple[Floats, Floats]:
        """Beat that each point would have without backscatter, Hz, signed, and its u."""
        steps = _steps(self.model.data)
        *moved, sagnac = self.model.predicted(
            np.concatenate([self.parameters + steps, self.parameters[np.newaxis]])
        )[3]
        slopes = (np.array(moved) - sagnac) / np.diagonal(steps)[:, np.newaxis]
        variance = np.einsum("ip,ij,jp->p", slopes, self.covariance, slopes) * widen
        u = np.sqrt(np.maximum(variance, 0.0)) / (2 * np.pi)
        return sagnac / (2 * np.pi), np.hypot(u, self.model.data.beat_u)  # what shifts the beat shifts it as much


def _steps(data: BeamsData) -> Floats:
    """A step of each parameter, (N_PARAMETERS, N_PARAMETERS), by which derivatives are taken."""
    return np.diag(np.where(np.isfinite(data.sd) & (data.sd > 0), 1e-4 * data.sd, _SMALL))


def _solutions(data: BeamsData, near: LaserFit | None = None) -> list[LaserFit]:
    """The minima that are possible, the best first; or that next to the one of more data."""
    model = LaserModel(data, near)
    looked = [(near.parameters, 0.0)] if near is not None else _looked(model)
    found: list[LaserFit] = []
    for start, cost in looked:
        if found and cost > looked[0][1] + 1e3 and found[0].chi_square < _GOOD * found[0].values:
            break
        end = _search(model, start, _EVALUATIONS)
        if end is None:
            continue
        found = _with(found, LaserFit.at(model, end[0]))
    if not found:
        raise NoFit("no two-mode laser fits the records of beat and beams")
    best = min(found, key=lambda one: one.chi_square)
    if near is None and best.covariance[TURN, TURN] > (_SHOWN * data.sd[TURN]) ** 2:
        # phases that turn stand for a coupling at another angle, and a ridge may be between the two
        held = LaserModel(replace(data, sd=np.where(np.arange(N_PARAMETERS) == TURN, 0.0, data.sd)), best)
        for turn in _TURNED * data.sd[TURN]:
            start = np.where(np.arange(N_PARAMETERS) == TURN, turn, best.parameters)
            end = _search(held, start, _EVALUATIONS)
            end = end and _search(model, end[0], _EVALUATIONS)
            found = found if end is None else _with(found, LaserFit.at(model, end[0]))
    found.sort(key=lambda one: one.chi_square)
    if found[0].chi_square > _HOPELESS * found[0].values:
        raise NoFit(
            "no two-mode laser is near what beat and beams show: is their backscatter too strong for its gain?"
        )
    return [one for one in found if one.chi_square < found[0].chi_square + POSSIBLE]


def _with(found: list[LaserFit], one: LaserFit) -> list[LaserFit]:
    """The minima and one more, if it is another."""
    u = 1e-3 + 0.5 * np.sqrt(np.diagonal(one.covariance)[:4])
    return found if any(np.all(np.abs(one.apart(other)) < u) for other in found) else [*found, one]


def _looked(model: LaserModel) -> list[tuple[Floats, float]]:
    """Where some steps from each start lead, and chi-square there, the best first."""
    # with noise that becomes less what is known beforehand leads past narrow valleys
    ended = list[tuple[Floats, float]]()
    for start in _starts(model.data):
        end: tuple[Floats, float] | None = start, 0.0
        for model.softer in _SOFTER:
            end = end and _search(model, end[0], _TRIES)
        model.softer = 1.0
        if end is not None:
            residual = model.residual(end[0][np.newaxis])[0]
            ended.append((end[0], float(residual @ residual)))
    return sorted(ended, key=lambda one: one[1])


def _search(model: LaserModel, start: Floats, evaluations: int) -> tuple[Floats, float] | None:
    """Least squares from a start: parameters and chi-square; ``None`` where no laser is near it."""
    from scipy.optimize import least_squares  # takes as long to import as all else

    free = np.flatnonzero(model.data.sd > 0)

    def whole(values: Floats) -> Floats:
        parameters = start.copy()
        parameters[free] = values
        return parameters

    def residual(values: Floats) -> Floats:
        return np.asarray(model.residual(whole(values)[np.newaxis])[0])

    def slope(values: Floats) -> Floats:
        return _jacobian(model, whole(values), free)

    if residual(start[free])[0] == _FAILED:
        return None
    made = least_squares(
        residual, start[free], jac=slope, x_scale="jac", max_nfev=evaluations, ftol=_SETTLED, xtol=None, gtol=None
    )
    return whole(made.x), 2 * float(made.cost)


def _jacobian(model: LaserModel, parameters: Floats, free: Indices) -> Floats:
    """Derivatives of the residuals, (values, free)."""
    steps = _steps(model.data)[free]
    both = model.residual(np.concatenate([parameters + steps, parameters[np.newaxis]]))
    return np.asarray(((both[:-1] - both[-1]) / steps[np.arange(free.size), free][:, np.newaxis]).T)


def _starts(data: BeamsData) -> list[Floats]:
    """Starts by equation (1) and that of the harmonics, linear in C and D, at gains that suit them."""
    gains = np.exp(np.mean(np.log(data.points.points.angular))) / np.geomspace(0.01, 20.0, 24)
    unknown = float(np.max(data.sd[LEVEL])) > 1.0
    levels = np.linspace(-4.0, 4.0, 17) if unknown else np.zeros(1)
    every = [[_linear(data, float(gain), float(level)) for level in levels] for gain in gains]
    tried = [min(some, key=lambda one: one[1]) for some in every]
    costs = np.array([cost for _, cost in tried])
    edged = np.pad(costs, 1, constant_values=np.inf)
    lowest = np.flatnonzero((costs <= edged[:-2]) & (costs <= edged[2:]))
    lowest = lowest[np.argsort(costs[lowest])][:3]
    beside = [place + step for step in (0, -2, 2, -4, 4) for place in lowest if 0 <= place + step < costs.size]
    return [tried[place][0] for place in dict.fromkeys(beside)]


def _linear(data: BeamsData, gain: float, level: float) -> tuple[Floats, float]:
    """Best parameters of the linear equations at a gain and a level, and what they leave."""
    some = data.points.points
    w, positive, gd = some.angular, some.rate > 0, gain * (1 - _SATURATION) / (1 + _SATURATION)
    columns = []
    for coupling, other in ((1, 0), (1j, 0), (0, 1), (0, 1j)):
        by_sum = np.where(positive, 1j * coupling, np.conj(1j * coupling)) / (gain + 1j * w)
        by_difference = np.where(positive, 1j * other, np.conj(1j * other)) / (gd + 1j * w)
        harmonic = np.where(positive, -coupling, np.conj(coupling)) / (2 * w) * gain / (gain + 1j * w)
        columns.append(np.stack([by_sum + by_difference, by_sum - by_difference, harmonic]))
    beside = np.stack([*data.over.T, some.amplitude]).astype(np.complex128)
    columns += [np.where(np.arange(3)[:, np.newaxis] == place, beside, 0.0) for place in range(3)]
    target = np.stack([*(data.swing.T * math.exp(-level)), some.ratio])
    # they hold to first order in the ratio only
    rough = 0.01 + 3 * np.abs(some.ratio) ** 2 + 0.3 * np.abs(some.ratio)
    noise = np.sqrt(np.trace(data.points.covariance, axis1=-2, axis2=-1) / 2)
    us = np.hypot(
        np.stack([*(math.exp(-level) / np.maximum(data.swing_weight.T, 1e-9)), noise]), rough * np.abs(target)
    )
    rows = np.array([(one / us).ravel() for one in columns]).T
    bounds = np.clip([*data.sd[CROSSTALK], data.sd[DISTORTION]], 1e-9, 0.01)
    known = np.diag([*np.zeros(4), *(1 / bounds)])
    system, aim = np.concatenate([rows.real, rows.imag, known]), (target / us).ravel()
    aims = np.concatenate([aim.real, aim.imag, np.zeros(7)])
    values = np.linalg.lstsq(system, aims, rcond=None)[0]
    start = np.where(np.isfinite(data.sd), data.mean, 0.0)
    coupling, other = complex(*values[:2]), complex(*values[2:4])
    for part, one in ((FIRST, (coupling - other) / 2), (SECOND, (coupling + other) / 2)):
        start[part] = math.log(max(abs(one), 1e-3 * abs(coupling))), np.angle(one)
    start[GAIN], start[CROSSTALK], start[DISTORTION] = math.log(gain), values[4:6], values[6]
    start[LEVEL] = level * (data.sd[LEVEL] > 0)
    return start, float(np.sum((system @ values - aims) ** 2))


def _routes(fit: RatesFit, data: BeamsData, best: LaserFit) -> tuple[Route, ...]:
    """The lock-in rate by harmonics alone, by the beams alone and by the frequencies alone."""
    scale = 2 * np.pi * data.points.records.records.scale_factor
    own = fit.lock_in_rate, fit.lock_in_rate_u, fit.lock_in_rate_low_95, fit.lock_in_rate_high_95
    routes = [Route("harmonics", *own)]
    by_beams = replace(data, harmonics=False, rate_weight=np.zeros_like(data.rate_weight))
    with suppress(NoFit):
        one = _solutions(by_beams, best)[0]
        routes.append(Route("beams", *(each / scale for each in one.coupling(1.0)[0])))
    if not data.rate_weight.any():
        return tuple(routes)
    # freed of what the difference of the beams does, by the laser of all
    some, push = data.points.points, best.push()
    frequency, rate_u = some.angular / (2 * np.pi), 1 / data.rate_weight
    freed, freed_u = frequency / (1 + push), np.hypot(data.beat_u, _FREED_U * np.abs(push) * frequency)
    # one sense tells no constant of the rates from the lock-in rate
    both, most = np.unique(np.sign(some.rate)).size == 2, _RECTANGLE * _BIAS
    with suppress(NoFit):
        tried = [
            fit_frequencies(some.rate + constant, freed, freed_u, input_rate_u=rate_u, bias=both)
            for constant in ([0.0] if both else [0.0, -most, most])
        ]
        value = tried[0].lock_in_rate
        u = math.hypot(tried[0].lock_in_rate_u, *((one.lock_in_rate - value) / math.sqrt(6) for one in tried))
        low, high = min(one.lock_in_rate_low_95 for one in tried), max(one.lock_in_rate_high_95 for one in tried)
        if math.isfinite(u):
            routes.append(Route("frequencies", value, u, low, high))
    return tuple(routes)
