"""The figures of merit as numbers and sentences."""

from __future__ import annotations

import math
from typing import Any

from station.fibre_gyro.common import COUNTS_PER_DPS
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
    watched = tuple(_to_watch(found))
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
    )


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
        "runs": [_run(run) for one in found.axes for run in one.runs],
        "at_temperatures": [_run(run) for one in found.axes for run in one.at_temperatures],
        "axes": [
            {"axis": one.axis, **_scale(one), **{name: getattr(one, name) for name in LIMITED}}
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


def _ppm(value: float) -> str:
    return f"{value:.3g} ppm" if math.isfinite(value) else "none"


def _run(one: MeritRun) -> dict[str, Any]:
    return {
        "name": one.name,
        "temperature_c": one.temperature_c,
        **picked(one.figures.fit, _FIT),
        "static_drift_counts": one.static_drift,
        **picked(one.figures, _FIGURES),
        **picked(one.pattern, _PATTERN),
        "rate_dps": one.rate_dps,
        "net_counts": one.output,
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


def _to_watch(found: MeritFound) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    for one in [run for axis in found.axes for run in axis.all_runs]:
        said += _to_watch_in(one)
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
    return [*said, *one.remarks]
