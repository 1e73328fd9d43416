"""`python -m benchmarks.estimator`: measure the estimator and its rivals, print the tables."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from benchmarks.estimator import accuracy, coverage, speed, tables
from benchmarks.estimator.gyros import N_SAMPLES

QUICK_RECORDS = 1_500
DEFAULT_RECORDS = 100_000
PAGE_MARKS = ("<!-- tables of python -m benchmarks.estimator -->", "<!-- end of tables -->")


@dataclass(frozen=True)
class Sizes:
    """How many records each part measures."""

    grid: int
    coverage: int
    against_ratio: int
    batch: int

    @staticmethod
    def of(records: int) -> Sizes:
        """The shares of a run of so many records on the grid."""
        return Sizes(records, max(records // 10, 200), max(records // 20, 200), min(max(records // 6, 200), 5000))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _options(arguments)
    sizes = Sizes.of(options.records or (QUICK_RECORDS if options.quick else DEFAULT_RECORDS))
    began = time.monotonic()
    speeds = speed.measure_speed(sizes.batch, options.seed)
    grid = accuracy.measure_grid(sizes.grid, options.seed)
    covered = coverage.measure_coverage(sizes.coverage, options.seed)
    by_ratio = coverage.coverage_by_ratio(sizes.against_ratio, options.seed)
    report = _report(sizes, options.seed, speeds, grid, covered, by_ratio, time.monotonic() - began)
    sys.stdout.write(report)
    if options.page:
        _into_page(options.page, report)
    if options.json:
        options.json.write_text(
            json.dumps(_as_json(sizes, options.seed, speeds, grid, covered, by_ratio), indent=1)
        )
    if options.plots:
        from benchmarks.estimator.plots import draw_all  # matplotlib is slow to import

        for path in draw_all(options.plots, grid, by_ratio, sizes.against_ratio, speeds):
            sys.stderr.write(f"wrote {path}\n")
    return 0


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimator",
        description="Efficiency, bias, coverage and speed of estimate_lock_in beside other methods.",
    )
    parser.add_argument(
        "--records", type=_at_least_200, metavar="N", help=f"records on the grid (default {DEFAULT_RECORDS})"
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of every random number (default 1)")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_RECORDS} records: a look, no proof")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there too")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw the pictures of docs/estimator.md there")
    parser.add_argument("--page", type=Path, metavar="FILE", help="put the tables between the marks of this page")
    options = parser.parse_args(arguments)
    if options.page and not (options.page.is_file() and all(m in options.page.read_text() for m in PAGE_MARKS)):
        parser.error(f"{options.page} is no file with the marks {PAGE_MARKS[0]} and {PAGE_MARKS[1]}")
    return options


def _into_page(page: Path, report: str) -> None:
    """Replace what stands between the marks of the page."""
    before, rest = page.read_text().split(PAGE_MARKS[0], 1)
    after = rest.split(PAGE_MARKS[1], 1)[1]
    page.write_text(f"{before}{PAGE_MARKS[0]}\n\n{report}\n{PAGE_MARKS[1]}{after}")


def _at_least_200(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 200:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 200 records")
    return value


def _report(
    sizes: Sizes,
    seed: int,
    speeds: list[speed.Speed],
    grid: accuracy.GridResult,
    covered: list[coverage.Coverage],
    by_ratio: tuple[Any, Any, Any],
    seconds: float,
) -> str:
    machine = f"{os.cpu_count()} cores with a load of {os.getloadavg()[0]:.1f}"
    sections = [
        f"{sizes.grid} records of {N_SAMPLES} eight-bit samples, seed {seed}; {seconds:.0f} s on {machine}; "
        f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}.",
        "### Error of the lock-in rate",
        tables.efficiency_table(grid),
        tables.worst_cell(grid),
        "### rms error / bound by rate",
        tables.by_rate_table(grid),
        "### rms error / bound of gyrolock, cell by cell",
        tables.cells_table(grid),
        "### Coverage",
        tables.coverage_table(covered),
        f"### Coverage where the ratio is small, {sizes.against_ratio} records each",
        tables.ratio_coverage_table(*by_ratio),
        "### Speed, one thread",
        tables.speed_table(speeds),
    ]
    return "\n\n".join(sections) + "\n"


def _as_json(
    sizes: Sizes,
    seed: int,
    speeds: list[speed.Speed],
    grid: accuracy.GridResult,
    covered: list[coverage.Coverage],
    by_ratio: tuple[Any, Any, Any],
) -> dict[str, Any]:
    methods = {
        errors.method: {
            **asdict(accuracy.cell_of(errors, grid.significant)),
            "frequency_outliers": accuracy.outliers(errors)[0],
            "seconds_per_record": errors.seconds,
        }
        for errors in grid.errors
    }
    cells = [[asdict(cell) for cell in row] for row in accuracy.cells_of(grid, grid.errors[0])]
    return {
        "sizes": asdict(sizes),
        "seed": seed,
        "methods": methods,
        "cells": {"rate_edges": accuracy.RATE_EDGES, "period_edges": accuracy.PERIOD_EDGES, "values": cells},
        "coverage": [asdict(c) for c in covered],
        "coverage_by_ratio": dict(
            zip(("multiple", "interval", "symmetric"), (list(map(float, c)) for c in by_ratio), strict=True)
        ),
        "speed": [asdict(s) for s in speeds],
    }


if __name__ == "__main__":
    sys.exit(main())
