"""Lock-in rate from beat and single beams together: what their modulation settles that the beat leaves open.

Backscatter modulates the two beams at the beat frequency ("winking"). Let C = a1 e^(-i eps/2) + a2 e^(i eps/2) and
D = a2 e^(i eps/2) - a1 e^(-i eps/2), both turned by the readout phase, and g and g_d the rates at which sum and
difference of the beams relax. Far above lock-in AC over DC of equal beams 1 and 2, against the beat's phase, is

    m = i C/(g + i w) +- i D/(g_d + i w),     the conjugate of both numerators in the other sense      (1)

while the beat's second harmonic over its fundamental is -C/(2 w) g/(g + i w), and WL = |C|/(2 pi K). So the beams
show the phase of C, which distortion of the receiver hides, D, which no harmonic shows, and g.

The fit (`analysis.several_rates.laser_fit`) is not of first order.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Complexes, Floats, NoFit
from analysis.beam_swings import BeamModulation, BeamsFlag
from analysis.budget import BenchKnowledge, lowest_bandwidth
from analysis.frequency_method import fit_frequencies
from analysis.several_rates import RatesFit
from analysis.several_rates.laser_fit import (
    BETWEEN,
    BIAS,
    CORNER,
    CROSSTALK,
    DELAY,
    DISPERSION,
    DISTORTION,
    DRIFT,
    FIRST,
    GAIN,
    IMBALANCE,
    LAG,
    LEVEL,
    MOST_BIAS,
    N_PARAMETERS,
    OTHER_BEAM,
    PEDESTAL,
    POSSIBLE,
    SATURATION,
    SATURATION_USUAL,
    SCALE,
    SECOND,
    THIRD_ORDER,
    TURN,
    LaserData,
    LaserFit,
    LaserModel,
    Look,
    beforehand,
    laplace,
    lasers_by_rates,
    rates_weight,
    search,
    solutions,
    whitened,
    with_usual_gain,
)
from analysis.several_rates.points import Points, gather, with_noise
from analysis.several_rates.ratio_model import SENSES, RatioData

# --------------------
# What is fitted, and what is known of it beforehand


@dataclass(frozen=True)
class BeamsKnowledge:
    """What is known of the beams' channels and of the table's rates; nan: nothing, then the usual bounds hold."""

    level_u: float = math.nan  # relative, of the DC levels
    crosstalk_limit: float = math.nan  # volts in a beam's channel for a volt of the beat, or of the other beam
    ac_corner_hz: float = 0.0  # of the AC coupling that was taken out; 0: there is none
    imbalance_limit: float = math.nan  # half the difference of both beams in the laser over their mean, at most
    bandwidth_hz: float = math.nan  # lowest corner of the beams' receivers, one pole each
    scale_u: float = math.nan  # relative, of scale factor and rates, common to all settings
    rate_u: float = math.nan  # relative, of each rate by itself: at least, for the records show more
    dead_band: float = math.nan  # lock-in rate by the dead band, deg/s, and its standard uncertainty
    dead_band_u: float = math.nan


LEVEL_LIMIT = 0.03  # DC accuracy of an oscilloscope of eight bits, and what its ranges differ by
CROSSTALK_LIMIT = 0.01  # -40 dB between two channels
CORNER_LIMIT = 0.2  # relative, of a capacitor in an input
_PEDESTAL, _PEDESTAL_U = 1.0, 0.6  # a photodiode behind a beam splitter, or two that take the difference
_RECTANGLE = math.sqrt(3.0)


# --------------------
# The fit


UNLIKELY = 0.001
_TRIES = 10  # steps of a first look
_SATURATIONS = (0.1, 0.5, 0.9)
_HALVED = np.isin(np.arange(N_PARAMETERS), (FIRST.start, SECOND.start)) * math.log(0.5)  # may have a steady beat
_SOFTER = (1000.0, 100.0, 10.0)  # times the noise, in a first look
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
    gathered = gather(fit.records)
    # drifts of the beat's fit may stand for what it does not know
    steady = np.where(np.arange(fit.parameters.shape[1]) > SENSES, 0.0, fit.parameters)
    scatter, degrees = gathered.scatter(steady, turning=True)
    if degrees > 0 and float(scipy.special.chdtrc(degrees, scatter)) < UNLIKELY:
        gathered = with_noise(gathered, (scatter / degrees - 1) * gathered.covariance)
    known = knowledge or BeamsKnowledge()
    data = beams_data(gathered, modulation, known, receiver or BenchKnowledge())
    found = lasers_by_rates(data, _solutions, known.rate_u)
    best, points = found[0], data.points.points
    degrees = data.degrees
    p_value = float(scipy.special.chdtrc(degrees, best.chi_square)) if degrees > 0 else math.nan
    widen = max(best.chi_square / max(degrees, 1), 1.0) if p_value < UNLIKELY else 1.0
    scale = 2 * np.pi * data.points.records.records.scale_factor
    (value, u, low, high), *_ = laplace(found, widen)
    routes, push = _routes(fit, data, best), best.push()
    if (u_of_band := known.dead_band_u) > 0:
        reach, band = NORMAL_95 * u_of_band, known.dead_band
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
    first, second = np.exp(values[[0, 2]]).tolist()
    of_sum = np.array([-1.0, 1.0, -2.0]) @ np.eye(N_PARAMETERS)[[1, 3, DISPERSION]]
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
        phase_sum=float(values[3] - values[1] - 2 * math.atan(values[DISPERSION])) % (2 * math.pi),
        phase_sum_u=math.sqrt(max(float(of_sum @ covariance @ of_sum), 0.0)),
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
        modulation_u=np.hypot(1 / np.maximum(data.swing_weight, 1e-300), (np.abs(data.swing).T * data.phase_u).T),
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


def beams_data(points: Points, swings: BeamModulation, known: BeamsKnowledge, bench: BenchKnowledge) -> LaserData:
    """The points with the beams of their records, and what is known of everything beforehand."""
    swing, weight, phase_u, over = _swings(points, swings)
    if not weight.any():
        raise NoFit("no record with a single beam that could be used")
    rate_weight, beat_u = rates_weight(points, known.rate_u)
    mean, sd = _beforehand(points.points, over, known, bench)
    if swings.flags & BeamsFlag.NO_LEVEL:
        sd[LEVEL] = _NO_LEVEL_U
    for part in (LEVEL, CROSSTALK, OTHER_BEAM, DELAY):
        sd[part] *= weight.any(axis=0)
    sd[[SCALE, BIAS]] *= rate_weight.any()
    return LaserData(points, swing, weight, phase_u, over, rate_weight, beat_u, mean, sd, known.ac_corner_hz)


def _swings(points: Points, modulation: BeamModulation) -> tuple[Complexes, Floats, Floats, Floats]:
    """Mean modulation of the records of each point, 1 over its u, u of the beat's phase, beat over level."""

    def curve_of(numbers: Complexes | Floats, us: Floats) -> tuple[Complexes, Floats, int]:
        weights, values = np.nan_to_num(us**-2.0), np.nan_to_num(numbers.astype(np.complex128))
        return points.curves((data, weights[rows], values[rows]) for rows, data, _ in points.records.data())

    def of_beams(numbers: Complexes | Floats) -> list[tuple[Complexes, Floats, int]]:
        return [curve_of(numbers[:, beam], modulation.modulation_u[:, beam]) for beam in range(2)]

    curves = of_beams(modulation.modulation)
    total = np.stack([weights for _, weights, _ in curves])
    # records of one setting that scatter by more than their noise, about a curve in time: phases may turn
    spread, freedom = 0.0, -2 * sum(fitted for *_, fitted in curves)
    for rows, data, _ in points.records.data():
        some = modulation.take(rows)
        seen = np.stack([points.on_curves(curve, data) for curve, *_ in curves], axis=-1)
        there = np.isfinite(some.modulation)
        left, own = np.where(there, some.modulation - seen, 0.0), np.where(there, some.modulation_u**-1.0, 0.0)
        left = whitened(left, seen, own, np.nan_to_num(some.phase_u))
        spread, freedom = spread + float(np.sum(np.abs(left) ** 2)), freedom + 2 * int(there.sum())
    unlikely = freedom > 0 and float(scipy.special.chdtrc(freedom, spread)) < UNLIKELY
    larger = math.sqrt(spread / freedom) if unlikely else 1.0
    # a mean over the times of all records: that of a square is 1
    over, mean = (
        np.stack([curve[:, 0] + curve[:, 2] for curve, *_ in some], axis=-1)
        for some in (of_beams(modulation.beat_over_level), curves)
    )
    phase_u = larger / np.sqrt(np.maximum(curve_of(modulation.phase_u, modulation.phase_u)[1], 1e-300))
    return mean, np.sqrt(total.T) / larger, phase_u, np.asarray(over.real)


