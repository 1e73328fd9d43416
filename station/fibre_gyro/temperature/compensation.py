"""The compensation table: scale factor and bias at equal steps of the temperature, within what was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fibre_gyro.common import PPM
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.temperature.evaluate import AxisTemperature

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Compensation:
    """Table of one axis; nan where a quantity was not measured at a temperature."""

    temperature: Floats  # (n,): deg C, whole multiples of the step
    scale_factor: Floats  # (n,): Counts per deg/s
    scale_factor_u: Floats
    bias: Floats  # (n,): deg/h, without dT/dt
    bias_u: Floats
    bias_rate: float  # deg/h per kelvin a minute; 0 where the model has no such term
    bias_rate_u: float


def compensation_of(one: AxisTemperature, settings: FogSettings) -> Compensation:
    """Return the table of an axis; empty where the measured range holds no whole multiple of the step."""
    step, nominal = settings.temperature.table_step_c, settings.nominal_scale_factor
    models = [modelled.model for modelled in (one.bias, one.scale) if modelled is not None]
    first = math.ceil(min(model.lowest for model in models) / step - 1e-9)
    last = math.floor(max(model.highest for model in models) / step + 1e-9)
    at = step * np.arange(first, last + 1, dtype=np.float64)
    nothing = np.full(at.size, np.nan)
    bias, bias_u = (nothing, nothing) if one.bias is None else one.bias.model.at(at)
    off, off_u = (nothing, nothing) if one.scale is None else one.scale.model.at(at)
    rate, rate_u = 0.0, 0.0
    if one.bias is not None and one.bias.model.with_rate:
        rate, rate_u = one.bias.model.rate_coefficient, one.bias.model.rate_coefficient_u
    return Compensation(
        at,
        nominal * (1 + off / PPM),
        nominal * np.hypot(off_u, one.scale_u_constant) / PPM,
        bias,
        np.hypot(bias_u, one.bias_u_constant),
        rate,
        rate_u,
    )
