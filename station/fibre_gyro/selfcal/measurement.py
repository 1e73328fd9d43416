"""The self-calibration by injected staircase: its plan, and what its segments say."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    InjectionPlan,
    NetOutputs,
    ScaleComparison,
    SlopeFit,
    compare_scale,
    fit_slope,
    largest_step,
    net_outputs,
    scaled_numbers,
    steps_beyond_dac,
    superposed_numbers,
)
from station.errors import NoUsableSignal, UsageError
from station.fibre_gyro.campaign import PlannedSegment
from station.fibre_gyro.segments import LeftOut, window_at_rest
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.store import FogRun, Segment
from station.fibre_gyro.table.measurement import AxisResult, TableEvaluation

PURPOSE = "selfcal"
BEFORE, AFTER = "static before", "static after"


@dataclass(frozen=True)
class TableReference:
    """The rate-table result that a self-calibration is compared with.

    Attributes
    ----------
    scale_factor, scale_factor_u : float
        Counts per deg/s.
    source : str
        Where it comes from, in words.
    """

    scale_factor: float
    scale_factor_u: float
    source: str


@dataclass(frozen=True)
class SelfcalEvaluation:
    """Result of a self-calibration.

    Attributes
    ----------
    keys : tuple of str
        Segments in the fit, one for each element of the arrays.
    rate_dps, number : ndarray, shape (n,)
        What the steps stand for, and the steps in counts.
    net : NetOutputs
    fit : SlopeFit
        Net output against rate: K_self.
    numbers : SlopeFit
        Injected numbers against rate, with the same weights: the mapping that was given.
    reference : TableReference or None
    comparison : ScaleComparison
        Against the table, or where there is none against the design.
    static_missing : {"", "before", "after"}
        Which static output is missing, if one is.
    left_out : tuple of LeftOut
    """

    keys: tuple[str, ...]
    rate_dps: NDArray[np.float64]
    number: NDArray[np.float64]
    net: NetOutputs
    fit: SlopeFit
    numbers: SlopeFit
    reference: TableReference | None
    comparison: ScaleComparison
    static_missing: str
    left_out: tuple[LeftOut, ...]


def numbers_for(settings: FogSettings, table: AxisResult | None) -> InjectionPlan:
    """Numbers to inject, in counts, for every rate of the settings in both senses.

    Parameters
    ----------
    settings : FogSettings
    table : AxisResult or None
        Of the axis of the settings.

    Raises
    ------
    UsageError
        The settings want numbers from a table run and there is none.
    """
    chosen = settings.selfcal
    rates = [sense * rate for rate in chosen.rates_dps for sense in (1.0, -1.0)]
    if chosen.numbers == "nominal":
        return scaled_numbers(rates, settings.nominal_scale_factor)
    if table is None or (chosen.numbers == "differences" and table.differences is None):
        raise UsageError(
            f'selfcal.numbers = "{chosen.numbers}" takes the numbers from a rate-table run of axis {chosen.axis}: '
            'name one with --table RUN, or set selfcal.numbers = "nominal"'
        )
    if chosen.numbers == "fit":
        return scaled_numbers(rates, table.fit.scale_factor, table.fit.scale_factor_u)
    assert table.differences is not None
    return superposed_numbers(rates, table.differences)


def plan_selfcal(settings: FogSettings, numbers: InjectionPlan) -> tuple[list[PlannedSegment], list[LeftOut]]:
    """List the segments: rest, every step, rest. Steps beyond the converter are left out by name.

    Parameters
    ----------
    settings : FogSettings
    numbers : InjectionPlan
        Counts.
    """
    chosen, gyro = settings.selfcal, settings.gyro
    beyond = steps_beyond_dac(numbers.number / gyro.counts_per_code, gyro.dac_bits)

    def segment(key: str, seconds: float, rate: float, number: float, number_u: float) -> PlannedSegment:
        static = {BEFORE: "before", AFTER: "after"}.get(key)
        conditions = {
            "purpose": PURPOSE,
            "static": static,
            "rate_dps": 0.0,
            "stands_for_dps": rate,
            "number": number,
            "number_u": number_u,
            "step_codes": number / gyro.counts_per_code,
        }
        return PlannedSegment(key, seconds, chosen.settle_s, conditions)

    plan, left_out = [segment(BEFORE, chosen.static_s, 0.0, 0.0, 0.0)], []
    for rate, number, u, too_large in zip(numbers.rate_dps, numbers.number, numbers.number_u, beyond, strict=True):
        if too_large:
            left_out.append(
                LeftOut(injection_key(rate), beyond_words(number / gyro.counts_per_code, gyro.dac_bits))
            )
        else:
            plan.append(segment(injection_key(rate), chosen.step_s, float(rate), float(number), float(u)))
    plan.append(segment(AFTER, chosen.static_s, 0.0, 0.0, 0.0))
    return plan, left_out


def injection_key(rate_dps: float) -> str:
    """Key of a segment with injection."""
    return f"inject {rate_dps:+.10g}"


def beyond_words(step_codes: float, dac_bits: int) -> str:
    """Say that a step is beyond the converter."""
    return (
        f"a step of {step_codes:+.6g} codes is beyond the {dac_bits}-bit converter, which takes "
        f"{largest_step(dac_bits):.0f} (half of its range): choose a smaller rate"
    )


def evaluate_selfcal(run: FogRun, settings: FogSettings, table: TableEvaluation | None) -> SelfcalEvaluation:
    """Evaluate the injection segments of a run.

    Parameters
    ----------
    run : FogRun
    settings : FogSettings
    table : TableEvaluation or None
        Of the rate-table segments in the same run. A table run of another file is in the facts of the run.

    Raises
    ------
    NoUsableSignal
        Fewer than three steps or no static output are left.
    """
    rows, left_out = _usable(run.taken_for(PURPOSE), settings)
    left_out += [LeftOut(**entry) for entry in run.facts.get("left_out_of_plan", [])]
    static = {conditions["static"]: mean for _, mean, conditions in rows if conditions["static"]}
    steps = [row for row in rows if not row[2]["static"]]
    missing = [name for name in ("before", "after") if name not in static]
    if len(missing) == 2 or len(steps) < 3:
        reasons = "; ".join(one.sentence for one in left_out)
        raise NoUsableSignal(
            f"a self-calibration needs a static output and at least three steps, there are {len(static)} and "
            f"{len(steps)}{': ' + reasons if reasons else ''}"
        )
    before = static.get("before", static.get("after"))
    after = static.get("after", before)
    assert before is not None and after is not None  # at least one is there
    rates = np.array([conditions["stands_for_dps"] for _, _, conditions in steps], dtype=np.float64)
    given = np.array([conditions["number"] for _, _, conditions in steps], dtype=np.float64)
    u = np.maximum([mean[1] for _, mean, _ in steps], 1e-12 * np.abs(given).max())
    net = net_outputs([mean[0] for _, mean, _ in steps], u, before, after)
    fit, numbers = fit_slope(rates, net.output, u), fit_slope(rates, given, u)
    reference = table_reference(run, settings, table)
    against = (
        (reference.scale_factor, reference.scale_factor_u) if reference else (settings.nominal_scale_factor, 0.0)
    )
    return SelfcalEvaluation(
        keys=tuple(key for key, _, _ in steps),
        rate_dps=rates,
        number=given,
        net=net,
        fit=fit,
        numbers=numbers,
        reference=reference,
        comparison=compare_scale(
            fit, fit_slope(rates, net.output - given, u), against, numbers_u=_mapping_u(steps, rates, u)
        ),
        static_missing=missing[0] if missing else "",
        left_out=tuple(left_out),
    )


def _mapping_u(steps: list[Row], rates: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Uncertainty of the slope of the numbers, counts per deg/s: their errors have one sign, they share a base."""
    number_u = np.array([conditions.get("number_u", 0.0) for _, _, conditions in steps], dtype=np.float64)
    weight = u**-2.0
    return float(np.sum(weight * np.abs(rates) * number_u) / np.sum(weight * rates**2))


Row = tuple[str, tuple[float, float], dict[str, Any]]


def _usable(segments: Iterable[Segment], settings: FogSettings) -> tuple[list[Row], list[LeftOut]]:
    """Key, mean with uncertainty, and conditions of every segment that can be used."""
    rows: list[Row] = []
    left_out = []
    for segment in segments:
        step = segment.conditions["number"] / settings.gyro.counts_per_code
        if steps_beyond_dac(step, settings.gyro.dac_bits):
            left_out.append(LeftOut(segment.key, beyond_words(step, settings.gyro.dac_bits)))
            continue
        try:
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        rows.append((segment.key, (mean.mean, mean.mean_u), segment.conditions))
    return rows, left_out


def table_reference(run: FogRun, settings: FogSettings, table: TableEvaluation | None) -> TableReference | None:
    """Scale factor of the rate table that belongs to a run."""
    if (saved := run.facts.get("table_reference")) is not None:
        return TableReference(**saved)
    result = table.of(settings.selfcal.axis) if table is not None else None
    if result is None or not math.isfinite(result.fit.scale_factor):
        return None
    source = f"rate-table run of axis {result.axis} in the same run"
    return TableReference(result.fit.scale_factor, result.fit.scale_factor_u, source)
