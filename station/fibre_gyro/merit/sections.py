"""The figures of merit in the report: deviations from the line, and the scale factor of each run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from station.fibre_gyro.common import COLOURS, COUNTS_PER_DPS, PPM
from station.fibre_gyro.merit.evaluate import MeritFound, MeritRun
from station.fibre_gyro.settings import FogSettings
from station.report.figure import HALF, SOFT, WIDE, legend_above, svg_element
from station.results.numbers import ppm, with_uncertainty
from station.results.parts import PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def sections(found: MeritFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    header = ("run", "°C", f"K, {COUNTS_PER_DPS}", "nonlin. FS", "nonlin. point", "asymmetry", "pattern")
    return [
        Section(
            "Deviations from the line",
            "Measured less fitted output. GJB style gives the nonlinearity of full scale, IEEE style names "
            "either.",
            figures=(
                PlacedFigure(_deviations_svg(found, of_point=False), "As ppm of the largest output."),
                PlacedFigure(_deviations_svg(found, of_point=True), "As ppm of the point's own output."),
            ),
            sentences=result.sentences,
        ),
        Section(
            "Scale factor of each run",
            "Repeatability is the standard deviation over the runs from cold starts; the temperature coefficient "
            "is the largest change of K per kelvin from their mean.",
            figures=(PlacedFigure(_scale_factors_svg(found), "Each run less the mean of the runs."),),
            table=TextTable(header, tuple(_row(one) for axis in found.axes for one in axis.all_runs)),
        ),
        *_bias_sections(found),
    ]


def _bias_sections(found: MeritFound) -> list[Section]:
    """Bias of each switching on, and the transients."""
    transients = [one for axis in found.axes for one in axis.runs if one.turn_on is not None]
    rows = []
    for one in (run for axis in found.axes for run in axis.runs):
        turn_on = one.turn_on
        ends = f"{turn_on.warm_up_high_95_s:.3g}" if turn_on and turn_on.ends else "beyond the record"
        rows.append(
            (
                one.name,
                with_uncertainty(one.bias_dph, one.bias_u_dph),
                with_uncertainty(turn_on.transient, turn_on.transient_u) if turn_on else "",
                f"{turn_on.warm_up_s:.3g} ({turn_on.warm_up_low_95_s:.3g} to {ends})" if turn_on else "",
            )
        )
    header = ("run", "bias, deg/h", "transient, deg/h", "warm-up, s (95 %)")
    text = "Static output less the vertical earth rate at the latitude of the settings."
    figures: tuple[PlacedFigure, ...] = ()
    if transients:
        bound = next(one.turn_on.bound for one in transients if one.turn_on)
        text += f" The warm-up is over when the bias stays within {bound:g} deg/h of its final value."
        caption = "Fitted bias from each switching on, less its final value; dashed: the bound."
        figures = (PlacedFigure(_transients_svg(transients), caption),)
    return [
        Section(
            "Bias from one switching on to the next", text, figures=figures, table=TextTable(header, tuple(rows))
        )
    ]


def _transients_svg(runs: Sequence[MeritRun]) -> str:
    """Draw the bias after switching on, less its final value: means over equal times, and fitted."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, one in enumerate(runs):
            if (turn_on := one.turn_on) is not None:
                colour = COLOURS[index % 7]
                axes.plot(turn_on.at_s, turn_on.values - turn_on.curve_end, ".", ms=3, color=colour, alpha=0.6)
                axes.plot(
                    turn_on.at_s, turn_on.curve - turn_on.curve_end, color=colour, linewidth=1.2, label=one.name
                )
                for sense in (1, -1):
                    axes.axhline(sense * turn_on.bound, color=SOFT, linewidth=0.7, linestyle=(0, (4, 3)))
        axes.set(xlabel="time since switching on, s", ylabel="bias less final, deg/h")
        legend_above(axes, columns=6)

    return svg_element("turn-on", WIDE, draw)


def _row(one: MeritRun) -> tuple[str, ...]:
    return (
        one.name,
        f"{one.temperature_c:.1f}" if math.isfinite(one.temperature_c) else "",
        with_uncertainty(one.figures.fit.slope, one.figures.fit.slope_u),
        f"{one.figures.nonlinearity_ppm:.3g} ppm",
        f"{one.figures.nonlinearity_of_point_ppm:.3g} ppm",
        ppm(one.figures.asymmetry_ppm, one.figures.asymmetry_u_ppm).lstrip("+"),
        ", ".join(one.pattern.names) or "none",
    )


def _deviations_svg(found: MeritFound, *, of_point: bool) -> str:
    """Draw the deviations from the line of every run, of full scale or of each point."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        runs = [(one, one in axis.at_temperatures) for axis in found.axes for one in axis.all_runs]
        for index, (one, hot) in enumerate(runs):
            order = np.argsort(one.rate_dps)
            values = one.figures.deviation_of_point_ppm if of_point else -one.figures.deviation_of_full_scale_ppm
            axes.plot(
                one.rate_dps[order], values[order], "s--" if hot else "o-", ms=3.5, linewidth=0.8,
                color=COLOURS[index % 7], label=one.name,
            )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="rate, deg/s", ylabel="ppm of the point" if of_point else "ppm of full scale")
        if of_point:
            axes.set_xscale("symlog", linthresh=1.0)
        else:
            legend_above(axes, columns=4)

    return svg_element("of-point" if of_point else "of-full-scale", HALF, draw)


def _scale_factors_svg(found: MeritFound) -> str:
    """Draw the scale factor of every run against the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        everything = [one for axis in found.axes for one in axis.all_runs]
        known = bool(np.all(np.isfinite([one.temperature_c for one in everything])))
        for index, axis in enumerate(found.axes):
            of_axis = f"axis {axis.axis}, " if len(found.axes) > 1 else ""
            groups = (("from cold starts", axis.runs), ("at other temperatures", axis.at_temperatures))
            for place, (name, chosen) in enumerate(groups):
                slopes = np.array([one.figures.fit.slope for one in chosen], dtype=np.float64)
                u = PPM * np.array([one.figures.fit.slope_u for one in chosen]) / abs(axis.scale_factor)
                off = PPM * (slopes / axis.scale_factor - 1)
                if chosen:
                    colour, temperatures = COLOURS[(2 * index + place) % 7], [one.temperature_c for one in chosen]
                    _against_temperature(axes, f"{of_axis}{name}", temperatures, off, u, colour)
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
