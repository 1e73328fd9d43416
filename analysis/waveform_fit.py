"""Fit of the lock-in waveform to records as they come: clipped, spiked, noisy, or no beat at all."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from analysis.damage import Bools, find_damage, outliers
from analysis.flags import Flag
from analysis.geometric_series import Series, sampled_series
from analysis.periodic_fit import Step
from analysis.phase_tracking import looks_like_wander, track_phase
from analysis.quantisation import level_spacing, mean_rounding
from analysis.records import Records, Stack
from analysis.residuals import examine_residual
from analysis.series_fit import fit_series

Floats = NDArray[np.float64]

N_PARAMETERS = 6
FEWEST_SAMPLES = 12
"""Twice the number of parameters: with fewer valid samples the noise could not be told from the fit."""


@dataclass(frozen=True)
class WaveformFit:
    """Fit of a stack of records.

    series : parameters (volts), phases from the middle of the record; the offset is less the record's mean
    covariance : (R, 6, 6) for white noise, order c0, Re H, Im H, Re q, Im q, w (rad at the record's ends)
    excess : (R, 3) variance factors of frequency, ratio size and ratio phase where the noise is not white
    noise_rms : (R,) volts
    flags : (R,)
    """

    series: Series
    covariance: Floats
    excess: Floats
    noise_rms: Floats
    flags: NDArray[np.int64]


def fit_waveform(stack: Stack, clipped: Bools | None) -> WaveformFit:
    """Fit every record; `clipped` (R, N) marks samples known to stand at the converter's end, None: find them."""
    parts = [_fit_part(stack.take(part), None if clipped is None else clipped[part]) for part in stack.parts()]
    series = Series(*(np.concatenate([getattr(p.series, f.name) for p in parts]) for f in fields(Series)))
    others = (np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(WaveformFit)[1:])
    return WaveformFit(series, *others)


def _fit_part(records: Records, clipped: Bools | None) -> WaveformFit:
    values, weights = records.values, records.weights
    n_samples = values.shape[1]
    damage = find_damage(records, clipped)
    flags = damage.flags.copy()
    series, step = fit_series(values, weights)
    hit = (flags & int(Flag.CLIPPED)) != 0
    if hit.any() and damage.weights is not None and damage.limits is not None:
        weights = np.ones_like(values) if weights is None else weights.copy()
        refitted, new_step, weights[hit] = _fit_between_limits(
            values[hit], weights[hit], damage.weights[hit], damage.limits[hit]
        )
        series.put(hit, refitted)
        step.put(hit, new_step)

    left = values - sampled_series(series, n_samples)
    if weights is not None:
        left *= weights
    spikes = outliers(left, weights)
    hit = np.asarray(spikes.any(axis=-1))
    if hit.any():
        weights = (np.ones_like(values) if weights is None else weights) * ~spikes
        refitted, new_step = fit_series(values[hit] * weights[hit], weights[hit])
        series.put(hit, refitted)
        step.put(hit, new_step)
        left[hit] = values[hit] - sampled_series(refitted, n_samples)
        left *= weights
        flags[hit] |= Flag.DAMAGED
    count = records.count if weights is None else weights.sum(axis=-1)
    quiet, corrected = _without_rounding(values, weights, series, step, count)
    if quiet.size:
        left[quiet] = corrected - sampled_series(series.take(quiet), n_samples)
        if weights is not None:
            left[quiet] *= weights[quiet]
    return _judged(records, weights, series, step, left, count, flags)


def _without_rounding(
    values: Floats, weights: Floats | None, series: Series, step: Step, count: Floats
) -> tuple[NDArray[np.intp], Floats]:
    """Fit quiet records again with the mean rounding error taken out; which they are, and their values then.

    `series` and `step` are changed in place.
    """
    rms = np.sqrt(step.residual_power / np.maximum(count - N_PARAMETERS, 1))
    spacing = level_spacing(values, rms)
    quiet = np.flatnonzero(spacing)
    corrected = values[quiet]
    if quiet.size == 0:
        return quiet, corrected
    mask = None if weights is None else weights[quiet]
    for _ in range(2):
        model = sampled_series(series.take(quiet), values.shape[1])
        corrected = values[quiet] - mean_rounding(model, values[quiet], spacing[quiet], rms[quiet])
        refitted, new_step = fit_series(corrected if mask is None else corrected * mask, mask)
        series.put(quiet, refitted)
        step.put(quiet, new_step)
    return quiet, corrected


def _judged(
    records: Records,
    weights: Floats | None,
    series: Series,
    step: Step,
    left: Floats,
    count: Floats,
    flags: NDArray[np.int64],
) -> WaveformFit:
    """The fit with its noise and its flags; records that do not fit get a second chance with a moving phase."""
    power, free = step.residual_power, count - N_PARAMETERS
    report = examine_residual(left, count, series.omega, np.abs(series.first), power)
    covariance = step.covariance()
    flags |= report.flags
    excess = report.excess
    for row in np.flatnonzero((report.flags & int(Flag.MISFIT)) != 0):
        if not looks_like_wander(left[row], float(series.omega[row])):
            continue
        tracked = track_phase(
            records.values[row], None if weights is None else weights[row], float(series.omega[row])
        )
        if tracked is None:
            continue
        here = slice(row, row + 1)
        series.offset[row], series.first[row] = tracked.offset, tracked.first
        series.ratio[row], series.omega[row] = tracked.ratio, tracked.omega
        covariance[row], power[row] = tracked.covariance, tracked.left @ tracked.left
        free[row] = count[row] - N_PARAMETERS + 1 - tracked.degree
        again = examine_residual(
            tracked.left[np.newaxis], count[here], series.omega[here], np.abs(series.first[here]), power[here]
        )
        flags[row] = (flags[row] & ~report.flags[row]) | again.flags[0] | int(Flag.RATE_WANDER)
        excess[row] = again.excess[0]
    flags[records.constant] = Flag.CONSTANT
    flags[count < FEWEST_SAMPLES] |= Flag.TOO_FEW_SAMPLES
    variance = power / np.maximum(free, 1)
    covariance *= variance[:, np.newaxis, np.newaxis]
    return WaveformFit(series, covariance, excess, np.sqrt(variance), flags)


def _fit_between_limits(
    values: Floats, weights: Floats, undamaged: Floats, limits: Floats
) -> tuple[Series, Step, Floats]:
    """Fit clipped records without their clipped samples.

    Which samples are left out must not depend on their own noise, or the mean of the others is biased near the
    limits. So after a first fit the model, not the sample, says what is too near to a limit.
    """
    series, step = fit_series(values * undamaged, undamaged)
    kept = undamaged
    for _ in range(2):
        model = sampled_series(series, values.shape[1])
        noise = np.sqrt(step.residual_power / np.maximum(kept.sum(axis=-1) - N_PARAMETERS, 1))
        margin = 4 * noise[:, np.newaxis]
        inside = weights * ((model > limits[:, :1] + margin) & (model < limits[:, 1:] - margin))
        enough = inside.sum(axis=-1, keepdims=True) > 0.2 * values.shape[1]
        kept = np.where(enough, inside, undamaged)
        series, step = fit_series(values * kept, kept)
    return series, step, kept
