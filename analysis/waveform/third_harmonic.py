"""What the lock-in waveform leaves at three times the beat: third-order distortion shows itself there.

s + k s^3 of the signal s = A sin(psi) is (1 + 3h) s - h A sin(3 psi), h = k A^2/4. The geometric series that fits
it best has another ratio than the beat, which no ratio shows; what no geometric series can take up is, at the
third harmonic, h A times a number that follows from r alone (`analysis.several_rates.ratio_model`).
"""

from __future__ import annotations

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.flags import FATAL, Flag
from analysis.waveform.waveform_fit import WaveformFit

ORDER = 3

NOT_KNOWN = int(FATAL | Flag.CLIPPED | Flag.DAMAGED | Flag.RATE_WANDER | Flag.ROUNDING_REPEATS)
"""Records in which other things leave something at the third harmonic."""

SMALLEST = 1e-4
"""Least uncertainty, -80 dBc: rounding to levels leaves that much in quiet records."""


def third_harmonic(fit: WaveformFit, n_samples: int) -> tuple[Complexes, Floats]:
    """Third harmonic beyond the waveform that was fitted, over the amplitude of the beat, of (R,) records.

    Its phase is referred to three times that of the fundamental, so that the time origin does not enter.
    """
    series = fit.series
    with np.errstate(all="ignore"):  # records without a beat; they are blanked
        unit = series.first / np.abs(series.first)
        amplitude = np.abs(series.first) / (1 - np.abs(series.ratio) ** 2)
        excess = fit.third * np.conj(unit) ** ORDER / amplitude
        noise = fit.noise_rms * np.sqrt(2 / n_samples * fit.excess[:, 1]) / amplitude
    known = ((fit.flags & NOT_KNOWN) == 0) & np.isfinite(excess) & np.isfinite(noise)
    known &= ORDER * series.omega < np.pi
    return np.where(known, excess, 0.0), np.where(known, np.hypot(noise, SMALLEST), np.inf)
