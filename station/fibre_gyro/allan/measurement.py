"""The noise at rest: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence

from station.fibre_gyro.allan.evaluate import PURPOSE, evaluate
from station.fibre_gyro.allan.result import LIMITED, result
from station.fibre_gyro.allan.sections import sections
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.logs import LogRow
from station.fibre_gyro.segments import PlannedSegment
from station.fibre_gyro.settings import FogSettings


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the one segment: rest."""
    chosen = settings.allan
    conditions = {"purpose": PURPOSE, "rate_dps": 0.0, "axis": chosen.axis, "end_up": 1}
    return [PlannedSegment(f"{chosen.axis} at rest", chosen.record_s, chosen.settle_s, conditions)]


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by its axis."""
    return [(f"{row.get('axis', '')} at rest".strip(), {"rate_dps": 0.0}) for row in rows]


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Noise at rest",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, (), named, whole=True),
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    plan=plan,
)
