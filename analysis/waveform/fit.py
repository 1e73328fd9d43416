"""Fit of the lock-in waveform to records as they come: clipped, spiked, noisy, or no beat at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.special

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints, Samples, Stacked
from analysis.flags import FATAL, Flag
from analysis.waveform.converter import (
    FEW_ERRORS,
    SILENT,
    find_damage,
    leftover_excess,
    level_spacing,
    locked_to_the_beat,
    mean_rounding,
    outliers,
    repetition,
)
from analysis.waveform.frequency import Records, Stack, never_alone
from analysis.waveform.residuals import (
    Masks,
    Residual,
    ResidualReport,
    by_code,
    by_level,
    examine_lines,
    examine_residual,
    hidden_by_harmonics,
    left_by,
    residual_of,
    residual_samples,
    turned_by,
)
from analysis.waveform.series import Series, drift_by_samples, sampled_series
from analysis.waveform.series_fit import PLAIN_RATIO, SeriesFit, Task, fit_series, fit_series_again, gauss_newton
from analysis.waveform.varying_rate import (
    LARGE,
    UNEVEN,
    FirstPhase,
    MovingFits,
    first_phase,
    fit_moving_rate,
    may_be_motion,
    small_motions,
    smooth_motions,
)

SINGLE_PRECISION_SWING = 1e-12, 1e12  # volts between which squares are safe in single precision

SINGLE_PRECISION_NOISE = 1e-4
"""Noise over swing below which single precision would show: less than a fiftieth of an eight-bit level."""

TRACKED_FROM = 1e-4  # residual over fundamental below which no motion is tried: a wander of s rad leaves about s
WORTH_MOVING = 0.98  # share of the residual power that a motion may leave to be worth its parameters

MOST_WALK = 20.0
"""rad of random walk over the record up to which a record that is no beat at a steady rate may be one with a noisy
rate. What is no beat at all needs more."""

SUSPECT = Flag.MISFIT | Flag.COLOURED_NOISE | Flag.DAMAGED
"""What makes it worth asking whether the residual is there all the time."""

FEW_PERIODS = 7.5
"""A motion that is no smooth curve may leave less than the noise, and with few periods looks like a harmonic: the
ratio's variance grows with the sixth power of this over the periods."""

COLOURFUL = 2.0
"""Variance factor from which on a smooth motion leaves so much about the beat that the exact one is asked too."""

MOVING_AT_ONCE = 256  # records with a motion that are worked on together
LEVELS_AT_ONCE = 4  # and these, whose polynomials stay in the cache

N_PARAMETERS = 6
FEWEST_SAMPLES = 12
"""Twice the number of parameters: with fewer valid samples the noise could not be told from the fit."""


@dataclass(frozen=True)
class WaveformFit(Stacked):
    """Fit of a stack of records."""

    # parameters (volts), phases from the middle of the record; the offset is less the record's mean
    series: Series
    covariance: Floats  # (R, 6, 6) for white noise, order c0, Re H, Im H, Re q, Im q, w (rad at the record's ends)
    excess: Floats  # (R, 3) variance factors of frequency, ratio size and ratio phase where the noise is not white
    noise_rms: Floats  # (R,) volts
    misfit: Floats  # (R,) standard uncertainty of the ratio by what is no noise
    # (R,) volts, complex: what the waveform leaves at three times the beat, its phase that in the middle of the
    # record; nan where samples are missing or something moved
    third: Complexes
    moves: Bools  # (R,) whether a motion explains the record, and has been asked if its parts agree
    flags: Ints  # (R,)


def fit_waveform(stack: Stack, clipped: Bools | None) -> WaveformFit:
    """Fit every record; `clipped` (R, N) marks samples known to stand at the converter's end, None: find them."""
    return WaveformFit.joined([fit for part in stack.parts() for fit in _fit_what_can_be(stack, part, clipped)])


