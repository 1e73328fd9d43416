"""Lock-in rate of a ring laser gyro from single records: the harmonic ratio, inverted exactly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.damage import find_damage, outliers
from analysis.flags import FATAL, Flag
from analysis.geometric_series import Series, fit_series, sampled_series
from analysis.lockin_equation import Relation, input_rate_from_beat, lock_in_from_beat, lock_in_from_rate
from analysis.periodic_fit import Step
from analysis.ratio_interval import size_interval
from analysis.records import Records, as_records
from analysis.residuals import ResidualReport, examine_residual

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

FEWEST_PERIODS = 3.0
N_PARAMETERS = 6
WHITE = "white noise of the size that the fit leaves, in each record"
COLOURED = "noise of the strength that the fit leaves near the fundamental and the second harmonic"


@dataclass(frozen=True)
class LockInEstimate:
    """Estimates of one or many records; every array has the leading shape of the records.

    lock_in_rate, lock_in_rate_u : deg/s, and its standard uncertainty
    lock_in_rate_low_95, lock_in_rate_high_95 : deg/s, 95 % interval; not symmetric, and it begins at 0 where the
        second harmonic does not stand out of the noise
    input_rate : deg/s, as given (signed), or from the record itself: W = (f/K)(1 + r^2)/(1 - r^2)
    beat_frequency, beat_frequency_u : Hz
    ratio, ratio_u : r = A2/A1, freed of the bias that noise gives to the size of a small complex number
    complex_ratio : rho = c2 |c1| / c1^2, independent of the time origin
    complex_ratio_covariance : (..., 2, 2) of its real and imaginary part
    backscatter_phase : rad, beta less the readout phase
    amplitude, noise_rms : volts, A of A sin(phi), and the standard deviation of what the fit leaves
    periods : beat periods in the record
    records, records_rejected : how many records the value rests on, and how many could not be used
    flags : bits of `Flag`
    noise_model : what the uncertainties rest on, in words
    """

    lock_in_rate: Floats
    lock_in_rate_u: Floats
    lock_in_rate_low_95: Floats
    lock_in_rate_high_95: Floats
    input_rate: Floats
    beat_frequency: Floats
    beat_frequency_u: Floats
    ratio: Floats
    ratio_u: Floats
    complex_ratio: Complexes
    complex_ratio_covariance: Floats
    backscatter_phase: Floats
    amplitude: Floats
    noise_rms: Floats
    periods: Floats
    records: NDArray[np.int64]
    records_rejected: NDArray[np.int64]
    flags: NDArray[np.uint32]
    scale_factor: float
    relation: Relation
    rate_given: bool
    noise_model: str

    def __getitem__(self, key: object) -> LockInEstimate:
        """Some of the records; indexes the leading axes of every field."""
        picked = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in picked.items():
            if isinstance(value, np.ndarray):
                picked[name] = np.asarray(value[key])
        return LockInEstimate(**picked)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Where a lock-in rate could be given at all."""
        return np.asarray((self.flags & np.uint32(FATAL)) == 0)


def estimate_lock_in(
    volts: ArrayLike,
    sample_interval: float,
    *,
    scale_factor: float,
    input_rate: ArrayLike | None = None,
    relation: Relation = "exact",
    clipped: ArrayLike | None = None,
) -> LockInEstimate:
    """Lock-in rate from each record of the beat.

    The whole waveform is fitted by maximum likelihood (`geometric_series`), which gives r = A2/A1 and f; then
    WL = |W| 2r/(1 + r^2) with the rate given, or WL = (f/K) 2r/(1 - r^2) without, where neither table rate nor
    tilt nor earth rate enters.

    Parameters
    ----------
    volts : (..., n_samples)
        nan marks a missing sample. Clipped samples are found by themselves where they are many.
    sample_interval : float
        Seconds.
    scale_factor : float
        K, pulses per degree.
    input_rate : (...), optional
        W, deg/s, signed. Without it the record is its own reference.
    relation : {"exact", "paper-13", "paper-10"}
        The paper's approximations serve for comparison. Without a given rate they use W = f/K for (10) and
        the exact W of the record for (13).
    clipped : (..., n_samples) of bool, optional
        Samples known to stand at the end of the converter's range.

    Returns
    -------
    LockInEstimate
        nan with a fatal flag where a lock-in rate would mean nothing.

    Raises
    ------
    ValueError
        Fewer than 8 samples, wrong shapes, infinite values, interval or scale factor not positive, unknown
        relation.
    """
    if not np.isfinite(scale_factor) or scale_factor <= 0:
        raise ValueError(f"scale_factor must be positive (pulses per degree), not {scale_factor!r}")
    lock_in_from_rate(0.0, 1.0, relation)  # an unknown relation is an error before any work is done
    records = as_records(volts, sample_interval)
    rate = _given_rate(input_rate, records)
    parts = []
    for part in records.parts(np.ones(len(records.values), dtype=bool)):
        given = None if clipped is None else _mask_rows(clipped, records, part)
        parts.append(_fit_part(records, part, given))
    fit = _Fit.joined(parts)
    return _estimate(fit, records, sample_interval, scale_factor, rate, relation)


