"""Threshold, resolution and dead zone by a ladder of small rates: plan, evaluation, result and report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from analysis.arrays import NORMAL_95
from analysis.fibre_gyro import (
    Edge,
    Ladder,
    References,
    Responses,
    SmallRates,
    WindowMean,
    horizontal_earth_rate_dps,
    plan_ladder,
    pooled_noise,
    refined,
    responses,
    slopes_beyond,
    small_rates,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.bench import open_fog_bench
from station.fibre_gyro.common import COUNTS_PER_DPS, not_taken, reasons_of, truth_of
from station.fibre_gyro.logs import LogRow, NamedSegment, gyro_measurement, listed_logs, table_conditions
from station.fibre_gyro.segments import (
    PlannedSegment,
    Segment,
    checked,
    remarks_on,
    segments_of,
    take_segments,
    window_at_rest,
)
from station.fibre_gyro.settings import FogSettings, Name, TestSettings
from station.report.figure import ACCENT, HALF, LINE, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, repeated, rows
from station.results.result import Excluded, PlacedFigure, Result, Section, TextTable, with_uncertainty
from station.runs.acquisition import Acquisition
from station.runs.store import SavedRun
from station.settings import NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# What the outputs at small rates say: threshold, dead zone and resolution of each axis


PURPOSE = "threshold"
NOISE, LADDER, RESOLUTION = "noise", "ladder", "resolution"
_SAME_INPUT = 1e-6  # deg/s
_NOT_THE_DESIGN = 0.2


class ThresholdSettings(TestSettings):
    """Threshold, resolution and dead zone."""

    axis: Name
    table_axis: Literal["vertical", "east"]
    lowest_dps: Positive
    highest_dps: Positive
    per_decade: Annotated[int, Field(ge=1, le=10)]
    refine: Annotated[int, Field(ge=0, le=20)]
    resolution_at_dps: NotNegative
    angle_random_walk: NotNegative
    ratio_u: Annotated[float, Field(gt=0, le=0.2)]
    shortest_s: Positive
    longest_s: Positive
    settle_s: NotNegative
    misalignment_mrad: NotNegative

    def wrong(self) -> str:
        """See that both ranges have their ends in order."""
        if self.highest_dps <= self.lowest_dps:
            return "highest_dps must be larger than threshold.lowest_dps"
        return (
            "longest_s must not be shorter than threshold.shortest_s" if self.longest_s < self.shortest_s else ""
        )


_own = ThresholdSettings.of


@dataclass(frozen=True)
class ThresholdSeries:
    """A ladder of inputs about one reference input."""

    keys: tuple[str, ...]  # one for each response
    reference_dps: float  # true input of the references, with the earth rate
    found: Responses
    says: SmallRates


@dataclass(frozen=True)
class AxisThreshold:
    """Small rates of one axis."""

    axis: str
    ladder: ThresholdSeries  # inputs about zero
    resolution: ThresholdSeries | None  # changes about another input
    scale_factor: float  # that responses are compared with, counts per deg/s
    by_design: bool  # whether that is the one by design: the largest inputs give none that could be right
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class ThresholdEvaluation:
    """Small rates of each axis."""

    axes: tuple[AxisThreshold, ...]
    left_out: tuple[Excluded, ...]


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


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> ThresholdEvaluation:
    """Evaluate the segments of a run."""
    left_out = not_taken(run)
    points = points_of(run, settings, left_out)
    found = []
    for axis in dict.fromkeys(axis_of(point, settings) for point in points):
        of_axis = [point for point in points if axis_of(point, settings) == axis]
        with Excluded.by_error(f"axis {axis}", left_out):
            found.append(_one_axis(axis, of_axis, settings, left_out))
    if not found:
        raise NoUsableSignal(f"there are no outputs at small rates to find a threshold from{reasons_of(left_out)}")
    return ThresholdEvaluation(tuple(found), tuple(left_out))


def axis_of(point: Point, settings: FogSettings) -> str:
    """Return the axis that a segment is of."""
    return str(point.segment.conditions.get("axis", _own(settings).axis))


def earth_rate_along_axis(settings: FogSettings) -> float:
    """Return the earth rate along the table's axis, deg/s."""
    if _own(settings).table_axis == "east":
        return 0.0
    return vertical_earth_rate_dph(settings.site.latitude_deg) / 3600


