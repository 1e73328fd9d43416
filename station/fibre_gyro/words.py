"""What the results mean, in sentences: for the report and for the terminal."""

from __future__ import annotations

import math

from analysis.fibre_gyro import (
    predicted_difference_ppm,
    predicted_self_scale,
    predicted_table_scale,
    vertical_earth_rate_dph,
)
from station.fibre_gyro.eps.measurement import EpsEvaluation
from station.fibre_gyro.figures.measurement import FiguresEvaluation
from station.fibre_gyro.selfcal.measurement import SelfcalEvaluation
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.measurement import AxisResult, TableEvaluation
from station.lock_in.sentences import with_uncertainty

_PPM = 1e6
_EXAMPLE_CHANGE = 100e-6
_EXAMPLE_EPS = 1e-3
_INL_WORDS = (
    "It is blind to the converter's nonlinearity: at rest the sum of both staircases stands still and the "
    "converter "
    "does not even move. A cubic error of 0.4 % of full scale shifts K of the table by some +250 ppm at a "
    "Sagnac phase "
    "of 0.47 rad (20 deg/s on a coil of 1000 m by 0.1 m), and by more at higher rates, where reset samples are "
    "left "
    "out; by less than 1 ppm where all are used; and K_self by nothing."
)


def ppm_words(value: float, u: float = math.nan) -> str:
    """Write a signed value in ppm with its uncertainty.

    Examples
    --------
    >>> ppm_words(999.9213, 0.43), ppm_words(float("nan"))
    ('+999.92(43) ppm', 'none')
    """
    if not math.isfinite(value):
        return "none"
    text = with_uncertainty(value, u) if math.isfinite(u) and u > 0 else f"{value:.4g}"
    return f"{'' if text.startswith('-') else '+'}{text} ppm"


def table_sentences(evaluation: TableEvaluation, settings: FogSettings) -> list[str]:
    """Say what the table run found beside K."""
    said = [one.sentence + "." for one in evaluation.left_out]
    for result in evaluation.axes:
        said += _axis_sentences(result, settings)
    return said


def _axis_sentences(result: AxisResult, settings: FogSettings) -> list[str]:
    said, fit = [], result.fit
    if result.differences is not None:
        smallest = int(abs(result.differences.delta_dps).argmin())
        relative = float(result.differences.relative_u_ppm[smallest])
        if relative > 1e4:
            said.append(
                f"{result.axis}: the number for {result.differences.delta_dps[smallest]:.4g} deg/s is good to "
                f"{relative / 1e4:.2g} % only; it is the difference of two numbers that are "
                f"{result.differences.base_dps / abs(result.differences.delta_dps[smallest]):.0f} times larger. "
                "Use K by least squares."
            )
    if fit.degrees_of_freedom and fit.chi_square > 3 * fit.degrees_of_freedom:
        said.append(
            f"{result.axis}: the runs scatter by {fit.scatter_ppm:.2g} ppm, more than their noise and the "
            f"{settings.table.irreproducibility_ppm:g} ppm of table.irreproducibility_ppm; the uncertainties were "
            "widened to match."
        )
    return said


def even_part_sentence(settings: FogSettings) -> str:
    """Say what the even part is made of."""
    vertical = vertical_earth_rate_dph(settings.site.latitude_deg)
    if settings.table.both_ends_up:
        return (
            "Each axis was turned with both ends up, so the vertical earth rate and the bias are told apart by "
            "the "
            f"data; at latitude {settings.site.latitude_deg:g}° the earth rate is {vertical:.3f} deg/h."
        )
    return (
        f"The even part holds the vertical earth rate and the bias together; the bias given here rests on the "
        f"earth rate of {vertical:.3f} deg/h at latitude {settings.site.latitude_deg:g}°. Runs with both ends of "
        "the axis up (table.both_ends_up) tell them apart."
    )


def selfcal_sentences(evaluation: SelfcalEvaluation, settings: FogSettings) -> list[str]:
    """Say what this self-calibration can see and what it cannot, with the predicted sizes."""
    shared = settings.selfcal.path == "shared"
    return [*(_shared_path_words(evaluation, settings) if shared else _second_path_words(evaluation, settings))]


