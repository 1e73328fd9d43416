"""`python -m benchmarks.budget`: the uncertainty budget beside simulated measurements, input by input.

Each line draws its inputs, synthesises records (beat, gain saturation, distortion, filters, noise, rounding),
analyses them, and compares the spread with the budget (JCGM 101 beside JCGM 100).
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from analysis.budget import (
    NOTHING_BUT_RECORDS,
    RecordShape,
    Reference,
    ResponseCorner,
    TableGeometry,
    expected_point,
    lock_in_budget,
)
from analysis.rotation import rate_on_axis
from benchmarks.monte_carlo import simulate_measurements

SCALE_FACTOR, LOCK_IN_RATE, PERIODS = 2000.0, 0.01, 20.0
TILT_DEG, LATITUDE_DEG = 88.693, 28.2
DEFAULT_TRIALS = 20_000


@dataclass(frozen=True)
class Case:
    """One measurement: W/WL, what is known of the bench, noise and levels over the amplitude."""

    name: str
    over_lock_in: float
    knowledge: dict[str, Any] = field(default_factory=dict)
    noise: float = 0.01
    level: float = 0.01
    records: int = 1
    scatter: float = 0.0
    phase: float = math.nan
    reference: Reference = "beat"


def _table(azimuth_deg: float = math.nan, azimuth_u_deg: float = 0.0) -> TableGeometry:
    rate = 0.08 / math.cos(math.radians(TILT_DEG))
    return TableGeometry(rate, 20e-6 * rate, TILT_DEG, 0.01, LATITUDE_DEG, 0.01, azimuth_deg, azimuth_u_deg)


CASES = (
    Case("noise, near the threshold", 1.3),
    Case("noise", 3.0),
    Case("noise", 20.0),
    Case("rounding", 8.0, noise=0.006, level=0.02),
    Case("scale factor 0.3 %", 3.0, {"scale_factor_u_ppm": 3000.0}),
    Case("distortion -50 dBc, phase known", 8.0, {"distortion_limit": 10 ** (-50 / 20)}, phase=0.6),
    Case("distortion -50 dBc, phase unknown", 3.0, {"distortion_limit": 10 ** (-50 / 20)}),
    Case("distortion -46 dBc", 1.3, {"distortion_limit": 10 ** (-46 / 20)}),
    Case("low pass corrected", 4.0, {"bandwidth": ResponseCorner(300.0, 20.0, corrected=True)}),
    Case("low pass not corrected", 4.0, {"bandwidth": ResponseCorner(400.0)}),
    Case("AC coupling corrected", 4.0, {"high_pass": ResponseCorner(20.0, 2.0, corrected=True)}),
    Case("gain corner corrected", 4.0, {"gain": ResponseCorner(200.0, 15.0, corrected=True)}),
    Case("gain corner not corrected", 4.0, {"gain": ResponseCorner(500.0)}),
    Case("scatter, 6 records", 4.0, records=6, scatter=0.02),
    Case("by the table, azimuth unknown", 8.0, {"table": _table()}, reference="rate"),
    Case("by the table, azimuth ±17 deg", 8.0, {"table": _table(70.0, 10.0)}, reference="rate"),
    Case(
        "everything",
        3.0,
        {
            "scale_factor_u_ppm": 500.0,
            "distortion_limit": 10 ** (-60 / 20),
            "bandwidth": ResponseCorner(1000.0, 50.0, corrected=True),
            "gain": ResponseCorner(2000.0),
        },
        records=4,
        scatter=0.003,
    ),
)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; exit code 1 if a case disagrees by more than 5 %."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.budget", description="Budget beside simulation.")
    parser.add_argument("--trials", type=int, default=DEFAULT_TRIALS, metavar="N", help="of each case")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    options = parser.parse_args(arguments)
    if options.trials < 100:
        parser.error("--trials: at least 100")
    began, worst = time.monotonic(), 0.0
    sys.stdout.write(
        "| case | W/WL | u budget, % | u simulated, % | ratio | U95 ratio |\n|---|---|---|---|---|---|\n"
    )
    for place, case in enumerate(CASES):
        row, ratio = _compare(case, options.trials, np.random.default_rng([options.seed, place]))
        worst = max(worst, abs(ratio - 1))
        sys.stdout.write(row)
        sys.stdout.flush()
    seconds = time.monotonic() - began
    error = 1 / math.sqrt(2 * options.trials)
    sys.stdout.write(
        f"\n{options.trials} trials each, seed {options.seed}, {seconds:.0f} s; largest disagreement of u "
        f"{worst:.1%}, of which {error:.1%} (1 sigma) is the simulation's own chance.\n"
    )
    return 0 if worst <= 0.05 else 1


def _compare(case: Case, trials: int, rng: np.random.Generator) -> tuple[str, float]:
    knowledge = replace(NOTHING_BUT_RECORDS, time_base_limit_ppm=50.0, **case.knowledge)
    rate = case.over_lock_in * LOCK_IN_RATE
    if (table := knowledge.table) is not None:
        azimuth = table.azimuth_deg if math.isfinite(table.azimuth_deg) else 90.0
        rate = float(rate_on_axis(table.table_rate, table.tilt_deg, table.latitude_deg, azimuth))
    frequency = SCALE_FACTOR * math.sqrt(rate**2 - LOCK_IN_RATE**2)
    shape = RecordShape(2500, PERIODS / frequency / 2500, 1.0, case.noise, case.level, case.records)
    point = expected_point(
        shape,
        scale_factor=SCALE_FACTOR,
        input_rate=rate,
        lock_in_rate=LOCK_IN_RATE,
        scatter=case.scatter * LOCK_IN_RATE,
        phase=case.phase,
    )
    budget = lock_in_budget(point, knowledge, case.reference)
    found = simulate_measurements(point, knowledge, shape, case.reference, trials=trials, rng=rng)
    low, high = found.interval_95
    ratio = budget.combined_u / found.u
    row = (
        f"| {case.name} | {rate / LOCK_IN_RATE:.3g} | {100 * budget.relative_u:.3f} | "
        f"{100 * found.u / LOCK_IN_RATE:.3f} | {ratio:.3f} | {2 * budget.expanded_u_95 / (high - low):.3f} |\n"
    )
    return row, ratio


if __name__ == "__main__":
    sys.exit(main())
