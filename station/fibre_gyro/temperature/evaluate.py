"""What the output over a temperature ramp says: bias and scale factor as functions of the temperature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    OverTemperature,
    fit_over_temperature,
    horizontal_earth_rate_dps,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import PPM, angle_clock_u, reasons_of
from station.fibre_gyro.recordings import Segment
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.temperature.blocks import (
    Blocks,
    Course,
    TimedSegment,
    Turned,
    course_of,
    rest_blocks,
    timed_segments,
    turned_means,
)
from station.results.result import LeftOut
from station.runs.store import SavedRun

Floats = NDArray[np.float64]

PURPOSE = "temperature"
_ROUNDS = 2
_TOO_FEW = "there are not four outputs {} at different temperatures"


@dataclass(frozen=True)
class Points:
    """Values that a model was fitted to; `at_s` since the begin of the run, `rate` kelvin a minute; (n,)."""

    value: Floats
    value_u: Floats
    at_s: Floats
    temperature: Floats
    rate: Floats


@dataclass(frozen=True)
class Modelled:
    """A quantity over the temperature: points and model."""

    points: Points
    model: OverTemperature

    @property
    def residual_rms(self) -> float:
        """Root mean square of what the model leaves, in the unit of the values."""
        return float(np.sqrt(np.mean(self.model.residual**2)))


@dataclass(frozen=True)
class AxisTemperature:
    """One axis over the temperature."""

    axis: str
    bias: Modelled | None  # deg/h; ``None`` without enough output at rest
    # standard uncertainty of a constant in the bias that the run cannot show: the horizontal earth rate by a
    # misalignment; deg/h
    bias_u_constant: float
    scale: Modelled | None  # ppm off the scale factor by design; ``None`` without enough outputs at a rate
    # standard uncertainty of the gyro's clock in it, where the output is an angle a frame; ppm
    scale_u_constant: float
    rate_noise: float  # part of the scatter of dT/dt that is noise of the thermometer
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class TemperatureFound:
    """Each axis over the temperature."""

    axes: tuple[AxisTemperature, ...]
    left_out: tuple[LeftOut, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> TemperatureFound:
    """Evaluate the segments of a run."""
    left_out: list[LeftOut] = []
    segments = timed_segments(run, PURPOSE, left_out)
    found = []
    for axis in dict.fromkeys(_axis(one.segment, settings) for one in segments):
        of_axis = [one for one in segments if _axis(one.segment, settings) == axis]
        try:
            found.append(_one_axis(axis, of_axis, settings, left_out))
        except ValueError as error:
            left_out.append(LeftOut(f"axis {axis}", str(error)))
    axes = tuple(one for one in found if one.bias or one.scale)
    if not axes:
        raise NoUsableSignal(f"nothing changes with the temperature that could be fitted{reasons_of(left_out)}")
    return TemperatureFound(axes, tuple(left_out))


def _axis(segment: Segment, settings: FogSettings) -> str:
    return str(segment.conditions.get("axis", settings.temperature.axis))


def _one_axis(
    axis: str, segments: Sequence[TimedSegment], settings: FogSettings, left_out: list[LeftOut]
) -> AxisTemperature:
    chosen = settings.temperature
    course = course_of(segments, chosen.window_s)
    at_rest = [one for one in segments if not one.segment.conditions["rate_dps"]]
    remarks: list[str] = []
    at_rates = [one for one in segments if one.segment.conditions["rate_dps"]]
    turned = turned_means(at_rates, settings, left_out, remarks)
    blocks = rest_blocks(at_rest, settings, remarks)
    bias, scale = None, None
    # the earth rate at rest is seen through the scale factor, the scale factor through the bias
    for _ in range(_ROUNDS):
        bias = _model(_bias_points(blocks, course, scale, settings), settings)
        scale = _model(_scale_points(turned, course, bias, settings), settings, with_rate=False)
    if bias is None:
        left_out.append(LeftOut(f"bias of axis {axis}", _TOO_FEW.format("at rest")))
    if scale is None:
        left_out.append(LeftOut(f"scale factor of axis {axis}", _TOO_FEW.format("at a rate of the table")))
    horizontal = 3600 * horizontal_earth_rate_dps(settings.site.latitude_deg)
    # towards the north or the south or between: nobody says
    unseen = 1e-3 * chosen.misalignment_mrad * horizontal / np.sqrt(2.0)
    clock_u = PPM * angle_clock_u([one.segment for one in at_rates])
    return AxisTemperature(axis, bias, float(unseen), scale, clock_u, _rate_noise(bias, course), tuple(remarks))


def _model(points: Points, settings: FogSettings, *, with_rate: bool = True) -> Modelled | None:
    try:
        model = fit_over_temperature(
            points.value,
            points.value_u,
            points.at_s,
            points.temperature,
            points.rate if with_rate else None,
            reference=settings.figures.reference_temperature_c,
            highest_order=settings.temperature.highest_order,
        )
    except ValueError:
        return None
    return Modelled(points, model)


def _bias_points(blocks: Blocks, course: Course, scale: Modelled | None, settings: FogSettings) -> Points:
    """Bias of every block, deg/h: the output over the scale factor at its temperature, less the earth rate."""
    warm, rate = course.at(blocks.at_s)
    k = settings.nominal_scale_factor * np.ones(warm.size)
    if scale is not None:
        k = k * (1 + scale.model.at(np.clip(warm, scale.model.lowest, scale.model.highest))[0] / PPM)
    earth = blocks.end_up * vertical_earth_rate_dph(settings.site.latitude_deg)
    return Points(3600 * blocks.mean / k - earth, 3600 * blocks.mean_u / np.abs(k), blocks.at_s, warm, rate)


def _scale_points(turned: Turned, course: Course, bias: Modelled | None, settings: FogSettings) -> Points:
    """Scale factor of every output at a rate, ppm off that by design."""
    warm, change = course.at(turned.at_s)
    known, known_u = np.zeros(warm.size), np.zeros(warm.size)
    if bias is not None:
        model = bias.model
        known, known_u = model.at(np.clip(warm, model.lowest, model.highest))
        if model.with_rate:
            known = known + model.rate_coefficient * change
            known_u = np.hypot(known_u, model.rate_coefficient_u * change)
    nominal = settings.nominal_scale_factor
    rate = turned.rate_dps
    off = PPM * (turned.mean / nominal - known / 3600 - rate) / rate
    off_u = PPM * turned.mean_u / nominal / np.abs(rate)
    bias_u = PPM * known_u / 3600 / np.abs(rate)
    return _in_pairs(Points(off, off_u, turned.at_s, warm, change), rate, bias_u)


def _in_pairs(points: Points, rate_dps: Floats, bias_u: Floats) -> Points:
    """Mean of neighbours in opposite senses, free of the bias; with one alone the bias counts in u."""
    columns = np.column_stack([points.value, points.value_u, points.at_s, points.temperature, points.rate])
    rows, place = [], 0
    while place < rate_dps.size:
        first = columns[place]
        if place + 1 < rate_dps.size and abs(rate_dps[place] + rate_dps[place + 1]) < 0.01 * abs(rate_dps[place]):
            both = (first + columns[place + 1]) / 2
            both[1] = np.hypot(first[1], columns[place + 1][1]) / 2
            rows.append(both)
            place += 2
        else:
            rows.append(np.array([first[0], np.hypot(first[1], bias_u[place]), *first[2:]]))
            place += 1
    return Points(*np.array(rows, dtype=np.float64).reshape(-1, 5).T)


def _rate_noise(bias: Modelled | None, course: Course) -> float:
    """Part of the variance of dT/dt that is noise: so much the coefficient of dT/dt comes out too small."""
    if bias is None or not np.ptp(bias.points.rate) > 0:
        return 0.0
    return float(np.mean(course.rate_u(bias.points.at_s) ** 2) / np.mean(bias.points.rate**2))
