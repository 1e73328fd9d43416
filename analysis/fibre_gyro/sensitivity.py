"""Sensitivity of an output to one stimulus of its surroundings; bias and scale factor from six positions.

At visit i, in the middle of which it is t_i, a stimulus has the value s_i, and the output (or a scale factor) is

    N_i = b(t_i) + k (s_i - s_0)

The baseline b is what the visits to the reference s_0 show, a straight line from each to the next: so k comes from
differential means, and a drift takes nothing that is even between two references. Without references on both sides
b is one straight line. What the visits scatter by beyond their noise is found as among runs of a rate table.

Six positions (tumble), the input axis along either sense of three directions at right angles, at rest:

    N_j+- = B +- K w_j,    (K w_E)^2 = sum of ((N_j+ - N_j-)/2)^2,    B = mean of all six

whatever the latitude and the azimuth are. A position that is off by an angle d of unknown direction sees d w more
across: what is known of the fixture counts at each of the six.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.fibre_gyro.injection import SlopeFit
from analysis.fibre_gyro.scatter import find_run_scatter
from analysis.rotation import EARTH_RATE_DPS


@dataclass(frozen=True)
class StimulusResponse:
    """How a value goes with a stimulus, in units of the value."""

    slope: float  # k, by unit of the stimulus
    slope_u: float
    reference: float  # s_0: the stimulus visited most often, of these the smallest
    by_reference: bool  # whether there is a reference before and after every other visit
    repeated: bool  # whether there are more visits than unknowns, so that their scatter shows
    stimulus: Floats  # (n,): at each visit, and value less baseline there, with its standard uncertainty
    difference: Floats
    difference_u: Floats
    level: Floats  # (m,): each value of the stimulus but the reference
    change: Floats  # (m,): mean difference there, with its standard uncertainty
    change_u: Floats
    bend: float  # the quadratic part at the far end of the ladder, in its standard uncertainties; nan: not known

    @property
    def largest(self) -> int:
        """Row of `level` with the largest change."""
        return int(np.argmax(np.abs(self.change)))


def stimulus_response(stimulus: ArrayLike, value: ArrayLike, u: ArrayLike, at_s: ArrayLike) -> StimulusResponse:
    """Slope and changes from means at several values of a stimulus.

    Parameters
    ----------
    stimulus, value, u, at_s : array_like, shape (n,)
        Stimulus, mean, its standard uncertainty by noise, and time of the middle, s; in any order.

    Raises
    ------
    ValueError
        There are fewer than three visits, or only one value of the stimulus.

    Examples
    --------
    >>> found = stimulus_response([0, 1, 0, -1, 0], [5.0, 5.3, 5.2, 5.1, 5.4], [0.01] * 5, [0, 1, 2, 3, 4])
    >>> round(found.slope, 12)
    0.2
    """
    order = np.argsort(np.asarray(at_s))
    s, values, noise, times = (np.asarray(one, dtype=np.float64)[order] for one in (stimulus, value, u, at_s))
    levels, visits = np.unique(s, return_counts=True)
    if s.size < 3 or levels.size < 2:
        raise ValueError("a sensitivity needs three means at two values of the stimulus")
    reference = float(min(levels[visits == visits.max()], key=abs))
    at_reference = np.flatnonzero(s == reference)
    by_reference = at_reference.size > 1 and at_reference[0] == 0 and at_reference[-1] == s.size - 1
    if by_reference:
        known = times[at_reference]
        baseline = np.stack([np.interp(times, known, row) for row in np.eye(known.size)], axis=1)
    else:
        middle = times - times.mean()
        drifts = s.size > 3 and np.linalg.matrix_rank(np.stack([np.ones_like(s), middle, s])) == 3
        baseline = np.stack([np.ones_like(s), middle] if drifts else [np.ones_like(s)], axis=1)
    away = s - reference
    design = np.column_stack([baseline, away])
    # the scatter is that of one visit among its like: it does not grow with the output
    level = values - values.mean() + np.ptp(values) + noise.max()
    scatter = find_run_scatter(design, level, noise, None)
    factors = scatter.estimator(design)
    by_level = np.stack([(s == one).astype(np.float64) for one in levels if one != reference], axis=1)
    of_levels = scatter.estimator(np.column_stack([baseline, by_level]))[baseline.shape[1] :]
    left = np.eye(s.size) - baseline @ factors[:-1]
    bend = np.nan
    if levels.size > 2:  # a curve would pass for scatter about the line
        curved = np.column_stack([design, (away / np.abs(away).max()) ** 2])
        about = find_run_scatter(curved, level, noise, None)
        quadratic = about.estimator(curved)[-1]
        bend = float(quadratic @ values) / about.standard_u(quadratic)
    return StimulusResponse(
        float(factors[-1] @ values),
        scatter.standard_u(factors[-1]),
        reference,
        bool(by_reference),
        not scatter.assumed,
        s,
        np.asarray(left @ values),
        np.array([scatter.standard_u(row) for row in left]),
        levels[levels != reference],
        np.asarray(of_levels @ values),
        np.array([scatter.standard_u(row) for row in of_levels]),
        bend,
    )


def tumble(means: ArrayLike, u: ArrayLike, off_rad: float) -> SlopeFit:
    """Evaluate six positions: slope K and intercept B; residuals and chi-square are those of the pairs' biases.

    Parameters
    ----------
    means, u : array_like, shape (3, 2)
        Mean output along either sense of three directions, counts, and its standard uncertainty by noise.
    off_rad : float
        What a position may be off by in any direction, rad: half width of a rectangle.
    """
    outputs, noise = np.asarray(means, dtype=np.float64), np.asarray(u, dtype=np.float64)
    half = (outputs[:, 0] - outputs[:, 1]) / 2
    half_u = np.hypot(noise[:, 0], noise[:, 1]) / 2
    earth = math.sqrt(max(float(np.sum(half**2 - half_u**2)), 0.0))  # a square of noise has a mean
    across = np.sqrt(np.maximum(np.sum(half**2) - half**2, 0.0)) * off_rad / np.sqrt(3)
    of_position = np.hypot(noise, across[:, np.newaxis])
    half_u = np.hypot(of_position[:, 0], of_position[:, 1]) / 2
    own = outputs.mean(axis=1) - outputs.mean()
    return SlopeFit(
        earth / EARTH_RATE_DPS,
        float(np.sqrt(np.sum((half * half_u) ** 2))) / max(earth, 1e-300) / EARTH_RATE_DPS,
        float(outputs.mean()),
        float(np.sqrt(np.sum(of_position**2))) / 6,
        own,
        float(np.sum((own / half_u) ** 2)),
        2,
    )
