"""Lock-in rate from records at several rates and in both senses, free of what one record cannot show.

The lock-in part of the harmonic ratio falls with the rate and turns round with the sense; second-order distortion
of the receiver does neither, the finite speed of the laser's gain turns it in phase, and a slow receiver weakens
it with the square of the rate. Records at several rates tell them apart (equation (1) of `ratio_model`, derived in
docs/several_rates.md). What they leave open is bounded by what is known of receiver and laser beforehand.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Literal

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Complexes, Floats, NoFit
from analysis.budget import BenchKnowledge
from analysis.lockin_rate import LockInEstimate
from analysis.several_rates.laser_fit import POSSIBLE, LaserFit, lasers_of_beat, of_bells
from analysis.several_rates.points import (
    FASTER_THAN_POSSIBLE,
    MISMATCH,
    SAME_RATE,
    Points,
    RatioRecords,
    UsedRecords,
    at_mean_times,
    common_mismatch,
    gather,
    inconsistent_rate,
    mismatch_of_all,
    rate_mismatch,
    rates_differ,
    records_of_arrays,
    records_of_estimates,
    with_noise,
    with_rate_noise,
)
from analysis.several_rates.ratio_model import (
    DRIFT,
    N_PARAMETERS,
    SENSES,
    Prior,
    RatioData,
    RatioFit,
    Reference,
    all_solutions,
    beyond_first_order,
    fit_ratios,
    predicted,
    prior_of,
    third_order_by_third_harmonic,
    with_distortion_alone,
)
from analysis.several_rates.result import (
    Model,
    ModelFit,
    RatesAnswer,
    RatesFit,
    RatesFlag,
    WithoutOneRate,
    answer,
    answer_of_lasers,
    largest_possible,
    lock_in_u,
    minimum_volumes,
    polar_covariance,
    size_us,
    up_to,
    widened,
)

_REST = N_PARAMETERS - 4
FREE: dict[Model, tuple[bool, ...]] = {
    "lock-in": (False, False, *(False,) * _REST),
    "distortion": (True, False, *(False,) * _REST),
    "gain": (False, True, *(False,) * _REST),
    "both": (True, True, *(False,) * _REST),
    "all": (True, True, *(True,) * _REST),
}
"""What each model fits beside the lock-in rate and its phase: distortion, gain time, and all the rest."""

COUNTED = ("distortion", "gain_corner", "bandwidth", "third_order")
"""Lines of a budget that these parameters stand for."""

MORE_RECORDS = "take the other sense of rotation as well, or rates that differ by a factor of two and more"

ENLARGED = "; enlarged to the scatter between records, which is more than that noise explains"
UNEVEN = "; with what uneven codes of a converter add to third harmonics and ratios"
UNLIKELY = 0.001
CONTRADICTED = 15.0
"""What somebody stated is not used where chi-square is higher by more with it: nearly four standard deviations."""


def fit_rates(
    estimates: LockInEstimate | Sequence[LockInEstimate],
    *,
    input_rate: ArrayLike | None = None,
    input_rate_u: ArrayLike = 0.0,
    reference: Reference = "rate",
    model: Model | Literal["auto"] = "auto",
    receiver: BenchKnowledge | None = None,
    in_order: bool | None = None,
    other: RatesFit | None = None,
) -> RatesFit:
    """Lock-in rate, distortion and bandwidth of the receiver, and gain corner, from records at several rates.

    The lock-in rate follows from two rates, or from one rate in both senses; its uncertainty counts what these do
    not tell of receiver and laser. Several rates in both senses tell all of it.

    Parameters
    ----------
    estimates : LockInEstimate, or several
        Records of one gyro, any shapes, from `estimate_lock_in` with a signed ``input_rate``; also means of
        records at one rate from `combine_estimates`.
    input_rate : array of n values, optional
        deg/s, signed; instead of the rates in the estimates.
    input_rate_u : float or array of n values
        deg/s, standard uncertainty of each rate, independent between records. What all records share (tilt,
        scale factor) does not belong here: it goes 1:1 into the lock-in rate.
    reference : {"rate", "beat"}
        "rate": r = tan(asin(WL/W)/2). "beat": r from f/K of the same record, where table rate, tilt and earth
        rate do not enter and the rates given serve for the sense alone.
    model : {"auto", "lock-in", "distortion", "gain", "both", "all"}
        What is fitted beside the lock-in rate. "auto" is "all": second- and third-order distortion, gain corner
        and bandwidth, each within what is known of it beforehand. The others fit what they name, take the rest
        to be zero, and know nothing beforehand.
    receiver : BenchKnowledge, optional
        What is known of receiver and laser; without it the usual bounds hold (`analysis.budget`).
    in_order : bool, optional
        Whether the records stand in the order in which they were taken. Then phase and lock-in rate may drift over
        them, and the uncertainty counts it; without it only where the records do not fit otherwise.
    other : RatesFit, optional
        The fit of these records with the other reference: its lasers hold, and are not looked for again.

    Raises
    ------
    NoFit
        No usable record, rates that cannot tell the unknowns of the model apart (one rate in one sense).
    ValueError
        No sense of rotation, an unknown model or reference.

    Examples
    --------
    One rate in both senses, an ideal gyro with WL = W/10 and a receiver with -46 dBc:

    >>> fit = fit_rate_ratios([1.0, -1.0], [-0.05012563 + 0.005, 0.05012563 + 0.005], np.eye(2) * 1e-10,
    ...                       [994.98744, 994.98744], scale_factor=1000, model="distortion")
    >>> round(fit.lock_in_rate, 4), round(fit.distortion, 4)
    (0.1, 0.005)
    """
    rate_u = np.asarray(input_rate_u, dtype=np.float64)

    def fit(ordered: bool) -> RatesFit:
        records = records_of_estimates(estimates, input_rate, in_order=ordered)
        return _fit(records, rate_u, reference, model, receiver, other)

    found = fit(bool(in_order))
    if in_order is not None:
        return found
    # where records of one rate and sense differ by more than their noise, something may have drifted
    scatter, degrees = gather(found.records).scatter(found.parameters)
    if degrees > 0 and float(scipy.special.chdtrc(degrees, scatter)) < UNLIKELY:
        drifting = fit(True)
        return found if drifting.flags & RatesFlag.MISFIT else drifting
    return found


def fit_again(
    fit: RatesFit, *, factor: Callable[[Floats], Complexes], receiver: BenchKnowledge | None = None
) -> RatesFit:
    """The fit of the same records, with the ratio of each times a factor of its beat frequency."""
    records = fit.records.records.times(factor)
    return _fit(records, fit.records.rate_u, fit.reference, fit.model, receiver)


def fit_rate_ratios(
    input_rate: ArrayLike,
    ratio: ArrayLike,
    covariance: ArrayLike,
    beat_frequency: ArrayLike,
    *,
    scale_factor: float,
    beat_frequency_u: ArrayLike = 0.0,
    amplitude: ArrayLike = 1.0,
    third_harmonic: ArrayLike | None = None,
    third_harmonic_u: ArrayLike = np.inf,
    input_rate_u: ArrayLike = 0.0,
    reference: Reference = "rate",
    model: Model | Literal["auto"] = "auto",
    receiver: BenchKnowledge | None = None,
    in_order: bool = False,
) -> RatesFit:
    """`fit_rates` on plain arrays of n records.

    Parameters
    ----------
    input_rate : (n,)
        deg/s, signed. Where nobody knows them (`input_rate_u=inf`), what beat and ratio of each record make of it.
    ratio : (n,) complex
        rho = c2 |c1| / c1^2; nan for a record that cannot be used.
    covariance : (n, 2, 2) or (2, 2)
        Of the real and imaginary part of rho.
    beat_frequency, beat_frequency_u : (n,)
        Hz; 0 marks a record without a beat, which says WL >= |W|.
    scale_factor : float
        Pulses per degree.
    amplitude : (n,)
        Of the beat, any unit; distortion grows with it.
    third_harmonic, third_harmonic_u : (n,), optional
        Real part of the third harmonic beyond the waveform, as in `LockInEstimate`. Without it, and without
        `receiver`, the ratios are taken to be free of third-order distortion.
    input_rate_u, reference, model, receiver
        As in `fit_rates`.
    in_order : bool
        Whether they stand in the order in which they were taken: then phase and lock-in rate may drift over them.
    """
    if third_harmonic is None and receiver is None:
        receiver = BenchKnowledge(third_order_limit=0.0)
    rate_u = np.asarray(input_rate_u, dtype=np.float64)
    unknown = bool(np.isinf(rate_u).all())
    records = records_of_arrays(
        input_rate,
        ratio,
        covariance,
        beat_frequency,
        scale_factor=scale_factor,
        beat_frequency_u=beat_frequency_u,
        amplitude=amplitude,
        third_harmonic=0.0 if third_harmonic is None else third_harmonic,
        third_harmonic_u=third_harmonic_u,
        rate_of_beat=unknown,
        in_order=in_order,
    )
    return _fit(records, np.zeros_like(rate_u) if unknown else rate_u, reference, model, receiver)


def _fit(
    records: RatioRecords,
    rate_u: Floats,
    reference: Reference,
    model: Model | Literal["auto"],
    receiver: BenchKnowledge | None,
    other: RatesFit | None = None,
) -> RatesFit:
    if reference not in ("rate", "beat"):
        raise ValueError(f"reference {reference!r} is neither 'rate' nor 'beat'")
    if model != "auto" and model not in FREE:
        raise ValueError(f"model {model!r} is none of 'auto', {', '.join(map(repr, FREE))}")
    if not np.all(np.isfinite(rate_u)) or np.any(rate_u < 0):
        raise ValueError("input_rate_u must be finite and not negative (deg/s)")
    rate_u = np.broadcast_to(rate_u, records.rate.shape)
    used = records.usable.copy()
    if reference == "rate":
        used &= ~inconsistent_rate(records, rate_u, common_mismatch(records))
    if not used.any():
        raise NoFit("no record with a usable beat: nothing can be fitted")
    gathered = points = gather(UsedRecords(records, used, rate_u, reference))
    chosen: Model = "all" if model == "auto" else model
    known, usual = (
        prior_of(knowledge, float(points.points.angular.min()) / (2 * np.pi)).seen_by(points.points)
        for knowledge in (receiver or BenchKnowledge(), BenchKnowledge())
    )
    found = all_solutions(points.points, _prior(chosen, known))
    contradicted = False
    if receiver is not None and chosen == "all":
        free = fit_ratios(points.points, usual, found.parameters[:1])
        contradicted = bool(free.chi_square[0] < found.chi_square[0] - CONTRADICTED)
        if contradicted:
            known, found = usual, all_solutions(points.points, usual)
    # One rate in one sense tells nothing from lock-in, however many records there are.
    if points.settings < 2 and chosen != "lock-in":
        what = f"the unknowns of the model {model!r} apart" if model != "auto" else "distortion from lock-in"
        raise NoFit(f"these records cannot tell {what}: {MORE_RECORDS}")
    if found.singular[0]:
        raise NoFit(f"these records cannot tell the unknowns of the model {model!r} apart: {MORE_RECORDS}")
    most = np.inf if records.rate_of_beat else largest_possible(found, points.points)
    found = up_to(found, most)
    drift_u, drifting = np.sqrt(found.covariance[0, DRIFT, DRIFT]), known
    if chosen == "all" and known.sd[SENSES] > 0 and abs(found.parameters[0, DRIFT]) < _MAYBE * drift_u:
        # the senses stand for each other's times; in one sense nothing does, and any drift within its bound counts
        known = replace(known, sd=np.where(np.arange(N_PARAMETERS) == DRIFT, 0.0, known.sd))
        start = np.where(known.sd > 0, found.parameters, known.mean)
        found = up_to(fit_ratios(points.points, known, start), most)
    if chosen == "all" and np.any(np.abs(found.parameters[0, SENSES + 1 :]) > _DRIFTS):
        size, u = np.abs(found.parameters[0]), np.sqrt(np.diagonal(found.covariance[0]))
        shown = (size > known.sd) & (u < _SHOWN * known.sd) & (np.arange(N_PARAMETERS) >= SENSES)
        known, drifting = (Prior(one.mean, np.where(shown, size, one.sd)) for one in (known, drifting))
        points = at_mean_times(points, found.parameters[:1])
        found = up_to(all_solutions(points.points, known), most)
    points, found = _beyond_first_order(points, found, _prior(chosen, known), most)
    if chosen == "all" and reference == "beat":
        points, found = _with_uneven_codes(points, found, known, most)
    points, found = _with_table_noise(points, found, _prior(chosen, known), most)
    fits: dict[Model, RatioFit] = {}
    for name, which in FREE.items():
        if name == chosen:
            fits[name] = found.take(slice(1))
        elif points.settings > 1 or name == "lock-in":
            prior = _prior(name, known)
            held = np.array([True, True, *which])
            fit = fit_ratios(points.points, prior, np.where(held, found.parameters[:1], prior.mean))
            if not fit.singular[0]:
                fits[name] = fit
    gain_time_u = np.sqrt(found.covariance[0, _GAIN_TIME, _GAIN_TIME])
    lasers: Sequence[LaserFit] = other.lasers if other else ()
    if other is not None and lasers:
        contradicted = bool(other.flags & RatesFlag.STATED_LIMITS_EXCEEDED)
    elif other is None and chosen == "all" and found.parameters[0, _GAIN_TIME] > _GAIN_SEEN * gain_time_u:
        starts = found.parameters[found.chi_square < found.chi_square[0] + POSSIBLE][:_STARTS]
        # what equation (1) took for uneven codes, wrong rates or statements may be another kind of backscatter
        benches = (receiver, None) if contradicted else (receiver,)
        for bench, noisy in product(benches, (gathered, points)):
            own = {name: getattr(noisy.points, name) for name in ("whitening", "third_weight")}
            every = replace(gathered, points=replace(gathered.points, **own))
            with suppress(NoFit):
                lasers = lasers_of_beat(every, starts, drifting, bench or BenchKnowledge())
                if scipy.special.chdtrc(max(lasers[0].degrees, 1), lasers[0].chi_square) > UNLIKELY:
                    points, contradicted = replace(points, uneven=noisy.uneven), contradicted and bench is None
                    break
    result = _result(points, fits, found, known, chosen, receiver, most, lasers)
    return replace(result, flags=result.flags | (RatesFlag.STATED_LIMITS_EXCEEDED if contradicted else 0))


def _beyond_first_order(points: Points, found: RatioFit, prior: Prior, most: float) -> tuple[Points, RatioFit]:
    """Points and minima, freed of what (1) leaves of the receiver."""
    # Of third-order distortion only where the third harmonic shows it: what misfits the ratios looks like it.
    data = points.points
    alone, alone_u = third_order_by_third_harmonic(found.parameters[:1], data)
    third_order_u = np.sqrt(found.covariance[0, 5, 5])
    shown = abs(alone) > _SEEN * alone_u and abs(found.parameters[0, 5]) > _SEEN * third_order_u
    u = np.sqrt(np.trace(points.covariance, axis1=-2, axis2=-1))
    for number in range(_PASSES):
        best = np.where(np.arange(N_PARAMETERS) == 5, shown * found.parameters[:1], found.parameters[:1])
        ratio, third = (left[0] for left in beyond_first_order(best, data))
        if number == 0 and not (shown or np.any(np.abs(ratio) > _NOTHING * u)):
            return points, found
        freed = replace(points, points=replace(data, ratio=data.ratio - ratio, third=data.third - third))
        found = fit_ratios(freed.points, prior, found.parameters)
    return freed, up_to(all_solutions(freed.points, prior), most)


_SEEN, _NOTHING, _PASSES, _MOST_PASSES = 5.0, 0.2, 4, 6


def _with_uneven_codes(points: Points, found: RatioFit, prior: Prior, most: float) -> tuple[Points, RatioFit]:
    """Points and minima, with what a converter's uneven codes make of third harmonics, and then of ratios."""
    # Codes that are uneven each by itself add to the third harmonic what changes with ratio and amplitude, which
    # no H explains; and to the real part of rho less than that, beside D.
    for _ in range(_PASSES):
        data = points.points
        seen = data.third_weight > 0
        left, u = (data.third - predicted(found.parameters[:1], data)[1])[..., seen], 1 / data.third_weight[seen]
        freedom = left.size - 1
        if freedom < 1 or scipy.special.chdtrc(freedom, float(np.sum((left / u) ** 2))) > UNLIKELY:
            break
        more = float(np.sum(left**2)) / freedom - float(np.mean(u**2))
        if prior.sd[5] == 0 or not _NO_CODES**2 < more < _OF_CODES**2:
            return points, found
        freer = replace(data, third_weight=data.third_weight / np.sqrt(1 + more * data.third_weight**2))
        points = replace(points, points=freer, uneven=math.hypot(points.uneven, math.sqrt(more)))
        found = up_to(all_solutions(points.points, prior), most)
    noisy, fit, more = points, found, 0.0
    for _ in range(_MOST_PASSES):
        degrees, chi_square = _degrees(fit, noisy, prior), float(fit.chi_square[0])
        by_chance = more == 0 and scipy.special.chdtrc(max(degrees, 1), chi_square) > UNLIKELY
        if by_chance or chi_square <= degrees or degrees < 1:
            break
        more += (chi_square / degrees - 1) * float(np.mean(noisy.covariance[:, 0, 0]))
        if not _NO_CODES**2 < more < max(points.uneven, _OF_RATIO) ** 2:
            return points, found
        noisy = with_noise(points, more * np.diag([1.0, _IMAGINARY]))
        fit = up_to(all_solutions(noisy.points, prior), most)
    return replace(noisy, uneven=math.hypot(points.uneven, math.sqrt(more))), fit


