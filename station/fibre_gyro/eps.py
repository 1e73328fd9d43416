"""The 2 pi error by injection in open loop: plan, evaluation, result and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from analysis.fibre_gyro import (
    TwoPiError,
    WindowMean,
    estimate_two_pi_error,
    mean_at_rest,
    pooled_noise,
    predicted_table_scale,
    steps_beyond_dac,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import PPM, beyond_converter, not_taken, reasons_of, small_ppm, staircase_section
from station.fibre_gyro.logs import LogRow, NamedSegment, gyro_measurement, listed_logs, planned_segments
from station.fibre_gyro.segments import PlannedSegment, Segment, checked, segments_of
from station.fibre_gyro.settings import FogSettings, TestSettings
from station.report.figure import ACCENT, HALF, INK, SECOND, SOFT, legend_above, svg_element
from station.results.numbers import TWO_PI_ERROR_PPM
from station.results.quantity import Quantity, QuantityGroup, document, rows
from station.results.result import (
    Contribution,
    Excluded,
    PlacedFigure,
    Result,
    Section,
    budget_document,
    budget_table,
    ppm,
    table,
)
from station.runs.store import SavedRun
from station.settings import NotNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# --------------------
# What the open-loop segments of a run say: the 2 pi error


PURPOSE = "eps"
NORMAL, RESET = "normal_error", "reset_error"
_BLOCKS = 10
"""Of a segment, whose means tell the noise: those of both senses are pooled, and long ones hold filtered words."""


class EpsSettings(TestSettings):
    """The open-loop measurement of the 2 pi error."""

    steps_codes: Annotated[list[Positive], Field(min_length=1)]
    record_s: Positive
    settle_s: NotNegative


_own = EpsSettings.of


@dataclass(frozen=True)
class EpsEvaluation:
    """Result of the open-loop measurement."""

    keys: tuple[str, ...]  # segments in the result, one for each element of the arrays
    step_codes: NDArray[np.float64]  # (n,)
    # (n,): Mean demodulated error of the sample pairs without and with a reset, counts of the detector's converter
    normal: NDArray[np.float64]
    normal_u: NDArray[np.float64]
    reset: NDArray[np.float64]
    reset_u: NDArray[np.float64]
    error: TwoPiError
    left_out: tuple[Excluded, ...]


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> EpsEvaluation:
    """Evaluate the open-loop segments of a run."""
    means_of: list[tuple[str, float, WindowMean, WindowMean]] = []
    left_out = not_taken(run)
    for segment in segments_of(run, PURPOSE):
        with Excluded.by_error(segment.key, left_out):
            means = _mean_of(segment, NORMAL), _mean_of(segment, RESET)
            means_of.append((segment.key, float(segment.conditions["step_codes"]), *means))
    if len(means_of) < 2:
        raise NoUsableSignal(
            f"the 2 pi error needs two injected steps, there are {len(means_of)}: {reasons_of(left_out, '')}"
        )
    keys = tuple(key for key, *_ in means_of)
    step = np.array([size for _, size, *_ in means_of])
    kinds = [normal for *_, normal, _ in means_of], [reset for *_, reset in means_of]
    normal, reset = (np.array([one.mean for one in of_kind]) for of_kind in kinds)
    normal_u, reset_u = (_noise(step, of_kind) for of_kind in kinds)
    try:
        found = estimate_two_pi_error(step, normal, reset, normal_u, reset_u, dac_bits=settings.gyro.dac_bits)
    except ValueError as error:
        raise NoUsableSignal(f"the injected steps give no 2 pi error: {error}") from None
    return EpsEvaluation(keys, step, normal, normal_u, reset, reset_u, found, tuple(left_out))


def _noise(step: NDArray[np.float64], means: Sequence[WindowMean]) -> NDArray[np.float64]:
    """Uncertainty of each mean by the noise at its size of the step: a larger one has more resets in each word."""
    u = np.empty(step.size)
    for size in np.unique(np.abs(step)):
        alike = np.abs(step) == size
        u[alike] = pooled_noise([mean for mean, kept in zip(means, alike, strict=True) if kept])
    return np.maximum(u, 1e-12)


def _mean_of(segment: Segment, name: str) -> WindowMean:
    """Mean of a column."""
    recording = checked(segment)
    if name not in recording.extra:
        raise ValueError(
            f"the output has no column {name}: name the demodulated error of the sample pairs "
            f"{NORMAL} and {RESET} in the frame format or in the log"
        )
    values = recording.extra[name]
    values = values[np.isfinite(values)]
    if values.size < 3:
        raise ValueError(f"{name} has {values.size} values: record longer, or inject a larger step")
    return mean_at_rest(values, recording.interval_s, blocks=_BLOCKS)


# --------------------
# The 2 pi error as numbers and sentences


NUMBERS = (
    Quantity(
        "two_pi_error", of="error.two_pi_error", u=True, headline=True, doc="of the converter's range over 2π"
    ),
    Quantity("amplitude", "counts", "error.amplitude", u=True, doc="of the detector, in counts of its converter"),
    Quantity("rest_phase", "rad", "error.rest_phase_rad", "error.rest_phase_u_rad"),
    Quantity("chi_square", of="error.chi_square"),
    Quantity("degrees_of_freedom", of="error.degrees_of_freedom"),
    replace(TWO_PI_ERROR_PPM, of="error.two_pi_error", u=True, limit=True),
)
POINTS = (
    Quantity("name", of="keys"),
    Quantity("step_codes", label="injected step", form="{:+g} codes"),
    Quantity(NORMAL, of="normal", u=True, label="error without reset, counts"),
    Quantity(RESET, of="reset", u=True, label="error with reset, counts"),
)
QUANTITIES = (QuantityGroup(NUMBERS), QuantityGroup(POINTS, "points", "name"))


def result(found: EpsEvaluation, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    eps, u = PPM * found.error.two_pi_error, PPM * found.error.two_pi_error_u
    lines = (f"The converter's range spans 2π (1 + eps); from {len(found.keys)} injected steps in open loop.",)
    said = [f"{one.sentence}." for one in found.left_out]
    error = found.error
    if error.degrees_of_freedom > 0 and error.chi_square > 4 * error.degrees_of_freedom:
        said.append(
            "The steps do not agree within their noise: the converter is not linear, or the feedback was not held."
        )
    return Result(
        name="result",
        value=f"eps = {ppm(eps, u)}",
        document={
            **document(found, NUMBERS),
            "budget": budget_document("1, the range over 2π", _budget(found), u),
            "points": rows(found, POINTS),
            "left_out": found.left_out,
        },
        quantities=QUANTITIES,
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(_sentences(found, settings)),
        to_watch=tuple(said),
        flags=tuple(said),
        left_out=found.left_out,
    )


def _budget(found: EpsEvaluation) -> list[Contribution]:
    """Say what each input contributes to the uncertainty of eps."""
    parts = {name: PPM * value for name, value in found.error.contributions.items()}
    noise = "by the scatter of the words, of both senses of a step together"
    freedom = f"residuals, {found.error.degrees_of_freedom} degrees of freedom"
    return [
        Contribution("normal", "noise of the pairs without a reset", parts["normal"], True, noise),
        Contribution("reset", "noise of the pairs with a reset", parts["reset"], True, noise),
        Contribution("scatter", "scatter of the steps beyond these", parts["scatter"], True, freedom),
        Contribution(
            "light level", "light level", 0.0, True, "fitted: the ratio of both kinds of pairs tells eps"
        ),
    ]


def _sentences(found: EpsEvaluation, settings: FogSettings) -> list[str]:
    """Say what the 2 pi error means for the scale factor, and what this test does not see."""
    eps, u = found.error.two_pi_error, found.error.two_pi_error_u
    gated, ungated = (PPM * (predicted_table_scale(0.0, eps, gated=kind) - 1) for kind in (True, False))
    used = "leaves reset samples out" if settings.gyro.gated_resets else "uses all samples"
    return [
        "The feedback is held and a large step injected: sample pairs with a reset differ from those without by "
        f"the 2π error alone. The converter's range spans 2π (1 + eps), eps = {ppm(PPM * eps, PPM * u)}; the "
        "detector's amplitude is the only calibration, and it comes from the same data.",
        f"In closed loop such an eps changes K of the rate table by {gated:+.5g} ppm where reset samples are left "
        f"out, and by {small_ppm(ungated)} where all are used; this gyro {used}.",
        "It does not see L·D/λ: for that it takes the table. A self-calibration through the shared path sees "
        "neither.",
    ]


# --------------------
# The 2 pi error in the report: figures and table of the injected steps


def sections(found: EpsEvaluation, run: SavedRun, settings: FogSettings, result: Result) -> list[Section]:
    """Return the sections of the report."""
    return [
        Section("What this result shows, and what it cannot", sentences=result.sentences),
        Section(
            "Pairs with and without a reset",
            figures=(
                PlacedFigure(_errors_svg(found), "Demodulated error against the injected step."),
                PlacedFigure(_reset_differences_svg(found), "Their difference is the 2π error alone."),
            ),
            table=table(found, POINTS),
        ),
        Section("Budget", table=budget_table("2π error", result.document["budget"])),
        staircase_section(settings, open_loop_step=float(abs(found.step_codes).min())),
    ]


def _errors_svg(found: EpsEvaluation) -> str:
    """Draw the demodulated error of pairs with and without a reset against the injected step."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        order = np.argsort(found.step_codes)
        step = found.step_codes[order]
        axes.plot(step, found.normal[order], "o-", ms=5, color=ACCENT, label="pairs without a reset")
        axes.plot(step, found.reset[order], "s--", ms=8, mfc="none", color=SECOND, label="pairs with a reset")
        axes.set(xlabel="injected step, codes", ylabel="error, converter counts")
        legend_above(axes, columns=2)

    return svg_element("errors", HALF, draw)


