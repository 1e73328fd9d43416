"""Figures of a result as inline SVG: the same records always give the same bytes.

matplotlib is imported inside the functions: it takes half a second, and only a report needs it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis import fit_harmonics
from instrument import Waveform
from station.lock_in.found import LockInFound
from station.report.figure import ACCENT, HALF, INK, LINE, SECOND, TALL, THIRD, WIDE, legend_above, svg_element

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_PERIODS_SHOWN = 4
_SAMPLES_SHOWN = 300  # dots that can still be told apart; each is an element of the page
_HARMONICS = 4
RECORDS_SHOWN = 2000  # of more every so many: a page of a million bars cannot be opened


def time_record_svg(waveform: Waveform) -> str:
    """Draw the first periods of a record: samples and fitted harmonics, and below what the fit leaves of them."""
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    frequency = float(fit.frequency)
    periods = int(np.ceil(_PERIODS_SHOWN / frequency / waveform.sample_interval))
    shown = min(waveform.codes.size, periods, _SAMPLES_SHOWN)
    scale, unit = _time_unit(shown * waveform.sample_interval)
    fine = np.linspace(0, (shown - 1) * waveform.sample_interval, 800)
    orders = np.arange(1, _HARMONICS + 1)
    times = np.arange(shown) * waveform.sample_interval

    def model(at: NDArray[Any]) -> Array:
        turning = np.exp(2j * np.pi * frequency * np.outer(at, orders))
        return np.asarray(float(fit.offset) + (turning @ fit.amplitudes).real, np.float64)

    def draw(figure: Figure) -> None:
        axes, below = figure.subplots(2, sharex=True, height_ratios=(2.4, 1))
        # a fine line over light dots: neither hides the other
        axes.plot(
            scale * times, waveform.volts[:shown], ".", ms=5, color=SECOND, alpha=0.45, mew=0, label="samples"
        )
        axes.plot(
            scale * fine,
            model(fine),
            color=ACCENT,
            linewidth=0.9,
            label=f"fit: offset and {_HARMONICS} harmonics",
        )
        axes.set(ylabel="V", xlim=(0, scale * fine[-1]))
        left = 1e3 * np.subtract(waveform.volts[:shown], model(times))
        level = 1e3 * abs(waveform.preamble.ymult)
        below.axhspan(-level / 2, level / 2, color=LINE, linewidth=0, label="one level of the converter")
        below.plot(scale * times, left, ".", ms=3, color=SECOND, alpha=0.6, mew=0, label="samples less fit")
        below.set(xlabel=f"time from the first sample, {unit}", ylabel="mV")
        for one in (axes, below):
            legend_above(one)

    return svg_element("record", TALL, draw)


def spectrum_svg(waveform: Waveform) -> str:
    """Draw the spectrum of a record in dB of its fundamental, harmonics marked; argument as above."""
    frequency = float(fit_harmonics(waveform.volts, waveform.sample_interval, nan_policy="omit").frequency)
    amplitudes, frequencies = _windowed_spectrum(waveform)
    level = 20 * np.log10(np.maximum(amplitudes, 1e-12) / amplitudes.max())
    end = min(8.6 * frequency, float(frequencies[-1]))
    scale, unit = _frequency_unit(end)
    inside = frequencies <= end

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        floor = float(np.percentile(level[inside], 1)) - 3
        axes.plot(scale * frequencies[inside], level[inside], color=ACCENT, linewidth=0.9)
        axes.set(
            xlabel=f"frequency, {unit}",
            ylabel="dB of the fundamental",
            xlim=(0, scale * end),
            ylim=(floor, 12),
        )
        for order in range(1, 9):
            if order * frequency < end:
                axes.axvline(
                    scale * order * frequency, color=SECOND, linewidth=0.7, linestyle=(0, (4, 3)), zorder=0
                )
                label = "f" if order == 1 else f"{order}f"
                axes.annotate(
                    label,
                    (scale * order * frequency, 12),
                    xytext=(0, 3),
                    textcoords="offset points",
                    ha="center",
                    color=SECOND,
                )

    return svg_element("spectrum", WIDE, draw)


def line_svg(waveform: Waveform, order: int) -> str:
    """Draw one harmonic enlarged, as the paper's Fig. 8 (c) and (d), beside what least squares gives."""
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    centre = order * float(fit.frequency)
    height, height_u = float(np.abs(fit.amplitudes[order - 1])), float(fit.amplitudes_u[order - 1])
    duration = waveform.codes.size * waveform.sample_interval
    around = centre + np.linspace(-5, 5, 401) / duration
    line = _amplitude_at(waveform, around)
    scale, unit = _frequency_unit(centre)
    milli = 1e3

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.plot(scale * around, milli * line, color=ACCENT, label="spectrum (Hann window)")
        axes.errorbar(
            [scale * centre],
            [milli * height],
            yerr=[2 * milli * height_u],
            fmt="o",
            ms=5,
            color=SECOND,
            capsize=3,
            label="least squares, ±2 u",
            zorder=3,
        )
        axes.set(xlabel=f"frequency, {unit}", ylabel="amplitude, mV")
        axes.set_xlim(scale * around[0], scale * around[-1])
        axes.set_ylim(0, milli * max(height + 2 * height_u, float(line.max())) * 1.12)
        axes.ticklabel_format(useOffset=False)
        legend_above(axes)

    return svg_element(f"line{order}", HALF, draw)


