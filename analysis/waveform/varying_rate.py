"""Fit of one record whose rate moves, whose intensity drifts or whose baseline moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.linalg

from analysis.arrays import Bools, Floats, Indices
from analysis.flags import Flag
from analysis.waveform.residuals import line_stands_out
from analysis.waveform.trajectory import (
    HIGHEST,
    Fitted,
    SampledRecord,
    Stepped,
    Terms,
    Trajectory,
    polynomials,
    rate_columns,
    with_rate_step,
)

SLOW_TERMS = 4
"""Polynomials of amplitude and offset to begin with: up to the third degree."""

RATE_TERMS, RATE_TERMS_PER_PERIOD = 6, 2.0
"""A motion as fast as the beat itself could not be told from lock-in: with so many polynomials per period, the
fastest has two thirds of the frequency of the beat."""

ENOUGH_TERMS, TERMS_FOR_A_THIRD = 130, 1.4
"""Of many periods not all that could be told apart are tried: so many, or those that reach a third of the beat."""

ROOM, ROOM_AT_LEAST = 1.25, 2
"""So many more polynomials of the rate are kept than the criterion asks for: it is content with a fault as large
as the noise."""

LOOSENESS = (1.0, 1e-2, 1e-4, 1e-6)
EXACT = 1e-8
"""Looseness times the squared amplitude, in turn. Over 2500 samples the last one moves the phase by a thousandth
of what the noise leaves unknown."""

ITERATIONS, LAST_ITERATIONS = 4, 8

NOISY_RATE = 12.0
"""-2 log likelihood by which noise of the rate must explain a record better than an exact motion."""

COARSEST, FINEST = 1.2, 0.1
"""Logarithm of the looseness to which such noise is found, before the terms are chosen, and after."""

SILENT = 1e-6
"""Noise over amplitude below which no converter goes: all there is has then been taken for noise of the rate."""

NEARLY_LOCKED = 0.99999

SLOWEST = 1.02
"""Rate over lock-in rate down to which a motion is believed: below it the gyro creeps, and what was fitted there
may be anything."""

AT_ENDS = 0.01
"""Share of the samples that may lie below: many polynomials are hardly known at the very ends of a record."""

FEW_PERIODS, SLOWED = 10.0, 0.35
"""With fewer periods than that a rate that falls below this share of its mean is doubtful too: a gyro that comes
to rest leaves too little of a beat to show it."""

WEAKEST = 0.3
"""The same for the amplitude, over its largest: a beam that is weaker than that was not drifting."""


@dataclass(frozen=True)
class MovingFit:
    """One record, and the beat that a gyro at its mean rate would have shown."""

    offset: float  # c0, H, q and w of that beat, phases from the middle of the record, w in rad per sample
    first: complex
    ratio: complex
    omega: float
    covariance: Floats  # (6, 6) in the order c0, Re H, Im H, Re q, Im q, w (rad at the record's ends)
    variance: float  # of the noise of a sample
    degrees: float  # samples less parameters
    left: Floats  # (N,) residual
    flags: int  # what moved
    walk: float  # rad, rms, by which noise of the rate moved the phase over the record; 0 where there is none
    vibrates: bool  # whether that noise holds a line, which no noise has, or has taken up all there is
    # change of the size of the ratio from the middle of the record to its end if the lock-in rate drifted, and the
    # share of records in which noise alone shows so much
    drift: float
    drift_chance: float
    # standard uncertainty of the size of the ratio where the rate stepped, because the time base may have stepped
    # instead
    stepped_u: float


def fit_moving_rate(values: Floats, mask: Floats) -> MovingFit | None:
    """Fit one record."""
    seen = first_phase(values, mask)
    if seen is None:
        return None
    record = SampledRecord(values, mask)
    try:
        with np.errstate(all="ignore"):  # a step too far gives nan, and is taken back
            fitted, needed, noisy = _fitted(record, seen)
            stepped = None
            if noisy or needed.rate > 1:
                stepped = with_rate_step(record, fitted, EXACT / float(np.mean(seen.amplitude)) ** 2)
            if stepped is None:
                return _as_beat(record, fitted, noisy=noisy, moves=noisy or needed.rate > 1)
            return _with_step(_as_beat(record, stepped.fitted, noisy=False, moves=True), stepped)
    except np.linalg.LinAlgError:
        return None


def _fitted(record: SampledRecord, seen: FirstPhase) -> tuple[Fitted, Terms, bool]:
    """The fit, the terms that the data ask for, and whether the rate is noisy."""
    scale = float(np.mean(seen.amplitude)) ** 2
    rough = _roughly(SampledRecord(record.values, record.mask * seen.trusted), seen, scale)
    trajectory = rough.trajectory if seen.step is None else _with_step_moved(record, rough.trajectory, seen)
    best = last = record.fit(trajectory, LOOSENESS[0] / scale, ITERATIONS)
    for looseness in LOOSENESS[1:]:
        last = record.fit(last.trajectory, looseness / scale, ITERATIONS)
        if last.evidence > best.evidence + NOISY_RATE:
            break
        best = min(best, last, key=lambda fitted: fitted.evidence)
    noisy = last.evidence > best.evidence + NOISY_RATE
    best = best if noisy else last
    needed = terms_needed(best, record.count)
    kept = replace(needed, rate=min(int(ROOM * needed.rate) + ROOM_AT_LEAST, best.trajectory.terms.rate))
    again = record.fit(with_terms(best, kept), best.looseness, ITERATIONS)
    if noisy:
        return *_with_noise_of_the_rate(record, again), True
    return record.fit(again.trajectory, EXACT / scale, LAST_ITERATIONS), needed, False


def _roughly(record: SampledRecord, seen: FirstPhase, scale: float) -> Fitted:
    """The phases followed wherever they go, then the motion that they show, and once more from there."""
    phase, slow = seen.phase, Terms(0, SLOW_TERMS, SLOW_TERMS, seen.step)
    of_amplitude, of_offset = record.columns(slow)
    amplitude = np.linalg.lstsq(of_amplitude.T, seen.amplitude, rcond=None)[0]
    offset = np.linalg.lstsq(of_offset.T, seen.offset, rcond=None)[0]
    for looseness in LOOSENESS[:2]:
        periods = (phase[-1] - phase[0]) / (2 * np.pi)
        most = int(
            min(
                HIGHEST,
                RATE_TERMS + RATE_TERMS_PER_PERIOD * periods,
                max(ENOUGH_TERMS, TERMS_FOR_A_THIRD * periods),
            )
        )
        motion = matched_motion(phase, (amplitude @ of_amplitude) * np.cos(phase) * record.mask, most)
        rate = np.zeros(min(int(ROOM * motion.rate.size) + ROOM_AT_LEAST, most))
        rate[: motion.rate.size] = motion.rate
        parameters = np.concatenate([rate, [motion.sine, motion.cosine], amplitude, offset])
        start = Trajectory(phase, parameters, replace(slow, rate=rate.size))
        fitted = record.fit(start, looseness / scale, ITERATIONS)
        phase, amplitude, offset = fitted.trajectory.phase, fitted.trajectory.amplitude, fitted.trajectory.offset
    return fitted


def _with_step_moved(record: SampledRecord, trajectory: Trajectory, seen: FirstPhase) -> Trajectory:
    """The step of the offset at the sample where the record says it is."""
    inside = np.flatnonzero(~seen.trusted)
    height = float(trajectory.parameters[-1])
    before = replace(trajectory, parameters=np.concatenate([trajectory.parameters[:-1], [0.0]]))
    left = ((record.values - record.waveform(before)) * record.mask)[inside]
    # sums of squares if the step comes before the i-th sample of these
    below = np.concatenate([[0.0], np.cumsum(left**2)])
    above = np.concatenate([np.cumsum(((left - height) ** 2)[::-1])[::-1], [0.0]])
    step = int(inside[0] + np.argmin(below + above))
    return replace(trajectory, terms=replace(trajectory.terms, step=step))


def _with_noise_of_the_rate(record: SampledRecord, fitted: Fitted) -> tuple[Fitted, Terms]:
    """The fit at the looseness of greatest likelihood, and the terms that are needed beside such noise."""
    # No more of them are kept: the noise takes up what they leave.
    width = float(np.log(LOOSENESS[0] / LOOSENESS[1])) / 2
    roughly = _likeliest(record, fitted, width, COARSEST)
    needed = terms_needed(roughly, record.count)
    again = record.fit(with_terms(roughly, needed), roughly.looseness, ITERATIONS)
    return _likeliest(record, again, COARSEST, FINEST), needed


def _likeliest(record: SampledRecord, fitted: Fitted, width: float, finest: float) -> Fitted:
    """The fit at the looseness of greatest likelihood; `width` and `finest` are steps of its logarithm."""
    tried, middle = {0.0: fitted}, 0.0
    while width > finest:
        for place in (middle - width, middle + width):
            if place not in tried:
                near = tried[middle].trajectory
                tried[place] = record.fit(near, fitted.looseness * np.exp(place), ITERATIONS)
        best = min(tried, key=lambda place: tried[place].evidence)
        width, middle = width / 2 if best == middle else width, best
    return tried[middle]


def _as_beat(record: SampledRecord, fitted: Fitted, *, noisy: bool, moves: bool) -> MovingFit | None:
    """What a gyro at the mean rate would have shown; None where it would be locked."""
    trajectory, terms, n_samples = fitted.trajectory, fitted.trajectory.terms, record.values.size
    rate, pull = float(trajectory.rate[0]), complex(*trajectory.pull)
    size = abs(pull)
    x = size / rate
    if not (np.isfinite(fitted.variance) and 0 < x < NEARLY_LOCKED):
        return None
    to_amplitude, to_offset = record.columns(terms)
    amplitude, offset = (
        float(np.mean(c)) for c in (trajectory.amplitude @ to_amplitude, trajectory.offset @ to_offset)
    )
    root = np.sqrt((1 - x) * (1 + x))
    ratio, omega = x / (1 + root), rate * root
    turn = pull / size
    middle = np.interp((n_samples - 1) / 2, np.arange(n_samples), trajectory.phase)
    # exp(i psi) = i (r - u)/(1 - r u) with u the phasor of the beat, psi the phase less gamma
    z = np.exp(1j * middle) / turn
    u = (z - 1j * ratio) / (ratio * z - 1j)
    q = ratio * u
    # frequency, size of q, its direction, by a, s, c
    jacobian = np.zeros((3, 3))
    along, across = np.array([turn.real, turn.imag]), np.array([-turn.imag, turn.real])
    jacobian[0, 0], jacobian[0, 1:] = rate / omega, -size / omega * along
    jacobian[1, 0], jacobian[1, 1:] = -ratio / (root * rate), ratio / (root * size) * along
    jacobian[2, 1:] = -across / size
    to_parameters = np.zeros((6, 3))
    to_parameters[3:5, 1] = u.real, u.imag
    to_parameters[3:5, 2] = -q.imag, q.real
    to_parameters[5, 0] = n_samples / 2
    whole = to_parameters @ jacobian
    places = np.array([0, terms.rate, terms.rate + 1])
    covariance = fitted.covariance[np.ix_(places, places)]
    if not np.linalg.eigvalsh(covariance).min() > 0:
        return None
    flags = int(Flag.RATE_WANDER) if moves else 0
    if _goes_too_far(trajectory, to_amplitude, n_samples):
        flags |= int(Flag.MISFIT)
    if _nearly_rests(trajectory):
        flags |= int(Flag.PARTS_DIFFER)
    silent = fitted.variance < (SILENT * amplitude) ** 2
    gain, gain_covariance = record.drift_of_pull(fitted)
    chi_square = float(gain @ np.linalg.solve(gain_covariance, gain))
    return MovingFit(
        offset=offset + amplitude * ratio * turn.real,
        first=complex(-amplitude * turn * (1 - ratio**2) * u),
        ratio=complex(q),
        omega=omega,
        covariance=whole @ covariance @ whole.T,
        variance=fitted.variance,
        degrees=fitted.degrees,
        left=fitted.left,
        flags=flags,
        walk=float(np.sqrt(fitted.looseness * fitted.variance * n_samples)) if noisy else 0.0,
        vibrates=noisy and (silent or line_stands_out(np.abs(np.fft.rfft(fitted.moved)[1:]) ** 2)),
        drift=float(ratio / (root * size) * np.linalg.norm(gain)),
        drift_chance=float(np.exp(-chi_square / 2)),
        stepped_u=0.0,
    )


def _with_step(fit: MovingFit | None, stepped: Stepped) -> MovingFit | None:
    """With what a step of the time base may have done to the ratio."""
    if fit is None:
        return None
    trajectory, ratio = stepped.fitted.trajectory, abs(fit.ratio)
    root = (1 - ratio**2) / (1 + ratio**2)
    differ = int(Flag.PARTS_DIFFER) if stepped.stretched else 0
    u = ratio / (root * float(np.hypot(*trajectory.pull))) * stepped.pull_u
    return replace(fit, stepped_u=u, flags=fit.flags | differ)


def _nearly_rests(trajectory: Trajectory) -> bool:
    """Whether a rate of few periods falls to a small share of its mean."""
    few = trajectory.phase[-1] - trajectory.phase[0] < 2 * np.pi * FEW_PERIODS
    rate = trajectory.rate @ rate_columns(trajectory.phase.size, trajectory.terms)[0]
    return bool(few and np.quantile(rate, AT_ENDS) < SLOWED * trajectory.rate[0])


def _goes_too_far(trajectory: Trajectory, to_amplitude: Floats, n_samples: int) -> bool:
    """Whether the gyro would have come close to lock-in, or the beam would have been lost, for a part."""
    rate = trajectory.rate @ rate_columns(n_samples, trajectory.terms)[0]
    height = trajectory.amplitude @ to_amplitude
    moves = rate.max() > rate.min()
    too_slow = moves and float(np.quantile(rate, AT_ENDS)) < SLOWEST * float(np.hypot(*trajectory.pull))
    return bool(too_slow or height.min() < WEAKEST * height.max())


# --------------------
# How many terms the motion needs: the data decide.
#
# At the minimum of a fit with more than enough terms its normal equations tell what any fit with fewer would
# leave: with N = L L' and the terms to be dropped last, dropping the last k of them costs the sum of the last k
# squares of L' theta. The Bayesian information criterion is then known for every number of terms without another
# fit


RIDGE = 1e-12


def terms_needed(fitted: Fitted, count: float) -> Terms:
    """Least Bayesian criterion among all numbers of terms up to those of a fit."""
    terms, parameters = fitted.trajectory.terms, fitted.trajectory.parameters
    price = np.log(count)
    best, least = terms, np.inf
    steps = (terms.step,) if terms.step is None else (terms.step, None)
    for amplitude, offset, step in product(range(1, terms.amplitude + 1), range(1, terms.offset + 1), steps):
        fewer = Terms(terms.rate, amplitude, offset, step)
        kept = _places(terms, fewer)
        dropped = np.setdiff1d(np.arange(terms.count), kept)
        order = np.concatenate([kept[terms.rate :], kept[: terms.rate], dropped])
        costs = _cost_of_dropping(fitted.normal[np.ix_(order, order)], parameters[order])
        first = terms.count - dropped.size - terms.rate
        # after the n-th coefficient of the rate everything is dropped
        cost = costs[first + 1 : first + terms.rate + 1]
        others = fewer.count - terms.rate
        criterion = cost / fitted.variance + price * (others + np.arange(1, terms.rate + 1))
        number = int(criterion.argmin())
        if criterion[number] < least:
            best, least = replace(fewer, rate=number + 1), float(criterion[number])
    return best


def with_terms(fitted: Fitted, terms: Terms) -> Trajectory:
    """The trajectory with fewer terms, the others as they come out best without those that are dropped."""
    trajectory, normal = fitted.trajectory, fitted.normal
    kept = _places(trajectory.terms, terms)
    dropped = np.setdiff1d(np.arange(trajectory.terms.count), kept)
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    scaled = normal * scale * scale[:, np.newaxis]
    scaled[np.diag_indices_from(scaled)] += RIDGE
    taken_over = scaled[np.ix_(kept, dropped)] @ (trajectory.parameters[dropped] / scale[dropped])
    parameters = trajectory.parameters[kept] + scale[kept] * np.linalg.solve(
        scaled[np.ix_(kept, kept)], taken_over
    )
    return Trajectory(trajectory.phase, parameters, terms)


def _places(terms: Terms, fewer: Terms) -> Indices:
    """Where the parameters of `fewer` terms stand among those of all."""
    first = terms.rate + 2
    second = first + terms.amplitude
    parts = [
        np.arange(fewer.rate),
        np.arange(terms.rate, first),
        first + np.arange(fewer.amplitude),
        second + np.arange(fewer.offset),
    ]
    if fewer.step is not None:
        parts.append(np.array([terms.count - 1]))
    # the rate first, as in `Trajectory`
    return np.concatenate(parts)


def _cost_of_dropping(normal: Floats, parameters: Floats) -> Floats:
    """What the fit would leave more if all parameters from number i on were zero, (P + 1,)."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    scaled = normal * scale * scale[:, np.newaxis]
    scaled[np.diag_indices_from(scaled)] += RIDGE
    squares = (np.linalg.cholesky(scaled).T @ (parameters / scale)) ** 2
    return np.concatenate([np.cumsum(squares[::-1])[::-1], [0.0]])


