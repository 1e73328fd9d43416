"""Figures of the fibre gyro's reports as inline SVG."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.fibre_gyro import Trace
from station.fibre_gyro.eps.measurement import EpsEvaluation
from station.fibre_gyro.figures.measurement import FiguresEvaluation
from station.fibre_gyro.selfcal.measurement import SelfcalEvaluation
from station.fibre_gyro.table.measurement import TableEvaluation
from station.report.picture import svg_element
from station.report.plot_style import ACCENT, HALF, INK, SECOND, SOFT, THIRD, WIDE, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_PPM = 1e6
_COLOURS = (ACCENT, SECOND, THIRD, INK, "#8a5a9e", "#b0902c", SOFT)
_MARKERS = "osD^vP"
_TALL = (10.0, 5.6)


def output_against_rate_svg(evaluation: TableEvaluation) -> str:
    """Draw the mean output of every run against the table's rate, with the fitted lines."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, result in enumerate(evaluation.axes):
            rate, sign = result.runs.rate_dps, result.runs.end_up
            span = np.array([min(0.0, rate.min()), max(0.0, rate.max())]) * 1.04
            colour, style = _COLOURS[index % 7], (0, (6, 2 * index))
            axes.plot(span, result.fit.scale_factor * span, color=colour, linestyle=style, linewidth=1.0)
            axes.plot(
                rate, sign * result.runs.mean, _MARKERS[index % 6], ms=8 - 2 * (index % 3), mfc="none",
                color=colour, label=f"axis {result.axis}",
            )  # fmt: skip
        axes.set(xlabel="rate of the table, deg/s", ylabel="mean output, counts")
        legend_above(axes)

    return svg_element("output", HALF, draw)


def residuals_svg(evaluation: TableEvaluation) -> str:
    """Draw the residuals of every run in ppm of its output, senses side by side."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        sizes = sorted({round(float(abs(r)), 9) for result in evaluation.axes for r in result.runs.nominal_dps})
        width = 0.8 / (2 * len(evaluation.axes))
        for index, result in enumerate(evaluation.axes):
            place = np.array([sizes.index(round(float(abs(r)), 9)) for r in result.runs.nominal_dps])
            forward = result.runs.nominal_dps > 0
            offset = (2 * index - len(evaluation.axes) + np.where(forward, 1.5, 0.5)) * width
            u = _PPM * result.runs.mean_u / np.abs(result.runs.mean)
            for chosen, filled in ((forward, True), (~forward, False)):
                axes.errorbar(
                    (place + offset)[chosen], result.fit.residual_ppm[chosen], yerr=u[chosen], fmt="o", ms=4,
                    mfc=_COLOURS[index % 7] if filled else "white", color=_COLOURS[index % 7], capsize=2,
                    linewidth=0.9, label=f"axis {result.axis}" if filled else None,
                )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes])
        axes.set(xlabel="rate of the table, deg/s", ylabel="residual, ppm of output")
        legend_above(axes)

    return svg_element("residuals", HALF, draw)


def differences_svg(evaluation: TableEvaluation) -> str:
    """Draw how far each difference is from K times the small rate, with both kinds of uncertainty."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        results = [result for result in evaluation.axes if result.differences is not None]
        for index, result in enumerate(results):
            differences = result.differences
            assert differences is not None
            expected = result.fit.scale_factor * differences.delta_dps
            off = _PPM * (differences.number / expected - 1)
            place = np.arange(off.size) + 0.18 * (index - (len(results) - 1) / 2)
            noise = _PPM * differences.noise_u / np.abs(expected)
            both = _PPM * differences.number_u / np.abs(expected)
            colour = _COLOURS[index % 7]
            axes.errorbar(place, off, yerr=both, fmt="none", color=colour, capsize=4, linewidth=0.8)
            axes.errorbar(
                place, off, yerr=noise, fmt="o", ms=4, color=colour, linewidth=2.6, label=f"axis {result.axis}"
            )
        first = results[0].differences
        assert first is not None
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set_yscale("symlog", linthresh=10.0)
        axes.set_xticks(range(first.delta_dps.size), [f"N({delta:.3g})" for delta in first.delta_dps])
        axes.set(xlabel="difference for so many deg/s", ylabel="off from K times the rate, ppm")
        axes.set_xlim(-0.5, first.delta_dps.size - 0.5)
        legend_above(axes)

    return svg_element("differences", WIDE, draw)


