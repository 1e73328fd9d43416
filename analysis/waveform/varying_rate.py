"""Records whose rate, intensity or baseline moves: seen, taken as smooth, or fitted one by one exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.special
from numpy.polynomial import legendre
from scipy.linalg import solve_triangular

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints, Samples, Stacked
from analysis.flags import Flag
from analysis.waveform.frequency import never_alone
from analysis.waveform.residuals import line_stands_out
from analysis.waveform.series import Series, carrier_of, data_sums, step_by_samples, tangents_along
from analysis.waveform.smooth_phase import AT_ENDS, OTHERS, Paths, fit_smooth_phase, knots_of
from analysis.waveform.trajectory import (
    HIGHEST,
    SLOW_CHANGES,
    Fitted,
    SampledRecord,
    Terms,
    Trajectory,
    polynomials,
    unit_diagonal,
)

SLOW_TERMS = 4  # polynomials of amplitude and offset to begin with: up to the third degree

RATE_TERMS, RATE_TERMS_PER_PERIOD = 6, 2.0
"""A motion as fast as the beat itself could not be told from lock-in: with so many polynomials per period, the
fastest has two thirds of the frequency of the beat."""

ENOUGH_TERMS, TERMS_FOR_A_THIRD, FEWEST_VALUES = 130, 1.4, 20.0
"""Of many periods not all that could be told apart are tried: so many, or those that reach a third of the beat. A
phase that is known roughly says how many of them it asks for as so many values, if it walks."""

ROOM, ROOM_AT_LEAST = 1.25, 2
"""So many more polynomials of the rate are kept than the criterion asks for: it is content with a fault as large
as the noise."""

LOST = 0.02  # share of the samples, and 1.2 turns at least, where a free phase hardly moves: locked, or no beat

FREE, LOOSE, TIGHT, EXACT = 1.0, 1e-2, 1e-6, 1e-8
"""Looseness times the squared amplitude, in turn. Over 2500 samples the last one moves the phase by a thousandth
of what the noise leaves unknown."""

ITERATIONS, LAST_ITERATIONS, TO_A_STEP = 4, 8, 2

NOISY_RATE = 12.0  # -2 log likelihood by which noise of the rate must explain a record better than an exact motion
ALIKE = 0.1  # the same, by which two such fits are not worth telling apart

ROUGHLY = 1.0  # gain of the last step of a fit that is not the last one, in variances of a sample's noise

IN_A_TURN, FEWEST_MEANS, BESIDE_GAPS = 10, 250, 0.9
"""Means of samples that a turn of the beat needs where it is fast, and a record; the share of the samples that
must be left where a mean that lacks one is none."""

COARSEST, FINEST = 1.2, 0.5
"""Logarithm of the looseness to which such noise is found, before the terms are chosen, and after."""

SILENT, CHANCE = 1e-6, 1e-4
"""Noise over amplitude of no converter: the rate's has taken all there is; share of records whose line is none."""

ABOUT, ITSELF = (0.6, 1.6), 1.2  # lines about the beat, over its own; so near to it s and c have taken them

NEARLY_LOCKED = 0.99999
SLOWEST = 1.02
"""Rate over lock-in rate down to which a motion is believed: below it the gyro creeps, and what was fitted there
may be anything."""

MOVES = 25.0
"""Variances of a sample's noise that the samples must say against an even phase for the rate to have moved."""

FEW_PERIODS, SLOWED = 10.0, 0.35
"""With fewer periods than that a rate that falls below this share of its mean is doubtful too: a gyro that comes
to rest leaves too little of a beat to show it."""

JUMPS, BELOW = 8.0, 0.5
"""Step of a noise of the rate, in its (robust) standard deviations, from which on it is a jump. One may be a gap;
where they come again, or below this share of the mean rate, a gyro turned round and seems to go on."""

WEAKEST = 0.3  # the same for the amplitude, over its largest: a beam that is weaker than that was not drifting


@dataclass(frozen=True)
class MovingFits(Stacked):
    """(R,) records, and the beats that gyros at their mean rates would have shown."""

    series: Series  # phases from the middle of the record
    covariance: Floats  # (R, 6, 6) in the order c0, Re H, Im H, Re q, Im q, w (rad at the record's ends)
    variance: Floats  # of the noise of a sample
    degrees: Floats  # samples less parameters
    left: Samples  # (R, N) residuals
    believed: Bools  # whether there is a beat at all
    flags: Ints  # what moved
    walk: Floats  # rad, rms, by which noise of the rate moved the phase over the record; 0 where there is none
    vibrates: Bools  # whether that noise holds a line, which no noise has, or has taken up all there is
    # change of the size of the ratio from the middle of the record to its end if the lock-in rate drifted, and the
    # share of records in which noise alone shows so much
    drift: Floats
    drift_chance: Floats
    # standard uncertainty of the size of the ratio where the rate stepped, because the time base may have stepped
    # instead
    stepped_u: Floats


