"""How fast the output follows: bandwidth and delay by an injected staircase, or by a sine of the table.

The injected step changes its sense every half period; a log has a column ``injected`` (codes) beside the output.
Or logs with the angle of the table, ``table_deg``, that swings as a sine, one for each frequency. The equations:
`analysis.fibre_gyro.response`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from analysis.arrays import Complexes, Floats
from analysis.fibre_gyro import (
    FilterResponse,
    SinePoint,
    StepTrain,
    sine_point,
    sine_response,
    step_response,
    steps_beyond_dac,
)
from instrument.fibre_gyro import TABLE_ANGLE
from station.errors import NoUsableSignal
from station.fibre_gyro.bench import turned_over
from station.fibre_gyro.common import beyond_converter, not_taken, reasons_of
from station.fibre_gyro.logs import LogRow, NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.segments import PlannedSegment, Segment, checked, segments_of, words_of
from station.fibre_gyro.settings import FogSettings, Name, TestSettings
from station.report.figure import ACCENT, INK, SOFT, WIDE, legend_above, svg_element
from station.results.quantity import Quantity, QuantityGroup, document, rows
from station.results.result import Excluded, PlacedFigure, Result, Section, table, with_uncertainty
from station.runs.store import SavedRun
from station.settings import NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PURPOSE = "response"
INJECTED = "injected"  # column of a log: step in codes while each output was made
_USUAL_GAIN = 0.95, 1.05
_POINTS = 13  # of the transfer function that is given


class ResponseSettings(TestSettings):
    """The steps that are injected."""

    axis: Name
    rate_dps: Positive
    half_period_s: Positive
    periods: Annotated[int, Field(ge=1, le=10_000)]
    settle_s: NotNegative


_own = ResponseSettings.of


@dataclass(frozen=True)
class ResponseEvaluation:
    """What was found, and the transfer function: that of the filter, or as sines gave it."""

    found: FilterResponse
    at_hz: Floats  # (m,)
    transfer: Complexes  # (m,)
    measured_u: Floats  # (m,): of its parts; nan where it is that of the filter
    interval_s: float
    left_out: tuple[Excluded, ...]

    @property
    def by_sine(self) -> bool:
        """Whether the table swung."""
        return bool(np.isfinite(self.measured_u).any())

    @property
    def phase_deg(self) -> Floats:
        """Phase of the output behind the input."""
        return np.asarray(np.rad2deg(np.unwrap(np.angle(self.transfer))))


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> ResponseEvaluation:
    """Find the filter by the steps of the first segment that has some, else by all sines."""
    left_out, sines, interval = not_taken(run), list[SinePoint](), math.nan
    every, axis = segments_of(run, PURPOSE), _own(settings).axis
    segments = [one for one in every if one.conditions.get("axis", axis) == axis]
    if every and not segments:
        axes = ", ".join(dict.fromkeys(str(one.conditions["axis"]) for one in every))
        raise NoUsableSignal(f"there is output of {axes}, none of the axis {axis}: name it as response.axis")
    for segment in segments:
        try:
            interval = checked(segment).interval_s
            if TABLE_ANGLE in segment.recording.extra and INJECTED not in segment.recording.extra:
                recording = segment.recording
                turned = np.unwrap(words_of(recording, TABLE_ANGLE), period=360.0)
                rate = np.diff(turned, prepend=np.nan) / recording.interval_s
                sines.append(
                    sine_point(rate, words_of(recording) / settings.nominal_scale_factor, recording.interval_s)
                )
                continue
            found = step_response(words_of(segment.recording), interval, _steps(segment, settings))
        except ValueError as error:
            left_out.append(Excluded(segment.key, str(error)))
            continue
        top = min(0.5 / interval, 3 * found.bandwidth_hz)
        frequency = np.geomspace(top / 100, top, _POINTS)
        unmeasured = np.full(_POINTS, np.nan)
        return ResponseEvaluation(
            found, frequency, found.transfer(frequency), unmeasured, interval, tuple(left_out)
        )
    if not sines:
        raise NoUsableSignal(f"there are no steps of the input that can be used{reasons_of(left_out)}")
    try:
        found = sine_response(sines)
    except ValueError as error:
        raise NoUsableSignal(f"{error}{reasons_of(left_out)}") from None
    sines.sort(key=lambda one: one.frequency_hz)
    frequency, u = (np.array(one) for one in zip(*((s.frequency_hz, s.ratio_u) for s in sines), strict=True))
    return ResponseEvaluation(
        found, frequency, np.array([one.ratio for one in sines]), u, interval, tuple(left_out)
    )


def _steps(segment: Segment, settings: FogSettings) -> StepTrain:
    """Steps by the column of the log, or by when they were commanded."""
    recording, per_code = segment.recording, settings.gyro.counts_per_code
    if INJECTED in recording.extra:
        codes = words_of(recording, INJECTED)
        known = np.flatnonzero(np.isfinite(codes))
        codes = codes[known[np.maximum(np.searchsorted(known, np.arange(codes.size), side="right") - 1, 0)]]
        at = np.flatnonzero(np.diff(codes)) + 1
        return StepTrain(
            recording.interval_s * at.astype(np.float64), per_code * np.diff(codes)[at - 1], exact=True
        )
    if "half_period_s" not in segment.conditions:
        raise ValueError(f"it has neither a column {INJECTED} nor a column {TABLE_ANGLE}")
    times, steps = turned_over(PlannedSegment("", recording.duration_s, 0.0, segment.conditions))
    before = np.concatenate([[float(segment.conditions["step_codes"])], steps[:-1]])
    return StepTrain(times, per_code * (steps - before), exact=False)


# --------------------
# The response as numbers and sentences


NUMBERS = (
    Quantity(
        "bandwidth", "hz", "found.bandwidth_hz", "found.bandwidth_u_hz", limit=True, at_least=True, headline=True,
        doc="where the filter passes half the power; at least that where no filter is seen",
    ),
    Quantity("delay", "s", "found.delay_s", "found.delay_u_s", limit=True, optional=True, doc="at low frequency"),
    Quantity("gain", of="found.gain", u=True, doc="change of the output over that of the input, by design"),
    Quantity("command_jitter", "s", "found.jitter_s", doc="scatter of the times that commands took"),
)  # fmt: skip
POINTS = (
    Quantity("response_frequency", "hz", "at_hz", label="frequency, Hz", form="{:.4g}"),
    Quantity("magnitude", of=lambda found: np.abs(found.transfer), label="magnitude", form="{:.4f}"),
    Quantity("phase", "deg", "phase_deg", label="phase, deg", form="{:.1f}"),
    Quantity("measured_u", doc="of its parts, where a sine measured it"),
)
QUANTITIES = (QuantityGroup(NUMBERS), QuantityGroup(POINTS, "points"))


def result(found: ResponseEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    of, form, seen = found.found, found.found.form.name, math.isfinite(found.found.bandwidth_u_hz)
    watched = [f"{one.sentence}." for one in found.left_out]
    bandwidth = with_uncertainty(of.bandwidth_hz, of.bandwidth_u_hz, "Hz") if seen else ""
    lines = [
        f"{form.capitalize()}; gain {with_uncertainty(of.gain, of.gain_u)} of that by design."
        if seen
        else f"No filter is seen beside the mean over each output ({found.interval_s:.4g} s)."
    ]
    if math.isfinite(of.delay_s):
        lines.append(f"Delay {with_uncertainty(1e3 * of.delay_s, 1e3 * of.delay_u_s, 'ms')} at low frequency.")
    else:
        lines.append(
            f"The delay is not known: commands take their way, {1e3 * of.jitter_s:.2g} ms from one to the next."
        )
    if math.isfinite(of.misfit):
        watched.append(
            f"Behind the steps the output differs from a {form}, {of.misfit:.2g} times the power elsewhere: "
            "the gyro has another filter, and bandwidth and delay are only near."
            if not found.by_sine
            else f"The points lie off a {form}, chi-square {of.misfit:.2g} a point: it is another filter."
        )
    if not of.settled:
        watched.append("The output does not come to rest between the steps: use a longer response.half_period_s.")
    if math.isfinite(of.odd_step_s):
        watched.append(
            f"The step {of.odd_step_s:.6g} s after the begin is not in the output as the others are: it did not "
            "come, or the gyro turned or saturated. Take it again."
        )
    if not _USUAL_GAIN[0] < abs(of.gain) < _USUAL_GAIN[1]:
        watched.append(
            f"The output goes {abs(of.gain):.4g} times as far as the input says: another unit, a step that does "
            "not come whole, or saturation."
        )
    return Result(
        name="result",
        value=f"Bandwidth {bandwidth}" if seen else f"Bandwidth above {of.bandwidth_hz:.3g} Hz",
        document={
            "form": form,
            **document(found, NUMBERS),
            "points": rows(found, POINTS),
            "left_out": found.left_out,
        },
        quantities=QUANTITIES,
        lines=tuple(lines),
        summary=[("", line) for line in lines],
        sentences=(
            "The mean over each output is not in bandwidth and delay; times are by the clock of the output.",
            "As allan.output_filter_hz the bandwidth holds for a low-pass of first order.",
        ),
        to_watch=tuple(watched),
        flags=tuple(watched),
        left_out=found.left_out,
    )


# --------------------
# Report, plan and logs


def sections(found: ResponseEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    transfer = PlacedFigure(_transfer(found), "Line: the fitted filter; points: measured.")
    steps = "All steps, one on the other; line: the fitted filter."
    return [
        *([] if found.by_sine else [Section("Step response", figures=(PlacedFigure(_rise(found), steps),))]),
        Section("Transfer function", figures=(transfer,), table=table(found, POINTS)),
        Section("What this result shows, and what it cannot", sentences=result.sentences),
    ]


def _rise(found: ResponseEvaluation) -> str:
    of, h = found.found, found.interval_s

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.plot(1e3 * of.since_s, of.risen, "o", ms=2, color=INK, label="outputs, by their ends")
        since = np.linspace(0, float(of.since_s.max(initial=h)), 400)
        delay = of.delay_s - of.form.delay_s(of.parameters) if math.isfinite(of.delay_s) else 0.0
        area = [of.form.integral(np.maximum(since - delay - one, 0.0), of.parameters) for one in (0.0, h)]
        axes.plot(1e3 * since, (area[0] - area[1]) / h, color=ACCENT, label="fitted filter")
        axes.set(xlabel="time behind the step, ms", ylabel="part of the step")
        legend_above(axes, columns=2)

    return svg_element("step-response", WIDE, draw)


def _transfer(found: ResponseEvaluation) -> str:
    frequency, of = found.at_hz, found.found

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        fine = np.geomspace(frequency.min(), frequency.max(), 300)
        gain = abs(of.gain) if found.by_sine else 1.0
        axes.plot(fine, gain * np.abs(of.transfer(fine)), color=ACCENT, label="fitted filter")
        if found.by_sine:
            axes.errorbar(
                frequency, np.abs(found.transfer), found.measured_u, fmt="o", ms=4, color=INK, label="measured"
            )
        axes.axhline(math.sqrt(0.5), color=SOFT, linewidth=0.8)
        axes.set(xscale="log", xlabel="frequency, Hz", ylabel="magnitude", ylim=(0, None))
        legend_above(axes, columns=2)

    return svg_element("transfer-function", WIDE, draw)


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the one segment, steps of the injected staircase from one sense to the other, if it can be made."""
    own = _own(settings)
    codes = settings.coil.nominal_scale(settings.gyro.dac_bits) * own.rate_dps
    if steps_beyond_dac(codes, settings.gyro.dac_bits):
        return []
    conditions = {"purpose": PURPOSE, "axis": own.axis, "end_up": 1, "rate_dps": 0.0, "step_codes": codes}
    conditions["half_period_s"] = own.half_period_s
    seconds = (2 * own.periods + 1) * own.half_period_s
    return [PlannedSegment(f"{own.axis} steps", seconds, own.settle_s, conditions)]


def beyond(settings: FogSettings) -> dict[str, str]:
    """Name the steps if they are beyond the converter."""
    own, bits = _own(settings), settings.gyro.dac_bits
    reason = beyond_converter(settings.coil.nominal_scale(bits) * own.rate_dps, bits)
    return {} if plan(settings) else {f"{own.axis} steps": reason}


def named(listed: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by its place in the list."""
    return [(f"{number} {row.get('axis', '')}".strip(), {"rate_dps": 0.0}) for number, row in enumerate(listed, 1)]


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "Frequency response",
    take=planned_segments(plan, beyond),
    take_files=listed_logs(PURPOSE, (), named, whole=True),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
    section=ResponseSettings,
)
