"""Fit of one record whose rate moves, whose intensity drifts or whose baseline moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Floats
from analysis.flags import Flag
from analysis.waveform.misfit import line_stands_out
from analysis.waveform.moving_rate.choice import terms_needed, with_terms
from analysis.waveform.moving_rate.first_phase import FirstPhase, first_phase
from analysis.waveform.moving_rate.matching import matched_motion
from analysis.waveform.moving_rate.polynomials import HIGHEST
from analysis.waveform.moving_rate.rate_step import Stepped, with_rate_step
from analysis.waveform.moving_rate.trajectory import Fitted, Record, Terms, Trajectory, rate_columns

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
    """One record, and the beat that a gyro at its mean rate would have shown.

    offset, first, ratio, omega : c0, H, q and w of that beat, phases from the middle of the record, w in rad per
        sample
    covariance : (6, 6) in the order c0, Re H, Im H, Re q, Im q, w (rad at the record's ends)
    variance : of the noise of a sample
    degrees : samples less parameters
    left : (N,) residual
    flags : what moved
    walk : rad, rms, by which noise of the rate moved the phase over the record; 0 where there is none
    vibrates : whether that noise holds a line, which no noise has, or has taken up all there is
    drift, drift_chance : change of the size of the ratio from the middle of the record to its end if the lock-in
        rate drifted, and the share of records in which noise alone shows so much
    stepped_u : standard uncertainty of the size of the ratio where the rate stepped, because the time base may
        have stepped instead
    """

    offset: float
    first: complex
    ratio: complex
    omega: float
    covariance: Floats
    variance: float
    degrees: float
    left: Floats
    flags: int
    walk: float
    vibrates: bool
    drift: float
    drift_chance: float
    stepped_u: float


def fit_moving_rate(values: Floats, mask: Floats) -> MovingFit | None:
    """Fit one record."""
    seen = first_phase(values, mask)
    if seen is None:
        return None
    record = Record(values, mask)
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


def _fitted(record: Record, seen: FirstPhase) -> tuple[Fitted, Terms, bool]:
    """The fit, the terms that the data ask for, and whether the rate is noisy."""
    scale = float(np.mean(seen.amplitude)) ** 2
    rough = _roughly(Record(record.values, record.mask * seen.trusted), seen, scale)
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


def _roughly(record: Record, seen: FirstPhase, scale: float) -> Fitted:
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


def _with_step_moved(record: Record, trajectory: Trajectory, seen: FirstPhase) -> Trajectory:
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


def _with_noise_of_the_rate(record: Record, fitted: Fitted) -> tuple[Fitted, Terms]:
    """The fit at the looseness of greatest likelihood, and the terms that are needed beside such noise.

    No more of them are kept: the noise takes up what they leave.
    """
    width = float(np.log(LOOSENESS[0] / LOOSENESS[1])) / 2
    roughly = _likeliest(record, fitted, width, COARSEST)
    needed = terms_needed(roughly, record.count)
    again = record.fit(with_terms(roughly, needed), roughly.looseness, ITERATIONS)
    return _likeliest(record, again, COARSEST, FINEST), needed


def _likeliest(record: Record, fitted: Fitted, width: float, finest: float) -> Fitted:
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


def _as_beat(record: Record, fitted: Fitted, *, noisy: bool, moves: bool) -> MovingFit | None:
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
