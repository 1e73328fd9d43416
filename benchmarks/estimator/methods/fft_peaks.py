"""Height of the spectrum's peaks at the beat and at twice its frequency, as read from a spectrum analyser."""

from __future__ import annotations

import numpy as np
import scipy.fft
import scipy.signal

from benchmarks.estimator.methods.reading import Floats, Reading, Relation

REACH = 2
"""Bins on either side of twice the strongest bin in which the second peak is looked for."""


def read_peaks(window: str, relation: Relation, codes: Floats, rate: Floats) -> Reading:
    """The strongest bin is the fundamental; the strongest near twice that bin is the second harmonic.

    Parameters
    ----------
    window : str
        A name that `scipy.signal.get_window` knows.
    relation
        From ratio, frequency and table rate to the lock-in rate.
    codes, rate : (R, N), (R,)
    """
    n_samples = codes.shape[1]
    weights = scipy.signal.get_window(window, n_samples)
    height = np.abs(scipy.fft.rfft((codes - codes.mean(axis=1, keepdims=True)) * weights, axis=1))
    # The main lobe of the mean value, which the window spreads over a few bins, is no beat.
    height[:, 0] = 0.0
    first = height.argmax(axis=1)
    near = np.clip(2 * first[:, np.newaxis] + np.arange(-REACH, REACH + 1), 0, height.shape[1] - 1)
    second = np.take_along_axis(height, near, axis=1).max(axis=1)
    frequency = first / n_samples
    ratio = second / height[np.arange(len(first)), first]
    return Reading(frequency, relation(ratio, frequency, rate))