def _given_rate(input_rate: ArrayLike | None, records: Records) -> Floats | None:
    if input_rate is None:
        return None
    rate = np.broadcast_to(np.asarray(input_rate, dtype=np.float64), records.shape).ravel()
    if not np.all(np.isfinite(rate)):
        raise ValueError("input_rate must be finite (deg/s)")
    return rate


def _mask_rows(mask: ArrayLike, records: Records, part: NDArray[np.intp]) -> NDArray[np.bool_]:
    full = (*records.shape, records.n_samples)
    return np.asarray(np.broadcast_to(np.asarray(mask, dtype=bool), full).reshape(-1, records.n_samples)[part])


@dataclass(frozen=True)
class _Fit:
    """Fit of a stack of records in volts: parameters, covariance for their own noise, flags."""

    series: Series
    covariance: Floats
    noise_rms: Floats
    excess: Floats
    flags: NDArray[np.uint32]

    @staticmethod
    def joined(parts: list[_Fit]) -> _Fit:
        join = np.concatenate
        series = Series(*(join([getattr(p.series, f.name) for p in parts]) for f in fields(Series)))
        return _Fit(series, *(join([getattr(p, f.name) for p in parts]) for f in fields(_Fit)[1:]))


def _fit_part(records: Records, part: NDArray[np.intp], clipped: NDArray[np.bool_] | None) -> _Fit:
    values, weights = records.take(part)
    damage = find_damage(values, weights, clipped)
    flags = damage.flags.copy()
    series, step, weights = _fit_undamaged(values, weights, damage.weights, damage.limits)
    left = values - sampled_series(series, records.n_samples)
    spikes = outliers(left, weights)
    if spikes.any():
        weights = (np.ones_like(values) if weights is None else weights) * ~spikes
        hit = spikes.any(axis=-1)
        again, new_step = fit_series(values[hit], weights[hit])
        series.put(hit, again)
        step.put(hit, new_step)
        left = values - sampled_series(series, records.n_samples)
        flags[hit] |= Flag.DAMAGED
    if weights is not None:
        left = left * weights
    count = np.full(len(part), float(records.n_samples)) if weights is None else weights.sum(axis=-1)
    degrees = np.maximum(count - N_PARAMETERS, 1)
    variance = step.residual_power / degrees
    report: ResidualReport = examine_residual(left, count, series.omega, np.abs(series.first), step.residual_power)
    flags |= report.flags
    flags[records.constant[part]] = Flag.CONSTANT
    flags[(records.count[part] < 8) | (count < 12)] |= Flag.TOO_FEW_SAMPLES
    scale = records.scale[part]
    return _Fit(
        Series(series.offset * scale, series.first * scale, series.ratio, series.omega),
        step.covariance() * variance[:, np.newaxis, np.newaxis],
        np.sqrt(variance) * scale,
        report.excess,
        flags,
    )


