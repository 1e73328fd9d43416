"""The numbers that a self-calibration injects, and the rate-table result that they and the comparison rest on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    InjectionPlan,
    RateDifferences,
    correlation_with_numbers,
    scaled_numbers,
    superposed_numbers,
)
from station.errors import UsageError
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.fibre_gyro.table.evaluate import AxisResult, TableFound, find_axes
from station.runs.store import SavedRun, open_run
from station.settings.load import saved_settings

Floats = NDArray[np.float64]

# facts of a run whose numbers come from another
REFERENCE, NUMBERS, DIFFERENCES = "table_reference", "numbers", "table_differences"
CORRELATION = "table_correlation"

_ARRAYS = ("delta_dps", "number", "noise_u", "irreproducibility_u")
_BASE = ("base_dps", "base_u")


@dataclass(frozen=True)
class TableReference:
    """The rate-table result that a self-calibration is compared with."""

    scale_factor: float  # counts per deg/s
    scale_factor_u: float
    source: str  # where it comes from, in words


def numbers_for(settings: FogSettings, table: AxisResult | None) -> InjectionPlan:
    """Numbers to inject, in counts, for every rate of the settings in both senses."""
    chosen = settings.selfcal
    rates = [sense * rate for rate in chosen.rates_dps for sense in (1.0, -1.0)]
    if chosen.numbers == "nominal":
        return scaled_numbers(rates, settings.nominal_scale_factor)
    if table is not None and chosen.numbers == "fit":
        return scaled_numbers(rates, table.fit.scale_factor, table.fit.scale_factor_u)
    if table is None or table.differences is None:
        raise UsageError(
            f'selfcal.numbers = "{chosen.numbers}" takes the numbers from a rate-table run of axis {chosen.axis}: '
            'name one with --table RUN, or set selfcal.numbers = "nominal"'
        )
    return superposed_numbers(rates, table.differences)


def facts_of_table(settings: FogSettings, table_run: Path) -> dict[str, Any]:
    """Return numbers and reference of another run, as facts of the one that uses them."""
    run = open_run(table_run)
    saved = saved_settings(FIBRE_GYRO, run.facts.settings, str(run.path))
    found = find_axes(run, saved).of(settings.selfcal.axis)
    if found is None:
        raise UsageError(f"{table_run}: gives no scale factor of axis {settings.selfcal.axis} (selfcal.axis)")
    source = f"rate-table run {run.path.parent.name}, axis {found.axis}"
    reference = TableReference(found.fit.scale_factor, found.fit.scale_factor_u, source)
    numbers = {name: values.tolist() for name, values in asdict(numbers_for(settings, found)).items()}
    known = {REFERENCE: asdict(reference), NUMBERS: numbers}
    if found.differences is None:
        return known
    plain = {name: np.asarray(getattr(found.differences, name)).tolist() for name in (*_ARRAYS, *_BASE)}
    together = _together(found)
    return {**known, DIFFERENCES: plain, **({CORRELATION: asdict(together)} if together else {})}


@dataclass(frozen=True)
class TableTogether:
    """How scale factor and numbers of one table run hang together."""

    # standard uncertainty of the scale factor, without the table's common error, and of each number; counts
    u: list[float]
    correlation: list[list[float]]


def _together(table: AxisResult) -> TableTogether | None:
    made, fit = table.differences, table.fit
    if made is None or made.factors is None:
        return None
    common = sum(fit.contributions.get(name, 0.0) ** 2 for name in ("table rate", "clock"))
    own = math.sqrt(max(fit.scale_factor_u**2 - common, 0.0))
    return TableTogether([own, *made.number_u.tolist()], correlation_with_numbers(fit, made.factors).tolist())


def numbers_against_table_u(
    run: SavedRun, table: TableFound | None, settings: FogSettings, rates_dps: Floats, weights: Floats
) -> float | None:
    """Relative standard uncertainty of the slope of the numbers over the K of the table run that both come from.

    Their errors have one source and cancel in part; ``None`` where nobody knows how.
    """
    reference = reference_of(run, settings, table)
    own = table.of(settings.selfcal.axis) if table is not None else None
    if reference is None or settings.selfcal.numbers != "differences":
        return None
    together: TableTogether | None
    if CORRELATION in run.facts:
        together, made = TableTogether(**run.facts[CORRELATION]), _saved_differences(run.facts)
    elif own is not None and own.differences is not None and REFERENCE not in run.facts:
        together, made = _together(own), own.differences
    else:
        return None
    if together is None or made is None:
        return None
    plan = superposed_numbers(rates_dps, made)
    centred = weights * (rates_dps - float(weights @ rates_dps) / float(weights.sum()))
    of_numbers = centred @ plan.multiples / float(centred @ rates_dps)
    slope = float(of_numbers @ made.number)
    factors = np.concatenate([[-1 / reference.scale_factor], of_numbers / slope]) * np.array(together.u)
    return float(np.sqrt(factors @ np.array(together.correlation) @ factors))


def _saved_differences(facts: Mapping[str, Any]) -> RateDifferences | None:
    made = facts.get(DIFFERENCES)
    if made is None:
        return None
    delta, number, noise, spread = (np.array(made[name], dtype=np.float64) for name in _ARRAYS)
    base, base_u = (float(made[name]) for name in _BASE)
    return RateDifferences(delta, number, noise, spread, base, base_u)


def numbers_u_of(facts: Mapping[str, Any], settings: FogSettings) -> Callable[[float], float]:
    """Return how well a number stands for a rate, counts, by the table run that the numbers of logs come from.

    By the scale factor of the table where the numbers are made of it, else by its differences; without a table
    run, and for numbers by design, nothing is known that would be uncertain.
    """
    reference, made = facts.get(REFERENCE), _saved_differences(facts)
    if reference is None or settings.selfcal.numbers == "nominal":
        return lambda rate: 0.0
    if settings.selfcal.numbers == "fit" or made is None:
        return lambda rate: abs(rate) * float(reference["scale_factor_u"])
    return lambda rate: float(superposed_numbers([rate], made).number_u[0])


def numbers_of(run: SavedRun, settings: FogSettings) -> InjectionPlan:
    """Return the numbers of a run: those that were saved with it, or those that its own table run gives."""
    if (saved := run.facts.get(NUMBERS)) is not None:
        return InjectionPlan(**{name: np.array(values, dtype=np.float64) for name, values in saved.items()})
    return numbers_for(settings, find_axes(run, settings).of(settings.selfcal.axis))


def reference_of(run: SavedRun, settings: FogSettings, table: TableFound | None) -> TableReference | None:
    """Return the scale factor of the rate table that belongs to a run: saved with it, or of its own table run."""
    if (saved := run.facts.get(REFERENCE)) is not None:
        return TableReference(**saved)
    result = table.of(settings.selfcal.axis) if table is not None else None
    if result is None or not math.isfinite(result.fit.scale_factor):
        return None
    source = f"rate-table run of axis {result.axis} in the same run"
    return TableReference(result.fit.scale_factor, result.fit.scale_factor_u, source)