_NO_CODES, _OF_CODES, _OF_RATIO = 3e-5, 0.004, 0.0015
"""rms that is nothing, and that codes of eight bits add at most to a third harmonic and to a ratio."""

_IMAGINARY = 0.1  # variance of the imaginary part over that of the real one
_OF_ANOTHER_KIND = 3.0  # half width of what other backscatter may do where no laser fits, over (2 pi K WL/g)^2
_OF_ALL = 2.0  # half width of what codes do to the lock-in rate by all rates alike, where no record shows it

_HARDLY = 0.7  # share of its uncertainty beforehand that the gain time has left, if the records hardly show it
_MAYBE = 1.0  # standard uncertainties beyond which a drift of the lock-in rate may be there
_DRIFTS = 0.05  # drifts over a run, rad or relative, up to which the means of the visits lose nothing
_SHOWN = 0.3  # share of its uncertainty beforehand that a drift has left where the records show it
_ENOUGH = 0.3  # share of its degrees of freedom that a test about curves must have left


def _with_table_noise(points: Points, found: RatioFit, prior: Prior, most: float) -> tuple[Points, RatioFit]:
    """Points and minima, with what the beats say of the errors of the rates."""
    # Where the ratios do not fit with it either, something else moves the beats: then nothing changes.
    share = 0.0 if points.records.records.rate_of_beat else table_noise(points, found)
    if share == 0:
        return points, found
    noisy = with_rate_noise(points, share)
    with_noise = up_to(all_solutions(noisy.points, prior), most)
    degrees = _degrees(with_noise, noisy, prior)
    if degrees > 0 and scipy.special.chdtrc(degrees, with_noise.chi_square[0]) < UNLIKELY:
        return points, found
    return noisy, with_noise


