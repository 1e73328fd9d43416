"""The rate-table run as numbers and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from analysis.fibre_gyro import NORMAL_95, Linearity, ThreeAxes, vertical_earth_rate_dph
from station.fibre_gyro.common import COUNTS_PER_DPS, PPM
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.budget import axis_budget, noise_sentence
from station.fibre_gyro.table.evaluate import AxisResult, TableFound
from station.results.as_json import picked
from station.results.numbers import ppm, with_uncertainty
from station.results.parts import TextTable
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = ("nominal_difference_ppm", "scale_factor_u_ppm", "scatter_ppm")
_FIT = {
    "scale_factor_counts_per_dps": "scale_factor",
    "scale_factor_u_counts_per_dps": "scale_factor_u",
    "even_part_counts": "even",
    "even_part_u_counts": "even_u",
    "chi_square": "chi_square",
    "degrees_of_freedom": "degrees_of_freedom",
    "scatter_ppm": "scatter_ppm",
    "angle_random_walk_deg_per_sqrt_h": "angle_random_walk",
}
_WINDOW = {
    "turns": "turns",
    "window_s": "duration_s",
    "samples": "samples",
    "sum_counts": "total",
    "mean_counts": "mean",
    "mean_u_counts": "mean_u",
    "missing": "missing",
    "outliers": "outliers",
}


def result(found: TableFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    axes = [_axis(one, settings) for one in found.axes]
    fits = [(one.axis, one.fit) for one in found.axes]
    lines = (
        f"{COUNTS_PER_DPS}; by design {settings.nominal_scale_factor:.6f}.",
        f"From {sum(len(one.keys) for one in found.axes)} runs over whole turns, by least squares.",
    )
    watched = tuple(to_watch(found, settings))
    return Result(
        name="result",
        value="; ".join(f"K({axis}) = {with_uncertainty(f.scale_factor, f.scale_factor_u)}" for axis, f in fits),
        document={
            "axes": axes,
            "nominal_scale_factor_counts_per_dps": settings.nominal_scale_factor,
            "irreproducibility_ppm": settings.table.irreproducibility_ppm,
            "matrix": _matrix(found.matrix),
            "left_out": found.left_out,
        },
        measured=tuple(_measured(axis, name) for axis in axes for name in LIMITED),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=(
            _even_part_sentence(settings),
            *(said for one in found.axes if (said := noise_sentence(one))),
            *(said for one in found.axes if (said := _ladder_sentence(one))),
        ),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
        tables=tuple(_tables(found)),
    )


def _tables(found: TableFound) -> Iterator[TextTable]:
    yield _axes_on_terminal(found)
    if any(one.linearity is not None for one in found.axes):
        yield ladder_table(found.axes)
    if found.matrix is not None:
        yield matrix_table(found.matrix)


def _measured(axis: dict[str, Any], name: str) -> Measured:
    u = axis["scale_factor_u_ppm"] if name == "nominal_difference_ppm" else math.nan
    return Measured(name, axis[name], axis["axis"], u)


def _matrix(matrix: ThreeAxes | None) -> dict[str, Any] | None:
    if matrix is None:
        return None
    return {
        "gyros": matrix.gyros,
        "turned": matrix.turned,
        "scale_factors_counts_per_dps": matrix.matrix,
        "scale_factors_u_counts_per_dps": matrix.matrix_u,
        "along_input_axis_counts_per_dps": matrix.scale_factor,
        "along_input_axis_u_counts_per_dps": matrix.scale_factor_u,
        "misalignment_mrad": matrix.misalignment_mrad,
        "misalignment_u_mrad": matrix.misalignment_u_mrad,
        "bias_counts": matrix.bias,
        "bias_u_counts": matrix.bias_u,
    }


def matrix_table(matrix: ThreeAxes) -> TextTable:
    """Return scale factors and misalignments of all gyros."""
    rows = []
    for place, gyro in enumerate(matrix.gyros):
        cells = [gyro]
        for other, axis in enumerate(matrix.turned):
            angle, u = (
                float(matrix.misalignment_mrad[place, other]),
                float(matrix.misalignment_u_mrad[place, other]),
            )
            own = with_uncertainty(float(matrix.matrix[place, other]), float(matrix.matrix_u[place, other]))
            cells.append(own if axis == gyro or not math.isfinite(angle) else f"{with_uncertainty(angle, u)} mrad")
        rows.append((*cells, with_uncertainty(float(matrix.bias[place]), float(matrix.bias_u[place]))))
    header = ("gyro", *(f"about {axis}" for axis in matrix.turned), "bias, counts")
    return TextTable(header, tuple(rows))


def _axis(one: AxisResult, settings: FogSettings) -> dict[str, Any]:
    fit, nominal = one.fit, settings.nominal_scale_factor
    rates = {"even_part": fit.even_dph, "bias": one.bias_dph, "vertical_earth_rate": fit.earth_rate_dph}
    rows = zip(one.keys, one.runs.rate_dps, one.windows, fit.residual_ppm, strict=True)
    return {
        "axis": one.axis,
        **picked(fit, _FIT),
        "scale_factor_u_ppm": PPM * fit.scale_factor_u / abs(fit.scale_factor),
        "nominal_difference_ppm": PPM * (fit.scale_factor / nominal - 1),
        "scale_factor_at_base_rate_counts_per_dps": one.parts.odd[0] / one.parts.rate_dps[0],
        **{f"{name}_dph": value for name, (value, _) in rates.items()},
        **{f"{name}_u_dph": u for name, (_, u) in rates.items()},
        "bias_drift_dph_per_h": fit.drift_dph_per_h[0],
        "bias_drift_u_dph_per_h": fit.drift_dph_per_h[1],
        **_tilt(one),
        "differences": _differences(one),
        "linearity": None if one.linearity is None else _linearity(one.linearity),
        "noise_model": None if one.noise is None else one.noise.source,
        "budget": axis_budget(one, settings),
        "points": [
            {"name": key, "table_rate_dps": rate, **picked(window, _WINDOW), "residual_ppm": residual}
            for key, rate, window, residual in rows
        ],
    }


def _tilt(one: AxisResult) -> dict[str, float | None]:
    tilt = one.tilt
    return {
        "input_axis_tilt_mrad": tilt.tilt_mrad if tilt else None,
        "input_axis_tilt_low_95_mrad": tilt.low_95_mrad if tilt else None,
        "input_axis_tilt_high_95_mrad": tilt.high_95_mrad if tilt else None,
    }


def _linearity(ladder: Linearity) -> dict[str, Any]:
    terms = {}
    for name, value in ladder.value.items():
        u = ladder.value_u[name]
        terms[f"{name}_ppm"] = value
        terms[f"{name}_u_ppm"] = u
        terms[f"{name}_low_95_ppm"], terms[f"{name}_high_95_ppm"] = value - NORMAL_95 * u, value + NORMAL_95 * u
    columns = (ladder.rate_dps, ladder.error_ppm, ladder.error_u_ppm)
    return {
        "terms": ladder.chosen,
        **terms,
        "nonlinearity_rms_ppm": ladder.rms_ppm,
        "nonlinearity_rms_low_95_ppm": ladder.rms_low_95_ppm,
        "nonlinearity_rms_high_95_ppm": ladder.rms_high_95_ppm,
        "nonlinearity_ppm": ladder.largest_ppm,
        "nonlinearity_low_95_ppm": ladder.largest_low_95_ppm,
        "nonlinearity_high_95_ppm": ladder.largest_high_95_ppm,
        "points": [
            {"rate_dps": rate, "error_ppm": error, "error_u_ppm": u}
            for rate, error, u in zip(*columns, strict=True)
        ],
    }


def ladder_table(axes: Sequence[AxisResult]) -> TextTable:
    """Return the terms of the scale-factor error and the nonlinearity of every axis that was run over a ladder."""
    rows = []
    for one in axes:
        ladder = one.linearity
        if ladder is None:
            continue
        for name, value in ladder.value.items():
            u = ladder.value_u[name]
            low, high = value - NORMAL_95 * u, value + NORMAL_95 * u
            seen = "in the polynomial" if name in ladder.chosen else "not seen"
            rows.append((f"{one.axis}, {name}", with_uncertainty(value, u), f"{low:+.3g} to {high:+.3g}", seen))
        rms = f"{ladder.rms_low_95_ppm:.3g} to {ladder.rms_high_95_ppm:.3g}"
        largest = f"{ladder.largest_low_95_ppm:.3g} to {ladder.largest_high_95_ppm:.3g}"
        rows.append((f"{one.axis}, nonlinearity, rms", f"{ladder.rms_ppm:.3g}", rms, "freed of noise"))
        rows.append((f"{one.axis}, nonlinearity, largest", f"{ladder.largest_ppm:.3g}", largest, "freed of noise"))
    return TextTable(("scale-factor error at the largest rate", "ppm", "95 %", ""), tuple(rows))


def _ladder_sentence(one: AxisResult) -> str:
    ladder = one.linearity
    if ladder is None:
        return ""
    interval = f"{ladder.rms_low_95_ppm:.2g} to {ladder.rms_high_95_ppm:.2g} ppm of full scale"
    if not ladder.chosen:
        return (
            f"{one.axis}: over the rates the output is a straight line within its noise; freed of it the "
            f"nonlinearity is {interval} (rms, 95 %)."
        )
    terms = ", ".join(f"{name} {ppm(ladder.value[name], ladder.value_u[name])}" for name in ladder.chosen)
    return (
        f"{one.axis}: over the rates the scale factor changes; in the polynomial: {terms}. Freed of noise the "
        f"nonlinearity is {ladder.rms_ppm:.2g} ppm of full scale, {interval} (rms, 95 %). K is that of the "
        "straight line, and what the output lies off it counts in its uncertainty."
    )


def _differences(one: AxisResult) -> list[dict[str, Any]]:
    made = one.differences
    if made is None:
        return []
    columns = {
        "delta_dps": made.delta_dps.round(9),
        "number_counts": made.number,
        "noise_u_counts": made.noise_u,
        "irreproducibility_u_counts": made.irreproducibility_u,
        "relative_u_ppm": made.relative_u_ppm,
        "number_u_counts": made.number_u,
        "number_low_95_counts": made.number - NORMAL_95 * made.number_u,
        "number_high_95_counts": made.number + NORMAL_95 * made.number_u,
        "from_fit_ppm": PPM * (made.number / (one.fit.scale_factor * made.delta_dps) - 1),
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _even_part_sentence(settings: FogSettings) -> str:
    """Say what the even part is made of."""
    vertical = vertical_earth_rate_dph(settings.site.latitude_deg)
    if settings.table.both_ends_up:
        return (
            "Each axis was turned with both ends up, so the vertical earth rate and the bias are told apart by "
            f"the data; at latitude {settings.site.latitude_deg:g}° the earth rate is {vertical:.3f} deg/h."
        )
    return (
        "The even part holds the vertical earth rate and the bias together; the bias given here rests on the "
        f"earth rate of {vertical:.3f} deg/h at latitude {settings.site.latitude_deg:g}°. Runs with both ends of "
        "the axis up (table.both_ends_up) tell them apart."
    )


def to_watch(found: TableFound, settings: FogSettings) -> list[str]:
    """Say what spoils a rate-table run or may spoil it, also one within a self-calibration."""
    said = [f"{one.sentence}." for one in found.left_out]
    for one in found.axes:
        said += _to_watch_of(one, settings)
    return said


def _to_watch_of(one: AxisResult, settings: FogSettings) -> list[str]:
    said, fit, made = [], one.fit, one.differences
    if made is not None:
        smallest = int(abs(made.delta_dps).argmin())
        delta, relative = float(made.delta_dps[smallest]), float(made.relative_u_ppm[smallest])
        if relative > 1e4:
            said.append(
                f"{one.axis}: the number for {delta:.4g} deg/s is good to {relative / 1e4:.2g} % only; it is the "
                f"difference of two numbers that are {made.base_dps / abs(delta):.0f} times larger. Use K by "
                "least squares."
            )
    stated = settings.table.irreproducibility_ppm
    if fit.scatter_assumed:
        said.append(
            f"{one.axis}: no run repeats another, so their scatter does not show; 10 ppm of table rate and scale "
            "factor from run to run are counted. Repeated runs or table.irreproducibility_ppm say it."
        )
    elif stated is not None and fit.chi_square > 3 * fit.degrees_of_freedom:
        said.append(
            f"{one.axis}: the runs scatter by {fit.scatter_ppm:.2g} ppm, more than their noise and the "
            f"{stated:g} ppm of table.irreproducibility_ppm; the uncertainties were widened to match."
        )
    drift, drift_u = fit.drift_dph_per_h
    if abs(drift) > 3 * drift_u:
        said.append(
            f"{one.axis}: the bias drifted by {with_uncertainty(drift, drift_u)} deg/h per h; it is taken out."
        )
    said += one.remarks
    return said


def _axes_on_terminal(found: TableFound) -> TextTable:
    rows = tuple(
        (
            one.axis,
            with_uncertainty(one.fit.scale_factor, one.fit.scale_factor_u),
            with_uncertainty(*one.fit.even_dph),
            with_uncertainty(*one.bias_dph),
            ppm(one.fit.scatter_ppm).lstrip("+"),
        )
        for one in found.axes
    )
    return TextTable(("axis", f"K, {COUNTS_PER_DPS}", "even part, deg/h", "bias, deg/h", "scatter"), rows)
