"""What runs over the whole range say: the figures of merit, from cold starts and at other temperatures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    Repeatability,
    ResidualPattern,
    ScaleFigures,
    StaticLevel,
    TurnOn,
    WindowMean,
    few_values_factor,
    horizontal_earth_rate_dps,
    pooled_noise,
    repeatability,
    repeatability_ppm,
    residual_pattern,
    scale_figures,
    static_level,
    temperature_coefficient_ppm,
    turn_on_transient,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import angle_clock_u, reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import check_table_rate, checked, remarks_on, window_at_rest, window_of_any_length
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "figures"
_MANY_TURNS = 100_000
_TURN_ON_BLOCKS = 180


@dataclass(frozen=True)
class MeritRun:
    """One run over the range, of one axis."""

    name: str  # ``"run 1"`` or ``"run at +60 deg C"``, with the axis in front where there are several
    temperature_c: float  # as the gyro or the log gives it, else as planned; nan if nobody knows
    rate_dps: NDArray[np.float64]  # (n,): Along the axis: with its end down the rate of the table changes its sign
    output: NDArray[np.float64]  # (n,): Net output: less the static output
    output_u: NDArray[np.float64]
    static_drift: float  # last static output less the first, counts; nan if one is missing
    static_drift_u: float
    figures: ScaleFigures
    pattern: ResidualPattern
    drift_removed: bool  # whether the static output was interpolated in time
    bias_dph: float  # static output less the vertical earth rate; the uncertainty by its noise
    bias_u_dph: float
    turn_on: TurnOn | None  # transient after switching on, deg/h; ``None`` without a usable record of it
    remarks: tuple[str, ...]  # what was missing or left out within the windows


@dataclass(frozen=True)
class AxisMerit:
    """Figures of merit of one axis."""

    axis: str
    runs: tuple[MeritRun, ...]  # from cold starts at the reference temperature
    at_temperatures: tuple[MeritRun, ...]
    scale_factor: float  # mean of the runs, and its standard uncertainty; counts per deg/s
    scale_factor_u: float
    nonlinearity_ppm: float  # the largest of the runs; nan where no run gives one
    nonlinearity_of_point_ppm: float
    asymmetry_ppm: float
    repeatability_ppm: float  # nan where there are too few runs
    temperature_coefficient_ppm: float
    bias: Repeatability | None  # of the bias from one switching on to the next, deg/h; ``None`` with one run

    @property
    def bias_repeatability_dph(self) -> float:
        """Standard deviation of the bias over the runs from cold starts."""
        return math.nan if self.bias is None else self.bias.value

    @property
    def slowest(self) -> TurnOn | None:
        """Transient with the longest warm-up."""
        return max((one.turn_on for one in self.runs if one.turn_on), key=lambda one: one.warm_up_s, default=None)

    @property
    def turn_on_transient_dph(self) -> float:
        """Largest bias just after switching on less the final one, with its sign."""
        every = [one.turn_on.transient for one in self.runs if one.turn_on]
        return max(every, key=abs, default=math.nan)

    @property
    def warm_up_s(self) -> float:
        """Longest time until the bias stays within the bound of its final value."""
        return math.nan if self.slowest is None else self.slowest.warm_up_s

    @property
    def all_runs(self) -> tuple[MeritRun, ...]:
        """Those from cold starts first."""
        return (*self.runs, *self.at_temperatures)


@dataclass(frozen=True)
class MeritFound:
    """Figures of merit of each axis."""

    axes: tuple[AxisMerit, ...]
    left_out: tuple[LeftOut, ...]

    def largest(self, name: str) -> float:
        """Return a figure of the one axis, or the largest of several; nan where none gives one."""
        return _largest([getattr(one, name) for one in self.axes])


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> MeritFound:
    """Evaluate the segments of a run."""
    left_out: list[LeftOut] = []
    by_axis: dict[str, dict[str, list[Segment]]] = {}
    for segment in segments_of(run, PURPOSE):
        axis = str(segment.conditions.get("axis", settings.figures.axis))
        by_axis.setdefault(axis, {}).setdefault(segment.conditions.get("run", "run 1"), []).append(segment)
    found = [
        _one_axis(axis, runs, settings, left_out, f"{axis} " if len(by_axis) > 1 else "")
        for axis, runs in by_axis.items()
    ]
    axes = tuple(one for one in found if one is not None)
    if not axes:
        raise NoUsableSignal(f"no run has enough points for a scale factor{reasons_of(left_out)}")
    return MeritFound(axes, tuple(left_out))


def _one_axis(
    axis: str, by_run: Mapping[str, list[Segment]], settings: FogSettings, left_out: list[LeftOut], before: str
) -> AxisMerit | None:
    """Evaluate the runs of one axis; what cannot be used is added to `left_out`."""
    found = {name: _one_run(f"{before}{name}", of_run, settings, left_out) for name, of_run in by_run.items()}
    good = {name: one for name, one in found.items() if one is not None}
    reference = {name for name, of_run in by_run.items() if of_run[0].conditions.get("reference", True)}
    runs = tuple(one for name, one in good.items() if name in reference)
    others = tuple(one for name, one in good.items() if name not in reference)
    if not runs:
        left_out += [LeftOut(one.name, "there is no run at the reference temperature beside it") for one in others]
        return None
    k = np.array([one.figures.fit.slope for one in runs])
    each = [one.figures for one in runs]
    clock_u = angle_clock_u([segment for of_run in by_run.values() for segment in of_run])
    return AxisMerit(
        axis=axis,
        runs=runs,
        at_temperatures=others,
        scale_factor=float(k.mean()),
        scale_factor_u=math.hypot(_scale_u(k, each[0]), clock_u * float(k.mean())),
        nonlinearity_ppm=_largest([one.nonlinearity_ppm for one in each]),
        nonlinearity_of_point_ppm=_largest([one.nonlinearity_of_point_ppm for one in each]),
        asymmetry_ppm=_largest([one.asymmetry_ppm for one in each]),
        repeatability_ppm=repeatability_ppm(k) if k.size > 1 else math.nan,
        temperature_coefficient_ppm=_temperature_coefficient(runs, others),
        bias=_bias_repeatability(runs, settings),
    )


def _bias_repeatability(runs: Sequence[MeritRun], settings: FogSettings) -> Repeatability | None:
    if len(runs) < 2:
        return None
    # the table need not come to rest towards the same side: a tilted axis sees another part of the earth rate
    horizontal = 3600 * horizontal_earth_rate_dps(settings.site.latitude_deg)
    turned = 1e-3 * settings.figures.misalignment_mrad * horizontal * math.sqrt(0.5)
    return repeatability([one.bias_dph for one in runs], [one.bias_u_dph for one in runs], turned)


def _scale_u(k: NDArray[np.float64], alone: ScaleFigures) -> float:
    """Standard uncertainty of the mean scale factor, for few runs or points as wide as Student's t asks for."""
    if k.size > 1:
        return few_values_factor(k.size - 1) * float(np.std(k, ddof=1) / math.sqrt(k.size))
    return few_values_factor(alone.fit.degrees_of_freedom) * alone.fit.slope_u


