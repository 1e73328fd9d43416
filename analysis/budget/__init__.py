"""Uncertainty budget of a lock-in rate."""

from analysis.budget.bench import (
    FRONT_END_LIMIT,
    LATITUDE_LIMIT_DEG,
    NOTHING_BUT_RECORDS,
    PROBE_LIMIT,
    BenchKnowledge,
    Bounded,
    OperatingPoint,
    RecordShape,
    ResponseCorner,
    TableGeometry,
    bounded,
    expected_noise,
    expected_point,
    operating_point,
)
from analysis.budget.inputs import Budget, BudgetInput, Distribution, Reference, lock_in_budget

__all__ = [
    "FRONT_END_LIMIT",
    "LATITUDE_LIMIT_DEG",
    "NOTHING_BUT_RECORDS",
    "PROBE_LIMIT",
    "BenchKnowledge",
    "Bounded",
    "Budget",
    "BudgetInput",
    "Distribution",
    "OperatingPoint",
    "RecordShape",
    "Reference",
    "ResponseCorner",
    "TableGeometry",
    "bounded",
    "expected_noise",
    "expected_point",
    "lock_in_budget",
    "operating_point",
]