def points_of(run: SavedRun, settings: FogSettings, left_out: list[Excluded]) -> list[Point]:
    """Return the mean of every segment; those that cannot be used are added to `left_out`."""
    found, clock, earth = [], 0.0, earth_rate_along_axis(settings)
    for segment in segments_of(run, PURPOSE):
        length = segment.recording.duration_s
        clock += length
        conditions = segment.conditions
        table = float(conditions.get("table_rate_dps", conditions["rate_dps"]))
        total = round(int(conditions.get("end_up", 1)) * (table + earth), 12)
        with Excluded.by_error(segment.key, left_out):
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
            found.append(Point(segment, mean, clock - length / 2, total))
    return found


def _one_axis(
    axis: str, points: Sequence[Point], settings: FogSettings, left_out: list[Excluded]
) -> AxisThreshold:
    of_series = {
        name: [one for one in points if one.segment.conditions.get("series", LADDER) == name]
        for name in (LADDER, RESOLUTION)
    }
    scale, by_design = _scale_factor(of_series[LADDER], settings)
    ladder = series_of(of_series[LADDER], scale, settings, left_out)
    resolution = None
    changes = of_series[RESOLUTION] or (of_series[LADDER] if abs(ladder.reference_dps) > _SAME_INPUT else [])
    if changes:
        with Excluded.by_error(f"resolution of axis {axis}", left_out):
            resolution = series_of(changes, scale, settings, left_out, about_reference=True)
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
    left_out: list[Excluded],
    *,
    about_reference: bool = False,
) -> ThresholdSeries:
    """Return the responses of one ladder, and what they say."""
    references = [one for one in points if one.is_reference]
    if not references:
        raise ValueError("it has no output at rest: take one before and one after")
    base = references[0].input_dps
    for one in references:
        if abs(one.input_dps - base) > _SAME_INPUT + 1e-3 * abs(base):
            reason = f"its input is {one.input_dps:.6g} deg/s, that of the other references {base:.6g}"
            left_out.append(Excluded(one.segment.key, reason))
    references = [one for one in references if abs(one.input_dps - base) <= _SAME_INPUT + 1e-3 * abs(base)]
    zero = base if about_reference else 0.0
    inputs = [one for one in points if not one.is_reference and abs(one.input_dps - zero) > _SAME_INPUT]
    if not inputs:
        raise ValueError("it has outputs at rest only")
    u = np.maximum(pooled_noise([one.mean for one in (*references, *inputs)]), 1e-12)
    near_zero = abs(base) <= _own(settings).lowest_dps / 2
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
        unseen_dps=1e-3 * _own(settings).misalignment_mrad * horizontal_earth_rate_dps(settings.site.latitude_deg),
    )
    return ThresholdSeries(tuple(one.segment.key for one in inputs), base, found, small_rates(found))


# --------------------
# Threshold, resolution and dead zone as numbers and sentences


def _edge(name: str, edge: Callable[[Any], Edge | None], **more: Any) -> Quantity:
    """An edge: its value where it is seen, and its interval; an upper end that nobody knows is nan."""

    def value(one: AxisThreshold) -> float | None:
        found = edge(one)
        return found.value if found is not None and found.seen else None

    def interval(one: AxisThreshold) -> tuple[float, float] | None:
        if (found := edge(one)) is None:
            return None
        return found.low_95, found.high_95 if math.isfinite(found.high_95) else math.nan

    return Quantity(name, "dps", value, interval=interval, bound=True, **more)


NUMBERS = (
    _edge("threshold", lambda one: one.ladder.says.threshold, limit=True, headline=True),
    _edge(
        "resolution", lambda one: one.resolution.says.threshold if one.resolution else None, limit=True,
        doc="smallest change that is seen about another input",
    ),
    _edge("dead_zone", lambda one: one.ladder.says.width, limit=True, doc="from its lower to its upper edge"),
    _edge("dead_zone_above", lambda one: one.ladder.says.rising),
    _edge("dead_zone_below", lambda one: one.ladder.says.falling),
    Quantity("resolution_at", "dps", "resolution.reference_dps"),
    Quantity("reference", "dps", "ladder.reference_dps", doc="input at rest, with the earth rate"),
    Quantity("scale_factor", "counts_per_dps", doc="that responses are compared with"),
    Quantity("wander", "dph", lambda one: 3600 * one.ladder.found.wander / abs(one.scale_factor)),
)  # fmt: skip
POINTS = (
    Quantity("name", of="keys"),
    Quantity("input", "dps", "found.input_dps"),
    Quantity("ratio", of="found.ratio", u=True, doc="change of the output over the expected one"),
)
QUANTITIES = (
    QuantityGroup(NUMBERS, "axes", "axis", alone=False),
    QuantityGroup(repeated(NUMBERS)),
    *(QuantityGroup(POINTS, f"axes.{name}", "name") for name in ("points", "resolution_points")),
)
_SENSES = {1: "positive", -1: "negative"}


