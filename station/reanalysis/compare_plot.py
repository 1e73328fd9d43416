"""Differences of two analyses over their uncertainties."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.reanalysis.compare import Comparison
from station.report.figure import ACCENT, INK, SECOND, SOFT, write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE = (9.0, 4.0)
_POINTS = 20_000


def write_comparison_plot(path: Path, found: Comparison) -> None:
    """Draw a comparison into a .svg, .png or .pdf file."""
    write_picture(path, "compare", _SIZE, lambda figure: _draw(figure, found))


def _draw(figure: Figure, found: Comparison) -> None:
    if found.same_records:
        _records(figure, found)
    else:
        _means(figure, found)


def _records(figure: Figure, found: Comparison) -> None:
    """Every record's difference in the lock-in rate, and how often which size occurs."""
    over_u = found.differences[0].over_u
    left, right = figure.subplots(1, 2, width_ratios=(3, 1), sharey=True)
    shown = np.linspace(0, over_u.size - 1, min(over_u.size, _POINTS)).astype(int)
    left.plot(shown + 1, over_u[shown], ".", color=ACCENT, markersize=4 if over_u.size < 500 else 2)
    for axes in (left, right):
        axes.axhline(0, color=INK, linewidth=0.8)
    left.set(xlabel="record in both", ylabel="lock-in rate: (B - A) over its uncertainty")
    right.hist(over_u, bins=min(60, max(8, over_u.size // 5)), orientation="horizontal", color=SECOND)
    right.set(xlabel="records")
    figure.suptitle(
        f"A: {Path(found.first.name).name}   B: {Path(found.second.name).name}", fontsize=9, color=SOFT
    )


def _means(figure: Figure, found: Comparison) -> None:
    """Both means with twice their uncertainty, one panel for each quantity."""
    panels = figure.subplots(1, len(found.differences), squeeze=False)[0]
    for axes, one in zip(panels, found.differences, strict=True):
        pairs = ((one.mean_first, one.mean_first_u, ACCENT), (one.mean_second, one.mean_second_u, SECOND))
        for place, (value, u, color) in enumerate(pairs):
            axes.errorbar([place], [value], [2 * u], fmt="o", color=color, capsize=4)
        axes.set_xticks([0, 1], ["A", "B"])
        axes.set(xlim=(-0.6, 1.6), title=f"{one.title}{', ' + one.unit if one.unit else ''}")
        axes.title.set_fontsize(9)
        axes.ticklabel_format(axis="y", useOffset=False)
    counted = (
        "noise and scatter" if found.by_noise is None else "every input for the lock-in rate, noise for the rest"
    )
    figure.supxlabel(f"with twice the standard uncertainty: {counted}", fontsize=9, color=SOFT)
