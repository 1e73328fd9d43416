"""How often the 95 % interval holds the truth, over the grid and where its assumptions are strained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from analysis import combine_estimates, estimate_lock_in
from analysis.arrays import Bools, Floats
from benchmarks.estimator.accuracy import PERIOD_EDGES, RATE_EDGES, within
from benchmarks.estimator.damage import as_volts, clean, many_periods, spiked, too_large, with_gap, with_ripple
from benchmarks.estimator.gyros import N_SAMPLES, Gyros, codes_of, draw_gyros, with_ratio
from benchmarks.estimator.noise import first_order, one_over_f
from benchmarks.estimator.progress import Progress

BATCH = 200
LEVEL = 0.95
FEWEST_IN_CELL = 50
RECORDS_PER_GYRO = 10


@dataclass(frozen=True)
class Coverage:
    """Share of intervals that held the truth.

    below, above : share of truths that lay below and above the interval
    worst, worst_records, worst_cell : share in the cell furthest from 95 % in its own standard deviations
    """

    case: str
    records: int
    covered: float
    below: float
    above: float
    worst: float
    worst_records: int
    worst_cell: str


@dataclass(frozen=True)
class Case:
    """One row of the table: gyros, their records, and the division into cells by some quantity of theirs.

    share is that of the records asked for: less for records which the estimator examines at length.
    """

    name: str
    draw: Callable[[np.random.Generator, int], Gyros]
    records: Callable[[np.random.Generator, Gyros], Floats]
    cells: Callable[[Gyros], dict[str, Bools]]
    rate_given: bool = False
    share: float = 1.0

    def count(self, asked: int) -> int:
        """How many records this case measures."""
        return max(int(asked * self.share), 100)


def measure_coverage(n_records: int, seed: int) -> list[Coverage]:
    """Every case with its share of `n_records` intervals; the combined ones with a tenth as many."""
    results = []
    n_groups = max(n_records // RECORDS_PER_GYRO, 1)
    total = sum(case.count(n_records) for case in CASES) + len(COMBINED) * n_groups * RECORDS_PER_GYRO
    with Progress("coverage", total) as progress:
        for number, case in enumerate(CASES):
            rng = np.random.default_rng([seed, number])
            gyros, below, above = _intervals(case, rng, case.count(n_records), progress)
            results.append(_summary(case.name, gyros, below, above, case.cells))
        for number, (name, times_noise) in enumerate(COMBINED):
            rng = np.random.default_rng([seed, 100 + number])
            results.append(_combined(name, times_noise, rng, n_groups, progress))
    return results


def coverage_by_ratio(n_records: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """True ratio over its uncertainty, and the share of truths inside the interval and inside value +- 1.96 u."""
    rng = np.random.default_rng([seed, 200])
    multiples = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0])
    inside, symmetric = np.empty_like(multiples), np.empty_like(multiples)
    with Progress("coverage against r/u", len(multiples)) as progress:
        for column, multiple in enumerate(multiples):
            gyros = _weak(rng, n_records, np.full(n_records, multiple))
            hit, near = [], []
            for start in range(0, n_records, BATCH):
                part = gyros.take(slice(start, start + BATCH))
                found = estimate_lock_in(clean(rng, part), 1.0, scale_factor=1.0)
                truth = part.lock_in_rate
                hit.append((found.lock_in_rate_low_95 <= truth) & (truth <= found.lock_in_rate_high_95))
                near.append(np.abs(found.lock_in_rate - truth) <= 1.96 * found.lock_in_rate_u)
            inside[column], symmetric[column] = np.concatenate(hit).mean(), np.concatenate(near).mean()
            progress.done()
    return multiples, inside, symmetric


def _intervals(
    case: Case, rng: np.random.Generator, n_records: int, progress: Progress
) -> tuple[Gyros, Bools, Bools]:
    gyros = case.draw(rng, n_records)
    below, above = [], []
    for start in range(0, n_records, BATCH):
        part = gyros.take(slice(start, start + BATCH))
        rate = part.input_rate if case.rate_given else None
        found = estimate_lock_in(case.records(rng, part), 1.0, scale_factor=1.0, input_rate=rate)
        below.append(part.lock_in_rate < found.lock_in_rate_low_95)
        # A record without an interval has not covered its truth: nan compares as false.
        above.append(~(part.lock_in_rate <= found.lock_in_rate_high_95))
        progress.done(len(part))
    return gyros, np.concatenate(below), np.concatenate(above)


def _summary(
    name: str, gyros: Gyros, below: Bools, above: Bools, cells: Callable[[Gyros], dict[str, Bools]]
) -> Coverage:
    covered = ~(below | above)
    worst, worst_records, worst_cell, furthest = np.nan, 0, "", -1.0
    for cell, chosen in cells(gyros).items():
        count = int(chosen.sum())
        if count < FEWEST_IN_CELL:
            continue
        share = float(covered[chosen].mean())
        distance = abs(share - LEVEL) / np.sqrt(LEVEL * (1 - LEVEL) / count)
        if distance > furthest:
            worst, worst_records, worst_cell, furthest = share, count, cell, distance
    inside, under, over = (float(a.mean()) for a in (covered, below, above))
    return Coverage(name, len(covered), inside, under, over, worst, worst_records, worst_cell)


def _combined(
    name: str, times_noise: float, rng: np.random.Generator, n_groups: int, progress: Progress
) -> Coverage:
    """Intervals of `combine_estimates` over records of one gyro that differ in phase and noise only."""
    groups = _weak(rng, n_groups, np.full(n_groups, times_noise)) if times_noise else draw_gyros(rng, n_groups)
    below, above = np.empty(n_groups, bool), np.empty(n_groups, bool)
    for number in range(n_groups):
        same = groups.take(np.full(RECORDS_PER_GYRO, number))
        same = replace(same, theta=rng.uniform(-np.pi, np.pi, RECORDS_PER_GYRO))
        found = combine_estimates(estimate_lock_in(clean(rng, same), 1.0, scale_factor=1.0))
        truth = same.lock_in_rate[0]
        below[number] = truth < float(found.lock_in_rate_low_95)
        above[number] = not truth <= float(found.lock_in_rate_high_95)
        progress.done(RECORDS_PER_GYRO)
    return _summary(name, groups, below, above, _by_periods)


def _weak(rng: np.random.Generator, n_records: int, multiple: Floats) -> Gyros:
    """Gyros whose ratio is `multiple` of its own uncertainty sigma/A sqrt(2/N)."""
    gyros = draw_gyros(rng, n_records, periods=(5.0, 500.0))
    return with_ratio(gyros, multiple * gyros.total_noise / gyros.amplitude * np.sqrt(2 / N_SAMPLES))


def _near_its_noise(rng: np.random.Generator, n_records: int) -> Gyros:
    return _weak(rng, n_records, rng.uniform(0, 5, n_records))


def _whole_periods(rng: np.random.Generator, n_records: int) -> Gyros:
    """Fifty samples per period exactly and no noise: the worst that rounding can do."""
    gyros = draw_gyros(rng, n_records, noise=(0.0, 0.0))
    return replace(gyros, frequency=np.full(n_records, 1 / 50))


def _coloured(rng: np.random.Generator, n_records: int) -> Gyros:
    return draw_gyros(rng, n_records, noise=(0.5, 3.0))


def _first_order(memory: float) -> Callable[[np.random.Generator, Gyros], Floats]:
    return lambda rng, gyros: codes_of(
        gyros, first_order(rng, len(gyros), N_SAMPLES, memory) * gyros.noise[:, np.newaxis]
    )


def _one_over_f(rng: np.random.Generator, gyros: Gyros) -> Floats:
    return codes_of(gyros, one_over_f(rng, len(gyros), N_SAMPLES) * gyros.noise[:, np.newaxis])


def _by_periods(gyros: Gyros) -> dict[str, Bools]:
    return _divided(gyros.periods, PERIOD_EDGES, "{:g}-{:g} periods")


def _by_noise(gyros: Gyros) -> dict[str, Bools]:
    return _divided(gyros.noise, (0.0, 0.05, 0.1, 0.15, 0.2), "noise {:g}-{:g}") | _by_periods_and_rate(gyros)


def _by_periods_and_rate(gyros: Gyros) -> dict[str, Bools]:
    rates = _divided(gyros.rate_over_lock_in, RATE_EDGES, "W/WL {:g}-{:g}")
    return {f"{p}, {x}": a & b for p, a in _by_periods(gyros).items() for x, b in rates.items()}


def _divided(values: Floats, edges: tuple[float, ...], label: str) -> dict[str, Bools]:
    return {
        label.format(low, high): within(values, edges, number)
        for number, (low, high) in enumerate(pairwise(edges))
    }


def _quiet(rng: np.random.Generator, n_records: int) -> Gyros:
    return draw_gyros(rng, n_records, noise=(0.0, 0.2))


SLOW = 0.1

CASES = (
    Case("grid, the record its own reference", draw_gyros, clean, _by_periods_and_rate),
    Case("grid, input rate given, either sense", draw_gyros, clean, _by_periods_and_rate, rate_given=True),
    Case("true ratio 0 to 5 of its uncertainty", _near_its_noise, clean, _by_periods),
    Case("noise 0 to 0.2 levels: rounding rules", _quiet, clean, _by_noise),
    Case("no noise, exactly 50 samples per period", _whole_periods, clean, _by_periods),
    Case("coloured: AR(1), memory 0.5", _coloured, _first_order(0.5), _by_periods),
    Case("coloured: AR(1), memory 0.9", _coloured, _first_order(0.9), _by_periods),
    Case("coloured: 1/f", _coloured, _one_over_f, _by_periods),
    Case("clipped, amplitude 126 to 133 codes", too_large, clean, _by_periods_and_rate),
    Case("the same in volts, limit unknown", too_large, as_volts, _by_periods_and_rate),
    Case("five spikes of 20 to 200 codes", draw_gyros, spiked, _by_periods_and_rate),
    Case("a tenth of the record without data", draw_gyros, with_gap, _by_periods_and_rate),
    Case("phase wanders by 0.1 to 3 rad", many_periods, with_ripple, _by_periods_and_rate, share=SLOW),
)

COMBINED = (("ten records combined, grid", 0.0), ("ten records combined, ratio 1 of its uncertainty", 1.0))