def _fit_what_can_be(stack: Stack, part: slice, clipped: Bools | None) -> list[WaveformFit]:
    """Fits of a part, in order; a record that the arithmetic cannot cope with is refused, and stops no other."""
    try:
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return [_fit_part(stack, part, clipped)]
    except (np.linalg.LinAlgError, ArithmeticError):
        first, stop, _ = part.indices(len(stack.volts))
        if stop - first == 1:
            unknown = np.array([np.nan])
            nothing = np.zeros(1)  # finite, so that what is computed from it for all records stays silent
            none: Complexes = np.zeros(1, dtype=np.complex128)
            series = Series(nothing, none, none.copy(), np.ones(1))
            flags = np.array([int(Flag.NOT_LOCK_IN_LIKE)])
            blank = np.full((1, 6, 6), np.nan), np.ones((1, 3)), unknown, unknown, unknown + 0j
            return [WaveformFit(series, *blank, nothing > 0, flags)]
        middle = (first + stop) // 2
        halves = slice(first, middle), slice(middle, stop)
        return [fit for half in halves for fit in _fit_what_can_be(stack, half, clipped)]


def _fit_part(stack: Stack, part: slice, clipped: Bools | None) -> WaveformFit:
    """Single precision, and double where single would show."""
    records = stack.take(part, np.float32)
    known = None if clipped is None else clipped[part]
    fit = _fit_records(records, known)
    swing = records.highest - records.lowest
    good = (swing > SINGLE_PRECISION_SWING[0]) & (swing < SINGLE_PRECISION_SWING[1])
    good &= fit.noise_rms > SINGLE_PRECISION_NOISE * swing
    fine = never_alone(np.flatnonzero(~(good | records.constant)))
    if fine.size:
        again = stack.take(fine + part.start, np.float64)
        fit.put(fine, _fit_records(again, None if known is None else known[fine]))
    return fit


def _fit_records(records: Records, clipped: Bools | None) -> WaveformFit:
    """Fit records; each has the same digits whatever others are among them."""
    fits: list[WaveformFit] = []
    place = np.empty(len(records.values), dtype=np.intp)
    for rows, some in records.groups():
        place[rows] = sum(fit.flags.size for fit in fits) + np.arange(rows.size)
        fits.append(_fit_alike(some, None if clipped is None else clipped[rows]))
    return WaveformFit.joined(fits).take(place)


def _fit_alike(records: Records, clipped: Bools | None) -> WaveformFit:
    """Fit two records or more all of which have missing samples, or none."""
    values, masks = records.values, Masks.of(records.values, records.weights)
    fit = fit_series(values, records.weights)
    damage = find_damage(records, fit, clipped)
    flags, hit = damage.flags, damage.rows
    if hit.size:
        refitted, kept = _fit_between_limits(values[hit], masks.of_all(hit), damage.weights, damage.limits)
        masks = masks.changed(hit, kept)
        fit.put(hit, refitted)

    left = residual_of(values, masks, fit.series)
    spikes = outliers(values, masks, fit.series, left, records.highest - records.lowest)
    if spikes:
        spiked = never_alone(np.array(list(spikes)))
        mask = masks.of_all(spiked)
        for place, row in enumerate(map(int, spiked)):
            mask[place, spikes[row][0]] = 0.0
        masks = masks.changed(spiked, mask)
        some = values[spiked] * mask
        refitted = fit_series(some, mask)  # anew: the spikes may have led the first fit astray
        fit.put(spiked, refitted)
        left.put(spiked, residual_of(some, Masks.of(some, mask), refitted.series))
        flags[spiked] |= Flag.DAMAGED
    _beside_third_harmonics(values, masks, fit, left)
    count = masks.counted(records.count)
    rounding, repeats = _take_out_rounding(values, masks, fit, left, count)
    flags[repeats] |= Flag.ROUNDING_REPEATS
    covariance = fit.covariance * rounding[:, np.newaxis, np.newaxis]
    judged = _judged(records, masks, fit.series, covariance, left, count, flags)
    judged.flags[[row for row, (_, piece) in spikes.items() if piece]] |= Flag.MISFIT
    return judged


