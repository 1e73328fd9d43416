"""Lock-in rate by the search for the dead band: the rate at which pulses begin and end, as test stands do it.

The table steps through rates up and down in both senses; the lock-in rate is half the width of the band without
pulses, its middle is the bias rate. Steps of the table, the difference between up and down, and noise that lets
the gyro slip inside the band limit it. A fit of the whole corner with its noise (`noisy_corner.py`) shows what the
last of these is worth.

A bias that drifts moves edges that are found at different times against each other: it looks like hysteresis, and
where the senses are swept one after the other like another lock-in rate. The beats beyond the band tell it apart:
hysteresis is a matter of the corner, a drift shifts them all. So the corner's fit has a linear drift and two
thresholds, for rates that rise and that fall, and the edges are taken to the middle of the sweep by that drift.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.dead_band import corner_fit
from analysis.dead_band.corner_fit import COUNTED_U, Corner, Sweep
from analysis.dead_band.noisy_corner import falling, rounded_pulse_rate

SEEN = 3.29
"""Standard uncertainties beyond which chance hardly ever goes."""

WALK_KNOWN = 2.0
"""A random walk that does not stand out of so many standard uncertainties says nothing of slips."""

ROUNDING_MATTERS = 2.0
"""Noise counts where edge and fitted lock-in rate differ by more than this many standard uncertainties."""


class DeadBandFlag(IntFlag):
    """Bits of `DeadBand.flags`; the lower-case name is the one used in JSON."""

    NO_SILENT_RATE = 1
    """On some branch there are pulses at every rate: the steps are too coarse or the noise too strong."""
    NO_PULSES = 2
    """On some branch there are no pulses at all: the sweep ends too early."""
    ONE_SENSE = 4
    """Only one sense was swept, so the bias rate is in the lock-in rate."""
    HYSTERESIS = 8
    """Up and down differ by more than the steps of the table."""
    ROUNDED = 16
    """Noise moves the edges: the fitted corner is the better value."""
    PULSES_INSIDE = 32
    """Beyond the first rate with pulses there are silent ones again."""

    DRIFT = 64
    """The bias drifted during the sweep; it is corrected for."""


@dataclass(frozen=True)
class DeadBand:
    """What a sweep shows.

    lock_in_rate, lock_in_rate_u : deg/s, mean of the edges; with the steps, half the hysteresis, noise and drift
    edges, edge_half_widths : (2, 2) deg/s, |W| of positive and negative sense, rising and falling, as in the
        middle of the sweep; nan if not swept
    bias_rate, bias_rate_u : deg/s, middle of the band in the middle of the sweep; nan with one sense
    hysteresis, hysteresis_u : deg/s, rising less falling; nan if only one of them was swept
    drift, drift_u : deg/s, change of the bias from the first step to the last; nan where it was not fitted
    corner_rate, corner_rate_u, random_walk, random_walk_u : fitted corner, deg/s and deg/sqrt(s); nan where not
        fitted
    noise_part : deg/s, share of the noise in the uncertainty
    flags : bits of `DeadBandFlag`
    """

    lock_in_rate: float
    lock_in_rate_u: float
    edges: Floats
    edge_half_widths: Floats
    bias_rate: float
    bias_rate_u: float
    hysteresis: float
    hysteresis_u: float
    drift: float
    drift_u: float
    corner_rate: float
    corner_rate_u: float
    random_walk: float
    random_walk_u: float
    noise_part: float
    flags: int


def find_dead_band(
    input_rates: ArrayLike,
    pulses: ArrayLike,
    dwell: float,
    *,
    scale_factor: float,
    pulses_u: ArrayLike = COUNTED_U,
    times: ArrayLike | None = None,
    least_pulses: int = 1,
    fit_corner: bool = True,
) -> DeadBand:
    """Dead band of a sweep.

    Parameters
    ----------
    input_rates : (n,)
        deg/s, signed, in the order in which the table took them.
    pulses : (n,)
        Counted at each.
    dwell : float
        Seconds at each rate.
    scale_factor : float
        Pulses per degree.
    pulses_u : float or (n,)
        Standard uncertainty of each; that of whole pulses unless they come from a frequency.
    times : (n,), optional
        Of the middle of each step, s; without them the steps follow each other evenly.
    least_pulses : int
        Fewer count as silence.
    fit_corner : bool
        Whether to fit the rounded corner too; without it a drift is not seen.

    Raises
    ------
    ValueError
        No edge on any branch; arrays that do not fit together, counts or a dwell that cannot be.

    Examples
    --------
    >>> rates = np.concatenate([np.arange(0, 0.1, 0.01), -np.arange(0, 0.1, 0.01)])
    >>> pulses = 2000 * 10 * np.sqrt(np.maximum(rates**2 - 0.055**2, 0))
    >>> band = find_dead_band(rates, pulses.round(), 10.0, scale_factor=2000)
    >>> round(band.lock_in_rate, 4), round(band.lock_in_rate_u, 4)
    (0.055, 0.002)
    """
    swept = _checked(input_rates, pulses, pulses_u, times, dwell, scale_factor, least_pulses)
    edges, halves, when, flags = _edges(swept, least_pulses)
    if not np.isfinite(edges).any():
        raise ValueError(
            "no edge of the dead band: the sweep must hold silent rates and rates with pulses, in order"
        )
    corner = corner_fit.fit_corner(swept, float(np.nanmean(edges))) if fit_corner else Corner()
    drift, drift_u = (0.0, 0.0) if np.isnan(corner.drift) else (corner.drift, corner.drift_u)
    # the bias adds to the positive edges and takes from the negative ones
    lever = np.array([[1.0], [-1.0]]) * when
    edges = edges - lever * drift
    found = _from_edges(edges, halves, np.abs(lever) * drift_u, _slips_u(swept, corner))
    apart = abs(found.lock_in_rate - corner.rate)
    noise_part = apart if apart > ROUNDING_MATTERS * np.hypot(corner.rate_u, found.lock_in_rate_u) else 0.0
    half_hysteresis = 0.0 if np.isnan(found.hysteresis) else abs(found.hysteresis) / 2 / np.sqrt(3)
    flags |= DeadBandFlag.HYSTERESIS if abs(found.hysteresis) > 3 * found.hysteresis_u else 0
    flags |= DeadBandFlag.DRIFT if abs(drift) > SEEN * drift_u else 0
    flags |= DeadBandFlag.ONE_SENSE if np.isnan(found.bias_rate) else 0
    flags |= DeadBandFlag.ROUNDED if noise_part else 0
    return DeadBand(
        lock_in_rate=found.lock_in_rate,
        lock_in_rate_u=float(np.sqrt(found.lock_in_rate_u**2 + half_hysteresis**2 + noise_part**2)),
        edges=edges,
        edge_half_widths=halves,
        bias_rate=found.bias_rate,
        bias_rate_u=found.bias_rate_u,
        hysteresis=found.hysteresis,
        hysteresis_u=found.hysteresis_u,
        drift=corner.drift,
        drift_u=corner.drift_u,
        corner_rate=corner.rate,
        corner_rate_u=corner.rate_u,
        random_walk=corner.random_walk,
        random_walk_u=corner.random_walk_u,
        noise_part=noise_part,
        flags=int(flags),
    )


def _checked(
    input_rates: ArrayLike,
    pulses: ArrayLike,
    pulses_u: ArrayLike,
    times: ArrayLike | None,
    dwell: float,
    scale_factor: float,
    least_pulses: int,
) -> Sweep:
    rates, counts = np.asarray(input_rates, dtype=np.float64), np.asarray(pulses, dtype=np.float64)
    if rates.ndim != 1 or rates.shape != counts.shape:
        raise ValueError(f"rates and pulses must be lists of one length, not {rates.shape} and {counts.shape}")
    when = np.arange(rates.size) * 1.0 if times is None else np.asarray(times, dtype=np.float64)
    if when.shape != rates.shape or not np.all(np.diff(when) >= 0):
        raise ValueError("times must be a list as long as that of the rates, and not go back")
    us = np.broadcast_to(np.asarray(pulses_u, dtype=np.float64), rates.shape)
    if not np.all(np.isfinite(rates)) or not np.all(np.isfinite(counts)) or np.any(counts < 0):
        raise ValueError("rates and pulses must be finite, pulses not negative")
    if not np.all(us >= 0):
        raise ValueError("pulses_u must not be negative")
    if not (np.isfinite(dwell) and dwell > 0 and scale_factor > 0 and least_pulses >= 1):
        raise ValueError("dwell, scale_factor and least_pulses must be positive")
    span = float(np.ptp(when)) if when.size else 0.0
    time = (when - when[0]) / span - 0.5 if span > 0 else np.zeros(rates.shape)
    return Sweep(rates, counts, us, time, dwell, scale_factor)


def _edges(swept: Sweep, least_pulses: int) -> tuple[Floats, Floats, Floats, int]:
    """|W| of the edge, half the gap it lies in, and its time, (2, 2): positive, negative; rising, falling."""
    edges, halves, when = (np.full((2, 2), np.nan) for _ in range(3))
    flags = 0
    down = falling(swept.rates)
    for k, sense in enumerate((1, -1)):
        for m, direction in enumerate((False, True)):
            branch = (swept.rates * sense > 0) & (down == direction)
            if branch.sum() < 2:
                continue
            order = np.argsort(np.abs(swept.rates[branch]))
            size, time = np.abs(swept.rates[branch])[order], swept.time[branch][order]
            moving = swept.pulses[branch][order] >= least_pulses
            if moving.all() or not moving.any():
                flags |= DeadBandFlag.NO_SILENT_RATE if moving.all() else DeadBandFlag.NO_PULSES
                continue
            first = int(np.argmax(moving))
            if not moving[first:].all():
                flags |= DeadBandFlag.PULSES_INSIDE
            # Below the slowest step swept there is nothing but standstill.
            below = size[first - 1] if first else 0.0
            edges[k, m], halves[k, m] = (size[first] + below) / 2, (size[first] - below) / 2
            when[k, m] = (time[first] + time[max(first - 1, 0)]) / 2
    return edges, halves, when, flags


class _FromEdges(NamedTuple):
    lock_in_rate: float
    lock_in_rate_u: float
    bias_rate: float
    bias_rate_u: float
    hysteresis: float
    hysteresis_u: float


def _from_edges(edges: Floats, halves: Floats, by_drift: Floats, by_slips: Floats) -> _FromEdges:
    """Lock-in rate, bias and hysteresis of edges (2, 2), and what steps, drift and slips leave open of them."""
    known = np.isfinite(edges)
    # A rate somewhere between two steps: uniform, with standard deviation of the gap over sqrt(12).
    us = halves / np.sqrt(3)
    senses = np.array([_mean(edges[k][known[k]]) for k in range(2)])
    # Up and down take the same steps and so share their error, unless the bias drifted between them; the senses do
    # not, unless the bias is zero. Slips are chance at every edge.
    steps_u = np.array([_shared(edges[k][known[k]], us[k][known[k]]) for k in range(2)])
    slips_u = np.array([_mean_u(by_slips[k][known[k]]) for k in range(2)])
    drift_u = _mean(by_drift[known])
    swept = np.isfinite(senses)
    u = float(np.hypot(_mean_u(np.hypot(steps_u, slips_u)[swept]), drift_u))
    both = bool(swept.all())
    hysteresis, hysteresis_u = _hysteresis(edges, np.sqrt(us**2 + by_slips**2 + by_drift**2))
    bias = float(senses[0] - senses[1]) / 2 if both else float("nan")
    return _FromEdges(float(senses[swept].mean()), u, bias, u if both else float("nan"), hysteresis, hysteresis_u)


def _slips_u(swept: Sweep, corner: Corner) -> Floats:
    """Standard deviation (2, 2) that slips give to the edges: each step shows one with its own probability."""
    spread = np.zeros((2, 2))
    if not corner.random_walk > WALK_KNOWN * corner.random_walk_u:
        return spread
    down = falling(swept.rates)
    slips = swept.dwell * np.abs(
        rounded_pulse_rate(
            swept.rates,
            scale_factor=swept.scale_factor,
            lock_in_rate=corner.rate,
            random_walk=corner.random_walk,
        )
    )
    for k, sense in enumerate((1, -1)):
        for m, direction in enumerate((False, True)):
            branch = (swept.rates * sense > 0) & (down == direction)
            order = np.argsort(np.abs(swept.rates[branch]))
            size, silent = np.abs(swept.rates[branch])[order], np.exp(-slips[branch][order])
            if size.size < 2:
                continue
            first = (1 - silent) * np.concatenate([[1.0], np.cumprod(silent)[:-1]])
            edge = (size + np.concatenate([[0.0], size[:-1]])) / 2
            total = max(float(first.sum()), 1e-300)
            middle = float(np.sum(first * edge)) / total
            spread[k, m] = np.sqrt(np.sum(first * (edge - middle) ** 2) / total)
    return spread


def _shared(edges: Floats, us: Floats) -> float:
    """Standard uncertainty of the mean of two edges in one sense, or of one.

    Where they lie apart, the true one is where both gaps overlap, or else the gaps are two: independent.
    """
    if edges.size < 2:
        return _mean(us)
    apart = abs(float(edges[0] - edges[1])) / 2 / np.sqrt(3)
    return float(max(_mean(us) - apart, _mean_u(us)))


def _hysteresis(edges: Floats, us: Floats) -> tuple[float, float]:
    """Mean of rising less falling edges, and its uncertainty; nan where no sense has both."""
    both = np.isfinite(edges).all(axis=1)
    if not both.any():
        return float("nan"), float("nan")
    difference = edges[both, 0] - edges[both, 1]
    return float(difference.mean()), float(np.sqrt(np.sum(us[both] ** 2))) / difference.size


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else float("nan")


def _mean_u(us: Floats) -> float:
    return float(np.sqrt(np.sum(us**2))) / us.size if us.size else float("nan")