def _shared_path_words(evaluation: SelfcalEvaluation, settings: FogSettings) -> list[str]:
    compared, gated = evaluation.comparison, settings.gyro.gated_resets
    scale = predicted_table_scale(_EXAMPLE_CHANGE, gated=gated)
    turned = predicted_table_scale(0.0, _EXAMPLE_EPS, gated=gated)
    return [
        "The injection goes through the feedback's own adder, converter and electrode. The loop makes the sum "
        "of both "
        "staircases zero, so the output is the injected number itself: K_self returns the mapping of numbers to "
        "rates "
        "that it was given. It is no measurement of the gyro's scale factor.",
        f"K_self differs from the slope of the injected numbers by "
        f"{ppm_words(compared.against_numbers_ppm, compared.against_numbers_u_ppm)}. This is what was tested: the "
        "digital arithmetic, the lock of the loop, its dead zone and the decimation of the output.",
        f"It is blind to L·D/λ, that is to the fibre, the coil's temperature and the wavelength: a change of "
        f"{_PPM * _EXAMPLE_CHANGE:+.0f} ppm after the numbers were made changes K of the table by "
        f"{_PPM * (scale - 1):+.4g} ppm and K_self by nothing, K_self/K_table - 1 = "
        f"{predicted_difference_ppm(1.0, 1.0, scale):+.4g} ppm.",
        f"It is blind to V_2π: {_two_pi_words(turned, gated)}",
        _INL_WORDS,
    ]


def _two_pi_words(table_scale: float, gated: bool) -> str:
    size = f"a 2π error of {_PPM * _EXAMPLE_EPS:+.0f} ppm that comes up after the numbers were made"
    difference = predicted_difference_ppm(1.0, 1.0, table_scale)
    if gated:
        return (
            f"{size} changes K of the table by {_PPM * (table_scale - 1):+.5g} ppm, since this gyro leaves reset "
            f"samples out, and K_self by nothing, K_self/K_table - 1 = {difference:+.5g} ppm."
        )
    return (
        f"{size} changes K of the table by {_small_words(_PPM * (table_scale - 1))} only, since this gyro uses "
        "the "
        "reset "
        "samples too, and K_self by nothing; it shows as a ripple at the reset frequency."
    )


def _second_path_words(evaluation: SelfcalEvaluation, settings: FogSettings) -> list[str]:
    compared, gated = evaluation.comparison, settings.gyro.gated_resets
    implied = -compared.against_numbers_ppm / (1 + compared.against_numbers_ppm / _PPM)
    implied_words = (
        f" With an exact injection path that is a 2π error of the feedback of "
        f"{ppm_words(implied, compared.against_numbers_u_ppm)}."
        if gated
        else ""
    )
    own = _PPM * (predicted_self_scale("separate", 0.0, _EXAMPLE_EPS, gated=gated) - 1)
    feedback = _PPM * (predicted_self_scale("separate", _EXAMPLE_EPS, gated=gated) - 1)
    return [
        "The injection goes through a second electrode with a converter of its own; the feedback answers with its "
        "own converter. K_self is the mapping of numbers to rates times the ratio of both paths' gains.",
        f"K_self differs from the slope of the injected numbers by "
        f"{ppm_words(compared.against_numbers_ppm, compared.against_numbers_u_ppm)}.{implied_words}",
        f"It does see V_2π of the feedback path: +{_PPM * _EXAMPLE_EPS:.0f} ppm there changes K_self by "
        f"{feedback:+.5g} ppm, as K of the table, so with a stable injection path K_self follows the table."
        if gated
        else "V_2π of the feedback path changes neither K of the table nor K_self by more than "
        f"{abs(feedback):.1g} "
        "ppm for 1000 ppm, since this gyro uses the reset samples too.",
        f"It sees the gain of its own injection path as an error: +{_PPM * _EXAMPLE_EPS:.0f} ppm there changes "
        "K_self "
        f"by {own:+.5g} ppm and K of the table by nothing.",
        "It is blind to L·D/λ, that is to the fibre, the coil's temperature and the wavelength: both staircases "
        "are "
        "phases of the modulator, no rotation is compared with them. For that it takes the table.",
    ]


