"""A two-mode laser fitted to all points of a run: beat harmonics, rates, and single beams where there are any.

Every setting is the periodic solution of the equations of a two-mode laser (`analysis.two_mode_laser`) at the beat
that was seen, and its signals go through the receivers. One least-squares fit has everything that was seen as its
data, and whatever may spoil it as its unknowns, each with a bound. `analysis.single_beams` has the beams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.special

from analysis.arrays import Bools, Complexes, Floats, Indices, NoFit
from analysis.budget import SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT, BenchKnowledge
from analysis.lockin_rate import size_interval
from analysis.several_rates.points import Points
from analysis.several_rates.ratio_model import (
    SENSES,
    Prior,
    RatioData,
    in_standard_uncertainties,
    nearest_series,
    prior_of,
)
from analysis.two_mode_laser import NUMBERS, lines_in_time, periodic_states, states_beside, steps_of_a_turn

N_PARAMETERS = 27

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
# imbalance of the beams; dispersion of the gain: backscatters are those that lock, with a factor 1 -+ i h
IMBALANCE, DISPERSION = 25, 26


SATURATION_USUAL, _SATURATION_U, _MOST_SATURATION = 0.5, 0.25, 0.95
_GAIN, _GAIN_U = math.log(2 * math.pi * 1000.0), 3.0  # a gain corner of 10 Hz to 100 kHz
MOST_BIAS = 0.005  # deg/s: the earth rate
_IMBALANCE, _DISPERSION = 0.05, 0.03  # bounds
_RECTANGLE = math.sqrt(3.0)


@dataclass(frozen=True)
class LaserData:
    """Everything that one fit compares, of P points."""

    points: Points
    swing: Complexes  # (P, 2) modulation of the beams, and the reciprocal of its u, 0 where there is none
    swing_weight: Floats
    phase_u: Floats  # (P,) of the beat, rad: it turns both beams
    over: Floats  # (P, 2) amplitude of the beat over the level
    rate_weight: Floats  # (P,) reciprocal of the u of each rate, deg/s; 0 where nobody knows it
    beat_u: Floats  # (P,) Hz
    mean: Floats  # (N_PARAMETERS,) known beforehand, and its standard deviation
    sd: Floats
    ac_corner_hz: float  # of the coupling that was taken out of the beams
    harmonics: bool = True  # whether ratio and third harmonic count
    # of ln(a2/a1) and of the sum of the phases, where no beam tells them: standard deviations and mean
    usual: tuple[float, float] = (math.inf, math.inf)
    about: tuple[float, float] = (0.0, 0.0)

    @property
    def degrees(self) -> int:
        """Values less unknowns of which nothing is known beforehand."""
        points = self.points.points
        values = [self.swing_weight, points.ratio] * 2 + [self.rate_weight, points.third_weight]
        known = int(np.count_nonzero(np.isfinite(self.usual)))
        return sum(int(np.count_nonzero(one)) for one in values) + known - int(np.count_nonzero(np.isinf(self.sd)))


def with_usual_gain(data: LaserData) -> LaserData:
    """Equal beams and no dispersion, for a first look: both fit what another coupling does."""
    return replace(data, sd=np.where(np.isin(np.arange(N_PARAMETERS), (IMBALANCE, DISPERSION)), 0.0, data.sd))


def whitened(left: Complexes, swing: Complexes, weight: Floats, phase_u: Floats) -> Complexes:
    """Differences (..., 2) from the modulation of both beams, along and across it, in standard uncertainties."""
    turned = left * np.exp(-1j * np.angle(swing)) * weight
    shared = np.abs(swing) * weight * phase_u[..., np.newaxis]
    square = np.sum(shared**2, axis=-1, keepdims=True)
    # root of the inverse of their covariance across: of its unit, and what the phase of the beat adds to both
    less = shared / (1 + square + np.sqrt(1 + square))
    across = turned.imag - less * np.sum(shared * turned.imag, axis=-1, keepdims=True)
    return np.asarray(turned.real + 1j * across)


def beforehand(some: RatioData, bench: BenchKnowledge) -> tuple[Floats, Floats]:
    """Mean and standard deviation of laser, receiver and rates before there are data, (N_PARAMETERS,)."""
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
    mean[SATURATION], sd[SATURATION] = SATURATION_USUAL, _SATURATION_U
    sd[SCALE] = math.hypot(SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT) / _RECTANGLE
    sd[BIAS] = MOST_BIAS / _RECTANGLE
    sd[IMBALANCE], sd[DISPERSION] = _IMBALANCE / _RECTANGLE, _DISPERSION / _RECTANGLE
    return mean, sd


# --------------------
# The model: a periodic solution for every setting, seen by three receivers


_FAILED = 1e6  # in standard uncertainties, where there is no solution
_PASSES = 3  # by which the light in front of a receiver is found from what leaves it
_DETOUR = (0.3, 0.6, 0.8, 0.9, 1.0)  # of the backscatter, on the way to all of it


def _lasers(parameters: Floats, data: LaserData) -> tuple[Floats, Floats]:
    """Lasers of B sets at P points for :func:`periodic_states`, (B, P, `NUMBERS`), and readout phases (B, P)."""
    some, column = data.points.points, parameters[:, np.newaxis]
    turned = column[..., BETWEEN] * np.sign(some.rate) / 2 + column[..., TURN] * some.when
    turned = turned + column[..., BEND] * (6 * some.when**2 - 0.5)
    grown = np.abs(1 + column[..., DRIFT] * some.when)
    numbers, dispersion = np.empty((*grown.shape, NUMBERS)), column[..., DISPERSION]
    grown /= np.hypot(1.0, dispersion)
    for beam, part in enumerate((FIRST, SECOND)):
        numbers[..., beam] = np.exp(np.clip(column[..., part.start], -30.0, 30.0)) * grown
    first, second = column[..., FIRST.stop - 1], column[..., SECOND.stop - 1]
    half = np.angle(np.exp(1j * (second - first))) / 2
    numbers[..., 2] = half - np.arctan(dispersion)
    numbers[..., 3] = np.clip(column[..., SATURATION], 0.0, _MOST_SATURATION)
    numbers[..., 4] = np.exp(np.minimum(column[..., GAIN], 30.0))
    numbers[..., 5], numbers[..., 6] = np.clip(column[..., IMBALANCE], -0.9, 0.9), dispersion
    return numbers, -(first + turned + half)


def _backscatter(part: Floats) -> Complexes:
    """A complex number (...), rad/s, from its logarithm (..., 2)."""
    return np.asarray(np.exp(np.clip(part[..., 0], -30.0, 30.0) + 1j * part[..., 1]))


class LaserModel:
    """The model of some data; of several sets of parameters the last is solved, others must be beside it."""

    def __init__(self, data: LaserData) -> None:
        self.data, some = data, data.points.points
        steps, self.lines = steps_of_a_turn(some.ratio)
        # states (P, 2, n), sagnac (P,) and the lasers (P, NUMBERS) that they solve: there the next solution begins
        none = np.zeros((some.rate.size, 2, steps))
        self.last: tuple[Floats, Floats, Floats | None] = none, np.sign(some.rate) * some.angular, None
        self.slopes: tuple[object, Floats] = None, np.empty(0)
        self.softer = 1.0  # times as much noise as there is

    def of(self, data: LaserData) -> LaserModel:
        """The same of other data of these points, begun at its solutions."""
        other = copy(self)
        other.data, other.slopes = data, (None, np.empty(0))
        return other

    @np.errstate(over="ignore", divide="ignore", invalid="ignore")  # where there is no laser it says so
    def residual(self, parameters: Floats) -> Floats:
        """Everything in its standard uncertainties for parameters (B, N_PARAMETERS): (B, values)."""
        data, some = self.data, self.data.points.points
        ratio, third, swing, sagnac, found = self.predicted(parameters)
        of_ratio, of_third = in_standard_uncertainties(some.ratio - ratio, some.third - third, some)
        of_swing = whitened(data.swing - swing, data.swing, data.swing_weight, data.phase_u)
        of_rate = self.of_rate(parameters, sagnac)
        fixed = data.sd > 0
        before = (data.mean - parameters)[:, fixed] / data.sd[fixed]
        if math.isfinite(data.usual[0]):
            turned = np.angle(np.exp(1j * (parameters[:, 3] - parameters[:, 1])))
            unusual = np.stack([parameters[:, 2] - parameters[:, 0], turned], axis=-1) - data.about
            before = np.concatenate([before, unusual / data.usual], axis=-1)
        counts = float(data.harmonics)
        parts = counts * of_ratio, counts * of_third, of_swing.real, of_swing.imag, of_rate
        seen = [part.reshape(len(parameters), -1) / self.softer for part in parts]
        whole = np.concatenate([*seen, before], axis=-1)
        return np.where(found & np.isfinite(whole), whole, _FAILED)

    def of_rate(self, parameters: Floats, sagnac: Floats) -> Floats:
        """What rates (B, P) leave of those of the table, in standard uncertainties."""
        rate = sagnac / (2 * np.pi * self.data.points.records.records.scale_factor)
        known = self.data.points.points.rate * (1 + parameters[:, SCALE, np.newaxis])
        return np.asarray((known + parameters[:, BIAS, np.newaxis] - rate) * self.data.rate_weight)

    def predicted(self, parameters: Floats) -> tuple[Complexes, Floats, Complexes, Floats, bool]:
        """Ratio, third harmonic (B, P), modulation of the beams (B, P, 2), 2 pi K W (B, P); if there are."""
        data, angular, column = self.data, self.data.points.points.angular, parameters[:, np.newaxis]
        numbers, readout = _lasers(parameters, data)
        light = self._light(numbers)
        # records turn while they are taken: their mean is that of two
        beside, weights = data.points.beside.T, data.points.beside_weights.T
        each, when = column[..., np.newaxis, :], data.points.points.when[:, np.newaxis]
        turning = each[..., TURN] + 6 * each[..., BEND] * (2 * when + beside)
        seen = self._seen(each, readout[..., np.newaxis] - turning * beside, light)
        ratio, third, swing = ((part * weights).sum(axis=-1) for part in seen)
        swing = np.moveaxis(swing, 0, -1)
        swing = swing / (1 + 1j * angular[:, np.newaxis] * column[..., DELAY])
        swing = swing + column[..., CROSSTALK] * data.over + column[..., OTHER_BEAM] * swing[..., ::-1]
        hertz, stated = angular[:, np.newaxis] / (2 * np.pi), data.ac_corner_hz
        corner = (hertz - 1j * stated) / (hertz - 1j * (stated + column[..., CORNER, np.newaxis]))
        swing = np.exp(column[..., LEVEL]) * swing * corner
        return ratio, third.real, swing, light.sagnac[light.of_set], light.found

    def _seen(self, parameters: Floats, readout: Floats, light: _Light) -> tuple[Complexes, Floats, Complexes]:
        """Ratio and third harmonic (B, P, k) at readout phases; swing of the beams in front of their receivers."""
        lines = self._lines(parameters, readout, light)
        w, value = nearest_series(lines, np.conj(lines[..., 1] / lines[..., 0]))
        turn = np.abs(value) / value
        left = lines[..., 2] - (1 - np.abs(w) ** 2) * value * np.conj(w) ** 2
        third = (left * turn**3).real / np.abs(value)
        beams = np.einsum("bin,bn->ib", light.beams, light.kernel[:, 0])[:, light.of_set, np.newaxis]
        return np.conj(w) * turn, third, beams * (np.abs(lines[..., 0]) / lines[..., 0])

    def _light(self, numbers: Floats) -> _Light:
        """Periodic solutions for the lasers (B, P, `NUMBERS`) of all sets: each different one once."""
        angular = self.data.points.points.angular
        (values, sagnac, solved), found = self.last, np.array(True)
        if solved is None or np.any(numbers[-1] != solved):
            values, sagnac, found = _by_degrees(numbers[-1], sagnac, values, angular)
        if found.all():
            self.last = values, sagnac, numbers[-1]
        # most parameters leave the lasers as they are
        others = np.any(numbers != numbers[-1], axis=(1, 2)) & found.all()
        which, back = np.append(np.flatnonzero(others), -1), np.where(others, np.cumsum(others) - 1, others.sum())
        if len(which) > 1:
            values, sagnac = states_beside(numbers[which], numbers[-1], sagnac, values, angular)
        psi, kernel, _ = lines_in_time(numbers[which].reshape(-1, NUMBERS), sagnac, values, self.lines)
        of_set = back[:, np.newaxis] * angular.size + np.arange(angular.size)
        return _Light(psi, np.exp(values), kernel, sagnac, bool(found.all()), of_set)

    def _lines(self, parameters: Floats, readout: Floats, light: _Light) -> Complexes:
        """Harmonics (B, P, k, lines) of the beat behind its receiver, over its amplitude."""
        some, at = self.data.points.points, (light.of_set, np.newaxis)
        numbers = PEDESTAL, DISTORTION, THIRD_ORDER, IMBALANCE
        pedestal, second, third, unequal = (parameters[..., [part]] for part in numbers)
        fringes = np.sqrt(light.beams.prod(axis=1))[at] * np.sin(light.psi[at] + readout[..., np.newaxis])
        single = light.beams.mean(axis=1)[at] - 1 + unequal / 2 * (light.beams[:, 0] - light.beams[:, 1])[at]
        signal = fringes = fringes + pedestal * single
        # How much light there is the records say, by the amplitude of the series nearest to what leaves the
        # receiver: the laser gives the shape
        x = some.angular[:, np.newaxis] * parameters[..., LAG]
        amplitude = some.amplitude[:, np.newaxis] * np.hypot(1.0, x)  # before the pole
        kernel = light.kernel[light.of_set]
        lines = np.einsum("bpkn,bpmn->bpkm", signal, kernel)
        w = np.conj(lines[..., 1] / lines[..., 0])
        for _ in range(_PASSES):
            w, value = nearest_series(lines, w, 1)
            fringes = fringes * (amplitude / np.abs(value))[..., np.newaxis]
            signal = fringes * (1 + fringes * (2 * second + 4 * third * fringes))
            lines = np.einsum("bpkn,bpmn->bpkm", signal, kernel)
        return np.asarray(lines / (1 + 1j * x[..., np.newaxis] * np.arange(1, lines.shape[-1] + 1)))


@dataclass(frozen=True)
class _Light:
    """Periodic solutions of L different lasers at n even steps of their phase."""

    psi: Floats  # (L, n)
    beams: Floats  # (L, 2, n) I1 and I2
    kernel: Complexes  # (L, lines, n) gives the harmonics in time
    sagnac: Floats  # (L,) 2 pi K W
    found: bool  # whether the last set has solutions, which are near to all others
    of_set: Indices  # (B, P) which of them each set has at each point


def _by_degrees(lasers: Floats, sagnac: Floats, start: Floats, angular: Floats) -> tuple[Floats, Floats, Bools]:
    """As :func:`periodic_states`; where it finds none, by way of weaker backscatter."""
    values, rates, found = periodic_states(lasers, sagnac, start, angular)
    lost = np.flatnonzero(~found)
    if lost.size:
        free = np.sign(sagnac[lost]) * angular[lost]
        some, then = np.zeros_like(start[lost]), free
        for share in _DETOUR:
            weaker = lasers[lost] * np.where(np.arange(NUMBERS) < 2, share, 1.0)
            some, then, there = periodic_states(weaker, then, some, angular[lost])
            some, then = np.where(there[:, np.newaxis, np.newaxis], some, 0.0), np.where(there, then, free)
        values[lost], rates[lost], found[lost] = some, then, there
    return values, rates, found


# --------------------
# The fit


POSSIBLE = 9.0  # chi-square above the best up to which another solution is possible
EVALUATIONS = 40  # steps of a search to the end
_HOPELESS, _GOOD = 100.0, 2.0  # chi-square over the values: no laser is near; much worse places are left alone
_SETTLED, _ROUGHLY = 1e-9, 1e-4  # a step that changes chi-square (or parameters: 1e-9) by less was the last one
_TRIED, _FAR = 15, 30.0  # steps after which a place that is still so far above a good laser is left
_SMALL = 1e-6  # step of a parameter of which nothing is known
LEAST_U = 1e-6  # of a rate: no table turns more steadily from one to the next, whatever its display says
_STATED, _ROUNDS = 4.0, 3  # degrees of freedom of uncertainties that were stated
_OFF, _UNKNOWN = 10.0, 1e-3  # rates that fit worse may be off by that share
_SHOWN = 0.05  # u of a turn over that beforehand, where records show it
_TURNED = np.array([-1.5, -0.5, 0.5, 1.5])  # of the same, turns from which a search begins where they do not


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
        # what it found last stays with the fit: close to lock-in nothing else leads there
        return cls(copy(model), parameters, covariance, float(residual @ residual), volume, residual.size)

    def coupling(self, widen: float, *, per_rate: bool = False) -> tuple[tuple[float, ...], tuple[float, float]]:
        """|C| freed of the bias of its size, its u and 95 % interval (rad/s), and the phase of C with its u."""
        # per rate as the table has it: a scale factor that is wrong moves beats and coupling alike
        first, second = (complex(_backscatter(self.parameters[part])) for part in (FIRST, SECOND))
        both, whole = np.hstack([[[c.real, -c.imag], [c.imag, c.real]] for c in (first, second)]), first + second
        spread = both @ self.covariance[:4, :4] @ both.T * widen
        size = max(abs(whole), 1e-300)
        along, across = np.array([whole.real, whole.imag]) / size, np.array([-whole.imag, whole.real]) / size
        u, across_u = (math.sqrt(max(float(way @ spread @ way), 1e-300)) for way in (along, across))
        scale = 1.0
        if per_rate:
            slopes, scale = both.T @ along / size, 1 + float(self.parameters[SCALE])
            with_scale = self.covariance[SCALE, :4] @ slopes / scale
            share = max(
                (u / size) ** 2 + widen * (self.covariance[SCALE, SCALE] / scale**2 - 2 * with_scale), 1e-24
            )
            size, u, across_u = size / scale, size / scale * math.sqrt(share), across_u / scale
        low, high = size_interval(size / u)
        # a phase that turns makes the angle uncertain, and the size none the larger
        turns = BETWEEN + np.flatnonzero(np.diagonal(self.covariance)[BETWEEN:DRIFT] > 0)
        shared = self.covariance[turns, :4] @ (across @ both) / scale
        by_turns = widen * float(shared @ np.linalg.solve(self.covariance[np.ix_(turns, turns)], shared))
        freed = math.sqrt(max(size**2 - max(across_u**2 - by_turns, 0.0), 0.0))
        return (freed, u, float(low) * u, float(high) * u), (float(np.angle(whole)), across_u / size)

    @property
    def degrees(self) -> int:
        """Values less unknowns; one that was known as well beforehand as it is now costs none."""
        data = self.model.data
        known = np.isfinite(data.sd) & (data.sd > 0)
        kept = np.diagonal(self.covariance)[known] / data.sd[known] ** 2
        kept = np.minimum(np.append(kept, (self.unequal_u / data.usual) ** 2), 1.0)
        return data.degrees - round(float(np.sum(1 - kept)))

    @property
    def unequal_u(self) -> Floats:
        """Standard uncertainties of ln(a2/a1) and of the angle between the backscatters."""
        difference = np.hstack([-np.eye(2), np.eye(2)])
        return np.asarray(np.sqrt(np.diagonal(difference @ self.covariance[:4, :4] @ difference.T)))

    @property
    def drifts(self) -> tuple[Floats, Floats]:
        """Phase between the senses, its turn and bend over the run, growth of the coupling; their u, (4,) each."""
        us = np.sqrt(np.diagonal(self.covariance))
        return self.parameters[BETWEEN : DRIFT + 1], np.asarray(us[BETWEEN : DRIFT + 1])

    @property
    def gain_time(self) -> tuple[float, float]:
        """1/g_c and its standard uncertainty, s."""
        time = math.exp(-float(self.parameters[GAIN]))
        return time, time * float(np.sqrt(self.covariance[GAIN, GAIN]))

    @property
    def rates_off(self) -> Floats:
        """Shares by which the rates of the table are not those of the laser, (P,)."""
        points = self.model.data.points
        rate = self.model.predicted(self.parameters[np.newaxis])[3][0] / (2 * np.pi)
        return np.asarray(rate / (points.records.records.scale_factor * points.points.rate) - 1)

    @property
    def rates_scale(self) -> float:
        """How much larger the variance of the rates is than was stated, which counts as some more rates do."""
        only = self.parameters[np.newaxis]
        left = self.model.of_rate(only, self.model.predicted(only)[3])[0]
        return (_STATED + float(left @ left)) / (_STATED + int(np.count_nonzero(self.model.data.rate_weight)))

    def push(self) -> Floats:
        """Share by which each beat is faster than the lock-in equation says, (P,)."""
        sagnac = self.model.predicted(self.parameters[np.newaxis])[3][0]
        coupling = abs(complex(_backscatter(self.parameters[FIRST]) + _backscatter(self.parameters[SECOND])))
        by_lock_in = np.sqrt(np.maximum(sagnac**2 - coupling**2, 1e-300))
        return np.asarray(self.model.data.points.points.angular / by_lock_in - 1)

    def corrected(self, widen: float) -> tuple[Floats, Floats]:
        """Beat that each point would have without backscatter, Hz, signed, and its u."""
        steps = _steps(self.model.data)
        sets = np.concatenate([self.parameters + steps, self.parameters[np.newaxis]])
        *moved, sagnac = self.model.predicted(sets)[3]
        slopes = (np.array(moved) - sagnac) / np.diagonal(steps)[:, np.newaxis]
        variance = np.einsum("ip,ij,jp->p", slopes, self.covariance, slopes) * widen
        u = np.sqrt(np.maximum(variance, 0.0)) / (2 * np.pi)
        return sagnac / (2 * np.pi), np.hypot(u, self.model.data.beat_u)  # what shifts the beat shifts it as much


def _steps(data: LaserData) -> Floats:
    """A step of each parameter, (N_PARAMETERS, N_PARAMETERS), by which derivatives are taken."""
    return np.diag(np.where(np.isfinite(data.sd) & (data.sd > 0), 1e-4 * data.sd, _SMALL))


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # far from any laser
def search(
    model: LaserModel, start: Floats, evaluations: int, settled: float = _SETTLED
) -> tuple[Floats, float] | None:
    """Least squares from a start: parameters and chi-square; ``None`` where no laser is near it."""
    from scipy.optimize import least_squares  # takes as long to import as all else

    free = np.flatnonzero(model.data.sd > 0)
    # by what is known beforehand: measured by slopes, which are steep somewhere, steps become ever shorter
    sizes = np.where(np.isfinite(model.data.sd), model.data.sd, 1.0)[free]
    first, together = start[free], math.isfinite(model.data.usual[0])
    if together:
        # where no beam is seen the valleys follow the coupling, with ratio and angle of the backscatters
        coupling = np.log(complex(_backscatter(start[FIRST]) + _backscatter(start[SECOND])))
        first[:4] = coupling.real, coupling.imag, start[2] - start[0], start[3] - start[1]
        sizes[2:4] = model.data.usual

    def whole(step: Floats) -> Floats:
        parameters, values = start.copy(), first + sizes * step
        parameters[free] = values
        if together:
            parameters[:4] = _backscatters(np.exp(complex(*values[:2])), values[3], values[2])
        return parameters

    least, near = math.inf, model.last

    def residual(step: Floats) -> Floats:
        nonlocal least, near
        model.last = near  # from a laser far away Newton's method may end at none
        left = model.residual(whole(step)[np.newaxis])[0]
        if float(left @ left) < least:
            least, near = float(left @ left), model.last
        return np.asarray(left)

    def slope(step: Floats) -> Floats:
        slopes = _jacobian(model, whole(step), free).copy()
        if together:
            second = 1 / (1 + np.exp(-complex(*(first + sizes * step)[2:4])))
            both = np.array([[1, 1j, -second, -1j * second], [1, 1j, 1 - second, 1j - 1j * second]])
            slopes[:, :4] = slopes[:, :4] @ np.stack([both.real, both.imag], axis=1).reshape(4, 4)
        return slopes * sizes

    nowhere = np.zeros(free.size)
    if residual(nowhere)[0] == _FAILED:
        return None
    made = least_squares(residual, nowhere, slope, max_nfev=evaluations, ftol=settled, xtol=_SETTLED, gtol=None)
    end, model.last = whole(made.x), near
    if turns := round(float(end[BETWEEN]) / (2 * np.pi)):  # one between the senses is half a one of both
        end[[BETWEEN, FIRST.stop - 1, SECOND.stop - 1]] += np.pi * turns * np.array([-2, 1, 1])
        return search(model, end, evaluations, settled)
    return end, 2 * float(made.cost)


def _jacobian(model: LaserModel, parameters: Floats, free: Indices) -> Floats:
    """Derivatives of the residuals, (values, free)."""
    key = (model.softer, parameters.tobytes())
    if model.slopes[0] != key:  # where a search ends they are known
        steps = _steps(model.data)[free]
        both = model.residual(np.concatenate([parameters + steps, parameters[np.newaxis]]))
        model.slopes = key, ((both[:-1] - both[-1]) / steps[np.arange(free.size), free][:, np.newaxis]).T
    return model.slopes[1]


Look = tuple[LaserModel, Floats, float]
"""Where a search begins: a model with solutions close to its parameters, these, and chi-square."""


def solutions(data: LaserData, looked: list[Look]) -> list[LaserFit]:
    """The minima that are possible, the best first, from some looks at them."""
    found, looked = list[LaserFit](), sorted(looked, key=lambda one: one[2])
    for near, start, cost in looked:
        least = min((one.chi_square for one in found), default=math.inf)
        good = found and least < _GOOD * found[0].values
        if good and cost > looked[0][2] + 1e3:
            break
        model = near.of(data)
        end = search(model, start, _TRIED, _ROUGHLY)
        if end and not (good and end[1] > least + _FAR):
            end = search(model, end[0], EVALUATIONS, _ROUGHLY)
        if end is not None and end[1] < least + _FAR:
            found = _with(found, LaserFit.at(model, end[0]))
    if not found:
        raise NoFit("no two-mode laser fits the records")
    best = min(found, key=lambda one: one.chi_square)
    if len(looked) > 1 and best.covariance[TURN, TURN] > (_SHOWN * data.sd[TURN]) ** 2:
        # phases that turn stand for a coupling at another angle, and a ridge may be between the two
        held = best.model.of(replace(data, sd=np.where(np.arange(N_PARAMETERS) == TURN, 0.0, data.sd)))
        for turn in _TURNED * data.sd[TURN]:
            start = np.where(np.arange(N_PARAMETERS) == TURN, turn, best.parameters)
            end = search(held, start, EVALUATIONS, _ROUGHLY)
            end = end and search(model := held.of(data), end[0], EVALUATIONS, _ROUGHLY)
            found = found if end is None else _with(found, LaserFit.at(model, end[0]))
    least = min(one.chi_square for one in found)
    ends = (
        (one, search(one.model, one.parameters, EVALUATIONS)) for one in found if one.chi_square < least + _FAR
    )
    ended = (LaserFit.at(one.model, end[0]) if end else one for one, end in ends)
    found = []
    for one in sorted(ended, key=lambda one: one.chi_square):
        found = _with(found, one)  # two may have ended at one
    if found[0].chi_square > _HOPELESS * found[0].values:
        raise NoFit("no two-mode laser is near what the records show: is its backscatter too strong for its gain?")
    return [one for one in found if one.chi_square < found[0].chi_square + POSSIBLE]


def _with(found: list[LaserFit], one: LaserFit) -> list[LaserFit]:
    """The minima and one more, if it is another."""
    u, data = 1e-3 + 0.5 * np.sqrt(np.diagonal(one.covariance)[:4]), one.model.data
    alike = any(np.all(_apart(one.parameters, other.parameters, data) < u) for other in found)
    return found if alike else [*found, one]


def _apart(one: Floats, other: Floats, data: LaserData) -> Floats:
    """Differences of both backscatters of two sets: of logarithms, and rad, (4,)."""
    # where no beam is seen nobody can say which of the two it is
    alike = [[0, 1, 2, 3], [2, 3, 0, 1]][: 2 if math.isfinite(data.usual[0]) else 1]
    differences = one[alike] - other[:4]
    differences[:, 1::2] = np.angle(np.exp(1j * differences[:, 1::2]))
    return np.asarray(np.abs(differences[np.argmin(np.abs(differences).max(axis=1))]))


def laplace(found: Sequence[LaserFit], widen: float, *, per_rate: bool = False) -> list[tuple[float, ...]]:
    """Coupling of all minima, u of all about the best and the interval that holds them; then of each; rad/s."""
    # the share of the probability under each goes with its height and its volume, as in the fit of equation (1)
    each = [one.coupling(widen, per_rate=per_rate)[0] for one in found]
    likely = np.exp([-0.5 * (one.chi_square - found[0].chi_square) / widen + one.log_volume for one in found])
    values, us, low, high = np.array(each).T
    if any(found[0].model.data.about):  # parts of one valley, not valleys
        return [of_bells(values, us, likely)]
    u = math.sqrt(float(np.average(us**2 + (values - values[0]) ** 2, weights=likely)))
    return [(float(values[0]), u, float(low.min()), float(high.max())), *each]


def of_bells(values: Floats, us: Floats, weights: Floats) -> tuple[float, float, float, float]:
    """Mean, standard deviation and 95 % interval of a sum of bells, (n,) each."""
    weights = weights / weights.sum()
    mean = float(values @ weights)
    u = math.sqrt(float(weights @ (us**2 + (values - mean) ** 2)))
    sizes = np.linspace(np.min(values - _TAILS * us), np.max(values + _TAILS * us), _STEPS)
    low, high = np.interp(_INTERVAL, scipy.special.ndtr((sizes[:, np.newaxis] - values) / us) @ weights, sizes)
    return mean, u, float(low), float(high)


_INTERVAL, _TAILS, _STEPS = (0.025, 0.975), 6.0, 4001


def rates_weight(points: Points, own_u: float) -> tuple[Floats, Floats]:
    """Reciprocal of the u of the rate of each point (deg/s), each off by itself by so much; u of its beat, Hz."""
    records, rates = points.records.records, np.abs(points.points.rate)
    rate_u, beats = np.zeros(rates.size), np.zeros((2, rates.size))
    for rows, block in points.records.blocks():
        np.maximum.at(rate_u, points.places[block], points.records.rate_u[rows])
        beats += points.places.sums(block, np.ones(block.rate.shape), block.beat_frequency_u**2)
    beat_u = np.sqrt(beats[1]) / beats[0]
    by_beat = points.points.beat_rate / rates * beat_u / records.scale_factor
    u = np.linalg.norm([rate_u, by_beat, np.fmax(own_u, LEAST_U) * rates], axis=0)
    return (not records.rate_of_beat) / u, beat_u


def lasers_by_rates(
    data: LaserData, look: Callable[[LaserData], list[LaserFit]], own_u: float = LEAST_U
) -> list[LaserFit]:
    """Lasers that data allow, each rate off by itself by as much as they show: at least by so much, relative."""
    found = list[LaserFit]()
    for own in (own_u, np.fmax(own_u, _UNKNOWN)):  # rates that no laser follows, or one that goes far, say little
        data = replace(data, rate_weight=rates_weight(data.points, own)[0])
        try:
            found = look(data)
        except NoFit:
            if own >= _UNKNOWN and not found:
                raise
        if found and found[0].rates_scale < _OFF:
            break
    for _ in range(_ROUNDS):
        scale = found[0].rates_scale
        if scale <= 1:
            break
        data = replace(data, rate_weight=data.rate_weight / math.sqrt(scale))
        found = solutions(data, [(one.model, one.parameters, one.chi_square) for one in found])
    return found


# --------------------
# The beat alone: its harmonics say what a laser adds to each ratio, and its rates how much it pushes each beat.
#
# Equation (1) of `ratio_model` knows one kind of backscatter. Another adds shares of (B_s/g_d)^2 to WL, and pushes
# the beat of each sense by its own share (docs/several_rates.md).


BACKSCATTER = np.array([[-math.radians(60.0), -math.log(2.5), 0.35], [math.radians(60.0), math.log(2.5), 0.65]])
"""Between which a laser usually is: sum of the phases, rad; logarithm of a2/a1; cross over self saturation."""

_LOGARITHMS, _ANGLES = (0.15, 0.7), (-0.9, -0.3, 0.3, 0.9)  # from which a search begins; exchanged beams are alike
_FIRST_LOOK, _LOOKED_AT, _OF_PART = 8, 3, 20  # evaluations of a first look, how many are followed; of a part
_ALIKE = 0.02  # of logarithms, and rad: ends of two looks that are one
_BROAD = 0.3  # u of ln(a2/a1) or of the angle over that beforehand, from which one bell would not do
_PART, _APART = 0.6, 4.0  # of what is usual, that of a part; u between valleys that are not parts of one
_ANGLE_PLACES = (-1.75, -1.05, -0.35, 0.35, 1.05, 1.75)
_PLACES = np.array([(m, n * way) for m, way in ((0.35, 1), (1.05, -1), (1.75, 1)) for n in _ANGLE_PLACES])
_CORNERS, _SAME = _PLACES[[0, 5, 12, 17]], 0.25  # share of its u by which the coupling is the same at all of them


def beat_data(points: Points, bench: BenchKnowledge) -> LaserData:
    """The points of a beat without beams, and what is known of everything beforehand."""
    mean, sd = beforehand(points.points, bench)
    half = np.ptp(BACKSCATTER, axis=0) / 2 / _RECTANGLE
    sd[LEVEL.start : DELAY.stop], sd[[CORNER, PEDESTAL]], sd[SATURATION] = 0.0, 0.0, half[2]
    weight, beat_u = rates_weight(points, LEAST_U)
    sd[SCALE], sd[BIAS] = 0.1 * weight.any(), sd[BIAS] * weight.any()  # anything that all rates have in common
    usual, nothing = (half[1], half[0]), np.zeros((weight.size, 2))
    swing = nothing.astype(np.complex128)
    return LaserData(points, swing, nothing, 0 * weight, nothing, weight, beat_u, mean, sd, 0.0, usual=usual)


def lasers_of_beat(points: Points, starts: Floats, known: Prior, bench: BenchKnowledge) -> list[LaserFit]:
    """Lasers that harmonics and rates allow, the likeliest first; begun from sets of equation (1) (B, 10)."""
    data = beat_data(points, bench)
    data.sd[BETWEEN : DRIFT + 1], usual = known.sd[SENSES:], data.usual
    found = lasers_by_rates(data, lambda data: _looked(data, starts))
    best, sizes = found[0], np.array([one.coupling(1.0)[0] for one in found])
    apart = bool(np.any(np.abs(sizes[:, 0] - sizes[0, 0]) > _APART * sizes[:, 1].max()))
    if apart or not np.any(best.unequal_u > _BROAD * np.array(usual)):
        return found
    # What is known beforehand is a sum of narrower bells, each of which has a minimum of its own; where the
    # coupling is the same at all corners one does
    corners = [_of_part(best.model.data, best, place) for place in _CORNERS]
    sizes = np.array([one.coupling(1.0)[0] for one in (best, *corners) if one])
    if None not in corners and np.all(np.ptp(sizes[:, :2], axis=0) < _SAME * sizes[0, 1]):
        return found
    parts, near = list[LaserFit](), best
    for place in _PLACES:
        if (end := _of_part(best.model.data, near, place)) is not None:
            near = end
            parts.append(replace(near, chi_square=near.chi_square + float(place @ place) / (1 - _PART**2)))
    return sorted(parts, key=lambda one: one.chi_square) or [best]


def _of_part(data: LaserData, near: LaserFit, place: Floats) -> LaserFit | None:
    """The minimum of a narrower bell about a place, from one near to it."""
    about = place * data.usual
    part = replace(data, usual=tuple(np.array(data.usual) * _PART), about=tuple(about))
    coupling = complex(_backscatter(near.parameters[FIRST]) + _backscatter(near.parameters[SECOND]))
    start = np.concatenate([_backscatters(coupling, about[1], about[0]), near.parameters[4:]])
    end = search(model := near.model.of(part), start, _OF_PART, _ROUGHLY)
    return None if end is None else LaserFit.at(model, end[0])


def _looked(data: LaserData, starts: Floats) -> list[LaserFit]:
    """Lasers that some data allow, begun from several lasers at each of the sets of equation (1)."""
    model, followed = LaserModel(with_usual_gain(data)), list[Look]()
    model.last = model.last[0][..., : 1 + 4 * (2 * model.lines // 3)], *model.last[1:]  # enough to look
    for start in starts:
        lasers = (_as_laser(start, angle, logarithm, data) for angle, logarithm in product(_ANGLES, _LOGARITHMS))
        looked = [end for laser in lasers if (end := search(copy(model), laser, _FIRST_LOOK, _ROUGHLY))]
        different = list[tuple[Floats, float]]()
        for end in sorted(looked, key=lambda one: one[1]):
            if all(np.max(_apart(end[0], other, data)) > _ALIKE for other, _ in different):
                different.append(end)
        followed += [(LaserModel(data), *end) for end in different[:_LOOKED_AT]]
    return solutions(data, followed)


def _as_laser(start: Floats, angle: float, logarithm: float, data: LaserData) -> Floats:
    """Parameters of a laser with the coupling and all else of equation (1) (10,)."""
    made = np.where(np.isfinite(data.sd), data.mean, 0.0)
    coupling = 2 * np.pi * data.points.records.records.scale_factor * complex(*start[:2])
    made[:4] = _backscatters(coupling, angle, logarithm)
    made[GAIN] = -math.log(max(float(start[3]), 1e-12))
    made[[DISTORTION, THIRD_ORDER, BETWEEN, TURN, BEND, DRIFT]] = start[[2, 5, 6, 7, 8, 9]]
    made[LAG] = math.sqrt(max(float(start[4]), 0.0))
    return np.where(data.sd > 0, made, data.mean)


def _backscatters(coupling: complex, angle: float, logarithm: float) -> Floats:
    """Logarithms of two backscatters, (4,), that make a coupling (rad/s)."""
    one, other = np.exp(-0.5j * angle), np.exp(logarithm + 0.5j * angle)
    first = np.log(coupling * one / (one + other))
    return np.array([first.real, first.imag, first.real + logarithm, first.imag + angle])
