"""The report's figures and tables: rates or records, checks, budget, and one record."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis import RatesFit, fit_harmonics
from analysis.budget import Budget
from analysis.lock_in_run import RateGroup, SeveralRates
from analysis.lockin_equation import beat_frequency, lock_in_from_rate
from analysis.several_rates import RatioData, predicted_ratio
from analysis.single_beams import BeamsFit
from instrument import Waveform
from station.lock_in.evaluate import LockInEvaluation
from station.lock_in.messages import (
    beams_sentences,
    describe_frequencies,
    quadrature_sentences,
    rates_sentences,
    table_sentences,
)
from station.lock_in.result import (
    BUDGET_COLUMNS,
    budget_rows,
    budget_sentences,
    rates_table,
    records_table,
    routes_table,
)
from station.report.figure import (
    ACCENT,
    HALF,
    INK,
    LINE,
    SECOND,
    SOFT,
    TALL,
    THIRD,
    WIDE,
    legend_above,
    svg_element,
)
from station.results.numbers import LOCK_IN_RATE
from station.results.result import PlacedFigure, Result, Section, TextTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RECORDS_SHOWN = 200


def sections(found: LockInEvaluation, result: Result) -> list[Section]:
    """Return the sections of the report in their order."""
    made = []
    if found.several is not None:
        made.append(_several_rates(found, found.several))
        if (beams := found.several.beams) is not None:
            made.append(_single_beams(found.several, beams))
        else:
            made += _checks(found.several)
    elif found.usable:
        caption = "Lock-in rate of every record with its standard uncertainty, the combined value, and the beat."
        figure = PlacedFigure(values_svg(found), caption)
        made.append(Section("Records and combined value", figures=(figure,)))
    if found.table_check is not None:
        made.append(Section("Does the table agree?", sentences=tuple(table_sentences(found))))
    if found.quadratures is not None:
        made.append(Section("Sine and cosine", sentences=tuple(quadrature_sentences(found))))
    if found.budget is not None:
        made.append(_budget(found.budget))
    return [*made, *_one_record(found), Section("Records", table=records_table(found, _RECORDS_SHOWN))]


def _budget(budget: Budget) -> Section:
    figure = PlacedFigure(budget_svg(budget), "What each input gives to the variance.")
    *rows, combined = budget_rows(budget)
    shown = [combined, *(row for line, row in zip(budget.inputs, rows, strict=True) if line.contribution > 0)]
    none = [line.quantity for line in budget.inputs if line.contribution == 0]
    said = (*budget_sentences(budget), *([f"Without weight here: {', '.join(none)}."] if none else []))
    table = TextTable(BUDGET_COLUMNS, tuple(shown))
    return Section("Uncertainty budget", figures=(figure,), sentences=said, table=table)


def _several_rates(found: LockInEvaluation, several: SeveralRates) -> Section:
    """Each rate alone, and the fit; without a fit the reason for that."""
    table = rates_table(several)
    sentences = tuple(rates_sentences(found))
    if several.by_beat is None:
        return Section("Several rates", sentences=sentences, table=table)
    truth = None if found.truth is None else found.truth[LOCK_IN_RATE.key()]
    figure = PlacedFigure(
        rates_svg(several.groups, several.by_beat, found.method.scale_factor, truth),
        "Lock-in rate that each rate alone would give, with its standard uncertainty. Lock-in itself is the same "
        "at every rate and in both senses; what rises or falls is distortion of the detector, or the gain of the "
        "laser. The lines are what the fit expects at each rate.",
    )
    return Section("Several rates", figures=(figure,), sentences=sentences, table=table)


def _single_beams(several: SeveralRates, beams: BeamsFit) -> Section:
    caption = (
        "Swing of both beams with the beat, AC over DC, and its phase against the beat. Symbols: as recorded; "
        "lines: what one laser does that fits beat and beams."
    )
    figure = PlacedFigure(beams_svg(beams), caption)
    said = tuple(beams_sentences(several))
    return Section("Single beams", figures=(figure,), sentences=said, table=routes_table(beams))


def _checks(several: SeveralRates) -> list[Section]:
    fit = several.by_beat
    if fit is None:
        return []
    figures = [
        PlacedFigure(
            deviations_svg(fit),
            "Distance of each record from the fit in standard uncertainties. One record in a hundred lies above "
            "the broken line by chance.",
        )
    ]
    if any(math.isfinite(value) for value in fit.left_out.lock_in_rate):
        figures.append(PlacedFigure(left_out_svg(fit), "The fit again, without each rate in turn."))
    other = several.by_frequency
    sentences: tuple[str, ...] = ()
    if other is not None:
        first, *rest = describe_frequencies(other)
        sentences = (f"The other route, beat frequency against rate: {first}", *rest)
    return [Section("Does the model hold?", figures=tuple(figures), sentences=sentences)]


def _one_record(found: LockInEvaluation) -> list[Section]:
    shown = _shown_record(found)
    if shown is None:
        return []
    wave, name = found.waveforms[shown], found.names[shown]
    beat = PlacedFigure(
        time_record_svg(wave),
        f"First periods of record {name} with the fitted harmonics, and what the fit leaves. A rate that moves "
        "within the record shows there as waves of the beat's period; the result's own fit follows it.",
    )
    spectrum = PlacedFigure(
        spectrum_svg(wave),
        f"Record {name}, Blackman-Harris window. Each harmonic of an ideal beat is weaker than the one before by "
        "the same ratio r; r gives the lock-in rate.",
    )
    lines = (
        PlacedFigure(line_svg(wave, 1), "Fundamental, enlarged."),
        PlacedFigure(line_svg(wave, 2), "Second harmonic, enlarged."),
    )
    return [
        Section("The beat", figures=(beat,)),
        Section("Its spectrum", figures=(spectrum,)),
        Section(
            "Fundamental and second harmonic",
            "The values come from the least-squares fit of the samples, not from the spectrum.",
            lines,
        ),
    ]


def _shown_record(found: LockInEvaluation) -> int | None:
    """Pick the first record that gave a value, or else the first with a frequency."""
    rows: Iterable[int] = range(len(found.names))
    if found.several is not None:
        rows = found.several.reference_group.rows
    for values in (found.each.lock_in_rate, found.each.beat_frequency):
        for row in rows:
            if math.isfinite(values[row]):
                return row
    return None


# --------------------
# Figures of a result as inline SVG: the same records always give the same bytes.
#
# matplotlib is imported inside the functions: it takes half a second, and only a report needs it


Array = NDArray[np.float64]

_PERIODS_SHOWN = 4
_SAMPLES_SHOWN = 300  # dots that can still be told apart; each is an element of the page
_HARMONICS = 4
_LINES_AROUND, _FINER = 5, 40  # Fourier lines beside an enlarged harmonic, and points of the curve for each
RECORDS_SHOWN = 2000  # of more every so many: a page of a million bars cannot be opened


def time_record_svg(waveform: Waveform) -> str:
    """Draw the first periods of a record: samples and fitted harmonics, and below what the fit leaves of them."""
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, harmonics=_HARMONICS, nan_policy="omit")
    frequency = float(fit.frequency)
    periods = int(np.ceil(_PERIODS_SHOWN / frequency / waveform.sample_interval))
    shown = min(waveform.codes.size, periods, _SAMPLES_SHOWN)
    span, units = shown * waveform.sample_interval, ((2.0, 1.0, "s"), (2e-3, 1e3, "ms"), (0.0, 1e6, "µs"))
    scale, unit = next((s, u) for limit, s, u in units if span >= limit)
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
            scale * fine, model(fine), color=ACCENT, linewidth=0.9, label=f"fit: offset and {_HARMONICS} harmonics"
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
    volts = _without_gaps(waveform)
    phase = 2 * np.pi * (np.arange(volts.size) + 0.5) / volts.size
    # Blackman and Harris: low skirts
    window = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    amplitudes = 2 * np.abs(np.fft.rfft(volts * window)) / window.sum()
    frequencies = np.fft.rfftfreq(volts.size, waveform.sample_interval)
    level = 20 * np.log10(np.maximum(amplitudes, 1e-12) / amplitudes.max())
    end = min(8.6 * frequency, float(frequencies[-1]))
    scale, unit = _frequency_unit(end)
    inside = frequencies <= end

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        floor = float(np.percentile(level[inside], 1)) - 3
        axes.plot(scale * frequencies[inside], level[inside], color=ACCENT, linewidth=0.9)
        axes.set(
            xlabel=f"frequency, {unit}", ylabel="dB of the fundamental", xlim=(0, scale * end), ylim=(floor, 12)
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
    volts = _without_gaps(waveform)
    frequency = np.fft.rfftfreq(_FINER * volts.size, waveform.sample_interval)
    near = np.abs(frequency - min(centre, frequency[-1])) * volts.size * waveform.sample_interval < _LINES_AROUND
    around = frequency[near]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(volts.size) + 0.5) / volts.size)
    line = 2 * np.abs(np.fft.rfft(volts * window, _FINER * volts.size)[near]) / window.sum()
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


def values_svg(evaluation: LockInEvaluation) -> str:
    """Draw lock-in rate and beat of every record, the combined value, and the truth if it is known."""
    combined, count = evaluation.combined, len(evaluation.names)
    apart = -(-count // RECORDS_SHOWN)
    each, number = evaluation.each[::apart], np.arange(1, count + 1, apart)
    which = "one record" if apart == 1 else f"one record in {apart}"
    value, (low, high) = float(combined.lock_in_rate), evaluation.interval_95
    off = np.abs(each.lock_in_rate - value) + 2 * each.lock_in_rate_u
    reach = 1.3 * float(np.nanmax(off, initial=0.0, where=np.isfinite(off)))
    narrow = 0 < reach < (high - low) / 6  # in a band that wide the records would be a flat line
    # thousands of records need no caps and thin bars
    size, line, cap = (2.5, 0.6, 0.0) if number.size > 60 else (4.0, 1.0, 2.5)
    records = {"fmt": "o", "ms": size, "linewidth": line, "capsize": cap, "color": INK}

    def draw(figure: Figure) -> None:
        from matplotlib.ticker import MaxNLocator

        above, below = figure.subplots(2, sharex=True, height_ratios=(2, 1))
        label = "combined, 95 %, all uncertainties included"
        above.axhspan(low, high, color=ACCENT, alpha=0.16, linewidth=0, label=label)
        above.axhline(value, color=ACCENT, linewidth=1.1)
        label = f"{which}, ±1 u of its noise"
        above.errorbar(number, each.lock_in_rate, yerr=each.lock_in_rate_u, label=label, **records)
        true = math.nan if evaluation.truth is None else evaluation.truth[LOCK_IN_RATE.key()]
        if abs(true - value) < (reach if narrow else math.inf):
            label = "truth of the simulation"
            above.axhline(true, color=THIRD, linestyle=(0, (5, 3)), linewidth=1.2, label=label)
        if narrow:
            above.set_ylim(value - reach, value + reach)
        below.plot(number, each.beat_frequency, "o", ms=size, color=INK)
        above.set(ylabel="lock-in rate, deg/s", xlim=(0.4, count + 0.6))
        below.set(xlabel="record", ylabel="beat, Hz")
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
        for axes in (above, below):
            axes.ticklabel_format(axis="y", useOffset=False)
        legend_above(above)

    return svg_element("values", TALL, draw)


def _without_gaps(waveform: Waveform) -> Array:
    volts = waveform.volts
    return np.where(np.isfinite(volts), volts - np.nanmean(volts), 0.0)


def _frequency_unit(end: float) -> tuple[float, str]:
    return next(
        (s, u) for limit, s, u in ((5e6, 1e-6, "MHz"), (5e3, 1e-3, "kHz"), (0.0, 1.0, "Hz")) if end >= limit
    )


# --------------------
# Figures of a measurement at several rates


_SENSES = ((1, ACCENT, "o", "positive sense"), (-1, SECOND, "s", "negative sense"))


def rates_svg(
    groups: Sequence[RateGroup], fit: RatesFit, scale_factor: float, true_lock_in_rate: float | None = None
) -> str:
    """Draw what each rate alone gives for the lock-in rate, and the fit to all of them, as an SVG element."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        low, high = fit.lock_in_rate_low_95, fit.lock_in_rate_high_95
        axes.axhspan(low, high, color=THIRD, alpha=0.18, linewidth=0)
        axes.axhline(fit.lock_in_rate, color=THIRD, linewidth=1.1, label="lock-in rate by the fit, 95 %")
        for sense, colour, marker, name in _SENSES:
            chosen = [group for group in groups if np.sign(group.input_rate) == sense]
            if chosen:
                _draw_sense(axes, chosen, fit, scale_factor, (colour, marker, name))
        if true_lock_in_rate is not None:
            axes.axhline(true_lock_in_rate, color=INK, linestyle=(0, (5, 3)), linewidth=1.1, label="truth")
        _rate_axis(axes, [group.input_rate for group in groups])
        axes.set(ylabel="lock-in rate, deg/s")
        axes.ticklabel_format(axis="y", useOffset=False)
        legend_above(axes, columns=4)

    return svg_element("rates", WIDE, draw)