def fit_moving_rate(values: Floats, mask: Floats, seen: FirstPhase | None = None) -> MovingFits | None:
    """Fit one record by the exact equation, whatever its rate does; `seen`: where that is known already."""
    if (seen is None and (seen := first_phase(values, mask)) is None) or seen.stops:
        return None
    # so many samples stand for each other that enough means are left of a turn, and of the samples beside gaps
    quarter = max(int(mask.size * np.pi / 2 / np.ptp(seen.phase)), 1)
    fastest = float(np.quantile(seen.phase[quarter:] - seen.phase[:-quarter], 1 - AT_ENDS)) / quarter
    most = int(min(2 * np.pi / IN_A_TURN / max(fastest, 1e-9), mask.size / FEWEST_MEANS))
    kept = {of: of * mask.reshape(-1, of).min(axis=1).sum() for of in range(2, most + 1) if mask.size % of == 0}
    of = max((of for of, count in kept.items() if count > BESIDE_GAPS * mask.sum()), default=1)
    try:
        with np.errstate(all="ignore"):  # a step too far gives nan, and is taken back
            record = SampledRecord(values, mask, of)
            fitted, needed, noisy = _fitted(record, seen)
            louder = _louder_at_beat(fitted) if noisy else np.zeros(2)
            left = record.residual(fitted.trajectory, fitted.looseness if noisy else 0.0)
            fits = as_beats(_path_of(record, fitted, left, louder, moves=noisy or needed.rate > 1))
            if noisy:
                of_steps = np.abs(np.fft.rfft(fitted.model.moved)[1:]) ** 2
                taken = min(int(needed.rate / np.pi), of_steps.size // 2)  # polynomials have left little of these
                of_steps[:taken] = of_steps[taken : 2 * taken][::-1]
                silent = fitted.variance * record.of < (SILENT * float(np.mean(seen.amplitude))) ** 2
                walk = np.sqrt([fitted.looseness * fitted.variance * record.values.size])
                fits = replace(fits, walk=walk, vibrates=np.array([silent or line_stands_out(of_steps, CHANCE)]))
                moved, at, rate = np.abs(fitted.model.moved), fitted.trajectory, fitted.trajectory.parts[0]
                far = np.flatnonzero(moved > JUMPS / 0.6745 * np.median(moved))
                rates = rate @ polynomials(at.phase.size).means[: rate.size, far]
                quiet = walk[0] ** 2 < np.ptp(at.phase) / 2  # or it may turn round at a crest by itself
                if quiet and far.size and (rates.min() < BELOW * rate[0] or np.ptp(at.phase[far]) > 2 * np.pi):
                    fits.flags[0] |= int(Flag.PARTS_DIFFER)
            return fits if fits.believed[0] else None
    except np.linalg.LinAlgError:
        return None


def _fitted(record: SampledRecord, seen: FirstPhase) -> tuple[Fitted, Terms, bool]:
    """The fit, the terms that the data ask for, and whether the rate is noisy."""
    scale = (float(np.mean(seen.amplitude)) / record.of) ** 2
    fits = _roughly(SampledRecord(record.samples, record.valid * seen.trusted, record.of), seen, scale)
    if (free := fits[0]) is (loose := fits[-1]):
        return free, free.trajectory.terms, False
    if seen.step is not None:  # it goes to the sample where the record says it is
        inside = np.flatnonzero(~seen.trusted)
        height = float(loose.trajectory.parameters[-1])
        before = replace(loose.trajectory, parameters=np.concatenate([loose.trajectory.parameters[:-1], [0.0]]))
        left, valid = record.residual(before)[inside], record.valid[inside]
        # sums of squares if the step comes before the i-th sample of these
        below = np.concatenate([[0.0], np.cumsum(left**2)])
        above = np.concatenate([np.cumsum((valid * (left - height) ** 2)[::-1])[::-1], [0.0]])
        step = int(inside[0] + np.argmin(below + above))
        moved = replace(loose.trajectory, terms=replace(loose.trajectory.terms, step=step))
        loose = record.fit(moved, LOOSE / scale, ITERATIONS, ROUGHLY)
        free = record.fit(moved, FREE / scale, ITERATIONS, ROUGHLY)
    best = min(free, loose, key=lambda fitted: fitted.evidence)
    if not (noisy := loose.evidence >= free.evidence + NOISY_RATE):
        tight = record.fit(loose, TIGHT / scale, LAST_ITERATIONS, ROUGHLY)
        noisy = tight.evidence > loose.evidence + NOISY_RATE
        best = best if noisy else tight
    needed = terms_needed(best, record.count)
    kept = replace(needed, rate=min(int(ROOM * needed.rate) + ROOM_AT_LEAST, best.trajectory.terms.rate))
    if noisy:
        # the looseness of greatest likelihood; no more terms are kept: the noise takes up what they leave
        fitted, width = record.fit(with_terms(best, kept), best.looseness, 1), float(np.log(FREE / LOOSE)) / 2
        roughly = _likeliest(record, fitted, width, COARSEST)
        needed = terms_needed(roughly, record.count)
        again = record.fit(with_terms(roughly, needed), roughly.looseness, ITERATIONS, ROUGHLY)
        likeliest = _likeliest(record, again, COARSEST, FINEST)
        return record.fit(likeliest, likeliest.looseness, ITERATIONS), needed, True
    return record.fit(with_terms(best, kept), EXACT / scale, LAST_ITERATIONS), needed, False


def _roughly(record: SampledRecord, seen: FirstPhase, scale: float) -> list[Fitted]:
    """The phases followed wherever they go, then the motion that they show, and once more from there."""
    # a gyro that does not turn for a while ends it: `as_beats` says misfit
    slow = Terms(0, SLOW_TERMS, SLOW_TERMS, seen.step)
    of_amplitude, of_offset = record.columns(slow)
    seen_by_sample = np.stack([seen.phase, seen.amplitude, seen.offset])
    phase, height, middle = seen_by_sample.reshape(3, -1, record.of).mean(axis=2)
    amplitude = np.linalg.lstsq(of_amplitude.T, height, rcond=None)[0]
    offset = np.linalg.lstsq(of_offset.T, middle, rcond=None)[0]
    fits = list[Fitted]()
    for looseness in (FREE, LOOSE):
        periods = (phase[-1] - phase[0]) / (2 * np.pi)
        tried = max(ENOUGH_TERMS, TERMS_FOR_A_THIRD * periods)
        most = int(min(HIGHEST, RATE_TERMS + RATE_TERMS_PER_PERIOD * periods, tried))
        motion, pull = matched_motion(phase, (amplitude @ of_amplitude) * np.cos(phase) * record.mask, most)
        rate = np.zeros(min(int(ROOM * motion.size) + ROOM_AT_LEAST, most))
        rate[: motion.size] = motion
        parameters = np.concatenate([rate, pull, amplitude, offset])
        start = Trajectory(phase, parameters, replace(slow, rate=rate.size))
        fitted = record.fit(start, looseness / scale, ITERATIONS if seen.step is None else TO_A_STEP, ROUGHLY)
        phase, (rate, pull, amplitude, offset) = fitted.trajectory.phase, fitted.trajectory.parts
        fits.append(fitted)
        rates = rate @ polynomials(phase.size).values[: rate.size]
        if np.mean(rates < np.hypot(*pull) / 2) > max(LOST, 1.2 / periods):
            break
    return fits


def _likeliest(record: SampledRecord, fitted: Fitted, width: float, finest: float) -> Fitted:
    """The fit at the looseness of greatest likelihood; `width` and `finest` are steps of its logarithm."""
    tried, middle = {0.0: fitted}, 0.0

    def at(place: float) -> float:
        if place not in tried:
            tried[place] = record.fit(tried[middle], fitted.looseness * np.exp(place), 1)
        return tried[place].evidence

    while width > finest:
        below, above = at(middle - width) - at(middle), at(middle + width) - at(middle)
        if min(below, above) < -ALIKE:
            middle += width if above < below else -width
        else:
            width /= 2
    if finest == FINEST:  # a parabola through the last three; terms are chosen well enough without
        at(middle + width * (below - above) / max(below + above, ALIKE))
    return min(tried.values(), key=lambda fit: fit.evidence)


FASTEST, UNEVEN = 0.1, 2.5
"""Change of the rate in a radian of the beat, over the rate, up to which the smooth phase is exact enough; ratio
of what two turns in a row take from which on it is hopeless."""

NEAR_LOCK_IN, UNHURRIED = 1.5, 0.02
"""Closer to lock-in than that, in lock-in rates, a motion must be so much slower."""


def smooth_motions(values: Floats, mask: Floats, phase: Floats | None = None) -> tuple[MovingFits, Bools]:
    """Records (R, N) fitted with a smooth phase, from a phase that is known roughly; and where that is enough."""
    paths = fit_smooth_phase(values, mask, phase)
    # the path has as many parameters as there are knots, and some
    enough = values.shape[1] > 2 * (knots_of(paths.rate * values.shape[1] / (2 * np.pi)) + OTHERS)
    near = paths.slowest < NEAR_LOCK_IN * np.hypot(*paths.pull.T)
    with np.errstate(all="ignore"):  # what failed is nan
        moved = as_beats(paths)
        smooth = moved.believed & enough & (paths.fast < np.where(near, UNHURRIED, FASTEST))
    return moved, smooth


def _louder_at_beat(fitted: Fitted) -> Floats:
    """Variance of s and c by noise of the rate that is stronger about the beat than it is in the mean, (2,)."""
    # Whatever the rate does at the beat itself looks like s and c. Steps of a variance v, seen through noise of n,
    # have lines of v^2/(v + n); polynomials take what is slower than half of their number.
    at, count = fitted.trajectory, fitted.model.moved.size
    step, periods = fitted.looseness * fitted.variance, float(at.phase[-1] - at.phase[0]) / (2 * np.pi)
    number = np.arange(count // 2 + 1)
    through = 2 * fitted.variance * (2 * np.pi * number / count / at.parts[2][0]) ** 2
    lines = np.abs(np.fft.rfft(fitted.model.moved)) ** 2 / count * (step + through) / step**2
    slowest = max(ABOUT[0] * periods, at.terms.rate / 2)
    if slowest > ABOUT[0] * periods:  # what is left of a noise that falls is less than what it has at the beat
        lines *= np.maximum(number / periods, 1.0) ** 2
    near = (number > slowest) & (number < ABOUT[1] * periods) & (np.abs(number - periods) > ITSELF)
    surplus = max(float(np.mean(lines[near])) - 1, 0.0) if near.any() else 0.0
    return np.asarray(surplus * step / count / np.var([np.sin(at.phase), np.cos(at.phase)], axis=1))


def _path_of(record: SampledRecord, fitted: Fitted, left: Floats, louder: Floats, *, moves: bool) -> Paths:
    """What a trajectory says of its record."""
    trajectory, terms, n_means = fitted.trajectory, fitted.trajectory.terms, record.values.size
    to_amplitude, to_offset = record.columns(terms)
    by_rate, pull, by_amplitude, by_offset = trajectory.parts
    height, offset = by_amplitude @ to_amplitude, by_offset @ to_offset
    rates = by_rate @ polynomials(n_means).values[: terms.rate]
    rate, size = float(by_rate[0]), float(np.hypot(*pull))
    ratio = size / (rate + np.sqrt(max(rate**2 - size**2, 0.0)))
    middle = np.interp((n_means - 1) / 2, np.arange(n_means), trajectory.phase)
    z = np.exp(1j * middle) * size / complex(*pull)
    places = np.array([0, terms.rate, terms.rate + 1])
    changes, of_changes = record.changes_of_pull(fitted)
    chi_square = float(changes @ np.linalg.solve(of_changes, changes))
    of_mean = np.repeat(2 * np.arange(1, SLOW_CHANGES + 1) + 1.0, 2)
    even = np.ptp(rates) == 0
    single = (
        rate / record.of,
        pull / record.of,
        (fitted.covariance[np.ix_(places, places)] + np.diag([0.0, *louder])) / record.of**2,
        (z - 1j * ratio) / (ratio * z - 1j),  # exp(i psi) = i (r - u)/(1 - r u), psi the phase less gamma
        float(np.mean(height)),
        float(np.mean(offset)),
        fitted.variance * record.of,
        record.count - terms.count - 1,
        left,
        np.inf if moves else 0.0,
        0.0,
        np.inf if even else float(np.quantile(rates, AT_ENDS)) / record.of,
        height.min() / height.max(),
        float(np.sqrt(np.sum(changes**2 / of_mean))) / record.of,
        float(scipy.special.chdtrc(changes.size, chi_square)),
        0.0,
        False,
    )
    return Paths(*(np.array([value]) for value in single))


def as_beats(paths: Paths) -> MovingFits:
    """What gyros at the mean rates would have shown."""
    n_records, n_samples = paths.left.shape
    rate, size = paths.rate, np.hypot(*paths.pull.T)
    x = size / rate
    believed = np.isfinite(paths.variance) & (x > 0) & (x < NEARLY_LOCKED)
    covariance = np.where(np.isfinite(paths.covariance), paths.covariance, 0.0)
    believed &= np.linalg.eigvalsh(covariance).min(axis=1) > 0
    root = np.sqrt(np.maximum((1 - x) * (1 + x), 1 - NEARLY_LOCKED))
    ratio, omega = x / (1 + root), rate * root
    turn = (paths.pull[:, 0] + 1j * paths.pull[:, 1]) / size
    by_pull = ratio / (root * size)
    u = paths.turned
    q = ratio * u
    # frequency, size of q, its direction, by a, s, c
    jacobian = np.zeros((n_records, 3, 3))
    along, across = np.stack([turn.real, turn.imag], axis=1), np.stack([-turn.imag, turn.real], axis=1)
    jacobian[:, 0, 0], jacobian[:, 0, 1:] = 1 / root, (-size / omega)[:, np.newaxis] * along
    jacobian[:, 1, 0], jacobian[:, 1, 1:] = -ratio / omega, by_pull[:, np.newaxis] * along
    jacobian[:, 2, 1:] = -across / size[:, np.newaxis]
    to_parameters = np.zeros((n_records, 6, 3))
    to_parameters[:, 3, 1], to_parameters[:, 4, 1] = u.real, u.imag
    to_parameters[:, 3, 2], to_parameters[:, 4, 2] = -q.imag, q.real
    to_parameters[:, 5, 0] = n_samples / 2
    whole = to_parameters @ jacobian
    moves = paths.moves > MOVES
    flags = np.where(moves, int(Flag.RATE_WANDER), 0)
    # close to lock-in, or the beam lost, for a part
    too_slow = moves & (paths.slowest < SLOWEST * size)
    flags[too_slow | (paths.weakest < WEAKEST)] |= int(Flag.MISFIT)
    flags[(rate * n_samples < 2 * np.pi * FEW_PERIODS) & (paths.slowest < SLOWED * rate)] |= int(Flag.PARTS_DIFFER)
    flags[paths.stretched] |= int(Flag.PARTS_DIFFER)
    nothing = np.zeros(n_records)
    first = -paths.amplitude * turn * (1 - ratio**2) * u
    return MovingFits(
        Series(paths.offset + paths.amplitude * ratio * turn.real, first, q, omega),
        whole @ covariance @ whole.transpose(0, 2, 1), paths.variance, paths.degrees, paths.left, believed,
        flags.astype(np.int64), nothing, nothing > 0, by_pull * np.sqrt(3) * paths.drift, paths.drift_chance,
        by_pull * paths.stepped_u,
    )  # fmt: skip


# --------------------
# How many terms the motion needs: the data decide.
#
# At the minimum of a fit with more than enough terms its normal equations tell what any fit with fewer would
# leave: terms t of covariance C cost t' C^-1 t, and with N = L L' and the terms to be dropped last, the last k of
# them cost the sum of the last k squares of L' t. So the Bayesian information criterion is known without another
# fit: first for amplitude and offset beside the whole motion, then for the motion


def terms_needed(fitted: Fitted, count: float) -> Terms:
    """Least Bayesian criterion among the numbers of terms up to those of a fit."""
    terms, parameters, variance = fitted.trajectory.terms, fitted.trajectory.parameters, fitted.variance
    price, covariance = np.log(count), fitted.covariance
    steps = (terms.step,) if terms.step is None else (terms.step, None)
    fewest, least = terms, np.inf
    for amplitude, offset, step in product(range(1, terms.amplitude + 1), range(1, terms.offset + 1), steps):
        fewer = Terms(terms.rate, amplitude, offset, step)
        out = np.delete(np.arange(terms.count), _places(terms, fewer))
        lost = parameters[out] @ np.linalg.solve(covariance[np.ix_(out, out)], parameters[out])
        if lost - price * out.size < least:
            fewest, least = fewer, float(lost - price * out.size)
    kept = _places(terms, fewest)
    order = np.concatenate([kept[terms.rate :], kept[: terms.rate], np.delete(np.arange(terms.count), kept)])
    scaled, scale = unit_diagonal(fitted.normal[np.ix_(order, order)])
    squares = (np.linalg.cholesky(scaled).T @ (parameters[order] / scale)) ** 2
    # what the fit would leave more if all parameters from number i on were zero
    costs = np.concatenate([np.cumsum(squares[::-1])[::-1], [0.0]])
    first = kept.size - terms.rate
    criterion = costs[first + 1 : first + terms.rate + 1] / variance + price * np.arange(1, terms.rate + 1)
    return replace(fewest, rate=int(criterion.argmin()) + 1)


def with_terms(fitted: Fitted, terms: Terms) -> Trajectory:
    """The trajectory with fewer terms, the others as they come out best without those that are dropped."""
    trajectory = fitted.trajectory
    kept = _places(trajectory.terms, terms)
    dropped = np.setdiff1d(np.arange(trajectory.terms.count), kept)
    scaled, scale = unit_diagonal(fitted.normal)
    taken_over = scaled[np.ix_(kept, dropped)] @ (trajectory.parameters[dropped] / scale[dropped])
    parameters = trajectory.parameters[kept] + scale[kept] * np.linalg.solve(
        scaled[np.ix_(kept, kept)], taken_over
    )
    return Trajectory(trajectory.phase, parameters, terms)


def _places(terms: Terms, fewer: Terms) -> Indices:
    """Where the parameters of `fewer` terms stand among those of all."""
    first = terms.rate + 2
    second = first + terms.amplitude
    # the rate first, as in `Trajectory`
    kept = np.r_[: fewer.rate, terms.rate : first, first : first + fewer.amplitude, second : second + fewer.offset]
    return kept if fewer.step is None else np.append(kept, terms.count - 1)


# --------------------
# First values of the rate's motion from a phase that is known roughly: a linear problem.
#
# Integrated, the lock-in equation is linear in all that is not the phase:
#
#     phi(t) = phi_0 + sum over j of a_j I_j(t) - s S(t) + c C(t)
#
# with I_j, S, C the integrals of the polynomials, of sin(phi) and of cos(phi). Weighted by A cos(phi), which turns
# an error of the phase into one of the sample, its least squares are nearly those of the samples themselves


def matched_motion(phase: Floats, weights: Floats, terms: int) -> tuple[Floats, Floats]:
    """Coefficients of a, and s and c, with as many polynomials as the phase asks for, at most `terms`."""
    # by the Bayesian information criterion
    integrals = [np.cumsum(values) - (values + values[0]) / 2 for values in (-np.sin(phase), np.cos(phase))]
    columns = np.concatenate([[np.ones(phase.size), *integrals], polynomials(phase.size).integrals[:terms]])
    columns *= weights
    target = weights * phase
    normal, scale = unit_diagonal(columns @ columns.T)
    factor = np.linalg.cholesky(normal)
    # The factor is nested: what each further polynomial explains is one square.
    explained = solve_triangular(factor, scale * (columns @ target), lower=True, check_finite=False)
    left = np.maximum(target @ target - np.cumsum(explained**2)[3:], 1e-300)
    # what all terms leave is as many values as it forgets: a phase that walks is no motion
    rough = target - solve_triangular(factor.T, explained, check_finite=False) * scale @ columns
    forgotten = min(np.sum(np.diff(rough) ** 2) / max(2 * rough @ rough, 1e-300), 1.0)
    count = max(np.count_nonzero(weights) * float(forgotten), FEWEST_VALUES)
    degree = int(np.argmin(count * np.log(left) + np.log(count) * np.arange(left.size)))
    size = degree + 4
    solution = scale[:size] * solve_triangular(factor[:size, :size].T, explained[:size], check_finite=False)
    return solution[3:], solution[1:3]


# --------------------
# The phase of a beat read from its samples, without any model of how the rate moves.
#
# A gyro's beat is A sin(phi) with phi always rising: between a crest and the trough that follows, phi is the arc
# sine of the sample. Wander of any size, sidebands and a fundamental that is nowhere in the spectrum do not matter


SWUNG = 0.25  # share of the amplitude by which the signal must cross its middle to begin the next half period
REACHED = 0.9  # share of the amplitude from which on the first and the last extreme of a record count as a crest
STOPPED, STILL = 3.0, 0.07  # turns of the others in which a beat moves by less than this share of its amplitude
END, UPPER, SQUARE = 0.4, 0.3, 0.9
"""Shares of its height from the middle where a beat has its ends, and its mean if it stands at one of them, near
lock-in; share of the samples that no other beat has there: all are clipped."""

QUIET = 0.06  # noise over amplitude at which crests are found without smoothing
KEPT_LINES = 3  # smoothing keeps at least so many times the frequency of the strongest line

FEWEST_CRESTS = 6
ENVELOPE_TERMS = 4

STEP_STANDS_OUT = 12.0
"""A step of the offset is believed where it lowers the scatter of the middles by this factor of its variance, in
logarithms times their number; a wrong one costs little, since the fit drops it again."""

NOT_APART = 1e-9  # determinant of two columns from which on they count as one


@dataclass(frozen=True)
class FirstPhase:
    """phase (N,) rad; amplitude, offset (N,) as low polynomials of time, the offset with its step."""

    phase: Floats
    amplitude: Floats
    offset: Floats
    trusted: Bools  # (N,) samples at which the step, if there is one, leaves no doubt about the phase
    step: int | None  # number of the first sample behind a step of the offset, or None
    stops: bool  # for some turns, or at both of its ends: locked, blocked, clipped, or no beat

    @property
    def uneven(self) -> float:
        """Largest ratio between what two turns in a row take."""
        rising = np.maximum.accumulate(self.phase)
        turns = np.diff(np.interp(np.arange(rising[0], rising[-1], 2 * np.pi), rising, np.arange(rising.size)))
        return float(np.max(np.maximum(turns[1:] / turns[:-1], turns[:-1] / turns[1:]), initial=1.0))


def first_phase(values: Floats, mask: Floats) -> FirstPhase | None:
    """Read the phase of one centred record (N,); `mask` is 0 where a sample is missing. None: there is no beat."""
    valid = mask > 0
    places = np.arange(values.size)
    filled = values if valid.all() else np.interp(places, places[valid], values[valid])
    smooth = _smoothed(filled)
    middle, half = (smooth.max() + smooth.min()) / 2, np.ptp(smooth) / 2
    side = np.sign(smooth - middle) * (np.abs(smooth - middle) > SWUNG * half)
    seen = np.maximum.accumulate(np.where(side != 0, np.arange(smooth.size), 0))
    side = side[np.maximum(seen, int(np.argmax(side != 0)))]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1])
    pieces = np.split(smooth * side, starts[1:])
    crests, signs = starts + np.array([int(piece.argmax()) for piece in pieces]), side[starts]
    if crests.size < FEWEST_CRESTS:
        return None
    amplitude, offset, trusted, step = _envelope(crests[1:-1], smooth[crests[1:-1]], signs[1:-1], values.size)
    if not np.all(amplitude > 0):
        return None
    level = np.clip((smooth - offset) / amplitude, -1.0, 1.0)
    passed = crests.copy()
    reached = np.abs(level[crests]) > REACHED
    if passed[0] == 0 or not reached[0]:
        passed[0] = -1
    if passed[-1] == values.size - 1 or not reached[-1]:
        passed[-1] = values.size
    # half turns: even while the beat rises
    half_turns = np.searchsorted(passed, places, side="right") + (signs[0] < 0)
    phase = half_turns * np.pi + np.where(half_turns % 2 == 0, 1, -1) * np.arcsin(level)
    edges = np.flatnonzero(np.diff(np.concatenate([[1], valid.astype(int), [1]])))
    speed = (phase[-1] - phase[0]) / phase.size
    for start, stop in edges.reshape(-1, 2):
        if start > 0 and stop < phase.size and (stop - start) * speed > 1:
            expected = speed * (stop - start + 1)
            turns = np.rint((expected - (phase[stop] - phase[start - 1])) / (2 * np.pi))
            phase[start:stop] += np.linspace(0, 2 * np.pi * turns, stop - start)
            phase[stop:] += 2 * np.pi * turns
    stops = _stops(values[valid], smooth, valid, crests, amplitude)
    return FirstPhase(phase, amplitude, offset, trusted, step, stops)