def _beside_third_harmonics(values: Samples, masks: Masks, fit: SeriesFit, left: Residual) -> None:
    """Fit records again of which a third harmonic is left that bends the last step; fit and left are changed."""
    # A step moves q by about 2 q* h from where the spectrum has it, h being that harmonic over the first, and is
    # then wrong by 2 h times itself: alike in every record of a run, so that no mean takes it out.
    n_samples, size, ratio = values.shape[1], np.abs(fit.series.first), np.abs(fit.series.ratio)
    noise = np.sqrt(np.maximum(2 * left.power - n_samples * np.abs(left.third) ** 2, 0.0)) / n_samples
    bent = (4 * ratio * np.abs(left.third) ** 2 > BENDS * noise * size) & (ratio < PLAIN_RATIO)
    whole = masks.whole(np.arange(len(values)))
    for masked in (False, True):  # apart, so that no record's last digits depend on another's mask
        if (rows := never_alone(np.flatnonzero(bent & (whole != masked)))).size:
            mask = masks.of_all(rows) if masked else None
            some = values[rows] if mask is None else values[rows] * mask
            refitted, _ = gauss_newton(Task.of(some, mask), fit.series.take(rows))
            fit.put(rows, refitted)
            left.put(rows, residual_of(some, Masks.of(some, mask), refitted.series))


BENDS = 0.01  # share of the uncertainty of a ratio that it may be wrong by


def _take_out_rounding(
    values: Samples, masks: Masks, fit: SeriesFit, left: Residual, count: Floats
) -> tuple[Floats, Bools]:
    """Fit quiet records again with the mean rounding error taken out; fit and left are changed."""
    # Returns the factor (R,) of the variance by what is left of the rounding, and where it repeats with the beat.
    rms = np.sqrt(left.power / np.maximum(count - N_PARAMETERS, 1))
    spacing = level_spacing(values, rms)
    quiet, excess = np.flatnonzero(spacing), np.ones(len(values))
    is_locked = np.zeros(len(values), dtype=bool)
    if quiet.size:
        silent = quiet[rms[quiet] < SILENT * spacing[quiet]]
        repeated = repetition(left.lines[silent])
        locked = locked_to_the_beat(fit.series.omega[silent], repeated, values.shape[1])
        excess[silent[locked]] = repeated[locked] * FEW_ERRORS
        is_locked[silent[locked]] = True
        quiet = quiet[~is_locked[quiet]]
    # The rounding error is taken where the first fit has put the waveform. That fit was moved by it by little, but
    # with next to no noise the error changes within a small part of a level.
    noisy = rms[quiet] > SILENT * spacing[quiet]
    whole = masks.whole(quiet)
    for times, few in ((1, noisy), (2, ~noisy)):
        for masked, chosen in ((False, few & whole), (True, few & ~whole)):
            if (rows := never_alone(quiet[chosen])).size:
                mask = masks.of_all(rows) if masked else None
                refitted, rest = _without_rounding(
                    values[rows], mask, fit.series.take(rows), spacing[rows], rms[rows], times
                )
                fit.put(rows, refitted)
                left.put(rows, rest)
                excess[rows] = leftover_excess(rest, values.shape[1], spacing[rows])
    return excess, is_locked


def _without_rounding(
    values: Samples, weights: Samples | None, fitted: Series, spacing: Floats, rms: Floats, times: int
) -> tuple[SeriesFit, Residual]:
    for _ in range(times):
        model = sampled_series(fitted, values.shape[1], values.dtype)
        corrected = values - mean_rounding(model, values, spacing, rms)
        if weights is not None:
            corrected *= weights
        refitted, _ = gauss_newton(Task.of(corrected, weights), fitted)
        fitted = refitted.series
    return refitted, residual_of(corrected, Masks.of(corrected, weights), fitted)


