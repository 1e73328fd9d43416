"""The noise at rest: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from station.fibre_gyro.allan.evaluate import PURPOSE, evaluate
from station.fibre_gyro.allan.result import LIMITED, result
from station.fibre_gyro.allan.sections import sections
from station.fibre_gyro.common import output_facts, truth_of, with_link_remarks
from station.fibre_gyro.logs import LogRow, is_list, read_logs, read_whole_logs
from station.fibre_gyro.segments import PlannedSegment, take_logs, take_segments, unusable_segments
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.measurements import Measurement
from station.runs.taking import Session


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the one segment: rest."""
    chosen = settings.allan
    conditions = {"purpose": PURPOSE, "rate_dps": 0.0, "axis": chosen.axis, "end_up": 1}
    return [PlannedSegment(f"{chosen.axis} at rest", chosen.record_s, chosen.settle_s, conditions)]


def take(settings: FogSettings, session: Session) -> None:
    """Take the segment on the bench."""
    take_segments(settings, session, open_fog_bench(settings), [lambda run: plan(settings)], truth_of(settings))


def take_files(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
    """Make a run of logs: as they are, with every axis that they hold, or by a list that may name parts."""

    def named(rows: Sequence[LogRow]) -> list[tuple[str, dict[str, object]]]:
        return [(f"{row.get('axis', '')} at rest".strip(), {"rate_dps": 0.0}) for row in rows]

    lists = [path for path in paths if is_list(path)]
    logs = read_whole_logs([path for path in paths if path not in lists], PURPOSE, settings)
    if lists:
        logs += read_logs(lists, PURPOSE, (), named, settings)
    take_logs(session, paths, logs)


MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock fog allan",
    title="Noise at rest",
    kind=FIBRE_GYRO,
    take=take,
    take_files=take_files,
    evaluate=evaluate,
    result=with_link_remarks(result),
    sections=sections,
    facts=output_facts,
    gives=LIMITED,
    unusable=lambda run, settings: unusable_segments(run, settings, [PURPOSE]),
)
