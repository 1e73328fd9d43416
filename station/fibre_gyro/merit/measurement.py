"""The figures of merit: runs over the whole range, from cold starts and at other temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from analysis.fibre_gyro import turn_time
from station.fibre_gyro.at_once import watch
from station.fibre_gyro.common import output_facts, truth_of, with_link_remarks
from station.fibre_gyro.examine import examine
from station.fibre_gyro.logs import LogRow, read_logs, table_conditions
from station.fibre_gyro.merit.evaluate import PURPOSE, evaluate
from station.fibre_gyro.merit.result import LIMITED, result
from station.fibre_gyro.merit.sections import sections
from station.fibre_gyro.segments import (
    MARGIN_S,
    PlannedSegment,
    seconds_of,
    take_logs,
    take_segments,
    unusable_segments,
)
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.measurements import Measurement
from station.runs.taking import Session

_SAME_TEMPERATURE_K = 5.0


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: every run and every temperature with rest, all rates in both senses, rest."""
    chosen, planned = settings.figures, []
    names = [(f"run {number}", chosen.reference_temperature_c, True) for number in range(1, chosen.runs + 1)]
    names += [(f"run at {t:+g} deg C", t, False) for t in chosen.temperatures_c]
    for name, temperature, reference in names:
        common = {"purpose": PURPOSE, "run": name, "axis": chosen.axis, "end_up": 1, "reference": reference}
        common |= {"temperature_c": temperature}
        rest = {**common, "rate_dps": 0.0}
        planned.append(PlannedSegment(f"{name}, static before", chosen.static_s, chosen.settle_s, rest))
        for size in chosen.rates_dps:
            turns = max(1, round(chosen.seconds / turn_time(size)))
            for rate in (size, -size):
                key, seconds = f"{name}, {rate:+.10g} deg/s", turns * turn_time(rate) + MARGIN_S
                planned.append(PlannedSegment(key, seconds, chosen.settle_s, {**common, "rate_dps": rate}))
        planned.append(PlannedSegment(f"{name}, static after", chosen.static_s, chosen.settle_s, rest))
    return planned


def take(settings: FogSettings, session: Session) -> None:
    """Take the segments on the bench."""
    take_segments(settings, session, open_fog_bench(settings), [lambda run: plan(settings)], truth_of(settings))


def take_files(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
    """Make a run of logs; each names the rate of the table, and run and temperature where there are several."""

    def named(rows: Sequence[LogRow]) -> list[tuple[str, dict[str, object]]]:
        several = len({row.get("axis", settings.figures.axis) for row in rows}) > 1
        return [_named(row, settings, several=several) for row in rows]

    take_logs(session, paths, read_logs(paths, PURPOSE, ("rate_dps",), named, settings))


def _named(row: LogRow, settings: FogSettings, *, several: bool) -> tuple[str, dict[str, object]]:
    temperature, rate = row.get("temperature_c"), row["rate_dps"]
    axis, end_up = row.get("axis", settings.figures.axis), row["end_up"]
    reference_c = settings.figures.reference_temperature_c
    conditions = {
        "run": row.get("run", "run 1"),
        "axis": axis,
        "temperature_c": temperature,
        "reference": temperature is None or abs(temperature - reference_c) <= _SAME_TEMPERATURE_K,
        "rate_dps": rate,
        "end_up": end_up,
        **table_conditions(row),
    }
    of_axis = f"{axis} " if several else ""
    down = " down" if end_up < 0 else ""
    return f"{of_axis}{conditions['run']}, {'static' if rate == 0 else f'{rate:+.10g} deg/s'}{down}", conditions


MEASUREMENT = Measurement(
    name=PURPOSE,
    command="gyrolock fog figures",
    title="Figures of merit of the scale factor",
    kind=FIBRE_GYRO,
    take=take,
    take_files=take_files,
    evaluate=evaluate,
    result=with_link_remarks(result),
    sections=sections,
    facts=output_facts,
    gives=LIMITED,
    watch=watch,
    examine=examine,
    unusable=lambda run, settings: unusable_segments(run, settings, [PURPOSE]),
    seconds=lambda settings: seconds_of(plan(settings)),
)