# --------------------
# First values of the rate's motion from a phase that is known roughly: a linear problem.
#
# Integrated, the lock-in equation is linear in all that is not the phase:
#
#     phi(t) = phi_0 + sum over j of a_j I_j(t) - s S(t) + c C(t)
#
# with I_j, S, C the integrals of the polynomials, of sin(phi) and of cos(phi). Weighted by A cos(phi), which turns
# an error of the phase into one of the sample, its least squares are nearly those of the samples themselves


MATCHING_RIDGE = 1e-12


@dataclass(frozen=True)
class VaryingRate:
    """rate (J,): Legendre coefficients of a(t), rad per sample; sine, cosine: s and c."""

    rate: Floats
    sine: float
    cosine: float


def matched_motion(phase: Floats, weights: Floats, terms: int) -> VaryingRate:
    """Motion with as many polynomials as the phase asks for (Bayesian information criterion), at most `terms`."""
    others = [np.ones(phase.size), -_integral(np.sin(phase)), _integral(np.cos(phase))]
    columns = np.concatenate([others, polynomials(phase.size).integrals[:terms]])
    columns *= weights
    target = weights * phase
    normal = columns @ columns.T
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    normal *= scale
    normal *= scale[:, np.newaxis]
    normal[np.diag_indices_from(normal)] += MATCHING_RIDGE
    factor = scipy.linalg.cholesky(normal, lower=True)
    # The factor is nested: what each further polynomial explains is one square.
    explained = scipy.linalg.solve_triangular(factor, scale * (columns @ target), lower=True)
    left = np.maximum(target @ target - np.cumsum(explained**2)[3:], 1e-300)
    count = np.count_nonzero(weights)
    degree = int(np.argmin(count * np.log(left) + np.log(count) * np.arange(left.size)))
    size = degree + 4
    solution = scale[:size] * scipy.linalg.solve_triangular(factor[:size, :size].T, explained[:size])
    return VaryingRate(solution[3:], float(solution[1]), float(solution[2]))