def selfcal_flags(evaluation: SelfcalEvaluation) -> list[str]:
    """Say what is to be watched in this result."""
    said = [one.sentence + "." for one in evaluation.left_out]
    if evaluation.static_missing:
        said.append(
            f"There is no static output {evaluation.static_missing} the steps: a drift of the bias is not seen."
        )
    net, fit = evaluation.net, evaluation.fit
    if abs(net.drift) > 4 * net.drift_u:
        said.append(
            f"The static output moved by {with_uncertainty(net.drift, net.drift_u)} counts between before and "
            "after: "
            "the bias drifts."
        )
    if abs(fit.intercept) > 4 * math.hypot(fit.intercept_u, net.static_u):
        said.append(
            f"The intercept F_0 is {with_uncertainty(fit.intercept, fit.intercept_u)} counts and not zero "
            "within its "
            "uncertainty: a dead zone, a drift of the bias, or steps that are not equal in both senses."
        )
    if fit.chi_square > 4 * fit.degrees_of_freedom:
        said.append(
            "The points lie off the line by more than their noise; the uncertainties were widened to match."
        )
    return said


def eps_sentences(evaluation: EpsEvaluation, settings: FogSettings) -> list[str]:
    """Say what the 2 pi error means for the scale factor, and what this test does not see."""
    eps, u = evaluation.result.two_pi_error, evaluation.result.two_pi_error_u
    gated, ungated = (_PPM * (predicted_table_scale(0.0, eps, gated=kind) - 1) for kind in (True, False))
    used = "leaves reset samples out" if settings.gyro.gated_resets else "uses all samples"
    return [
        "The feedback is held and a large step injected: sample pairs with a reset differ from those without by "
        "the "
        f"2π error alone. The converter's range spans 2π (1 + eps), eps = {ppm_words(_PPM * eps, _PPM * u)}; the "
        "detector's amplitude is the only calibration, and it comes from the same data.",
        f"In closed loop such an eps changes K of the rate table by {gated:+.5g} ppm where reset samples are "
        "left out, "
        f"and by {_small_words(ungated)} where all are used; this gyro {used}.",
        "It does not see L·D/λ: for that it takes the table. A self-calibration through the shared path sees "
        "neither.",
    ]


def _small_words(value: float) -> str:
    return f"{value:+.2g} ppm" if abs(value) >= 0.01 else "less than 0.01 ppm"


def eps_flags(evaluation: EpsEvaluation) -> list[str]:
    """Say what is to be watched in this result."""
    said = [one.sentence + "." for one in evaluation.left_out]
    result = evaluation.result
    if result.degrees_of_freedom > 0 and result.chi_square > 4 * result.degrees_of_freedom:
        said.append(
            "The steps do not agree within their noise: the converter is not linear, or the feedback was not held."
        )
    return said


def figures_sentences(evaluation: FiguresEvaluation) -> list[str]:
    """Say which pattern the residuals have."""
    causes = {
        "odd": "odd in the rate (cubic: resets, converter)",
        "even": "even in the rate (asymmetry)",
        "near zero": "near zero (dead zone)",
    }
    said = []
    for run in (*evaluation.runs, *evaluation.at_temperatures):
        if run.pattern.names:
            said.append(
                f"{run.name}: the deviations are {', and '.join(causes[name] for name in run.pattern.names)}."
            )
    return said or ["The deviations from the line show no pattern beyond their noise."]


def figures_flags(evaluation: FiguresEvaluation) -> list[str]:
    """Say what is to be watched in this result."""
    said = [one.sentence + "." for one in evaluation.left_out]
    for run in (*evaluation.runs, *evaluation.at_temperatures):
        if not math.isfinite(run.static_drift):
            said.append(
                f"{run.name}: a static output before or after is missing, a drift of the bias is not seen."
            )
        elif abs(run.static_drift) > 4 * run.static_drift_u:
            said.append(f"{run.name}: the static output drifted by {run.static_drift:+.3g} counts.")
        senses = [sum(1 for rate in set(run.rate_dps) if sense * rate > 0) for sense in (1, -1)]
        if min(senses) < 11:
            said.append(
                f"{run.name}: {senses[0]} rates in one sense and {senses[1]} in the other; GJB style asks for "
                "11 in each."
            )
    return said