def _prior(model: Model, known: Prior) -> Prior:
    """What is known before the fit of a model: only the model of everything makes use of it."""
    if model == "all":
        return known
    return Prior(np.zeros(N_PARAMETERS), np.where([True, True, *FREE[model]], np.inf, 0.0))


def _result(
    points: Points,
    fits: dict[Model, RatioFit],
    found: RatioFit,
    known: Prior,
    chosen: Model,
    receiver: BenchKnowledge | None,
    most: float,
    lasers: Sequence[LaserFit],
) -> RatesFit:
    records = points.records.records
    fit, prior = fits[chosen], _prior(chosen, known)
    degrees, height = _degrees(fit, points, prior), float(fit.chi_square[0])
    if lasers:
        degrees, height = lasers[0].degrees, lasers[0].chi_square
    chi_square, p_value, widen, freedom = _test(height, degrees, fit, points, lasers)
    covariance = polar_covariance(fit) * widen
    said = answer_of_lasers(lasers, widen, points.points.reference) if lasers else answer(found, widen, freedom)
    tested = left_over(points.points, prior, points.settings) > 0
    if not lasers and chosen == "all" and gain_time_is_open(fit, points.points, prior, points.settings):
        said = over_gain_times(said, found, points.points, prior, widen)
    mismatch = rate_mismatch(records, said.value, float(fit.parameters[0, DRIFT]))
    common, differ = _rates_differ(points.records, said, mismatch, bool(np.ptp(points.rate_group)))
    failed = p_value < UNLIKELY
    # a laser that fits says why beats are not those of the lock-in equation, if the rates fit it as well
    off = lasers[0].rates_off if lasers else np.full(1, np.inf)
    explained = not failed and bool(np.all(np.abs(off) < MISMATCH) and abs(np.median(off)) < FASTER_THAN_POSSIBLE)
    differ &= not explained
    if differ and (failed or not tested) and not records.rate_of_beat:
        # Where beats are not those of their rates, and the ratios do not fit either or test nothing, nobody knows
        # which of the two is right.
        rate, beat_rate = np.abs(points.points.rate), points.points.beat_rate / (1 + common)
        if points.points.reference == "beat":
            changed = rate / np.hypot(beat_rate, said.value)
        else:
            square = np.maximum((rate - said.value) * (rate + said.value), 1e-300)
            changed = beat_rate / np.sqrt(square)
        said = widened(said, float(np.abs(changed - 1).max()) / math.sqrt(3))
    said = widened(said, _OF_ALL * points.uneven / math.sqrt(3))
    if chosen == "all" and not lasers and fit.parameters[0, 3] > _GAIN_SEEN * np.sqrt(fit.covariance[0, 3, 3]):
        delay = 2 * math.pi * records.scale_factor * said.value * float(fit.parameters[0, 3])
        said = widened(said, _OF_ANOTHER_KIND * delay**2 / math.sqrt(3))
    us, fitted = np.sqrt(np.diagonal(covariance)), np.where([True, True, *FREE[chosen]], 1.0, np.nan)
    rates = np.abs(records.rate[records.locked])
    possible = rates[rates <= said.high]
    at_least = float(possible.max()) if possible.size else 0.0
    scale_factor, scale_factor_u = scale_factor_of_rates(records.scale_factor, points, fit)
    values = fit.parameters[0] * fitted
    # upper 95 % limit of T from the model that has it too, when the chosen one has not
    fuller: Model = "both" if chosen == "distortion" else "gain"
    limit = float("nan")
    if not FREE[chosen][1] and fuller in fits:
        limit = max(fits[fuller].parameters[0, 3], 0.0) + NORMAL_95 * np.sqrt(fits[fuller].covariance[0, 3, 3])
    result = RatesFit(
        lock_in_rate=max(said.value, at_least),
        lock_in_rate_u=said.u,
        lock_in_rate_low_95=max(said.low, at_least),
        lock_in_rate_high_95=max(said.high, at_least),
        alternatives=said.others,
        counted=_counted(chosen, points, receiver),
        backscatter_phase=float(np.arctan2(fit.parameters[0, 1], fit.parameters[0, 0])),
        backscatter_phase_u=float(us[1]),
        distortion=float(values[2]),
        distortion_u=float(us[2] * fitted[2]),
        gain_time=lasers[0].gain_time[0] if lasers else float(values[3]),
        gain_time_u=lasers[0].gain_time[1] if lasers else float(us[3] * fitted[3]),
        lasers=tuple(lasers),
        gain_time_limit=float(limit),
        lag_square=float(values[4]),
        lag_square_u=float(us[4] * fitted[4]),
        third_order=float(values[5]),
        third_order_u=float(us[5] * fitted[5]),
        phase_between_senses=float(values[SENSES]),
        phase_between_senses_u=float(us[SENSES] * fitted[SENSES]),
        phase_drift=float(values[SENSES + 1]),
        phase_drift_u=float(us[SENSES + 1] * fitted[SENSES + 1]),
        lock_in_drift=float(values[DRIFT]),
        lock_in_drift_u=float(us[DRIFT] * fitted[DRIFT]),
        scale_factor=scale_factor,
        scale_factor_u=scale_factor_u,
        covariance=covariance,
        model=chosen,
        models=tuple(
            ModelFit(
                name,
                float(np.hypot(*each.parameters[0, :2])),
                lock_in_u(each),
                float(each.chi_square[0]),
                _degrees(each, points, _prior(name, known)),
            )
            for name, each in fits.items()
        ),
        reference=points.points.reference,
        chi_square=chi_square,
        degrees_of_freedom=degrees,
        p_value=p_value,
        cost=lock_in_u(fit) / lock_in_u(fits.get("lock-in", fit)),
        left_out=leave_out(points, fit, prior),
        records=points.records,
        parameters=fit.parameters,
        at_least=at_least,
        flags=0,
        noise_model=records.noise_model + (UNEVEN if points.uneven else "") + (ENLARGED if widen > 1 else ""),
    )
    flags = rates_flags(result, records, tested=tested, explained=explained)
    return replace(result, flags=flags | (RatesFlag.RATE_AND_BEAT_DISAGREE if differ else 0))