def _largest(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return max(known, default=math.nan)


def _temperature_coefficient(runs: Sequence[MeritRun], others: Sequence[MeritRun]) -> float:
    known = [one for one in others if math.isfinite(one.temperature_c)]
    middle = float(np.mean([one.temperature_c for one in runs]))
    if not known or not math.isfinite(middle):
        return math.nan
    reference = (float(np.mean([one.figures.fit.slope for one in runs])), middle)
    slopes, temperatures = [one.figures.fit.slope for one in known], [one.temperature_c for one in known]
    try:
        return temperature_coefficient_ppm(slopes, temperatures, reference=reference)
    except ValueError:
        return math.nan


def _one_run(
    name: str, segments: Sequence[Segment], settings: FogSettings, left_out: list[LeftOut]
) -> MeritRun | None:
    """Evaluate one run; segments that cannot be used are added to `left_out`."""
    points, remarks, clock = [], [], 0.0
    switched_on = [one for one in segments if "since_on_s" in one.conditions]
    segments = [one for one in segments if "since_on_s" not in one.conditions]
    for segment in segments:
        length = segment.recording.duration_s
        clock += length
        try:
            mean = _mean(segment, settings)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        remarks += remarks_on(segment, mean)
        points.append(_Point(segment.key, segment.conditions, mean, clock - length / 2))
    turned, static = [p for p in points if p.rate_dps], [p for p in points if not p.rate_dps]
    turned = _with_a_static_output(turned, static, left_out)
    if len({one.rate_dps for one in turned}) < 3 or not static:
        left_out.append(
            LeftOut(name, f"it has {len(turned)} rates and {len(static)} static outputs, 3 and 1 are needed")
        )
        return None
    level, drifts, ends = np.empty(len(turned)), [], list(dict.fromkeys(one.end_up for one in turned))
    for end_up in ends:
        of_end = [place for place, one in enumerate(turned) if one.end_up == end_up]
        at_rest = [one for one in static if one.end_up == end_up]
        found = static_level(
            [turned[place].at_s for place in of_end],
            [one.at_s for one in at_rest],
            [one.mean.mean for one in at_rest],
            [one.mean.mean_u for one in at_rest],
        )
        level[of_end] = found.level
        drifts.append(found)
    rate = np.array([one.rate_dps for one in turned], dtype=np.float64)
    output = np.array([one.mean.mean for one in turned]) - level
    u = np.maximum(pooled_noise([one.mean for one in turned]), 1e-12 * np.abs(output).max())
    largest = max(drifts, key=lambda one: abs(one.drift) if math.isfinite(one.drift) else math.inf)
    both = len(static) > 1
    figures = scale_figures(rate, output, u)
    bias = [_bias(found, end_up, figures.fit.slope, settings) for end_up, found in zip(ends, drifts, strict=True)]
    bias_u = math.sqrt(sum(one**2 for _, one in bias)) / len(bias)
    return MeritRun(
        name, _temperature(segments), rate, output, u,
        largest.drift if both else math.nan, largest.drift_u if both else math.nan,
        figures, residual_pattern(rate, output, u), any(one.modelled for one in drifts),
        sum(one for one, _ in bias) / len(bias), bias_u,
        _turn_on(switched_on, figures.fit.slope, settings, left_out), tuple(remarks),
    )  # fmt: skip


def _bias(found: StaticLevel, end_up: int, scale: float, settings: FogSettings) -> tuple[float, float]:
    """Bias by the static output of one end of the axis, deg/h, and its noise."""
    earth = end_up * vertical_earth_rate_dph(settings.site.latitude_deg)
    return 3600 * found.mean / scale - earth, 3600 * found.mean_u / abs(scale)


def _turn_on(
    segments: Sequence[Segment], scale: float, settings: FogSettings, left_out: list[LeftOut]
) -> TurnOn | None:
    """Fit the transient of the first output from switching on that can be used, by the K of its run."""
    for segment in segments:
        try:
            recording = checked(segment)
            blocks = int(min(_TURN_ON_BLOCKS, recording.counts.size // 10))
            edges = np.linspace(0, recording.times[-1] + recording.interval_s, max(blocks, 1) + 1)
            place = np.digitize(recording.times + recording.interval_s / 2, edges[1:-1])
            count = np.bincount(place, minlength=blocks)
            with np.errstate(invalid="ignore"):
                means = np.bincount(place, recording.counts, minlength=blocks) / count
            values = 3600 * means / scale
            since = float(segment.conditions["since_on_s"])
            return turn_on_transient(
                since + (edges[:-1] + edges[1:]) / 2, values, settings.figures.warm_up_bound_dph
            )
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
    return None


@dataclass(frozen=True)
class _Point:
    """Mean of one segment; `at_s` in the middle of it, in seconds of output since the begin of the run."""

    key: str
    conditions: Mapping[str, Any]
    mean: WindowMean
    at_s: float

    @property
    def end_up(self) -> int:
        return int(self.conditions.get("end_up", 1))

    @property
    def rate_dps(self) -> float:
        """Along the axis."""
        rate = self.conditions["rate_dps"]
        return self.end_up * float(self.conditions.get("table_rate_dps", rate) if rate else 0.0)


def _with_a_static_output(
    turned: Sequence[_Point], static: Sequence[_Point], left_out: list[LeftOut]
) -> list[_Point]:
    """Those whose end of the axis was also up at rest: the vertical earth rate changes its sign with the end."""
    ends = {one.end_up for one in static}
    kept = []
    for one in turned:
        if one.end_up in ends or not ends:
            kept.append(one)
        else:
            side = "up" if one.end_up > 0 else "down"
            left_out.append(
                LeftOut(one.key, f"there is no static output with this end of the axis {side}: take one")
            )
    return kept


def _mean(segment: Segment, settings: FogSettings) -> WindowMean:
    if segment.conditions["rate_dps"] == 0:
        return window_at_rest(segment, resolution=settings.gyro.output_resolution)
    check_table_rate(segment.conditions, settings.table.rate_tolerance_ppm)
    return window_of_any_length(segment, settings, turns=_MANY_TURNS)


def _temperature(segments: Sequence[Segment]) -> float:
    """Mean temperature that the gyro gave, or the one that was planned."""
    measured = [s.recording.temperature for s in segments if s.recording.temperature is not None]
    values = np.concatenate(measured) if measured else np.empty(0)
    values = values[np.isfinite(values)]
    if values.size:
        return float(values.mean())
    planned: Any = segments[0].conditions.get("temperature_c")
    return math.nan if planned is None else float(planned)
