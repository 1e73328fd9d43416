"""What the segments of a self-calibration say: slope, intercept and static output of the injected steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    NetOutputs,
    ScaleComparison,
    SlopeFit,
    compare_scale,
    fit_slope,
    net_outputs,
    steps_beyond_dac,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import beyond_converter, not_taken, reasons_of
from station.fibre_gyro.recordings import segments_of
from station.fibre_gyro.selfcal.numbers import TableReference, reference_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.table.evaluate import PURPOSE as TABLE
from station.fibre_gyro.table.evaluate import TableFound, find_axes
from station.fibre_gyro.windows import window_at_rest
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "selfcal"
_STATIC = ("before", "after")
_Row = tuple[str, tuple[float, float], dict[str, Any]]


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
    static = {conditions["static"]: mean for _, mean, conditions in rows if conditions["static"]}
    steps = [row for row in rows if not row[2]["static"]]
    missing = [name for name in _STATIC if name not in static]
    if not static or len(steps) < 3:
        raise NoUsableSignal(
            f"a self-calibration needs a static output and at least three steps, there are {len(static)} and "
            f"{len(steps)}{reasons_of(left_out)}"
        )
    # where one is missing the other stands for both
    before, after = (static.get(name, next(iter(static.values()))) for name in _STATIC)
    rates = np.array([conditions["stands_for_dps"] for _, _, conditions in steps], dtype=np.float64)
    given = np.array([conditions["number"] for _, _, conditions in steps], dtype=np.float64)
    u = np.maximum([mean[1] for _, mean, _ in steps], 1e-12 * np.abs(given).max())
    net = net_outputs([mean[0] for _, mean, _ in steps], u, before, after)
    fit, numbers = fit_slope(rates, net.output, u), fit_slope(rates, given, u)
    table = find_axes(run, settings) if run.taken_for(TABLE) else None
    reference = reference_of(run, settings, table)
    against = (
        (reference.scale_factor, reference.scale_factor_u) if reference else (settings.nominal_scale_factor, 0.0)
    )
    return SelfcalFound(
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
        table=table,
    )


def _mapping_u(steps: Sequence[_Row], rates: NDArray[np.float64], u: NDArray[np.float64]) -> float:
    """Uncertainty of the slope of the numbers, counts per deg/s: their errors have one sign, they share a base."""
    number_u = np.array([conditions.get("number_u", 0.0) for _, _, conditions in steps], dtype=np.float64)
    weight = u**-2.0
    return float(np.sum(weight * np.abs(rates) * number_u) / np.sum(weight * rates**2))


def _usable(run: SavedRun, settings: FogSettings) -> tuple[list[_Row], list[LeftOut]]:
    """Key, mean with uncertainty, and conditions of every segment that can be used."""
    rows: list[_Row] = []
    left_out = []
    for segment in segments_of(run, PURPOSE):
        step = segment.conditions["number"] / settings.gyro.counts_per_code
        if steps_beyond_dac(step, settings.gyro.dac_bits):
            left_out.append(LeftOut(segment.key, beyond_converter(step, settings.gyro.dac_bits)))
            continue
        try:
            mean = window_at_rest(segment, resolution=settings.gyro.output_resolution)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        rows.append((segment.key, (mean.mean, mean.mean_u), segment.conditions))
    return rows, left_out