def _test(
    chi_square: float, degrees: int, fit: RatioFit, points: Points, lasers: Sequence[LaserFit]
) -> tuple[float, float, float, int]:
    """Chi-square of the means, the smaller chance of it and of the scatter about them, and what follows."""
    # The last two: the factor by which the variances grow where chance does not explain it, and the degrees of
    # freedom of that factor, 0 where it is 1.
    # a drift that is hardly determined says nothing of single records
    steady, us = fit.parameters.copy(), np.sqrt(np.diagonal(fit.covariance[0]))
    if lasers:  # what equation (1) takes for drifts may be another kind of backscatter
        steady[0, SENSES:], us[SENSES:] = lasers[0].drifts
    steady[0, SENSES + 1 :] *= np.abs(steady[0, SENSES + 1 :]) > SIGNIFICANT * us[SENSES + 1 :]
    scatter = points.scatter(steady)
    if scatter[1] > 0 and float(scipy.special.chdtrc(scatter[1], scatter[0])) < UNLIKELY:
        # what (1) leaves out turns with the phases too: it follows a curve, noise does not
        curved = points.scatter(steady, turning=True)
        scatter = curved if curved[1] > _ENOUGH * scatter[1] else scatter
    tests = [(chi_square, degrees), scatter]
    chances = [float(scipy.special.chdtrc(n, value)) if n > 0 else float("nan") for value, n in tests]
    widen, freedom = 1.0, 0
    for (value, n), chance in zip(tests, chances, strict=True):
        if chance < UNLIKELY and value / n > widen:
            widen, freedom = value / n, n
    p_value = min((chance for chance in chances if not np.isnan(chance)), default=float("nan"))
    return chi_square, p_value, widen, freedom


