"""Threshold, resolution and dead zone: what is taken, and how it goes on from there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from analysis.fibre_gyro import Ladder, plan_ladder, refined
from station.fibre_gyro.bench_or_logs import NamedSegment, gyro_measurement, listed_logs
from station.fibre_gyro.common import truth_of
from station.fibre_gyro.logs import LogRow, table_conditions
from station.fibre_gyro.recordings import segments_of
from station.fibre_gyro.segments import PlannedSegment, take_segments
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.threshold.evaluate import (
    LADDER,
    NOISE,
    PURPOSE,
    RESOLUTION,
    earth_rate_along_axis,
    evaluate,
    points_of,
    series_of,
)
from station.fibre_gyro.threshold.result import LIMITED, result
from station.fibre_gyro.threshold.sections import sections
from station.fibre_gyro.windows import checked, window_at_rest
from station.runs.store import SavedRun
from station.runs.taking import Session

_NOISE_S = 60.0
_BETWEEN_REFERENCES = 4
_REFINED = "refined"


def plan_noise(settings: FogSettings) -> list[PlannedSegment]:
    """List the segment that says the noise, unless the settings do."""
    if settings.threshold.angle_random_walk:
        return []
    return [_segment("noise at rest", NOISE, 0.0, _NOISE_S, settings, reference=False)]


def plan(settings: FogSettings, angle_random_walk: float) -> list[PlannedSegment]:
    """List the segments of the ladder and of the resolution."""
    ladder, base = ladder_for(settings, angle_random_walk), settings.threshold.resolution_at_dps
    senses = [(sense * float(rate), float(s)) for rate, s in _rungs(ladder) for sense in (1, -1)]
    planned = _with_references("", LADDER, 0.0, senses, settings)
    if base:
        changes = [(change, seconds) for change, seconds in senses if abs(change) < base]
        planned += _with_references(f"{base:g} ", RESOLUTION, base, changes, settings)
    return planned


def plan_refined(settings: FogSettings, run: SavedRun) -> list[PlannedSegment]:
    """List further inputs about the edge that the ladder of a run shows."""
    if not settings.threshold.refine:
        return []
    points = [
        one
        for one in points_of(run, settings, [])
        if one.segment.conditions["series"] == LADDER and not one.segment.conditions.get(_REFINED)
    ]
    try:
        found = series_of(points, settings.nominal_scale_factor, settings, []).found
    except ValueError:
        return []
    longest = {abs(one.input_dps): one.mean.duration_s for one in points if not one.is_reference}
    between = [(rate, _seconds_near(abs(rate), longest)) for rate in refined(found, settings.threshold.refine)]
    return _with_references("further ", LADDER, 0.0, between, settings, further=True)


def ladder_for(settings: FogSettings, angle_random_walk: float) -> Ladder:
    """Return the ladder of the settings for a noise, deg/sqrt(h)."""
    chosen = settings.threshold
    return plan_ladder(
        chosen.lowest_dps,
        chosen.highest_dps,
        angle_random_walk,
        per_decade=chosen.per_decade,
        ratio_u=chosen.ratio_u,
        seconds=(chosen.shortest_s, chosen.longest_s),
    )


def angle_random_walk_of(run: SavedRun, settings: FogSettings) -> float:
    """Return the noise by the settings, or by the segment at rest, deg/sqrt(h)."""
    if settings.threshold.angle_random_walk:
        return settings.threshold.angle_random_walk
    for segment in segments_of(run, PURPOSE):
        if segment.conditions["series"] == NOISE:
            try:
                mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
            except ValueError:
                continue
            return 60 * mean.mean_u * math.sqrt(mean.duration_s) / settings.nominal_scale_factor
    return 0.0


def take(settings: FogSettings, session: Session) -> None:
    """Take the segments on the bench: noise, ladder, and further inputs about the edge that it shows."""

    def ladder(run: SavedRun) -> list[PlannedSegment]:
        walk = angle_random_walk_of(run, settings)
        session.note_left_out(_too_noisy(ladder_for(settings, walk), settings))
        return plan(settings, walk)

    stages = [lambda run: plan_noise(settings), ladder, lambda run: plan_refined(settings, run)]
    take_segments(settings, session, open_fog_bench(settings), stages, truth_of(settings))


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by axis and rate of the table; at rest, or without input, it is a reference."""
    return [_named(row, settings) for row in rows]