def _draw_sense(
    axes: Axes, groups: list[RateGroup], fit: RatesFit, scale_factor: float, look: tuple[str, str, str]
) -> None:
    """One sense: each rate's own value, and what the fit says that a single rate would show."""
    colour, marker, name = look
    rates = np.array([group.input_rate for group in groups])
    values = np.array([float(group.combined.lock_in_rate) for group in groups])
    us = np.array([float(group.combined.lock_in_rate_u) for group in groups])
    fine = np.sign(rates[0]) * np.geomspace(np.abs(rates).min(), np.abs(rates).max(), 200)
    if len(groups) > 1:
        axes.plot(np.abs(fine), _seen_at(fine, fit, scale_factor), color=colour, linewidth=1.0, alpha=0.8)
    axes.errorbar(
        np.abs(rates), values, yerr=us, fmt=marker, ms=4.5, color=colour, capsize=2.5, label=f"one rate, {name}"
    )


def _seen_at(rates: Array, fit: RatesFit, scale_factor: float) -> Array:
    """Lock-in rate in deg/s that one rate alone would show, if the fit is right."""
    frequency = beat_frequency(scale_factor, rates, fit.lock_in_rate)
    data = RatioData(
        rate=rates,
        beat_rate=frequency / scale_factor,
        angular=2 * np.pi * frequency,
        ratio=np.zeros(rates.shape, dtype=complex),
        whitening=np.zeros((1, rates.size, 2, 2)),
        amplitude=np.ones(rates.shape),
        when=np.zeros(rates.shape),
        third=np.zeros(rates.shape),
        third_weight=np.zeros(rates.shape),
        reference="rate",
    )
    return lock_in_from_rate(np.abs(predicted_ratio(fit.parameters, data))[0], rates)


