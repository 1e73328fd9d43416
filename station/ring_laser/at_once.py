"""One record of the beat for those who watch: its harmonics, fitted in some milliseconds, and a picture of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from analysis import HarmonicFit, fit_harmonics
from instrument import Waveform
from station.events.seen import Trace
from station.scope.at_once import trace_of

_PERIODS = 4.0
_HARMONICS = 4


def harmonics_of(waveform: Waveform) -> HarmonicFit | None:
    """Return the harmonics of a record; ``None`` where it shows no beat."""
    volts = waveform.volts
    if not np.isfinite(volts).any() or np.nanmax(volts) == np.nanmin(volts):
        return None
    fit = fit_harmonics(volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    return fit if math.isfinite(float(fit.frequency)) and float(np.abs(fit.amplitudes[0])) > 0 else None


def trace_of_beat(waveform: Waveform, fit: HarmonicFit | None) -> Trace:
    """Return a few periods of a record with its fit; without a beat the whole record, and no fit."""
    if fit is None:
        return trace_of(waveform, math.inf, None)
    frequency = float(fit.frequency)

    def beat(times: NDArray[np.float64]) -> NDArray[np.float64]:
        turning = np.exp(2j * np.pi * frequency * np.outer(times, np.arange(1, _HARMONICS + 1)))
        return np.asarray(float(fit.offset) + (turning @ fit.amplitudes).real)

    return trace_of(waveform, _PERIODS / frequency, beat)
