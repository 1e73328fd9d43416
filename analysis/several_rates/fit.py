"""Lock-in rate from records at several rates and in both senses, free of what one record cannot show.

The lock-in part of the harmonic ratio falls with the rate and turns round with the sense; second-order distortion
of the receiver does neither, and the finite speed of the laser's gain turns it in phase. Records at several rates
tell the three apart (equation (1) of `ratio_model`, derived in docs/several_rates.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Complexes, Floats, Indices
from analysis.errors import NoFit
from analysis.lockin_rate import LockInEstimate, size_interval
from analysis.several_rates.ratio_model import (
    RatioData,
    RatioFit,
    Reference,
    fit_ratios,
    predicted_ratio,
    whitening_factor,
)
from analysis.several_rates.ratio_records import (
    SMALLEST_U,
    RatioRecords,
    inconsistent_rate,
    records_of_arrays,
    records_of_estimates,
)
from analysis.several_rates.result import Model, ModelFit, RatesFit, RatesFlag, WithoutOneRate

FREE: dict[Model, tuple[bool, bool]] = {
    "lock-in": (False, False),
    "distortion": (True, False),
    "gain": (False, True),
    "both": (True, True),
}
"""Which of distortion and gain time each model fits."""

MORE_RECORDS = "take the other sense of rotation as well, or rates that differ by a factor of two and more"

ENLARGED = "; enlarged to the scatter between records, which is more than that noise explains"
UNLIKELY = 0.001
SIGNIFICANT = 3.3
GAIN_COST = 2.0
"""A gain corner that the data do not show is fitted all the same if it costs no more than this in uncertainty."""

DISTORTION_COST = 10.0
"""Distortion that costs more than this factor means rates too close together to tell it from lock-in."""

LOOSE = 0.3
"""A lock-in rate with a larger relative uncertainty is not determined."""

SAME_RATE = 0.01
MISMATCH = 0.005
"""A rate that misses the one of the beat by more is worth a flag: it goes 1:1 into the lock-in rate."""


def fit_rates(
    estimates: LockInEstimate | Sequence[LockInEstimate],
    *,
    input_rate: ArrayLike | None = None,
    input_rate_u: ArrayLike = 0.0,
    reference: Reference = "rate",
    model: Model | Literal["auto"] = "auto",
) -> RatesFit:
    """Lock-in rate, distortion of the receiver and gain corner of the laser from records at several rates.

    Two rates, or one rate in both senses, determine lock-in rate and distortion; more test them. The gain corner
    comes out where the rates reach it.

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
    model : {"auto", "lock-in", "distortion", "gain", "both"}
        What is fitted beside the lock-in rate. "auto": distortion always; the gain corner too, unless the data
        neither show it nor can pay for it (`GAIN_COST`).

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
    records = records_of_estimates(estimates, input_rate)
    return _fit(records, np.asarray(input_rate_u, dtype=np.float64), reference, model)


def fit_rate_ratios(
    input_rate: ArrayLike,
    ratio: ArrayLike,
    covariance: ArrayLike,
    beat_frequency: ArrayLike,
    *,
    scale_factor: float,
    beat_frequency_u: ArrayLike = 0.0,
    amplitude: ArrayLike = 1.0,
    input_rate_u: ArrayLike = 0.0,
    reference: Reference = "rate",
    model: Model | Literal["auto"] = "auto",
) -> RatesFit:
    """`fit_rates` on plain arrays of n records.

    Parameters
    ----------
    input_rate : (n,)
        deg/s, signed.
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
    input_rate_u, reference, model
        As in `fit_rates`.
    """
    records = records_of_arrays(
        input_rate,
        ratio,
        covariance,
        beat_frequency,
        scale_factor=scale_factor,
        beat_frequency_u=beat_frequency_u,
        amplitude=amplitude,
    )
    return _fit(records, np.asarray(input_rate_u, dtype=np.float64), reference, model)


