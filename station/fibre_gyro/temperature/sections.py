"""Scale factor and bias over the temperature in the report: points, model, what it leaves, compensation table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.fibre_gyro import NORMAL_95
from station.fibre_gyro.common import COUNTS_PER_DPS
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.temperature.compensation import compensation_of
from station.fibre_gyro.temperature.evaluate import AxisTemperature, Modelled, TemperatureFound
from station.fibre_gyro.temperature.result import table_of_models
from station.report.figure import ACCENT, HALF, INK, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.numbers import with_uncertainty
from station.results.parts import PlacedFigure, Section, TextTable
from station.results.result import Result
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def sections(found: TemperatureFound, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    made = [Section("Which models, and why", sentences=result.sentences)]
    for one in found.axes:
        figures = []
        if one.bias is not None:
            caption = "Bias less its part from dT/dt; line and band: model and its 95 %."
            figures.append(PlacedFigure(_model_svg(one.bias, f"bias-{one.axis}", "bias, deg/h"), caption))
        if one.scale is not None:
            caption = "Scale factor; line and band: model and its 95 %."
            label = "K less design, ppm"
            figures.append(PlacedFigure(_model_svg(one.scale, f"scale-{one.axis}", label), caption))
        made.append(Section(f"Axis {one.axis}", figures=tuple(figures), table=table_of_models(one)))
        if one.bias is not None:
            caption = "What the model of the bias leaves, and the temperature, in time."
            figure = PlacedFigure(_residual_svg(one.bias, one.axis), caption)
            made.append(Section(f"Residuals of the bias, axis {one.axis}", figures=(figure,)))
        text = "Of measured temperatures only. `gyrolock fog constants` writes it as CSV and C header."
        made.append(Section(f"Compensation table, axis {one.axis}", text, table=_compensation(one, settings)))
    return made


def _compensation(one: AxisTemperature, settings: FogSettings) -> TextTable:
    table = compensation_of(one, settings)
    columns = (table.temperature, table.scale_factor, table.scale_factor_u, table.bias, table.bias_u)
    rows = tuple(
        (f"{warm:g}", with_uncertainty(float(k), float(k_u)), with_uncertainty(float(bias), float(bias_u)))
        for warm, k, k_u, bias, bias_u in zip(*columns, strict=True)
    )
    return TextTable(("°C", f"K, {COUNTS_PER_DPS}", "bias, deg/h"), rows)


def _model_svg(modelled: Modelled, name: str, label: str) -> str:
    """Draw points and model against the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        points, model = modelled.points, modelled.model
        warm = np.linspace(model.lowest, model.highest, 200)
        value, u = model.at(warm)
        by_rate = model.rate_coefficient * points.rate if model.with_rate else np.zeros(points.rate.size)
        for rising, colour, mark, text in ((True, SECOND, "^", "warming"), (False, ACCENT, "v", "cooling")):
            chosen = (points.rate >= 0) == rising
            if chosen.any():
                axes.errorbar(
                    points.temperature[chosen], (points.value - by_rate)[chosen], points.value_u[chosen], fmt=mark,
                    ms=2.8, color=colour, linewidth=0.4, alpha=0.7, label=text,
                )  # fmt: skip
        axes.fill_between(warm, value - NORMAL_95 * u, value + NORMAL_95 * u, color=SOFT, alpha=0.35, linewidth=0)
        axes.plot(warm, value, color=INK, linewidth=1.2, label=f"order {model.order}")
        axes.set(xlabel="temperature, °C", ylabel=label)
        legend_above(axes, columns=3)

    return svg_element(name, HALF, draw)


def _residual_svg(modelled: Modelled, axis: str) -> str:
    """Draw what the model leaves in time, with the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        hours = modelled.points.at_s / 3600
        axes.errorbar(
            hours, modelled.model.residual, modelled.points.value_u, fmt="o", ms=2.8, color=INK, linewidth=0.4
        )
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="time, h", ylabel="left of the bias, deg/h")
        beside = axes.twinx()
        beside.plot(hours, modelled.points.temperature, color=SECOND, linewidth=1.0)
        beside.grid(visible=False)
        beside.set_ylabel("temperature, °C", color=SECOND)

    return svg_element(f"bias-residuals-{axis}", WIDE, draw)
