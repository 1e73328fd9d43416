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
    RunScatter,
    ScaleComparison,
    SlopeFit,
    StaticLevel,
    WindowMean,
    compare_scale,
    drift_in_slope,
    find_run_scatter,
    fit_slope,
    noise_of_means,
    static_level,
    steps_beyond_dac,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.allan.noise_model import NoiseModel, noise_of
from station.fibre_gyro.common import PPM, beyond_converter, not_taken, reasons_of
from station.fibre_gyro.recordings import segments_of
from station.fibre_gyro.selfcal.numbers import TableReference, numbers_against_table_u, reference_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.evaluate import PURPOSE as TABLE
from station.fibre_gyro.table.evaluate import TableFound, find_axes
from station.fibre_gyro.windows import begins_of, remarks_on, window_at_rest
from station.results.result import LeftOut
from station.runs.store import SavedRun

Floats = NDArray[np.float64]

PURPOSE = "selfcal"
_STATIC = ("before", "after")


@dataclass(frozen=True)
class _Row:
    """Mean of one segment, and when it began."""

    key: str
    conditions: dict[str, Any]
    mean: WindowMean
    begin_s: float
    remarks: tuple[str, ...]

    @property
    def at_s(self) -> float:
        """Middle of it."""
        return self.begin_s + self.mean.duration_s / 2


@dataclass(frozen=True)
class SelfcalFound:
    """Result of a self-calibration."""

    keys: tuple[str, ...]  # segments in the fit, one for each element of the arrays
    rate_dps: NDArray[np.float64]  # (n,): What the steps stand for, and the steps in counts
    number: NDArray[np.float64]
    net: NetOutputs
    fit: SlopeFit  # net output against rate: K_self
    numbers: SlopeFit  # injected numbers against rate, with the same weights: the mapping that was given
    reference: TableReference | None
    comparison: ScaleComparison  # against the table, or where there is none against the design
    static_missing: str  # {"", "before", "after"}: Which static output is missing, if one is
    drift_removed: bool  # whether the static output was interpolated in time
    # what each cause contributes to the uncertainty of K_self/K_table - 1 (or against the design), ppm
    contributions: Mapping[str, float]
    noise: NoiseModel | None  # the noise model that was counted
    # whether the noise within the segments is that of the model; else that of their words, which is larger
    noise_by_model: bool
    remarks: tuple[str, ...]  # what was missing or left out within the windows
    left_out: tuple[LeftOut, ...]
    table: TableFound | None  # of the rate-table segments in the same run


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> SelfcalFound:
    """Evaluate a self-calibration, and the rate-table segments of the same run."""
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
    model = noise_of(run, choices, settings.selfcal.axis)
    both = [*steps, *static]
    expected = None
    if model is not None:
        lengths = np.array([row.mean.duration_s for row in both])
        expected = settings.nominal_scale_factor * np.sqrt(model.fast_variance(lengths))
    noise_u, by_model = noise_of_means([row.mean for row in both], expected)
    u = np.maximum(noise_u[: len(steps)], 1e-12 * np.abs(given).max())
    level = static_level(
        [row.at_s for row in steps],
        [row.at_s for row in static],
        [row.mean.mean for row in static],
        noise_u[len(steps) :],
    )
    output = np.array([row.mean.mean for row in steps]) - level.level
    net = NetOutputs(output, u, level.mean, level.mean_u, level.drift, level.drift_u)
    drift_u = level.unseen_slope_u * abs(drift_in_slope(rates, u**-2.0, [row.at_s for row in steps]))
    common = _common_covariance(steps, static, level, noise_u[len(steps) :], model, settings.nominal_scale_factor)
    fit, scatter = _fit(rates, output, u, drift_u, common)
    excess, _ = _fit(rates, output - given, u, drift_u, common)
    table = find_axes(run, settings, choices) if run.taken_for(TABLE) else None
    reference = reference_of(run, settings, table)
    against = (
        (reference.scale_factor, reference.scale_factor_u) if reference else (settings.nominal_scale_factor, 0.0)
    )
    numbers_u = _mapping_u(steps, rates, u)
    if reference is not None and settings.selfcal.numbers == "fit":
        # the numbers were made of the scale factor that they are compared with: its error is in both
        against, numbers_u = (reference.scale_factor, abs(numbers_u - reference.scale_factor_u)), 0.0
    together_u = numbers_against_table_u(run, table, settings, rates, u**-2.0)
    if together_u is not None:
        against, numbers_u = (against[0], 0.0), together_u * abs(fit_slope(rates, given, u).slope)
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
        contributions=_contributions(scatter, fit, rates, u, drift_u, against, numbers_u),
        noise=model,
        noise_by_model=by_model,
        remarks=tuple(said for row in rows for said in row.remarks),
        left_out=tuple(left_out),
        table=table,
    )