def _beforehand(
    some: RatioData, over: Floats, known: BeamsKnowledge, bench: BenchKnowledge
) -> tuple[Floats, Floats]:
    """Mean and standard deviation of every parameter before there are data, (N_PARAMETERS,) each."""
    mean, sd = beforehand(some, bench)
    mean[PEDESTAL], sd[PEDESTAL] = _PEDESTAL, _PEDESTAL_U
    sd[LEVEL] = LEVEL_LIMIT / _RECTANGLE if math.isnan(known.level_u) else known.level_u
    crosstalk = CROSSTALK_LIMIT if math.isnan(known.crosstalk_limit) else known.crosstalk_limit
    sd[CROSSTALK] = sd[OTHER_BEAM] = crosstalk / _RECTANGLE
    largest = over.max(axis=0)
    if largest.all():
        sd[OTHER_BEAM] *= largest / largest[::-1]  # it is a share of volts, and the levels differ
    slowest = float(some.angular.min()) / (2 * np.pi)
    bandwidth = lowest_bandwidth(slowest) if math.isnan(known.bandwidth_hz) else known.bandwidth_hz
    mean[DELAY], sd[DELAY] = np.array([1.0, 1 / _RECTANGLE]) / (4 * np.pi * bandwidth)
    sd[IMBALANCE] = sd[IMBALANCE] if math.isnan(known.imbalance_limit) else known.imbalance_limit / _RECTANGLE
    sd[CORNER] = CORNER_LIMIT * known.ac_corner_hz / _RECTANGLE
    sd[SCALE] = sd[SCALE] if math.isnan(known.scale_u) else known.scale_u
    return mean, sd