def _fit_undamaged(
    values: Floats, weights: Floats | None, without_damage: Floats | None, limits: Floats | None
) -> tuple[Series, Step, Floats | None]:
    """Fit; near a clipping limit, samples are left out by what the model says of them, not by their own noise."""
    if without_damage is None or limits is None:
        series, step = fit_series(values, weights)
        return series, step, weights
    series, step = fit_series(values * without_damage, without_damage)
    kept = without_damage
    for _ in range(2):
        model = sampled_series(series, values.shape[1])
        noise = np.sqrt(step.residual_power / np.maximum(kept.sum(axis=-1) - N_PARAMETERS, 1))
        margin = 4 * noise[:, np.newaxis]
        inside = (model > limits[:, :1] + margin) & (model < limits[:, 1:] - margin)
        kept = inside * (1.0 if weights is None else weights)
        kept = np.where(kept.sum(axis=-1, keepdims=True) < 0.2 * values.shape[1], without_damage, kept)
        series, step = fit_series(values * kept, kept)
    return series, step, kept


def _estimate(
    fit: _Fit,
    records: Records,
    sample_interval: float,
    scale_factor: float,
    rate: Floats | None,
    relation: Relation,
) -> LockInEstimate:
    n_samples, series = records.n_samples, fit.series
    with np.errstate(all="ignore"):
        frequency = series.omega / (2 * np.pi * sample_interval)
        first, q = series.first, series.ratio
        size = np.abs(q)
        u, jacobian = _frame(first, q, frequency, records, sample_interval)
        # Rows of the covariance: frequency, size of the ratio, its tangential part.
        # The scale of `first` is volts; its columns in the covariance are of unit-scale records.
        covariance = jacobian @ fit.covariance @ jacobian.swapaxes(-1, -2)
        covariance = covariance * np.sqrt(fit.excess)[:, :, np.newaxis] * np.sqrt(fit.excess)[:, np.newaxis, :]
        ratio_u, tangential_u = np.sqrt(covariance[:, 1, 1]), np.sqrt(covariance[:, 2, 2])
        ratio = np.sqrt(np.maximum(size**2 - tangential_u**2, 0.0))
        beat_rate = frequency / scale_factor
        value, slope_r, slope_f = _rate_and_slopes(ratio, beat_rate, rate, relation)
        variance = slope_r**2 * covariance[:, 1, 1] + (slope_f / scale_factor) ** 2 * covariance[:, 0, 0]
        variance += 2 * slope_r * (slope_f / scale_factor) * covariance[:, 0, 1]
        rate_u = np.sqrt(np.maximum(variance, 0.0))
        raw = _rate_and_slopes(size, beat_rate, rate, relation)[0]
        low, high = size_interval(np.where(rate_u > 0, raw / rate_u, np.inf))
        exact = ~(rate_u > 0)
        low, high = np.where(exact, raw, low * rate_u), np.where(exact, raw, high * rate_u)
        direction = np.conj(first) / np.abs(first)
        rho = q * direction
        turn = np.exp(1j * np.angle(rho))
        rotation = np.stack([np.stack([turn.real, -turn.imag], -1), np.stack([turn.imag, turn.real], -1)], -2)
        rho_covariance = rotation @ covariance[:, 1:, 1:] @ rotation.swapaxes(-1, -2)
        sense = 1.0 if rate is None else np.where(rate < 0, -1.0, 1.0)
        phase = np.angle(-rho * sense) * sense
        rate_out = input_rate_from_beat(ratio, beat_rate) if rate is None else rate
        amplitude = np.abs(first) / (1 - size**2)

    periods = series.omega * n_samples / (2 * np.pi)
    flags = fit.flags.copy()
    flags[periods < FEWEST_PERIODS] |= Flag.FEW_PERIODS
    flags[2 * series.omega >= np.pi] |= Flag.SECOND_HARMONIC_ABOVE_NYQUIST
    flags[_folds_onto_another(series.omega, size, n_samples)] |= Flag.HARMONICS_ALIASED
    flags[~(size > 3.3 * ratio_u)] |= Flag.RATIO_NOT_SIGNIFICANT
    fatal = (flags & np.uint32(FATAL)) != 0
    shape = records.shape

    def shaped(values: NDArray[np.float64], keep: bool = False) -> Floats:
        return np.asarray(values if keep else np.where(fatal, np.nan, values)).reshape(shape)

    blank = np.where(fatal, np.nan, 1.0)
    return LockInEstimate(
        lock_in_rate=shaped(value),
        lock_in_rate_u=shaped(rate_u),
        lock_in_rate_low_95=shaped(low),
        lock_in_rate_high_95=shaped(high),
        input_rate=shaped(np.asarray(rate_out), keep=rate is not None),
        beat_frequency=shaped(frequency),
        beat_frequency_u=shaped(np.sqrt(covariance[:, 0, 0])),
        ratio=shaped(ratio),
        ratio_u=shaped(ratio_u),
        complex_ratio=(rho * blank).reshape(shape),
        complex_ratio_covariance=(rho_covariance * blank[:, np.newaxis, np.newaxis]).reshape(*shape, 2, 2),
        backscatter_phase=shaped(phase),
        amplitude=shaped(amplitude),
        noise_rms=shaped(fit.noise_rms, keep=True),
        periods=shaped(periods),
        records=(~fatal).astype(np.int64).reshape(shape),
        records_rejected=fatal.astype(np.int64).reshape(shape),
        flags=flags.reshape(shape),
        scale_factor=float(scale_factor),
        relation=relation,
        rate_given=rate is not None,
        noise_model=COLOURED if np.any(flags & Flag.COLOURED_NOISE) else WHITE,
    )


