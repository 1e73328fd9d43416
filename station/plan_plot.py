"""Uncertainty of the lock-in rate against the rate at which it is measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.picture import svg_element, write_picture
from station.plan import PAPER_OVER_LOCK_IN, PlannedMeasurement
from station.plot_style import ACCENT, INK, SECOND, SOFT, THIRD, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = (8.4, 4.8)
_LEAST_SHARE = 0.02
"""A part that nowhere makes this much of the total is not drawn."""


def plan_svg(planned: PlannedMeasurement) -> str:
    """Draw the curve of a plan as an SVG element."""
    return svg_element("plan", _SIZE, lambda figure: _draw(figure, planned))


def write_plan_plot(path: Path, planned: PlannedMeasurement) -> None:
    """Draw the curve of a plan into a .svg, .png or .pdf file.

    Raises
    ------
    UsageError, OSError
    """
    write_picture(path, "plan", _SIZE, lambda figure: _draw(figure, planned))


def _draw(figure: Figure, planned: PlannedMeasurement) -> None:
    axes = figure.add_subplot()
    curve, plan = planned.curve, planned.plan
    over, total = curve.over_lock_in, 100 * curve.total
    axes.plot(over, total, color=INK, linewidth=2.2, label="all together", zorder=5)
    reference = "scale factor, time base" if plan.request.reference == "beat" else "rate on the axis"
    for name, label, color in (
        ("noise", "noise and rounding", ACCENT),
        ("distortion", "distortion", SECOND),
        ("reference", reference, THIRD),
        ("channel", "bandwidth, gain", SOFT),
    ):
        part = 100 * getattr(curve, name)
        if np.any(part > _LEAST_SHARE * total):
            axes.plot(over, part, color=color, label=label)
    axes.set(xscale="log", yscale="log", xlim=(1, float(over[-1])))
    axes.set_ylim(max(float(total.min()) / 8, 1e-4), float(total.max()) * 1.5)
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
    wanted = 100 * plan.request.wanted_u
    axes.axhline(wanted, color=SOFT, linewidth=0.9, linestyle=(0, (5, 3)))
    right = axes.get_yaxis_transform()
    axes.text(0.995, wanted, "wanted", transform=right, ha="right", va="bottom", color=SOFT, fontsize=8.5)
    for place in sorted({rate.over_lock_in for rate in plan.rates}):
        axes.axvline(place, color=ACCENT, linewidth=0.9, linestyle=(0, (2, 2)))
    at = [float(np.interp(np.log(x), np.log(curve.over_lock_in), 100 * curve.total)) for x in _places(planned)]
    axes.plot(_places(planned), at, "o", color=INK, ms=6, zorder=6)
    axes.axvline(PAPER_OVER_LOCK_IN, color=SECOND, linewidth=0.9, linestyle=(0, (2, 2)))
    top = axes.get_xaxis_transform()
    axes.text(plan.rates[0].over_lock_in * 1.03, 0.97, "plan", transform=top, va="top", color=ACCENT, fontsize=8.5)
    axes.text(
        PAPER_OVER_LOCK_IN * 1.03, 0.97, "20, as in the paper", transform=top, va="top", color=SECOND, fontsize=8.5
    )


def _places(planned: PlannedMeasurement) -> list[float]:
    return [*sorted({rate.over_lock_in for rate in planned.plan.rates}), PAPER_OVER_LOCK_IN]