def _judged(
    records: Records, masks: Masks, series: Series, covariance: Floats, left: Residual, count: Floats, flags: Ints
) -> WaveformFit:
    """The fit with its noise and its flags; records that do not fit get a second chance with a motion."""
    free, power = count - N_PARAMETERS, left.power
    repeated = (flags & int(Flag.ROUNDING_REPEATS)) != 0
    n_samples = records.values.shape[1]
    report = examine_residual(left, n_samples, count, series, repeated)
    excess, third = report.excess, np.where(count < n_samples, np.nan, left.third)
    fatal = (report.flags & int(FATAL)) != 0
    beat_power = np.abs(series.first) ** 2 / 2 * count
    at_rest, moving = np.ones(len(count), dtype=bool), np.zeros(len(count), dtype=bool)
    asked = report.uneven | ((report.flags & int(Flag.COLOURED_NOISE)) != 0)
    asked |= ~fatal & (power > LARGE * beat_power)
    # A residual as small as this cannot come from a motion that would move the ratio.
    asked &= power > TRACKED_FROM**2 * np.abs(series.first) ** 2 * count
    variance = power / np.maximum(free, 1)
    motions = _followed(records, masks, series, np.flatnonzero(asked), flags, fatal, variance)
    for rows, moved, again, is_small in motions:
        sidebands = power[rows] / beat_power[rows]
        series.put(rows, moved.series)
        at_rest[rows], moving[rows], third[rows] = is_small, True, np.nan
        covariance[rows] = moved.covariance / moved.variance[:, np.newaxis, np.newaxis]
        free[rows], power[rows] = moved.degrees, moved.variance * moved.degrees
        report.flags[rows], excess[rows] = again.flags | moved.flags, again.excess
        # what noise hardly makes
        drift = np.where(moved.drift_chance < RARE, HIDDEN * moved.drift, 0.0)
        hidden, sure = _following_the_level(records.values[rows], masks, rows, moved)
        turned = moved.vibrates * turned_by(sidebands, np.abs(moved.series.ratio))
        every = again.misfit, drift, moved.stepped_u, hidden / np.abs(moved.series.first), turned
        report.misfit[rows] = np.linalg.norm(every, axis=0)
        report.flags[rows[moved.drift_chance < UNLIKELY]] |= Flag.PARTS_DIFFER
        report.flags[rows[sure | moved.vibrates]] |= Flag.MISFIT
    examine_lines(report, left, n_samples, series, ~moving)
    flags |= report.flags
    asked = ~moving & ~fatal & (report.uneven | (report.misfit > 0) | ((report.flags & int(Flag.MISFIT)) != 0))
    codes = _by_codes(records.values, masks, series, report, np.flatnonzero(asked), flags)
    report.stronger[codes] = report.drifting[codes] = False
    variance = power / np.maximum(free, 1)
    _look_closer(records.values, masks, series, report, variance * excess[:, 1], at_rest, flags)
    at_rest[codes] = False
    for row in map(int, np.flatnonzero(at_rest & ((flags & int(SUSPECT)) != 0) & ~fatal)):
        left_over = _valid_left(records.values, masks, series, row)
        passing = max(passing_power(left_over), slow_curve_power(left_over))
        if passing:
            flags[row] |= Flag.MISFIT
            report.misfit[row] = np.hypot(report.misfit[row], np.sqrt(passing / beat_power[row]))
    flags[records.constant] = Flag.CONSTANT
    flags[count < FEWEST_SAMPLES] |= Flag.TOO_FEW_SAMPLES
    covariance *= variance[:, np.newaxis, np.newaxis]
    return WaveformFit(series, covariance, excess, np.sqrt(variance), report.misfit, third, moving, flags)


