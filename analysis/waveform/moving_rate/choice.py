"""How many terms the motion needs: the data decide.

At the minimum of a fit with more than enough terms its normal equations tell what any fit with fewer would leave:
with N = L L' and the terms to be dropped last, dropping the last k of them costs the sum of the last k squares of
L' theta. The Bayesian information criterion is then known for every number of terms without another fit.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from analysis.arrays import Floats, Indices
from analysis.waveform.moving_rate.trajectory import Fitted, Terms, Trajectory

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
