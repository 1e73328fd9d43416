"""What the segments of a rate-table run say: scale factor, earth rate and bias of each axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.fibre_gyro import (
    AxisFit,
    InputAxisTilt,
    OddEven,
    RateDifferences,
    TableRuns,
    ThreeAxes,
    WindowMean,
    bias_at_latitude,
    fit_axis,
    fit_three_axes,
    horizontal_earth_rate_dps,
    input_axis_tilt,
    missing_senses,
    odd_even_parts,
    pooled_noise,
    rate_differences,
    table_runs,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import angle_clock_u, reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import check_table_rate, remarks_on, window_over_turns
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "table"
_OUTPUTS = {"counts_x": "X", "counts_y": "Y", "counts_z": "Z"}  # columns with the output of each of several gyros


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
    tilt : InputAxisTilt or None
        Of the input axis against the table's axis, by the horizontal earth rate; ``None`` if it cannot show.
    remarks : tuple of str
        What was missing or left out within the windows.
    """

    axis: str
    keys: tuple[str, ...]
    windows: tuple[WindowMean, ...]
    runs: TableRuns
    parts: OddEven
    differences: RateDifferences | None
    fit: AxisFit
    bias_dph: tuple[float, float]
    tilt: InputAxisTilt | None
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class TableFound:
    """Results of all axes, and what was left out.

    Attributes
    ----------
    axes : tuple of AxisResult
        Those that give a result.
    matrix : ThreeAxes or None
        Of all gyros, where the segments hold the output of more than the one along the table's axis.
    """

    axes: tuple[AxisResult, ...]
    left_out: tuple[LeftOut, ...]
    matrix: ThreeAxes | None = None

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
    used = {key: windows[key][0] for result in results for key in result.keys}
    matrix = _matrix(used, settings, left_out)
    return TableFound(tuple(results), tuple(left_out), matrix)


def _matrix(used: Mapping[str, Segment], settings: FogSettings, left_out: list[LeftOut]) -> ThreeAxes | None:
    """Fit the outputs of all gyros in the segments that are used, if they hold more than one."""
    columns = sorted({name for one in used.values() for name in one.recording.extra if name in _OUTPUTS})
    if len(columns) < 2:
        return None
    names = [_OUTPUTS[column] for column in columns]
    means, means_u = [], []
    try:
        for segment in used.values():
            of_all = [_window(segment, settings, column) for column in columns]
            means.append([one.mean for one in of_all])
            means_u.append([max(one.mean_u, 1e-12 * abs(of_all[0].mean) + 1e-12) for one in of_all])
        conditions = [segment.conditions for segment in used.values()]
        return fit_three_axes(
            names,
            [str(one["axis"]).upper() for one in conditions],
            [one.get("table_rate_dps", one["rate_dps"]) for one in conditions],
            means,
            means_u,
            end_up=[one.get("end_up", 1) for one in conditions],
            vertical_earth_rate_dps=vertical_earth_rate_dph(settings.site.latitude_deg) / 3600,
            irreproducibility_ppm=settings.table.irreproducibility_ppm,
        )
    except (ValueError, KeyError) as error:
        left_out.append(LeftOut("matrix of the axes", str(error)))
        return None


def _window(segment: Segment, settings: FogSettings, column: str = "") -> WindowMean:
    table = settings.table
    check_table_rate(segment.conditions, table.rate_tolerance_ppm)
    resolution = settings.gyro.output_resolution
    return window_over_turns(
        segment, turns=table.turns, window_s=table.window_s, resolution=resolution, column=column
    )


def _runs_of(windows: dict[str, tuple[Segment, WindowMean]]) -> TableRuns:
    conditions = [segment.conditions for segment, _ in windows.values()]
    means = [mean for _, mean in windows.values()]
    # words without any scatter (a simulation without noise) still need a weight
    floor = [1e-12 * abs(mean.mean) + 1e-12 for mean in means]
    return table_runs(
        [c["rate_dps"] for c in conditions],
        [mean.mean for mean in means],
        np.maximum(pooled_noise(means), floor),
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
    end_up = 1 if np.any(runs.end_up > 0) else -1
    parts = odd_even_parts(runs, end_up=end_up)
    irreproducibility = settings.table.irreproducibility_ppm
    differences = None
    if parts.rate_dps.size >= 2:
        differences = rate_differences(parts, irreproducibility_ppm=irreproducibility, runs=runs, end_up=end_up)
    fit = fit_axis(runs, irreproducibility_ppm=irreproducibility)
    if clock_u := angle_clock_u([segment for segment, _ in windows.values()]):
        fit = replace(fit, scale_factor_u=math.hypot(fit.scale_factor_u, clock_u * fit.scale_factor))
        if differences is not None:
            common = np.hypot(differences.irreproducibility_u, clock_u * differences.number)
            differences = replace(differences, irreproducibility_u=common)
    bias = bias_at_latitude(fit, settings.site.latitude_deg)
    means = tuple(mean for _, mean in windows.values())
    remarks = [said for segment, mean in windows.values() for said in remarks_on(segment, mean)]
    tilt = _tilt(means, fit, settings)
    return AxisResult(axis, tuple(windows), means, runs, parts, differences, fit, bias, tilt, tuple(remarks))


def _tilt(means: Sequence[WindowMean], fit: AxisFit, settings: FogSettings) -> InputAxisTilt | None:
    seen = abs(fit.scale_factor) * horizontal_earth_rate_dps(settings.site.latitude_deg)
    # the noise of all windows is known better than that of each
    density = np.mean([one.sine_u**2 * one.duration_s for one in means])
    spread = [float(np.sqrt(density / one.duration_s)) for one in means]
    try:
        return input_axis_tilt([one.sine for one in means], spread, seen)
    except ValueError:
        return None