def _integral(values: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2)])


# --------------------
# The phase of a beat read from its samples, without any model of how the rate moves.
#
# A gyro's beat is A sin(phi) with phi always rising: between a crest and the trough that follows, phi is the arc
# sine of the sample. Wander of any size, sidebands and a fundamental that is nowhere in the spectrum do not matter


SWUNG = 0.25
"""Share of the amplitude by which the signal must cross its middle to begin the next half period."""

REACHED = 0.9
"""Share of the amplitude from which on the first and the last extreme of a record count as a crest."""

QUIET = 0.06
"""Noise over amplitude at which crests are found without smoothing."""

KEPT_LINES = 3
"""Smoothing keeps at least so many times the frequency of the strongest line."""

FEWEST_CRESTS = 6
ENVELOPE_TERMS = 4

STEP_STANDS_OUT = 12.0
"""A step of the offset is believed where it lowers the scatter of the middles by this factor of its variance, in
logarithms times their number; a wrong one costs little, since the fit drops it again."""


NOT_APART = 1e-9
"""Determinant of two columns from which on they count as one."""


@dataclass(frozen=True)
class FirstPhase:
    """phase (N,) rad; amplitude, offset (N,) as low polynomials of time, the offset with its step."""

    phase: Floats
    amplitude: Floats
    offset: Floats
    trusted: Bools  # (N,) samples at which the step, if there is one, leaves no doubt about the phase
    step: int | None  # number of the first sample behind a step of the offset, or None


