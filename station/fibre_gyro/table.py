"""The rate-table run: its plan, and its figures and tables in the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from analysis.fibre_gyro import check_whole_turns, turn_time
from station.errors import UsageError
from station.fibre_gyro.allan import NOISE
from station.fibre_gyro.common import COLOURS, COUNTS_PER_DPS, PPM, staircase_section
from station.fibre_gyro.logs import (
    LogRow,
    NamedSegment,
    gyro_measurement,
    listed_logs,
    planned_segments,
    table_conditions,
)
from station.fibre_gyro.segments import MARGIN_S, PlannedSegment
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table_result import (
    PURPOSE,
    QUANTITIES,
    AxisResult,
    TableEvaluation,
    evaluate,
    ladder_table,
    matrix_table,
    noise_sentence,
    result,
)
from station.report.figure import HALF, SOFT, WIDE, legend_above, svg_element
from station.results.result import PlacedFigure, Result, Section, TextTable, budget_table, ppm, with_uncertainty
from station.runs.acquisition import Acquisition
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from analysis.fibre_gyro import RateDifferences


# --------------------
# The rate-table run in the report: axes, output and residuals, numbers of small rates, runs


_MARKERS = "osD^vP"


def sections(found: TableEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    residuals = (
        "Output less fit; the bars are the standard uncertainty of each mean. Filled: positive sense; open: "
        "negative."
    )
    made = [
        Section("Scale factor of each axis", result.sentences[0], table=axis_table(found, settings)),
        Section(
            "Output and residuals",
            figures=(
                PlacedFigure(_output_svg(found), "Mean output over whole turns, and the fitted lines."),
                PlacedFigure(_residuals_svg(found), residuals),
            ),
        ),
    ]
    if differences := [(one, one.differences) for one in found.axes if one.differences is not None]:
        made.append(_difference_section(differences))
    if found.matrix is not None:
        text = (
            "All gyros were recorded at once. Diagonal: scale factor about each axis that was turned; beside it: "
            "direction of the input axis towards that axis, as the fixture brings it to the table's."
        )
        made.append(Section("Scale factors and misalignments", text, table=matrix_table(found.matrix)))
    if any(one.linearity is not None for one in found.axes):
        text = (
            "Scale-factor error as a polynomial of the rate over the largest: asymmetry between the senses, "
            "linear, quadratic and quartic term. A term is in it where it is more than three of its "
            "uncertainties. The nonlinearity is freed of what noise and scatter make of it."
        )
        figure = PlacedFigure(_ladder_svg(found), "Mean output less the straight line; curve: polynomial, ±1 u.")
        title, ladder = "Scale-factor error over the rates", ladder_table(found.axes)
        made.append(Section(title, text, figures=(figure,), table=ladder))
    for axis, one in zip(result.document["axes"], found.axes, strict=True):
        sentences = tuple(said for said in [noise_sentence(one)] if said)
        table = budget_table(f"K({one.axis})", axis["budget"])
        made.append(Section(f"Budget of K({one.axis})", sentences=sentences, table=table))
    rows = tuple(
        (
            key,
            f"{window.turns}",
            f"{window.duration_s:.3f}",
            f"{window.total:.10g}",
            with_uncertainty(window.mean, window.mean_u),
            f"{residual:+.3g}",
        )
        for one in found.axes
        for key, window, residual in zip(one.keys, one.windows, one.fit.residual_ppm, strict=True)
    )
    return [
        *made,
        staircase_section(settings),
        Section(
            "Runs",
            table=TextTable(("run", "turns", "window, s", "sum, counts", "mean, counts", "residual, ppm"), rows),
        ),
    ]


def axis_table(found: TableEvaluation, settings: FogSettings) -> TextTable:
    """Return what was found of each axis."""
    header = (
        "axis",
        f"K, {COUNTS_PER_DPS}",
        "less design",
        "even part, deg/h",
        "bias, deg/h",
        "scatter",
        "ARW, deg/√h",
    )
    return TextTable(header, tuple(_axis_row(one, settings) for one in found.axes))


def _axis_row(one: AxisResult, settings: FogSettings) -> tuple[str, ...]:
    fit = one.fit
    k_u = PPM * fit.scale_factor_u / abs(fit.scale_factor)
    return (
        one.axis,
        with_uncertainty(fit.scale_factor, fit.scale_factor_u),
        ppm(PPM * (fit.scale_factor / settings.nominal_scale_factor - 1), k_u),
        with_uncertainty(*fit.even_dph),
        with_uncertainty(*one.bias_dph),
        f"{fit.scatter_ppm:.2g} ppm",
        f"{fit.angle_random_walk:.2g}",
    )


def _difference_section(made: list[tuple[AxisResult, RateDifferences]]) -> Section:
    text = (
        "Differences of two large numbers, as the patent CN104634364A makes them. White noise hardly matters; "
        "what table rate, scale factor and bias change from run to run is multiplied by base rate over difference."
    )
    caption = (
        "Each number against K by least squares times the rate. Thick: standard uncertainty from noise; thin: "
        "with the irreproducibility."
    )
    rows = []
    for one, differences in made:
        for place in range(differences.delta_dps.size):
            number, delta = float(differences.number[place]), float(differences.delta_dps[place])
            rows.append(
                (
                    f"{one.axis}, {delta:.6g} deg/s",
                    with_uncertainty(number, float(differences.number_u[place])),
                    f"{PPM * differences.noise_u[place] / abs(number):.4g} ppm",
                    f"{PPM * differences.irreproducibility_u[place] / abs(number):.4g} ppm",
                    f"{PPM * (number / (one.fit.scale_factor * delta) - 1):+.3g} ppm",
                )
            )
    header = ("difference for", "N, counts", "u from noise", "u from irreproducibility", "off the fit")
    figure = PlacedFigure(_differences_svg(made), caption)
    return Section("Numbers of small rates", text, figures=(figure,), table=TextTable(header, tuple(rows)))


def _output_svg(found: TableEvaluation) -> str:
    """Draw the mean output of every run against the table's rate, with the fitted lines."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, one in enumerate(found.axes):
            rate, sign = one.runs.rate_dps, one.runs.end_up
            span = np.array([min(0.0, rate.min()), max(0.0, rate.max())]) * 1.04
            colour, style = COLOURS[index % 7], (0, (6, 2 * index))
            axes.plot(span, one.fit.scale_factor * span, color=colour, linestyle=style, linewidth=1.0)
            axes.plot(
                rate, sign * one.runs.mean, _MARKERS[index % 6], ms=8 - 2 * (index % 3), mfc="none",
                color=colour, label=f"axis {one.axis}",
            )  # fmt: skip
        axes.set(xlabel="rate of the table, deg/s", ylabel="mean output, counts")
        legend_above(axes)

    return svg_element("output", HALF, draw)


