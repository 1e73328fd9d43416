"""The 2 pi error in the report: figures and table of the injected steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from station.fibre_gyro.common import staircase_section
from station.fibre_gyro.eps.evaluate import EpsFound
from station.fibre_gyro.settings import FogSettings
from station.report.figure import ACCENT, HALF, INK, SECOND, SOFT, legend_above, svg_element
from station.results.contributions import budget_table
from station.results.numbers import with_uncertainty
from station.results.parts import PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def sections(found: EpsFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    rows = tuple(
        (f"{step:+g} codes", with_uncertainty(float(n), float(nu)), with_uncertainty(float(r), float(ru)))
        for step, n, nu, r, ru in zip(
            found.step_codes, found.normal, found.normal_u, found.reset, found.reset_u, strict=True
        )
    )
    header = ("injected step", "error without reset, counts", "error with reset, counts")
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Pairs with and without a reset",
            figures=(
                PlacedFigure(_errors_svg(found), "Demodulated error against the injected step."),
                PlacedFigure(_reset_differences_svg(found), "Their difference is the 2π error alone."),
            ),
            table=TextTable(header, rows),
        ),
        Section("Budget", table=budget_table("2π error", result.document["budget"])),
        staircase_section(settings, open_loop_step=float(abs(found.step_codes).min())),
    ]


def _errors_svg(found: EpsFound) -> str:
    """Draw the demodulated error of pairs with and without a reset against the injected step."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        order = np.argsort(found.step_codes)
        step = found.step_codes[order]
        axes.plot(step, found.normal[order], "o-", ms=5, color=ACCENT, label="pairs without a reset")
        axes.plot(step, found.reset[order], "s--", ms=8, mfc="none", color=SECOND, label="pairs with a reset")
        axes.set(xlabel="injected step, codes", ylabel="error, converter counts")
        legend_above(axes, columns=2)

    return svg_element("errors", HALF, draw)


def _reset_differences_svg(found: EpsFound) -> str:
    """Draw the difference between pairs with and without a reset: the 2 pi error itself."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        order = np.argsort(found.step_codes)
        difference = (found.reset - found.normal)[order]
        u = np.hypot(found.reset_u, found.normal_u)[order]
        label = "measured, ±1 u"
        axes.errorbar(found.step_codes[order], difference, u, fmt="o", ms=5, color=INK, capsize=3, label=label)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="injected step, codes", ylabel="with less without reset, counts")
        legend_above(axes)

    return svg_element("reset-differences", HALF, draw)
