"""The figures of merit over the whole range, from cold starts and at other temperatures: plan to report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    Repeatability,
    ResidualPattern,
    ScaleFigures,
    TurnOn,
    WindowMean,
    few_values_factor,
    horizontal_earth_rate_dps,
    pooled_noise,
    repeatability,
    residual_pattern,
    scale_figures,
    static_level,
    temperature_coefficient_ppm,
    turn_on_transient,
    turn_time,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import COLOURS, COUNTS_PER_DPS, PPM, angle_clock_u, reasons_of
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
    window_at_rest,
    window_of_any_length,
    words_of,
)
from station.fibre_gyro.settings import FogSettings
from station.report.figure import HALF, SOFT, WIDE, legend_above, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, repeated
from station.results.result import Excluded, PlacedFigure, Result, Section, TextTable, ppm, with_uncertainty
from station.runs.store import SavedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# What runs over the whole range say: the figures of merit, from cold starts and at other temperatures


PURPOSE = "figures"
_MANY_TURNS = 100_000
_TURN_ON_BLOCKS = 180
_STILL, _JUMP = 20, 15.0  # words that stand still, usual changes from word to word: the output is none yet


@dataclass(frozen=True)
class MeritRun:
    """One run over the range, of one axis."""

    name: str  # ``"run 1"`` or ``"run at +60 deg C"``, with the axis in front where there are several
    temperature_c: float  # as the gyro or the log gives it, else as planned; nan if nobody knows
    rate_dps: NDArray[np.float64]  # (n,): Along the axis: with its end down the rate of the table changes its sign
    output: NDArray[np.float64]  # (n,): Net output: less the static output
    output_u: NDArray[np.float64]
    static_drift: float  # last static output less the first, counts; nan if one is missing
    figures: ScaleFigures
    pattern: ResidualPattern
    drift_removed: bool  # whether the static output was interpolated in time
    bias_dph: float  # static output less the vertical earth rate; the uncertainty by its noise
    bias_u_dph: float
    turn_on: TurnOn | None  # transient after switching on, deg/h; ``None`` without a usable record of it
    scale_turn_on: TurnOn | None  # the same of K, ppm, where the table turned in both senses
    valid_s: float  # after switching on, when the output begins to be one; nan as above
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
    scatter: Repeatability | None  # of K from one switching on to the next, ppm; ``None`` with one run
    temperature_coefficient_ppm: float  # nan without a run at another temperature
    temperature_coefficient_u_ppm: float
    bias: Repeatability | None  # of the bias from one switching on to the next, deg/h; ``None`` with one run

    @property
    def repeatability_ppm(self) -> float:
        """Standard deviation of K over the runs from cold starts."""
        return math.nan if self.scatter is None else self.scatter.value

    @property
    def bias_repeatability_dph(self) -> float:
        """Standard deviation of the bias over the runs from cold starts."""
        return math.nan if self.bias is None else self.bias.value

    @property
    def slowest(self) -> TurnOn | None:
        """Transient with the longest warm-up."""
        return max((one.turn_on for one in self.runs if one.turn_on), key=lambda one: one.warm_up_s, default=None)

    @property
    def slowest_scale(self) -> TurnOn | None:
        """Transient of K with the longest warm-up."""
        each = [one.scale_turn_on for one in self.runs if one.scale_turn_on]
        return max(each, key=lambda one: one.warm_up_s, default=None)

    @property
    def output_valid_s(self) -> float:
        """Longest time until the output begins to be one."""
        return _largest([one.valid_s for one in self.runs])

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
class FiguresEvaluation:
    """Figures of merit of each axis."""

    axes: tuple[AxisMerit, ...]
    left_out: tuple[Excluded, ...]

    def largest(self, name: str) -> float:
        """Return a figure of the one axis, or the largest of several; nan where none gives one."""
        return _largest([getattr(one, name) for one in self.axes])


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> FiguresEvaluation:
    """Evaluate the segments of a run."""
    left_out: list[Excluded] = []
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
    return FiguresEvaluation(axes, tuple(left_out))


def _one_axis(
    axis: str, by_run: Mapping[str, list[Segment]], settings: FogSettings, left_out: list[Excluded], before: str
) -> AxisMerit | None:
    """Evaluate the runs of one axis; what cannot be used is added to `left_out`."""
    found = {name: _one_run(f"{before}{name}", of_run, settings, left_out) for name, of_run in by_run.items()}
    good = {name: one for name, one in found.items() if one is not None}
    reference = {name for name, of_run in by_run.items() if of_run[0].conditions.get("reference", True)}
    runs = tuple(one for name, one in good.items() if name in reference)
    others = tuple(one for name, one in good.items() if name not in reference)
    if not runs:
        left_out += [
            Excluded(one.name, "there is no run at the reference temperature beside it") for one in others
        ]
        return None
    k = np.array([one.figures.fit.slope for one in runs])
    each = [one.figures for one in runs]
    clock_u = angle_clock_u([segment for of_run in by_run.values() for segment in of_run])
    middle, noise = float(k.mean()), np.array([one.slope_noise_u for one in each])
    scatter = repeatability(PPM * k / middle, PPM * noise / middle) if k.size > 1 else None
    coefficient, coefficient_u = _temperature_coefficient(runs, others, scatter)
    # of few runs or points as wide as Student's t asks for
    scale_u = few_values_factor(each[0].fit.degrees_of_freedom) * each[0].fit.slope_u
    if k.size > 1:
        scale_u = few_values_factor(k.size - 1) * float(np.std(k, ddof=1) / math.sqrt(k.size))
    return AxisMerit(
        axis=axis,
        runs=runs,
        at_temperatures=others,
        scale_factor=middle,
        scale_factor_u=math.hypot(scale_u, clock_u * middle),
        nonlinearity_ppm=_largest([one.nonlinearity_ppm for one in each]),
        nonlinearity_of_point_ppm=_largest([one.nonlinearity_of_point_ppm for one in each]),
        asymmetry_ppm=_largest([one.asymmetry_ppm for one in each]),
        scatter=scatter,
        temperature_coefficient_ppm=coefficient,
        temperature_coefficient_u_ppm=coefficient_u,
        bias=_bias_repeatability(runs, settings),
    )


def _bias_repeatability(runs: Sequence[MeritRun], settings: FogSettings) -> Repeatability | None:
    if len(runs) < 2:
        return None
    # the table need not come to rest towards the same side: a tilted axis sees another part of the earth rate
    horizontal = 3600 * horizontal_earth_rate_dps(settings.site.latitude_deg)
    turned = 1e-3 * settings.figures.misalignment_mrad * horizontal * math.sqrt(0.5)
    return repeatability([one.bias_dph for one in runs], [one.bias_u_dph for one in runs], turned)


def _largest(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return max(known, default=math.nan)


def _temperature_coefficient(
    runs: Sequence[MeritRun], others: Sequence[MeritRun], scatter: Repeatability | None
) -> tuple[float, float]:
    """The largest change of K per kelvin and its u, ppm: every start scatters as the runs do."""
    middle = float(np.mean([one.temperature_c for one in runs]))
    k, noise = np.mean([[one.figures.fit.slope, one.figures.slope_noise_u] for one in runs], axis=0).tolist()
    found = [(math.nan, math.nan)]
    for one in others:
        if (apart := abs(one.temperature_c - middle)) > 0:  # and known
            value = temperature_coefficient_ppm([one.figures.fit.slope], [middle + apart], reference=(k, middle))
            u = PPM * math.hypot(one.figures.slope_noise_u, noise / math.sqrt(len(runs))) / k
            spread = 0.0 if scatter is None else scatter.value * math.sqrt(1 + 1 / len(runs))
            found.append((value, math.hypot(u, spread) / apart))
    return max(found, key=lambda one: -1.0 if math.isnan(one[0]) else one[0])


def _one_run(
    name: str, segments: Sequence[Segment], settings: FogSettings, left_out: list[Excluded]
) -> MeritRun | None:
    """Evaluate one run; segments that cannot be used are added to `left_out`."""
    points, remarks, clock = [], [], 0.0
    switched_on = [one for one in segments if "since_on_s" in one.conditions]
    segments = [one for one in segments if "since_on_s" not in one.conditions]
    for segment in segments:
        length = segment.recording.duration_s
        clock += length
        with Excluded.by_error(segment.key, left_out):
            if segment.conditions["rate_dps"] == 0:
                mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
            else:
                check_table_rate(segment.conditions, settings.table.rate_tolerance_ppm)
                mean = window_of_any_length(segment, settings, turns=_MANY_TURNS)
            remarks += remarks_on(segment, mean)
            points.append(_Point(segment.key, segment.conditions, mean, clock - length / 2))
    turned, static = [p for p in points if p.rate_dps], [p for p in points if not p.rate_dps]
    turned = _with_a_static_output(turned, static, left_out)
    if len({one.rate_dps for one in turned}) < 3 or not static:
        left_out.append(
            Excluded(name, f"it has {len(turned)} rates and {len(static)} static outputs, 3 and 1 are needed")
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
    earth, scale = vertical_earth_rate_dph(settings.site.latitude_deg), figures.fit.slope
    bias = [
        (3600 * found.mean / scale - end_up * earth, 3600 * found.mean_u / abs(scale))
        for end_up, found in zip(ends, drifts, strict=True)
    ]
    bias_u = math.sqrt(sum(one**2 for _, one in bias)) / len(bias)
    return MeritRun(
        name, _temperature(segments), rate, output, u,
        largest.drift if both else math.nan,
        figures, residual_pattern(rate, output, u), any(one.modelled for one in drifts),
        sum(one for one, _ in bias) / len(bias), bias_u,
        *_turn_on(switched_on, figures.fit.slope, settings, left_out), tuple(remarks),
    )  # fmt: skip


def _turn_on(
    segments: Sequence[Segment], scale: float, settings: FogSettings, left_out: list[Excluded]
) -> tuple[TurnOn | None, TurnOn | None, float]:
    """Fit the transients of bias and K from switching on, by the K of their run; when the output is one."""
    bias: TurnOn | None = None
    of_scale: TurnOn | None = None
    valid, turning = list[float](), dict[float, tuple[Segment, float]]()
    for segment in segments:
        with Excluded.by_error(segment.key, left_out):
            words, since = words_of(checked(segment)), float(segment.conditions["since_on_s"])
            begin = since + _live_from(words) * segment.recording.interval_s
            valid.append(begin)
            if rate := float(segment.conditions.get("table_rate_dps", segment.conditions["rate_dps"])):
                turning[rate] = segment, begin
            elif bias is None:
                at, (means,) = _courses([(segment, begin)])
                bias = turn_on_transient(at, 3600 * means / scale, settings.figures.warm_up_bound_dph)
    for rate, (segment, begin) in turning.items():
        back = next((one for one in turning if one * rate < 0), 0.0)
        with Excluded.by_error(segment.key, left_out):
            if not back:
                raise ValueError("the warm-up of K needs the output from switching on in both senses")
            if of_scale is None:
                at, (forth_means, back_means) = _courses([(segment, begin), turning[back]])
                change = PPM * ((forth_means - back_means) / (rate - back) / scale - 1)
                of_scale = turn_on_transient(at, change, settings.figures.warm_up_bound_ppm)
    return bias, of_scale, max(valid, default=math.nan)


def _live_from(words: NDArray[np.float64]) -> int:
    """How many words at the begin are no output yet: they stand still, or jump as no noise does."""
    steps = np.nan_to_num(np.abs(np.diff(words)))
    usual = float(np.median(steps[steps.size // 2 :]))
    early = steps[: steps.size // 2]
    if not usual or early.size < _STILL:
        return 0
    stands = np.convolve(early == 0, np.ones(_STILL), "valid") == _STILL
    ends = [np.flatnonzero(early > _JUMP * usual) + 1, np.flatnonzero(stands) + _STILL]
    return int(max((one[-1] for one in ends if one.size), default=0))


def _courses(
    switched_on: Sequence[tuple[Segment, float]],
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Means of outputs from switching on over the same equal times, and the middles of these."""
    each = []
    for segment, _ in switched_on:
        words, step = words_of(segment.recording), segment.recording.interval_s
        each.append((words, float(segment.conditions["since_on_s"]) + step * (np.arange(words.size) + 0.5)))
    begin = max(at for _, at in switched_on)
    end = min(float(at[-1] + (at[-1] - at[-2]) / 2) for _, at in each)
    fewest = min(int(np.count_nonzero(at > begin)) for _, at in each)
    blocks = max(1, min(_TURN_ON_BLOCKS, fewest // 10))
    edges, means = np.linspace(begin, end, blocks + 1), []
    for words, at in each:
        inside = np.isfinite(words) & (at >= begin) & (at <= end)
        place = np.digitize(at[inside], edges[1:-1])
        with np.errstate(invalid="ignore"):
            means.append(np.bincount(place, words[inside], blocks) / np.bincount(place, minlength=blocks))
    return (edges[:-1] + edges[1:]) / 2, means


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
    turned: Sequence[_Point], static: Sequence[_Point], left_out: list[Excluded]
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
                Excluded(one.key, f"there is no static output with this end of the axis {side}: take one")
            )
    return kept


def _temperature(segments: Sequence[Segment]) -> float:
    """Mean temperature that the gyro gave, or the one that was planned."""
    measured = [s.recording.temperature for s in segments if s.recording.temperature is not None]
    values = np.concatenate(measured) if measured else np.empty(0)
    values = values[np.isfinite(values)]
    if values.size:
        return float(values.mean())
    planned: Any = segments[0].conditions.get("temperature_c")
    return math.nan if planned is None else float(planned)


# --------------------
# The figures of merit as numbers and sentences


def _figure(name: str, unit: str, u: str = "", **more: Any) -> Quantity:
    """A figure of merit of one axis; u: the field of a run, of the run that gives the largest."""
    key = f"{name}_{unit}"
    return Quantity(name, unit, key, (lambda one: _u_of_largest(one, key, u)) if u else False, limit=True, **more)


FIGURES = (
    _figure("nonlinearity", "ppm", "nonlinearity_u_ppm", doc="of full scale"),
    _figure("nonlinearity_of_point", "ppm", doc="of each output"),
    _figure("asymmetry", "ppm", "asymmetry_u_ppm", doc="between the senses"),
    _figure(
        "repeatability",
        "ppm",
        interval=("scatter.low_95", "scatter.high_95"),
        doc="of K from one cold start to the next",
    ),
    Quantity(
        "temperature_coefficient",
        "ppm",
        "temperature_coefficient_ppm",
        u="temperature_coefficient_u_ppm",
        limit=True,
        doc="largest change of K per kelvin",
    ),
    _figure("bias_repeatability", "dph", interval=("bias.low_95", "bias.high_95")),
    _figure("turn_on_transient", "dph", doc="bias just after switching on less the final one"),
    _figure("warm_up", "s", interval=("slowest.warm_up_low_95_s", "slowest.warm_up_high_95_s")),
    Quantity(
        "scale_factor_transient",
        "ppm",
        "slowest_scale.transient",
        u=True,
        interval=True,
        limit=True,
        optional=True,
        doc="K just after switching on less the final one",
    ),
    Quantity(
        "scale_factor_warm_up",
        "s",
        "slowest_scale.warm_up_s",
        limit=True,
        optional=True,
        interval=("slowest_scale.warm_up_low_95_s", "slowest_scale.warm_up_high_95_s"),
    ),
    Quantity(
        "output_valid",
        "s",
        "output_valid_s",
        limit=True,
        optional=True,
        doc="after switching on: from then on the words neither stand still nor jump",
    ),
)
SCALE = (
    Quantity("scale_factor", "counts_per_dps", u=True, headline=True, trend=True, doc="mean of the runs"),
    Quantity("input_per_count", "dph", lambda one: 3600 / one.scale_factor, doc="as IEEE texts give it"),
)
BOUNDS = (
    Quantity("bias_noise_u", "dph", "bias.noise_u", doc="noise within the repeatability of the bias"),
    Quantity("warm_up_bound", "dph", "slowest.bound", doc="within which the bias has to stay"),
)
RUN = (
    Quantity("temperature", "c", "temperature_c"),
    Quantity("scale_factor", "counts_per_dps", "figures.fit.slope", u=True),
    Quantity("intercept", "counts", "figures.fit.intercept", u=True),
    Quantity("static_drift", "counts"),
    Quantity("bias", "dph", "bias_dph", "bias_u_dph"),
    Quantity("scale_factor_positive", "counts_per_dps", "figures.scale_factor_positive"),
    Quantity("scale_factor_negative", "counts_per_dps", "figures.scale_factor_negative"),
    Quantity("nonlinearity", "ppm", "figures.nonlinearity_ppm", "figures.nonlinearity_u_ppm"),
    Quantity("nonlinearity_of_point", "ppm", "figures.nonlinearity_of_point_ppm"),
    Quantity("asymmetry", "ppm", "figures.asymmetry_ppm", "figures.asymmetry_u_ppm"),
    Quantity("deviation_of_full_scale", "ppm", "figures.deviation_of_full_scale_ppm"),
    Quantity("deviation_of_point", "ppm", "figures.deviation_of_point_ppm"),
    Quantity("odd", "ppm", "pattern.odd_ppm"),
    Quantity("even", "ppm", "pattern.even_ppm"),
    Quantity("near_zero", "ppm", "pattern.near_zero_ppm"),
    Quantity("rate", "dps", "rate_dps"),
    Quantity("net", "counts", "output", doc="output less the static output"),
)
TURN_ON = (
    Quantity("exponentials"),
    Quantity("time_constants", "s", "time_constants_s"),
    Quantity("transient", "dph", "transient", u=True, interval=True),
    Quantity("warm_up", "s", "warm_up_s", interval=("warm_up_low_95_s", "warm_up_high_95_s")),
)
QUANTITIES = (
    QuantityGroup((*FIGURES, *SCALE, *BOUNDS), "axes", "axis", alone=False),
    *(QuantityGroup(RUN, place, "name") for place in ("runs", "at_temperatures")),
    *(QuantityGroup(TURN_ON, f"{place}.turn_on") for place in ("runs", "at_temperatures")),
    QuantityGroup(repeated((*FIGURES, *SCALE, *BOUNDS))),  # of several axes the largest
)
_GJB_RATES = 11
_CAUSES = {
    "odd": "odd in the rate (cubic: resets, converter)",
    "even": "even in the rate (asymmetry)",
    "near zero": "near zero (dead zone)",
    "scatter": "irregular beyond their noise (bias, scale factor or table change between the rates)",
}


def result(found: FiguresEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    lines = tuple(line for one in found.axes for line in _lines(one, several=len(found.axes) > 1))
    by_run = (said for axis in found.axes for run in axis.all_runs for said in _to_watch_in(run))
    watched = (*(f"{one.sentence}." for one in found.left_out), *by_run)
    worst = max(found.axes, key=lambda one: np.nan_to_num(one.nonlinearity_ppm, nan=-1.0))
    return Result(
        name="result",
        value=f"Nonlinearity {_with_u(worst, 'nonlinearity')} of full scale",
        document=_document(found),
        quantities=QUANTITIES,
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(_sentences(found)),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def _lines(one: AxisMerit, *, several: bool) -> tuple[str, ...]:
    begin = f"Axis {one.axis}: nonlinearity {_with_u(one, 'nonlinearity')}, asymmetry" if several else "Asymmetry"
    runs, coefficient = f"{len(one.runs)} runs", f"{_ppm(one.temperature_coefficient_ppm)}/K"
    if one.scatter is not None:
        runs = f"95 %: {one.scatter.low_95:.3g} to {one.scatter.high_95:.3g}, {runs}"
    if math.isfinite(u := one.temperature_coefficient_u_ppm):
        coefficient = with_uncertainty(one.temperature_coefficient_ppm, u, "ppm/K")
    return (
        f"{begin} {_with_u(one, 'asymmetry')}, repeatability {_ppm(one.repeatability_ppm)} ({runs}), temperature "
        f"coefficient {coefficient}.",
        f"{f'K({one.axis})' if several else 'K'} = {with_uncertainty(one.scale_factor, one.scale_factor_u)} "
        f"{COUNTS_PER_DPS}.",
        *_bias_lines(one, several=several),
    )


def _bias_lines(one: AxisMerit, *, several: bool) -> list[str]:
    said, begin = [], f"Axis {one.axis}: bias" if several else "Bias"
    if one.bias is not None:
        said.append(
            f"{begin} from one switching on to the next: {one.bias.value:.2g} deg/h (95 %: {one.bias.low_95:.2g} "
            f"to {one.bias.high_95:.2g}, {one.bias.count} runs)."
        )
    if (slowest := one.slowest) is not None:
        high = f"{slowest.warm_up_high_95_s:.3g} s" if slowest.ends else "beyond the record"
        said.append(
            f"{begin} just after switching on {one.turn_on_transient_dph:+.2g} deg/h off its final value; within "
            f"{slowest.bound:g} deg/h of it after {slowest.warm_up_s:.3g} s (95 %: "
            f"{slowest.warm_up_low_95_s:.3g} s to {high})."
        )
    if (of_scale := one.slowest_scale) is not None:
        high = f"{of_scale.warm_up_high_95_s:.3g} s" if of_scale.ends else "beyond the record"
        said.append(
            f"{f'Axis {one.axis}: ' if several else ''}K just after switching on {of_scale.transient:+.3g} ppm "
            f"off its final value; within {of_scale.bound:g} ppm of it after {of_scale.warm_up_s:.3g} s (95 %: "
            f"{of_scale.warm_up_low_95_s:.3g} s to {high})."
        )
    return said


def _document(found: FiguresEvaluation) -> dict[str, Any]:
    """Of one axis as it is; of several the largest figures, no common scale factor, and each axis by itself."""
    axes = [{"axis": axis.axis, **document(axis, (*FIGURES, *SCALE, *BOUNDS))} for axis in found.axes]
    top = {name: value for name, value in axes[0].items() if name != "axis"}
    if len(axes) > 1:
        top = dict.fromkeys(document(found.axes[0], SCALE)) | {
            one.key(): _largest([axis[one.key()] for axis in axes if axis[one.key()] is not None])
            for one in FIGURES
        }
    return {
        "style": "GJB and IEEE style; nonlinearity is of full scale unless its name says of_point",
        **top,
        "runs": [_run(run) for one in found.axes for run in one.runs],
        "at_temperatures": [_run(run) for one in found.axes for run in one.at_temperatures],
        "axes": axes,
        "left_out": found.left_out,
    }


def _u_of_largest(axis: AxisMerit, name: str, u: str) -> float:
    """The largest of the runs is as uncertain as that run."""
    known = [run.figures for run in axis.runs if math.isfinite(getattr(run.figures, name))]
    return float(getattr(max(known, key=attrgetter(name)), u)) if known else math.nan


def _with_u(axis: AxisMerit, name: str) -> str:
    u = _u_of_largest(axis, f"{name}_ppm", f"{name}_u_ppm")
    return with_uncertainty(getattr(axis, f"{name}_ppm"), u, "ppm")


def _ppm(value: float) -> str:
    return f"{value:.3g} ppm" if math.isfinite(value) else "none"


def _run(one: MeritRun) -> dict[str, Any]:
    turn_on = None if one.turn_on is None else {**document(one.turn_on, TURN_ON), "ends": one.turn_on.ends}
    return {"name": one.name, **document(one, RUN), "pattern": one.pattern.names, "turn_on": turn_on}


def _sentences(found: FiguresEvaluation) -> list[str]:
    """Say which pattern the deviations have."""
    said = [
        f"{one.name}: the deviations are {', and '.join(_CAUSES[name] for name in one.pattern.names)}."
        for axis in found.axes
        for one in axis.all_runs
        if one.pattern.names
    ]
    return said or ["The deviations from the line show no pattern beyond their noise."]


def _to_watch_in(one: MeritRun) -> list[str]:
    said = []
    if not math.isfinite(one.static_drift):
        said.append(f"{one.name}: a static output before or after is missing, a drift of the bias is not seen.")
    elif one.drift_removed:
        said.append(
            f"{one.name}: the static output drifted by {one.static_drift:+.3g} counts; it was interpolated."
        )
    senses = [sum(1 for rate in set(one.rate_dps) if sense * rate > 0) for sense in (1, -1)]
    if min(senses) < _GJB_RATES:
        said.append(
            f"{one.name}: {senses[0]} rates in one sense and {senses[1]} in the other; GJB style asks for "
            f"{_GJB_RATES} in each."
        )
    said += [
        f"{one.name}: the record from switching on is too short to show that {what} stays within "
        f"{transient.bound:g} {unit}: record longer (figures.turn_on_s)."
        for what, transient, unit in (("the bias", one.turn_on, "deg/h"), ("K", one.scale_turn_on, "ppm"))
        if transient is not None and not transient.ends
    ]
    return [*said, *one.remarks]


# --------------------
# The figures of merit in the report: deviations from the line, and the scale factor of each run


def sections(found: FiguresEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    header = ("run", "°C", f"K, {COUNTS_PER_DPS}", "nonlin. FS", "nonlin. point", "asymmetry", "pattern")
    return [
        Section(
            "Deviations from the line",
            "Measured less fitted output. GJB style gives the nonlinearity of full scale, IEEE style names "
            "either.",
            figures=(
                PlacedFigure(_deviations_svg(found, of_point=False), "As ppm of the largest output."),
                PlacedFigure(_deviations_svg(found, of_point=True), "As ppm of the point's own output."),
            ),
            sentences=result.sentences,
        ),
        Section(
            "Scale factor of each run",
            "Repeatability is the standard deviation over the runs from cold starts; the temperature coefficient "
            "is the largest change of K per kelvin from their mean.",
            figures=(PlacedFigure(_scale_factors_svg(found), "Each run less the mean of the runs."),),
            table=TextTable(header, tuple(_row(one) for axis in found.axes for one in axis.all_runs)),
        ),
        *_bias_sections(found),
    ]


def _bias_sections(found: FiguresEvaluation) -> list[Section]:
    """Bias of each switching on, and the transients."""
    transients = [one for axis in found.axes for one in axis.runs if one.turn_on is not None]
    rows = []
    for one in (run for axis in found.axes for run in axis.runs):
        turn_on = one.turn_on
        ends = f"{turn_on.warm_up_high_95_s:.3g}" if turn_on and turn_on.ends else "beyond the record"
        rows.append(
            (
                one.name,
                with_uncertainty(one.bias_dph, one.bias_u_dph),
                with_uncertainty(turn_on.transient, turn_on.transient_u) if turn_on else "",
                f"{turn_on.warm_up_s:.3g} ({turn_on.warm_up_low_95_s:.3g} to {ends})" if turn_on else "",
            )
        )
    header = ("run", "bias, deg/h", "transient, deg/h", "warm-up, s (95 %)")
    text = "Static output less the vertical earth rate at the latitude of the settings."
    figures: tuple[PlacedFigure, ...] = ()
    if transients:
        bound = next(one.turn_on.bound for one in transients if one.turn_on)
        text += f" The warm-up is over when the bias stays within {bound:g} deg/h of its final value."
        caption = "Fitted bias from each switching on, less its final value; dashed: the bound."
        figures = (PlacedFigure(_transients_svg(transients, "turn_on", "bias less final, deg/h"), caption),)
    if of_scale := [one for axis in found.axes for one in axis.runs if one.scale_turn_on is not None]:
        caption = "The same of K, by both senses."
        figures += (PlacedFigure(_transients_svg(of_scale, "scale_turn_on", "K less final, ppm"), caption),)
    return [
        Section(
            "Bias from one switching on to the next", text, figures=figures, table=TextTable(header, tuple(rows))
        )
    ]


def _transients_svg(runs: Sequence[MeritRun], which: str, label: str) -> str:
    """Draw bias or K after switching on, less its final value: means over equal times, and fitted."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for index, one in enumerate(runs):
            if (turn_on := getattr(one, which)) is not None:
                colour = COLOURS[index % 7]
                axes.plot(turn_on.at_s, turn_on.values - turn_on.curve_end, ".", ms=3, color=colour, alpha=0.6)
                axes.plot(
                    turn_on.at_s, turn_on.curve - turn_on.curve_end, color=colour, linewidth=1.2, label=one.name
                )
                for sense in (1, -1):
                    axes.axhline(sense * turn_on.bound, color=SOFT, linewidth=0.7, linestyle=(0, (4, 3)))
        axes.set(xlabel="time since switching on, s", ylabel=label)
        legend_above(axes, columns=6)

    return svg_element("turn-on", WIDE, draw)


def _row(one: MeritRun) -> tuple[str, ...]:
    return (
        one.name,
        f"{one.temperature_c:.1f}" if math.isfinite(one.temperature_c) else "",
        with_uncertainty(one.figures.fit.slope, one.figures.fit.slope_u),
        f"{one.figures.nonlinearity_ppm:.3g} ppm",
        f"{one.figures.nonlinearity_of_point_ppm:.3g} ppm",
        ppm(one.figures.asymmetry_ppm, one.figures.asymmetry_u_ppm).lstrip("+"),
        ", ".join(one.pattern.names) or "none",
    )


def _deviations_svg(found: FiguresEvaluation, *, of_point: bool) -> str:
    """Draw the deviations from the line of every run, of full scale or of each point."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        runs = [(one, one in axis.at_temperatures) for axis in found.axes for one in axis.all_runs]
        for index, (one, hot) in enumerate(runs):
            order = np.argsort(one.rate_dps)
            values = one.figures.deviation_of_point_ppm if of_point else -one.figures.deviation_of_full_scale_ppm
            axes.plot(
                one.rate_dps[order], values[order], "s--" if hot else "o-", ms=3.5, linewidth=0.8,
                color=COLOURS[index % 7], label=one.name,
            )  # fmt: skip
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="rate, deg/s", ylabel="ppm of the point" if of_point else "ppm of full scale")
        if of_point:
            axes.set_xscale("symlog", linthresh=1.0)
        else:
            legend_above(axes, columns=4)

    return svg_element("of-point" if of_point else "of-full-scale", HALF, draw)


def _scale_factors_svg(found: FiguresEvaluation) -> str:
    """Draw the scale factor of every run against the temperature."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        everything = [one for axis in found.axes for one in axis.all_runs]
        known = bool(np.all(np.isfinite([one.temperature_c for one in everything])))
        for index, axis in enumerate(found.axes):
            of_axis = f"axis {axis.axis}, " if len(found.axes) > 1 else ""
            groups = (("from cold starts", axis.runs), ("at other temperatures", axis.at_temperatures))
            for place, (name, chosen) in enumerate(groups):
                slopes = np.array([one.figures.fit.slope for one in chosen], dtype=np.float64)
                u = PPM * np.array([one.figures.fit.slope_u for one in chosen]) / abs(axis.scale_factor)
                off = PPM * (slopes / axis.scale_factor - 1)
                if chosen:
                    colour, at = (
                        COLOURS[(2 * index + place) % 7],
                        np.array([one.temperature_c for one in chosen], np.float64),
                    )
                    at = at if np.all(np.isfinite(at)) else np.arange(1.0, at.size + 1)
                    how: dict[str, Any] = {"fmt": "o", "ms": 4, "capsize": 2, "color": colour, "linewidth": 0.9}
                    axes.errorbar(at, off, yerr=u, label=f"{of_axis}{name}", **how)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="temperature, °C" if known else "run", ylabel="K less mean, ppm")
        legend_above(axes, columns=2)

    return svg_element("scale-factors", WIDE, draw)


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
            for rate in (chosen.turn_on_rate_dps, -chosen.turn_on_rate_dps) if chosen.turn_on_rate_dps else ():
                asked = f"The table turns first: {rate:+g} deg/s."
                turning = {**common, "rate_dps": rate, "since_on_s": 0.0, "by_hand": asked}
                planned.append(
                    PlannedSegment(f"{name}, switched on, {rate:+g} deg/s", chosen.turn_on_s, 0.0, turning)
                )
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
    what = "static" if rate == 0 else f"{rate:+.10g} deg/s"
    if "since_on_s" in row:
        what = f"switched on{f', {what}' if rate else ''}"
    return f"{of_axis}{conditions['run']}, {what}{down}", conditions


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Figures of merit of the scale factor",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, ("rate_dps",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
)
