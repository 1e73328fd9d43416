"""The 2 pi error as numbers and sentences."""

from __future__ import annotations

from typing import Any

from analysis.fibre_gyro import predicted_table_scale
from station.fibre_gyro.common import PPM, small_ppm
from station.fibre_gyro.eps.evaluate import EpsFound
from station.fibre_gyro.settings import FogSettings
from station.results.as_json import picked
from station.results.contributions import Contribution, budget_document
from station.results.numbers import ppm
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = ("two_pi_error_ppm",)
_NUMBERS = {
    "two_pi_error": "two_pi_error",
    "two_pi_error_u": "two_pi_error_u",
    "amplitude_counts": "amplitude",
    "amplitude_u_counts": "amplitude_u",
    "rest_phase_rad": "rest_phase_rad",
    "rest_phase_u_rad": "rest_phase_u_rad",
    "chi_square": "chi_square",
    "degrees_of_freedom": "degrees_of_freedom",
}


def result(found: EpsFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    eps, u = PPM * found.error.two_pi_error, PPM * found.error.two_pi_error_u
    lines = (f"The converter's range spans 2π (1 + eps); from {len(found.keys)} injected steps in open loop.",)
    to_watch = tuple(_to_watch(found))
    return Result(
        name="result",
        value=f"eps = {ppm(eps, u)}",
        document=_document(found),
        measured=(Measured("two_pi_error_ppm", eps),),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(_sentences(found, settings)),
        to_watch=to_watch,
        flags=to_watch,
        left_out=found.left_out,
    )


def _document(found: EpsFound) -> dict[str, Any]:
    columns = (found.keys, found.step_codes, found.normal, found.normal_u, found.reset, found.reset_u)
    names = ("name", "step_codes", "normal_error", "normal_error_u", "reset_error", "reset_error_u")
    return {
        **picked(found.error, _NUMBERS),
        "two_pi_error_ppm": PPM * found.error.two_pi_error,
        "two_pi_error_u_ppm": PPM * found.error.two_pi_error_u,
        "budget": budget_document("1, the range over 2π", _budget(found), PPM * found.error.two_pi_error_u),
        "points": [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)],
        "left_out": found.left_out,
    }


def _budget(found: EpsFound) -> list[Contribution]:
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


def _sentences(found: EpsFound, settings: FogSettings) -> list[str]:
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


def _to_watch(found: EpsFound) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    error = found.error
    if error.degrees_of_freedom > 0 and error.chi_square > 4 * error.degrees_of_freedom:
        said.append(
            "The steps do not agree within their noise: the converter is not linear, or the feedback was not held."
        )
    return said