def _common_covariance(
    steps: Sequence[_Row],
    static: Sequence[_Row],
    level: StaticLevel,
    static_u: Floats,
    model: NoiseModel | None,
    scale_factor: float,
) -> Floats:
    """Covariance of the net outputs beyond the noise of each step: static output, and slow noise by the model."""
    common = (level.weights * static_u**2) @ level.weights.T
    if model is not None:
        both = [*steps, *static]
        begins = np.array([row.begin_s for row in both])
        slow = model.slow_covariance(begins, begins + [row.mean.duration_s for row in both])
        net = np.hstack([np.eye(len(steps)), -level.weights])
        common = common + scale_factor**2 * net @ slow @ net.T
    return np.asarray(common, dtype=np.float64)


def _fit(rates: Floats, values: Floats, u: Floats, drift_u: float, common: Floats) -> tuple[SlopeFit, RunScatter]:
    """Fit a line; its uncertainties count the scatter of the points and the drift that may be left."""
    fit = fit_slope(rates, values, u)
    design = np.column_stack([rates, np.ones_like(rates)])
    scatter = find_run_scatter(design, values, u, 0.0, slow=common)
    slope, intercept = np.linalg.pinv(design / u[:, np.newaxis]) / u
    slope_u = math.hypot(scatter.standard_u(slope), drift_u)
    return replace(fit, slope_u=slope_u, intercept_u=scatter.standard_u(intercept)), scatter


def _contributions(
    scatter: RunScatter,
    fit: SlopeFit,
    rates: Floats,
    u: Floats,
    drift_u: float,
    against: tuple[float, float],
    numbers_u: float,
) -> dict[str, float]:
    """What each cause contributes to the uncertainty of the comparison, ppm."""
    slope = (np.linalg.pinv(np.column_stack([rates, np.ones_like(rates)]) / u[:, np.newaxis]) / u)[0]
    parts = scatter.parts(slope)
    causes = {
        "noise": parts["noise"],
        "slow noise": parts["slow noise"],
        "scatter": parts["scatter"],
        "drift": drift_u,
        "numbers": numbers_u,
    }
    relative = {name: PPM * value / abs(fit.slope) for name, value in causes.items()}
    return {**relative, "table": PPM * against[1] / abs(against[0])}


def _mapping_u(steps: Sequence[_Row], rates: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Uncertainty of the slope of the numbers, counts per deg/s: their errors have one sign, they share a base."""
    number_u = np.array([row.conditions.get("number_u", 0.0) for row in steps], dtype=np.float64)
    weight = u**-2.0
    return float(np.sum(weight * np.abs(rates) * number_u) / np.sum(weight * rates**2))


def _usable(run: SavedRun, settings: FogSettings) -> tuple[list[_Row], list[LeftOut]]:
    """Mean of every segment that can be used."""
    rows: list[_Row] = []
    left_out, segments = [], segments_of(run, PURPOSE)
    for segment, begin_s in zip(segments, begins_of(segments), strict=True):
        step = segment.conditions["number"] / settings.gyro.counts_per_code
        if steps_beyond_dac(step, settings.gyro.dac_bits):
            left_out.append(LeftOut(segment.key, beyond_converter(step, settings.gyro.dac_bits)))
            continue
        try:
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        rows.append(_Row(segment.key, segment.conditions, mean, begin_s, tuple(remarks_on(segment, mean))))
    return rows, left_out
