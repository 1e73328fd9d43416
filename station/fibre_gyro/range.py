"""Input range: the largest rate that the output follows in each sense, and how it comes back from an overload.

The table turns at larger and larger rates; in an overload it turns faster than the gyro can follow and stops, in
the middle of one log that has the angle of the table in it. Equations: `analysis.fibre_gyro.largest_rate`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from analysis.fibre_gyro import InputRange, RangeEnd, Recovery, WindowMean, input_range, recovery
from instrument.fibre_gyro import TABLE_ANGLE
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.common import PPM, far_from_design, not_taken, reasons_of
from station.fibre_gyro.logs import (
    LogRow,
    NamedSegment,
    gyro_measurement,
    listed_logs,
    planned_segments,
    table_conditions,
)
from station.fibre_gyro.segments import (
    OVERLOAD,
    PlannedSegment,
    Segment,
    checked,
    remarks_on,
    segments_of,
    window_of_any_length,
    words_of,
)
from station.fibre_gyro.settings import FogSettings, Name, TestSettings
from station.report.figure import ACCENT, INK, SECOND, SOFT, WIDE, legend_above, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, rows
from station.results.result import Excluded, PlacedFigure, Result, Section, table, with_uncertainty
from station.runs.store import SavedRun
from station.settings import Finite, NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PURPOSE = "range"
_UNKNOWN_RATE_PPM = 10.0  # by which a table's rate scatters where nobody states it
_SHIFT_U = 4.0


class RangeSettings(TestSettings):
    """The rates, what counts as followed, and the overload."""

    axis: Name
    rates_dps: Annotated[list[Positive], Field(min_length=3)]
    tolerance_ppm: Positive
    seconds: Positive
    settle_s: NotNegative
    overload_dps: Finite
    overload_s: Positive
    stop_s: Positive
    rest_s: Positive

    def wrong(self) -> str:
        """Rates of which two are one."""
        return "rates_dps: must differ" if len(set(self.rates_dps)) < len(self.rates_dps) else ""


_own = RangeSettings.of


@dataclass(frozen=True)
class RangeEvaluation:
    """The range, and what each overload did."""

    range: InputRange
    overloads: tuple[tuple[str, Recovery], ...]  # by their segments
    remarks: tuple[str, ...]
    left_out: tuple[Excluded, ...]

    @property
    def slowest(self) -> Recovery | None:
        """The overload that the output needed longest to come back from."""
        each = [one for _, one in self.overloads]
        return max(each, key=lambda one: one.high_95_s if math.isfinite(one.high_95_s) else math.inf, default=None)

    @property
    def largest_change(self) -> Recovery | None:
        """The overload that changed the bias most."""
        each = [one for _, one in self.overloads if math.isfinite(one.bias_change_dps)]
        return max(each, key=lambda one: abs(one.bias_change_dps), default=None)


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> RangeEvaluation:
    """Lay the line, find its ends, and look at each overload by it."""
    own, left_out = _own(settings), not_taken(run)
    usable, overloads = list[tuple[Segment, WindowMean]](), list[tuple[str, Recovery]]()
    every = segments_of(run, PURPOSE)
    segments = [one for one in every if one.conditions.get("axis", own.axis) == own.axis]
    if every and not segments:
        axes = ", ".join(dict.fromkeys(str(one.conditions["axis"]) for one in every))
        raise NoUsableSignal(f"there is output of {axes}, none of the axis {own.axis}: name it as range.axis")
    for segment in segments:
        if OVERLOAD not in segment.conditions:
            with Excluded.by_error(segment.key, left_out):
                usable.append((segment, window_of_any_length(segment, settings, turns=settings.table.turns)))
    rate = np.array([float(one.conditions.get("table_rate_dps", one.conditions["rate_dps"])) for one, _ in usable])
    mean, u = (np.array([getattr(one, name) for _, one in usable]) for name in ("mean", "mean_u"))
    stated = settings.table.irreproducibility_ppm
    scatter = (_UNKNOWN_RATE_PPM if stated is None else stated) / PPM * np.abs(mean)
    try:
        found = input_range(
            rate, mean, np.hypot(u, np.maximum(scatter, 1e-9)),
            tolerance_ppm=own.tolerance_ppm, fringe_dps=2 * settings.coil.fringe_limit_dps,
        )  # fmt: skip
    except ValueError as error:
        raise NoUsableSignal(f"{error}{reasons_of(left_out)}") from None
    line, least = (found.scale_factor, found.bias), found.least.low_95_dps
    for segment in segments:
        if OVERLOAD in segment.conditions:
            with Excluded.by_error(segment.key, left_out):
                recording = checked(segment)
                if TABLE_ANGLE not in recording.extra:
                    raise ValueError(f"an overload needs the angle of the table beside the output, {TABLE_ANGLE}")
                turned = np.unwrap(words_of(recording, TABLE_ANGLE), period=360.0)
                turning = np.diff(turned, prepend=np.nan) / recording.interval_s
                bound = own.tolerance_ppm / PPM * least
                words = words_of(recording)
                overloads.append((segment.key, recovery(turning, words, recording.interval_s, line, least, bound)))
    followed = dict(zip(found.rate_dps.tolist(), found.followed.tolist(), strict=True))
    remarks = [said for (one, window), w in zip(usable, rate, strict=True) if followed[float(w)]
               for said in remarks_on(one, window)]  # fmt: skip
    return RangeEvaluation(found, tuple(overloads), tuple(remarks), tuple(left_out))


# --------------------
# The range as numbers and sentences


def _of_end(name: str, at: str, **more: Any) -> Quantity:
    ends = f"range.{at}.low_95_dps", f"range.{at}.high_95_dps"
    return Quantity(name, "dps", f"range.{at}.value_dps", interval=ends, **more)


NUMBERS = (
    _of_end(
        "input_range", "least", limit=True, at_least=True, headline=True,
        doc="largest rate that the output follows in both senses; without upper end where none was beyond it",
    ),
    _of_end("positive_range", "positive", limit=True, at_least=True),
    _of_end("negative_range", "negative", limit=True, at_least=True, doc="as a size"),
    Quantity("range_scale_factor", "counts_per_dps", "range.scale_factor", u=True, doc="by all rates followed"),
    Quantity(
        "recovery", "s", "slowest.recovery_s", interval=("slowest.low_95_s", "slowest.high_95_s"), limit=True,
        optional=True, bound=True,
        doc="from the rate back in the range until the error stays within range.tolerance_ppm of it",
    ),
    Quantity(
        "bias_change_by_overload", "dph", "largest_change.bias_change_dps", "largest_change.bias_change_u_dps",
        scale=3600.0, limit=True, optional=True, doc="bias behind the overload less that before",
    ),
)  # fmt: skip
OVERLOADS = (
    Quantity("largest_rate", "dps", "overload_dps"),
    Quantity("recovery", "s", "recovery_s", interval=("low_95_s", "high_95_s")),
    Quantity("bias_change", "dph", "bias_change_dps", "bias_change_u_dps", scale=3600.0),
)
POINTS = (
    Quantity("rate", "dps", "rate_dps", label="rate, deg/s", form="{:+.8g}"),
    Quantity("mean", "counts", label="mean, counts", form="{:.8g}"),
    Quantity("off", "ppm", "off_ppm", "off_u_ppm", label="off the line, ppm of the rate"),
    Quantity("followed", label="followed"),
)
QUANTITIES = (
    QuantityGroup(NUMBERS),
    QuantityGroup(POINTS, "points"),
    QuantityGroup(OVERLOADS, "overloads", "name"),
)


def result(found: RangeEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    own, of = _own(settings), found.range
    watched = [*filter(None, [far_from_design(of.scale_factor, settings)]), *found.remarks]
    ends = (("positive", 1, of.positive), ("negative", -1, of.negative))
    lines = [_end_words(name, sense, end, of, settings) for name, sense, end in ends]
    for name, one in found.overloads:
        if not math.isfinite(one.high_95_s):
            watched.append(
                f"{name}: {one.low_95_s:.4g} s behind the overload the output is not back, {one.left_dps:+.4g} "
                f"deg/s off{_fringes(one.left_dps, settings)}. Switch it off and on, and record longer."
            )
            continue
        back = f"within {one.high_95_s:.3g} s"
        if math.isfinite(one.recovery_s):
            back = f"after {one.recovery_s:.3g} s ({one.low_95_s:.3g} to {one.high_95_s:.3g})"
        lines.append(f"{name[0].upper()}{name[1:]}: back {back}, to {1e3 * one.bound_dps:.3g} mdeg/s.")
        if abs(one.bias_change_dps) > _SHIFT_U * one.bias_change_u_dps:
            change, u = 3600 * one.bias_change_dps, 3600 * one.bias_change_u_dps
            watched.append(
                f"{name}: behind it the bias is another one, by {with_uncertainty(change, u, 'deg/h')}: let the "
                "gyro rest, and see whether it comes back."
            )
    watched += _odd_points(of, own)
    watched += [f"{one.sentence}." for one in found.left_out]
    least = of.least
    over = "at least " if not least.beyond else ""
    return Result(
        name="result",
        value=f"Input range {over}±{_size(least)} deg/s",
        document={
            **document(found, NUMBERS),
            "beyond": {name: end.beyond or None for name, _, end in ends},
            "points": rows(of, POINTS),
            "overloads": [{"name": name, **document(one, OVERLOADS)} for name, one in found.overloads],
            "left_out": found.left_out,
        },
        quantities=QUANTITIES,
        lines=tuple(lines),
        summary=[("", line) for line in lines],
        sentences=(
            f"Followed: within {own.tolerance_ppm:g} ppm of the rate from the line through the smaller rates.",
            "A recovery is as fine as the outputs that are averaged to see it through their noise.",
            "While the table stops, a delay of the output is an error too.",
        ),
        to_watch=tuple(watched),
        flags=tuple(watched),
        left_out=found.left_out,
    )


def _size(end: RangeEnd) -> str:
    u = (end.high_95_dps - end.low_95_dps) / 4
    return with_uncertainty(end.value_dps, u if end.beyond == "stands still" else math.nan)


def _end_words(name: str, sense: int, end: RangeEnd, of: InputRange, settings: FogSettings) -> str:
    begin = f"{name.capitalize()} sense: the output follows"
    if not end.beyond:
        return f"{begin} all rates, up to {sense * end.value_dps:+.6g} deg/s."
    if end.beyond == "stands still":
        return f"{begin} up to {'+' if sense > 0 else '-'}{_size(end)} deg/s and stands still there."
    at = sense * min(abs(one) for one in of.rate_dps[~of.followed & (sense * of.rate_dps > 0)])
    does = f": as a word of {end.detail:.0f} bits that wraps" if end.beyond == "wraps" else ""
    if end.beyond == "settles on another fringe":
        does = _fringes(end.detail * 2 * settings.coil.fringe_limit_dps, settings)
    off = float(of.off_ppm[of.rate_dps == at][0])
    return f"{begin} up to {sense * end.value_dps:+.6g} deg/s; at {at:+.6g} it is {off / 1e4:+.3g} % off{does}."


def _fringes(off_dps: float, settings: FogSettings) -> str:
    """What may be said of an error that is whole fringes."""
    whole = off_dps / (2 * settings.coil.fringe_limit_dps)
    if not round(whole) or abs(whole - round(whole)) > 0.05:
        return ""
    many = "a fringe" if abs(round(whole)) == 1 else f"{abs(round(whole))} fringes"
    return f", as much as {many} ({abs(off_dps):.4g} deg/s): the loop has settled on another one, or a word wraps"


def _odd_points(of: InputRange, own: RangeSettings) -> list[str]:
    """Rates that are off the line though larger ones of their sense are on it."""
    said = []
    for sense in (1, -1):
        side = sense * of.rate_dps > 0
        off, size = np.abs(of.off_ppm[side]), np.abs(of.rate_dps[side])
        out = size[off > own.tolerance_ppm]
        if out.size and (size[off <= own.tolerance_ppm] > out.min()).any():
            said.append(
                f"At {sense * out.min():+.6g} deg/s the output is off the line, at larger rates it is on it: that "
                "log is of another rate, or was disturbed. Take it again: the range may be larger."
            )
    return said


# --------------------
# Report, plan and logs


def sections(found: RangeEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    figures = (PlacedFigure(_line(found, settings), "Each rate off the line; dashed: the tolerance."),)
    made = [Section("Output off the line", figures=figures, table=table(found.range, POINTS))]
    if found.overloads:
        back = PlacedFigure(_back(found), "Error of the output from where the rate is back; dashed: the bound.")
        made.append(Section("Recovery from an overload", figures=(back,)))
    return [*made, Section("What this result shows, and what it cannot", sentences=result.sentences)]


def _line(found: RangeEvaluation, settings: FogSettings) -> str:
    of, tolerance = found.range, _own(settings).tolerance_ppm

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for chosen, colour, label in ((of.followed, INK, "followed"), (~of.followed, SECOND, "not followed")):
            axes.errorbar(
                of.rate_dps[chosen], of.off_ppm[chosen], of.off_u_ppm[chosen], fmt="o", ms=4, color=colour,
                capsize=2, label=label,
            )  # fmt: skip
        for end in (-tolerance, tolerance):
            axes.axhline(end, color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set(xlabel="rate of the table, deg/s", ylabel="off the line, ppm of the rate")
        axes.set_yscale("symlog", linthresh=2 * tolerance)
        axes.margins(y=0.15)
        legend_above(axes, columns=2)

    return svg_element("range", WIDE, draw)


def _back(found: RangeEvaluation) -> str:
    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for place, (name, one) in enumerate(found.overloads):
            axes.plot(one.since_s, one.error_dps, ".-", color=(ACCENT, SECOND, INK)[place % 3], ms=4, label=name)
        bound = found.overloads[0][1].bound_dps
        latest = max(
            (one.high_95_s for _, one in found.overloads if math.isfinite(one.high_95_s)), default=math.inf
        )
        axes.set_xlim(0, min(3 * latest, max(float(one.since_s[-1]) for _, one in found.overloads)))
        for end in (-bound, bound):
            axes.axhline(end, color=SOFT, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set_yscale("symlog", linthresh=2 * bound)
        axes.set(xlabel="time since the rate is back in the range, s", ylabel="error, deg/s")
        legend_above(axes, columns=2)

    return svg_element("recovery", WIDE, draw)


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: each rate in both senses, the smallest first; then an overload in both."""
    own = _own(settings)
    fixed = {"purpose": PURPOSE, "axis": own.axis, "end_up": 1}
    planned = [
        PlannedSegment(f"{rate:+g} deg/s", own.seconds, own.settle_s, {**fixed, "rate_dps": rate})
        for size in sorted(own.rates_dps)
        for rate in (size, -size)
    ]
    for rate in (own.overload_dps, -own.overload_dps) if own.overload_dps and settings.simulated else ():
        times = {"overload_s": own.overload_s, "stop_s": own.stop_s}
        seconds = 2 * own.overload_s + 2 * own.stop_s + own.rest_s
        overload = {**fixed, "rate_dps": 0.0, OVERLOAD: rate, **times}
        planned.append(PlannedSegment(f"overload {rate:+g} deg/s", seconds, own.settle_s, overload))
    return planned


def named(listed: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by its rate, or by its overload."""
    made: list[NamedSegment] = []
    for row in listed:
        axis = {"axis": row["axis"]} if "axis" in row else {}
        if OVERLOAD in row:
            made.append((f"overload {row[OVERLOAD]:+g} deg/s", {OVERLOAD: row[OVERLOAD], "rate_dps": 0.0, **axis}))
        elif row.get("rate_dps"):
            conditions = {"rate_dps": row["rate_dps"], **axis, **table_conditions(row)}
            conditions.pop("window_s", None)  # whole turns of it are looked for
            made.append((f"{row['rate_dps']:+.10g} deg/s", conditions))
        else:
            raise UsageError(f"{row['place']}: give the rate that is not 0, or {OVERLOAD}")
    return made


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Input range",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, (), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
    section=RangeSettings,
)
