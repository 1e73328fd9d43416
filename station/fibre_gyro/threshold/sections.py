"""Threshold, resolution and dead zone in the report: output over expected output against the input."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.fibre_gyro import NORMAL_95
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.threshold.evaluate import AxisThreshold, Series, ThresholdFound
from station.fibre_gyro.threshold.result import in_words
from station.report.figure import ACCENT, HALF, LINE, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.numbers import with_uncertainty
from station.results.parts import PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def sections(found: ThresholdFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    made = [Section("What was found", sentences=result.sentences, table=_table(found))]
    for one in found.axes:
        caption = "Bars: 95 %. Grey: the 95 % interval of the threshold, or what a bound leaves open."
        made.append(
            Section(
                f"Axis {one.axis}: inputs about zero",
                figures=(PlacedFigure(_ratios_svg(one, one.ladder, "ladder"), caption),),
                table=_rungs(one.ladder),
            )
        )
        if one.resolution is not None:
            title = f"Axis {one.axis}: changes about {one.resolution.reference_dps:.4g} deg/s"
            figure = PlacedFigure(_ratios_svg(one, one.resolution, "resolution"), "As above, for the resolution.")
            made.append(Section(title, figures=(figure,), table=_rungs(one.resolution)))
    return made


def _table(found: ThresholdFound) -> TextTable:
    rows = []
    for one in found.axes:
        says = one.ladder.says
        edges = [("threshold", says.threshold), ("dead zone, positive side", says.rising)]
        edges += [("dead zone, negative side", says.falling), ("dead zone, width", says.width)]
        if one.resolution is not None:
            edges.append(
                (f"resolution at {one.resolution.reference_dps:.3g} deg/s", one.resolution.says.threshold)
            )
        rows += [(one.axis, name, in_words(edge)) for name, edge in edges]
    return TextTable(("axis", "of", "found"), tuple(rows))


def _rungs(series: Series) -> TextTable:
    found = series.found
    order = np.argsort(found.input_dps)
    rows = tuple(
        (f"{found.input_dps[k]:+.6g}", with_uncertainty(float(found.ratio[k]), float(found.ratio_u[k])))
        for k in order
    )
    return TextTable(("input, deg/s", "r"), rows)


def _ratios_svg(one: AxisThreshold, series: Series, name: str) -> str:
    """Draw r of both senses against the size of the input."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        found, edge = series.found, series.says.threshold
        smallest, largest = float(np.abs(found.input_dps).min()), float(np.abs(found.input_dps).max())
        low, high = max(edge.low_95, smallest / 3), min(edge.high_95, 3 * largest)
        axes.axvspan(low, high, color=LINE, linewidth=0, zorder=0)
        for sense, colour, mark, label in (
            (1, ACCENT, "o", "positive input"),
            (-1, SECOND, "s", "negative input"),
        ):
            chosen = sense * found.input_dps > 0
            if chosen.any():
                u = NORMAL_95 * found.ratio_u[chosen]
                axes.errorbar(
                    np.abs(found.input_dps[chosen]), found.ratio[chosen], u, fmt=mark, ms=4, capsize=2,
                    color=colour, linewidth=0.9, label=label,
                )  # fmt: skip
        for part in (0.5, 0.1):
            axes.axhline(part, color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set(xscale="log", xlabel="size of the input, deg/s", ylabel="r, output over expected")
        axes.set_xlim(smallest / 2, largest * 2)
        legend_above(axes, columns=2)

    return svg_element(f"{name}-{one.axis}", WIDE if series.found.input_dps.size > 6 else HALF, draw)
