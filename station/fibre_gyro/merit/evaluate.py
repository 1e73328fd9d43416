"""What runs over the whole range say: the figures of merit, from cold starts and at other temperatures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    ResidualPattern,
    ScaleFigures,
    net_outputs,
    repeatability_ppm,
    residual_pattern,
    scale_figures,
    temperature_coefficient_ppm,
)
from station.errors import NoUsableSignal
from station.fibre_gyro.common import reasons_of
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import check_table_rate, window_at_rest, window_over_turns
from station.results.result import LeftOut
from station.runs.store import SavedRun

PURPOSE = "figures"
_MANY_TURNS = 100_000


@dataclass(frozen=True)
class MeritRun:
    """One run over the range.

    Attributes
    ----------
    name : str
        ``"run 1"`` or ``"run at +60 deg C"``.
    temperature_c : float
        As the gyro or the log gives it, else as planned; nan if nobody knows.
    rate_dps, output, output_u : ndarray, shape (n,)
        Net output: less the mean of the static outputs before and after.
    static_drift, static_drift_u : float
        Static output after less that before, counts; nan if one is missing.
    """

    name: str
    temperature_c: float
    rate_dps: NDArray[np.float64]
    output: NDArray[np.float64]
    output_u: NDArray[np.float64]
    static_drift: float
    static_drift_u: float
    figures: ScaleFigures
    pattern: ResidualPattern


@dataclass(frozen=True)
class MeritFound:
    """Figures of merit of a gyro.

    Attributes
    ----------
    runs : tuple of MeritRun
        From cold starts at the reference temperature.
    scale_factor, scale_factor_u : float
        Mean of the runs, and its standard uncertainty; counts per deg/s.
    nonlinearity_ppm, nonlinearity_of_point_ppm, asymmetry_ppm : float
        The largest of the runs; nan where no run gives one.
    repeatability_ppm, temperature_coefficient_ppm : float
        nan where there are too few runs.
    """

    runs: tuple[MeritRun, ...]
    at_temperatures: tuple[MeritRun, ...]
    scale_factor: float
    scale_factor_u: float
    nonlinearity_ppm: float
    nonlinearity_of_point_ppm: float
    asymmetry_ppm: float
    repeatability_ppm: float
    temperature_coefficient_ppm: float
    left_out: tuple[LeftOut, ...]

    @property
    def all_runs(self) -> tuple[MeritRun, ...]:
        """Those from cold starts first."""
        return (*self.runs, *self.at_temperatures)


def evaluate(run: SavedRun, settings: FogSettings, choices: Mapping[str, Any]) -> MeritFound:
    """Evaluate the segments of a run.

    Raises
    ------
    NoUsableSignal
        No run is complete enough for a line.
    """
    left_out: list[LeftOut] = []
    by_run: dict[str, list[Segment]] = {}
    for segment in segments_of(run, PURPOSE):
        by_run.setdefault(segment.conditions.get("run", "run 1"), []).append(segment)
    found = {name: _one_run(name, segments, settings, left_out) for name, segments in by_run.items()}
    good = {name: one for name, one in found.items() if one is not None}
    reference = {name for name, segments in by_run.items() if segments[0].conditions.get("reference", True)}
    runs = tuple(one for name, one in good.items() if name in reference)
    if not runs:
        raise NoUsableSignal(f"no run has enough points for a scale factor{reasons_of(left_out)}")
    others = tuple(one for name, one in good.items() if name not in reference)
    k = np.array([one.figures.fit.slope for one in runs])
    each = [one.figures for one in runs]
    scale_u = float(np.std(k, ddof=1) / math.sqrt(k.size)) if k.size > 1 else each[0].fit.slope_u
    return MeritFound(
        runs=runs,
        at_temperatures=others,
        scale_factor=float(k.mean()),
        scale_factor_u=scale_u,
        nonlinearity_ppm=_largest([one.nonlinearity_ppm for one in each]),
        nonlinearity_of_point_ppm=_largest([one.nonlinearity_of_point_ppm for one in each]),
        asymmetry_ppm=_largest([one.asymmetry_ppm for one in each]),
        repeatability_ppm=repeatability_ppm(k) if k.size > 1 else math.nan,
        temperature_coefficient_ppm=_temperature_coefficient(runs, others),
        left_out=tuple(left_out),
    )


def _largest(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return max(known, default=math.nan)


def _temperature_coefficient(runs: Sequence[MeritRun], others: Sequence[MeritRun]) -> float:
    known = [one for one in others if math.isfinite(one.temperature_c)]
    middle = float(np.mean([one.temperature_c for one in runs]))
    if not known or not math.isfinite(middle):
        return math.nan
    reference = (float(np.mean([one.figures.fit.slope for one in runs])), middle)
    slopes, temperatures = [one.figures.fit.slope for one in known], [one.temperature_c for one in known]
    try:
        return temperature_coefficient_ppm(slopes, temperatures, reference=reference)
    except ValueError:
        return math.nan


def _one_run(
    name: str, segments: Sequence[Segment], settings: FogSettings, left_out: list[LeftOut]
) -> MeritRun | None:
    """Evaluate one run; segments that cannot be used are added to `left_out`."""
    rates, means, static = [], [], []
    for position, segment in enumerate(segments):
        try:
            mean = _mean(segment, settings)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
            continue
        if segment.conditions["rate_dps"] == 0:
            static.append((2 * position >= len(segments), mean))
        else:
            rates.append(segment.conditions.get("table_rate_dps", segment.conditions["rate_dps"]))
            means.append(mean)
    before = next((mean for late, mean in static if not late), None)
    after = next((mean for late, mean in reversed(static) if late), None)
    if len(set(rates)) < 3 or (before is None and after is None):
        left_out.append(
            LeftOut(name, f"it has {len(rates)} rates and {len(static)} static outputs, 3 and 1 are needed")
        )
        return None
    mean, mean_u = np.array(means, dtype=np.float64).T
    net = net_outputs(mean, mean_u, before or after or (0.0, 0.0), after or before or (0.0, 0.0))
    rate, u = np.array(rates, dtype=np.float64), np.maximum(net.output_u, 1e-12 * np.abs(net.output).max())
    both = before is not None and after is not None
    return MeritRun(
        name, _temperature(segments), rate, net.output, u,
        net.drift if both else math.nan, net.drift_u if both else math.nan,
        scale_figures(rate, net.output, u), residual_pattern(rate, net.output, u),
    )  # fmt: skip


def _mean(segment: Segment, settings: FogSettings) -> tuple[float, float]:
    resolution = settings.gyro.output_resolution
    if segment.conditions["rate_dps"] == 0:
        mean = window_at_rest(segment, resolution=resolution)
    else:
        check_table_rate(segment.conditions, settings.table.rate_tolerance_ppm)
        mean = window_over_turns(segment, turns=_MANY_TURNS, window_s=0.0, resolution=resolution)
    return mean.mean, mean.mean_u


def _temperature(segments: Sequence[Segment]) -> float:
    """Mean temperature that the gyro gave, or the one that was planned."""
    measured = [s.recording.temperature for s in segments if s.recording.temperature is not None]
    values = np.concatenate(measured) if measured else np.empty(0)
    values = values[np.isfinite(values)]
    if values.size:
        return float(values.mean())
    planned: Any = segments[0].conditions.get("temperature_c")
    return math.nan if planned is None else float(planned)
