"""Scale factor and bias over the temperature as numbers and sentences."""

from __future__ import annotations

import math
from typing import Any

from station.fibre_gyro.common import COUNTS_PER_DPS
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.temperature.compensation import compensation_of
from station.fibre_gyro.temperature.evaluate import AxisTemperature, Modelled, TemperatureFound
from station.results.numbers import with_uncertainty
from station.results.parts import TextTable
from station.results.result import Measured, Result
from station.runs.store import SavedRun

LIMITED = ("scale_factor_over_temperature_ppm", "bias_over_temperature_dph", "bias_residual_dph")
_NOISY_RATE = 0.01


def result(found: TemperatureFound, run: SavedRun, settings: FogSettings) -> Result:
    """Put into numbers and sentences what was found."""
    axes = [_axis(one, settings) for one in found.axes]
    alone = len(axes) == 1
    lines = tuple(line for one in found.axes for line in _lines(one, several=not alone))
    watched = tuple(_to_watch(found, settings))
    return Result(
        name="result",
        value="; ".join(_value(one, axis) for one, axis in zip(found.axes, axes, strict=True)),
        document={**(axes[0] if alone else {}), "axes": axes, "left_out": found.left_out},
        measured=tuple(
            Measured(name, axis[name], "" if alone else axis["axis"]) for axis in axes for name in LIMITED
        ),
        lines=lines,
        summary=[("", line) for line in lines],
        sentences=tuple(said for one in found.axes for said in _sentences(one)),
        to_watch=watched,
        flags=watched,
        left_out=found.left_out,
        tables=tuple(table_of_models(one) for one in found.axes),
    )


def _value(one: AxisTemperature, axis: dict[str, Any]) -> str:
    parts = []
    if one.scale is not None:
        k, u = (axis[f"scale_factor_over_temperature_{end}"] for end in ("ppm", "u_ppm"))
        parts.append(f"K changes by {with_uncertainty(k, u)} ppm")
    if one.bias is not None:
        span, u = (axis[f"bias_over_temperature_{end}"] for end in ("dph", "u_dph"))
        parts.append(f"the bias by {with_uncertainty(span, u)} deg/h")
    model = next(modelled.model for modelled in (one.bias, one.scale) if modelled is not None)
    return f"{', '.join(parts)} from {model.lowest:.3g} to {model.highest:.3g} °C"


def _axis(one: AxisTemperature, settings: FogSettings) -> dict[str, Any]:
    table = compensation_of(one, settings)
    (k_span, k_span_u), (span, span_u) = (
        (math.nan, math.nan) if modelled is None else modelled.model.span() for modelled in (one.scale, one.bias)
    )
    return {
        "axis": one.axis,
        "scale_factor_over_temperature_ppm": k_span,
        "scale_factor_over_temperature_u_ppm": k_span_u,
        "bias_over_temperature_dph": span,
        "bias_over_temperature_u_dph": span_u,
        "bias_residual_dph": one.bias.residual_rms if one.bias else math.nan,
        "reference_temperature_c": settings.figures.reference_temperature_c,
        "nominal_scale_factor_counts_per_dps": settings.nominal_scale_factor,
        "scale_factor": _model(one.scale, "ppm", constant_u=one.scale_u_constant),
        "bias": _model(one.bias, "dph", constant_u=one.bias_u_constant),
        "rate_noise_share": one.rate_noise,
        "compensation": {
            "temperature_c": table.temperature,
            "scale_factor_counts_per_dps": table.scale_factor,
            "scale_factor_u_counts_per_dps": table.scale_factor_u,
            "bias_dph": table.bias,
            "bias_u_dph": table.bias_u,
            "bias_dph_per_k_per_min": table.bias_rate,
            "bias_u_dph_per_k_per_min": table.bias_rate_u,
        },
    }


