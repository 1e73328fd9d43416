"""What one record says at once, for displays and never for the result: of a scope, of a ring laser."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from instrument import Preamble, Waveform
from station.errors import one_line
from station.runs.store import NewRecord

if TYPE_CHECKING:
    from analysis import HarmonicFit
    from station.live.events import Events

_BEHIND = 200  # acquisitions that may wait to be fitted; more are not shown
_LAST_S = 1.0  # for so long the end of a run waits for values that are still to come


@dataclass(frozen=True)
class PreviewValue:
    """A number with its standard uncertainty, of noise alone."""

    name: str  # with the unit at its end: ``"lock_in_rate_dps"``
    value: float
    u: float
    text: str  # as a person reads it
    records: int = 1  # how many it is of


@dataclass(frozen=True)
class PreviewTrace:
    """A few periods of a record, and its fit at the same times; at most some hundred points."""

    seconds: float  # from the first point to the last
    unit: str
    samples: Sequence[float]
    fit: Sequence[float] = ()


@dataclass(frozen=True)
class Preview:
    """What a record says."""

    key: str
    group: str  # what is taken together: records at one rate
    values: tuple[PreviewValue, ...]  # of this record
    # of all records of its group so far; the first is the one to show in a table of groups
    running: tuple[PreviewValue, ...] = ()
    so_far: tuple[PreviewValue, ...] = ()  # of all records so far
    flags: tuple[str, ...] = ()
    trace: PreviewTrace | None = None


See = Callable[[Sequence["NewRecord"]], Preview | None]
"""Gets the records of one acquisition in the order in which they come; ``None`` if they are not to be shown."""


class Watcher:
    """Fits records as they come, in a thread of its own: what is too slow for it is not shown."""

    def __init__(self, events: Events, see: See) -> None:
        self._events, self._see = events, see
        self._queue: queue.Queue[Sequence[NewRecord] | None] = queue.Queue(_BEHIND)
        self._thread = threading.Thread(target=self._work, name="values", daemon=True)
        self._thread.start()

    def __call__(self, records: Sequence[NewRecord]) -> None:
        """Take the records of one acquisition; returns at once."""
        with suppress(queue.Full):
            self._queue.put_nowait(records)

    def close(self) -> None:
        """Let it finish what it has, for a second at most."""
        with suppress(queue.Full):
            self._queue.put_nowait(None)
            self._thread.join(_LAST_S)

    def _work(self) -> None:
        while (records := self._queue.get()) is not None:
            facts: dict[str, Any] = {"key": records[0].key}
            try:
                seen = self._see(records)
                if seen is None:
                    continue
                facts = dict(vars(seen))
            except Exception as error:  # a record that nobody can read spoils its own line only
                facts["problem"] = one_line(error)
            self._events.emit("value", **facts)


# --------------------
# A record of an oscilloscope for those who watch: the waveform that was just saved, and a picture of it


_POINTS = 240

Floats = NDArray[np.float64]


def waveform_of(record: NewRecord) -> Waveform:
    """Return a record that was just saved as the waveform that the scope sent; InstrumentError if it is none."""
    return Waveform(np.frombuffer(record.payload, dtype=np.int8), Preamble.parse(record.header))


def trace_of(waveform: Waveform, seconds: float, fit: Callable[[Floats], Floats] | None) -> PreviewTrace:
    """Return the beginning of a record with its fit; all of it where it is no longer than that."""
    volts, interval = waveform.volts, waveform.sample_interval
    shown = int(min(volts.size, np.ceil(seconds / interval) + 1))
    places = np.unique(np.linspace(0, shown - 1, min(_POINTS, shown)).round().astype(int))
    through = [] if fit is None else rounded(fit(places * interval))
    unit = waveform.preamble.yunit
    unit = "V" if unit.lower() in ("", "volts") else unit
    return PreviewTrace(float(places[-1] * interval), unit, rounded(volts[places]), through)


def rounded(values: Floats) -> list[float]:
    """Five digits: what an eye can see, in lines that stay short."""
    return [float(f"{value:.5g}") for value in values]


# --------------------
# One record of the beat for those who watch: its harmonics, fitted in some milliseconds, and a picture of it


_PERIODS = 4.0
_HARMONICS = 4


def harmonics_of(waveform: Waveform) -> HarmonicFit | None:
    """Return the harmonics of a record; ``None`` where it shows no beat."""
    volts = waveform.volts
    if not np.isfinite(volts).any() or np.nanmax(volts) == np.nanmin(volts):
        return None
    from analysis import fit_harmonics

    fit = fit_harmonics(volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    return fit if math.isfinite(float(fit.frequency)) and float(np.abs(fit.amplitudes[0])) > 0 else None


def trace_of_beat(waveform: Waveform, fit: HarmonicFit | None) -> PreviewTrace:
    """Return a few periods of a record with its fit; without a beat the whole record, and no fit."""
    if fit is None:
        return trace_of(waveform, math.inf, None)
    frequency = float(fit.frequency)

    def beat(times: NDArray[np.float64]) -> NDArray[np.float64]:
        turning = np.exp(2j * np.pi * frequency * np.outer(times, np.arange(1, _HARMONICS + 1)))
        return np.asarray(float(fit.offset) + (turning @ fit.amplitudes).real)

    return trace_of(waveform, _PERIODS / frequency, beat)
