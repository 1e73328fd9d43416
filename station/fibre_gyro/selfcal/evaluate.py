"""What the segments of a self-calibration say: slope, intercept and static output of the injected steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    NetOutputs,
    ScaleComparison,
    SlopeFit,
    WindowMean,
    compare_scale,
    drift_in_slope,
    find_run_scatter,
    fit_slope,
    static_level,
    steps_beyond_dac,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import beyond_converter, not_taken, reasons_of
from station.fibre_gyro.recordings import segments_of
from station.fibre_gyro.selfcal.numbers import TableReference, reference_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.evaluate import PURPOSE as TABLE
from station.fibre_gyro.table.evaluate import TableFound, find_axes
from station.fibre_gyro.windows import remarks_on, window_at_rest
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "selfcal"
_STATIC = ("before", "after")


@dataclass(frozen=True)
class _Row:
    """Mean of one segment; `at_s` in the middle of it, in seconds of output since the begin."""

    key: str
    conditions: dict[str, Any]
    mean: WindowMean
    at_s: float
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class SelfcalFound:
    """Result of a self-calibration.

    Attributes
    ----------
    keys : tuple of str
        Segments in the fit, one for each element of the arrays.
    rate_dps, number : ndarray, shape (n,)
        What the steps stand for, and the steps in counts.
    fit : SlopeFit
        Net output against rate: K_self.
    numbers : SlopeFit
        Injected numbers against rate, with the same weights: the mapping that was given.
    comparison : ScaleComparison
        Against the table, or where there is none against the design.
    static_missing : {"", "before", "after"}
        Which static output is missing, if one is.
    drift_removed : bool
        Whether the static output was interpolated in time.
    remarks : tuple of str
        What was missing or left out within the windows.
    table : TableFound or None
        Of the rate-table segments in the same run.
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
    drift_removed: bool
    remarks: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    table: TableFound | None


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> SelfcalFound:
    """Evaluate a self-calibration, and the rate-table segments of the same run.

    Raises
    ------
    NoUsableSignal
        Fewer than three steps or no static output are left.
    """
    rows, left_out = _usable(run, settings)
    left_out += not_taken(run)
    static = [row for row in rows if row.conditions["static"]]
    steps = [row for row in rows if not row.conditions["static"]]
    names = {row.conditions["static"] for row in static}
    missing = [name for name in _STATIC if name not in names]
    if not static or len(steps) < 3:
        raise NoUsableSignal(
            f"a self-calibration needs a static output and at least three steps, there are {len(static)} and "
            f"{len(steps)}{reasons_of(left_out)}"
        )
    rates = np.array([row.conditions["stands_for_dps"] for row in steps], dtype=np.float64)
    given = np.array([row.conditions["number"] for row in steps], dtype=np.float64)
    u = np.maximum([row.mean.mean_u for row in steps], 1e-12 * np.abs(given).max())
    times = [row.at_s for row in steps]
    level = static_level(
        times,
        [row.at_s for row in static],
        [row.mean.mean for row in static],
        [row.mean.mean_u for row in static],
    )
    output = np.array([row.mean.mean for row in steps]) - level.level
    net = NetOutputs(output, u, level.mean, level.mean_u, level.drift, level.drift_u)
    drift_u = level.unseen_slope_u * abs(drift_in_slope(rates, u**-2.0, times))
    fit, excess = (_fit(rates, values, u, drift_u) for values in (output, output - given))
    table = find_axes(run, settings) if run.taken_for(TABLE) else None
    reference = reference_of(run, settings, table)
    against = (
        (reference.scale_factor, reference.scale_factor_u) if reference else (settings.nominal_scale_factor, 0.0)
    )
    numbers_u = _mapping_u(steps, rates, u)
    if reference is not None and settings.selfcal.numbers == "fit":
        # the numbers were made of the scale factor that they are compared with: its error is in both
        against, numbers_u = (reference.scale_factor, abs(numbers_u - reference.scale_factor_u)), 0.0
    return SelfcalFound(
        keys=tuple(row.key for row in steps),
        rate_dps=rates,
        number=given,
        net=net,
        fit=fit,
        numbers=fit_slope(rates, given, u),
        reference=reference,
        comparison=compare_scale(fit, excess, against, numbers_u=numbers_u),
        static_missing=missing[0] if missing else "",
        drift_removed=level.modelled,
        remarks=tuple(said for row in rows for said in row.remarks),
        left_out=tuple(left_out),
        table=table,
    )


def _fit(
    rates: NDArray[np.float64], values: NDArray[np.float64], u: NDArray[np.float64], drift_u: float
) -> SlopeFit:
    """Fit a line; its uncertainties count the scatter of the points and the drift that may be left."""
    fit = fit_slope(rates, values, u)
    design = np.column_stack([rates, np.ones_like(rates)])
    scatter = find_run_scatter(design, values, u, 0.0)
    slope, intercept = np.linalg.pinv(design / u[:, np.newaxis]) / u
    slope_u = math.hypot(scatter.standard_u(slope), drift_u)
    return replace(fit, slope_u=slope_u, intercept_u=scatter.standard_u(intercept))


def _mapping_u(steps: Sequence[_Row], rates: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Uncertainty of the slope of the numbers, counts per deg/s: their errors have one sign, they share a base."""
    number_u = np.array([row.conditions.get("number_u", 0.0) for row in steps], dtype=np.float64)
    weight = u**-2.0
    return float(np.sum(weight * np.abs(rates) * number_u) / np.sum(weight * rates**2))


def _usable(run: SavedRun, settings: FogSettings) -> tuple[list[_Row], list[LeftOut]]:
    """Mean of every segment that can be used."""
    rows: list[_Row] = []
    left_out, clock = [], 0.0
    for segment in segments_of(run, PURPOSE):
        length = segment.recording.duration_s
        clock += length
        step = segment.conditions["number"] / settings.gyro.counts_per_code
        if steps_beyond_dac(step, settings.gyro.dac_bits):
            left_out.append(LeftOut(segment.key, beyond_converter(step, settings.gyro.dac_bits)))
            continue
        try:
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        remarks = tuple(remarks_on(segment, mean))
        rows.append(_Row(segment.key, segment.conditions, mean, clock - length / 2, remarks))
    return rows, left_out
