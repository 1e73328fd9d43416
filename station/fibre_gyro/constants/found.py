"""Which constants a run gives: numbers of small rates, or a compensation table over the temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import FixedPoint, InjectionPlan, round_to_words, scaled_numbers
from station.errors import UsageError
from station.fibre_gyro.selfcal.numbers import numbers_of
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.fibre_gyro.table.evaluate import AxisResult, find_axes
from station.fibre_gyro.temperature.compensation import compensation_of
from station.fibre_gyro.temperature.evaluate import AxisTemperature
from station.fibre_gyro.temperature.evaluate import evaluate as evaluate_temperature
from station.runs.store import SavedRun, open_run
from station.settings.load import saved_settings

Floats = NDArray[np.float64]

_GIVE = ("table", "selfcal", "temperature")
_SHARE_OF_U = 0.1
_LEAST_ERROR_PPM, _MOST_ERROR_PPM = 0.01, 10.0


@dataclass(frozen=True)
class Wanted:
    """How words are made."""

    axis: str = ""  # empty: that of the settings, or the only one
    # {"differences", "fit"}: Of a rate-table run: from differences of two rates, or the scale factor by least
    # squares times the rate
    numbers: str = "differences"
    unit: str = "codes"  # {"codes", "counts"}: Codes of the staircase's step, or counts of the output
    width: int | None = None  # bits of a word, and behind the point
    fraction: int | None = None
    error_ppm: float | None = None  # largest rounding error; a tenth of the standard uncertainty if not given


@dataclass(frozen=True)
class Column:
    """Constants of one kind, with their words."""

    name: str  # part of an identifier: ``"N"``, ``"K"``, ``"BIAS"``
    what: str  # in words
    unit: str
    at: Floats  # (n,): Rates, deg/s, or temperatures, deg C, that they belong to; empty for a single constant
    values: Floats  # (n,)
    values_u: Floats
    words: FixedPoint


@dataclass(frozen=True)
class Constants:
    """All constants of a run."""

    kind: str  # {"numbers", "temperature"}: Whether `at` are rates or temperatures
    axis: str
    gyro: str
    run: Path
    columns: tuple[Column, ...]


def constants_of(path: Path, wanted: Wanted) -> Constants:
    """Evaluate a saved run and round what it gives."""
    run = open_run(path)
    command = run.facts.command
    if command not in _GIVE:
        raise UsageError(
            f"{path}: a run of {command!r} gives no constants; those of `gyrolock fog` {', '.join(_GIVE)} do"
        )
    settings = saved_settings(FIBRE_GYRO, run.facts.settings, str(run.path))
    try:
        if command == "temperature":
            axis, columns = _over_temperature(run, settings, wanted)
        else:
            axis, columns = _of_small_rates(run, settings, wanted, command)
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from None
    kind = "temperature" if command == "temperature" else "numbers"
    return Constants(kind, axis, settings.gyro.name, run.path, columns)


def _of_small_rates(
    run: SavedRun, settings: FogSettings, wanted: Wanted, command: str
) -> tuple[str, tuple[Column, ...]]:
    if command == "selfcal":
        axis, plan = settings.selfcal.axis, numbers_of(run, settings)
        if wanted.axis not in ("", axis):
            raise UsageError(f"{run.path}: is a self-calibration of axis {axis}, not of {wanted.axis}")
    else:
        found = find_axes(run, settings)
        axis = wanted.axis or (
            settings.selfcal.axis if len(found.axes) > 1 else found.axes[0].axis if found.axes else ""
        )
        result = found.of(axis)
        if result is None:
            there = ", ".join(one.axis for one in found.axes) or "none"
            raise UsageError(f"{run.path}: gives no scale factor of axis {axis or 'Z'} (--axis); it has: {there}")
        plan = _plan_of(result, run, wanted.numbers)
    positive = plan.rate_dps > 0
    order = np.argsort(plan.rate_dps[positive])
    rate, number, u = (values[positive][order] for values in (plan.rate_dps, plan.number, plan.number_u))
    scale = settings.gyro.counts_per_code if wanted.unit == "codes" else 1.0
    values, values_u = number / scale, u / scale
    words = round_to_words(
        values, width=wanted.width, fraction=wanted.fraction, error_ppm=_error_for(values, values_u, wanted)
    )
    what = "number of a rate, added to the staircase each transit time"
    return axis, (Column("N", what, wanted.unit, rate, values, values_u, words),)


def _plan_of(result: AxisResult, run: SavedRun, numbers: str) -> InjectionPlan:
    made = result.differences
    if made is None:
        raise UsageError(f"{run.path}: has one rate only, and no differences: take several rates")
    if numbers == "fit":
        return scaled_numbers(made.delta_dps, result.fit.scale_factor, result.fit.scale_factor_u)
    return InjectionPlan(made.delta_dps.round(9), made.number, made.number_u, np.eye(made.number.size))


def _over_temperature(run: SavedRun, settings: FogSettings, wanted: Wanted) -> tuple[str, tuple[Column, ...]]:
    found = evaluate_temperature(run, settings, {})
    one = _axis_of(found.axes, run, wanted.axis)
    table = compensation_of(one, settings)
    columns = []
    for name, what, unit, values, values_u in (
        ("K", "scale factor", "counts per deg/s", table.scale_factor, table.scale_factor_u),
        ("BIAS", "bias without dT/dt", "deg/h", table.bias, table.bias_u),
    ):
        known = np.isfinite(values)
        if known.any():
            columns.append(
                _column(name, what, unit, table.temperature[known], values[known], values_u[known], wanted)
            )
    if table.bias_rate:
        rate, rate_u = np.array([table.bias_rate]), np.array([table.bias_rate_u])
        unit = "deg/h per kelvin a minute"
        columns.append(_column("BIAS_RATE", "bias by dT/dt", unit, np.empty(0), rate, rate_u, wanted))
    if not columns:
        raise ValueError("the measured temperatures hold no whole multiple of temperature.table_step_c")
    return one.axis, tuple(columns)


def _axis_of(axes: tuple[AxisTemperature, ...], run: SavedRun, wanted: str) -> AxisTemperature:
    for one in axes:
        if wanted in (one.axis, "") and (wanted or len(axes) == 1):
            return one
    raise UsageError(f"{run.path}: name one of its axes with --axis: {', '.join(one.axis for one in axes)}")


def _column(
    name: str, what: str, unit: str, at: Floats, values: Floats, values_u: Floats, wanted: Wanted
) -> Column:
    """Words of a column; a bias goes through zero, so its rounding is measured by its uncertainty."""
    if wanted.width is not None or wanted.fraction is not None:
        return Column(
            name,
            what,
            unit,
            at,
            values,
            values_u,
            round_to_words(values, width=wanted.width, fraction=wanted.fraction),
        )
    size = float(np.abs(values).max()) or 1.0
    allowed = wanted.error_ppm * 1e-6 * size if wanted.error_ppm else _SHARE_OF_U * float(values_u.min())
    # half of the last place at most
    fraction = max(0, math.ceil(-math.log2(2 * max(allowed, 1e-9 * size))))
    return Column(name, what, unit, at, values, values_u, round_to_words(values, fraction=fraction))


def _error_for(values: Floats, values_u: Floats, wanted: Wanted) -> float:
    """Largest rounding error, ppm, that is hardly seen beside the uncertainty."""
    if wanted.error_ppm is not None:
        return wanted.error_ppm
    relative = 1e6 * values_u[values != 0] / np.abs(values[values != 0])
    return (
        float(np.clip(_SHARE_OF_U * relative.min(), _LEAST_ERROR_PPM, _MOST_ERROR_PPM)) if relative.size else 1.0
    )
