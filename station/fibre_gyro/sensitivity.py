"""Sensitivity of bias and scale factor to one stimulus, whatever it is; bias and K from six positions (tumble).

A magnetic field, the supply, the light power, pressure, acceleration, vibration: an operator or a list of logs
says which value it had, this test what the gyro made of it; the equations: `analysis.fibre_gyro.sensitivity`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from analysis.fibre_gyro import SlopeFit, StimulusResponse, WindowMean, stimulus_response, tumble
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.common import COUNTS_PER_DPS, PPM, far_from_design, not_taken, reasons_of
from station.fibre_gyro.logs import (
    LogRow,
    NamedSegment,
    gyro_measurement,
    listed_logs,
    planned_segments,
    table_conditions,
)
from station.fibre_gyro.segments import (
    PlannedSegment,
    Segment,
    begins_of,
    remarks_on,
    segments_of,
    window_at_rest,
    window_of_any_length,
)
from station.fibre_gyro.settings import FogSettings, Name, TestSettings
from station.report.figure import ACCENT, INK, SOFT, WIDE, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, rows
from station.results.result import Excluded, PlacedFigure, Result, Section, table, with_uncertainty
from station.runs.store import SavedRun
from station.settings import Finite, NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PURPOSE = "sensitivity"
POSITIONS = ("+x", "-x", "+y", "-y", "+z", "-z")
_SIGNIFICANT = 4.0

Usable = tuple[Segment, WindowMean, float]  # with the time of its middle, s


class SensitivitySettings(TestSettings):
    """The stimulus, and how long each of its values is looked at."""

    axis: Name
    stimulus: str
    unit: str
    values: Annotated[list[Finite], Field(min_length=3)]
    rate_dps: NotNegative
    tumble: bool
    squareness_mrad: NotNegative
    record_s: Positive
    settle_s: NotNegative

    def wrong(self) -> str:
        """Values that are all the same."""
        return "values: must differ" if len(set(self.values)) < 2 else ""


_own = SensitivitySettings.of


@dataclass(frozen=True)
class SensitivityEvaluation:
    """What the stimulus does to bias, deg/h, and scale factor, ppm; or what six positions say."""

    bias: StimulusResponse | None
    scale: StimulusResponse | None
    tumble: SlopeFit | None
    scale_factor: float  # by design, counts per deg/s: it turns counts into deg/h
    remarks: tuple[str, ...]
    left_out: tuple[Excluded, ...]

    @property
    def responses(self) -> list[tuple[str, StimulusResponse, str]]:
        """What responds, how, and in which unit."""
        both = ("bias", self.bias, "deg/h"), ("scale factor", self.scale, "ppm")
        return [(name, response, unit) for name, response, unit in both if response is not None]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> SensitivityEvaluation:
    """Evaluate all segments: by their positions where they have some, else by the stimulus."""
    left_out, usable = not_taken(run), list[Usable]()
    segments = segments_of(run, PURPOSE)
    for segment, begin in zip(segments, begins_of(segments), strict=True):
        with Excluded.by_error(segment.key, left_out):
            if segment.conditions["rate_dps"]:
                window = window_of_any_length(segment, settings, turns=settings.table.turns)
            else:
                window = window_at_rest(segment, resolution=settings.gyro.output_resolution)
            usable.append((segment, window, begin + window.duration_s / 2))
    bias: StimulusResponse | None = None
    scale: StimulusResponse | None = None
    six: SlopeFit | None = None
    try:
        if any("position" in one.conditions for one, *_ in usable):
            six = _six_positions(usable, settings)
        else:
            bias, scale = (stimulus_response(*of.T) if of.size else None for of in _means(usable, settings))
    except ValueError as error:
        raise NoUsableSignal(f"{error}{reasons_of(left_out)}") from None
    if (bias, scale, six) == (None, None, None):
        raise NoUsableSignal(f"there is no output at rest, and none in both senses{reasons_of(left_out)}")
    remarks = tuple(said for segment, window, _ in usable for said in remarks_on(segment, window))
    return SensitivityEvaluation(bias, scale, six, settings.nominal_scale_factor, remarks, tuple(left_out))


def _means(usable: Sequence[Usable], settings: FogSettings) -> tuple[np.ndarray, np.ndarray]:
    """Stimulus, mean, its u and time of every visit: of the bias, deg/h, and the scale factor, ppm of design."""
    design = settings.nominal_scale_factor
    at_rest = [one for one in usable if not one[0].conditions["rate_dps"]]
    turning = [one for one in usable if one[0].conditions["rate_dps"]]
    per_count = 3600 / design
    bias = [
        (one.conditions["stimulus"], per_count * mean.mean, per_count * mean.mean_u, at)
        for one, mean, at in at_rest
    ]
    scale, place = [], 0
    while place + 1 < len(turning):
        (one, mean, at), (other, its_mean, then) = turning[place : place + 2]
        forth, back = (
            float(of.get("table_rate_dps", of["rate_dps"])) for of in (one.conditions, other.conditions)
        )
        are_pair = one.conditions["stimulus"] == other.conditions["stimulus"] and forth * back < 0
        if are_pair:
            size = PPM / design / (forth - back)
            u = abs(size) * np.hypot(mean.mean_u, its_mean.mean_u)
            scale.append((one.conditions["stimulus"], size * (mean.mean - its_mean.mean), u, (at + then) / 2))
        place += 2 if are_pair else 1
    return np.array(bias), np.array(scale)


def _six_positions(usable: Sequence[Usable], settings: FogSettings) -> SlopeFit:
    of: dict[str, list[WindowMean]] = {position: [] for position in POSITIONS}
    for one, mean, _ in usable:
        of[one.conditions["position"]].append(mean)
    if missing := [position for position, means in of.items() if not means]:
        raise ValueError(f"six positions are needed, there is no output of {', '.join(missing)}")
    means = np.array([np.mean([one.mean for one in means]) for means in of.values()])
    u = np.array([np.sqrt(np.sum([one.mean_u**2 for one in means])) / len(means) for means in of.values()])
    return tumble(means.reshape(3, 2), u.reshape(3, 2), 1e-3 * _own(settings).squareness_mrad)


# --------------------
# Sensitivities as numbers and sentences


def _largest(which: str, part: str) -> Any:
    """The largest change, or its uncertainty."""
    return lambda found: (one := getattr(found, which)) and float(getattr(one, part)[one.largest])


def _in_dph(part: str) -> Any:
    return lambda found: found.tumble and 3600 * getattr(found.tumble, part) / found.scale_factor


NUMBERS = (
    Quantity("bias_sensitivity", "dph_per_unit", "bias.slope", u=True, limit=True, optional=True, headline=True),
    Quantity(
        "bias_change", "dph", _largest("bias", "change"), _largest("bias", "change_u"), limit=True, optional=True,
        doc="largest change from the reference",
    ),
    Quantity("scale_factor_sensitivity", "ppm_per_unit", "scale.slope", u=True, limit=True, optional=True),
    Quantity(
        "scale_factor_change", "ppm", _largest("scale", "change"), _largest("scale", "change_u"), limit=True,
        optional=True, doc="largest change from the reference",
    ),
    Quantity("tumble_scale_factor", "counts_per_dps", "tumble.slope", u=True, trend=True),
    Quantity(
        "tumble_bias", "dph", _in_dph("intercept"), _in_dph("intercept_u"), limit=True, optional=True, trend=True
    ),
)  # fmt: skip
LEVELS = (
    Quantity("stimulus", of="level", label="stimulus", form="{:g}"),
    Quantity("change", u=True, label="change from the reference"),
)
QUANTITIES = (QuantityGroup(NUMBERS),)


_CHANGES = "Changes are differences from the reference before and after: an even drift takes nothing."
_SIX = (
    "K is what the earth rate makes of three directions at right angles, whatever latitude and azimuth are. What "
    "each position may be off by (sensitivity.squareness_mrad) is counted."
)


def result(found: SensitivityEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    own, said, watched = _own(settings), list[str](), list[str]()
    if (six := found.tumble) is not None:
        k = with_uncertainty(six.slope, six.slope_u)
        bias, u = (3600 * one / found.scale_factor for one in (six.intercept, six.intercept_u))
        said += [f"K = {k} {COUNTS_PER_DPS} by the earth rate", f"Bias {with_uncertainty(bias, u, 'deg/h')}."]
        watched += filter(None, [far_from_design(six.slope, settings)])
    for name, response, unit in found.responses:
        at = response.largest
        largest = with_uncertainty(response.change[at], response.change_u[at], unit)
        said += [
            f"{name} {with_uncertainty(response.slope, response.slope_u, f'{unit} per {own.unit}')}",
            f"Largest change of the {name} {largest}, at {response.level[at]:g} against {response.reference:g} "
            f"{own.unit}.",
        ]
    watched += [*_to_watch(found, own), *found.remarks, *(f"{one.sentence}." for one in found.left_out)]
    return Result(
        name="result",
        value=said[0],
        document={
            "stimulus": None if six else own.stimulus,
            "stimulus_unit": None if six else own.unit,
            **document(found, NUMBERS),
            "levels": {name: rows(response, LEVELS) for name, response, _ in found.responses},
            "left_out": found.left_out,
        },
        quantities=QUANTITIES,
        lines=tuple(said[1:]),
        summary=[("", line) for line in said[1:]],
        sentences=(
            _SIX if six else _CHANGES,
            f"deg/h are by the scale factor by design, {found.scale_factor:.6g} {COUNTS_PER_DPS}.",
        ),
        to_watch=tuple(watched),
        flags=tuple(watched),
        left_out=found.left_out,
    )


def _to_watch(found: SensitivityEvaluation, own: SensitivitySettings) -> list[str]:
    said = []
    for name, response, _ in found.responses:
        if not response.by_reference:
            said.append(
                f"The {name} was not seen at {response.reference:g} {own.unit} before and after all others: a "
                "drift that is no straight line counts as sensitivity. Go back to it at the begin and the end."
            )
        if not response.repeated:
            said.append(
                f"No visit repeats another, so how the {name} scatters between visits is not in u: go through the "
                f"values of the {own.stimulus} more than once."
            )
        if abs(response.bend) > _SIGNIFICANT:
            said.append(
                f"The {name} does not go with the {own.stimulus} on a straight line: its quadratic part is "
                f"{abs(response.bend):.0f} times its uncertainty. Take the changes of each value, not the slope."
            )
    if found.tumble is not None and found.tumble.chi_square > _SIGNIFICANT**2 + 3:
        said.append(
            "The three pairs of positions do not give one bias: it changed on the way, or depends on the position "
            "(acceleration), or the fixture is worse than sensitivity.squareness_mrad says."
        )
    return said


# --------------------
# Report, plan and logs


def sections(found: SensitivityEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    across, made = f"{_own(settings).stimulus}, {_own(settings).unit}", list[Section]()
    for name, response, unit in found.responses:
        figures = (PlacedFigure(_svg(response, across, f"change, {unit}", name), "Each visit, and the line."),)
        made.append(Section(f"Change of the {name}, {unit}", figures=figures, table=table(response, LEVELS)))
    return [*made, Section("What this result shows, and what it cannot", sentences=result.sentences)]


def _svg(response: StimulusResponse, across: str, up: str, name: str) -> str:
    """Draw the changes against the stimulus."""

    def draw(figure: Figure) -> None:
        axes, stimulus = figure.add_subplot(), response.stimulus
        ends = np.array([stimulus.min(), stimulus.max()])
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.plot(ends, response.slope * (ends - response.reference), color=ACCENT)
        axes.errorbar(stimulus, response.difference, response.difference_u, fmt="o", ms=4, color=INK, capsize=3)
        axes.set(xlabel=across, ylabel=up)

    return svg_element(f"{name.replace(' ', '-')}-over-stimulus", WIDE, draw)


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: every value in its order, at rest and, if wished, in both senses; or six positions."""
    own = _own(settings)
    wanted: list[tuple[str, float, dict[str, Any]]]
    if own.tumble:
        asked = "Input axis of the gyro along {} of the fixture."
        wanted = [(f"position {one}", 0.0, {"position": one, "by_hand": asked.format(one)}) for one in POSITIONS]
    else:
        wanted = [
            (
                f"{number} {own.stimulus} {value:g}{f' {rate:+g} deg/s' if rate else ''}",
                rate,
                {"stimulus": value, "by_hand": f"Set the {own.stimulus} to {value:g} {own.unit}."},
            )
            for number, value in enumerate(own.values, start=1)
            for rate in ((0.0, own.rate_dps, -own.rate_dps) if own.rate_dps else (0.0,))
        ]
    fixed = {"purpose": PURPOSE, "axis": own.axis, "end_up": 1}
    return [
        PlannedSegment(key, own.record_s, own.settle_s, {**fixed, "rate_dps": rate, **more})
        for key, rate, more in wanted
    ]


def named(listed: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by the stimulus, or by its position."""
    made: list[NamedSegment] = []
    for number, row in enumerate(listed, start=1):
        rate = row.get("rate_dps", 0.0)
        if "stimulus" in row:
            name = f"{number} {_own(settings).stimulus} {row['stimulus']:g}{f' {rate:+g} deg/s' if rate else ''}"
            more = table_conditions({**row, "rate_dps": rate}) if rate else {}
            made.append((name, {"stimulus": row["stimulus"], "rate_dps": rate, **more}))
        elif row.get("position") in POSITIONS:
            made.append((f"{number} position {row['position']}", {"position": row["position"], "rate_dps": 0.0}))
        else:
            raise UsageError(f"{row['place']}: give the stimulus, or as position one of {', '.join(POSITIONS)}")
    return made


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Sensitivity to a stimulus",
    take=planned_segments(plan),
    take_files=listed_logs(PURPOSE, (), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
    section=SensitivitySettings,
)
