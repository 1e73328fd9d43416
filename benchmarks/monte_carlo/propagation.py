"""Propagation of distributions (JCGM 101, Supplement 1 of the GUM) through the whole measurement.

Every input of a budget is drawn from its distribution, records are synthesised with what was drawn and analysed
as if nothing were wrong; the spread of the lock-in rates is what the budget predicts. None of the budget's
derivatives is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.budget import BenchKnowledge, OperatingPoint, RecordShape, Reference
from analysis.combine import combine_estimates
from analysis.lockin_equation import lock_in_from_beat, lock_in_from_rate
from analysis.lockin_rate import LockInEstimate, estimate_lock_in
from benchmarks.monte_carlo.draws import corrected_factor, draw_inputs, nominal_rate
from benchmarks.monte_carlo.records import make_records

_AT_ONCE = 400


@dataclass(frozen=True)
class MonteCarlo:
    """Lock-in rates of simulated measurements.

    Attributes
    ----------
    lock_in_rates : (n,)
        deg/s, of the trials that gave one.
    failed : int
        Trials that gave none.
    """

    lock_in_rates: Floats
    failed: int

    @property
    def mean(self) -> float:
        """deg/s."""
        return float(self.lock_in_rates.mean())

    @property
    def u(self) -> float:
        """Standard deviation, deg/s."""
        return float(self.lock_in_rates.std(ddof=1))

    @property
    def interval_95(self) -> tuple[float, float]:
        """Probabilistically symmetric 95 % interval, deg/s."""
        low, high = np.quantile(self.lock_in_rates, (0.025, 0.975))
        return float(low), float(high)


def simulate_measurements(
    point: OperatingPoint,
    knowledge: BenchKnowledge,
    shape: RecordShape,
    reference: Reference = "beat",
    *,
    trials: int,
    rng: np.random.Generator,
) -> MonteCarlo:
    """Measure the same gyro many times, with every input of the budget drawn anew each time.

    Parameters
    ----------
    point : OperatingPoint
        Its rates, scale factor, phase and scatter; its noise comes from `shape`.
    shape : RecordShape
        Also how many records make one measurement.
    reference : {"beat", "rate"}

    Raises
    ------
    ValueError
        The rate as reference without the table's geometry, or a record with fewer than 3 periods.
    """
    rate = None
    if reference == "rate":
        if knowledge.table is None:
            raise ValueError("with the rate as reference the table's geometry is needed")
        rate = nominal_rate(knowledge.table)
    if point.beat_frequency * shape.duration < 3:
        raise ValueError("a record must hold at least 3 beat periods")
    draws = draw_inputs(point, knowledge, reference, trials, shape.records, rng)
    removed = corrected_factor(point.beat_frequency, knowledge)
    values = []
    step = max(1, _AT_ONCE // shape.records) * shape.records
    for first in range(0, trials * shape.records, step):
        volts = make_records(draws.part(slice(first, first + step)), shape, rng)
        each = estimate_lock_in(volts, shape.sample_interval, scale_factor=point.scale_factor, input_rate=rate)
        values += [
            _measured(each[first : first + shape.records], removed)
            for first in range(0, len(volts), shape.records)
        ]
    rates = np.array(values)
    good = np.isfinite(rates)
    return MonteCarlo(rates[good], int((~good).sum()))


def _measured(each: LockInEstimate, removed: float) -> float:
    """Lock-in rate of one measurement, its ratio freed of the factor that is known."""
    one = combine_estimates(each)
    value = float(one.lock_in_rate)
    if removed == 1.0 or not np.isfinite(value):
        return value
    beat_rate = float(one.beat_frequency) / one.scale_factor

    def relation(ratio: float) -> float:
        if one.rate_given:
            return float(lock_in_from_rate(ratio, float(one.input_rate)))
        return float(lock_in_from_beat(ratio, beat_rate))

    ratio = float(one.ratio)
    return value * relation(ratio / removed) / relation(ratio)