def beams_svg(beams: BeamsFit) -> str:
    """Draw how far each beam swings with the beat at each rate, and with which phase, as an SVG element."""

    def draw(figure: Figure) -> None:
        size, phase = figure.subplots(1, 2)
        for sense, line, name in ((1, "-", "positive sense"), (-1, "--", "negative sense")):
            inside = np.flatnonzero(np.sign(beams.rate) == sense)
            inside = inside[np.argsort(np.abs(beams.rate[inside]))]
            for beam, colour in ((0, ACCENT), (1, SECOND)):
                seen, fitted = beams.modulation[inside, beam], beams.fitted[inside, beam]
                at, label = np.abs(beams.rate[inside]), f"beam {beam + 1}, {name}"
                if not np.isfinite(seen).any():
                    continue
                marker = "o" if sense > 0 else "s"
                size.plot(at, 100 * np.abs(fitted), line, color=colour, linewidth=1.0)
                size.plot(at, 100 * np.abs(seen), marker, ms=4.5, color=colour, mfc="none", label=label)
                phase.plot(at, np.degrees(np.angle(fitted)), line, color=colour, linewidth=1.0)
                phase.plot(at, np.degrees(np.angle(seen)), marker, ms=4.5, color=colour, mfc="none")
        for axes in (size, phase):
            _rate_axis(axes, beams.rate)
        size.set(ylabel="AC over DC, %", ylim=(0, 1.1 * size.dataLim.ymax))
        phase.set(ylabel="phase, °")
        legend_above(size, columns=2)

    return svg_element("beams", WIDE, draw)


