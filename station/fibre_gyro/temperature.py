"""Scale factor and bias over a temperature ramp: plan, evaluation, compensation table, result and report."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from analysis.arrays import NORMAL_95
from analysis.fibre_gyro import (
    OverTemperature,
    fit_over_temperature,
    horizontal_earth_rate_dps,
    mean_at_rest,
    pooled_noise,
    temperature_course,
    turn_time,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import COUNTS_PER_DPS, PPM, angle_clock_u, reasons_of
from station.fibre_gyro.logs import (
    LogRow,
    NamedSegment,
    gyro_measurement,
    listed_logs,
    planned_segments,
    table_conditions,
)
from station.fibre_gyro.segments import (
    MARGIN_S,
    PlannedSegment,
    Segment,
    check_table_rate,
    checked,
    remarks_on,
    segments_of,
    window_of_any_length,
)
from station.fibre_gyro.settings import FogSettings, Name, TestSettings
from station.report.figure import ACCENT, HALF, INK, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, repeated
from station.results.result import Excluded, PlacedFigure, Result, Section, TextTable, with_uncertainty
from station.runs.store import SavedRun
from station.settings import Finite, NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# What the output over a temperature ramp says: bias and scale factor as functions of the temperature


Floats = NDArray[np.float64]

PURPOSE = "temperature"
_ROUNDS = 2
_TOO_FEW = "there are not four outputs {} at different temperatures"


class TemperatureSettings(TestSettings):
    """Scale factor and bias over a temperature ramp."""

    axis: Name
    coldest_c: Finite
    hottest_c: Finite
    ramp_c_per_min: Positive
    cycles: Annotated[int, Field(ge=1, le=100)]
    hold_s: NotNegative
    rate_dps: NotNegative
    rest_s: Positive
    settle_s: NotNegative
    block_s: Positive
    window_s: Positive
    thermometer_lag_s: Finite
    highest_order: Annotated[int, Field(ge=1, le=6)]
    table_step_c: Positive
    misalignment_mrad: NotNegative

    def wrong(self) -> str:
        """See that the ramp goes up."""
        return "hottest_c must be above temperature.coldest_c" if self.hottest_c <= self.coldest_c else ""


_own = TemperatureSettings.of


@dataclass(frozen=True)
class TemperaturePoints:
    """Values that a model was fitted to; `at_s` since the begin of the run, `rate` kelvin a minute; (n,)."""

    value: Floats
    value_u: Floats
    at_s: Floats
    temperature: Floats
    rate: Floats


@dataclass(frozen=True)
class Modelled:
    """A quantity over the temperature: points and model."""

    points: TemperaturePoints
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
class TemperatureEvaluation:
    """Each axis over the temperature."""

    axes: tuple[AxisTemperature, ...]
    left_out: tuple[Excluded, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> TemperatureEvaluation:
    """Evaluate the segments of a run."""
    left_out: list[Excluded] = []
    segments = timed_segments(run, PURPOSE, left_out)
    found = []
    for axis in dict.fromkeys(_axis(one.segment, settings) for one in segments):
        of_axis = [one for one in segments if _axis(one.segment, settings) == axis]
        with Excluded.by_error(f"axis {axis}", left_out):
            found.append(_one_axis(axis, of_axis, settings, left_out))
    axes = tuple(one for one in found if one.bias or one.scale)
    if not axes:
        raise NoUsableSignal(f"nothing changes with the temperature that could be fitted{reasons_of(left_out)}")
    return TemperatureEvaluation(axes, tuple(left_out))


def _axis(segment: Segment, settings: FogSettings) -> str:
    return str(segment.conditions.get("axis", _own(settings).axis))


def _one_axis(
    axis: str, segments: Sequence[TimedSegment], settings: FogSettings, left_out: list[Excluded]
) -> AxisTemperature:
    chosen = _own(settings)
    course = course_of(segments, chosen.window_s, chosen.thermometer_lag_s)
    at_rest = [one for one in segments if not one.segment.conditions["rate_dps"]]
    remarks: list[str] = []
    at_rates = [one for one in segments if one.segment.conditions["rate_dps"]]
    turned = turned_means(at_rates, settings, left_out, remarks)
    blocks = rest_blocks(at_rest, settings, remarks)
    bias, scale = None, None
    # the earth rate at rest is seen through the scale factor, the scale factor through the bias
    for _ in range(_ROUNDS):
        warm, rate = course.at(blocks.at_s)
        k = settings.nominal_scale_factor * np.ones(warm.size)
        if scale is not None:
            k = k * (1 + scale.model.at(np.clip(warm, scale.model.lowest, scale.model.highest))[0] / PPM)
        earth = blocks.end_up * vertical_earth_rate_dph(settings.site.latitude_deg)
        bias = _model(
            TemperaturePoints(
                3600 * blocks.mean / k - earth, 3600 * blocks.mean_u / np.abs(k), blocks.at_s, warm, rate
            ),
            settings,
        )
        scale = _model(_scale_points(turned, course, bias, settings), settings, with_rate=False)
    if bias is None:
        left_out.append(Excluded(f"bias of axis {axis}", _TOO_FEW.format("at rest")))
    if scale is None:
        left_out.append(Excluded(f"scale factor of axis {axis}", _TOO_FEW.format("at a rate of the table")))
    horizontal = 3600 * horizontal_earth_rate_dps(settings.site.latitude_deg)
    # towards the north or the south or between: nobody says
    unseen = 1e-3 * chosen.misalignment_mrad * horizontal / np.sqrt(2.0)
    clock_u = PPM * angle_clock_u([one.segment for one in at_rates])
    rate_noise = 0.0  # part of the variance of dT/dt that is noise: so much too small its coefficient comes out
    if bias is not None and np.ptp(bias.points.rate) > 0:
        rate_noise = float(np.mean(course.rate_u(bias.points.at_s) ** 2) / np.mean(bias.points.rate**2))
    return AxisTemperature(axis, bias, float(unseen), scale, clock_u, rate_noise, tuple(remarks))


def _model(points: TemperaturePoints, settings: FogSettings, *, with_rate: bool = True) -> Modelled | None:
    try:
        model = fit_over_temperature(
            points.value,
            points.value_u,
            points.at_s,
            points.temperature,
            points.rate if with_rate else None,
            reference=settings.figures.reference_temperature_c,
            highest_order=_own(settings).highest_order,
        )
    except ValueError:
        return None
    return Modelled(points, model)


def _scale_points(
    turned: Turned, course: TemperatureCourse, bias: Modelled | None, settings: FogSettings
) -> TemperaturePoints:
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
    points = TemperaturePoints(off, off_u, turned.at_s, warm, change)
    columns = np.column_stack([points.value, points.value_u, points.at_s, points.temperature, points.rate])
    rows, place = [], 0
    while place < rate.size:
        first = columns[place]
        if place + 1 < rate.size and abs(rate[place] + rate[place + 1]) < 0.01 * abs(rate[place]):
            both = (first + columns[place + 1]) / 2
            both[1] = np.hypot(first[1], columns[place + 1][1]) / 2
            rows.append(both)
            place += 2
        else:
            rows.append(np.array([first[0], np.hypot(first[1], bias_u[place]), *first[2:]]))
            place += 1
    return TemperaturePoints(*np.array(rows, dtype=np.float64).reshape(-1, 5).T)


# --------------------
# When each segment of a ramp was taken, how warm the gyro was, and means of the output at rest and at rates


MOST_BLOCKS = 300
_MOST_SAMPLES = 20_000
_MANY_TURNS = 100_000
_OVERLAP_S = 1.0
_CHAMBER = "chamber_temperature_degc"


@dataclass(frozen=True)
class TimedSegment:
    """A segment, and the time at which it began, s since the begin of the run."""

    segment: Segment
    begin_s: float


def timed_segments(run: SavedRun, purpose: str, left_out: list[Excluded]) -> list[TimedSegment]:
    """Return the segments that can be used, in the order of time; the others are added to `left_out`."""
    # The time is that of the clock where they were taken, of the simulation, or of the list of logs. Where nobody
    # says it, or two would overlap, one follows the other.
    taken = {one.key: one.taken_at for one in run.taken_for(purpose)}
    on_bench = not run.facts.simulated and not run.facts.sources
    found, clock = [], 0.0
    for segment in segments_of(run, purpose):
        length = segment.recording.duration_s
        begin = segment.conditions.get("begin_s")
        if on_bench:
            begin = datetime.fromisoformat(taken[segment.key]).timestamp() - length
        found.append((segment, clock if begin is None else float(begin), clock))
        clock += length
    ordered = sorted(found, key=lambda one: one[1])
    ends = [begin + segment.recording.duration_s for segment, begin, _ in ordered]
    overlap = any(later[1] < end - _OVERLAP_S for later, end in zip(ordered[1:], ends, strict=False))
    usable = []
    for segment, begin, follows in found if overlap else ordered:
        with Excluded.by_error(segment.key, left_out):
            checked(segment)
            usable.append(TimedSegment(segment, follows if overlap else begin - ordered[0][1]))
    return usable


@dataclass(frozen=True)
class TemperatureCourse:
    """Temperature of the run in time, as the thermometer gave it."""

    times: Floats
    temperature: Floats
    window_s: float

    def at(self, at_s: Floats) -> tuple[Floats, Floats]:
        """Temperature, deg C, and its change, kelvin a minute."""
        warm, rate, _ = temperature_course(self.times, self.temperature, at_s, window_s=self.window_s)
        return warm, rate

    def rate_u(self, at_s: Floats) -> Floats:
        """Noise of the change, kelvin a minute."""
        return temperature_course(self.times, self.temperature, at_s, window_s=self.window_s)[2]


def course_of(segments: Sequence[TimedSegment], window_s: float, lag_s: float = 0.0) -> TemperatureCourse:
    """Return the course of the temperature: of the gyro's thermometer, else of the chamber's or the list's."""
    # `lag_s`: by how much the thermometer is known to be late
    times, warm = [], []
    for one in segments:
        recording, conditions = one.segment.recording, one.segment.conditions
        if recording.temperature is not None and np.isfinite(recording.temperature).any():
            times.append(one.begin_s + recording.times)
            warm.append(recording.temperature)
        elif (given := conditions.get("temperature_c", conditions.get(_CHAMBER))) is not None:
            times.append(np.array([one.begin_s + recording.duration_s / 2]))
            warm.append(np.array([float(given)]))
    if not times:
        raise ValueError(
            "nobody gives a temperature: the output needs a column temperature, or the list temperature_c"
        )
    when, values = np.concatenate(times), np.concatenate(warm)
    there = np.isfinite(values)
    when, values = when[there], values[there]
    step = max(1, when.size // _MOST_SAMPLES)
    whole = when.size // step * step
    # neighbours are taken together: their mean keeps what they know
    return TemperatureCourse(
        when[:whole].reshape(-1, step).mean(axis=1) - lag_s,
        values[:whole].reshape(-1, step).mean(axis=1),
        window_s,
    )


@dataclass(frozen=True)
class Blocks:
    """Means of the output at rest over equal times: counts, s since the begin of the run, end of the axis."""

    mean: Floats
    mean_u: Floats
    at_s: Floats
    end_up: Floats


def rest_blocks(segments: Sequence[TimedSegment], settings: FogSettings, remarks: list[str]) -> Blocks:
    """Cut the outputs at rest into blocks of ``block_s`` or longer; each with the noise of all of them."""
    # What was missing or far off is added to `remarks`.
    whole = sum(one.segment.recording.duration_s for one in segments)
    block_s = max(_own(settings).block_s, whole / MOST_BLOCKS)
    means, rows = [], []
    for one in segments:
        recording = one.segment.recording
        lost, far = sum(gap.missing for gap in recording.gaps), 0
        count = max(1, round(recording.duration_s / block_s))
        edges = np.linspace(0, recording.times[-1] + recording.interval_s, count + 1)
        places = np.searchsorted(recording.times + recording.interval_s / 2, edges)
        fewest = max(2.0, recording.duration_s / count / recording.interval_s / 2)
        for place, (first, last) in enumerate(itertools.pairwise(places)):
            if last - first < fewest:
                continue  # most of it is missing
            words = recording.counts[first:last]
            mean = mean_at_rest(words, recording.interval_s, resolution=settings.gyro.output_resolution)
            far += mean.outliers
            means.append(mean)
            middle = one.begin_s + float(edges[place] + edges[place + 1]) / 2
            rows.append((mean.mean, middle, float(one.segment.conditions.get("end_up", 1))))
        for number, what in ((lost, "missing"), (far, "far from all others and left out")):
            if number:
                said = "1 output word is" if number == 1 else f"{number} output words are"
                remarks.append(f"{one.segment.key}: {said} {what}.")
    if not rows:
        return Blocks(*(np.empty(0) for _ in range(4)))
    mean, at, end_up = np.array(rows, dtype=np.float64).T
    floor = 1e-12 * np.abs(mean).max() + 1e-15
    return Blocks(mean, np.maximum(pooled_noise(means), floor), at, end_up)


@dataclass(frozen=True)
class Turned:
    """Means of the output at rates; counts, deg/s along the axis with the earth rate, s since the begin; (n,)."""

    mean: Floats
    mean_u: Floats
    rate_dps: Floats
    at_s: Floats


def turned_means(
    segments: Sequence[TimedSegment], settings: FogSettings, left_out: list[Excluded], remarks: list[str]
) -> Turned:
    """Return the means over whole turns; adds to `left_out` what cannot be used, to `remarks` what was missing."""
    earth = vertical_earth_rate_dph(settings.site.latitude_deg) / 3600
    tilt, means, rows = _own(settings).misalignment_mrad, [], []
    for one in segments:
        conditions = one.segment.conditions
        with Excluded.by_error(one.segment.key, left_out):
            check_table_rate(conditions, settings.table.rate_tolerance_ppm)
            mean = window_of_any_length(one.segment, settings, turns=_MANY_TURNS, tilt_mrad=tilt)
            remarks += remarks_on(one.segment, mean)
            means.append(mean)
            table = float(conditions.get("table_rate_dps", conditions["rate_dps"]))
            along = int(conditions.get("end_up", 1)) * (table + earth)
            rows.append((mean.mean, along, one.begin_s + mean.duration_s / 2))
    if not rows:
        return Turned(*(np.empty(0) for _ in range(4)))
    mean_of, rate, at = np.array(rows, dtype=np.float64).T
    return Turned(mean_of, np.maximum(pooled_noise(means), 1e-12 * np.abs(mean_of)), rate, at)


# --------------------
# The compensation table: scale factor and bias at equal steps of the temperature, within what was measured


@dataclass(frozen=True)
class Compensation:
    """Table of one axis; nan where a quantity was not measured at a temperature."""

    temperature: Floats  # (n,): deg C, whole multiples of the step
    scale_factor: Floats  # (n,): Counts per deg/s
    scale_factor_u: Floats
    bias: Floats  # (n,): deg/h, without dT/dt
    bias_u: Floats
    bias_rate: float  # deg/h per kelvin a minute; 0 where the model has no such term
    bias_rate_u: float


def compensation_of(one: AxisTemperature, settings: FogSettings) -> Compensation:
    """Return the table of an axis; empty where the measured range holds no whole multiple of the step."""
    step, nominal = _own(settings).table_step_c, settings.nominal_scale_factor
    models = [modelled.model for modelled in (one.bias, one.scale) if modelled is not None]
    first = math.ceil(min(model.lowest for model in models) / step - 1e-9)
    last = math.floor(max(model.highest for model in models) / step + 1e-9)
    at = step * np.arange(first, last + 1, dtype=np.float64)
    nothing = np.full(at.size, np.nan)
    bias, bias_u = (nothing, nothing) if one.bias is None else one.bias.model.at(at)
    off, off_u = (nothing, nothing) if one.scale is None else one.scale.model.at(at)
    rate, rate_u = 0.0, 0.0
    if one.bias is not None and one.bias.model.with_rate:
        rate, rate_u = one.bias.model.rate_coefficient, one.bias.model.rate_coefficient_u
    return Compensation(
        at,
        nominal * (1 + off / PPM),
        nominal * np.hypot(off_u, one.scale_u_constant) / PPM,
        bias,
        np.hypot(bias_u, one.bias_u_constant),
        rate,
        rate_u,
    )


# --------------------
# Scale factor and bias over the temperature as numbers and sentences


NUMBERS = (
    Quantity(
        "scale_factor_over_temperature", "ppm", lambda one: _span(one.scale)[0], lambda one: _span(one.scale)[1],
        limit=True, headline=True, doc="largest less smallest K over the measured range",
    ),
    Quantity(
        "bias_over_temperature", "dph", lambda one: _span(one.bias)[0], lambda one: _span(one.bias)[1], limit=True
    ),
    Quantity(
        "bias_residual", "dph", lambda one: one.bias.residual_rms if one.bias else math.nan, limit=True,
        doc="rms of what the model leaves",
    ),
    Quantity(
        "bias_hysteresis", "dph", lambda one: _hysteresis(one.bias)[0], lambda one: _hysteresis(one.bias)[1],
        limit=True, doc="bias going up less going down, at equal temperature",
    ),
    Quantity(
        "scale_factor_hysteresis", "ppm", lambda one: _hysteresis(one.scale)[0],
        lambda one: _hysteresis(one.scale)[1], limit=True, doc="K going up less going down, at equal temperature",
    ),
    Quantity("rate_noise_share", of="rate_noise", doc="part of the scatter of dT/dt that is noise"),
)  # fmt: skip
DESIGN = (Quantity("reference_temperature", "c"), Quantity("nominal_scale_factor", "counts_per_dps"))
COMPENSATION = (
    Quantity("temperature", "c"),
    Quantity("scale_factor", "counts_per_dps", u=True),
    Quantity("bias", "dph", u=True),
    Quantity("bias", "dph_per_k_per_min", "bias_rate", u=True, doc="by dT/dt"),
)
POINTS = (
    Quantity("at", "s", "points.at_s"),
    Quantity("temperature", "c", "points.temperature"),
    Quantity("k_per_min", of="points.rate", doc="dT/dt"),
)


_RAMPS, _FEWEST_OF_RAMP = 0.3, 3  # of the fastest change: slower is no ramp; points on the way up or down


def _hysteresis(modelled: Modelled | None) -> tuple[float, float]:
    """Going up less going down at equal temperature, with u; nan without a ramp each way."""
    if modelled is None:
        return math.nan, math.nan
    model, rate = modelled.model, modelled.points.rate
    # what the polynomial does not say
    beside = model.residual + (model.rate_coefficient * rate if model.with_rate else 0.0)
    up, down = (beside[sign * rate > _RAMPS * np.abs(rate).max()] for sign in (1, -1))
    if min(up.size, down.size) < _FEWEST_OF_RAMP:
        return math.nan, math.nan
    # slow noise is another on every ramp, and no mean over a ramp makes it smaller
    steep = np.sign(rate[np.abs(rate) > _RAMPS * np.abs(rate).max()])
    ramps = 1 + np.count_nonzero(np.diff(steep))
    u = math.hypot(model.noise_u * math.sqrt(1 / up.size + 1 / down.size), 2 / math.sqrt(ramps) * model.slow)
    return float(up.mean() - down.mean()), u


def _model_quantities(unit: str, constant_u: float = 0.0) -> tuple[Quantity, ...]:
    """Numbers of a model; `constant_u` is added to the u of its constant."""

    def coefficients_u(modelled: Modelled) -> Floats:
        u = modelled.model.coefficients_u.copy()
        u[0] = math.hypot(u[0], constant_u)
        return u

    return (
        Quantity("order", of="model.order"),
        Quantity("coefficients", unit, "model.coefficients", coefficients_u, doc="of powers of T - T0"),
        Quantity("", f"{unit}_per_k_per_min", "model.rate_coefficient", u=True, u_at=f"{unit}_u_per_k_per_min"),
        Quantity("lowest", "c", "model.lowest"),
        Quantity("highest", "c", "model.highest"),
        Quantity("noise_u", unit, "model.noise_u", doc="of a point"),
        Quantity("slow", unit, "model.slow", doc="slow noise"),
        Quantity("residual", unit, "residual_rms", doc="rms of what the model leaves"),
    )


_MODELS = {"scale_factor": "ppm", "bias": "dph"}
QUANTITIES = (
    QuantityGroup((*NUMBERS, *DESIGN), "axes", "axis", alone=False),
    *(QuantityGroup(_model_quantities(unit), f"axes.{name}") for name, unit in _MODELS.items()),
    *(QuantityGroup(POINTS, f"axes.{name}.points") for name in _MODELS),
    QuantityGroup(COMPENSATION, "axes.compensation"),
    QuantityGroup(repeated(NUMBERS)),
)
_CLEAR_LAG = 14.0  # by so much AICc must be lower with a late thermometer
_NOISY_RATE = 0.01


def result(found: TemperatureEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    axes = [_axis_document(one, settings) for one in found.axes]
    alone = len(axes) == 1
    lines = tuple(line for one in found.axes for line in _lines(one, several=not alone))
    watched = tuple(_to_watch(found, settings))
    return Result(
        name="result",
        value="; ".join(map(_value, found.axes)),
        document={**(axes[0] if alone else {}), "axes": axes, "left_out": found.left_out},
        quantities=QUANTITIES,
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(said for one in found.axes for said in _sentences(one)),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
        tables=tuple(table_of_models(one) for one in found.axes),
    )


def _value(one: AxisTemperature) -> str:
    parts = []
    if one.scale is not None:
        parts.append(f"K changes by {with_uncertainty(*_span(one.scale))} ppm")
    if one.bias is not None:
        parts.append(f"the bias by {with_uncertainty(*_span(one.bias))} deg/h")
    model = next(modelled.model for modelled in (one.bias, one.scale) if modelled is not None)
    return f"{', '.join(parts)} from {model.lowest:.3g} to {model.highest:.3g} °C"


def _span(modelled: Modelled | None) -> tuple[float, float]:
    return (math.nan, math.nan) if modelled is None else modelled.model.span()


def _axis_document(one: AxisTemperature, settings: FogSettings) -> dict[str, Any]:
    return {
        "axis": one.axis,
        **document(one, NUMBERS),
        DESIGN[0].key(): settings.figures.reference_temperature_c,
        DESIGN[1].key(): settings.nominal_scale_factor,
        "scale_factor": _model_document(one.scale, "ppm", one.scale_u_constant),
        "bias": _model_document(one.bias, "dph", one.bias_u_constant),
        "compensation": document(compensation_of(one, settings), COMPENSATION),
    }


def _model_document(modelled: Modelled | None, unit: str, constant_u: float) -> dict[str, Any] | None:
    if modelled is None:
        return None
    model, points = modelled.model, modelled.points
    return {
        **document(modelled, _model_quantities(unit, constant_u)),
        "with_rate": model.with_rate,
        "rate_known": model.rate_known,
        "slow_noise": model.slow_kind,
        "candidates": model.candidates,
        "points": {
            **document(modelled, POINTS),
            f"value_{unit}": points.value,
            f"residual_{unit}": model.residual,
        },
    }


def _lines(one: AxisTemperature, *, several: bool) -> tuple[str, ...]:
    begin, said = f"Axis {one.axis}: " if several else "", []
    if one.scale is not None and one.scale.model.order:
        slope, u = one.scale.model.coefficients[1], one.scale.model.coefficients_u[1]
        said.append(f"{begin}K {with_uncertainty(float(slope), float(u))} ppm/K at the reference temperature.")
    if one.bias is not None:
        model = one.bias.model
        if model.with_rate:
            known = with_uncertainty(model.rate_coefficient, model.rate_coefficient_u)
            said.append(f"{begin}bias {known} deg/h per kelvin a minute.")
        said.append(f"{begin}{one.bias.residual_rms:.2g} deg/h of the bias is left by the model.")
    return tuple(said)


def table_of_models(one: AxisTemperature) -> TextTable:
    """Return the coefficients of both models."""
    rows = []
    for name, unit, modelled in (("K less design", "ppm", one.scale), ("bias", "deg/h", one.bias)):
        if modelled is None:
            continue
        model = modelled.model
        for power, (value, u) in enumerate(zip(model.coefficients, model.coefficients_u, strict=True)):
            per = "" if not power else "/K" if power == 1 else f"/K^{power}"
            rows.append((name, f"(T - T0)^{power}", with_uncertainty(float(value), float(u)), f"{unit}{per}"))
        if model.with_rate:
            known = with_uncertainty(model.rate_coefficient, model.rate_coefficient_u)
            rows.append((name, "dT/dt", known, f"{unit} per K/min"))
    return TextTable((f"axis {one.axis}", "term", "coefficient", "unit"), tuple(rows))


def _sentences(one: AxisTemperature) -> list[str]:
    said, u = "", math.nan
    for name, modelled, unit in (("Scale factor", one.scale, "ppm"), ("Bias", one.bias, "deg/h")):
        up_less_down, u = _hysteresis(modelled)
        if math.isfinite(u):
            said += (
                f"{name} of axis {one.axis} going up less going down: {with_uncertainty(up_less_down, u, unit)}. "
            )
    said += "Ramps of one speed cannot tell hysteresis, a drift and an effect of dT/dt apart: vary it."
    chosen = [
        _choice_in_words(f"{name} of axis {one.axis}", modelled)
        for name, modelled in (("scale factor", one.scale), ("bias", one.bias))
        if modelled is not None
    ]
    return [*chosen, said] if math.isfinite(u) else chosen


def _choice_in_words(name: str, modelled: Modelled) -> str:
    model = modelled.model
    first, others = model.candidates[0], model.candidates[1:]
    rate = " and dT/dt" if first.with_rate else ""
    said = f"{name[0].upper()}{name[1:]}: a polynomial of order {first.order}{rate} has the least AICc of "
    said += f"{len(model.candidates)} models, weight {first.weight:.2g}"
    if others:
        other = others[0]
        rate = " and dT/dt" if other.with_rate else ""
        said += f"; the next is order {other.order}{rate}, {other.aicc:.2g} above it"
    slow = (
        f"slow noise of {model.slow:.2g} {model.slow_kind}"
        if model.slow > 0.1 * model.noise_u
        else "hardly any slow noise"
    )
    return (
        f"{said}. Counted are {slow} beside {model.noise_u:.2g} of a point, and that another model may be right."
    )


def _to_watch(found: TemperatureEvaluation, settings: FogSettings) -> list[str]:
    said, own = [f"{one.sentence}." for one in found.left_out], _own(settings)
    for one in found.axes:
        if one.bias is not None and not one.bias.model.rate_known:
            said.append(
                f"{one.axis}: what comes from dT/dt cannot be told from what comes from the temperature: let the "
                "temperature go up and down again. The bias holds for this ramp only."
            )
        if one.rate_noise > _NOISY_RATE:
            said.append(
                f"{one.axis}: {100 * one.rate_noise:.2g} % of the scatter of dT/dt is noise of the thermometer: "
                "its coefficient comes out too small by about that. Use a longer temperature.window_s."
            )
        for what, modelled in (("bias", one.bias), ("scale factor", one.scale)):
            if modelled is not None and modelled.model.lag_gain > _CLEAR_LAG:
                lag = modelled.model.lag_s
                when = f"about {abs(lag):.0f} s {'later' if lag > 0 else 'before'}"
                said.append(
                    f"{one.axis}: the {what} follows what the thermometer says {when}: it is "
                    f"{'late' if lag > 0 else 'ahead of the gyro'}, and the model and its order are wrong. State "
                    f"temperature.thermometer_lag_s ({own.thermometer_lag_s + lag:.0f}), or change more slowly."
                )
        if one.scale is None:
            said.append(
                f"{one.axis}: no scale factor was measured; the bias rests on the one by design, "
                f"{settings.nominal_scale_factor:.6g} {COUNTS_PER_DPS}."
            )
        said += one.remarks
    return said


# --------------------
# Scale factor and bias over the temperature in the report: points, model, what it leaves, compensation table


def sections(found: TemperatureEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    made = [Section("Which models, and why", sentences=result.sentences)]
    for one in found.axes:
        figures = []
        if one.bias is not None:
            caption = "Bias less its part from dT/dt; line and band: model and its 95 %."
            figures.append(PlacedFigure(_model_svg(one.bias, f"bias-{one.axis}", "bias, deg/h"), caption))
        if one.scale is not None:
            caption = "Scale factor; line and band: model and its 95 %."
            label = "K less design, ppm"
            figures.append(PlacedFigure(_model_svg(one.scale, f"scale-{one.axis}", label), caption))
        made.append(Section(f"Axis {one.axis}", figures=tuple(figures), table=table_of_models(one)))
        if one.bias is not None:
            caption = "What the model of the bias leaves, and the temperature, in time."
            figure = PlacedFigure(_residual_svg(one.bias, one.axis), caption)
            made.append(Section(f"Residuals of the bias, axis {one.axis}", figures=(figure,)))
        text = "Of measured temperatures only. `gyrolock fog constants` writes it as CSV and C header."
        table = compensation_of(one, settings)
        columns = (table.temperature, table.scale_factor, table.scale_factor_u, table.bias, table.bias_u)
        rows = tuple(
            (f"{warm:g}", with_uncertainty(float(k), float(k_u)), with_uncertainty(float(bias), float(bias_u)))
            for warm, k, k_u, bias, bias_u in zip(*columns, strict=True)
        )
        made.append(
            Section(
                f"Compensation table, axis {one.axis}",
                text,
                table=TextTable(("°C", f"K, {COUNTS_PER_DPS}", "bias, deg/h"), rows),
            )
        )
    return made


def _model_svg(modelled: Modelled, name: str, label: str) -> str:
    """Draw points and model against the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        points, model = modelled.points, modelled.model
        warm = np.linspace(model.lowest, model.highest, 200)
        value, u = model.at(warm)
        by_rate = model.rate_coefficient * points.rate if model.with_rate else np.zeros(points.rate.size)
        for rising, colour, mark, text in ((True, SECOND, "^", "warming"), (False, ACCENT, "v", "cooling")):
            chosen = (points.rate >= 0) == rising
            if chosen.any():
                axes.errorbar(
                    points.temperature[chosen], (points.value - by_rate)[chosen], points.value_u[chosen], fmt=mark,
                    ms=2.8, color=colour, linewidth=0.4, alpha=0.7, label=text,
                )  # fmt: skip
        axes.fill_between(warm, value - NORMAL_95 * u, value + NORMAL_95 * u, color=SOFT, alpha=0.35, linewidth=0)
        axes.plot(warm, value, color=INK, linewidth=1.2, label=f"order {model.order}")
        axes.set(xlabel="temperature, °C", ylabel=label)
        legend_above(axes, columns=3)

    return svg_element(name, HALF, draw)


def _residual_svg(modelled: Modelled, axis: str) -> str:
    """Draw what the model leaves in time, with the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        hours = modelled.points.at_s / 3600
        axes.errorbar(
            hours, modelled.model.residual, modelled.points.value_u, fmt="o", ms=2.8, color=INK, linewidth=0.4
        )
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="time, h", ylabel="left of the bias, deg/h")
        beside = axes.twinx()
        beside.plot(hours, modelled.points.temperature, color=SECOND, linewidth=1.0)
        beside.grid(visible=False)
        beside.set_ylabel("temperature, °C", color=SECOND)

    return svg_element(f"bias-residuals-{axis}", WIDE, draw)


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: rest, a turn in both senses, rest, ..., while the chamber goes up, stays, comes down."""
    chosen, planned, begin = _own(settings), [], 0.0
    cold, hot = chosen.coldest_c, chosen.hottest_c
    rates = (chosen.rate_dps, -chosen.rate_dps) if chosen.rate_dps else ()
    turns = [(f"{rate:+.10g} deg/s", rate, turn_time(rate) + MARGIN_S) for rate in rates]
    legs = [("up", cold, hot), ("hot", hot, hot), ("down", hot, cold), ("cold", cold, cold)] * chosen.cycles
    for place, (leg, start, end) in enumerate(legs):
        name = leg if place < 4 else f"cycle {place // 4 + 1} {leg}"
        ramp = chosen.ramp_c_per_min * np.sign(end - start)
        by_hand = f"Let the chamber go from {start:g} to {end:g} deg C, {chosen.ramp_c_per_min:g} K a minute."
        by_hand = by_hand if ramp else f"Hold the chamber at {start:g} deg C."
        lasts = 60 * (end - start) / ramp if ramp else chosen.hold_s
        ends, number = begin + lasts, 0
        while begin < ends:
            number += 1
            for what, rate, seconds in [("rest", 0.0, chosen.rest_s), *turns]:
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


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by axis, rate of the table and, where the list says it, temperature."""
    return [_named(row, settings) for row in rows]


def _named(row: LogRow, settings: FogSettings) -> NamedSegment:
    axis, rate, warm = (row.get("axis", _own(settings).axis), row.get("rate_dps", 0.0), row.get("temperature_c"))
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
    quantities=QUANTITIES,
    plan=plan,
    section=TemperatureSettings,
)
