"""Plan a measurement of the lock-in rate before it is made."""

from analysis.plan.curve import UncertaintyCurve, uncertainty_curve
from analysis.plan.default_rates import DEFAULT_RECORDS, default_rates
from analysis.plan.measurement_plan import (
    Plan,
    PlannedRate,
    budget_elsewhere,
    plan_measurement,
    plan_of_records,
    predicted_budget,
)
from analysis.plan.request import SAFE_ABOVE_LOCK_IN, OscilloscopeSteps, PlanRequest, TableSpread
from analysis.plan.several_rates import FEW_RATES, expected_joint_u

__all__ = [
    "DEFAULT_RECORDS",
    "FEW_RATES",
    "SAFE_ABOVE_LOCK_IN",
    "OscilloscopeSteps",
    "Plan",
    "PlanRequest",
    "PlannedRate",
    "TableSpread",
    "UncertaintyCurve",
    "budget_elsewhere",
    "default_rates",
    "expected_joint_u",
    "plan_measurement",
    "plan_of_records",
    "predicted_budget",
    "uncertainty_curve",
]