def _by_codes(
    values: Samples, masks: Masks, series: Series, report: ResidualReport, rows: Indices, flags: Ints
) -> Indices:
    """Which of some records only a converter spoils; the report and the flags then say so."""
    found = []
    for row in map(int, rows):
        left, mask = _valid_left(values, masks, series, row), masks.of_one(row)
        level = values[row] if mask is None else values[row, mask > 0]
        size = by_code(left, level - left)
        if size is not None:
            # it adds to the real part of rho, and to its size by as much as rho is real
            share = abs(np.cos(np.angle(series.ratio[row] / series.first[row])))
            report.misfit[row] = size / abs(series.first[row]) * max(share, 0.1)
            report.excess[row] = 1.0
            flags[row] &= ~int(Flag.MISFIT | Flag.COLOURED_NOISE)
            found.append(row)
    return np.array(found, dtype=np.intp)


def _look_closer(
    values: Samples,
    masks: Masks,
    series: Series,
    report: ResidualReport,
    variance: Floats,
    at_rest: Bools,
    flags: Ints,
) -> None:
    """What shows in the samples only: harmonics too weak for lines, and a ratio that drifts."""
    # The report's misfit and the flags are changed. variance (R,): of the noise of a sample, as strong as it is at
    # the harmonics.

    def taken(chosen: Bools) -> tuple[Indices, Samples, Samples | None, Series]:
        rows = never_alone(np.flatnonzero(chosen))
        return rows, values[rows], masks.of_any(rows), series.take(rows)

    rows, some, mask, waves = taken(report.stronger)
    if rows.size:
        hidden = hidden_by_harmonics(left_by(waves, some, mask), waves.omega, report.mean[rows])
        hidden *= 2 / (values.shape[1] * np.abs(waves.first))
        report.misfit[rows] = np.maximum(report.misfit[rows], hidden)
    rows, some, mask, waves = taken(report.drifting & at_rest)
    if rows.size:
        drift, covariance = drift_by_samples(some, mask, waves)
        drift_u, sure = drift_of_ratio(drift, covariance * variance[rows, np.newaxis, np.newaxis])
        report.misfit[rows] = np.hypot(report.misfit[rows], drift_u)
        flags[rows[sure]] |= Flag.PARTS_DIFFER


