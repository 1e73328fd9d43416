"""Uncertainty of the lock-in rate against the rate at which it is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.arrays import Floats
from analysis.budget import Budget
from analysis.plan.measurement_plan import predicted_budget
from analysis.plan.request import PlanRequest

_POINTS = 100
_GROUPS: dict[str, tuple[str, ...]] = {
    "noise": ("noise", "quantization", "beat_frequency", "scatter"),
    "distortion": ("distortion", "third_order", "separation"),
    "reference": (
        "input_rate",
        "scale_factor",
        "time_base",
        "table_rate",
        "tilt",
        "latitude",
        "earth_rate",
        "azimuth",
    ),
    "channel": ("bandwidth", "high_pass", "gain_corner", "response"),
}


@dataclass(frozen=True)
class UncertaintyCurve:
    """Relative standard uncertainties, each of shape (n,), for W/WL = `over_lock_in`."""

    over_lock_in: Floats
    total: Floats
    # what noise, distortion, the rate (K and time base, or table), and bandwidth and gain contribute
    noise: Floats
    distortion: Floats
    reference: Floats
    channel: Floats
    records: int  # for which this holds


def uncertainty_curve(request: PlanRequest, records: int, *, fastest: float = 100.0) -> UncertaintyCurve:
    """Predict the uncertainty at rates from close above lock-in to `fastest` times lock-in."""
    single = replace(request, rates_over_lock_in=())
    over = np.geomspace(1.06, fastest, _POINTS)
    budgets = [predicted_budget(single, float(ratio), records) for ratio in over]
    parts = {name: np.array([_part(budget, lines) for budget in budgets]) for name, lines in _GROUPS.items()}
    return UncertaintyCurve(
        over_lock_in=over, total=np.array([budget.relative_u for budget in budgets]), records=records, **parts
    )


def _part(budget: Budget, names: tuple[str, ...]) -> float:
    return math.hypot(*(line.contribution for line in budget.inputs if line.name in names)) / budget.lock_in_rate
