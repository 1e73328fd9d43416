"""Figures of a measurement at several rates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis import RatesFit
from analysis.lock_in_run import RateGroup
from analysis.lockin_equation import beat_frequency, lock_in_from_rate
from analysis.several_rates import RatioData, predicted_ratio
from station.lock_in.presentation.plots import RECORDS_SHOWN
from station.report.figure import ACCENT, HALF, INK, SECOND, SOFT, THIRD, WIDE, legend_above, svg_element

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
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
    turned = fit.lock_in_rate * np.exp(1j * fit.backscatter_phase)
    known = np.nan_to_num(
        [turned.real, turned.imag, fit.distortion, fit.gain_time, fit.lag_square, fit.third_order]
    )
    data = RatioData(
        rate=rates,
        beat_rate=frequency / scale_factor,
        angular=2 * np.pi * frequency,
        ratio=np.zeros(rates.shape, dtype=complex),
        whitening=np.zeros((1, rates.size, 2, 2)),
        amplitude=np.ones(rates.shape),
        third=np.zeros(rates.shape),
        third_weight=np.zeros(rates.shape),
        reference="rate",
    )
    return lock_in_from_rate(np.abs(predicted_ratio(known[np.newaxis], data))[0], rates)


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