def _degrees(fit: RatioFit, points: Points, prior: Prior) -> int:
    """Values less unknowns; an unknown that was known as well beforehand as it is now costs none."""
    known = np.isfinite(prior.sd) & (prior.sd > 0)
    kept = np.diagonal(fit.covariance[0])[known] / prior.sd[known] ** 2
    # what changes over a run is tested by its visits alone, if at all
    left = left_over(points.points, prior, points.rate_group.size) - int(np.sum(prior.sd[SENSES:] > 0))
    return left + round(float(np.minimum(kept, 1.0).sum()))


def gain_time_is_open(fit: RatioFit, data: RatioData, prior: Prior, settings: int) -> bool:
    """Whether so many settings leave the gain time, or the test of it, to what is known beforehand."""
    hardly_seen = fit.covariance[0, _GAIN_TIME, _GAIN_TIME] > (_HARDLY * prior.sd[_GAIN_TIME]) ** 2
    return bool(prior.sd[_GAIN_TIME] > 0 and (hardly_seen or left_over(data, prior, settings) <= 0))


def left_over(data: RatioData, prior: Prior, settings: int) -> int:
    """Two values of every setting and their third harmonics, less the unknowns that do not change over a run."""
    has_thirds = prior.sd[5] > 0 and np.any(data.third_weight > 0)
    return int((3 if has_thirds else 2) * settings - np.sum(prior.sd[:SENSES] > 0))


