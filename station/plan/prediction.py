"""What a step of a campaign will take and give: its time, and the uncertainty of the lock-in rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from analysis.plan import plan_of_records
from station.errors import NoUsableSignal
from station.lock_in.rate_plan import rate_plan, records_at_each
from station.lock_in.settings import Settings
from station.measurements import measurement
from station.plan.plan import PlanOptions, plan_request

_TRIALS = 3
"""Records that the search for the beat takes at each rate, as a rule."""


@dataclass(frozen=True)
class Prediction:
    """What is known of a step beforehand."""

    # on a real bench, without warm-up and settling of the campaign; ``None`` where nobody knows it
    seconds: float | None
    u: float | None = None  # standard uncertainty of the lock-in rate, deg/s, every input counted
    u95: float | None = None  # half of its 95 % interval
    why_not: str = ""  # why there is no uncertainty


def predict(name: str, settings: Mapping[str, Any]) -> Prediction:
    """Predict one measurement."""
    kind = measurement(name)
    values = kind.kind.model.model_validate(dict(settings))
    if isinstance(values, Settings):
        return _lock_in(values)
    return Prediction(kind.seconds(values), why_not="is not predicted for this measurement")


def _lock_in(settings: Settings) -> Prediction:
    try:
        tilt = settings.simulation.tilt_deg if settings.simulation is not None else 0.0
        steps = rate_plan(settings, tilt)
        ratios = tuple(sorted({step.over_lock_in for step in steps.steps}))
        both = any(step.sense < 0 for step in steps.steps)
        records = records_at_each(settings, steps)
        request = plan_request(settings, PlanOptions(rates=ratios, both_senses=both))
        planned = plan_of_records(request, records)
    except (ValueError, NoUsableSignal) as error:
        return Prediction(None, why_not=str(error))
    each = planned.duration_s / sum(rate.shape.records for rate in planned.rates)
    changes = len(planned.rates)
    seconds = planned.duration_s + changes * (_TRIALS * each + settings.table.settle_s)
    if settings.table.kind != "none":
        senses = 2 if settings.table.both_senses else 1
        seconds += senses * (settings.table.settle_s + settings.measurement.tilt_records * each)
    return Prediction(seconds, planned.budget.combined_u, planned.budget.expanded_u_95)
