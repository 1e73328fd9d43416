"""Uncertainty budget of a result: made from what the records and the settings say, as JSON and as a table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.budget import (
    BenchKnowledge,
    Budget,
    Corner,
    Reference,
    TableGeometry,
    lock_in_budget,
    operating_point,
)
from analysis.rotation import earth_rate_on_axis
from station.results.numbers import with_uncertainty

if TYPE_CHECKING:
    from station.lock_in.evaluate import Evaluation
    from station.settings.load import Settings

_AC_CORNER_HZ = 10.0
"""Lower -3 dB corner of the AC coupling of a TDS2014 with a direct cable; a 10X probe makes it a tenth."""


def bench_knowledge(settings: Settings, table: TableGeometry | None = None) -> BenchKnowledge:
    """Collect what the settings say of a bench.

    Parameters
    ----------
    settings : Settings
    table : TableGeometry, optional
        Where the rate of the table is known.

    Returns
    -------
    BenchKnowledge
        With nan for whatever nobody stated.
    """
    scope, stated, front_end = settings.scope, settings.budget, settings.front_end
    share = 0.01 * (stated.front_end_u_percent if stated is not None else 0.0)
    coupling = Corner(_AC_CORNER_HZ / scope.probe if scope.coupling == "AC" else 0.0)
    if front_end.ac_corner_hz:
        coupling = Corner(front_end.ac_corner_hz, share * front_end.ac_corner_hz, corrected=True)
    if stated is None:
        return BenchKnowledge(high_pass=coupling, table=table)
    bandwidth = Corner(stated.bandwidth_hz or math.nan)
    if front_end.low_pass_hz:
        bandwidth = Corner(front_end.low_pass_hz, share * front_end.low_pass_hz, corrected=True)
    return BenchKnowledge(
        scale_factor_u_ppm=stated.scale_factor_u_ppm or math.nan,
        time_base_limit_ppm=stated.time_base_limit_ppm,
        distortion_limit=10 ** (stated.distortion_limit_dbc / 20) if stated.distortion_limit_dbc else math.nan,
        bandwidth=bandwidth,
        high_pass=coupling,
        gain=Corner(stated.gain_corner_hz or math.nan),
        response_u=share if front_end.response or front_end.response_file else math.nan,
        table=table,
    )


def table_geometry(
    evaluation: Evaluation, settings: Settings, *, azimuth_deg: float = math.nan, azimuth_u_deg: float = 0.0
) -> TableGeometry | None:
    """Say how the rate on the axis came about in an evaluated run.

    Parameters
    ----------
    evaluation : Evaluation
    settings : Settings
        Those of the run.
    azimuth_deg, azimuth_u_deg : float, optional
        Of the axis from north, where it is known.

    Returns
    -------
    TableGeometry or None
        ``None`` where no table with a known rate was used.
    """
    tilt, check = evaluation.tilt, evaluation.table_check
    if tilt is None or check is None:
        return None
    latitude = settings.site.latitude_deg
    vertical = float(earth_rate_on_axis(latitude, tilt.tilt_deg, 90.0))
    table_rate = (check.input_rate - vertical) / math.cos(math.radians(tilt.tilt_deg))
    stated = settings.budget
    return TableGeometry(
        table_rate=table_rate,
        table_rate_u=1e-6 * stated.table_rate_u_ppm * abs(table_rate) if stated is not None else 0.0,
        tilt_deg=tilt.tilt_deg,
        tilt_u_deg=tilt.tilt_u_deg,
        latitude_deg=latitude,
        latitude_u_deg=stated.latitude_u_deg if stated is not None else 0.0,
        azimuth_deg=azimuth_deg,
        azimuth_u_deg=azimuth_u_deg,
    )


def budget_of(evaluation: Evaluation, settings: Settings, table: TableGeometry | None = None) -> Budget:
    """Make the budget of an evaluated run.

    Parameters
    ----------
    evaluation : Evaluation
        With a usable result of the exact relation.
    settings : Settings
        Those of the run.
    table : TableGeometry, optional
        Rate, tilt and azimuth of the table; by default what the evaluation knows of them. Needed where the
        evaluation's reference is a rate that was given.

    Returns
    -------
    Budget

    Raises
    ------
    ValueError
        There is no lock-in rate, or it was not found with the exact relation.
    """
    if evaluation.method.relation != "exact":
        raise ValueError("a budget is made for the exact relation; the others are wrong by more than their noise")
    reference: Reference = "beat" if evaluation.method.input_rate is None else "rate"
    spacing = float(np.mean([abs(wave.preamble.ymult) for wave in evaluation.waveforms]))
    samples = min(wave.codes.size for wave in evaluation.waveforms)
    point = operating_point(evaluation.each, evaluation.combined, samples=samples, level_spacing=spacing)
    table = table or table_geometry(evaluation, settings)
    return lock_in_budget(point, bench_knowledge(settings, table), reference)


def budget_document(budget: Budget) -> dict[str, Any]:
    """Return a budget as plain JSON; null stands for infinitely many degrees of freedom.

    Parameters
    ----------
    budget : Budget

    Returns
    -------
    dict
    """
    return {
        "reference": budget.reference,
        "lock_in_rate_dps": budget.lock_in_rate,
        "combined_u_dps": budget.combined_u,
        "combined_u_percent": 100 * budget.relative_u,
        "effective_degrees_of_freedom": _finite(budget.effective_degrees_of_freedom),
        "coverage_factor": budget.coverage_factor,
        "expanded_u_95_dps": budget.expanded_u_95,
        "inputs": [
            {
                "name": line.name,
                "quantity": line.quantity,
                "unit": line.unit,
                "value": _finite(line.value),
                "u": line.u,
                "distribution": line.distribution,
                "sensitivity_dps_per_unit": line.sensitivity,
                "contribution_dps": line.contribution,
                "share_of_variance": budget.share(line),
                "degrees_of_freedom": _finite(line.degrees_of_freedom),
                "note": line.note,
            }
            for line in budget.inputs
        ],
        "not_stated": list(budget.unstated),
    }


BUDGET_COLUMNS = (
    "quantity",
    "value",
    "u (k = 1)",
    "distribution",
    "sensitivity, deg/s per unit",
    "contribution, deg/s",
    "share",
    "d.o.f.",
)


def budget_rows(budget: Budget) -> list[tuple[str, ...]]:
    """Return the lines of a budget as text under `BUDGET_COLUMNS`, the largest contribution first.

    Parameters
    ----------
    budget : Budget

    Returns
    -------
    list of tuple of str
        The last one is the combined uncertainty.
    """
    rows: list[tuple[str, ...]] = []
    for line in budget.inputs:
        unit = "" if line.unit == "1" else f" {line.unit}"
        rows.append(
            (
                line.quantity,
                f"{line.value:.6g}{unit}",
                f"{line.u:.2g}{unit}",
                line.distribution,
                f"{line.sensitivity:.3g}" if line.sensitivity else "0",
                f"{line.contribution:.2g}" if line.contribution else "0",
                _percent(budget.share(line)),
                _freedom(line.degrees_of_freedom),
            )
        )
    rows.append(
        (
            "lock-in rate, combined",
            f"{budget.lock_in_rate:.6g} deg/s",
            f"{budget.combined_u:.2g} deg/s",
            "",
            "",
            f"{budget.combined_u:.2g}",
            "100 %",
            _freedom(budget.effective_degrees_of_freedom),
        )
    )
    return rows


def budget_sentences(budget: Budget) -> list[str]:
    """Say in words what the budget comes to, and what it does not hold.

    Parameters
    ----------
    budget : Budget

    Returns
    -------
    list of str
    """
    value = with_uncertainty(budget.lock_in_rate, budget.combined_u, "deg/s")
    said = [
        f"Lock-in rate {value}, all inputs counted; U95 = {budget.expanded_u_95:.2g} deg/s "
        f"({100 * budget.coverage_factor * budget.relative_u:.2g} %) with k = {budget.coverage_factor:.2f}."
    ]
    if budget.inputs and budget.inputs[0].contribution > 0:
        first = budget.inputs[0]
        said.append(f"The largest part is: {first.quantity} ({_percent(budget.share(first))} of the variance).")
    if budget.unstated:
        said.append(
            f"Not counted, since nobody stated it: {'; '.join(budget.unstated)}. "
            "The [budget] section of the settings is the place."
        )
    return said


def _percent(share: float) -> str:
    return "0" if share == 0 else "< 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


def _freedom(value: float) -> str:
    return "∞" if value > 1e6 else f"{value:.0f}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
