"""When each segment of a ramp was taken, how warm the gyro was, and means of the output at rest and at rates."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import mean_at_rest, pooled_noise, temperature_course, vertical_earth_rate_dph
from station.fibre_gyro.recordings import Segment, segments_of
from station.fibre_gyro.settings import FogSettings
from station.fibre_gyro.windows import check_table_rate, checked, remarks_on, window_of_any_length
from station.results.result import LeftOut
from station.runs.store import SavedRun

Floats = NDArray[np.float64]

MOST_BLOCKS = 300
_MOST_SAMPLES = 20_000
_MANY_TURNS = 100_000
_OVERLAP_S = 1.0
_CHAMBER = "chamber_temperature_degc"


@dataclass(frozen=True)
class TimedSegment:
    """A segment, and the time at which it began, s since the begin of the run."""

    segment: Segment
    begin_s: float


def timed_segments(run: SavedRun, purpose: str, left_out: list[LeftOut]) -> list[TimedSegment]:
    """Return the segments that can be used, in the order of time; the others are added to `left_out`.

    The time is that of the clock where they were taken, of the simulation, or of the list of logs. Where nobody
    says it, or two would overlap, one follows the other.
    """
    taken = {one.key: one.taken_at for one in run.taken_for(purpose)}
    on_bench = not run.facts.simulated and not run.facts.sources
    found, clock = [], 0.0
    for segment in segments_of(run, purpose):
        length = segment.recording.duration_s
        begin = segment.conditions.get("begin_s")
        if on_bench:
            begin = datetime.fromisoformat(taken[segment.key]).timestamp() - length
        found.append((segment, clock if begin is None else float(begin), clock))
        clock += length
    ordered = sorted(found, key=lambda one: one[1])
    ends = [begin + segment.recording.duration_s for segment, begin, _ in ordered]
    overlap = any(later[1] < end - _OVERLAP_S for later, end in zip(ordered[1:], ends, strict=False))
    usable = []
    for segment, begin, follows in found if overlap else ordered:
        try:
            checked(segment)
        except ValueError as error:
            left_out.append(LeftOut(segment.key, str(error)))
        else:
            usable.append(TimedSegment(segment, follows if overlap else begin - ordered[0][1]))
    return usable


@dataclass(frozen=True)
class Course:
    """Temperature of the run in time, as the thermometer gave it."""

    times: Floats
    temperature: Floats
    window_s: float

    def at(self, at_s: Floats) -> tuple[Floats, Floats]:
        """Temperature, deg C, and its change, kelvin a minute."""
        warm, rate, _ = temperature_course(self.times, self.temperature, at_s, window_s=self.window_s)
        return warm, rate

    def rate_u(self, at_s: Floats) -> Floats:
        """Noise of the change, kelvin a minute."""
        return temperature_course(self.times, self.temperature, at_s, window_s=self.window_s)[2]


def course_of(segments: Sequence[TimedSegment], window_s: float) -> Course:
    """Return the course of the temperature: of the gyro's thermometer, else of the chamber's or the list's."""
    times, warm = [], []
    for one in segments:
        recording, conditions = one.segment.recording, one.segment.conditions
        if recording.temperature is not None and np.isfinite(recording.temperature).any():
            times.append(one.begin_s + recording.times)
            warm.append(recording.temperature)
        elif (given := conditions.get("temperature_c", conditions.get(_CHAMBER))) is not None:
            times.append(np.array([one.begin_s + recording.duration_s / 2]))
            warm.append(np.array([float(given)]))
    if not times:
        raise ValueError(
            "nobody gives a temperature: the output needs a column temperature, or the list temperature_c"
        )
    when, values = np.concatenate(times), np.concatenate(warm)
    there = np.isfinite(values)
    when, values = when[there], values[there]
    step = max(1, when.size // _MOST_SAMPLES)
    whole = when.size // step * step
    # neighbours are taken together: their mean keeps what they know
    return Course(
        when[:whole].reshape(-1, step).mean(axis=1), values[:whole].reshape(-1, step).mean(axis=1), window_s
    )


@dataclass(frozen=True)
class Blocks:
    """Means of the output at rest over equal times: counts, s since the begin of the run, end of the axis."""

    mean: Floats
    mean_u: Floats
    at_s: Floats
    end_up: Floats


def rest_blocks(segments: Sequence[TimedSegment], settings: FogSettings, remarks: list[str]) -> Blocks:
    """Cut the outputs at rest into blocks of ``block_s`` or longer; each with the noise of all of them.

    What was missing or far off is added to `remarks`.
    """
    whole = sum(one.segment.recording.duration_s for one in segments)
    block_s = max(settings.temperature.block_s, whole / MOST_BLOCKS)
    means, rows = [], []
    for one in segments:
        recording = one.segment.recording
        lost, far = sum(gap.missing for gap in recording.gaps), 0
        count = max(1, round(recording.duration_s / block_s))
        edges = np.linspace(0, recording.times[-1] + recording.interval_s, count + 1)
        places = np.searchsorted(recording.times + recording.interval_s / 2, edges)
        fewest = max(2.0, recording.duration_s / count / recording.interval_s / 2)
        for place, (first, last) in enumerate(itertools.pairwise(places)):
            if last - first < fewest:
                continue  # most of it is missing
            words = recording.counts[first:last]
            mean = mean_at_rest(words, recording.interval_s, resolution=settings.gyro.output_resolution)
            far += mean.outliers
            means.append(mean)
            middle = one.begin_s + float(edges[place] + edges[place + 1]) / 2
            rows.append((mean.mean, middle, float(one.segment.conditions.get("end_up", 1))))
        for number, what in ((lost, "missing"), (far, "far from all others and left out")):
            if number:
                said = "1 output word is" if number == 1 else f"{number} output words are"
                remarks.append(f"{one.segment.key}: {said} {what}.")
    if not rows:
        return Blocks(*(np.empty(0) for _ in range(4)))
    mean, at, end_up = np.array(rows, dtype=np.float64).T
    floor = 1e-12 * np.abs(mean).max() + 1e-15
    return Blocks(mean, np.maximum(pooled_noise(means), floor), at, end_up)


@dataclass(frozen=True)
class Turned:
    """Means of the output at rates; counts, deg/s along the axis with the earth rate, s since the begin; (n,)."""

    mean: Floats
    mean_u: Floats
    rate_dps: Floats
    at_s: Floats


def turned_means(
    segments: Sequence[TimedSegment], settings: FogSettings, left_out: list[LeftOut], remarks: list[str]
) -> Turned:
    """Return the means over whole turns; adds to `left_out` what cannot be used, to `remarks` what was missing."""
    earth = vertical_earth_rate_dph(settings.site.latitude_deg) / 3600
    tilt, means, rows = settings.temperature.misalignment_mrad, [], []
    for one in segments:
        conditions = one.segment.conditions
        try:
            check_table_rate(conditions, settings.table.rate_tolerance_ppm)
            mean = window_of_any_length(one.segment, settings, turns=_MANY_TURNS, tilt_mrad=tilt)
        except ValueError as error:
            left_out.append(LeftOut(one.segment.key, str(error)))
            continue
        remarks += remarks_on(one.segment, mean)
        means.append(mean)
        table = float(conditions.get("table_rate_dps", conditions["rate_dps"]))
        along = int(conditions.get("end_up", 1)) * (table + earth)
        rows.append((mean.mean, along, one.begin_s + mean.duration_s / 2))
    if not rows:
        return Turned(*(np.empty(0) for _ in range(4)))
    mean_of, rate, at = np.array(rows, dtype=np.float64).T
    return Turned(mean_of, np.maximum(pooled_noise(means), 1e-12 * np.abs(mean_of)), rate, at)