def _fit(records: RatioRecords, rate_u: Floats, reference: Reference, model: Model | Literal["auto"]) -> RatesFit:
    if reference not in ("rate", "beat"):
        raise ValueError(f"reference {reference!r} is neither 'rate' nor 'beat'")
    if model != "auto" and model not in FREE:
        raise ValueError(f"model {model!r} is none of 'auto', {', '.join(map(repr, FREE))}")
    used = records.usable.copy()
    if reference == "rate":
        used &= ~inconsistent_rate(records)
    if not used.any():
        raise NoFit("no record with a usable beat: nothing can be fitted")
    data = _data(records, used, rate_u, reference)
    # Two points of rate and sense are the least that tells anything from lock-in, however many records there are.
    points = len(set(zip(rate_groups(data.rate), np.sign(data.rate), strict=True)))
    possible: list[Model] = list(FREE) if points > 1 else ["lock-in"]
    fits = {name: fit for name in possible if not (fit := fit_ratios(data, FREE[name])).singular[0]}
    chosen = _choose(fits, model)
    return _result(records, used, data, fits, chosen)


def _data(records: RatioRecords, used: Bools, rate_u: Floats, reference: Reference) -> RatioData:
    if not np.all(np.isfinite(rate_u)) or np.any(rate_u < 0):
        raise ValueError("input_rate_u must be finite and not negative (deg/s)")
    rate, frequency, ratio = records.rate[used], records.beat_frequency[used], records.ratio[used]
    if reference == "rate":
        relative = np.broadcast_to(rate_u, records.rate.shape)[used] / np.abs(rate)
    else:
        relative = records.beat_frequency_u[used] / frequency
    along = np.stack([ratio.real, ratio.imag], axis=-1) * relative[:, np.newaxis]
    covariance = records.covariance[used] + along[:, :, np.newaxis] * along[:, np.newaxis, :]
    covariance = covariance + SMALLEST_U**2 * np.eye(2)
    return RatioData(
        rate=rate,
        beat_rate=frequency / records.scale_factor,
        angular=2 * np.pi * frequency,
        ratio=ratio,
        whitening=whitening_factor(covariance)[np.newaxis],
        amplitude=records.amplitude[used],
        reference=reference,
    )


def _choose(fits: dict[Model, RatioFit], model: Model | Literal["auto"]) -> Model:
    if model != "auto":
        if model not in fits:
            raise NoFit(f"these records cannot tell the unknowns of the model {model!r} apart: {MORE_RECORDS}")
        return model
    if "distortion" not in fits:
        raise NoFit(f"these records cannot tell distortion of the receiver from lock-in: {MORE_RECORDS}")
    if "both" not in fits:
        return "distortion"
    gain_time, u = fits["both"].parameters[0, 3], np.sqrt(fits["both"].covariance[0, 3, 3])
    cost = _lock_in_u(fits["both"]) / _lock_in_u(fits["distortion"])
    return "both" if abs(gain_time) > SIGNIFICANT * u or cost <= GAIN_COST else "distortion"


def _result(
    records: RatioRecords, used: Bools, data: RatioData, fits: dict[Model, RatioFit], chosen: Model
) -> RatesFit:
    fit, degrees = fits[chosen], _degrees(chosen, used)
    chi_square, p_value, widen = _test(fit, degrees)
    covariance = _polar_covariance(fit) * widen
    value, low, high = _lock_in_rate(fit, widen, degrees if widen > 1 else 0)
    us, fitted = np.sqrt(np.diagonal(covariance)), np.where([True, True, *FREE[chosen]], 1.0, np.nan)
    at_least = _at_least(records, high)
    left, deviation = _residuals(fit, data, used)
    result = RatesFit(
        lock_in_rate=max(value, at_least),
        lock_in_rate_u=float(us[0]),
        lock_in_rate_low_95=max(low, at_least),
        lock_in_rate_high_95=max(high, at_least),
        backscatter_phase=float(np.arctan2(fit.parameters[0, 1], fit.parameters[0, 0])),
        backscatter_phase_u=float(us[1]),
        distortion=float(fit.parameters[0, 2] * fitted[2]),
        distortion_u=float(us[2] * fitted[2]),
        gain_time=float(fit.parameters[0, 3] * fitted[3]),
        gain_time_u=float(us[3] * fitted[3]),
        gain_time_limit=_gain_time_limit(fits, chosen),
        covariance=covariance,
        model=chosen,
        models=tuple(_model_fit(name, each, used) for name, each in fits.items()),
        reference=data.reference,
        chi_square=chi_square,
        degrees_of_freedom=degrees,
        p_value=p_value,
        cost=_lock_in_u(fit) / _lock_in_u(fits.get("lock-in", fit)),
        left_out=_leave_out(data, fit, chosen),
        rate=records.rate,
        ratio=records.ratio,
        residual=left,
        deviation=deviation,
        used=used,
        locked=records.locked,
        rate_mismatch=_rate_mismatch(records, value),
        at_least=at_least,
        flags=0,
        noise_model=records.noise_model + (ENLARGED if widen > 1 else ""),
    )
    return replace(result, flags=_flags(result, inconsistent_rate(records)))