def _frame(
    first: Complexes, q: Complexes, frequency: Floats, records: Records, sample_interval: float
) -> tuple[Complexes, Floats]:
    """Jacobian (R, 3, 6) of frequency and of the ratio's radial and tangential part by the fit's parameters.

    The tangential part is that of rho = q exp(-i arg H), so the phase of H enters it; the radial part, the size
    of the ratio, does not know H.
    """
    size = np.abs(q)
    unit = np.where(size > 0, q / np.where(size > 0, size, 1.0), 1.0)
    jacobian = np.zeros((q.size, 3, 6))
    jacobian[:, 0, 5] = 1 / (np.pi * records.n_samples * sample_interval)
    jacobian[:, 1, 3], jacobian[:, 1, 4] = unit.real, unit.imag
    jacobian[:, 2, 3], jacobian[:, 2, 4] = -unit.imag, unit.real
    in_unit = first / records.scale
    squared = np.abs(in_unit) ** 2
    jacobian[:, 2, 1], jacobian[:, 2, 2] = size * in_unit.imag / squared, -size * in_unit.real / squared
    return unit, jacobian


def _rate_and_slopes(
    ratio: Floats, beat_rate: Floats, rate: Floats | None, relation: Relation
) -> tuple[Floats, Floats, Floats]:
    """Lock-in rate, and its derivatives by the ratio and by f/K."""
    r = ratio
    if rate is None and relation == "exact":
        value = lock_in_from_beat(r, beat_rate)
        return value, beat_rate * 2 * (1 + r * r) / (1 - r * r) ** 2, 2 * r / (1 - r * r)
    if rate is None:
        w = beat_rate if relation == "paper-10" else input_rate_from_beat(r, beat_rate)
        by_beat = lock_in_from_rate(r, w / beat_rate, relation)
    else:
        w, by_beat = np.abs(rate), np.zeros_like(r)
    small = 1e-6
    slope = (lock_in_from_rate(r + small, w, relation) - lock_in_from_rate(r - small, w, relation)) / (2 * small)
    return lock_in_from_rate(r, w, relation), slope, by_beat


def _folds_onto_another(omega: Floats, ratio: Floats, n_samples: int) -> NDArray[np.bool_]:
    """Whether a strong harmonic folds to within one bin of the fundamental or of the second harmonic."""
    orders = np.arange(2, 13)
    folded = np.abs((orders * omega[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    bin_width = 2 * np.pi / n_samples
    strong = ratio[:, np.newaxis] ** (orders - 1) > 0.02 * ratio[:, np.newaxis]
    on_first = np.abs(folded - omega[:, np.newaxis]) < bin_width
    second = np.abs((2 * omega[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    on_second = (np.abs(folded - second) < bin_width) & (orders > 2)
    at_edge = (np.abs(folded - np.pi) < bin_width) & (orders == 2)
    at_zero = (folded < bin_width) & (orders == 2)
    return np.asarray((strong & (on_first | on_second | at_edge | at_zero)).any(axis=-1))
