"""An uncertainty budget as bars, the largest contribution on top."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.budget import Budget
from station.plots import ACCENT, INK, SECOND, SOFT, _svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINES_SHOWN = 12


def budget_svg(budget: Budget, name: str = "budget") -> str:
    """Draw the contributions of a budget in percent of the lock-in rate.

    Parameters
    ----------
    budget : Budget
    name : str, optional
        Sets the ids of the figure apart from those of others on one page.

    Returns
    -------
    str
        SVG element.
    """
    lines = [line for line in budget.inputs if line.contribution > 0][:_LINES_SHOWN]
    labels = ["combined", *(line.quantity for line in lines)]
    percent = [100 * u / budget.lock_in_rate for u in (budget.combined_u, *(line.contribution for line in lines))]

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        places = range(len(labels), 0, -1)
        bars = axes.barh(list(places), percent, height=0.62, color=[SECOND, *[ACCENT] * len(lines)])
        axes.bar_label(bars, labels=[f"{value:.2g} %" for value in percent], padding=4, color=INK, fontsize=8.5)
        axes.set_yticks(list(places), labels, color=INK)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.set_xscale("log")
        axes.set_xlim(max(min(percent), max(percent) * 1e-6) * 0.4, max(percent) * 4)
        axes.set_xlabel("standard uncertainty, % of the lock-in rate", color=SOFT)

    return _svg(name, (10.0, 0.9 + 0.3 * len(labels)), draw)