def _stops(seen: Floats, smooth: Floats, valid: Bools, crests: Indices, amplitude: Floats) -> bool:
    """Whether a beat stands still, for some turns or at both of its ends."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # takes longer to import than all else here

    place = (seen - seen.min()) / max(np.ptp(seen), 1e-300)
    square = abs(np.mean(place) - 0.5) < UPPER and np.mean(np.abs(place - 0.5) > END) > SQUARE
    long = int(STOPPED * np.median(crests[2:] - crests[:-2]))
    lowest, highest = (np.where(valid, smooth, nothing) for nothing in (-np.inf, np.inf))
    moved = maximum_filter1d(highest, long) - minimum_filter1d(lowest, long)
    inside = slice(long // 2 + 1, smooth.size - long // 2 - 1)
    return bool(square or np.any(moved[inside] < STILL * amplitude[inside]))


def _smoothed(values: Floats) -> Floats:
    """The record without the noise that would make crests of its own."""
    lines = np.fft.rfft(values)
    power = np.abs(lines) ** 2
    power[0] = 0.0
    bins = np.arange(power.size)
    noise = np.sqrt(np.median(power[power.size // 2 :]) / (np.log(2) * values.size))
    allowed = (QUIET * np.ptp(values) / 2 / max(noise, 1e-300)) ** 2 * power.size
    if allowed > power.size:
        return values
    kept = max(allowed, KEPT_LINES * float(power.argmax()), 1.0)
    return np.fft.irfft(lines * np.exp(-np.log(2) * (bins / kept) ** 2), values.size)


def _envelope(
    crests: Indices, heights: Floats, signs: Floats, n_samples: int
) -> tuple[Floats, Floats, Bools, int | None]:
    """Amplitude and offset from what two neighbouring crests have in common, and in what they differ."""
    middles, halves = (heights[1:] + heights[:-1]) / 2, (heights[:-1] - heights[1:]) / 2 * signs[:-1]
    terms = min(ENVELOPE_TERMS, max(1, middles.size // 3))
    columns = polynomials(n_samples).values[:terms]
    between = (crests[1:] + crests[:-1]) // 2
    amplitude = np.linalg.lstsq(columns[:, between].T, halves, rcond=None)[0] @ columns
    trusted, others, step = np.ones(n_samples, dtype=bool), np.ones(middles.size, dtype=bool), None
    number = _step_between(columns[:, between], middles)
    if number is not None:
        # this middle belongs to two crests, one on either side of the step
        step, others[number] = int(between[number]), False
        trusted[crests[number] : crests[number + 1] + 1] = False
        columns = np.concatenate([columns, [(np.arange(n_samples) >= step).astype(float)]])
    found = np.linalg.lstsq(columns[:, between[others]].T, middles[others], rcond=None)[0]
    return amplitude, found @ columns, trusted, step


def _step_between(columns: Floats, middles: Floats) -> int | None:
    """Which of the middles has a step of the offset between its two crests."""
    count = middles.size
    if count < columns.shape[0] + 4:
        return None
    smooth = np.linalg.qr(columns.T)[0]
    rough = middles - smooth @ (smooth.T @ middles)
    # For each middle the gain of two more columns: 1 behind it, and, since it lies half-way up, one for itself.
    free = np.eye(count) - smooth @ smooth.T
    behind = np.cumsum(free[:, ::-1], axis=1)[:, ::-1] - free
    with_behind = np.cumsum(rough[::-1])[::-1] - rough
    of_behind = np.cumsum(behind[::-1], axis=0)[::-1].diagonal() - behind.diagonal()
    of_both, of_itself = behind.diagonal(), free.diagonal()
    inner = slice(1, -1)
    aa, ab, bb, a, b = (v[inner] for v in (of_behind, of_both, of_itself, with_behind, rough))
    determinant = aa * bb - ab**2
    known = determinant > NOT_APART
    gains = np.where(known, bb * a**2 - 2 * ab * a * b + aa * b**2, 0.0) / np.where(known, determinant, 1.0)
    best, scatter = int(gains.argmax()), float(rough @ rough)
    gain = count * np.log(scatter / max(scatter - gains[best], 1e-12 * scatter)) if scatter > 0 else 0.0
    return best + 1 if gain > STEP_STANDS_OUT + 2 * np.log(count) else None


# --------------------
# Whether what a steady fit leaves of a record may come from a motion of the rate, the intensity, the baseline


BESIDE = 0.5  # share of its frequency about the fundamental in which sidebands are looked for

LOWEST, NEXT = slice(0, 3), slice(7, 24)
"""Lines 1 to 3, where a drift or a step of the baseline stands, and lines 8 to 24."""

STEEP = 30.0
"""A drift falls as the square of the frequency, by about 90 from the ones to the others; noise as 1/f by 9."""

LARGE = 0.1
"""Share of the power of the beat from which on what is left has no direction: the phase moves by 0.3 rad."""

MOST_REPEATING = 0.5
"""Share of what stands above the noise that may repeat with the beat; a motion leaves sidebands, which do not."""

HARMONICS = 8

STEADY = 4.0  # standard deviations by which noise may differ from what it is in the mean

MOST_BESIDE = 64  # lines on either side of the fundamental that are looked at

ONE_SIDED, BANDS = 6.0, (2, 4, 8, 16)
"""Surplus of the stronger of phase and amplitude over the other, in its scatter for noise; in the so many slowest
lines of both, or in all."""


Sidebands = tuple[Floats, Complexes, Complexes, Indices]
"""Power of the noise in a line (R,), lines of what moves amplitude and phase of the fundamental (R, K), from the
first on, and how many of these count (R,)."""


def may_be_motion(left: Floats, series: Series, whole: Bools) -> tuple[Bools, Indices, Sidebands]:
    """Whether what fits at steady rates leave (R, N) is that of a moving phase, amplitude or baseline."""
    # And of which `whole` records (R,) sidebands tell it, with these.
    # Distortion leaves harmonics, which no motion would mend. A wander of s rad wanders by k s at the k-th
    # harmonic, so its sidebands there have k^2 r^(2k-2) of the power of those about the fundamental; the ratio
    # found at a steady rate is too small, which the power 1.5 allows for. Noise of whatever colour moves phase and
    # amplitude alike, a motion of the rate the phase alone, one of the intensity the amplitude.
    n_records, n_samples = left.shape
    power = np.abs(np.fft.rfft(left)[:, 1:]) ** 2
    floor = np.median(power, axis=1) / np.log(2)
    of_samples = np.vecdot(left, left)
    # harmonics; a folded one that falls onto another counts once
    turns = series.omega[:, np.newaxis] / (2 * np.pi) * np.arange(1, HARMONICS + 1)
    place = np.abs(turns - np.rint(turns)) * n_samples
    apart = np.abs(place[:, :, np.newaxis] - place[:, np.newaxis])
    twice = np.any(np.tril(apart < 1, -1), axis=2) | (place < 1)
    lines = np.where(twice, 0.0, np.abs(data_sums(left, series.omega, HARMONICS, 0, lowest=1)[:, 0]) ** 2)
    repeating = 2 * np.sum(lines - np.where(twice, 0.0, floor[:, np.newaxis]), axis=1) / n_samples
    # what stands above the noise is itself known only to its scatter
    scatter = floor * np.sqrt(2 / n_samples)
    open_ = ~(repeating > MOST_REPEATING * (np.maximum(of_samples - floor, 0.0) + scatter))
    steep = np.zeros(n_records, dtype=bool)
    if power.shape[1] > NEXT.stop:
        steep = power[:, LOWEST].mean(axis=1) > STEEP * np.median(power[:, NEXT], axis=1) / np.log(2)
    line = series.omega * n_samples / (2 * np.pi)
    bins = np.arange(1, power.shape[1] + 1)
    beside = np.abs(bins - line[:, np.newaxis]) < BESIDE * line[:, np.newaxis]
    surplus = power - floor[:, np.newaxis]
    squared = np.abs(series.ratio) ** 2
    of_fundamental = (1 - squared) ** 3 / (1 + squared)
    inside, of_all = np.where(beside, surplus, 0.0).sum(axis=1), surplus.sum(axis=1)
    of_all -= n_samples * scatter
    about = (inside > 0.5 * of_fundamental**1.5 * of_all) & (inside > 0)
    large = of_samples > LARGE * np.abs(series.first) ** 2 / 2 * n_samples
    ask = np.flatnonzero(open_ & ~steep & about & ~large)
    has_direction, sidebands = _have_direction(left[ask], series.take(ask), line[ask], floor[ask])
    moves = open_ & (steep | (about & large))
    loud = never_alone(np.flatnonzero(open_ & large & ~moves))
    if loud.size:  # a phase that moves leaves most where the beat is steep, noise does not
        some, turn = series.take(loud), carrier_of(series.omega[loud], n_samples, left.dtype)
        slope = (some.first[:, np.newaxis] * turn / (1 - some.ratio[:, np.newaxis] * turn) ** 2).imag ** 2
        slope -= slope.mean(axis=1, keepdims=True)
        along = np.vecdot(left[loud] ** 2, slope) / np.sqrt(2 * np.vecdot(slope, slope))
        moves[loud] = along * n_samples > STEADY * of_samples[loud]
    moves[ask[has_direction]] = True
    told = never_alone(np.flatnonzero(has_direction & whole[ask]))
    floor, of_amplitude, of_phase, reach = sidebands
    return moves, ask[told], (floor[told], of_amplitude[told], of_phase[told], reach[told])


def _have_direction(left: Floats, series: Series, line: Floats, floor: Floats) -> tuple[Bools, Sidebands]:
    """Whether residuals about the fundamental move its phase and its amplitude by different amounts."""
    n_samples = left.shape[1]
    turned = np.fft.fft(left * np.conj(carrier_of(series.omega, n_samples, left.dtype)))
    turned *= np.exp(-1j * np.angle(series.first))[:, np.newaxis]
    number = np.arange(1, min(MOST_BESIDE, n_samples // 2 - 1) + 1)
    above, below = turned[:, number], np.conj(turned[:, -number])
    reach = np.maximum(BESIDE * line, 1.0).astype(np.intp)
    inside = number <= reach[:, np.newaxis]
    of_amplitude, of_phase = np.where(inside, above + below, 0.0), np.where(inside, (above - below) / 1j, 0.0)
    n_lines = of_phase.shape[1]
    found = np.zeros(len(left), dtype=bool)
    slow = legendre.legvander(np.linspace(-1, 1, n_samples), SLOW_TERMS - 1)
    drifts = np.linalg.qr(np.fft.rfft(slow, axis=0)[1 : n_lines + 1])[0]
    along = (of_amplitude[:, np.newaxis] @ drifts.conj()) @ drifts.T
    for amplitude in (of_amplitude, of_amplitude - along[:, 0]):
        products = np.abs(amplitude) ** 2, np.abs(of_phase) ** 2, (amplitude * of_phase.conj()).real
        a, p, ap = (np.cumsum(product, axis=1) for product in products)
        for count in (*BANDS, n_lines):
            last = np.minimum(np.minimum(count, reach), n_lines)
            here = np.arange(len(left)), last - 1
            mean, half = (a[here] + p[here]) / 2, np.hypot((a[here] - p[here]) / 2, ap[here])
            least = np.maximum(mean - half, 2 * last * floor)
            found |= mean + half > (1 + ONE_SIDED / np.sqrt(last)) * least
    return found, (floor, of_amplitude, of_phase, reach)


# --------------------
# A motion that is so small that no fit of a path is worth it: the phase moves by its own lines about the
# fundamental, and the steady fit takes one step more along the moved phase.
#
# Where a record ends elsewhere than it begins, these lines fall as slowly as those of a ramp, J/(2 pi k), and
# reach the second harmonic. The upper half of those that are looked at tells J; where they are not those of a ramp
# and noise, it is no small motion


LARGEST_SMALL, RISE = 0.06, 0.45  # rad rms; of the ratio, over the square of it, that the step may miss
HARMLESS = 0.35  # what it misses, in standard uncertainties of the ratio by noise
STEPS_AT_ONCE = 8  # records whose samples stay in the cache


def small_motions(values: Samples, sidebands: Sidebands, series: Series) -> tuple[Indices, MovingFits]:
    """Of whole records (R, N), of which steady fits leave sidebands: those where that is enough; their fits."""
    n_samples = values.shape[1]
    line = series.omega * n_samples / (2 * np.pi)
    floor, of_amplitude, of_phase, reach = sidebands
    number, last = np.arange(1, of_phase.shape[1] + 1), np.minimum(reach, of_phase.shape[1])
    place = (np.arange(n_samples) - (n_samples - 1) / 2) / n_samples
    ramp = np.fft.fft(place)[number]
    upper = (number > last[:, np.newaxis] / 2) & (number <= last[:, np.newaxis])
    n_upper, weight = np.count_nonzero(upper, axis=1), np.maximum(upper @ np.abs(ramp) ** 2, 1e-300)
    jump = (np.where(upper, of_phase, 0.0) @ np.conj(ramp)).real / weight
    even = np.where(number <= last[:, np.newaxis], of_phase - jump[:, np.newaxis] * ramp, 0.0)

    def is_noise(lines: Complexes, count: Ints) -> Bools:
        return np.asarray(np.sum(np.abs(lines) ** 2, axis=1) < 2 * count * floor * (1 + STEADY / np.sqrt(count)))

    first, ratio = np.abs(series.first), np.abs(series.ratio)
    power = np.sum(np.abs(of_phase) ** 2, axis=1)
    square = 2 * np.maximum(power - 2 * last * floor, 0.0) / (n_samples * first) ** 2
    missed = np.hypot(np.sqrt(floor / weight) / (2 * np.pi * line * first), RISE * square * ratio)
    small = (square < LARGEST_SMALL**2) & (missed < HARMLESS * np.sqrt(2 * floor) / (n_samples * first))
    small &= (n_upper > 2) & is_noise(of_amplitude, last)
    rows = never_alone(np.flatnonzero(small & is_noise(np.where(upper, even, 0.0), np.maximum(n_upper, 1))))
    lines = np.zeros((rows.size, n_samples // 2 + 1), dtype=np.complex128)
    lines[:, number] = even[rows]
    phase = (np.fft.irfft(lines, n_samples) + jump[rows, np.newaxis] * place) / first[rows, np.newaxis]
    phase = phase.astype(values.dtype)
    step, inverse, rest = np.empty((rows.size, 6)), np.empty((rows.size, 6, 6)), values[rows]
    for begin in range(0, rows.size, STEPS_AT_ONCE):
        few = slice(begin, begin + STEPS_AT_ONCE)
        some = series.take(rows[few])
        along = carrier_of(some.omega, n_samples, rest.dtype)
        along *= np.cos(phase[few]) + 1j * np.sin(phase[few])
        tangents, rest[few] = tangents_along(along, rest[few], None, some)
        step[few], inverse[few] = step_by_samples(tangents, rest[few]).solve_and_invert()
        rest[few] -= (step[few, np.newaxis].astype(rest.dtype) @ tangents)[:, 0]
    degrees = np.asarray(n_samples - 6.0 - 2.0 * reach[rows], dtype=np.float64)
    variance = np.vecdot(rest, rest).astype(np.float64) / degrees
    nothing, wander = np.zeros(rows.size), np.full(rows.size, int(Flag.RATE_WANDER), dtype=np.int64)
    return rows, MovingFits(
        series.take(rows).moved(step, n_samples), inverse * variance[:, np.newaxis, np.newaxis], variance, degrees,
        rest, nothing == 0, wander, nothing, nothing > 0, nothing, nothing + 1, missed[rows],
    )  # fmt: skip