def _test(fit: RatioFit, degrees: int) -> tuple[float, float, float]:
    """Chi-square, its probability, and the factor by which the variances grow where chance does not explain it."""
    chi_square = float(fit.chi_square[0])
    if degrees == 0:
        return chi_square, float("nan"), 1.0
    p_value = float(scipy.special.chdtrc(degrees, chi_square))
    return chi_square, p_value, chi_square / degrees if p_value < UNLIKELY else 1.0


def _degrees(model: Model, used: Bools) -> int:
    return 2 * int(used.sum()) - 2 - sum(FREE[model])


def _lock_in_u(fit: RatioFit) -> float:
    """Standard uncertainty of |z|; where z is near 0, of its larger part."""
    return float(np.sqrt(_polar_covariance(fit)[0, 0]))


def _polar_covariance(fit: RatioFit) -> Floats:
    """Covariance (4, 4) of |z|, its angle, D and T."""
    x, y = fit.parameters[0, :2]
    size = max(float(np.hypot(x, y)), 1e-300)
    turn = np.eye(4)
    turn[0, :2], turn[1, :2] = (x / size, y / size), (-y / size**2, x / size**2)
    return np.asarray(turn @ fit.covariance[0] @ turn.T)


def _lock_in_rate(fit: RatioFit, widen: float, degrees: int) -> tuple[float, float, float]:
    """Value freed of the bias that noise gives to the size of a complex number, and its 95 % interval."""
    covariance = _polar_covariance(fit) * widen
    size = float(np.hypot(*fit.parameters[0, :2]))
    across = size**2 * float(covariance[1, 1])
    student = float(scipy.special.stdtrit(degrees, 0.975)) / 1.96 if degrees else 1.0
    wide = float(np.sqrt(covariance[0, 0])) * student
    low, high = size_interval(size / wide)
    return float(np.sqrt(max(size**2 - across, 0.0))), float(low) * wide, float(high) * wide


def _model_fit(model: Model, fit: RatioFit, used: Bools) -> ModelFit:
    value = float(np.hypot(*fit.parameters[0, :2]))
    return ModelFit(model, value, _lock_in_u(fit), float(fit.chi_square[0]), _degrees(model, used))


def _gain_time_limit(fits: dict[Model, RatioFit], chosen: Model) -> float:
    """Upper 95 % limit of T from the model that has it too, when the chosen one has not."""
    fuller: Model = "both" if chosen == "distortion" else "gain"
    if FREE[chosen][1] or fuller not in fits:
        return float("nan")
    return float(max(fits[fuller].parameters[0, 3], 0.0) + 1.96 * np.sqrt(fits[fuller].covariance[0, 3, 3]))


def _residuals(fit: RatioFit, data: RatioData, used: Bools) -> tuple[Complexes, Floats]:
    left = (data.ratio - predicted_ratio(fit.parameters, data))[0]
    parts = np.stack([left.real, left.imag], axis=-1)
    white = np.einsum("nji,nj->ni", data.whitening[0], parts)
    residual, deviation = np.full(used.shape, np.nan, dtype=complex), np.full(used.shape, np.nan)
    residual[used], deviation[used] = left, np.hypot(white[:, 0], white[:, 1])
    return residual, deviation


def rate_groups(rate: Floats) -> Indices:
    """Which of the different |W| each rate belongs to, 0, 1, ...; |W| within 1 % count as one rate."""
    order = np.argsort(np.abs(rate))
    size = np.abs(rate)[order]
    group = np.empty(rate.size, dtype=np.intp)
    group[order] = np.concatenate([[0], np.cumsum(np.diff(size) > SAME_RATE * size[1:])])
    return group


