"""The rate-table run: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.fibre_gyro import check_whole_turns, turn_time
from station.errors import UsageError
from station.fibre_gyro.allan.noise_model import NOISE
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.logs import LogRow, table_conditions
from station.fibre_gyro.segments import MARGIN_S, PlannedSegment
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.evaluate import PURPOSE, evaluate
from station.fibre_gyro.table.result import LIMITED, result
from station.fibre_gyro.table.sections import sections
from station.runs.taking import Session


def plan(settings: FogSettings, axes: Sequence[str] | None = None) -> list[PlannedSegment]:
    """List the segments of a run: each axis, each end up, each rate in both senses."""
    table, planned = settings.table, []
    for axis in axes or table.axes:
        for end_up in (1, -1) if table.both_ends_up else (1,):
            for size in table.rates_dps:
                for rate in (size, -size):
                    seconds = (table.window_s or table.turns * turn_time(rate)) + MARGIN_S
                    conditions = {"purpose": PURPOSE, "axis": axis, "end_up": end_up, "rate_dps": rate}
                    planned.append(PlannedSegment(_key(axis, rate, end_up), seconds, table.settle_s, conditions))
    return planned


def take(settings: FogSettings, session: Session) -> None:
    """Take the segments on the bench."""
    for fault in _fixed_window_faults(settings):
        session.progress.note(f"will be left out: {fault}")
    planned_segments(plan)(settings, session)


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by axis and rate of the table."""
    return [_named(row, settings) for row in rows]


def _named(row: LogRow, settings: FogSettings) -> NamedSegment:
    axis, rate, end_up = row.get("axis", settings.table.axes[-1]), row["rate_dps"], row["end_up"]
    if rate == 0:
        raise UsageError(f"{row['place']}, rate_dps: a rate-table run has no log at rest")
    conditions = {"axis": axis, "end_up": end_up, "rate_dps": rate, **table_conditions(row)}
    return _key(axis, rate, end_up), conditions


def _key(axis: str, rate_dps: float, end_up: int) -> str:
    """``"Z +20.01"``, ``"Z down -20"``."""
    return f"{axis}{'' if end_up > 0 else ' down'} {rate_dps:+.10g}"


def _fixed_window_faults(settings: FogSettings) -> list[str]:
    """Say which rates a window of fixed length is no whole number of turns at, before anything turns."""
    faults = []
    for rate in settings.table.rates_dps if settings.table.window_s else ():
        try:
            check_whole_turns(settings.table.window_s, rate, tolerance_s=1 / settings.simulation.output_rate_hz)
        except ValueError as error:
            faults.append(str(error))
    return faults


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Scale factor by rate table",
    take=take,
    take_files=listed_logs(PURPOSE, ("rate_dps",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    plan=plan,
    choices=(NOISE,),
)
