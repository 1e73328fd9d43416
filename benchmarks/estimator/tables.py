"""The results as Markdown tables, the same on a terminal and in docs/estimator.md."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from benchmarks.estimator.accuracy import (
    OUTLIER,
    PERIOD_EDGES,
    RATE_EDGES,
    SIGNIFICANT,
    Cell,
    GridResult,
    cell_of,
    cells_of,
    outliers,
    within,
)
from benchmarks.estimator.coverage import LEVEL, Coverage
from benchmarks.estimator.speed import Speed

FEWEST = 30
"""A cell with fewer records is not shown and cannot be the worst."""

BROAD = (1.02, 1.5, 5.0, 20.0, 100.0)


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table with columns padded to one width."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    lines = [header, ["-" * width for width in widths], *rows]
    return "\n".join("| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in lines)


def efficiency_table(grid: GridResult) -> str:
    """One row per method: error over bound, bias, error in percent, wrong frequencies."""
    rows = []
    for errors in grid.errors:
        cell = cell_of(errors, grid.significant)
        wrong, missing, read = outliers(errors)
        rows.append(
            (
                errors.method,
                f"{cell.records}",
                f"{cell.rms:.3f} ± {cell.rms_u:.3f}" if cell.rms < 1.5 else _number(cell.rms),
                f"{cell.robust:.3g}",
                f"{cell.bias:+.3f} ± {cell.bias_u:.3f}" if cell.rms < 1.5 else _number(cell.bias, sign=True),
                f"{100 * cell.relative_median:.2f} %",
                f"{wrong} of {read}" + (f", {missing} gave up" if missing else ""),
                f"{1e6 * errors.seconds:.0f} µs",
            )
        )
    header = (
        "method",
        f"records with r > {SIGNIFICANT:g} u",
        "rms error / bound",
        "the same from the median",
        "mean error / bound",
        "median error of WL",
        f"frequency wrong by > {OUTLIER:g} bounds",
        "time per record",
    )
    return table(header, rows)


def by_rate_table(grid: GridResult) -> str:
    """rms error over bound of each method in broad ranges of |W|/WL."""
    header = ["method", *(f"W/WL {low:g}-{high:g}" for low, high in pairwise(BROAD))]
    rows = []
    for errors in grid.errors:
        cells = (
            cell_of(errors, grid.significant & within(grid.gyros.rate_over_lock_in, BROAD, number))
            for number in range(len(BROAD) - 1)
        )
        rows.append([errors.method, *(_number(cell.rms) for cell in cells)])
    return table(header, rows)


def cells_table(grid: GridResult) -> str:
    """rms error over bound of our estimator in every cell, with its standard error."""
    header = ["W/WL", *(f"{low:g}-{high:g} periods" for low, high in pairwise(PERIOD_EDGES))]
    rows = []
    for number, row in enumerate(cells_of(grid, grid.errors[0])):
        rows.append([f"{RATE_EDGES[number]:g}-{RATE_EDGES[number + 1]:g}", *(_cell(cell) for cell in row)])
    return table(header, rows)


def worst_cell(grid: GridResult) -> str:
    """Which cell is worst, and how bad the worst of so many cells of a perfect estimator would look."""
    named = [
        (
            cell,
            f"W/WL {RATE_EDGES[i]:g}-{RATE_EDGES[i + 1]:g}, {PERIOD_EDGES[j]:g}-{PERIOD_EDGES[j + 1]:g} periods",
        )
        for i, row in enumerate(cells_of(grid, grid.errors[0]))
        for j, cell in enumerate(row)
        if cell.records >= FEWEST
    ]
    if not named:
        return "No cell holds enough records: ask for more."
    cell, name = max(named, key=lambda item: item[0].rms)
    biased, biased_name = max(named, key=lambda item: abs(item[0].bias))
    chance = _largest_by_chance([c.records for c, _ in named])
    return (
        f"Worst cell of gyrolock: {cell.rms:.3f} ± {cell.rms_u:.3f} ({name}, {cell.records} records); the worst "
        f"of so many cells of a perfect estimator would be {chance:.3f} on average. Largest bias: "
        f"{biased.bias:+.3f} ± {biased.bias_u:.3f} u ({biased_name}, {biased.records} records)."
    )


def coverage_table(results: Sequence[Coverage]) -> str:
    """One row per case; the share is followed by its binomial standard deviation."""
    rows = [
        (
            c.case,
            f"{c.records}",
            f"{100 * c.covered:.1f} ± {100 * np.sqrt(LEVEL * (1 - LEVEL) / c.records):.1f} %",
            f"{100 * c.below:.1f} / {100 * c.above:.1f} %",
            f"{100 * c.worst:.1f} ± {100 * np.sqrt(LEVEL * (1 - LEVEL) / c.worst_records):.1f} % ({c.worst_cell})"
            if c.worst_records
            else "too few records",
        )
        for c in results
    ]
    header = ("95 % interval", "intervals", "holds the truth", "truth below / above", "cell furthest from 95 %")
    return table(header, rows)


def ratio_coverage_table(multiples: Sequence[float], inside: Sequence[float], symmetric: Sequence[float]) -> str:
    """Coverage against the true ratio in units of its uncertainty."""
    rows = [
        (f"{m:g}", f"{100 * a:.1f} %", f"{100 * b:.1f} %")
        for m, a, b in zip(multiples, inside, symmetric, strict=True)
    ]
    return table(("true r/u", "interval", "value ± 1.96 u"), rows)


def speed_table(results: Sequence[Speed]) -> str:
    """One row per comparison."""
    rows = [
        (s.what, f"{1e6 * s.ours:.1f} µs", f"{1e6 * s.yardstick:.1f} µs", f"{s.ratio:.3g}", s.accuracy)
        for s in results
    ]
    return table(("comparison", "ours, per record", "the other", "ratio", "note"), rows)


def _largest_by_chance(records: Sequence[int]) -> float:
    """Mean of the largest rms among cells of unit Gaussian errors."""
    rng = np.random.default_rng(0)
    draws = rng.chisquare(np.asarray(records), size=(2000, len(records))) / np.asarray(records)
    return float(np.sqrt(draws).max(axis=1).mean())


def _cell(cell: Cell) -> str:
    return f"{cell.rms:.2f} ± {cell.rms_u:.2f}" if cell.records >= FEWEST else "few"


def _number(value: float, *, sign: bool = False) -> str:
    """Three digits, without an exponent that a reader would have to decode below a million."""
    if not np.isfinite(value):
        return "none"
    text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}" if abs(value) < 1e6 else f"{value:.1e}"
    return ("+" if sign and value > 0 else "") + text