def _leave_out(data: RatioData, fit: RatioFit, chosen: Model) -> WithoutOneRate:
    group = rate_groups(data.rate)
    n_groups = int(group.max()) + 1
    empty = np.empty(0)
    if n_groups < 2:
        return WithoutOneRate(empty, empty, empty, empty)
    kept = (group != np.arange(n_groups)[:, np.newaxis]).astype(float)
    others = fit_ratios(data.weighted(kept), FREE[chosen], np.repeat(fit.parameters, n_groups, axis=0))
    along = fit.parameters[0, :2] / max(float(np.hypot(*fit.parameters[0, :2])), 1e-300)
    value = np.hypot(others.parameters[:, 0], others.parameters[:, 1])
    u = np.sqrt(np.einsum("i,bij,j->b", along, others.covariance[:, :2, :2], along))
    shift = (others.parameters[:, :2] - fit.parameters[0, :2]) @ along
    # The value of all is made of that of the others and of the rate left out, so variances subtract.
    gained = np.maximum(u**2 - _lock_in_u(fit) ** 2, (1e-3 * u) ** 2)
    blank = np.where(others.singular, np.nan, 1.0)
    rates = np.array([np.abs(data.rate[group == g]).mean() for g in range(n_groups)])
    return WithoutOneRate(rates, value * blank, u * blank, shift / np.sqrt(gained) * blank)


def _at_least(records: RatioRecords, high: float) -> float:
    """Fastest rate without a beat that is possible within the interval."""
    rates = np.abs(records.rate[records.locked])
    possible = rates[rates <= high]
    return float(possible.max()) if possible.size else 0.0


def _rate_mismatch(records: RatioRecords, lock_in_rate: float) -> Floats:
    rate = np.abs(records.rate)
    square = (rate - lock_in_rate) * (rate + lock_in_rate)
    known = records.usable & (square > 0)
    mismatch = np.full(rate.shape, np.nan)
    expected = records.scale_factor * np.sqrt(square[known])
    mismatch[known] = records.beat_frequency[known] / expected - 1
    return mismatch


def _flags(fit: RatesFit, inconsistent: Bools) -> int:
    size, u = fit.lock_in_rate, fit.lock_in_rate_u
    plain = next((m.lock_in_rate_u for m in fit.models if m.model == "lock-in"), u)
    distorted = next((m.lock_in_rate_u for m in fit.models if m.model == "distortion"), u)
    rate = np.abs(fit.rate)
    with np.errstate(over="ignore"):
        stretch = size**2 / np.maximum(rate**2 - size**2, 1e-300) * (u / size if size else 0.0)
    differ = np.abs(fit.rate_mismatch) > MISMATCH + 3 * stretch
    no_beat_above = fit.locked & (rate > fit.lock_in_rate_high_95)
    disagree = np.abs(fit.left_out.deviation) > SIGNIFICANT
    conditions = {
        RatesFlag.NOT_SIGNIFICANT: not size > SIGNIFICANT * u,
        RatesFlag.RATES_TOO_CLOSE: FREE[fit.model][0] and distorted > DISTORTION_COST * plain,
        RatesFlag.NOT_DETERMINED: u > LOOSE * size,
        RatesFlag.NOT_TESTED: fit.degrees_of_freedom == 0,
        RatesFlag.MISFIT: fit.p_value < UNLIKELY,
        RatesFlag.ONE_RATE_DISAGREES: bool(np.any(disagree)),
        RatesFlag.ONE_SENSE: len(set(np.sign(fit.rate[fit.used]))) == 1,
        RatesFlag.GAIN_CORNER_ASSUMED_HIGH: not FREE[fit.model][1],
        RatesFlag.LOCKED_RECORDS: fit.at_least > 0,
        RatesFlag.NO_BEAT_ABOVE_LOCK_IN: bool(np.any(no_beat_above)),
        RatesFlag.RECORDS_LEFT_OUT: not bool(np.all(fit.used | fit.locked)),
        RatesFlag.RATE_AND_BEAT_DISAGREE: bool(np.any(differ | inconsistent)),
        RatesFlag.RATE_BELOW_LOCK_IN: bool(np.any(fit.used & (rate <= size))),
    }
    return int(sum(bit for bit, raised in conditions.items() if raised))