def _residuals_svg(found: TableEvaluation) -> str:
    """Draw the residuals of every run in ppm of its output, senses side by side."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        sizes = sorted({round(float(abs(rate)), 9) for one in found.axes for rate in one.runs.nominal_dps})
        width = 0.8 / (2 * len(found.axes))
        for index, one in enumerate(found.axes):
            place = np.array([sizes.index(round(float(abs(rate)), 9)) for rate in one.runs.nominal_dps])
            forward = one.runs.nominal_dps > 0
            offset = (2 * index - len(found.axes) + np.where(forward, 1.5, 0.5)) * width
            u = PPM * one.runs.mean_u / np.abs(one.runs.mean)
            for chosen, filled in ((forward, True), (~forward, False)):
                axes.errorbar(
                    (place + offset)[chosen], one.fit.residual_ppm[chosen], yerr=u[chosen], fmt="o", ms=4,
                    mfc=COLOURS[index % 7] if filled else "white", color=COLOURS[index % 7], capsize=2,
                    linewidth=0.9, label=f"axis {one.axis}" if filled else None,
                )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes])
        axes.set(xlabel="rate of the table, deg/s", ylabel="residual, ppm of output")
        legend_above(axes)

    return svg_element("residuals", HALF, draw)


def _ladder_svg(found: TableEvaluation) -> str:
    """Draw how far the output lies off the straight line at each rate, ppm of full scale, and the polynomial."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, one in enumerate(found.axes):
            ladder, colour = one.linearity, COLOURS[index % 7]
            if ladder is None:
                continue
            rate = one.runs.end_up * one.runs.rate_dps
            full = float(np.abs(rate).max())
            along = one.runs.end_up * one.runs.mean
            left = PPM * (along - np.polyval(np.polyfit(rate, along, 1), rate)) / np.abs(along).max()
            bars = PPM * one.runs.mean_u / np.abs(one.runs.mean).max()
            axes.errorbar(
                rate, left, bars, fmt=_MARKERS[index % 6], ms=4, mfc="none", color=colour, label=one.axis
            )
            curve, u = (part * ladder.rate_dps / full for part in (ladder.error_ppm, ladder.error_u_ppm))
            axes.plot(ladder.rate_dps, curve, color=colour, linewidth=1.0)
            axes.fill_between(ladder.rate_dps, curve - u, curve + u, color=colour, alpha=0.2, linewidth=0)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="rate along the axis, deg/s", ylabel="off the line, ppm of full scale")
        legend_above(axes, columns=6)

    return svg_element("ladder", WIDE, draw)