def _counted(chosen: Model, points: Points, receiver: BenchKnowledge | None) -> frozenset[str]:
    counted = {name for name, free in zip(COUNTED, FREE[chosen], strict=False) if free}
    nothing_of_third = not np.any(points.points.third_weight > 0)
    if receiver is not None and receiver.third_order_limit == 0 and nothing_of_third:
        counted -= {"third_order"}
    return frozenset(counted)


def _rates_differ(of: UsedRecords, said: RatesAnswer, mismatch: Floats, several: bool) -> tuple[float, bool]:
    """What all beats have in common against their rates, and whether some depart from theirs beside it."""
    # Beats that all depart alike show a wrong scale factor, others coupling without loss.
    rate = of.records.rate
    if np.any(of.records.usable & (np.abs(rate) <= said.value)):
        return 0.0, True
    common = mismatch_of_all(rate, said.value, said.u, mismatch) if several else 0.0
    return common, rates_differ(rate, said.value, said.u, mismatch, of.rate_u, common)


# --------------------
# What tests a fit over several rates: the fit without each rate, rates against beats, flags


UNLIKELY_LEFT_OUT = 0.001
SIGNIFICANT = 3.3
FREE_OF_DISTORTION = ("lock-in", "gain")
FREE_OF_GAIN = ("lock-in", "distortion")

DISTORTION_COST = 10.0
"""Distortion that costs more than this factor means rates too close together to tell it from lock-in."""

LOOSE = 0.3  # a lock-in rate with a larger relative uncertainty is not determined

MISFITS_BY_CHANCE = 0.05
EXPLAINED = 5.0  # third-order distortion of so many standard uncertainties is what the misfit of the records was


def leave_out(points: Points, fit: RatioFit, prior: Prior) -> WithoutOneRate:
    """The fit without each rate in turn, from the solution of all."""
    # A rate disagrees where chi-square falls by more without it than its own values explain: that takes all its
    # values together, with their covariance and that of the fit.
    data, group = points.points, points.rate_group
    n_groups = int(group.max()) + 1
    empty = np.empty(0)
    if n_groups < 2:
        return WithoutOneRate(empty, empty, empty, empty, empty)
    kept = (group != np.arange(n_groups)[:, np.newaxis]).astype(float)
    start, rest = np.repeat(fit.parameters, n_groups, axis=0), data.weighted(kept)
    # a rate that is wrong may have led the fit of all astray
    tried = [fit_ratios(rest, prior, each) for each in (start, with_distortion_alone(start, rest, prior))]
    better = np.flatnonzero(tried[1].chi_square < tried[0].chi_square)
    place = np.arange(n_groups)
    place[better] += n_groups
    others = RatioFit.joined(tried).take(place)
    along = fit.parameters[0, :2] / max(float(np.hypot(*fit.parameters[0, :2])), 1e-300)
    value = np.hypot(others.parameters[:, 0], others.parameters[:, 1])
    u = np.sqrt(np.einsum("i,bij,j->b", along, others.covariance[:, :2, :2], along))
    shift = (others.parameters[:, :2] - fit.parameters[0, :2]) @ along
    # The value of all is made of that of the others and of the rate left out, so variances subtract.
    gained = np.maximum(u**2 - lock_in_u(fit) ** 2, (1e-3 * u) ** 2)
    blank = np.where(others.singular, np.nan, 1.0)
    fall = fit.chi_square[0] - others.chi_square
    known = (data.third_weight > 0) & (prior.sd[5] > 0)
    values = np.array([2 * np.sum(group == g) + np.sum(known & (group == g)) for g in range(n_groups)])
    chance = scipy.special.chdtrc(values, np.maximum(fall, 0.0))
    rates = np.array([np.abs(data.rate[group == g]).mean() for g in range(n_groups)])
    return WithoutOneRate(
        rates,
        value * blank,
        u * blank,
        shift / np.sqrt(gained) * blank,
        np.minimum(chance * n_groups, 1.0) * blank,
    )


