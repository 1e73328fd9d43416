"""What the segments of a rate-table run say: scale factor, earth rate and bias of each axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    AxisFit,
    InputAxisTilt,
    Linearity,
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
    noise_of_means,
    odd_even_parts,
    rate_differences,
    scale_linearity,
    table_runs,
    vertical_earth_rate_dph,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.allan.noise_model import NoiseModel, noise_of
from station.fibre_gyro.common import angle_clock_u, reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import begins_of, check_table_rate, remarks_on, window_over_turns
from station.results.result import LeftOut
from station.runs.store import SavedRun

Floats = NDArray[np.float64]

PURPOSE = "table"
_OUTPUTS = {"counts_x": "X", "counts_y": "Y", "counts_z": "Z"}  # columns with the output of each of several gyros


@dataclass(frozen=True)
class AxisResult:
    """What the table run says of one axis."""

    axis: str
    keys: tuple[str, ...]  # segments in the result, one for each element of ``runs``
    windows: tuple[WindowMean, ...]  # one for each key
    runs: TableRuns
    parts: OddEven  # of the runs with the upper end up (or, if there are none, the lower)
    differences: RateDifferences | None  # ``None`` with fewer than two rates
    fit: AxisFit
    # and its standard uncertainty: from the even part and the latitude, or from both ends up
    bias_dph: tuple[float, float]
    # of the input axis against the table's axis, by the horizontal earth rate; ``None`` if it cannot show
    tilt: InputAxisTilt | None
    linearity: Linearity | None  # scale-factor error over the rates; ``None`` where they are no ladder
    noise: NoiseModel | None  # the noise model that was counted
    # whether the noise within the runs is that of the model; else that of their words, which is larger
    noise_by_model: bool
    remarks: tuple[str, ...]  # what was missing or left out within the windows


@dataclass(frozen=True)
class TableFound:
    """Results of all axes, and what was left out."""

    axes: tuple[AxisResult, ...]  # those that give a result
    left_out: tuple[LeftOut, ...]
    # of all gyros, where the segments hold the output of more than the one along the table's axis
    matrix: ThreeAxes | None = None

    def of(self, axis: str) -> AxisResult | None:
        """Result of one axis, ``None`` if there is none."""
        return next((result for result in self.axes if result.axis == axis), None)


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> TableFound:
    """Evaluate a rate-table run."""
    found = find_axes(run, settings, choices)
    if not found.axes:
        raise NoUsableSignal(f"no axis has runs in both senses{reasons_of(found.left_out)}")
    return found


def find_axes(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any] | None = None) -> TableFound:
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
        noise = noise_of(run, choices or {}, axis)
        if (result := _axis_result(axis, of_axis, settings, noise)) is not None:
            results.append(result)
    used = {key: windows[key][0] for result in results for key in result.keys}
    models = {axis: noise_of(run, choices or {}, axis) for axis in _OUTPUTS.values()}
    matrix = _matrix(used, settings, models, left_out)
    return TableFound(tuple(results), tuple(left_out), matrix)


def _matrix(
    used: Mapping[str, Segment],
    settings: FogSettings,
    models: Mapping[str, NoiseModel | None],
    left_out: list[LeftOut],
) -> ThreeAxes | None:
    """Fit the outputs of all gyros in the segments that are used, if they hold more than one."""
    columns = sorted({name for one in used.values() for name in one.recording.extra if name in _OUTPUTS})
    if len(columns) < 2:
        return None
    names = [_OUTPUTS[column] for column in columns]
    segments = list(used.values())
    conditions = [segment.conditions for segment in segments]
    begins = np.array(begins_of(segments))
    try:
        windows = [[_window(segment, settings, column) for segment in segments] for column in columns]
        means = [[one.mean for one in of_gyro] for of_gyro in windows]
        ends = begins + [one.duration_s for one in windows[0]]
        noise = [
            _noise(of_gyro, models[name], _sensitivity(means, segments, name), begins)
            for name, of_gyro in zip(names, windows, strict=True)
        ]
        return fit_three_axes(
            names,
            [str(one["axis"]).upper() for one in conditions],
            [one.get("table_rate_dps", one["rate_dps"]) for one in conditions],
            np.transpose(means),
            np.transpose([one.u for one in noise]),
            end_up=[one.get("end_up", 1) for one in conditions],
            at_s=(begins + ends) / 2 + _no_time(conditions),
            vertical_earth_rate_dps=vertical_earth_rate_dph(settings.site.latitude_deg) / 3600,
            irreproducibility_ppm=settings.table.irreproducibility_ppm,
            table_rate_u_ppm=settings.table.rate_u_ppm or 0.0,
            slow=[one.slow for one in noise],
        )
    except (ValueError, KeyError) as error:
        left_out.append(LeftOut("matrix of the axes", str(error)))
        return None


def _sensitivity(means: Sequence[Sequence[float]], segments: Sequence[Segment], name: str) -> float:
    """Roughly the scale factor of one of several gyros, for its noise model: largest output over its rate."""
    largest = max(abs(mean) for of_gyro in means for mean in of_gyro)
    return largest / max(abs(float(one.conditions["rate_dps"])) for one in segments)


@dataclass(frozen=True)
class _Noise:
    """Noise of the means of one gyro: within the runs, counts, and slow, counts^2."""

    u: Floats
    slow: Floats | None
    by_model: bool


def _noise(windows: Sequence[WindowMean], model: NoiseModel | None, scale_factor: float, begins: Floats) -> _Noise:
    """Noise by the model where there is one and the words do not scatter more than it says, else by the words."""
    if model is None:
        return _Noise(noise_of_means(windows)[0], None, by_model=False)
    duration = np.array([one.duration_s for one in windows])
    u, by_model = noise_of_means(windows, scale_factor * np.sqrt(model.fast_variance(duration)))
    return _Noise(u, scale_factor**2 * model.slow_covariance(begins, begins + duration), by_model)


def _window(segment: Segment, settings: FogSettings, column: str = "") -> WindowMean:
    table = settings.table
    check_table_rate(segment.conditions, table.rate_tolerance_ppm)
    resolution = settings.gyro.output_resolution
    return window_over_turns(
        segment, turns=table.turns, window_s=table.window_s, resolution=resolution, column=column
    )


def _runs_of(windows: Mapping[str, tuple[Segment, WindowMean]], noise: _Noise, begins: Floats) -> TableRuns:
    conditions = [segment.conditions for segment, _ in windows.values()]
    means = [mean for _, mean in windows.values()]
    duration = np.array([mean.duration_s for mean in means])
    return table_runs(
        [c["rate_dps"] for c in conditions],
        [mean.mean for mean in means],
        noise.u,
        rate_dps=[c.get("table_rate_dps", c["rate_dps"]) for c in conditions],
        duration_s=duration,
        end_up=[c.get("end_up", 1) for c in conditions],
        at_s=begins + duration / 2 + _no_time(conditions),
        slow=noise.slow,
    )


def _no_time(conditions: Sequence[Mapping[str, Any]]) -> float:
    """nan for the simulated bench, whose segments follow no clock: there is no drift to be seen; else 0."""
    return math.nan if any("model" in one for one in conditions) else 0.0


def _leave_out_single_senses(windows: dict[str, tuple[Segment, WindowMean]], left_out: list[LeftOut]) -> None:
    """Take out, by name, every rate whose opposite is missing or was left out."""
    for end_up in (1, -1):
        of_end = {key: pair for key, pair in windows.items() if pair[0].conditions.get("end_up", 1) == end_up}
        rates = [float(segment.conditions["rate_dps"]) for segment, _ in of_end.values()]
        alone = missing_senses(table_runs(rates, 0.0, 1.0)) if rates else []
        for key, rate in zip(of_end, rates, strict=True):
            if rate in alone:
                opposite = -rate
                left_out.append(
                    LeftOut(key, f"the opposite sense ({opposite:+.10g} deg/s) is missing: take it too")
                )
                del windows[key]


def _axis_result(
    axis: str,
    windows: dict[str, tuple[Segment, WindowMean]],
    settings: FogSettings,
    model: NoiseModel | None,
) -> AxisResult | None:
    if len(windows) < 2:
        return None
    means = tuple(mean for _, mean in windows.values())
    segments = [segment for segment, _ in windows.values()]
    begins = np.array(begins_of(segments))
    noise = _noise(means, model, _sensitivity([[one.mean for one in means]], segments, axis), begins)
    runs = _runs_of(windows, noise, begins)
    end_up = 1 if np.any(runs.end_up > 0) else -1
    parts = odd_even_parts(runs, end_up=end_up)
    irreproducibility = settings.table.irreproducibility_ppm
    differences = None
    if parts.rate_dps.size >= 2:
        differences = rate_differences(parts, irreproducibility_ppm=irreproducibility, runs=runs, end_up=end_up)
    fit = fit_axis(
        runs, irreproducibility_ppm=irreproducibility, table_rate_u_ppm=settings.table.rate_u_ppm or 0.0
    )
    if clock_u := angle_clock_u(segments):
        part = clock_u * abs(fit.scale_factor)
        fit = replace(
            fit,
            scale_factor_u=math.hypot(fit.scale_factor_u, part),
            contributions={**fit.contributions, "clock": part},
        )
        if differences is not None:
            common = np.hypot(differences.irreproducibility_u, clock_u * differences.number)
            differences = replace(differences, irreproducibility_u=common)
    return AxisResult(
        axis=axis,
        keys=tuple(windows),
        windows=means,
        runs=runs,
        parts=parts,
        differences=differences,
        fit=fit,
        bias_dph=bias_at_latitude(fit, settings.site.latitude_deg),
        tilt=_tilt(means, fit, settings),
        linearity=scale_linearity(runs, irreproducibility_ppm=irreproducibility),
        noise=model,
        noise_by_model=noise.by_model,
        remarks=tuple(said for segment, mean in windows.values() for said in remarks_on(segment, mean)),
    )


def _tilt(means: Sequence[WindowMean], fit: AxisFit, settings: FogSettings) -> InputAxisTilt | None:
    seen = abs(fit.scale_factor) * horizontal_earth_rate_dps(settings.site.latitude_deg)
    # the noise of all windows is known better than that of each
    density = np.mean([one.sine_u**2 * one.duration_s for one in means])
    spread = [float(np.sqrt(density / one.duration_s)) for one in means]
    freedom = sum(one.sine_freedom for one in means)
    try:
        return input_axis_tilt([one.sine for one in means], spread, seen, freedom=freedom)
    except ValueError:
        return None
