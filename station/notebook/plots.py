"""Pictures of one record: samples, fit and what the fit leaves; the output of a fibre gyro."""

import io
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis import fit_harmonics
from instrument import Waveform
from instrument.fibre_gyro import Recording
from station.catalogue import Entry, draw_trend, series_of, trend_size
from station.report.figure import ACCENT, SECOND, STYLE, legend_above

_SIZE = (9.0, 5.0)
_SMALLEST = 1e-3  # of the fundamental; weaker harmonics are not drawn
_MOST_HARMONICS = 40


class NotebookPicture(Figure):
    """A figure of Matplotlib that a notebook shows by itself."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        with _style():
            self.savefig(file, format="png", dpi=110)
        return file.getvalue()


def draw_record(waveform: Waveform, title: str, ratio: float) -> Figure:
    """Draw a record with the harmonics fitted to it, and below what they leave."""
    volts, times = waveform.volts, waveform.times
    if not np.isfinite(ratio):
        return _samples(times, volts, title, "time from trigger, s", "V")
    fit = fit_harmonics(volts, waveform.sample_interval, harmonics=2, nan_policy="omit")
    below_nyquist = int(0.5 / (float(fit.frequency) * waveform.sample_interval))
    wanted = int(np.ceil(np.log(_SMALLEST) / np.log(ratio))) if 0 < ratio < 1 else 2
    harmonics = max(1, min(max(wanted, 2), below_nyquist, _MOST_HARMONICS))
    fit = fit_harmonics(volts, waveform.sample_interval, harmonics=harmonics, nan_policy="omit")
    turns = np.outer(
        np.arange(volts.size) * waveform.sample_interval * float(fit.frequency), 1 + np.arange(harmonics)
    )
    model = float(fit.offset) + (np.exp(2j * np.pi * turns) @ fit.amplitudes).real
    with _style():
        figure = NotebookPicture(figsize=_SIZE, layout="constrained")
        figure.suptitle(title)
        above, below = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        above.plot(times, volts, ".", ms=3, color=SECOND, alpha=0.6, mew=0, label="samples")
        above.plot(times, model, color=ACCENT, label=f"fit: offset and {harmonics} harmonics")
        above.set(ylabel="V")
        legend_above(above)
        below.plot(times, volts - model, ".", ms=2, color=SECOND, mew=0)
        below.set(xlabel="time from trigger, s", ylabel="residual, V")
    return figure


def draw_output(recording: Recording, title: str) -> Figure:
    """Draw a stretch of a fibre gyro's output."""
    return _samples(recording.times, recording.counts, title, "time, s", "counts")


def _style() -> AbstractContextManager[None]:
    style: Any = STYLE
    return matplotlib.rc_context(style)


def _samples(x: NDArray[np.float64], y: NDArray[np.float64], title: str, across: str, up: str) -> Figure:
    with _style():
        figure = NotebookPicture(figsize=_SIZE, layout="constrained")
        axes = figure.subplots()
        axes.plot(x, y, color=ACCENT, linewidth=0.9)
        axes.set(xlabel=across, ylabel=up, title=title)
    return figure


def draw_runs(entries: Sequence[Entry]) -> Figure:
    """Draw the results of runs over time; NoUsableSignal if none has a result."""
    series = series_of(entries)
    with _style():
        figure = NotebookPicture(figsize=trend_size(series), layout="constrained")
        draw_trend(figure, series)
    return figure