def _followed(
    records: Records, masks: Masks, series: Series, rows: Indices, flags: Ints, fatal: Bools, variance: Floats
) -> Iterator[tuple[Indices, MovingFits, ResidualReport, bool]]:
    """Those of some records that a motion explains, with what it leaves of them."""
    # and whether it is so small that a steady rate is not far; variance (R,): that of a fit at a steady rate. The
    # flags (R,) get that of a misfit where a beat stops
    n_samples, repeated = records.values.shape[1], (flags & int(Flag.ROUNDING_REPEATS)) != 0

    def left_by_motion(rows: Indices, moved: MovingFits) -> ResidualReport:
        # What noise of the rate leaves is white only together with that noise.
        residual, white = Residual.of(moved.left, moved.series.omega), not moved.walk.any()
        count = moved.degrees + N_PARAMETERS
        again = examine_residual(residual, n_samples, count, moved.series, repeated[rows], moved=white)
        examine_lines(again, residual, n_samples, moved.series, np.ones(rows.size, dtype=bool), moved=white)
        again.excess[:] = np.maximum(again.excess, 1.0)
        again.flags[~np.any(again.excess > 1.0, axis=1)] &= ~int(Flag.COLOURED_NOISE)
        again.excess[:, 1:] *= 1 + (FEW_PERIODS * 2 * np.pi / (n_samples * moved.series.omega))[:, np.newaxis] ** 6
        return again

    for first in range(0, rows.size, MOVING_AT_ONCE):
        some = never_alone(rows[first : first + MOVING_AT_ONCE])
        left = left_by(series.take(some), records.values[some], masks.of_any(some)).astype(np.float64)
        whole = masks.whole(some) & ~fatal[some]
        asked, told, sidebands = may_be_motion(left, series.take(some), whole)
        asked |= fatal[some]
        if told.size:
            here = some[told]
            small, moved = small_motions(records.values[here], sidebands, series.take(here))
            if small.size:
                here = here[small]
                again = left_by_motion(here, moved)
                settled = never_alone(np.flatnonzero(again.flags == 0))
                if settled.size:
                    yield here[settled], moved.take(settled), again.take(settled), True
                    asked[told[small[settled]]] = False
        some = never_alone(np.unique(some[asked]))
        if not some.size:
            continue
        values, mask = records.values[some].astype(np.float64), masks.of_all(some).astype(np.float64)
        undone, tried, phase = np.ones(some.size, dtype=bool), np.arange(some.size), None
        seen = dict[int, FirstPhase | None]()
        for by_crests in (False, True):
            if by_crests:  # a motion so wide that the fundamental has no band of its own is read from them
                seen = {place: first_phase(values[place], mask[place]) for place in tried.tolist()}
                even = {place: one for place, one in seen.items() if one and not one.stops and one.uneven < UNEVEN}
                crests = {place: one.phase for place, one in even.items()}
                tried = never_alone(np.array(list(crests), dtype=np.intp))
                phase = np.array([crests[place] for place in tried.tolist()])
            if not tried.size:
                break
            here = some[tried]
            moved, is_smooth = smooth_motions(values[tried], mask[tried], phase)
            again = left_by_motion(here, moved)
            failed = ((again.flags | moved.flags) & int(FATAL | Flag.MISFIT)) != 0
            coloured = (again.flags & int(Flag.COLOURED_NOISE)) != 0
            coloured &= again.excess.max(axis=1) > COLOURFUL
            done = is_smooth & ~failed & ~coloured
            explained = (moved.flags & int(Flag.RATE_WANDER)) != 0
            explained |= moved.variance <= WORTH_MOVING * variance[here]
            taken = never_alone(np.flatnonzero(done & explained))
            if taken.size:
                yield here[taken], moved.take(taken), again.take(taken), False
            undone[tried[done]] = False
            # one that fits and is too quick for it has been read well enough
            tried = np.unique(tried[failed | coloured])
        fits: dict[bytes, MovingFits | None] = {}  # a record that is alone stands here twice
        for place in np.flatnonzero(undone)[np.unique(some[undone], return_index=True)[1]].tolist():
            row, key = some[[place]], values[place].tobytes() + mask[place].tobytes()
            if (known := seen.get(place)) and known.stops:
                flags[row] |= Flag.MISFIT
            if not records.exact[row[0]] or (place in seen and (known is None or known.stops)):
                continue
            if key not in fits:
                fits[key] = fit_moving_rate(values[place], mask[place], known)
            exactly = fits[key]
            if exactly is None or exactly.variance[0] > WORTH_MOVING * variance[row[0]]:
                continue
            again = left_by_motion(row, exactly)
            wrong = (again.flags[0] | exactly.flags[0]) & int(FATAL | Flag.MISFIT)
            if not (fatal[row[0]] and (wrong or exactly.walk[0] > MOST_WALK)):
                yield row, exactly, again, False


def _following_the_level(values: Samples, masks: Masks, rows: Indices, moved: MovingFits) -> tuple[Floats, Bools]:
    """What `by_level` says of records (r, N); rounding without noise follows the level too, and is known."""
    level, rms, left = values - moved.left, np.sqrt(moved.variance), moved.left.astype(np.float64)
    spacing = level_spacing(values, rms)
    for place in np.flatnonzero(spacing):
        one = slice(place, place + 1)
        left[one] -= mean_rounding(level[one], values[one], spacing[one], rms[one])
    hidden, sure = np.zeros(rows.size), np.zeros(rows.size, dtype=bool)
    whole = masks.whole(rows)
    together = np.flatnonzero(whole)
    parts = [together[first : first + LEVELS_AT_ONCE] for first in range(0, together.size, LEVELS_AT_ONCE)]
    for part in [*parts, *np.flatnonzero(~whole)[:, np.newaxis]]:
        mask = None if whole[part[0]] else masks.of_one(rows[part[0]])
        valid = slice(None) if mask is None else mask > 0
        hidden[part], sure[part] = by_level(left[part][:, valid], level[part][:, valid], moved.degrees[part])
    return hidden, sure


