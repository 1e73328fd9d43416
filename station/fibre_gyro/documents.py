"""The results as JSON documents, with the names that programs rely on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from analysis.fibre_gyro import RateDifferences
from station.fibre_gyro.eps.measurement import EpsEvaluation
from station.fibre_gyro.figures.measurement import FiguresEvaluation, FiguresRun
from station.fibre_gyro.selfcal.measurement import SelfcalEvaluation
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.measurement import AxisResult, TableEvaluation
from station.fibre_gyro.witness.measurement import WitnessedRecord, WitnessEvaluation

_PPM = 1e6


def number(value: object) -> float | None:
    """Return a float as JSON has it: ``None`` for what is not finite."""
    plain = float(value)  # type: ignore[arg-type]  # a zero-dimensional array or a scalar
    return plain if math.isfinite(plain) else None


def numbers(values: Sequence[Any] | Any) -> list[float | None]:
    """Return an array as JSON has it."""
    return [number(value) for value in values]


def table_document(evaluation: TableEvaluation, settings: FogSettings) -> dict[str, Any]:
    """Return the rate-table result as plain JSON."""
    return {
        "axes": [_axis(result, settings) for result in evaluation.axes],
        "nominal_scale_factor_counts_per_dps": settings.nominal_scale_factor,
        "irreproducibility_ppm": settings.table.irreproducibility_ppm,
        "left_out": [one.as_json() for one in evaluation.left_out],
    }


def _axis(result: AxisResult, settings: FogSettings) -> dict[str, Any]:
    fit, nominal = result.fit, settings.nominal_scale_factor
    document: dict[str, Any] = {
        "axis": result.axis,
        "scale_factor_counts_per_dps": number(fit.scale_factor),
        "scale_factor_u_counts_per_dps": number(fit.scale_factor_u),
        "scale_factor_u_ppm": number(_PPM * fit.scale_factor_u / abs(fit.scale_factor)),
        "nominal_difference_ppm": number(_PPM * (fit.scale_factor / nominal - 1)),
        "scale_factor_at_base_rate_counts_per_dps": number(result.parts.odd[0] / result.parts.rate_dps[0]),
        "even_part_counts": number(fit.even),
        "even_part_u_counts": number(fit.even_u),
        "chi_square": number(fit.chi_square),
        "degrees_of_freedom": fit.degrees_of_freedom,
        "scatter_ppm": number(fit.scatter_ppm),
        "angle_random_walk_deg_per_sqrt_h": number(fit.angle_random_walk),
        "differences": _differences(result.differences, fit.scale_factor),
        "points": _points(result),
    }
    rates = {"even_part": fit.even_dph, "bias": result.bias_dph, "vertical_earth_rate": fit.earth_rate_dph}
    for name, (value, u) in rates.items():
        document |= {f"{name}_dph": number(value), f"{name}_u_dph": number(u)}
    return document


def _differences(differences: RateDifferences | None, scale_factor: float) -> list[dict[str, Any]]:
    if differences is None:
        return []
    columns = zip(
        differences.delta_dps,
        differences.number,
        differences.noise_u,
        differences.irreproducibility_u,
        differences.relative_u_ppm,
        strict=True,
    )
    return [
        {
            "delta_dps": round(float(delta), 9),
            "number_counts": number(count),
            "noise_u_counts": number(noise),
            "irreproducibility_u_counts": number(scatter),
            "relative_u_ppm": number(relative),
            "from_fit_ppm": number(_PPM * (count / (scale_factor * delta) - 1)),
        }
        for delta, count, noise, scatter, relative in columns
    ]


def _points(result: AxisResult) -> list[dict[str, Any]]:
    rows = zip(result.keys, result.windows, result.runs.rate_dps, result.fit.residual_ppm, strict=True)
    return [
        {
            "name": key,
            "table_rate_dps": number(rate),
            "turns": window.turns,
            "window_s": number(window.duration_s),
            "samples": window.samples,
            "sum_counts": number(window.total),
            "mean_counts": number(window.mean),
            "mean_u_counts": number(window.mean_u),
            "residual_ppm": number(residual),
        }
        for key, window, rate, residual in rows
    ]


def selfcal_document(evaluation: SelfcalEvaluation, settings: FogSettings) -> dict[str, Any]:
    """Return the self-calibration as plain JSON."""
    fit, net, compared = evaluation.fit, evaluation.net, evaluation.comparison
    reference = evaluation.reference
    return {
        "path": settings.selfcal.path,
        "numbers": settings.selfcal.numbers,
        "scale_factor_self_counts_per_dps": number(fit.slope),
        "scale_factor_self_u_counts_per_dps": number(fit.slope_u),
        "intercept_counts": number(fit.intercept),
        "intercept_u_counts": number(fit.intercept_u),
        "static_counts": number(net.static),
        "static_u_counts": number(net.static_u),
        "static_drift_counts": number(net.drift),
        "static_drift_u_counts": number(net.drift_u),
        "static_missing": evaluation.static_missing or None,
        "numbers_slope_counts_per_dps": number(evaluation.numbers.slope),
        "self_minus_numbers_ppm": number(compared.against_numbers_ppm),
        "self_minus_numbers_u_ppm": number(compared.against_numbers_u_ppm),
        "compared_with": "table" if reference else "design",
        "table_scale_factor_counts_per_dps": number(reference.scale_factor) if reference else None,
        "table_scale_factor_u_counts_per_dps": number(reference.scale_factor_u) if reference else None,
        "table_source": reference.source if reference else None,
        "self_minus_table_ppm": number(compared.difference_ppm) if reference else None,
        "self_minus_table_u_ppm": number(compared.difference_u_ppm) if reference else None,
        "self_minus_design_ppm": number(_PPM * (fit.slope / settings.nominal_scale_factor - 1)),
        "points": [
            {"name": key, "rate_dps": number(rate), "number_counts": number(given), "net_counts": number(output),
             "net_u_counts": number(u), "residual_counts": number(residual)}
            for key, rate, given, output, u, residual in zip(
                evaluation.keys, evaluation.rate_dps, evaluation.number, net.output, net.output_u, fit.residual,
                strict=True)
        ],
        "left_out": [one.as_json() for one in evaluation.left_out],
    }  # fmt: skip


def eps_document(evaluation: EpsEvaluation) -> dict[str, Any]:
    """Return the 2 pi error as plain JSON."""
    result = evaluation.result
    return {
        "two_pi_error": number(result.two_pi_error),
        "two_pi_error_u": number(result.two_pi_error_u),
        "two_pi_error_ppm": number(_PPM * result.two_pi_error),
        "two_pi_error_u_ppm": number(_PPM * result.two_pi_error_u),
        "amplitude_counts": number(result.amplitude),
        "amplitude_u_counts": number(result.amplitude_u),
        "rest_phase_rad": number(result.rest_phase_rad),
        "rest_phase_u_rad": number(result.rest_phase_u_rad),
        "chi_square": number(result.chi_square),
        "degrees_of_freedom": int(result.degrees_of_freedom),
        "points": [
            {"name": key, "step_codes": number(step), "normal_error": number(n), "normal_error_u": number(nu),
             "reset_error": number(r), "reset_error_u": number(ru)}
            for key, step, n, nu, r, ru in zip(
                evaluation.keys, evaluation.step_codes, evaluation.normal, evaluation.normal_u, evaluation.reset,
                evaluation.reset_u, strict=True)
        ],
        "left_out": [one.as_json() for one in evaluation.left_out],
    }  # fmt: skip


def figures_document(evaluation: FiguresEvaluation) -> dict[str, Any]:
    """Return the figures of merit as plain JSON."""
    return {
        "style": "GJB and IEEE style; nonlinearity is of full scale unless its name says of_point",
        "scale_factor_counts_per_dps": number(evaluation.scale_factor),
        "scale_factor_u_counts_per_dps": number(evaluation.scale_factor_u),
        # IEEE texts give input over output
        "input_per_count_dph": number(3600 / evaluation.scale_factor),
        "nonlinearity_ppm": number(evaluation.nonlinearity_ppm),
        "nonlinearity_of_point_ppm": number(evaluation.nonlinearity_of_point_ppm),
        "asymmetry_ppm": number(evaluation.asymmetry_ppm),
        "repeatability_ppm": number(evaluation.repeatability_ppm),
        "temperature_coefficient_ppm": number(evaluation.temperature_coefficient_ppm),
        "runs": [_figures_run(run) for run in evaluation.runs],
        "at_temperatures": [_figures_run(run) for run in evaluation.at_temperatures],
        "left_out": [one.as_json() for one in evaluation.left_out],
    }


def _figures_run(run: FiguresRun) -> dict[str, Any]:
    figures, pattern, fit = run.figures, run.pattern, run.figures.fit
    return {
        "name": run.name,
        "temperature_c": number(run.temperature_c),
        "scale_factor_counts_per_dps": number(fit.slope),
        "scale_factor_u_counts_per_dps": number(fit.slope_u),
        "scale_factor_positive_counts_per_dps": number(figures.scale_factor_positive),
        "scale_factor_negative_counts_per_dps": number(figures.scale_factor_negative),
        "intercept_counts": number(fit.intercept),
        "intercept_u_counts": number(fit.intercept_u),
        "static_drift_counts": number(run.static_drift),
        "nonlinearity_ppm": number(figures.nonlinearity_ppm),
        "nonlinearity_u_ppm": number(figures.nonlinearity_u_ppm),
        "nonlinearity_of_point_ppm": number(figures.nonlinearity_of_point_ppm),
        "asymmetry_ppm": number(figures.asymmetry_ppm),
        "asymmetry_u_ppm": number(figures.asymmetry_u_ppm),
        "pattern": list(pattern.names),
        "odd_ppm": number(pattern.odd_ppm),
        "even_ppm": number(pattern.even_ppm),
        "near_zero_ppm": number(pattern.near_zero_ppm),
        "rate_dps": numbers(run.rate_dps),
        "net_counts": numbers(run.output),
        "deviation_of_full_scale_ppm": numbers(figures.deviation_of_full_scale_ppm),
        "deviation_of_point_ppm": numbers(figures.deviation_of_point_ppm),
    }


def witness_document(evaluation: WitnessEvaluation, settings: FogSettings) -> dict[str, Any]:
    """Return what the oscilloscope shows of the staircase as plain JSON."""
    named = (
        ("step_height", evaluation.step_height, "_v"),
        ("step_time", evaluation.step_time, "_s"),
        ("reset_height", evaluation.reset_height, "_v"),
        ("two_pi_voltage", evaluation.two_pi_voltage, "_v"),
        ("bias_height", evaluation.bias_height, "_v"),
        ("step", evaluation.step_codes, "_codes"),
        ("step_time_difference", evaluation.step_time_ppm, "_ppm"),
        ("two_pi_error", evaluation.two_pi_error, ""),
    )
    document: dict[str, Any] = {}
    for name, measured, unit in named:
        document |= {f"{name}{unit}": number(measured.value), f"{name}_u{unit}": number(measured.u)}
    error = evaluation.two_pi_error
    return document | {
        "two_pi_error_ppm": number(_PPM * error.value),
        "two_pi_error_u_ppm": number(_PPM * error.u),
        "two_pi_voltage_u_without_gain_v": number(evaluation.two_pi_voltage_record_u),
        "half_wave_v": evaluation.half_wave_v or None,
        "gain_u": settings.witness.gain_u,
        "time_base_u": settings.witness.time_base_u,
        "records": [_witnessed(one) for one in evaluation.records],
        "left_out": [one.as_json() for one in evaluation.left_out],
    }


def _witnessed(record: WitnessedRecord) -> dict[str, Any]:
    found = record.found
    return {
        "name": record.name,
        "step_height_v": number(found.step_height),
        "step_height_u_v": number(found.step_height_u),
        "step_time_s": number(found.step_time),
        "step_time_u_s": number(found.step_time_u),
        "reset_height_v": number(found.reset_height),
        "reset_height_u_v": number(found.reset_height_u),
        "two_pi_voltage_v": number(found.two_pi_voltage),
        "two_pi_voltage_u_v": number(found.two_pi_voltage_u),
        "bias_height_v": number(found.bias_height),
        "bias_height_u_v": number(found.bias_height_u),
        "steps": found.steps,
        "resets": found.resets,
        "noise_rms_v": number(found.noise_rms),
        "step_time_given": record.step_time_given,
        "flags": list(found.flags),
    }