def first_phase(values: Floats, mask: Floats) -> FirstPhase | None:
    """Read the phase of one centred record (N,); `mask` is 0 where a sample is missing. None: there is no beat."""
    valid = mask > 0
    places = np.arange(values.size)
    filled = values if valid.all() else np.interp(places, places[valid], values[valid])
    smooth = _smoothed(filled)
    crests, signs = _crests(smooth)
    if crests.size < FEWEST_CRESTS:
        return None
    envelope = _Envelope.of(crests[1:-1], smooth[crests[1:-1]], signs[1:-1], values.size)
    if np.any(envelope.amplitude <= 0):
        return None
    level = np.clip((smooth - envelope.offset) / envelope.amplitude, -1.0, 1.0)
    passed = crests.copy()
    reached = np.abs(level[crests]) > REACHED
    if passed[0] == 0 or not reached[0]:
        passed[0] = -1
    if passed[-1] == values.size - 1 or not reached[-1]:
        passed[-1] = values.size
    # half turns: even while the beat rises
    half_turns = np.searchsorted(passed, places, side="right") + (signs[0] < 0)
    phase = half_turns * np.pi + np.where(half_turns % 2 == 0, 1, -1) * np.arcsin(level)
    return FirstPhase(_bridged(phase, valid), envelope.amplitude, envelope.offset, envelope.trusted, envelope.step)


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


