"""Results of many runs over time, each unit in its own colour."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.catalogue.entry import Entry, Value
from station.errors import NoUsableSignal
from station.report.figure import ACCENT, INK, SECOND, THIRD, legend_above, write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = (ACCENT, SECOND, THIRD, "#8a4f9e", "#b08a1e", "#3f8f9b", "#a23b4a", "#5b6875")
_MARKERS = "osD^vP<>"
_WIDTH, _HEIGHT, _MOST_PANELS = 9.5, 3.0, 8
Series = dict[str, dict[str, list[tuple[Entry, Value]]]]
"""Values by what they are, and by unit."""


def write_trend(path: Path, entries: Sequence[Entry]) -> int:
    """Draw the results of runs over time into a file, and return how many."""
    series = series_of(entries)
    write_picture(path, "trend", trend_size(series), lambda figure: draw_trend(figure, series))
    return sum(len(values) for units in series.values() for values in units.values())


def draw_trend(figure: Figure, series: Series) -> None:
    """Draw one panel for each number, most often measured first; with 95 % of what every input does to it."""
    shown = sorted(series.items(), key=lambda one: -sum(map(len, one[1].values())))[:_MOST_PANELS]
    panels: Any = figure.subplots(len(shown), squeeze=False, sharex=True)
    for (name, units), axes in zip(shown, panels[:, 0], strict=True):
        for place, (unit, values) in enumerate(sorted(units.items())):
            colour = _COLOURS[place % len(_COLOURS)]
            marker = _MARKERS[place // len(_COLOURS) % len(_MARKERS)]
            times = [datetime.fromisoformat(entry.started_at) for entry, _ in values]
            numbers = [value.value for _, value in values]
            bars = [0.0 if value.u != value.u else 1.96 * value.u for _, value in values]
            axes.errorbar(
                times, numbers, bars, color=colour, lw=0.7, elinewidth=0.8, alpha=0.9, label=unit, zorder=2
            )
            for entry, when, number in zip([entry for entry, _ in values], times, numbers, strict=True):
                fill = "white" if entry.mark == "bad" or entry.standing == "fails" else colour
                axes.plot([when], [number], marker, ms=4.5, mfc=fill, mec=colour, zorder=3)
                if entry.verdict == "FAIL":
                    axes.plot([when], [number], "x", ms=9, color=INK, zorder=4)
        axes.set_ylabel(name)
        axes.ticklabel_format(axis="y", useOffset=False)
        legend_above(axes, columns=6)
    panels[-1, 0].set_xlabel(
        "when the run began, UTC (bars: 95 %; hollow: marked bad or fails its checks; x: FAIL)"
    )


def trend_size(series: Series) -> tuple[float, float]:
    """Width and height of the figure, inches."""
    return _WIDTH, _HEIGHT * min(len(series), _MOST_PANELS) + 0.3


def series_of(entries: Sequence[Entry]) -> Series:
    """Sort results by what they are and by unit."""
    found: Series = {}
    for entry in entries:
        for value in entry.values:
            if value.value == value.value and entry.started_at:
                label = _label(value)
                unit = entry.unit or entry.gyro or "no unit named"
                found.setdefault(label, {}).setdefault(unit, []).append((entry, value))
    if not found:
        raise NoUsableSignal("none of the runs has a result that could be drawn")
    return found


def _label(value: Value) -> str:
    """Name of an axis: words of the key, what it is of, unit."""
    parts = value.name.split("_")
    if "per" in parts:
        parts = parts[: parts.index("per") - 1]
    elif value.unit:
        parts = parts[:-1]
    words = " ".join(parts).replace("lock in", "lock-in")
    return f"{words} {value.of}".strip() + (f"\n{value.unit}" if value.unit else "")
