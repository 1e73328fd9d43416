"""The inputs of a budget, drawn from their distributions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.budget import BenchKnowledge, OperatingPoint, Reference, ResponseCorner, TableGeometry
from analysis.channel import gain_on_ratio, high_pass_on_ratio, low_pass_on_ratio
from analysis.rotation import rate_on_axis


@dataclass(frozen=True)
class Draws:
    """The truth of (R,) records, each field of that shape.

    Attributes
    ----------
    scale_factor, input_rate, lock_in_rate : ndarray
        Pulses per degree, deg/s, deg/s.
    phase : ndarray
        Readout phase less backscatter phase, rad.
    stretch : ndarray
        True over nominal sample interval.
    distortion : ndarray
        Second harmonic that a pure sine of the beat's amplitude would get, over that amplitude.
    low_pass, high_pass, gain : ndarray
        Corners, Hz.
    share_lost : ndarray
        Part of r that goes without a known frequency dependence.
    """

    scale_factor: Floats
    input_rate: Floats
    lock_in_rate: Floats
    phase: Floats
    stretch: Floats
    distortion: Floats
    low_pass: Floats
    high_pass: Floats
    gain: Floats
    share_lost: Floats

    def part(self, where: slice) -> Draws:
        """Some of the records."""
        return Draws(**{name: value[where] for name, value in vars(self).items()})


def draw_inputs(
    point: OperatingPoint,
    knowledge: BenchKnowledge,
    reference: Reference,
    trials: int,
    records: int,
    rng: np.random.Generator,
) -> Draws:
    """Draw so many measurements of so many records: the records of one differ in the scatter of WL alone."""

    def common(values: float | Floats) -> Floats:
        return np.repeat(np.broadcast_to(np.asarray(values, dtype=np.float64), trials), records)

    def corner(known: ResponseCorner, absent: float) -> Floats:
        if not known.corrected:  # drawn as a share of r instead
            return common(absent)
        return common(np.abs(rng.normal(known.hz, known.u_hz, trials)))

    ppm = 0.0 if math.isnan(knowledge.scale_factor_u_ppm) else knowledge.scale_factor_u_ppm
    limit = knowledge.distortion_limit
    if math.isnan(limit) or "distortion" in knowledge.separated:
        limit = 0.0
    rate: float | Floats = point.input_rate
    if reference == "rate" and knowledge.table is not None:
        rate = _axis_rates(knowledge.table, trials, rng)
    phase = rng.uniform(0, 2 * np.pi, trials) if math.isnan(point.phase) else point.phase
    scatter = point.scatter_u * math.sqrt(records) * rng.standard_normal(trials * records)
    return Draws(
        scale_factor=common(point.scale_factor * (1 + 1e-6 * ppm * rng.standard_normal(trials))),
        input_rate=common(rate),
        lock_in_rate=point.lock_in_rate + scatter,
        phase=common(phase),
        stretch=common(1 + 1e-6 * knowledge.time_base_limit_ppm * rng.uniform(-1, 1, trials)),
        distortion=common(limit * rng.uniform(-1, 1, trials)),
        low_pass=corner(knowledge.bandwidth, math.inf),
        high_pass=corner(knowledge.high_pass, 0.0),
        gain=corner(knowledge.gain, math.inf),
        share_lost=common(_shares_lost(point.beat_frequency, knowledge, trials, rng)),
    )


def nominal_rate(table: TableGeometry) -> float:
    """The rate that would be given: without an azimuth, that of the vertical part alone."""
    azimuth = table.azimuth_deg if math.isfinite(table.azimuth_deg) else 90.0
    return float(rate_on_axis(table.table_rate, table.tilt_deg, table.latitude_deg, azimuth))


def corrected_factor(frequency: float, knowledge: BenchKnowledge) -> float:
    """Factor on r that the analysis takes out: that of the corners it corrects, at their nominal values."""
    return math.prod(factor for corner, factor in _corners(frequency, knowledge) if corner.corrected)


def _corners(frequency: float, knowledge: BenchKnowledge) -> Iterator[tuple[ResponseCorner, float]]:
    """Each corner that is known, and the factor that it puts on r."""
    for corner, on_ratio in (
        (knowledge.bandwidth, low_pass_on_ratio),
        (knowledge.high_pass, high_pass_on_ratio),
        (knowledge.gain, gain_on_ratio),
    ):
        if not math.isnan(corner.hz):
            yield corner, float(abs(on_ratio(frequency, corner.hz)))


def _axis_rates(table: TableGeometry, trials: int, rng: np.random.Generator) -> Floats:
    rates = rng.normal(table.table_rate, table.table_rate_u, trials)
    tilts = rng.normal(table.tilt_deg, table.tilt_u_deg, trials)
    latitudes = rng.normal(table.latitude_deg, table.latitude_u_deg, trials)
    if math.isfinite(table.azimuth_deg):
        width = table.azimuth_u_deg * math.sqrt(3)
        azimuths = table.azimuth_deg + width * rng.uniform(-1, 1, trials)
    else:
        azimuths = rng.uniform(0, 360, trials)
    return rate_on_axis(rates, tilts, latitudes, azimuths)


def _shares_lost(frequency: float, knowledge: BenchKnowledge, trials: int, rng: np.random.Generator) -> Floats:
    """Effects that nobody corrects, each anywhere between its limits."""
    total = np.zeros(trials)
    for corner, factor in _corners(frequency, knowledge):
        if not corner.corrected:
            total += (1 - factor) * rng.uniform(-1, 1, trials)
    if math.isfinite(knowledge.response_u):
        total += knowledge.response_u * rng.standard_normal(trials)
    return total