def _solutions(data: LaserData) -> list[LaserFit]:
    """The minima that some data allow, the best first, begun where some steps from each start lead."""
    starts = usual = _starts(data, SATURATION_USUAL)
    found, none = list[LaserFit](), NoFit()
    # with noise that becomes less what is known leads past narrow valleys; else other saturations, or more noise
    for noise in (_SOFTER, _SOFTER[-1:], (1e4, *_SOFTER)):
        looked = list[Look]()
        for start in starts:
            model = LaserModel(with_usual_gain(data))
            model.softer, *less = noise
            end = search(model, start, _TRIES) or search(model, start + _HALVED, _TRIES)
            for model.softer in less:
                end = end and search(model, end[0], _TRIES)
            model.softer = 1.0
            if end is not None:
                looked.append((model, end[0], float(np.sum(model.residual(end[0][np.newaxis]) ** 2))))
        try:
            found += solutions(data, looked)
        except NoFit as error:
            none = error
        found.sort(key=lambda one: one.chi_square)
        chance = float(scipy.special.chdtrc(max(data.degrees, 1), found[0].chi_square)) if found else 0.0
        if found and (noise is not _SOFTER or not chance < UNLIKELY):
            break
        place = np.arange(N_PARAMETERS) == SATURATION
        others = [np.where(place, other, one.parameters) for one in found[:1] for other in _SATURATIONS]
        starts = usual + (others or _starts(data, _SATURATIONS[-1])) if noise is _SOFTER else usual
    if not found:
        raise none
    return [one for one in found if one.chi_square < found[0].chi_square + POSSIBLE]


