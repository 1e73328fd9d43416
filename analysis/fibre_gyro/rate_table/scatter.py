"""How far the runs of one axis scatter beyond their noise, and the uncertainty of what is computed from them.

A mean over whole turns knows the noise within its run. Between runs scale factor, table rate and bias change by
amounts that nobody states well. The residuals of the fit over all runs show them, with a few degrees of freedom
only, so every size of that scatter which they allow is weighed with its likelihood:

    variance of a run     v = u^2 + (s_0 F)^2 + rho^2 [ (1 - a) (F/F_rms)^2 + a ]
    likelihood            of the residuals given v (restricted: freed of the fitted parameters)
    prior                 1/(rho + u_rms/3) and a part at rho = 0, a even in 0..1

F is the run's own output, s_0 what is stated, rho the scatter beyond it, a the part of it that does not grow with
the output (bias) while the rest does (scale factor, table). What is linear in the means has, given rho and a, a
normal error; over all of them it is a mixture, whose 95 % interval is given. Where the scatter between runs rules,
that is Student's t; where their noise does, the normal interval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from analysis.arrays import Floats

NORMAL_95 = float(scipy.special.ndtri(0.975))
_SIZES, _PARTS = 32, 4
_NONE_BEYOND = 0.6  # weight of no scatter at all, in that of one up to the noise
_ASSUMED = 10e-6
"""Scatter of scale factor and table from run to run where no run repeats another and nobody states it: of a table
that is neither the best (1 ppm) nor a cheap one (100 ppm)."""


def few_values_factor(freedom: int) -> float:
    """By how much a standard deviation of few values is widened, so that 1.96 of it hold 95 %.

    Examples
    --------
    >>> round(few_values_factor(5), 3), round(few_values_factor(10_000), 3)
    (1.312, 1.0)
    """
    return float(scipy.special.stdtrit(max(freedom, 1), 0.975)) / NORMAL_95


@dataclass(frozen=True)
class RunScatter:
    """Variances that the runs may have.

    Attributes
    ----------
    variance : ndarray, shape (h, n)
        Of each run under each hypothesis, counts^2.
    weight : ndarray, shape (h,)
        Probability of each hypothesis.
    assumed : bool
        Whether the runs cannot show their scatter and nobody states it.
    """

    variance: Floats
    weight: Floats
    assumed: bool

    def mean_variance(self) -> Floats:
        """Mean of the variances, shape (n,)."""
        return np.asarray(self.weight @ self.variance, dtype=np.float64)

    def standard_u(self, combination: Floats) -> float:
        """Standard uncertainty of a combination of the means: 1.96 of it are the half width of the 95 % interval.

        Parameters
        ----------
        combination : ndarray, shape (n,)
            Factor of each mean.
        """
        sigma = np.sqrt(self.variance @ combination**2)
        low, high = 0.0, 60.0 * float(sigma.max()) + 1e-300
        sigma = np.maximum(sigma, 1e-300)
        for _ in range(60):
            middle = (low + high) / 2
            inside = float(self.weight @ scipy.special.ndtr(middle / sigma))
            low, high = (middle, high) if inside < 0.975 else (low, middle)
        return (low + high) / 2 / NORMAL_95


def find_run_scatter(design: Floats, mean: Floats, noise_u: Floats, stated: float | None) -> RunScatter:
    """Weigh the scatter that the residuals of the runs allow.

    Parameters
    ----------
    design : ndarray, shape (n, p)
        Of the parameters that are fitted to the means.
    mean, noise_u : ndarray, shape (n,)
        Counts.
    stated : float or None
        Relative standard deviation of scale factor and table from run to run, where it is known.
    """
    known = noise_u**2 + ((stated or 0.0) * mean) ** 2
    freedom = mean.size - design.shape[1]
    if freedom < 1:
        beyond = _ASSUMED if stated is None else 0.0
        return RunScatter((known + (beyond * mean) ** 2)[np.newaxis], np.ones(1), stated is None)
    scaled = design / np.linalg.norm(design, axis=0)
    left = mean - scaled @ np.linalg.lstsq(scaled, mean, rcond=None)[0]
    quiet = float(np.sqrt(np.mean(known)))
    largest = 30.0 * float(np.sqrt(left @ left / freedom)) + 10.0 * quiet
    size = np.concatenate([[0.0], np.geomspace(2e-2 * quiet, largest, _SIZES)])
    width = np.gradient(size)
    part = (np.arange(_PARTS) + 0.5) / _PARTS
    square = (mean / np.sqrt(np.mean(mean**2))) ** 2
    shape = (1 - part[:, np.newaxis]) * square + part[:, np.newaxis]
    variance = known + size[:, np.newaxis, np.newaxis] ** 2 * shape
    likelihood = _log_likelihood(variance.reshape(-1, mean.size), scaled, left)
    share = width / (size + quiet / 3)
    share[0] = _NONE_BEYOND * float(share[size < quiet].sum())
    prior = np.log(share)
    weight = np.exp(likelihood + np.repeat(prior, _PARTS) - (likelihood + np.repeat(prior, _PARTS)).max())
    return RunScatter(variance.reshape(-1, mean.size), weight / weight.sum(), assumed=False)


def _log_likelihood(variance: Floats, design: Floats, left: Floats) -> Floats:
    """Restricted likelihood of the residuals under each row of variances, shape (h,)."""
    heavy = 1 / variance
    normal = np.einsum("hn,ni,nj->hij", heavy, design, design)
    moment = np.einsum("hn,ni,n->hi", heavy, design, left)
    fitted = np.linalg.solve(normal, moment[..., np.newaxis])[..., 0]
    square = heavy @ left**2 - np.einsum("hi,hi->h", moment, fitted)
    determinant = np.linalg.slogdet(normal)[1]
    return np.asarray(-0.5 * (np.log(variance).sum(axis=1) + determinant + square), dtype=np.float64)
