"""Uncertainty budget of a lock-in rate."""

from analysis.budget.bounded import Bounded, bounded
from analysis.budget.combination import Budget, BudgetInput, Distribution, Reference
from analysis.budget.expected_noise import RecordShape, expected_noise, expected_point
from analysis.budget.inputs import lock_in_budget
from analysis.budget.knowledge import (
    NOTHING_BUT_RECORDS,
    BenchKnowledge,
    Corner,
    OperatingPoint,
    TableGeometry,
    operating_point,
)
from analysis.budget.unstated import FRONT_END_LIMIT, LATITUDE_LIMIT_DEG

__all__ = [
    "FRONT_END_LIMIT",
    "LATITUDE_LIMIT_DEG",
    "NOTHING_BUT_RECORDS",
    "BenchKnowledge",
    "Bounded",
    "Budget",
    "BudgetInput",
    "Corner",
    "Distribution",
    "OperatingPoint",
    "RecordShape",
    "Reference",
    "TableGeometry",
    "bounded",
    "expected_noise",
    "expected_point",
    "lock_in_budget",
    "operating_point",
]