def _crests(values: Floats) -> tuple[Indices, Floats]:
    """Places of highest and lowest samples in turn, and which is which (1, -1), by a trigger with hysteresis."""
    middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
    side = np.sign(values - middle) * (np.abs(values - middle) > SWUNG * half)
    seen = np.maximum.accumulate(np.where(side != 0, np.arange(values.size), 0))
    side = side[np.maximum(seen, int(np.argmax(side != 0)))]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(side)) + 1])
    pieces = np.split(values * side, starts[1:])
    return starts + np.array([int(piece.argmax()) for piece in pieces]), side[starts]


@dataclass(frozen=True)
class _Envelope:
    amplitude: Floats
    offset: Floats
    trusted: Bools
    step: int | None

    @staticmethod
    def of(crests: Indices, heights: Floats, signs: Floats, n_samples: int) -> _Envelope:
        """Amplitude and offset from what two neighbouring crests have in common, and in what they differ."""
        middles, halves = (heights[1:] + heights[:-1]) / 2, (heights[:-1] - heights[1:]) / 2 * signs[:-1]
        terms = min(ENVELOPE_TERMS, max(1, middles.size // 3))
        columns = polynomials(n_samples).values[:terms]
        between = (crests[1:] + crests[:-1]) // 2
        amplitude = np.linalg.lstsq(columns[:, between].T, halves, rcond=None)[0] @ columns
        trusted, places = np.ones(n_samples, dtype=bool), np.arange(n_samples)
        number = _step_between(columns[:, between], middles)
        if number is None:
            return _Envelope(
                amplitude, np.linalg.lstsq(columns[:, between].T, middles, rcond=None)[0] @ columns, trusted, None
            )
        # Middle `number` belongs to two crests, one on either side of the step.
        step = int(between[number])
        trusted[crests[number] : crests[number + 1] + 1] = False
        behind = np.concatenate([columns, [(places >= step).astype(float)]])
        others = np.arange(middles.size) != number
        found = np.linalg.lstsq(behind[:, between[others]].T, middles[others], rcond=None)[0]
        return _Envelope(amplitude, found @ behind, trusted, step)


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


def _bridged(phase: Floats, valid: Bools) -> Floats:
    """The phase with the whole turns put in that were lost where samples are missing."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], valid.astype(int), [1]])))
    speed = (phase[-1] - phase[0]) / phase.size
    for start, stop in edges.reshape(-1, 2):
        if start > 0 and stop < phase.size and (stop - start) * speed > 1:
            expected = speed * (stop - start + 1)
            turns = np.rint((expected - (phase[stop] - phase[start - 1])) / (2 * np.pi))
            phase[start:stop] += np.linspace(0, 2 * np.pi * turns, stop - start)
            phase[stop:] += 2 * np.pi * turns
    return phase


# --------------------
# Whether what a steady fit leaves of a record may come from a motion of the rate, the intensity, the baseline


BESIDE = 0.5
"""Share of its frequency about the fundamental in which sidebands are looked for."""

LOWEST, NEXT = slice(0, 3), slice(7, 24)
"""Lines 1 to 3, where a drift or a step of the baseline stands, and lines 8 to 24."""

STEEP = 30.0
"""A drift falls as the square of the frequency, by about 90 from the ones to the others; noise as 1/f by 9."""

LARGE = 0.1
"""Share of the power of the beat from which on what is left has no direction: the phase moves by 0.3 rad."""

MOST_REPEATING = 0.5
"""Share of what stands above the noise that may repeat with the beat; a motion leaves sidebands, which do not."""

HARMONICS = 8

ONE_SIDED = 6.0
"""Surplus of the stronger of phase and amplitude over the other, in its scatter for noise."""


def may_be_motion(left: Floats, omega: float, first: complex, ratio: float) -> bool:
    """Whether what the fit at a steady rate leaves is that of a moving phase, amplitude or baseline."""
    # Distortion leaves harmonics, which no motion would mend. A wander of s rad wanders by k s at the k-th
    # harmonic, so its sidebands there have k^2 r^(2k-2) of the power of those about the fundamental; the ratio
    # found at a steady rate is too small, which the power 1.5 allows for. Noise of whatever colour moves phase and
    # amplitude alike, a motion of the rate the phase alone, one of the intensity the amplitude.
    power = np.abs(np.fft.rfft(left)[1:]) ** 2
    if _repeats(left, omega, power):
        return False
    if power.size > NEXT.stop and power[LOWEST].mean() > STEEP * np.median(power[NEXT]) / np.log(2):
        return True
    floor = float(np.median(power)) / np.log(2)
    line = omega * left.size / (2 * np.pi)
    bins = np.arange(1, power.size + 1)
    beside = (bins > (1 - BESIDE) * line) & (bins < (1 + BESIDE) * line)
    of_fundamental = (1 - ratio**2) ** 3 / (1 + ratio**2)
    surplus, of_all = float((power[beside] - floor).sum()), float((power - floor).sum())
    if not surplus > 0.5 * of_fundamental**1.5 * of_all:
        return False
    return bool(left @ left > LARGE * abs(first) ** 2 / 2 * left.size) or _has_direction(left, omega, first, line)


def _repeats(left: Floats, omega: float, power: Floats) -> bool:
    """Whether most of what the fit leaves beside noise is harmonics of the beat, as a filter leaves them."""
    time = np.arange(left.size) - (left.size - 1) / 2
    turns = np.exp(1j * omega * np.outer(np.arange(1, HARMONICS + 1), time))
    columns = np.concatenate([turns.real, turns.imag]).T
    found, _, rank, _ = np.linalg.lstsq(columns, left, rcond=1e-6)
    noise = float(np.median(power)) / np.log(2) / left.size  # variance of a sample
    repeating = float(np.sum((columns @ found) ** 2)) - noise * int(rank)
    return bool(repeating > MOST_REPEATING * (float(left @ left) - noise * left.size))


def _has_direction(left: Floats, omega: float, first: complex, line: float) -> bool:
    """Whether the residual about the fundamental moves its phase and its amplitude by different amounts."""
    time = np.arange(left.size) - (left.size - 1) / 2
    lines = np.fft.fft(left * np.exp(-1j * omega * time) * np.conj(first))
    reach = max(BESIDE * line, 1.0)
    lines[np.abs(np.fft.fftfreq(left.size, 1 / left.size)) > reach] = 0.0
    moved = np.fft.ifft(lines)
    weaker, stronger = np.linalg.eigvalsh(np.cov(moved.real, moved.imag))
    return bool(stronger > (1 + ONE_SIDED / np.sqrt(reach)) * weaker)