def _differences_svg(made: list[tuple[AxisResult, RateDifferences]]) -> str:
    """Draw how far each difference is from K times the small rate, with both kinds of uncertainty."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, (one, differences) in enumerate(made):
            expected = one.fit.scale_factor * differences.delta_dps
            off = PPM * (differences.number / expected - 1)
            place = np.arange(off.size) + 0.18 * (index - (len(made) - 1) / 2)
            noise = PPM * differences.noise_u / np.abs(expected)
            both = PPM * differences.number_u / np.abs(expected)
            colour, label = COLOURS[index % 7], f"axis {one.axis}"
            axes.errorbar(place, off, yerr=both, fmt="none", color=colour, capsize=4, linewidth=0.8)
            axes.errorbar(place, off, yerr=noise, fmt="o", ms=4, color=colour, linewidth=2.6, label=label)
        deltas = made[0][1].delta_dps
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set_yscale("symlog", linthresh=10.0)
        axes.set_xticks(range(deltas.size), [f"N({delta:.3g})" for delta in deltas])
        axes.set(xlabel="difference for so many deg/s", ylabel="off from K times the rate, ppm")
        axes.set_xlim(-0.5, deltas.size - 0.5)
        legend_above(axes)

    return svg_element("differences", WIDE, draw)


def plan(settings: FogSettings, axes: Sequence[str] | None = None) -> list[PlannedSegment]:
    """List the segments of a run: each axis, each end up, each rate in both senses."""
    table, planned = settings.table, []
    for axis in axes or table.axes:
        for end_up in (1, -1) if table.both_ends_up else (1,):
            for size in table.rates_dps:
                for rate in (size, -size):
                    seconds = (table.window_s or table.turns * turn_time(rate)) + MARGIN_S
                    conditions = {"purpose": PURPOSE, "axis": axis, "end_up": end_up, "rate_dps": rate}
                    planned.append(PlannedSegment(_key(axis, rate, end_up), seconds, table.settle_s, conditions))
    return planned


def take(settings: FogSettings, session: Acquisition) -> None:
    """Take the segments on the bench."""
    for rate in settings.table.rates_dps if settings.table.window_s else ():
        try:
            check_whole_turns(settings.table.window_s, rate, tolerance_s=1 / settings.simulation.output_rate_hz)
        except ValueError as fault:
            session.progress.note(f"will be left out: {fault}")
    planned_segments(plan)(settings, session)


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by axis and rate of the table."""
    return [_named(row, settings) for row in rows]


def _named(row: LogRow, settings: FogSettings) -> NamedSegment:
    axis, rate, end_up = row.get("axis", settings.table.axes[-1]), row["rate_dps"], row["end_up"]
    if rate == 0:
        raise UsageError(f"{row['place']}, rate_dps: a rate-table run has no log at rest")
    conditions = {"axis": axis, "end_up": end_up, "rate_dps": rate, **table_conditions(row)}
    return _key(axis, rate, end_up), conditions


def _key(axis: str, rate_dps: float, end_up: int) -> str:
    """``"Z +20.01"``, ``"Z down -20"``."""
    return f"{axis}{'' if end_up > 0 else ' down'} {rate_dps:+.10g}"


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Scale factor by rate table",
    take=take,
    take_files=listed_logs(PURPOSE, ("rate_dps",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
    choices=(NOISE,),
)
