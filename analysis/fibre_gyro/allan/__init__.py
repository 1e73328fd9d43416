"""Noise of a gyro at rest: Allan deviation for the eye, and the noise model by maximum likelihood."""

from analysis.fibre_gyro.allan.deviation import AllanCurve, allan_curve
from analysis.fibre_gyro.allan.fit import NoiseFit, fit_noise
from analysis.fibre_gyro.allan.terms import TERMS, allan_variance, window_covariance

__all__ = [
    "TERMS",
    "AllanCurve",
    "NoiseFit",
    "allan_curve",
    "allan_variance",
    "fit_noise",
    "window_covariance",
]