def _valid_left(values: Samples, masks: Masks, series: Series, row: int) -> Floats:
    """What the waveform leaves of the samples of one record that are believed."""
    left, mask = residual_samples(values, masks, series, row).astype(np.float64), masks.of_one(row)
    return left if mask is None else left[mask > 0]


THIRD_DIFFERENCE = 0.6745 * np.sqrt(20)  # median size of the third difference of white noise, over its rms

STRAY = 2.0
"""Residual over the noise of neighbouring samples from which on a model does not know where the limits are met."""


def _fit_between_limits(
    values: Samples, weights: Samples, undamaged: Samples, limits: Floats
) -> tuple[SeriesFit, Samples]:
    """Fit clipped records without their clipped samples."""
    # Which samples are left out must not depend on their own noise, or the mean of the others is biased near the
    # limits. So after a first fit the model, not the sample, says what is too near to a limit; but where it leaves
    # far more than neighbouring samples differ by, as under a moving rate, it does not know.
    fit = fit_series(values * undamaged, undamaged)
    whole = undamaged[:, 3:] * undamaged[:, 2:-1] * undamaged[:, 1:-2] * undamaged[:, :-3] > 0
    rough = np.where(whole, np.abs(np.diff(values, 3, axis=1)), np.nan)
    rough = np.nanmedian(np.where(whole.any(axis=1, keepdims=True), rough, np.inf), axis=1) / THIRD_DIFFERENCE
    kept = undamaged
    for _ in range(2):
        model = sampled_series(fit.series, values.shape[1], values.dtype)
        noise = np.sqrt(fit.residual_power / np.maximum(kept.sum(axis=-1) - N_PARAMETERS, 1))
        margin = 4 * noise[:, np.newaxis]
        inside = weights * ((model > limits[:, :1] + margin) & (model < limits[:, 1:] - margin))
        known = (inside.sum(axis=-1) > 0.2 * values.shape[1]) & (noise < STRAY * rough)
        kept = np.where(known[:, np.newaxis], inside, undamaged).astype(values.dtype)
        fit = fit_series_again(values * kept, kept, fit.series)
    return fit, kept


# --------------------
# Whether what a fit leaves is there all the time, as noise is, or in one part of the record only.
#
# The start of a motion, a gyro that settles into lock-in, a beam that comes back: each leaves a smooth curve in
# one part of the record. Its spectrum is as flat as that of coloured noise; in time it stands alone. Noise that is
# louder for a while is no curve: its neighbouring samples do not agree.
#
# A curve so slow that no part stands out, as a motion leaves that dies away over the record, shows itself by the
# phases of its lines: they turn evenly from one to the next, while those of noise are independent


PARTS = 20

CHANCE = 1e-6  # share of records in which noise leaves so much more in one part than in the others

LINES, IN_PHASE, FIRST_LINES, STRONGER = 24, 0.8, 3, 4.0
"""So many lines from the lowest on are looked at. Steps from one to the next whose directions have a mean of this
length come by chance in 2 of 10^7 records."""

LONGEST_RUN, FAR = 20, 5.0
"""Samples of one sign in a row beyond so many (robust) standard deviations that no noise has."""

SMOOTH = 3.0  # standard deviations by which the products of neighbouring samples must exceed those of white noise


