"""An uncertainty budget as bars, the largest contribution on top."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.budget import Budget, BudgetInput
from station.report.figure import ACCENT, INK, SECOND, svg_element

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINES_SHOWN = 12
_SMALLEST_SHOWN = 1e-4
"""Contributions below this share of the combined uncertainty are too small to be drawn."""


def budget_svg(budget: Budget, name: str = "budget") -> str:
    """Draw the contributions of a budget in percent of the lock-in rate."""

    def draw(figure: Figure) -> None:
        draw_budget(figure.add_subplot(), budget)

    return svg_element(name, (10.0, budget_height(budget)), draw)


def budget_height(budget: Budget) -> float:
    """Height in inches that the bars of a budget need."""
    return 1.0 + 0.29 * (len(_shown(budget)) + 1)


def draw_budget(axes: Axes, budget: Budget) -> None:
    """Draw the bars on given axes."""
    lines = _shown(budget)
    labels = ["combined", *(line.quantity for line in lines)]
    percent = [100 * u / budget.lock_in_rate for u in (budget.combined_u, *(line.contribution for line in lines))]
    places = list(range(len(labels), 0, -1))
    bars = axes.barh(places, percent, height=0.62, color=[SECOND, *[ACCENT] * len(lines)])
    axes.bar_label(bars, labels=[f"{value:.2g} %" for value in percent], padding=4, color=INK, fontsize=8.5)
    axes.set_yticks(places, labels, color=INK)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xscale("log")
    axes.set_xlim(min(percent) * 0.4, max(percent) * 4)
    axes.set_xlabel("standard uncertainty, % of the lock-in rate")


def _shown(budget: Budget) -> list[BudgetInput]:
    least = _SMALLEST_SHOWN * budget.combined_u
    return [line for line in budget.inputs if line.contribution > least][:_LINES_SHOWN]
