"""Scale factor and bias over a temperature ramp: what is taken, and how it goes on from there."""

from __future__ import annotations

from collections.abc import Sequence

from analysis.fibre_gyro import turn_time
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.logs import LogRow, table_conditions
from station.fibre_gyro.segments import MARGIN_S, PlannedSegment
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.temperature.evaluate import PURPOSE, evaluate
from station.fibre_gyro.temperature.result import LIMITED, result
from station.fibre_gyro.temperature.sections import sections


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: rest, a turn in both senses, rest, ..., while the chamber goes up and down again."""
    chosen, planned, begin = settings.temperature, [], 0.0
    lasts = 60 * (chosen.hottest_c - chosen.coldest_c) / chosen.ramp_c_per_min
    for name, start, end in (
        ("up", chosen.coldest_c, chosen.hottest_c),
        ("down", chosen.hottest_c, chosen.coldest_c),
    ):
        ramp = chosen.ramp_c_per_min if end > start else -chosen.ramp_c_per_min
        by_hand = f"Let the chamber go from {start:g} to {end:g} deg C, {chosen.ramp_c_per_min:g} K a minute."
        ends, number = begin + lasts, 0
        while begin < ends:
            number += 1
            for what, rate, seconds in _cycle(settings):
                conditions = {
                    "purpose": PURPOSE,
                    "axis": chosen.axis,
                    "end_up": 1,
                    "rate_dps": rate,
                    "by_hand": by_hand,
                    "ramp_c_per_min": ramp,
                    "planned_temperature_c": start + ramp * (begin + chosen.settle_s - (ends - lasts)) / 60,
                    "planned_begin_s": begin + chosen.settle_s,
                }
                planned.append(PlannedSegment(f"{name} {number}, {what}", seconds, chosen.settle_s, conditions))
                begin += chosen.settle_s + seconds
                if begin >= ends:
                    break
    return planned


def _cycle(settings: FogSettings) -> list[tuple[str, float, float]]:
    """Name, rate and seconds of what is repeated."""
    chosen = settings.temperature
    rates = (chosen.rate_dps, -chosen.rate_dps) if chosen.rate_dps else ()
    turns = [(f"{rate:+.10g} deg/s", rate, turn_time(rate) + MARGIN_S) for rate in rates]
    return [("rest", 0.0, chosen.rest_s), *turns]


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by axis, rate of the table and, where the list says it, temperature."""
    return [_named(row, settings) for row in rows]


def _named(row: LogRow, settings: FogSettings) -> NamedSegment:
    axis, rate, warm = (
        row.get("axis", settings.temperature.axis),
        row.get("rate_dps", 0.0),
        row.get("temperature_c"),
    )
    conditions = {
        "axis": axis,
        "end_up": row["end_up"],
        "rate_dps": rate,
        **({} if warm is None else {"temperature_c": warm}),
        **({"begin_s": row["start_s"]} if "start_s" in row else {}),
        **({} if not rate else {k: v for k, v in table_conditions(row).items() if k != "window_s"}),
    }
    at = "" if warm is None else f" at {warm:+g} deg C"
    return (
        f"{axis}{'' if row['end_up'] > 0 else ' down'} {f'{rate:+.10g} deg/s' if rate else 'rest'}{at}",
        conditions,
    )


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Scale factor and bias over the temperature",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, (), named, whole=True),
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    plan=plan,
)
