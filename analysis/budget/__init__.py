"""Uncertainty budget of a lock-in rate."""

from analysis.budget.bench import (
    FRONT_END_LIMIT,
    LATITUDE_LIMIT_DEG,
    NOTHING_BUT_RECORDS,
    PROBE_LIMIT,
    SCALE_FACTOR_LIMIT,
    TIME_BASE_LIMIT_PPM,
    BenchKnowledge,
    Bounded,
    OperatingPoint,
    RecordShape,
    ResponseCorner,
    TableGeometry,
    expected_noise,
    expected_point,
    operating_point,
)
from analysis.budget.inputs import Budget, BudgetInput, Distribution, Reference, lock_in_budget