def deviations_svg(fit: RatesFit) -> str:
    """Draw how far each record lies from the fit, in standard uncertainties."""

    def draw(figure: Figure) -> None:
        axes, deviation = figure.add_subplot(), fit.deviation
        for sense, colour, marker, name in _SENSES:
            inside = np.flatnonzero((sense * fit.rate > 0) & np.isfinite(deviation))
            inside = inside[:: -(-inside.size // RECORDS_SHOWN) or 1]
            if inside.size:
                axes.plot(
                    np.abs(fit.rate[inside]),
                    deviation[inside],
                    marker,
                    ms=3.5,
                    color=colour,
                    alpha=0.6,
                    mew=0,
                    label=name,
                )
        # a two-dimensional normal deviation exceeds 3.03 in one record of a hundred
        axes.axhline(3.03, color=SOFT, linestyle=(0, (4, 3)), linewidth=0.9)
        _rate_axis(axes, fit.rate[fit.used])
        axes.set(ylabel="distance, u", ylim=(0, None))
        legend_above(axes)

    return svg_element("deviations", HALF, draw)


def left_out_svg(fit: RatesFit) -> str:
    """Draw the lock-in rate without each rate in turn; argument as above."""
    known = np.isfinite(fit.left_out.lock_in_rate)

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.axhspan(
            fit.lock_in_rate - fit.lock_in_rate_u,
            fit.lock_in_rate + fit.lock_in_rate_u,
            color=THIRD,
            alpha=0.18,
            linewidth=0,
        )
        axes.axhline(fit.lock_in_rate, color=THIRD, linewidth=1.1, label="all rates, ±1 u")
        axes.errorbar(
            fit.left_out.rate[known],
            fit.left_out.lock_in_rate[known],
            yerr=fit.left_out.lock_in_rate_u[known],
            fmt="o",
            ms=4.5,
            color=INK,
            capsize=2.5,
            label="without this rate",
        )
        _rate_axis(axes, fit.left_out.rate)
        axes.set(ylabel="lock-in rate, deg/s")
        axes.ticklabel_format(axis="y", useOffset=False)
        legend_above(axes)

    return svg_element("left-out", HALF, draw)


def _rate_axis(axes: Axes, rates: list[float] | Array) -> None:
    """A logarithmic axis of rates with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    size = np.abs(np.asarray(rates, dtype=np.float64))
    axes.set_xscale("log")
    axes.set_xlim(size.min() / 1.2, size.max() * 1.2)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("rate on the axis, deg/s")


# --------------------
# An uncertainty budget as bars, the largest contribution on top


_LINES_SHOWN = 12
_SMALLEST_SHOWN = 1e-4  # contributions below this share of the combined uncertainty are too small to be drawn


def budget_svg(budget: Budget) -> str:
    """Draw what each input of a budget gives to the variance."""
    least = _SMALLEST_SHOWN * budget.combined_u
    lines = [line for line in budget.inputs if line.contribution > least][:_LINES_SHOWN]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        # noise may leave a lock-in rate of zero, of which nothing is a percentage
        unit, scale = ("%", 100 / budget.lock_in_rate) if budget.lock_in_rate > 0 else ("deg/s", 1.0)
        shares = [100 * budget.share(line) for line in lines]
        sizes = [f"{scale * line.contribution:.2g} {unit}" for line in lines]
        told = [f"{share:.1f} %  (u {size})" for share, size in zip(shares, sizes, strict=True)]
        places = list(range(len(lines), 0, -1))
        bars = axes.barh(places, shares, height=0.62, color=ACCENT)
        axes.bar_label(bars, told, padding=4, color=INK, fontsize=8.5)
        axes.set_yticks(places, [line.quantity for line in lines], color=INK)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.set_xlim(0, 125)
        axes.set_xticks(range(0, 101, 20))
        axes.set_xlabel(f"share of the variance, %; combined u = {scale * budget.combined_u:.2g} {unit}")

    return svg_element("budget", (10.0, 1.0 + 0.29 * len(lines)), draw)