def scale_factor_of_rates(scale_factor: float, points: Points, fit: RatioFit) -> tuple[float, float]:
    """K that beats and rates given ask for, pulses per degree: f/W freed of lock-in by r of the fit."""
    # The uncertainty is that of the mean of all points, from their scatter; an error that all rates share is not
    # in it.
    data = points.points
    size = float(np.hypot(*fit.parameters[0, :2])) * (1 + fit.parameters[0, DRIFT] * data.when)
    base = np.abs(data.rate) if data.reference == "rate" else data.beat_rate
    x = np.minimum(size / base, 1.0 if data.reference == "rate" else np.inf)
    free = np.sqrt(np.maximum(1 - x**2, 1e-12)) if data.reference == "rate" else 1 / np.sqrt(1 + x**2)
    each = data.beat_rate * scale_factor / np.abs(data.rate) / free
    # what is not known of the lock-in rate weighs with its square over that of the rate
    weights = 1 / (1e-5 + (lock_in_u(fit) / size * x**2) ** 2) if np.all(size > 0) else np.ones_like(each)
    mean = float(np.average(each, weights=weights))
    if each.size < 2:
        return mean, float("nan")
    spread = float(np.sqrt(np.average((each - mean) ** 2, weights=weights) / (each.size - 1)))
    return mean, spread


def rates_flags(fit: RatesFit, records: RatioRecords, *, tested: bool, explained: bool) -> int:
    """Bits of `RatesFlag` of a result that has none yet; `explained`: a laser fits beats and ratios."""
    size, u = fit.lock_in_rate, fit.lock_in_rate_u
    plain = next((m.lock_in_rate_u for m in fit.models if m.model == "lock-in"), u)
    distorted = next((m.lock_in_rate_u for m in fit.models if m.model == "distortion"), u)
    rate, mismatch = fit.rate, fit.rate_mismatch
    no_beat_above = np.abs(rate[fit.locked]) > fit.lock_in_rate_high_95
    rate_u = fit.records.rate_u
    disagree = rates_differ(rate, size, u, mismatch, rate_u) or mismatch_of_all(rate, size, u, mismatch) != 0
    disagree = (disagree and not explained) or bool(np.any(inconsistent_rate(records, rate_u)))
    by_third_order = abs(fit.third_order) > EXPLAINED * fit.third_order_u
    misfits = sum(int(np.sum(block.misfit & fit.used[some])) for some, block in records.blocks())
    conditions = {
        RatesFlag.NOT_SIGNIFICANT: not size > SIGNIFICANT * u,
        RatesFlag.RATES_TOO_CLOSE: fit.model not in FREE_OF_DISTORTION and distorted > DISTORTION_COST * plain,
        RatesFlag.NOT_DETERMINED: u > LOOSE * size,
        RatesFlag.NOT_TESTED: not tested,
        RatesFlag.MISFIT: fit.p_value < UNLIKELY_LEFT_OUT,
        RatesFlag.ONE_RATE_DISAGREES: bool(np.any(fit.left_out.p_value < UNLIKELY_LEFT_OUT)) and not explained,
        RatesFlag.ONE_SENSE: bool(np.any(rate > 0, where=fit.used) != np.any(rate < 0, where=fit.used)),
        RatesFlag.GAIN_CORNER_ASSUMED_HIGH: fit.model in FREE_OF_GAIN,
        RatesFlag.LOCKED_RECORDS: fit.at_least > 0,
        RatesFlag.NO_BEAT_ABOVE_LOCK_IN: bool(np.any(no_beat_above)),
        RatesFlag.RECORDS_LEFT_OUT: not bool(np.all(fit.used | fit.locked)),
        RatesFlag.RATE_AND_BEAT_DISAGREE: disagree,
        RatesFlag.RATE_BELOW_LOCK_IN: bool(np.any(np.abs(rate) <= size, where=fit.used)),
        RatesFlag.SEVERAL_SOLUTIONS: bool(fit.alternatives),
        RatesFlag.RECORDS_MISFIT: misfits > max(2, MISFITS_BY_CHANCE * fit.used.sum()) and not by_third_order,
    }
    return int(sum(bit for bit, raised in conditions.items() if raised))


# --------------------
# The answer over every gain time that is possible, where few rates leave it to its bound.
#
# A bench may lie far along the bent valley from where priors, bells about zero, put the minimum: at every gain
# time the rest is fitted, and what these fits give is averaged over the bound


_GAIN_TIME, _GAIN_SEEN = 3, 3.3  # standard uncertainties of a gain time that is no chance
_STARTS = 3  # minima from which lasers are looked for
_OF_THE_BOUND = np.concatenate([np.linspace(0.0, 1.0, 15), [1.02, 1.05, 1.1]])
_ABOUT_A_MINIMUM = np.linspace(-4.0, 4.0, 17)
_SAME_SHARE, _SAME_U, _ENDS = 1e-3, 0.5, 50.0