def injected_steps_svg(evaluation: SelfcalEvaluation) -> str:
    """Draw the net output against the injected steps, and the fitted line."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        span = np.array([evaluation.rate_dps.min(), evaluation.rate_dps.max()]) * 1.04
        fit = evaluation.fit
        axes.plot(span, fit.intercept + fit.slope * span, color=ACCENT, linewidth=1.0, label="fit")
        axes.plot(evaluation.rate_dps, evaluation.net.output, "o", ms=5, color=SECOND, label="net output")
        axes.set(xlabel="rate that the injected step stands for, deg/s", ylabel="counts")
        legend_above(axes)

    return svg_element("injected", HALF, draw)


def selfcal_residuals_svg(evaluation: SelfcalEvaluation) -> str:
    """Draw net output less injected number, which is what the shared path tests, and the residuals of the fit."""
    rate, u = evaluation.rate_dps, evaluation.net.output_u
    scale = _PPM / np.abs(evaluation.number).max()

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        place = np.arange(rate.size)
        order = np.argsort(rate)
        for values, colour, offset, label in (
            (evaluation.net.output - evaluation.number, SECOND, -0.12, "output less injected number"),
            (evaluation.fit.residual, ACCENT, 0.12, "output less fitted line"),
        ):
            axes.errorbar(
                place + offset, scale * values[order], yerr=scale * u[order], fmt="o", ms=4, capsize=2,
                color=colour, linewidth=0.9, label=label,
            )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set_xticks(place, [f"{value:+g}" for value in rate[order]])
        axes.set(xlabel="rate that the step stands for, deg/s", ylabel="ppm of full scale")
        legend_above(axes, columns=2)

    return svg_element("selfcal-residuals", HALF, draw)


def errors_svg(evaluation: EpsEvaluation) -> str:
    """Draw the demodulated error of pairs with and without a reset against the injected step."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        order = np.argsort(evaluation.step_codes)
        step = evaluation.step_codes[order]
        axes.plot(step, evaluation.normal[order], "o-", ms=5, color=ACCENT, label="pairs without a reset")
        axes.plot(step, evaluation.reset[order], "s--", ms=8, mfc="none", color=SECOND, label="pairs with a reset")
        axes.set(xlabel="injected step, codes", ylabel="error, converter counts")
        legend_above(axes, columns=2)

    return svg_element("errors", HALF, draw)


def reset_differences_svg(evaluation: EpsEvaluation) -> str:
    """Draw the difference between pairs with and without a reset: the 2 pi error itself."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        order = np.argsort(evaluation.step_codes)
        difference = (evaluation.reset - evaluation.normal)[order]
        u = np.hypot(evaluation.reset_u, evaluation.normal_u)[order]
        axes.errorbar(
            evaluation.step_codes[order],
            difference,
            yerr=u,
            fmt="o",
            ms=5,
            color=INK,
            capsize=3,
            label="measured, ±1 u",
        )
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="injected step, codes", ylabel="with less without reset, counts")
        legend_above(axes)

    return svg_element("reset-differences", HALF, draw)


def deviations_svg(evaluation: FiguresEvaluation, *, of_point: bool) -> str:
    """Draw the deviations from the line of every run, of full scale or of each point."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, run in enumerate((*evaluation.runs, *evaluation.at_temperatures)):
            order = np.argsort(run.rate_dps)
            values = run.figures.deviation_of_point_ppm if of_point else -run.figures.deviation_of_full_scale_ppm
            hot = index >= len(evaluation.runs)
            axes.plot(
                run.rate_dps[order], values[order], "s--" if hot else "o-", ms=3.5, linewidth=0.8,
                color=_COLOURS[index % 7], label=run.name,
            )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="rate, deg/s", ylabel="ppm of the point" if of_point else "ppm of full scale")
        if of_point:
            axes.set_xscale("symlog", linthresh=1.0)
        else:
            legend_above(axes, columns=4)

    return svg_element("of-point" if of_point else "of-full-scale", HALF, draw)


def scale_factors_svg(evaluation: FiguresEvaluation) -> str:
    """Draw the scale factor of every run against the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        runs = (*evaluation.runs, *evaluation.at_temperatures)
        cold = ("from cold starts", evaluation.runs, ACCENT)
        for name, chosen, colour in (cold, ("at other temperatures", evaluation.at_temperatures, SECOND)):
            slopes = np.array([run.figures.fit.slope for run in chosen], dtype=np.float64)
            u = _PPM * np.array([run.figures.fit.slope_u for run in chosen]) / evaluation.scale_factor
            off = _PPM * (slopes / evaluation.scale_factor - 1)
            if chosen:
                _against_temperature(axes, name, [run.temperature_c for run in chosen], off, u, colour)
        known = bool(np.all(np.isfinite([run.temperature_c for run in runs])))
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="temperature, °C" if known else "run", ylabel="K less mean, ppm")
        legend_above(axes, columns=2)

    return svg_element("scale-factors", WIDE, draw)


def _against_temperature(
    axes: Axes, name: str, temperature: ArrayLike, value: ArrayLike, u: ArrayLike, colour: str
) -> None:
    place = np.asarray(temperature, dtype=np.float64)
    if not np.all(np.isfinite(place)):
        place = np.arange(1.0, place.size + 1)
    axes.errorbar(place, value, yerr=u, fmt="o", ms=4, capsize=2, color=colour, linewidth=0.9, label=name)


def staircase_svg(trace: Trace, interval_s: float) -> str:
    """Draw the staircase, the phase difference and the detector signal over a few resets."""
    micro = 1e6

    def draw(figure: Figure) -> None:
        top, middle, bottom = figure.subplots(3, 1, sharex=True)
        begin = micro * (trace.times_s - trace.times_s[0])
        for axes, values, colour, label in (
            (top, trace.staircase, ACCENT, "staircase,\ncodes"),
            (middle, trace.difference_rad / np.pi, THIRD, "phase difference,\nπ"),
            (bottom, trace.intensity, SECOND, "intensity,\npart of peak"),
        ):
            axes.step(begin, values, where="post", color=colour, linewidth=0.9)
            axes.set_ylabel(label)
            axes.ticklabel_format(axis="y", useOffset=False)
            for at in begin[trace.reset]:
                axes.axvline(at, color=SOFT, linewidth=0.6, linestyle=(0, (3, 3)), zorder=0)
        bottom.set_xlabel(f"time, µs (one sample every {micro * interval_s:.3f} µs)")
        bottom.set_xlim(0, begin[-1])

    return svg_element("staircase", _TALL, draw)
