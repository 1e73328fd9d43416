"""The pictures of docs/estimator.md."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.arrays import Floats
from benchmarks.estimator.accuracy import GridResult, cell_of, within
from benchmarks.estimator.methods import OURS
from benchmarks.estimator.speed import Speed

EDGES = (1.02, 1.1, 1.3, 1.7, 2.5, 4.0, 7.0, 12.0, 25.0, 50.0, 100.0)
FEWEST = 40
COLOURS = (
    "#111111",
    "#c0392b",
    "#e59866",
    "#1f618d",
    "#7fb3d5",
    "#7d3c98",
    "#c39bd3",
    "#1e8449",
    "#82c99d",
    "#b7950b",
)
MARKERS = "osD^v<>PX*"


def draw_all(
    folder: Path, grid: GridResult, coverage: tuple[Floats, Floats, Floats], n_coverage: int, speeds: list[Speed]
) -> list[Path]:
    """Write the three pictures into `folder`, which is made if need be; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "estimator_error.png": error_over_bound(grid),
        "estimator_coverage.png": coverage_against_ratio(*coverage, n_coverage),
        "estimator_time.png": time_per_record(grid, speeds),
    }
    for name, figure in figures.items():
        figure.savefig(folder / name, dpi=110)
        plt.close(figure)
    return [folder / name for name in figures]


def error_over_bound(grid: GridResult) -> Figure:
    """Error over bound, from the median, against |W|/WL, one line per method."""
    figure, axes = plt.subplots(figsize=(8.2, 6.6), layout="constrained")
    ratio = grid.gyros.rate_over_lock_in
    centres = np.sqrt(np.multiply(EDGES[:-1], EDGES[1:]))
    for errors, colour, marker in zip(grid.errors, COLOURS, MARKERS, strict=True):
        cells = [cell_of(errors, grid.significant & within(ratio, EDGES, n)) for n in range(len(EDGES) - 1)]
        error = [cell.robust if cell.records >= FEWEST else np.nan for cell in cells]
        width = 2.6 if errors.method == OURS else 1.2
        axes.plot(centres, error, color=colour, marker=marker, lw=width, ms=5, label=errors.method, zorder=width)
    axes.axhline(1, color="grey", lw=1, ls="--")
    axes.text(100, 0.9, "Cramér-Rao bound", ha="right", va="top", color="grey", fontsize=9)
    axes.set(xscale="log", yscale="log", xlabel="W / WL", ylabel="error of WL / bound", ylim=(0.6, 400))
    axes.set_xticks([1, 2, 3, 5, 10, 20, 50, 100], ["1", "2", "3", "5", "10", "20", "50", "100"])
    axes.set_yticks([1, 2, 5, 10, 20, 50, 100, 200], ["1", "2", "5", "10", "20", "50", "100", "200"])
    axes.minorticks_off()
    _finish(axes, "Error of the lock-in rate (median, scaled to a standard deviation) over the bound")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def coverage_against_ratio(multiples: Floats, inside: Floats, symmetric: Floats, n_records: int) -> Figure:
    """Share of truths inside the interval, and inside a symmetric error bar, against r/u."""
    figure, axes = plt.subplots(figsize=(7.2, 4.0), layout="constrained")
    spread = 196 * np.sqrt(0.95 * 0.05 / n_records)
    axes.axhspan(95 - spread, 95 + spread, color="#dddddd", label="95 % and its sampling scatter")
    axes.plot(multiples, 100 * inside, "o-", color=COLOURS[0], lw=2, label="interval low_95 to high_95")
    axes.plot(multiples, 100 * symmetric, "s--", color=COLOURS[1], lw=1.2, label="value ± 1.96 u")
    axes.set(
        xlabel="true harmonic ratio r over its standard uncertainty", ylabel="holds the truth / %", ylim=(85, 100)
    )
    axes.legend(loc="lower right", fontsize=9, frameon=False)
    _finish(axes, f"Coverage of the 95 % interval, {n_records} records per point")
    return figure


def time_per_record(grid: GridResult, speeds: list[Speed]) -> Figure:
    """Time per record of every method, and of one FFT."""
    figure, axes = plt.subplots(figsize=(8.2, 4.0), layout="constrained")
    names = ["one scipy.fft.rfft", *(errors.method for errors in grid.errors)]
    micros = 1e6 * np.array([speeds[0].yardstick, *(errors.seconds for errors in grid.errors)])
    colours = ["#999999", *COLOURS]
    places = np.arange(len(names))[::-1]
    axes.barh(places, micros, color=colours, height=0.7)
    for place, value in zip(places, micros, strict=True):
        axes.text(value * 1.08, place, f"{value:.0f} µs", va="center", fontsize=9)
    axes.set_yticks(places, names, fontsize=9)
    axes.set(xscale="log", xlabel="time per record of 2500 samples / µs, one thread", xlim=(3, micros.max() * 4))
    _finish(axes, "Time per record, whole grid")
    axes.set_xticks([10, 100, 1000], ["10", "100", "1000"])
    axes.minorticks_off()
    axes.grid(axis="y", visible=False)
    return figure


def _finish(axes: Axes, title: str) -> None:
    axes.set_title(title, fontsize=11, loc="left")
    axes.grid(color="#e5e5e5", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