def passing_power(left: Floats) -> float:
    """Sum of squares of a curve in one part of a residual (N,), beyond its steady noise; 0 where there is none."""
    # The power of a part of m samples has as many degrees of freedom as its noise has independent values: m for
    # white noise, and m (mean S)^2/mean(S^2) for one of the spectrum S, which the residual itself shows.
    if left.size < PARTS:
        return 0.0
    # long runs of one sign, far beyond what the rest shows
    far = np.sign(left) * (np.abs(left) > FAR * 1.4826 * np.median(np.abs(left)))
    lengths = np.diff(np.concatenate([[0], np.flatnonzero(np.diff(far)) + 1, [far.size]]))
    in_long_run = np.repeat(lengths >= LONGEST_RUN, lengths) & (far != 0)
    if in_long_run.any():
        return float(np.sum(left[in_long_run] ** 2))
    length = left.size // PARTS
    cut = left[: length * PARTS].reshape(PARTS, length)
    parts = np.sum(cut**2, axis=1)
    power = np.abs(np.fft.rfft(left)[1:]) ** 2
    spread = float(np.mean(power**2))
    if not spread > 0:
        return 0.0
    # a line of noise scatters as an exponential variable, with a mean square of twice the squared mean
    degrees = float(min(max(2 * length * float(np.mean(power)) ** 2 / spread, 1.0), length))
    # Half of the parts may be disturbed: the quieter half tells the noise. Its mean is below that of all.
    below = float(scipy.special.chdtr(degrees + 2, float(scipy.special.chdtri(degrees, 0.5))) / 0.5)
    quiet = np.argsort(parts)[: PARTS // 2]
    level = float(parts[quiet].mean()) / below
    largest = float(parts.max()) / max(level, 1e-300)
    chance = PARTS * float(scipy.special.fdtrc(degrees, degrees * PARTS / 2, largest))
    if not chance < CHANCE:
        return 0.0
    products = cut[:, 1:] * cut[:, :-1]
    alike = products.sum(axis=1)
    curve = float(np.sum(alike - alike[quiet].mean()))
    return curve if curve > SMOOTH * float(np.linalg.norm(products)) else 0.0


def slow_curve_power(left: Floats) -> float:
    """Sum of squares of a curve in a residual (N,) whose lowest lines have the phases of one event; 0 without."""
    # So have the lines of noise that is louder for a while: they must be stronger than all others are. And so have
    # the feet of a line that lies among them: the strongest must be one of the first.
    spectrum = np.fft.rfft(left)[1:]
    lines, power = spectrum[: LINES + 1], np.abs(spectrum) ** 2
    steps = lines[1:] * np.conj(lines[:-1])
    sizes = np.abs(steps)
    if power.size <= LINES + 1 or not sizes.min() > 0 or abs(np.mean(steps / sizes)) < IN_PHASE:
        return 0.0
    low, others = power[: LINES + 1], power[LINES + 1 :]
    if int(low.argmax()) >= FIRST_LINES or not low.mean() > STRONGER * others.mean():
        return 0.0
    return float(2 * low.sum() / left.size)


# --------------------
# A ratio that drifts within the record: the lock-in rate does not, so something else is there.
#
# A second beat close to the first looks like one beat of another ratio, which changes slowly: if the two part by d
# turns over the record, the ratio changes by pi d times what it is off by, from the middle of the record to its
# end


UNLIKELY, RARE = 1e-4, 1e-2
"""Shares of records in which noise shows so large a drift that a flag says so, where something moved besides, or
that it counts."""

SURE = 1e-6  # the same for the flag where nothing else speaks against the record

HIDDEN = 2.0
"""What may hide behind a drift from the middle of the record to its end, over that: as with two beats that part by
a seventh of a turn."""


def drift_of_ratio(drift: Floats, covariance: Floats) -> tuple[Floats, Bools]:
    """Standard uncertainty of the ratio (R,) by drifts that noise hardly makes, and where it never does."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    x, y = drift.T
    with np.errstate(all="ignore"):  # records without a beat, or without noise
        chi_square = (c * x**2 - 2 * b * x * y + a * y**2) / (a * c - b**2)
        chance = np.where(np.isfinite(chi_square), np.exp(-chi_square / 2), 1.0)
    return np.where(chance < RARE, HIDDEN * np.hypot(x, y), 0.0), chance < SURE
