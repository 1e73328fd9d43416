"""The figures of merit as numbers and sentences."""

from __future__ import annotations

import math
from typing import Any

from analysis.fibre_gyro import TurnOn
from station.fibre_gyro.common import COUNTS_PER_DPS, undecided_limits
from station.fibre_gyro.merit.evaluate import AxisMerit, MeritFound, MeritRun
from station.fibre_gyro.settings import FogSettings
from station.results.as_json import picked
from station.results.numbers import with_uncertainty
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = (
    "nonlinearity_ppm",
    "nonlinearity_of_point_ppm",
    "asymmetry_ppm",
    "repeatability_ppm",
    "temperature_coefficient_ppm",
    "bias_repeatability_dph",
    "turn_on_transient_dph",
    "warm_up_s",
)
_GJB_RATES = 11
_CAUSES = {
    "odd": "odd in the rate (cubic: resets, converter)",
    "even": "even in the rate (asymmetry)",
    "near zero": "near zero (dead zone)",
    "scatter": "irregular beyond their noise (bias, scale factor or table change between the rates)",
}
_FIT = {
    "scale_factor_counts_per_dps": "slope",
    "scale_factor_u_counts_per_dps": "slope_u",
    "intercept_counts": "intercept",
    "intercept_u_counts": "intercept_u",
}
_FIGURES = {
    "scale_factor_positive_counts_per_dps": "scale_factor_positive",
    "scale_factor_negative_counts_per_dps": "scale_factor_negative",
    "nonlinearity_ppm": "nonlinearity_ppm",
    "nonlinearity_u_ppm": "nonlinearity_u_ppm",
    "nonlinearity_of_point_ppm": "nonlinearity_of_point_ppm",
    "asymmetry_ppm": "asymmetry_ppm",
    "asymmetry_u_ppm": "asymmetry_u_ppm",
    "deviation_of_full_scale_ppm": "deviation_of_full_scale_ppm",
    "deviation_of_point_ppm": "deviation_of_point_ppm",
}
_PATTERN = {"pattern": "names", "odd_ppm": "odd_ppm", "even_ppm": "even_ppm", "near_zero_ppm": "near_zero_ppm"}


def result(found: MeritFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    lines = tuple(line for one in found.axes for line in _lines(one, several=len(found.axes) > 1))
    watched = tuple(_to_watch(found, settings))
    return Result(
        name="result",
        value=f"Nonlinearity {found.largest('nonlinearity_ppm'):.3g} ppm of full scale",
        document=_document(found),
        measured=_measured(found),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(_sentences(found)),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
    )


def _lines(one: AxisMerit, *, several: bool) -> tuple[str, ...]:
    begin = f"Axis {one.axis}: nonlinearity {_ppm(one.nonlinearity_ppm)}, asymmetry" if several else "Asymmetry"
    return (
        f"{begin} {_ppm(one.asymmetry_ppm)}, repeatability {_ppm(one.repeatability_ppm)} "
        f"({len(one.runs)} runs), temperature coefficient {_ppm(one.temperature_coefficient_ppm)}/K.",
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
    return said


def _measured(found: MeritFound) -> tuple[Measured, ...]:
    if len(found.axes) == 1:
        return tuple(Measured(name, getattr(found.axes[0], name)) for name in LIMITED)
    return tuple(Measured(name, getattr(one, name), one.axis) for one in found.axes for name in LIMITED)


def _document(found: MeritFound) -> dict[str, Any]:
    """Of one axis as of old; of several the largest figures, no common scale factor, and each axis by itself."""
    alone = found.axes[0] if len(found.axes) == 1 else None
    return {
        "style": "GJB and IEEE style; nonlinearity is of full scale unless its name says of_point",
        **(_scale(alone) if alone else dict.fromkeys(_scale(found.axes[0]))),
        **{name: found.largest(name) for name in LIMITED},
        **(_intervals(alone) if alone else {}),
        "runs": [_run(run) for one in found.axes for run in one.runs],
        "at_temperatures": [_run(run) for one in found.axes for run in one.at_temperatures],
        "axes": [
            {"axis": one.axis, **_scale(one), **{name: getattr(one, name) for name in LIMITED}, **_intervals(one)}
            for one in found.axes
        ],
        "left_out": found.left_out,
    }


def _scale(one: AxisMerit) -> dict[str, float]:
    return {
        "scale_factor_counts_per_dps": one.scale_factor,
        "scale_factor_u_counts_per_dps": one.scale_factor_u,
        # IEEE texts give input over output
        "input_per_count_dph": 3600 / one.scale_factor,
    }


def _intervals(one: AxisMerit) -> dict[str, float | None]:
    """95 % intervals of what has one; the noise of the bias; the bound of the warm-up."""
    bias, slowest = one.bias, one.slowest
    return {
        "bias_repeatability_low_95_dph": bias.low_95 if bias else None,
        "bias_repeatability_high_95_dph": bias.high_95 if bias else None,
        "bias_noise_u_dph": bias.noise_u if bias else None,
        "warm_up_low_95_s": slowest.warm_up_low_95_s if slowest else None,
        "warm_up_high_95_s": slowest.warm_up_high_95_s if slowest else None,
        "warm_up_bound_dph": slowest.bound if slowest else None,
    }


def _ppm(value: float) -> str:
    return f"{value:.3g} ppm" if math.isfinite(value) else "none"


def _run(one: MeritRun) -> dict[str, Any]:
    return {
        "name": one.name,
        "temperature_c": one.temperature_c,
        **picked(one.figures.fit, _FIT),
        "static_drift_counts": one.static_drift,
        "bias_dph": one.bias_dph,
        "bias_u_dph": one.bias_u_dph,
        "turn_on": _turn_on(one.turn_on),
        **picked(one.figures, _FIGURES),
        **picked(one.pattern, _PATTERN),
        "rate_dps": one.rate_dps,
        "net_counts": one.output,
    }


def _turn_on(one: TurnOn | None) -> dict[str, Any] | None:
    if one is None:
        return None
    return {
        "exponentials": one.exponentials,
        "time_constants_s": one.time_constants_s,
        "transient_dph": one.transient,
        "transient_u_dph": one.transient_u,
        "transient_low_95_dph": one.transient_low_95,
        "transient_high_95_dph": one.transient_high_95,
        "warm_up_s": one.warm_up_s,
        "warm_up_low_95_s": one.warm_up_low_95_s,
        "warm_up_high_95_s": one.warm_up_high_95_s,
        "ends": one.ends,
    }


def _sentences(found: MeritFound) -> list[str]:
    """Say which pattern the deviations have."""
    said = [
        f"{one.name}: the deviations are {', and '.join(_CAUSES[name] for name in one.pattern.names)}."
        for axis in found.axes
        for one in axis.all_runs
        if one.pattern.names
    ]
    return said or ["The deviations from the line show no pattern beyond their noise."]


def _to_watch(found: MeritFound, settings: FogSettings) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    for one in [run for axis in found.axes for run in axis.all_runs]:
        said += _to_watch_in(one)
    for axis in found.axes:
        document = {name: getattr(axis, name) for name in LIMITED} | _intervals(axis)
        said += undecided_limits([document], LIMITED, settings)
    return said


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
    if one.turn_on is not None and not one.turn_on.ends:
        said.append(
            f"{one.name}: the record from switching on is too short to show that the bias stays within "
            f"{one.turn_on.bound:g} deg/h: record longer (figures.turn_on_s)."
        )
    return [*said, *one.remarks]