def over_gain_times(
    said: RatesAnswer, found: RatioFit, data: RatioData, prior: Prior, widen: float
) -> RatesAnswer:
    """What any gain time within its bound may make of the answer; the interval holds that of none as well."""
    mean, sd = prior.mean[_GAIN_TIME], prior.sd[_GAIN_TIME]
    beforehand = mean + sd * _ABOUT_A_MINIMUM if mean > 0 else math.sqrt(3) * sd * _OF_THE_BOUND
    us = np.sqrt(found.covariance[:, _GAIN_TIME, _GAIN_TIME] * widen)
    closer = found.parameters[:, _GAIN_TIME, np.newaxis] + us[:, np.newaxis] * _ABOUT_A_MINIMUM
    times = np.unique(np.concatenate([beforehand, closer.ravel()]))
    times = times[times >= 0]
    held = np.arange(N_PARAMETERS) == _GAIN_TIME
    rest = Prior(np.where(held, 0.0, prior.mean), np.where(held, 0.0, prior.sd))
    starts = np.repeat(found.parameters, times.size, axis=0)
    starts[:, _GAIN_TIME] = np.tile(times, len(found.parameters))
    starts = np.concatenate([starts, with_distortion_alone(starts, data, rest)])
    fits = fit_ratios(data, rest, starts)
    z = (fits.parameters[:, 0] + 1j * fits.parameters[:, 1]).reshape(-1, times.size)
    reach = _SAME_U * np.sqrt(np.trace(fits.covariance[:, :2, :2], axis1=-2, axis2=-1)).reshape(z.shape)
    height = fits.chi_square.reshape(z.shape)
    order = np.argsort(height, axis=0, kind="stable")
    z, reach = (np.take_along_axis(each, order, axis=0) for each in (z, reach))
    new = np.ones(z.shape, dtype=bool)
    for row in range(1, len(z)):
        close = np.abs(z[:row] - z[row]) < _SAME_SHARE * np.abs(z[row]) + reach[row]
        new[row] = ~np.any(close & new[:row], axis=0)
    different = np.empty_like(new)
    np.put_along_axis(different, order, new, axis=0)
    kept = np.flatnonzero(different.ravel())
    fits, at = fits.take(kept), kept % times.size
    heights = 0.5 * (fits.chi_square - fits.chi_square.min()) / widen
    # a bound ends much sooner than a bell
    beyond = times - mean if mean > 0 else _ENDS * np.maximum(times - math.sqrt(3) * sd, 0.0)
    widths = np.diff(np.concatenate([times[:1], (times[1:] + times[:-1]) / 2, times[-1:]]))
    weights = (widths * np.exp(-0.5 * (beyond / sd) ** 2))[at] * minimum_volumes(fits) * np.exp(-heights)
    values, us = np.hypot(fits.parameters[:, 0], fits.parameters[:, 1]), size_us(fits) * math.sqrt(widen)
    _, _, low, high = of_bells(values, us, weights)
    low, high = min(said.low, max(low, 0.0)), max(said.high, high)
    if np.ptp(np.abs(data.rate)) > SAME_RATE * np.abs(data.rate).max():
        # there may be no gain time to speak of, as `said` takes it, or any within the bound: both count half
        square = float(np.average(us**2 + (values - said.value) ** 2, weights=weights))
        return replace(said, u=math.sqrt((said.u**2 + square) / 2), low=low, high=high)
    # one rate says nothing of it: the mean of this solution; others count in u and in the interval
    nearest = np.abs(np.subtract.outer([said.value, *(one.lock_in_rate for one in said.others)], values))
    value = float(np.average(values, weights=weights * (nearest.argmin(axis=0) == 0) + 1e-300))
    u = math.sqrt(float(np.average(us**2 + (values - value) ** 2, weights=weights)))
    return replace(said, value=value, u=u, low=low, high=high)


# --------------------
# Rates that are wrong, each in its own way: how far beats and rates of several points depart from each other.
#
# With the rate as reference an error of a rate goes into the lock-in rate, and no ratio shows it: in both senses
# at 1.2, 2 and 4 WL a table that misses every rate by 0.1 % makes four times what the noise of the ratios does.
# The beats show it. A share d of a rate, and a share e of the lock-in rate, move the beat by
#
#     f/(K sqrt(W^2 - WL^2)) - 1 = common + (d W^2 + e WL^2)/(W^2 - WL^2)
#
# so what is left of the beats beside a factor of all of them (scale factor, tilt), and beside what is not known of
# WL, is the error of the rates


UNLIKELY_TABLE = 0.001
MATTERS = 0.3
"""Table noise below this share of the relative u of the lock-in rate is left alone: it adds 5 % at most."""

_LEAST_U = 1e-5  # of a beat over its rate: what the motion of any table leaves in a mean over a record


def table_noise(points: Points, fit: RatioFit) -> float:
    """Relative standard uncertainty of the rates of the points, beyond what was stated, as their beats show it."""
    # 0 where that is chance or does not matter. 0 as well where it is more than `MISMATCH`: no table is that bad,
    # some rate is another one, or coupling moves the beats; the tests of the fit then say which. From few points
    # it is larger, by Student's factor.
    data, records = points.points, points.records
    mean, rate = float(np.hypot(*fit.parameters[0, :2])), np.abs(data.rate)
    freedom, size = rate.size - 1, mean * (1 + fit.parameters[0, DRIFT] * data.when)
    if data.reference != "rate" or freedom < 1 or not (mean > 0 and np.all((size > 0) & (size < rate.min()))):
        return 0.0
    square, known = (size / rate) ** 2, lock_in_u(fit) / mean
    seen = (data.beat_rate / np.sqrt((rate - size) * (rate + size)) - 1) * (1 - square)
    u = math.hypot(_LEAST_U, float(np.max((records.rate_u / np.abs(records.records.rate))[records.used])))
    columns = np.stack([1 - square, square], axis=-1) / u
    # that WL is known from the ratios is one more value
    white = np.concatenate([columns, [[0.0, 1 / known]]])
    aim = np.append(seen / u, 0.0)
    found = np.linalg.lstsq(white, aim, rcond=None)[0]
    left = float(np.sum((aim - white @ found) ** 2))
    if scipy.special.chdtrc(freedom, left) > UNLIKELY_TABLE:
        return 0.0
    share = u * math.sqrt(left / freedom - 1)
    if not MATTERS * known < share < MISMATCH:
        return 0.0
    return share * float(scipy.special.stdtrit(freedom, 0.975)) / NORMAL_95
