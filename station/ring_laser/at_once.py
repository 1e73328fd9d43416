"""One record of the beat for those who watch: its harmonics, fitted in some milliseconds, and a picture of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from analysis import HarmonicFit, fit_harmonics
from instrument import Preamble, Waveform
from station.events.seen import Trace
from station.runs.store import NewRecord

_POINTS = 240
_PERIODS = 4.0
_HARMONICS = 4


def waveform_of(record: NewRecord) -> Waveform:
    """Return a record that was just saved as the waveform that the scope sent; InstrumentError if it is none."""
    return Waveform(np.frombuffer(record.payload, dtype=np.int8), Preamble.parse(record.header))


def harmonics_of(waveform: Waveform) -> HarmonicFit | None:
    """Return the harmonics of a record; ``None`` where it shows no beat."""
    volts = waveform.volts
    if not np.isfinite(volts).any() or np.nanmax(volts) == np.nanmin(volts):
        return None
    fit = fit_harmonics(volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    return fit if math.isfinite(float(fit.frequency)) and float(np.abs(fit.amplitudes[0])) > 0 else None


def trace_of(waveform: Waveform, fit: HarmonicFit | None) -> Trace:
    """Return a few periods of a record with its fit; without a beat the whole record, and no fit."""
    volts, interval = waveform.volts, waveform.sample_interval
    shown = volts.size
    if fit is not None:
        shown = min(shown, math.ceil(_PERIODS / float(fit.frequency) / interval) + 1)
    places = np.unique(np.linspace(0, shown - 1, min(_POINTS, shown)).round().astype(int))
    through: list[float] = []
    if fit is not None:
        turning = np.exp(
            2j * np.pi * float(fit.frequency) * np.outer(places * interval, np.arange(1, _HARMONICS + 1))
        )
        through = _rounded(float(fit.offset) + (turning @ fit.amplitudes).real)
    unit = waveform.preamble.yunit
    unit = "V" if unit.lower() in ("", "volts") else unit
    return Trace(float(places[-1] * interval), unit, _rounded(volts[places]), through)


def _rounded(values: NDArray[np.float64]) -> list[float]:
    """Five digits: what an eye can see, in lines that stay short."""
    return [float(f"{value:.5g}") for value in values]
