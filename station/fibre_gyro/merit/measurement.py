"""The figures of merit: runs over the whole range, from cold starts and at other temperatures."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.fibre_gyro import turn_time
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.logs import LogRow, table_conditions
from station.fibre_gyro.merit.evaluate import PURPOSE, evaluate
from station.fibre_gyro.merit.result import LIMITED, result
from station.fibre_gyro.merit.sections import sections
from station.fibre_gyro.segments import MARGIN_S, PlannedSegment
from station.fibre_gyro.settings import FogSettings

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
        if reference and chosen.turn_on_s:
            planned.append(
                PlannedSegment(f"{name}, switched on", chosen.turn_on_s, 0.0, {**rest, "since_on_s": 0.0})
            )
        planned.append(PlannedSegment(f"{name}, static before", chosen.static_s, chosen.settle_s, rest))
        for size in chosen.rates_dps:
            turns = max(1, round(chosen.seconds / turn_time(size)))
            for rate in (size, -size):
                key, seconds = f"{name}, {rate:+.10g} deg/s", turns * turn_time(rate) + MARGIN_S
                planned.append(PlannedSegment(key, seconds, chosen.settle_s, {**common, "rate_dps": rate}))
        planned.append(PlannedSegment(f"{name}, static after", chosen.static_s, chosen.settle_s, rest))
    return planned


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by the rate of the table, and by run and axis where there are several."""
    several = len({row.get("axis", settings.figures.axis) for row in rows}) > 1
    return [_named(row, settings, several=several) for row in rows]


def _named(row: LogRow, settings: FogSettings, *, several: bool) -> NamedSegment:
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
        **({"since_on_s": row["since_on_s"]} if "since_on_s" in row else {}),
    }
    of_axis = f"{axis} " if several else ""
    down = " down" if end_up < 0 else ""
    what = "switched on" if "since_on_s" in row else "static" if rate == 0 else f"{rate:+.10g} deg/s"
    return f"{of_axis}{conditions['run']}, {what}{down}", conditions


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Figures of merit of the scale factor",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, ("rate_dps",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    plan=plan,
)
