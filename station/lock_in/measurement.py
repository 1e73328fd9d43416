"""The lock-in rate of a ring laser gyro: the skeleton of measurements, filled in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.lock_in_run import Method
from station.lock_in.found import LockInFound
from station.lock_in.presentation.at_once import watch
from station.lock_in.presentation.documents import record_documents
from station.lock_in.presentation.sections import sections
from station.lock_in.presentation.tables import fact_tables
from station.lock_in.read import evaluate_run, evaluate_source
from station.lock_in.result import result
from station.lock_in.settings import RING_LASER, LimitSettings, Settings
from station.lock_in.take import take
from station.measurements import Measurement
from station.ring_laser.examine import examine
from station.runs.store import SavedRun


def evaluate(run: SavedRun, settings: Settings, choices: Mapping[str, Any]) -> LockInFound:
    """Evaluate a run; the choices are those of :class:`analysis.lock_in_run.Method`."""
    chosen = {"scale_factor": settings.gyro.scale_factor_pulses_per_deg, **choices}
    return evaluate_run(run, settings, Method(**chosen))


MEASUREMENT = Measurement(
    name="measure",
    command="gyrolock measure",
    title="Lock-in rate",
    kind=RING_LASER,
    take=take,
    evaluate=evaluate,
    evaluate_source=evaluate_source,
    choices=("scale_factor", "relation", "input_rate"),
    gives=tuple(LimitSettings.model_fields),
    result=result,
    sections=lambda found, run, settings, result: sections(found, result),
    facts=fact_tables,
    rows=lambda found: record_documents(found, "record"),
    examine=lambda settings: examine(settings, settings.table.fast_rate_dps),
    watch=watch,
)