def result(found: ThresholdEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    axes = [
        {
            "axis": one.axis,
            **document(one, NUMBERS),
            "points": rows(one.ladder, POINTS),
            "resolution_points": rows(one.resolution, POINTS) if one.resolution else [],
        }
        for one in found.axes
    ]
    alone = len(axes) == 1
    lines = tuple(line for one in found.axes for line in _lines(one, several=not alone))
    by_axis = (said for one in found.axes for said in _to_watch_of(one, settings))
    watched = (*(f"{one.sentence}." for one in found.left_out), *by_axis)
    first = found.axes[0]
    return Result(
        name="result",
        value=f"Threshold {in_words(first.ladder.says.threshold)}",
        document={**(axes[0] if alone else {}), "axes": axes, "left_out": found.left_out},
        quantities=QUANTITIES,
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=_sentences(found, settings),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def in_words(edge: Edge) -> str:
    """Write an edge with its interval, or as a bound."""
    if edge.seen:
        return f"{edge.value:.3g} deg/s (95 %: {edge.low_95:.3g} to {edge.high_95:.3g})"
    if math.isinf(edge.high_95):
        return f"above {edge.low_95:.3g} deg/s" if edge.low_95 else "not known"
    return f"below {edge.high_95:.3g} deg/s"


def _lines(one: AxisThreshold, *, several: bool) -> tuple[str, ...]:
    begin = f"Axis {one.axis}: threshold {in_words(one.ladder.says.threshold)}; dead" if several else "Dead"
    lines = [f"{begin} zone {in_words(one.ladder.says.width)} wide."]
    if one.resolution:
        at = f"about {one.resolution.reference_dps:.3g} deg/s"
        lines.append(f"Resolution {in_words(one.resolution.says.threshold)}, {at}.")
    return tuple(lines)


def _sentences(found: ThresholdEvaluation, settings: FogSettings) -> tuple[str, ...]:
    said = [
        "r is the change of the output over the one that K times the change of the input would give. Threshold "
        "and resolution are the smallest inputs, of the worse sense, with r of one half or more; within the dead "
        "zone r is below a tenth (terms of IEEE Std 528). What lies between two rungs of the ladder is in the "
        "interval."
    ]
    if any(not one.ladder.says.threshold.seen for one in found.axes):
        said.append(
            "The smallest input passes already: the result is a bound. A ladder that begins lower "
            "(threshold.lowest_dps) makes it smaller, as far as the noise lets it."
        )
    if _own(settings).table_axis == "vertical":
        said.append("Inputs count the vertical earth rate, which the table turns against where they are small.")
    return tuple(said)


def _to_watch_of(one: AxisThreshold, settings: FogSettings) -> list[str]:
    said, ladder = [], one.ladder
    for sense in (1, -1):
        if sense not in ladder.says.senses:
            said.append(f"{one.axis}: there is no {_SENSES[sense]} input: the dead zone has one edge only.")
    if one.by_design:
        said.append(
            f"{one.axis}: the largest inputs give no scale factor near the one by design, "
            f"{settings.nominal_scale_factor:.6g} {COUNTS_PER_DPS}, which the outputs are compared with: is the "
            "coil in [gyro] that of this gyro, and is there an output at all?"
        )
    if abs(ladder.reference_dps) > _own(settings).lowest_dps / 2:
        said.append(
            f"{one.axis}: at rest the input is {ladder.reference_dps:.4g} deg/s, the earth rate along the axis, "
            "and the gyro is taken to be linear there. Where the table turns against it, or lies to the east, "
            "nothing need be taken."
        )
    for low, high, slope, u in slopes_beyond(ladder.found):
        said.append(
            f"{one.axis}: from {low:+.3g} to {high:+.3g} deg/s the output changes by {with_uncertainty(slope, u)} "
            "of what K gives: a dead zone that is not about zero, or another scale factor at small rates."
        )
    above, below = ladder.says.rising, ladder.says.falling
    if above.low_95 > below.high_95 or below.low_95 > above.high_95:
        said.append(
            f"{one.axis}: the dead zone is not centred on zero: up to {in_words(above)} in the positive sense, "
            f"{in_words(below)} in the negative one. A bias of the electronics moves it."
        )
    for name, edge in (("one half", ladder.says.threshold), ("a tenth", ladder.says.width)):
        if edge.undecided_dps:
            inputs = ", ".join(f"{rate:+.3g}" for rate in edge.undecided_dps)
            said.append(f"{one.axis}: the limit of {name} lies inside U95 of r at {inputs} deg/s.")
    return [*said, *one.remarks]


# --------------------
# Threshold, resolution and dead zone in the report: output over expected output against the input


def sections(found: ThresholdEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    made = [Section("What was found", sentences=result.sentences, table=_table(found))]
    for one in found.axes:
        caption = "Bars: 95 %. Grey: the 95 % interval of the threshold, or what a bound leaves open."
        made.append(
            Section(
                f"Axis {one.axis}: inputs about zero",
                figures=(PlacedFigure(_ratios_svg(one, one.ladder, "ladder"), caption),),
                table=_rungs_figure(one.ladder),
            )
        )
        if one.resolution is not None:
            title = f"Axis {one.axis}: changes about {one.resolution.reference_dps:.4g} deg/s"
            figure = PlacedFigure(_ratios_svg(one, one.resolution, "resolution"), "As above, for the resolution.")
            made.append(Section(title, figures=(figure,), table=_rungs_figure(one.resolution)))
    return made


def _table(found: ThresholdEvaluation) -> TextTable:
    rows = []
    for one in found.axes:
        says = one.ladder.says
        edges = [("threshold", says.threshold), ("dead zone, positive side", says.rising)]
        edges += [("dead zone, negative side", says.falling), ("dead zone, width", says.width)]
        if one.resolution is not None:
            edges.append(
                (f"resolution at {one.resolution.reference_dps:.3g} deg/s", one.resolution.says.threshold)
            )
        rows += [(one.axis, name, in_words(edge)) for name, edge in edges]
    return TextTable(("axis", "of", "found"), tuple(rows))


def _rungs_figure(series: ThresholdSeries) -> TextTable:
    found = series.found
    order = np.argsort(found.input_dps)
    rows = tuple(
        (f"{found.input_dps[k]:+.6g}", with_uncertainty(float(found.ratio[k]), float(found.ratio_u[k])))
        for k in order
    )
    return TextTable(("input, deg/s", "r"), rows)


def _ratios_svg(one: AxisThreshold, series: ThresholdSeries, name: str) -> str:
    """Draw r of both senses against the size of the input."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        found, edge = series.found, series.says.threshold
        smallest, largest = float(np.abs(found.input_dps).min()), float(np.abs(found.input_dps).max())
        low, high = max(edge.low_95, smallest / 3), min(edge.high_95, 3 * largest)
        axes.axvspan(low, high, color=LINE, linewidth=0, zorder=0)
        for sense, colour, mark, label in (
            (1, ACCENT, "o", "positive input"),
            (-1, SECOND, "s", "negative input"),
        ):
            chosen = sense * found.input_dps > 0
            if chosen.any():
                u = NORMAL_95 * found.ratio_u[chosen]
                axes.errorbar(
                    np.abs(found.input_dps[chosen]), found.ratio[chosen], u, fmt=mark, ms=4, capsize=2,
                    color=colour, linewidth=0.9, label=label,
                )  # fmt: skip
        for part in (0.5, 0.1):
            axes.axhline(part, color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set(xscale="log", xlabel="size of the input, deg/s", ylabel="r, output over expected")
        axes.set_xlim(smallest / 2, largest * 2)
        legend_above(axes, columns=2)

    return svg_element(f"{name}-{one.axis}", WIDE if series.found.input_dps.size > 6 else HALF, draw)


_NOISE_S = 60.0
_BETWEEN_REFERENCES = 4
_REFINED = "refined"


def plan_noise(settings: FogSettings) -> list[PlannedSegment]:
    """List the segment that says the noise, unless the settings do."""
    if _own(settings).angle_random_walk:
        return []
    return [_segment("noise at rest", NOISE, 0.0, _NOISE_S, settings, reference=False)]


def plan(settings: FogSettings, angle_random_walk: float) -> list[PlannedSegment]:
    """List the segments of the ladder and of the resolution."""
    ladder, base = ladder_for(settings, angle_random_walk), _own(settings).resolution_at_dps
    rungs = zip(ladder.rate_dps.tolist(), ladder.seconds.tolist(), strict=True)
    senses = [(sense * rate, seconds) for rate, seconds in rungs for sense in (1, -1)]
    planned = _with_references("", LADDER, 0.0, senses, settings)
    if base:
        changes = [(change, seconds) for change, seconds in senses if abs(change) < base]
        planned += _with_references(f"{base:g} ", RESOLUTION, base, changes, settings)
    return planned


def plan_refined(settings: FogSettings, run: SavedRun) -> list[PlannedSegment]:
    """List further inputs about the edge that the ladder of a run shows."""
    if not _own(settings).refine:
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
    between = list[tuple[float, float]]()
    for rate in refined(found, _own(settings).refine):  # as long as the nearest smaller input
        nearest = max((one for one in longest if one <= abs(rate)), default=min(longest))
        between.append((rate, longest[nearest]))
    return _with_references("further ", LADDER, 0.0, between, settings, further=True)


def ladder_for(settings: FogSettings, angle_random_walk: float) -> Ladder:
    """Return the ladder of the settings for a noise, deg/sqrt(h)."""
    chosen = _own(settings)
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
    if _own(settings).angle_random_walk:
        return _own(settings).angle_random_walk
    for segment in segments_of(run, PURPOSE):
        if segment.conditions["series"] == NOISE:
            try:
                mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
            except ValueError:
                continue
            return 60 * mean.mean_u * math.sqrt(mean.duration_s) / settings.nominal_scale_factor
    return 0.0


def take(settings: FogSettings, session: Acquisition) -> None:
    """Take the segments on the bench: noise, ladder, and further inputs about the edge that it shows."""

    def ladder(run: SavedRun) -> list[PlannedSegment]:
        walk = angle_random_walk_of(run, settings)
        drowns = "its output drowns in the noise: it takes {:.3g} s to know it to a quarter, and "
        drowns += "threshold.longest_s is {:g}"
        too_noisy, longest = ladder_for(settings, walk).too_noisy, _own(settings).longest_s
        session.note_left_out({f"input {rate:g}": drowns.format(seconds, longest) for rate, seconds in too_noisy})
        return plan(settings, walk)

    stages = [lambda run: plan_noise(settings), ladder, lambda run: plan_refined(settings, run)]
    take_segments(settings, session, open_fog_bench(settings), stages, truth_of(settings))


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by axis and rate of the table; at rest, or without input, it is a reference."""
    return [_named(row, settings) for row in rows]


def _named(row: LogRow, settings: FogSettings) -> NamedSegment:
    axis, rate, end_up = row.get("axis", _own(settings).axis), row["rate_dps"], row["end_up"]
    base = row.get("base_dps")
    change = rate - base if base is not None else rate + earth_rate_along_axis(settings)
    reference = change == 0 or (base is None and (rate == 0 or abs(change) < _own(settings).lowest_dps / 10))
    conditions = {
        "axis": axis,
        "end_up": end_up,
        "rate_dps": rate,
        "series": LADDER if base is None else RESOLUTION,
        "reference": reference,
        **{name: value for name, value in table_conditions(row).items() if name != "window_s"},
    }
    return f"{axis}{'' if end_up > 0 else ' down'} {rate:+.10g}{' reference' if reference else ''}", conditions


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
        "axis": _own(settings).axis,
        "end_up": 1,
        "rate_dps": input_dps - earth_rate_along_axis(settings),
        "series": series,
        "reference": reference,
    }
    return PlannedSegment(
        key, seconds, _own(settings).settle_s, {**conditions, **({_REFINED: True} if further else {})}
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
    quantities=QUANTITIES,
    unusable=_unusable,
    section=ThresholdSettings,
)
