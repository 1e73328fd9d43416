"""A record of an oscilloscope for those who watch: the waveform that was just saved, and a picture of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from instrument import Preamble, Waveform
from station.events.seen import Trace
from station.runs.store import NewRecord

_POINTS = 240

Floats = NDArray[np.float64]


def waveform_of(record: NewRecord) -> Waveform:
    """Return a record that was just saved as the waveform that the scope sent; InstrumentError if it is none."""
    return Waveform(np.frombuffer(record.payload, dtype=np.int8), Preamble.parse(record.header))


def trace_of(waveform: Waveform, seconds: float, fit: Callable[[Floats], Floats] | None) -> Trace:
    """Return the beginning of a record with its fit; all of it where it is no longer than that."""
    volts, interval = waveform.volts, waveform.sample_interval
    shown = int(min(volts.size, np.ceil(seconds / interval) + 1))
    places = np.unique(np.linspace(0, shown - 1, min(_POINTS, shown)).round().astype(int))
    through = [] if fit is None else rounded(fit(places * interval))
    unit = waveform.preamble.yunit
    unit = "V" if unit.lower() in ("", "volts") else unit
    return Trace(float(places[-1] * interval), unit, rounded(volts[places]), through)


def rounded(values: Floats) -> list[float]:
    """Five digits: what an eye can see, in lines that stay short."""
    return [float(f"{value:.5g}") for value in values]