def _model(modelled: Modelled | None, unit: str, constant_u: float = 0.0) -> dict[str, Any] | None:
    if modelled is None:
        return None
    model, points = modelled.model, modelled.points
    u = model.coefficients_u.copy()
    u[0] = math.hypot(u[0], constant_u)
    return {
        "order": model.order,
        "with_rate": model.with_rate,
        "rate_known": model.rate_known,
        f"coefficients_{unit}": model.coefficients,
        f"coefficients_u_{unit}": u,
        f"{unit}_per_k_per_min": model.rate_coefficient,
        f"{unit}_u_per_k_per_min": model.rate_coefficient_u,
        "lowest_c": model.lowest,
        "highest_c": model.highest,
        f"noise_u_{unit}": model.noise_u,
        f"slow_{unit}": model.slow,
        "slow_noise": model.slow_kind,
        f"residual_{unit}": modelled.residual_rms,
        "candidates": model.candidates,
        "points": {
            "at_s": points.at_s,
            "temperature_c": points.temperature,
            "k_per_min": points.rate,
            f"value_{unit}": points.value,
            f"residual_{unit}": model.residual,
        },
    }


def _lines(one: AxisTemperature, *, several: bool) -> tuple[str, ...]:
    begin, said = f"Axis {one.axis}: " if several else "", []
    if one.scale is not None and one.scale.model.order:
        slope, u = one.scale.model.coefficients[1], one.scale.model.coefficients_u[1]
        said.append(f"{begin}K {with_uncertainty(float(slope), float(u))} ppm/K at the reference temperature.")
    if one.bias is not None:
        model = one.bias.model
        if model.with_rate:
            known = with_uncertainty(model.rate_coefficient, model.rate_coefficient_u)
            said.append(f"{begin}bias {known} deg/h per kelvin a minute.")
        said.append(f"{begin}{one.bias.residual_rms:.2g} deg/h of the bias is left by the model.")
    return tuple(said)


def table_of_models(one: AxisTemperature) -> TextTable:
    """Return the coefficients of both models."""
    rows = []
    for name, unit, modelled in (("K less design", "ppm", one.scale), ("bias", "deg/h", one.bias)):
        if modelled is None:
            continue
        model = modelled.model
        for power, (value, u) in enumerate(zip(model.coefficients, model.coefficients_u, strict=True)):
            per = "" if not power else "/K" if power == 1 else f"/K^{power}"
            rows.append((name, f"(T - T0)^{power}", with_uncertainty(float(value), float(u)), f"{unit}{per}"))
        if model.with_rate:
            known = with_uncertainty(model.rate_coefficient, model.rate_coefficient_u)
            rows.append((name, "dT/dt", known, f"{unit} per K/min"))
    return TextTable((f"axis {one.axis}", "term", "coefficient", "unit"), tuple(rows))


def _sentences(one: AxisTemperature) -> list[str]:
    return [
        _choice_in_words(f"{name} of axis {one.axis}", modelled)
        for name, modelled in (("scale factor", one.scale), ("bias", one.bias))
        if modelled is not None
    ]


def _choice_in_words(name: str, modelled: Modelled) -> str:
    model = modelled.model
    first, others = model.candidates[0], model.candidates[1:]
    rate = " and dT/dt" if first.with_rate else ""
    said = f"{name[0].upper()}{name[1:]}: a polynomial of order {first.order}{rate} has the least AICc of "
    said += f"{len(model.candidates)} models, weight {first.weight:.2g}"
    if others:
        other = others[0]
        rate = " and dT/dt" if other.with_rate else ""
        said += f"; the next is order {other.order}{rate}, {other.aicc:.2g} above it"
    slow = (
        f"slow noise of {model.slow:.2g} {model.slow_kind}"
        if model.slow > 0.1 * model.noise_u
        else "hardly any slow noise"
    )
    return (
        f"{said}. Counted are {slow} beside {model.noise_u:.2g} of a point, and that another model may be right."
    )


def _to_watch(found: TemperatureFound, settings: FogSettings) -> list[str]:
    said = [f"{one.sentence}." for one in found.left_out]
    for one in found.axes:
        if one.bias is not None and not one.bias.model.rate_known:
            said.append(
                f"{one.axis}: what comes from dT/dt cannot be told from what comes from the temperature: let the "
                "temperature go up and down again. The bias holds for this ramp only."
            )
        if one.rate_noise > _NOISY_RATE:
            said.append(
                f"{one.axis}: {100 * one.rate_noise:.2g} % of the scatter of dT/dt is noise of the thermometer: "
                "its coefficient comes out too small by about that. Use a longer temperature.window_s."
            )
        if one.scale is None:
            said.append(
                f"{one.axis}: no scale factor was measured; the bias rests on the one by design, "
                f"{settings.nominal_scale_factor:.6g} {COUNTS_PER_DPS}."
            )
        said += one.remarks
    return said