def _reset_differences_svg(found: EpsEvaluation) -> str:
    """Draw the difference between pairs with and without a reset: the 2 pi error itself."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        order = np.argsort(found.step_codes)
        difference = (found.reset - found.normal)[order]
        u = np.hypot(found.reset_u, found.normal_u)[order]
        label = "measured, ±1 u"
        axes.errorbar(found.step_codes[order], difference, u, fmt="o", ms=5, color=INK, capsize=3, label=label)
        axes.axhline(0, color=SOFT, linewidth=0.8)
        axes.set(xlabel="injected step, codes", ylabel="with less without reset, counts")
        legend_above(axes)

    return svg_element("reset-differences", HALF, draw)


def plan(settings: FogSettings) -> list[PlannedSegment]:
    """List the segments: every step in both senses that the converter can make."""
    chosen, bits = _own(settings), settings.gyro.dac_bits
    return [
        PlannedSegment(_key(step), chosen.record_s, chosen.settle_s, {"purpose": PURPOSE, **_conditions(step)})
        for step in _steps(settings)
        if not steps_beyond_dac(step, bits)
    ]


def beyond(settings: FogSettings) -> dict[str, str]:
    """Name the steps that are beyond the converter."""
    bits = settings.gyro.dac_bits
    return {_key(step): beyond_converter(step, bits) for step in _steps(settings) if steps_beyond_dac(step, bits)}


def named(rows: Sequence[LogRow], settings: FogSettings) -> list[NamedSegment]:
    """Name the segment of each log by the step that was injected."""
    return [(_key(row["step_codes"]), _conditions(row["step_codes"])) for row in rows]


def _steps(settings: FogSettings) -> list[float]:
    return [step for size in _own(settings).steps_codes for step in (size, -size)]


def _key(step_codes: float) -> str:
    return f"open loop {step_codes:+.10g}"


def _conditions(step_codes: float) -> dict[str, object]:
    return {"loop": "held", "step_codes": step_codes, "rate_dps": 0.0}


MEASUREMENT = gyro_measurement(
    PURPOSE,
    "2π error by open-loop injection",
    take=planned_segments(plan, beyond),
    take_files=listed_logs(PURPOSE, ("step_codes",), named),
    evaluate=evaluate,
    result=result,
    sections=sections,
    quantities=QUANTITIES,
    plan=plan,
    section=EpsSettings,
)
