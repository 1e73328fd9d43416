"""What the segments of a rate-table run say: scale factor, earth rate and bias of each axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.fibre_gyro import (
    AxisFit,
    OddEven,
    RateDifferences,
    TableRuns,
    WindowMean,
    bias_at_latitude,
    fit_axis,
    missing_senses,
    odd_even_parts,
    rate_differences,
    table_runs,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import check_table_rate, window_over_turns
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "table"


@dataclass(frozen=True)
class AxisResult:
    """What the table run says of one axis.

    Attributes
    ----------
    keys : tuple of str
        Segments in the result, one for each element of ``runs``.
    windows : tuple of WindowMean
        One for each key.
    parts : OddEven
        Of the runs with the upper end up (or, if there are none, the lower).
    differences : RateDifferences or None
        ``None`` with fewer than two rates.
    bias_dph : tuple of float
        And its standard uncertainty: from the even part and the latitude, or from both ends up.
    """

    axis: str
    keys: tuple[str, ...]
    windows: tuple[WindowMean, ...]
    runs: TableRuns
    parts: OddEven
    differences: RateDifferences | None
    fit: AxisFit
    bias_dph: tuple[float, float]


@dataclass(frozen=True)
class TableFound:
    """Results of all axes, and what was left out.

    Attributes
    ----------
    axes : tuple of AxisResult
        Those that give a result.
    """

    axes: tuple[AxisResult, ...]
    left_out: tuple[LeftOut, ...]

    def of(self, axis: str) -> AxisResult | None:
        """Result of one axis, ``None`` if there is none."""
        return next((result for result in self.axes if result.axis == axis), None)


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> TableFound:
    """Evaluate a rate-table run.

    Raises
    ------
    NoUsableSignal
        No axis was turned in both senses.
    """
    found = find_axes(run, settings)
    if not found.axes:
        raise NoUsableSignal(f"no axis has runs in both senses{reasons_of(found.left_out)}")
    return found


def find_axes(run: SavedRun, settings: FogSettings) -> TableFound:
    """Evaluate the rate-table segments of a run, whatever else it holds; perhaps no axis gives a result."""
    segments = segments_of(run, PURPOSE)
    windows: dict[str, tuple[Segment, WindowMean]] = {}
    left_out: list[LeftOut] = []
    for segment in segments:
        try:
            windows[segment.key] = segment, _window(segment, settings)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
    axes = dict.fromkeys(segment.conditions["axis"] for segment in segments)
    results = []
    for axis in axes:
        of_axis = {key: pair for key, pair in windows.items() if pair[0].conditions["axis"] == axis}
        _leave_out_single_senses(of_axis, left_out)
        if (result := _axis_result(axis, of_axis, settings)) is not None:
            results.append(result)
    return TableFound(tuple(results), tuple(left_out))


def _window(segment: Segment, settings: FogSettings) -> WindowMean:
    table = settings.table
    check_table_rate(segment.conditions, table.rate_tolerance_ppm)
    return window_over_turns(
        segment, turns=table.turns, window_s=table.window_s, resolution=settings.gyro.output_resolution
    )


def _runs_of(windows: dict[str, tuple[Segment, WindowMean]]) -> TableRuns:
    conditions = [segment.conditions for segment, _ in windows.values()]
    means = [mean for _, mean in windows.values()]
    # words without any scatter (a simulation without noise) still need a weight
    floor = [1e-12 * abs(mean.mean) + 1e-12 for mean in means]
    return table_runs(
        [c["rate_dps"] for c in conditions],
        [mean.mean for mean in means],
        np.maximum([mean.mean_u for mean in means], floor),
        rate_dps=[c.get("table_rate_dps", c["rate_dps"]) for c in conditions],
        duration_s=[mean.duration_s for mean in means],
        end_up=[c.get("end_up", 1) for c in conditions],
    )


def _leave_out_single_senses(windows: dict[str, tuple[Segment, WindowMean]], left_out: list[LeftOut]) -> None:
    """Take out, by name, every rate whose opposite is missing or was left out."""
    for end_up in (1, -1):
        of_end = {key: pair for key, pair in windows.items() if pair[0].conditions.get("end_up", 1) == end_up}
        alone = missing_senses(_runs_of(of_end)) if of_end else []
        for key, (segment, _) in of_end.items():
            if float(segment.conditions["rate_dps"]) in alone:
                opposite = -float(segment.conditions["rate_dps"])
                left_out.append(
                    LeftOut(key, f"the opposite sense ({opposite:+.10g} deg/s) is missing: take it too")
                )
                del windows[key]


def _axis_result(
    axis: str, windows: dict[str, tuple[Segment, WindowMean]], settings: FogSettings
) -> AxisResult | None:
    if len(windows) < 2:
        return None
    runs = _runs_of(windows)
    parts = odd_even_parts(runs, end_up=1 if np.any(runs.end_up > 0) else -1)
    irreproducibility = settings.table.irreproducibility_ppm
    differences = None
    if parts.rate_dps.size >= 2:
        differences = rate_differences(parts, irreproducibility_ppm=irreproducibility)
    fit = fit_axis(runs, irreproducibility_ppm=irreproducibility)
    bias = bias_at_latitude(fit, settings.site.latitude_deg)
    means = tuple(mean for _, mean in windows.values())
    return AxisResult(axis, tuple(windows), means, runs, parts, differences, fit, bias)