def values_svg(evaluation: LockInFound) -> str:
    """Draw the lock-in rate of every record, the combined value, and the truth if it is known."""
    combined, count = evaluation.combined, len(evaluation.names)
    apart = -(-count // RECORDS_SHOWN)
    each, number = evaluation.each[::apart], np.arange(1, count + 1, apart)
    which = "one record" if apart == 1 else f"one record in {apart}"
    low, high = evaluation.interval_95

    def draw(figure: Figure) -> None:
        from matplotlib.ticker import MaxNLocator

        axes = figure.add_subplot()
        axes.axhspan(
            low, high, color=ACCENT, alpha=0.16, linewidth=0, label="combined, 95 % interval, every input counted"
        )
        axes.axhline(float(combined.lock_in_rate), color=ACCENT, linewidth=1.1)
        # thousands of records need no caps and thin bars
        many = number.size > 60
        axes.errorbar(
            number,
            each.lock_in_rate,
            yerr=each.lock_in_rate_u,
            fmt="o",
            ms=2.5 if many else 4,
            linewidth=0.6 if many else 1.0,
            capsize=0 if many else 2.5,
            color=INK,
            label=f"{which}, ±1 u of its noise",
        )
        if evaluation.truth is not None:
            true = evaluation.truth["lock_in_rate_dps"]
            axes.axhline(true, color=THIRD, linestyle=(0, (5, 3)), linewidth=1.2, label="truth of the simulation")
        axes.set(xlabel="record", ylabel="lock-in rate, deg/s", xlim=(0.4, count + 0.6))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.ticklabel_format(axis="y", useOffset=False)
        legend_above(axes)

    return svg_element("values", WIDE, draw)


def _windowed_spectrum(waveform: Waveform) -> tuple[Array, Array]:
    """Amplitudes in V at the frequencies of the discrete transform, Blackman-Harris window (low skirts)."""
    volts = _without_gaps(waveform)
    phase = 2 * np.pi * (np.arange(volts.size) + 0.5) / volts.size
    window = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    amplitudes = 2 * np.abs(np.fft.rfft(volts * window)) / window.sum()
    return np.asarray(amplitudes), np.asarray(np.fft.rfftfreq(volts.size, waveform.sample_interval), np.float64)


def _amplitude_at(waveform: Waveform, frequencies: Array) -> Array:
    """Amplitudes in V at any frequencies, Hann window."""
    volts = _without_gaps(waveform)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(volts.size) + 0.5) / volts.size)
    times = np.arange(volts.size) * waveform.sample_interval
    turning = np.exp(-2j * np.pi * np.outer(frequencies, times))
    return np.asarray(2 * np.abs(turning @ (volts * window)) / window.sum())


def _without_gaps(waveform: Waveform) -> Array:
    volts = waveform.volts
    return np.where(np.isfinite(volts), volts - np.nanmean(volts), 0.0)


def _time_unit(span: float) -> tuple[float, str]:
    return next((s, u) for limit, s, u in ((2.0, 1.0, "s"), (2e-3, 1e3, "ms"), (0.0, 1e6, "µs")) if span >= limit)


def _frequency_unit(end: float) -> tuple[float, str]:
    return next(
        (s, u) for limit, s, u in ((5e6, 1e-6, "MHz"), (5e3, 1e-3, "kHz"), (0.0, 1.0, "Hz")) if end >= limit
    )
