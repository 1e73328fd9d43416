"""What the outputs at small rates say: threshold, dead zone and resolution of each axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.fibre_gyro import (
    References,
    Responses,
    SmallRates,
    WindowMean,
    horizontal_earth_rate_dps,
    pooled_noise,
    responses,
    small_rates,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import not_taken, reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import remarks_on, window_at_rest
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "threshold"
NOISE, LADDER, RESOLUTION = "noise", "ladder", "resolution"
_SAME_INPUT = 1e-6  # deg/s
_NOT_THE_DESIGN = 0.2
_LINEAR = (0.8, 1.2)


@dataclass(frozen=True)
class Series:
    """A ladder of inputs about one reference input."""

    keys: tuple[str, ...]  # one for each response
    reference_dps: float  # true input of the references, with the earth rate
    found: Responses
    says: SmallRates


@dataclass(frozen=True)
class AxisThreshold:
    """Small rates of one axis."""

    axis: str
    ladder: Series  # inputs about zero
    resolution: Series | None  # changes about another input
    scale_factor: float  # that responses are compared with, counts per deg/s
    by_design: bool  # whether that is the one by design: the largest inputs give none that could be right
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class ThresholdFound:
    """Small rates of each axis."""

    axes: tuple[AxisThreshold, ...]
    left_out: tuple[LeftOut, ...]


@dataclass(frozen=True)
class Point:
    """Mean of one segment; `at_s` its middle in seconds of output, `input_dps` the true input about the axis."""

    segment: Segment
    mean: WindowMean
    at_s: float
    input_dps: float

    @property
    def is_reference(self) -> bool:
        """Whether it is an output without the input of the ladder."""
        return bool(self.segment.conditions.get("reference"))


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> ThresholdFound:
    """Evaluate the segments of a run."""
    left_out = not_taken(run)
    points = points_of(run, settings, left_out)
    found = []
    for axis in dict.fromkeys(axis_of(point, settings) for point in points):
        of_axis = [point for point in points if axis_of(point, settings) == axis]
        try:
            found.append(_one_axis(axis, of_axis, settings, left_out))
        except ValueError as error:
            left_out.append(LeftOut(f"axis {axis}", str(error)))
    if not found:
        raise NoUsableSignal(f"there are no outputs at small rates to find a threshold from{reasons_of(left_out)}")
    return ThresholdFound(tuple(found), tuple(left_out))


def axis_of(point: Point, settings: FogSettings) -> str:
    """Return the axis that a segment is of."""
    return str(point.segment.conditions.get("axis", settings.threshold.axis))


def earth_rate_along_axis(settings: FogSettings) -> float:
    """Return the earth rate along the table's axis, deg/s."""
    if settings.threshold.table_axis == "east":
        return 0.0
    return vertical_earth_rate_dph(settings.site.latitude_deg) / 3600


def points_of(run: SavedRun, settings: FogSettings, left_out: list[LeftOut]) -> list[Point]:
    """Return the mean of every segment; those that cannot be used are added to `left_out`."""
    found, clock, earth = [], 0.0, earth_rate_along_axis(settings)
    for segment in segments_of(run, PURPOSE):
        length = segment.recording.duration_s
        clock += length
        conditions = segment.conditions
        table = float(conditions.get("table_rate_dps", conditions["rate_dps"]))
        total = round(int(conditions.get("end_up", 1)) * (table + earth), 12)
        try:
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        found.append(Point(segment, mean, clock - length / 2, total))
    return found


def _one_axis(axis: str, points: Sequence[Point], settings: FogSettings, left_out: list[LeftOut]) -> AxisThreshold:
    of_series = {
        name: [one for one in points if one.segment.conditions.get("series", LADDER) == name]
        for name in (LADDER, RESOLUTION)
    }
    scale, by_design = _scale_factor(of_series[LADDER], settings)
    ladder = series_of(of_series[LADDER], scale, settings, left_out)
    resolution = None
    changes = of_series[RESOLUTION] or (of_series[LADDER] if abs(ladder.reference_dps) > _SAME_INPUT else [])
    if changes:
        try:
            resolution = series_of(changes, scale, settings, left_out, about_reference=True)
        except ValueError as error:
            left_out.append(LeftOut(f"resolution of axis {axis}", str(error)))
    remarks = [said for one in points for said in remarks_on(one.segment, one.mean)]
    return AxisThreshold(axis, ladder, resolution, scale, by_design, tuple(remarks))


def _scale_factor(points: Sequence[Point], settings: FogSettings) -> tuple[float, bool]:
    """Slope between the largest inputs of both senses, if it can be one; else that by design."""
    design = settings.nominal_scale_factor
    first, last = (choose(points, key=lambda one: one.input_dps, default=None) for choose in (min, max))
    if first is not None and last is not None and first.input_dps < 0 < last.input_dps:
        slope = (last.mean.mean - first.mean.mean) / (last.input_dps - first.input_dps)
        if abs(abs(slope / design) - 1) < _NOT_THE_DESIGN:  # an output may fall with the rate
            return slope, False
    return design, True


def series_of(
    points: Sequence[Point],
    scale_factor: float,
    settings: FogSettings,
    left_out: list[LeftOut],
    *,
    about_reference: bool = False,
) -> Series:
    """Return the responses of one ladder, and what they say."""
    references = [one for one in points if one.is_reference]
    if not references:
        raise ValueError("it has no output at rest: take one before and one after")
    base = references[0].input_dps
    for one in references:
        if abs(one.input_dps - base) > _SAME_INPUT + 1e-3 * abs(base):
            reason = f"its input is {one.input_dps:.6g} deg/s, that of the other references {base:.6g}"
            left_out.append(LeftOut(one.segment.key, reason))
    references = [one for one in references if abs(one.input_dps - base) <= _SAME_INPUT + 1e-3 * abs(base)]
    zero = base if about_reference else 0.0
    inputs = [one for one in points if not one.is_reference and abs(one.input_dps - zero) > _SAME_INPUT]
    if not inputs:
        raise ValueError("it has outputs at rest only")
    u = np.maximum(pooled_noise([one.mean for one in (*references, *inputs)]), 1e-12)
    near_zero = abs(base) <= settings.threshold.lowest_dps / 2
    found = responses(
        [round(one.input_dps - zero, 12) for one in inputs],
        [one.at_s for one in inputs],
        [one.mean.mean for one in inputs],
        u[len(references) :],
        References(
            np.array([one.at_s for one in references]),
            np.array([one.mean.mean for one in references]),
            u[: len(references)],
        ),
        scale_factor,
        reference_dps=0.0 if about_reference or near_zero else base,
        unseen_dps=1e-3
        * settings.threshold.misalignment_mrad
        * horizontal_earth_rate_dps(settings.site.latitude_deg),
    )
    return Series(tuple(one.segment.key for one in inputs), base, found, small_rates(found))
