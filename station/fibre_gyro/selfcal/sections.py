"""The self-calibration in the report: steps and output, slope and intercept, its own rate-table run."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from station.fibre_gyro.common import COUNTS_PER_DPS, PPM, staircase_section
from station.fibre_gyro.selfcal.evaluate import SelfcalFound
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.sections import axis_table
from station.report.figure import ACCENT, HALF, SECOND, SOFT, legend_above, svg_element
from station.results.contributions import budget_table
from station.results.numbers import with_uncertainty
from station.results.parts import PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def sections(found: SelfcalFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    made = [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Injected steps and output",
            figures=(
                PlacedFigure(_steps_svg(found), "Net output against the rate that each step stands for."),
                PlacedFigure(
                    _residuals_svg(found), "Net output less the injected number, and less the fitted line."
                ),
            ),
            table=_step_table(found),
        ),
        Section("Slope, intercept and static output", table=_slope_table(found)),
        Section("Budget", table=budget_table("K_self", result.document["budget"])),
        staircase_section(settings),
    ]
    if found.table is not None and found.table.axes:
        made.append(Section("Rate-table run of the same run", table=axis_table(found.table, settings)))
    return made


def _step_table(found: SelfcalFound) -> TextTable:
    rows = tuple(
        (f"{rate:+.10g} deg/s", f"{given:.6f}", with_uncertainty(float(out), float(u)), f"{out - given:+.3g}")
        for rate, given, out, u in zip(
            found.rate_dps, found.number, found.net.output, found.net.output_u, strict=True
        )
    )
    return TextTable(("stands for", "injected, counts", "net output, counts", "difference, counts"), rows)


def _slope_table(found: SelfcalFound) -> TextTable:
    fit, net, reference = found.fit, found.net, found.reference
    rows = [
        (f"slope K_self, {COUNTS_PER_DPS}", with_uncertainty(fit.slope, fit.slope_u)),
        ("slope of the injected numbers", f"{found.numbers.slope:.9g}"),
        ("intercept F_0, counts", with_uncertainty(fit.intercept, math.hypot(fit.intercept_u, net.static_u))),
        ("static output N_0, counts", with_uncertainty(net.static, net.static_u)),
        ("static output after less before", with_uncertainty(net.drift, net.drift_u)),
    ]
    if reference is not None:
        rows.append(
            (f"K, {reference.source}", with_uncertainty(reference.scale_factor, reference.scale_factor_u)),
        )
    return TextTable(("", "value"), tuple(rows))


def _steps_svg(found: SelfcalFound) -> str:
    """Draw the net output against the injected steps, and the fitted line."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        span = np.array([found.rate_dps.min(), found.rate_dps.max()]) * 1.04
        axes.plot(span, found.fit.intercept + found.fit.slope * span, color=ACCENT, linewidth=1.0, label="fit")
        axes.plot(found.rate_dps, found.net.output, "o", ms=5, color=SECOND, label="net output")
        axes.set(xlabel="rate that the injected step stands for, deg/s", ylabel="counts")
        legend_above(axes)

    return svg_element("injected", HALF, draw)


def _residuals_svg(found: SelfcalFound) -> str:
    """Draw net output less injected number, which is what the shared path tests, and the residuals of the fit."""
    rate, u = found.rate_dps, found.net.output_u
    scale = PPM / np.abs(found.number).max()

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        place = np.arange(rate.size)
        order = np.argsort(rate)
        for values, colour, offset, label in (
            (found.net.output - found.number, SECOND, -0.12, "output less injected number"),
            (found.fit.residual, ACCENT, 0.12, "output less fitted line"),
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