def _named(row: LogRow, settings: FogSettings) -> NamedSegment:
    axis, rate, end_up = row.get("axis", settings.threshold.axis), row["rate_dps"], row["end_up"]
    base = row.get("base_dps")
    change = rate - base if base is not None else rate + earth_rate_along_axis(settings)
    reference = change == 0 or (base is None and (rate == 0 or abs(change) < settings.threshold.lowest_dps / 10))
    conditions = {
        "axis": axis,
        "end_up": end_up,
        "rate_dps": rate,
        "series": LADDER if base is None else RESOLUTION,
        "reference": reference,
        **{name: value for name, value in table_conditions(row).items() if name != "window_s"},
    }
    return f"{axis}{'' if end_up > 0 else ' down'} {rate:+.10g}{' reference' if reference else ''}", conditions


def _rungs(ladder: Ladder) -> list[tuple[float, float]]:
    return list(zip(ladder.rate_dps.tolist(), ladder.seconds.tolist(), strict=True))


def _too_noisy(ladder: Ladder, settings: FogSettings) -> dict[str, str]:
    return {
        f"input {rate:g}": f"its output drowns in the noise: it takes {seconds:.3g} s to know it to a quarter, "
        f"and threshold.longest_s is {settings.threshold.longest_s:g}"
        for rate, seconds in ladder.too_noisy
    }


def _seconds_near(rate: float, known: Mapping[float, float]) -> float:
    """As long as the nearest smaller input."""
    return known[max((one for one in known if one <= rate), default=min(known))]


def _with_references(
    name: str,
    series: str,
    base: float,
    changes: Sequence[tuple[float, float]],
    settings: FogSettings,
    *,
    further: bool = False,
) -> list[PlannedSegment]:
    """Put an output at the reference input before, between and after the others."""
    planned, count = [], 0
    for first in range(0, len(changes), _BETWEEN_REFERENCES):
        group = changes[first : first + _BETWEEN_REFERENCES]
        count += 1
        seconds = max(one for _, one in group)
        planned.append(_segment(f"{name}reference {count}", series, base, seconds, settings, further=further))
        planned += [
            _segment(
                f"{name}{change:+.6g}", series, base + change, length, settings, reference=False, further=further
            )
            for change, length in group
        ]
    if planned:
        seconds = planned[-1].seconds
        planned.append(_segment(f"{name}reference {count + 1}", series, base, seconds, settings, further=further))
    return planned


def _segment(
    key: str,
    series: str,
    input_dps: float,
    seconds: float,
    settings: FogSettings,
    *,
    reference: bool = True,
    further: bool = False,
) -> PlannedSegment:
    """The table turns against the earth rate, so that the gyro has the input that is wanted."""
    conditions = {
        "purpose": PURPOSE,
        "axis": settings.threshold.axis,
        "end_up": 1,
        "rate_dps": input_dps - earth_rate_along_axis(settings),
        "series": series,
        "reference": reference,
    }
    return PlannedSegment(
        key, seconds, settings.threshold.settle_s, {**conditions, **({_REFINED: True} if further else {})}
    )


def _unusable(run: SavedRun, settings: FogSettings) -> dict[str, str]:
    """Small rates need no tolerance: the rate that the table reached is the input."""
    found = {}
    for segment in segments_of(run, PURPOSE):
        try:
            checked(segment)
        except ValueError as error:
            found[segment.key] = str(error)
    return found


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Threshold, resolution and dead zone",
    take=take,
    take_files=listed_logs(PURPOSE, ("rate_dps",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    gives=LIMITED,
    unusable=_unusable,
)
