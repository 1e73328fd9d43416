"""The self-calibration as numbers and sentences: what it shows, and what it cannot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from analysis.fibre_gyro import (
    predicted_difference_ppm,
    predicted_self_scale,
    predicted_table_scale,
)
from station.fibre_gyro.common import COUNTS_PER_DPS, PPM, small_ppm
from station.fibre_gyro.selfcal.evaluate import SelfcalFound
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.result import to_watch as to_watch_of_table
from station.results.as_json import picked
from station.results.contributions import Contribution, budget_document
from station.results.numbers import ppm, with_uncertainty
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = ("self_minus_numbers_ppm", "self_minus_table_ppm")
_EXAMPLE_CHANGE = 100e-6
_EXAMPLE_EPS = 1e-3
_FIT = {
    "scale_factor_self_counts_per_dps": "slope",
    "scale_factor_self_u_counts_per_dps": "slope_u",
    "intercept_counts": "intercept",
    "intercept_u_counts": "intercept_u",
}
_NET = {
    "static_counts": "static",
    "static_u_counts": "static_u",
    "static_drift_counts": "drift",
    "static_drift_u_counts": "drift_u",
}


def result(found: SelfcalFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    fit, net, compared = found.fit, found.net, found.comparison
    against = "K of the table" if found.reference else "K by design"
    numbers = ppm(compared.against_numbers_ppm, compared.against_numbers_u_ppm)
    lines = (
        f"Against {against}: {ppm(compared.difference_ppm, compared.difference_u_ppm)}.",
        f"Against the slope of the injected numbers: {numbers}.",
    )
    measured = [Measured("self_minus_numbers_ppm", compared.against_numbers_ppm)]
    if found.reference is not None:
        measured.append(Measured("self_minus_table_ppm", compared.difference_ppm))
    watched = tuple(_to_watch(found, settings))
    return Result(
        name="result",
        value=f"K_self = {with_uncertainty(fit.slope, fit.slope_u)} {COUNTS_PER_DPS}",
        document=_document(found, settings),
        measured=tuple(measured),
        lines=lines,
        summary=[
            *(("", line) for line in lines),
            ("intercept F_0", f"{with_uncertainty(fit.intercept, _intercept_u(found))} counts"),
            ("static output N_0", f"{with_uncertainty(net.static, net.static_u)} counts"),
        ],
        sentences=tuple(_sentences(found, settings)),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def _intercept_u(found: SelfcalFound) -> float:
    """Standard uncertainty of the intercept, counts, with that of the static output which was taken off."""
    return math.hypot(found.fit.intercept_u, found.net.static_u)


def _document(found: SelfcalFound, settings: FogSettings) -> dict[str, Any]:
    fit, net, compared, reference = found.fit, found.net, found.comparison, found.reference
    columns = {
        "name": found.keys,
        "rate_dps": found.rate_dps,
        "number_counts": found.number,
        "net_counts": net.output,
        "net_u_counts": net.output_u,
        "residual_counts": fit.residual,
    }
    return {
        "path": settings.selfcal.path,
        "numbers": settings.selfcal.numbers,
        **picked(fit, _FIT),
        **picked(net, _NET),
        "static_missing": found.static_missing or None,
        "numbers_slope_counts_per_dps": found.numbers.slope,
        "self_minus_numbers_ppm": compared.against_numbers_ppm,
        "self_minus_numbers_u_ppm": compared.against_numbers_u_ppm,
        "compared_with": "table" if reference else "design",
        "table_scale_factor_counts_per_dps": reference.scale_factor if reference else None,
        "table_scale_factor_u_counts_per_dps": reference.scale_factor_u if reference else None,
        "table_source": reference.source if reference else None,
        "self_minus_table_ppm": compared.difference_ppm if reference else None,
        "self_minus_table_u_ppm": compared.difference_u_ppm if reference else None,
        "self_minus_design_ppm": PPM * (fit.slope / settings.nominal_scale_factor - 1),
        "noise_model": None if found.noise is None else found.noise.source,
        "budget": budget_document(
            f"K_self against K {'of the table' if reference else 'by design'}", _budget(found), _u_ppm(found)
        ),
        "points": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
        "left_out": found.left_out,
    }


def _u_ppm(found: SelfcalFound) -> float:
    """Standard uncertainty of K_self against the scale factor that it is compared with, ppm."""
    return found.comparison.difference_u_ppm


def _budget(found: SelfcalFound) -> list[Contribution]:
    """Say what each input contributes to the uncertainty of K_self against the scale factor of the table."""
    parts, model = found.contributions, found.noise
    by_words = "by the scatter of the words"
    at_rest = "static output, and slow noise between it and the steps"
    if model is None:
        note = "static output; no noise model (--noise): slow noise counts as far as the steps scatter by it"
    else:
        note = f"noise model of {model.source}"
    drift = "interpolated in time" if found.drift_removed else "as large as the static outputs allow"
    table = found.reference.source if found.reference else "compared with K by design, exact by definition"
    return [
        Contribution(
            "noise", "noise within the steps", parts["noise"], True,
            "by the noise model" if found.noise_by_model else by_words,
        ),
        Contribution("slow noise", at_rest, parts["slow noise"], model is not None, note),
        Contribution("scatter", "scatter of the steps beyond these", parts["scatter"], True, "residuals"),
        Contribution("drift", "drift of the bias", parts["drift"], True, drift),
        Contribution("numbers", "numbers for the rates", parts["numbers"], True, _numbers_note(parts)),
        Contribution("table", "scale factor compared with", parts["table"], True, table),
    ]  # fmt: skip


def _numbers_note(parts: Mapping[str, float]) -> str:
    if parts["numbers"] and not parts["table"]:
        return "of the table run, with its scale factor: their errors cancel in part"
    return "of the table run"


def _sentences(found: SelfcalFound, settings: FogSettings) -> list[str]:
    """Say what this self-calibration can see and what it cannot, with the predicted sizes."""
    by_path = _shared_path_sentences if settings.selfcal.path == "shared" else _second_path_sentences
    return by_path(found, gated=settings.gyro.gated_resets)


def _shared_path_sentences(found: SelfcalFound, *, gated: bool) -> list[str]:
    compared = found.comparison
    numbers = ppm(compared.against_numbers_ppm, compared.against_numbers_u_ppm)
    scale = predicted_table_scale(_EXAMPLE_CHANGE, gated=gated)
    return [
        "The injection goes through the feedback's own adder, converter and electrode. The loop makes the sum of "
        "both staircases zero, so the output is the injected number itself: K_self returns the mapping of numbers "
        "to rates that it was given. It is no measurement of the gyro's scale factor.",
        f"K_self differs from the slope of the injected numbers by {numbers}. This is what was tested: the "
        "digital arithmetic, the lock of the loop, its dead zone and the decimation of the output.",
        "It is blind to L·D/λ, that is to the fibre, the coil's temperature and the wavelength: a change of "
        f"{PPM * _EXAMPLE_CHANGE:+.0f} ppm after the numbers were made changes K of the table by "
        f"{PPM * (scale - 1):+.4g} ppm and K_self by nothing, K_self/K_table - 1 = "
        f"{predicted_difference_ppm(1.0, 1.0, scale):+.4g} ppm.",
        _two_pi_sentence(gated=gated),
        "It is blind to the converter's nonlinearity: at rest the sum of both staircases stands still and the "
        "converter does not even move. A cubic error of 0.4 % of full scale shifts K of the table by some +250 "
        "ppm at a Sagnac phase of 0.47 rad (20 deg/s on a coil of 1000 m by 0.1 m), and by more at higher rates, "
        "where reset samples are left out; by less than 1 ppm where all are used; and K_self by nothing.",
    ]


def _two_pi_sentence(*, gated: bool) -> str:
    scale = predicted_table_scale(0.0, _EXAMPLE_EPS, gated=gated)
    begin = (
        f"It is blind to V_2π: a 2π error of {PPM * _EXAMPLE_EPS:+.0f} ppm that comes up after the numbers were "
        "made changes K of the table by"
    )
    if gated:
        return (
            f"{begin} {PPM * (scale - 1):+.5g} ppm, since this gyro leaves reset samples out, and K_self by "
            f"nothing, K_self/K_table - 1 = {predicted_difference_ppm(1.0, 1.0, scale):+.5g} ppm."
        )
    return (
        f"{begin} {small_ppm(PPM * (scale - 1))} only, since this gyro uses the reset samples too, and K_self by "
        "nothing; it shows as a ripple at the reset frequency."
    )


def _second_path_sentences(found: SelfcalFound, *, gated: bool) -> list[str]:
    difference, u = found.comparison.against_numbers_ppm, found.comparison.against_numbers_u_ppm
    own = PPM * (predicted_self_scale("separate", 0.0, _EXAMPLE_EPS, gated=gated) - 1)
    feedback = PPM * (predicted_self_scale("separate", _EXAMPLE_EPS, gated=gated) - 1)
    differs = f"K_self differs from the slope of the injected numbers by {ppm(difference, u)}."
    if gated:
        implied = ppm(-difference / (1 + difference / PPM), u)
        differs += f" With an exact injection path that is a 2π error of the feedback of {implied}."
        sees = (
            f"It does see V_2π of the feedback path: +{PPM * _EXAMPLE_EPS:.0f} ppm there changes K_self by "
            f"{feedback:+.5g} ppm, as K of the table, so with a stable injection path K_self follows the table."
        )
    else:
        sees = (
            "V_2π of the feedback path changes neither K of the table nor K_self by more than "
            f"{abs(feedback):.1g} ppm for 1000 ppm, since this gyro uses the reset samples too."
        )
    return [
        "The injection goes through a second electrode with a converter of its own; the feedback answers with its "
        "own converter. K_self is the mapping of numbers to rates times the ratio of both paths' gains.",
        differs,
        sees,
        f"It sees the gain of its own injection path as an error: +{PPM * _EXAMPLE_EPS:.0f} ppm there changes "
        f"K_self by {own:+.5g} ppm and K of the table by nothing.",
        "It is blind to L·D/λ, that is to the fibre, the coil's temperature and the wavelength: both staircases "
        "are phases of the modulator, no rotation is compared with them. For that it takes the table.",
    ]


def _to_watch(found: SelfcalFound, settings: FogSettings) -> list[str]:
    net, fit = found.net, found.fit
    said = [f"{one.sentence}." for one in found.left_out]
    if found.static_missing:
        said.append(
            f"There is no static output {found.static_missing} the steps: a drift of the bias is not seen."
        )
    if abs(net.drift) > 3 * net.drift_u:
        drift = with_uncertainty(net.drift, net.drift_u)
        said.append(
            f"The static output moved by {drift} counts between before and after: the bias drifts. It was "
            "interpolated in time."
        )
    if abs(fit.intercept) > 4 * _intercept_u(found):
        said.append(
            f"The intercept F_0 is {with_uncertainty(fit.intercept, fit.intercept_u)} counts and not zero within "
            "its uncertainty: a dead zone, a drift of the bias, or steps that are not equal in both senses."
        )
    if fit.chi_square > 4 * fit.degrees_of_freedom:
        said.append(
            "The points lie off the line by more than their noise; the uncertainties were widened to match."
        )
    said += found.remarks
    return said + (to_watch_of_table(found.table, settings) if found.table is not None else [])
