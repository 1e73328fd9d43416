"""What the records of one run say together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.budget import Budget
from analysis.flags import FATAL
from analysis.lock_in_run.estimates import Method
from analysis.lock_in_run.groups import SeveralRates
from analysis.lock_in_run.pairs import QuadratureResult
from analysis.lock_in_run.table_check import TableCheck
from analysis.lock_in_run.table_rate import Tilt
from analysis.lockin_rate import LockInEstimate


@dataclass(frozen=True)
class LockInRun:
    """What the records of a run say.

    Attributes
    ----------
    method : Method
    each : LockInEstimate
        Fields of shape (n_records,).
    combined : LockInEstimate
        Fields of shape ().
    tilt, table_check : Tilt, TableCheck or None
        Where a table with known rate was used.
    several : SeveralRates or None
        Where records were taken at several rates or in both senses.
    quadratures : QuadratureResult or None
        Where a second photodiode was recorded.
    budget : Budget or None
    no_budget : str
        Why there is no budget.
    """

    method: Method
    each: LockInEstimate
    combined: LockInEstimate
    tilt: Tilt | None = None
    table_check: TableCheck | None = None
    several: SeveralRates | None = None
    quadratures: QuadratureResult | None = None
    budget: Budget | None = None
    no_budget: str = ""

    @property
    def usable(self) -> bool:
        """Whether a lock-in rate can be given at all."""
        return bool(np.isfinite(self.combined.lock_in_rate)) and not int(self.combined.flags) & int(FATAL)
