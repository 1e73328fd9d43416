"""Uncertainty of the lock-in rate against the rate at which it is measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.plan.plan import PAPER_OVER_LOCK_IN, PlannedMeasurement
from station.report.figure import ACCENT, INK, SECOND, SOFT, THIRD, legend_above, svg_element, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = (8.4, 4.8)
_DEPTH = 12.0
"""The plot reaches this factor below the smallest uncertainty."""


def plan_svg(planned: PlannedMeasurement) -> str:
    """Draw the curve of a plan as an SVG element."""
    return svg_element("plan", _SIZE, lambda figure: _draw(figure, planned))


def write_plan_plot(path: Path, planned: PlannedMeasurement) -> None:
    """Draw the curve of a plan into a .svg, .png or .pdf file."""
    write_picture(path, "plan", _SIZE, lambda figure: _draw(figure, planned))


def _draw(figure: Figure, planned: PlannedMeasurement) -> None:
    axes = figure.add_subplot()
    curve, plan = planned.curve, planned.plan
    over, total = curve.over_lock_in, 100 * curve.total
    lowest = float(total.min()) / _DEPTH
    axes.plot(over, total, color=INK, linewidth=2.2, label="all together", zorder=5)
    reference = "scale factor, time base" if plan.request.reference == "beat" else "rate on the axis"
    for name, label, color in (
        ("noise", "noise and rounding", ACCENT),
        ("distortion", "distortion", SECOND),
        ("reference", reference, THIRD),
        ("channel", "bandwidth, gain", SOFT),
    ):
        part = 100 * getattr(curve, name)
        if np.any(part > lowest):
            axes.plot(over, part, color=color, label=label)
    axes.set(xscale="log", yscale="log", xlim=(1, float(over[-1])), ylim=(lowest, float(total.max()) * 1.5))
    axes.set_xlabel("rate on the axis over lock-in rate, W/WL")
    each = f"{curve.records} record{'s' if curve.records > 1 else ''} at one rate"
    senses = " in each sense" if plan.request.both_senses else ""
    axes.set_ylabel(f"standard uncertainty of the lock-in rate, %\n({each}{senses})")
    ticks = [1, 2, 3, 5, 8, 15, 20, 30, 50, 100]
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _mark(axes, planned)
    legend_above(axes, columns=5)


def _mark(axes: Axes, planned: PlannedMeasurement) -> None:
    """Mark the wanted uncertainty, the plan's rates and the paper's advice."""
    plan, curve = planned.plan, planned.curve
    rates = sorted({rate.over_lock_in for rate in plan.rates})
    lines = [(100 * plan.request.wanted_u, "wanted", SOFT)]
    if len(rates) > 1:
        lines.append((100 * plan.budget.relative_u, "all rates together", ACCENT))
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0}
    for percent, text, color in lines:
        axes.axhline(percent, color=color, linewidth=0.9, linestyle=(0, (5, 3)))
        at = axes.get_yaxis_transform()
        axes.text(
            0.99,
            percent,
            text,
            transform=at,
            ha="right",
            va="center",
            color=color,
            fontsize=8.5,
            bbox=box,
            zorder=7,
        )
    verticals = [(rates[0], "plan", ACCENT, 0.97), *((rate, "", ACCENT, 0.97) for rate in rates[1:])]
    verticals.append((PAPER_OVER_LOCK_IN, "20, as in the paper", SECOND, 0.91))
    for rate, text, color, height in verticals:
        axes.axvline(rate, color=color, linewidth=0.9, linestyle=(0, (2, 2)))
        at = axes.get_xaxis_transform()
        axes.text(rate * 1.03, height, text, transform=at, va="top", color=color, fontsize=8.5, bbox=box, zorder=7)
    places = [*rates, PAPER_OVER_LOCK_IN]
    values = np.interp(np.log(places), np.log(curve.over_lock_in), 100 * curve.total)
    axes.plot(places, values, "o", color=INK, ms=6, zorder=6)
