"""What the records of one run say together."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.budget import Budget
from analysis.flags import FATAL
from analysis.lock_in_run.estimates import Method
from analysis.lock_in_run.groups import SeveralRates
from analysis.lock_in_run.pairs import QuadratureResult
from analysis.lock_in_run.table_check import TableCheck
from analysis.lock_in_run.table_rate import Tilt
from analysis.lockin_rate import LockInEstimate, size_interval


@dataclass(frozen=True)
class LockInRun:
    """What the records of a run say."""

    method: Method
    each: LockInEstimate  # fields of shape (n_records,)
    # fields of shape (). Its uncertainty and its interval know the noise of the records only.
    combined: LockInEstimate
    record_u: Floats  # (n_records,): deg/s; standard uncertainty of each record alone, every input counted
    tilt: Tilt | None = None  # where a table with known rate was used
    table_check: TableCheck | None = None
    several: SeveralRates | None = None  # where records were taken at several rates or in both senses
    quadratures: QuadratureResult | None = None  # where a second photodiode was recorded
    budget: Budget | None = None  # ``None`` without a lock-in rate

    @property
    def usable(self) -> bool:
        """Whether a lock-in rate can be given at all."""
        return bool(np.isfinite(self.combined.lock_in_rate)) and not int(self.combined.flags) & int(FATAL)

    @property
    def lock_in_rate(self) -> float:
        """deg/s; nan without a result."""
        return float(self.combined.lock_in_rate) if self.usable else math.nan

    @property
    def lock_in_rate_u(self) -> float:
        """Standard uncertainty, every input counted, deg/s."""
        return math.nan if self.budget is None else self.budget.combined_u

    @property
    def record_intervals_95(self) -> tuple[Floats, Floats]:
        """Ends of the 95 % interval of each record alone, every input counted, deg/s, shape (n_records,)."""
        u = self.record_u
        with np.errstate(invalid="ignore", divide="ignore"):
            low, high = size_interval(np.hypot(self.each.lock_in_rate, u) / u)
        return low * u, high * u

    @property
    def noise_u(self) -> float:
        """Standard uncertainty from the noise of the records alone, deg/s."""
        if self.several is None or self.budget is None:
            return float(self.combined.lock_in_rate_u)
        # that of a fit over several rates holds what it takes to know receiver and laser
        return next(line.contribution for line in self.budget.inputs if line.name == "noise")

    @property
    def interval_95(self) -> tuple[float, float]:
        """Ends of the 95 % interval, every input counted, deg/s."""
        if self.budget is None:
            return math.nan, math.nan
        low, high = self.budget.interval_95
        fit = None if self.several is None else self.several.by_beat
        if fit is None:
            return low, high
        # several solutions, or rates that hardly tell, make the fit's own interval wider than its u says
        value, rest = fit.lock_in_rate, math.sqrt(max(self.budget.combined_u**2 - fit.lock_in_rate_u**2, 0.0))
        rest *= self.budget.coverage_factor
        low = min(low, value - math.hypot(value - fit.lock_in_rate_low_95, rest))
        high = max(high, value + math.hypot(fit.lock_in_rate_high_95 - value, rest))
        return max(low, fit.at_least, 0.0), max(high, fit.at_least)
