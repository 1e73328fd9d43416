"""The noise model in the report: Allan deviation with the fitted terms, and their table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.fibre_gyro import allan_variance
from station.fibre_gyro.allan.evaluate import AllanFound, NoiseOf
from station.fibre_gyro.allan.result import UNITS, term_table
from station.fibre_gyro.common import COLOURS
from station.fibre_gyro.settings import FogSettings
from station.report.figure import INK, SOFT, WIDE, legend_above, svg_element
from station.results.parts import PlacedFigure, Section
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def sections(found: AllanFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    caption = "Overlapping Allan deviation; bars: standard uncertainty. Line: fitted model; dashed: its terms."
    return [
        Section("What was fitted", sentences=result.sentences),
        *(
            Section(
                f"Noise of {one.key}", figures=(PlacedFigure(_svg(one, place), caption),), table=term_table(one)
            )
            for place, one in enumerate(found.records)
        ),
    ]


def _svg(one: NoiseOf, place: int) -> str:
    """Draw the Allan deviation, the model and its terms."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        tau = one.curve.tau_s
        deviation, u = 3600 * one.curve.deviation, 3600 * one.curve.deviation_u
        axes.errorbar(tau, deviation, u, fmt="o", ms=3, color=INK, linewidth=0.7, label="measured")
        model = 3600 * np.sqrt(allan_variance(one.fit.coefficients, tau))
        axes.plot(tau, model, color=COLOURS[0], linewidth=1.6, label="model")
        for index, (term, value) in enumerate(one.fit.coefficients.items(), start=1):
            curve = 3600 * np.sqrt(allan_variance({term: value}, tau))
            axes.plot(tau, curve, "--", color=COLOURS[index % 7], linewidth=0.9, label=UNITS[term][1])
        axes.set(xscale="log", yscale="log", xlabel="averaging time, s", ylabel="Allan deviation, deg/h")
        axes.set_ylim(0.5 * float(deviation.min()), 2.0 * float(deviation.max()))
        axes.grid(color=SOFT, linewidth=0.3)
        legend_above(axes, columns=4)

    return svg_element(f"allan-{place}", WIDE, draw)
