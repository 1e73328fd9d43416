"""A rate that takes two values, which no low polynomial describes; or a time base that does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Floats
from analysis.waveform.moving_rate.trajectory import Fitted, Record, Trajectory, rate_columns

PLACES = 100
"""So many places of a step are tried, and all samples beside the best of them."""

END = 0.04
"""Share of the record at either end in which no step is looked for: what happens there hardly moves the ratio."""

LEFT_BY_STEP = 0.16
"""Share of the phase's departure from a steady rate that may remain beside a step. Of an even change of the rate,
the smooth motion which is most like a step, a quarter remains."""

LOOSENESS = (1e-2, 1e-4, 1e-6)
"""Times the squared amplitude, in turn, before the last one of the caller."""

ITERATIONS, LAST_ITERATIONS = 4, 8

SURE = 15.0
"""-2 log likelihood by which a step of the time base must be likelier than one of the rate to be called one."""

LARGEST = 50.0
"""Logarithm at which likelihoods are cut off."""

FARTHEST = 100
"""Samples by which a step is moved at once."""


@dataclass(frozen=True)
class Stepped:
    """fitted : with two rates
    pull_u : rad per sample, what b may be off by because the time base may have stepped
    stretched : whether it has
    """

    fitted: Fitted
    pull_u: float
    stretched: bool


def with_rate_step(record: Record, fitted: Fitted, looseness: float) -> Stepped | None:
    """The fit with two rates instead, where they explain the record better than `fitted` does with what it has.

    Where a(t) steps, W may have stepped, or the time base. Then b steps too, and the lock-in rate is that of one
    part or the other, in units of the time base that is stated. Both are tried, and each is as likely as it fits.
    """
    found = _found_step(fitted)
    if found is None:
        return None
    old = fitted.trajectory
    rate = np.array([1.0, found[1], 0.0]) * old.rate[0]
    terms = replace(old.terms, rate=3, jump=found[0])
    start = Trajectory(old.phase, np.concatenate([rate, old.parameters[old.terms.rate :]]), terms)
    try:
        steady = _fit(record, start, looseness)
        start = steady.trajectory
        stretched = _fit(record, replace(start, terms=replace(start.terms, stretched=True)), looseness)
    except np.linalg.LinAlgError:
        return None
    best = min(steady, stretched, key=lambda one: one.cost)
    better = fitted.evidence - best.evidence
    if fitted.looseness <= looseness:
        dropped = old.terms.count - terms.count
        better = (fitted.cost - best.cost) / fitted.variance + np.log(record.count) * dropped
    if not better > 0:
        return None
    surer = (steady.cost - stretched.cost) / best.variance
    taken = stretched if surer > SURE else steady
    at = stretched.trajectory
    levels = (at.rate @ rate_columns(at.phase.size, at.terms)[1])[[0, -1]] / at.rate[0]
    away = np.abs(np.hypot(*at.pull) * levels - np.hypot(*taken.trajectory.pull)).max()
    chance = 1 / (1 + np.exp(-np.clip(surer / 2, -LARGEST, LARGEST)))
    return Stepped(taken, float(away * np.sqrt(chance)), taken is stretched)


def _found_step(fitted: Fitted) -> tuple[int, float] | None:
    """Place and size, over the mean rate, of the step, if the rate takes two values and does nothing else."""
    trajectory = fitted.trajectory
    # what moves the phase beside the equation is motion of the rate too
    advances = trajectory.rate @ rate_columns(trajectory.phase.size, trajectory.terms)[1] + fitted.moved
    size = advances.size
    angle = np.concatenate([[0.0], np.cumsum(advances)])
    bent = _without_line(angle)
    places = np.linspace(END * size, (1 - END) * size, PLACES).astype(int)
    best = _best_place(bent, places)[0]
    place, jump, left = _best_place(bent, np.arange(best - size // PLACES, best + size // PLACES + 1))
    if not left <= LEFT_BY_STEP**2 * float(bent @ bent):
        return None
    return place, jump / (angle[-1] - angle[0]) * size


def _fit(record: Record, start: Trajectory, looseness: float) -> Fitted:
    """From loose to exact, the step moved to where it belongs in between."""
    scale = float(start.amplitude[0]) ** 2
    for looser in LOOSENESS:
        start = _moved(record.fit(start, looser / scale, ITERATIONS).trajectory)
    return record.fit(start, looseness, LAST_ITERATIONS)


def _moved(trajectory: Trajectory) -> Trajectory:
    """The jump where it belongs: one that came early has made up for it in the step in which it is said to be."""
    terms = trajectory.terms
    jump, made_up = (float(term) for term in trajectory.rate[-2:])
    early = np.floor(made_up / jump) if jump else 0.0
    if not 0 < abs(early) < FARTHEST:
        return trajectory
    parameters = trajectory.parameters.copy()
    parameters[terms.rate - 1] -= early * jump
    return replace(trajectory, parameters=parameters, terms=replace(terms, jump=int((terms.jump or 0) - early)))


def _without_line(values: Floats) -> Floats:
    """(..., N) less their straight lines."""
    places = np.arange(values.shape[-1]) - (values.shape[-1] - 1) / 2
    slope = values @ places / (places @ places)
    return np.asarray(values - values.mean(axis=-1, keepdims=True) - slope[..., np.newaxis] * places)


def _best_place(bent: Floats, places: np.ndarray) -> tuple[int, float, float]:
    """Place at which a kink leaves least of a curve without its line, the kink, and the power that is left."""
    kinks = _without_line(np.maximum(np.arange(bent.size) - places[:, np.newaxis], 0.0))
    power, along = np.vecdot(kinks, kinks), kinks @ bent
    best = int(np.argmax(along**2 / power))
    return int(places[best]), float(along[best] / power[best]), float(bent @ bent - along[best] ** 2 / power[best])
