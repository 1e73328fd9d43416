"""Uncertainty budget of a lock-in rate."""

from analysis.budget.combination import Budget, BudgetInput, Reference
from analysis.budget.inputs import lock_in_budget
from analysis.budget.knowledge import BenchKnowledge, Corner, OperatingPoint, TableGeometry, operating_point

__all__ = [
    "BenchKnowledge",
    "Budget",
    "BudgetInput",
    "Corner",
    "OperatingPoint",
    "Reference",
    "TableGeometry",
    "lock_in_budget",
    "operating_point",
]
