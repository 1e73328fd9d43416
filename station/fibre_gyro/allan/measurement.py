"""The noise at rest: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from station.fibre_gyro.allan.evaluate import PURPOSE, evaluate
from station.fibre_gyro.allan.result import LIMITED, result
from station.fibre_gyro.allan.sections import sections
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, planned_segments
from station.fibre_gyro.logs import LogRow, is_list, read_logs, read_whole_logs
from station.fibre_gyro.segments import PlannedSegment, take_logs
from station.fibre_gyro.settings import FogSettings
from station.runs.taking import Session


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the one segment: rest."""
    chosen = settings.allan
    conditions = {"purpose": PURPOSE, "rate_dps": 0.0, "axis": chosen.axis, "end_up": 1}
    return [PlannedSegment(f"{chosen.axis} at rest", chosen.record_s, chosen.settle_s, conditions)]


def take_files(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
    """Make a run of logs: as they are, with every axis that they hold, or by a list that may name parts."""

    def named(rows: Sequence[LogRow]) -> list[NamedSegment]:
        return [(f"{row.get('axis', '')} at rest".strip(), {"rate_dps": 0.0}) for row in rows]

    lists = [path for path in paths if is_list(path)]
    logs = read_whole_logs([path for path in paths if path not in lists], PURPOSE, settings)
    if lists:
        logs += read_logs(lists, PURPOSE, (), named, settings)
    take_logs(session, paths, logs)


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Noise at rest",
    take=planned_segments(plan),
    take_files=take_files,
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    plan=plan,
)