def _starts(data: LaserData, saturation: float) -> list[Floats]:
    """Starts by equation (1) and that of the harmonics, linear in C and D, at gains that suit them."""
    gains = np.exp(np.mean(np.log(data.points.points.angular))) / np.geomspace(0.01, 20.0, 24)
    unknown = float(np.max(data.sd[LEVEL])) > 1.0
    levels = np.linspace(-4.0, 4.0, 17) if unknown else np.zeros(1)
    every = [[_linear(data, float(gain), float(level), saturation) for level in levels] for gain in gains]
    tried = [min(some, key=lambda one: one[1]) for some in every]
    costs = np.array([cost for _, cost in tried])
    edged = np.pad(costs, 1, constant_values=np.inf)
    lowest = np.flatnonzero((costs <= edged[:-2]) & (costs <= edged[2:]))
    lowest = lowest[np.argsort(costs[lowest])][:3]
    beside = [place + step for step in (0, -2, 2, -4, 4) for place in lowest if 0 <= place + step < costs.size]
    return [tried[place][0] for place in dict.fromkeys(beside)]


def _linear(data: LaserData, gain: float, level: float, saturation: float) -> tuple[Floats, float]:
    """Best parameters of the linear equations at a gain and a level, and what they leave."""
    some = data.points.points
    w, positive, gd = some.angular, some.rate > 0, gain * (1 - saturation) / (1 + saturation)
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
    start[SATURATION] = saturation
    start[LEVEL] = level * (data.sd[LEVEL] > 0)
    return start, float(np.sum((system @ values - aims) ** 2))


def _routes(fit: RatesFit, data: LaserData, best: LaserFit) -> tuple[Route, ...]:
    """The lock-in rate by harmonics alone, by the beams alone and by the frequencies alone."""
    scale = 2 * np.pi * data.points.records.records.scale_factor
    own = fit.lock_in_rate, fit.lock_in_rate_u, fit.lock_in_rate_low_95, fit.lock_in_rate_high_95
    routes = [Route("harmonics", *own)]
    by_beams = replace(data, harmonics=False, rate_weight=np.zeros_like(data.rate_weight))
    with suppress(NoFit):
        one = solutions(by_beams, [(best.model, best.parameters, 0.0)])[0]
        routes.append(Route("beams", *(each / scale for each in one.coupling(1.0)[0])))
    if not data.rate_weight.any():
        return tuple(routes)
    # freed of what the difference of the beams does, by the laser of all
    some, push = data.points.points, best.push()
    frequency, given = some.angular / (2 * np.pi), data.points.records.records.scale_factor
    freed, per_rate = frequency / (1 + push), given * np.abs(some.rate) / some.beat_rate
    freed_u = np.hypot(per_rate / data.rate_weight, _FREED_U * np.abs(push) * frequency)
    # one sense tells no constant of the rates from the lock-in rate
    both, most = np.unique(np.sign(some.rate)).size == 2, MOST_BIAS
    with suppress(NoFit):
        tried = [
            fit_frequencies(some.rate + constant, freed, freed_u, bias=both)
            for constant in ([0.0] if both else [0.0, -most, most])
        ]
        # for the scale factor as given: what rates have in common goes into the one that they show
        by = [one.scale_factor / given for one in tried]
        values = [share * one.lock_in_rate for share, one in zip(by, tried, strict=True)]
        way = np.array([0.5 * by[0] / tried[0].lock_in_rate, 0.0, tried[0].lock_in_rate / given])
        own_u = float(np.sqrt(np.maximum(way @ tried[0].covariance @ way, 0.0)))
        value, u = values[0], math.hypot(own_u, *((one - values[0]) / math.sqrt(6) for one in values))
        low, high = (
            by[0] * min(one.lock_in_rate_low_95 for one in tried),
            by[0] * max(one.lock_in_rate_high_95 for one in tried),
        )
        if math.isfinite(u):
            routes.append(Route("frequencies", value, u, low, high))
    return tuple(routes)
