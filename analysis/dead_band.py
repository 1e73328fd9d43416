"""Lock-in rate by the search for the dead band: the rate at which pulses begin and end, as test stands do it.

The table steps through rates up and down in both senses; the lock-in rate is half the width of the band without
pulses, its middle is the bias rate. Steps of the table, the difference between up and down, and noise that lets
the gyro slip inside the band limit it. A fit of the whole corner with its noise (equation (1))
shows what the last of these is worth.

With the noise the phase of the beat obeys

    d(phi)/dt = 2 pi K [W - WL sin(phi)] + noise,    variance of the noise's angle: N^2 t

N is the angle random walk in deg/sqrt(s). Noise lets the phase slip below lock-in; the mean rate of that is known
in closed form for a particle that diffuses in a tilted periodic potential (Stratonovich, Topics in the Theory of
Random Noise, vol. 2): with a = 2 pi K W, b = 2 pi K WL and D = (2 pi K N)^2/2,

    <d(phi)/dt> = D (1 - exp(-2 pi a/D)) / integral over 0..2 pi of exp(-a s/D) I0((2 b/D) sin(s/2)) ds      (1)

A continued fraction gives the same to rounding and without the integral's narrow peaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats, Ints

FEWEST_FOR_CORNER = 6
ROUNDING_MATTERS = 2.0
"""Noise counts where edge and fitted lock-in rate differ by more than this many standard uncertainties."""

LARGEST_TURN = 0.4
"""rad, of the phase in one step of the simulation; the steps are exact but for the noise inside them."""

LEAST_WALK = 5e-4
"""In sqrt(WL/K): less noise rounds nothing that a counter could show, and would need endless harmonics."""

TREMBLE = 0.25
"""Turns."""


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


@dataclass(frozen=True)
class DeadBand:
    """What a sweep shows.

    lock_in_rate, lock_in_rate_u : deg/s, mean of the edges; with the steps, half the hysteresis and the noise
    edges, edge_half_widths : (2, 2) deg/s, |W| of positive and negative sense, rising and falling; nan if not
        swept
    bias_rate, bias_rate_u : deg/s, middle of the band; nan with one sense
    hysteresis, hysteresis_u : deg/s, rising less falling; nan if only one of them was swept
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
    corner_rate: float
    corner_rate_u: float
    random_walk: float
    random_walk_u: float
    noise_part: float
    flags: int


class Corner(NamedTuple):
    """Fitted corner: lock-in rate (deg/s) and random walk (deg/sqrt(s)) with their uncertainties."""

    rate: float
    rate_u: float
    random_walk: float
    random_walk_u: float


NO_CORNER = Corner(*(float("nan"),) * 4)


def find_dead_band(
    input_rates: ArrayLike,
    pulses: ArrayLike,
    dwell: float,
    *,
    scale_factor: float,
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
    least_pulses : int
        Fewer count as silence.
    fit_corner : bool
        Whether to fit the rounded corner too.

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
    rates, counts = _checked(input_rates, pulses, dwell, scale_factor, least_pulses)
    edges, halves, flags = _edges(rates, counts, least_pulses)
    known = np.isfinite(edges)
    if not known.any():
        raise ValueError(
            "no edge of the dead band: the sweep must hold silent rates and rates with pulses, in order"
        )
    # A rate somewhere between two steps: uniform, with standard deviation of the gap over sqrt(12).
    us = halves / np.sqrt(3)
    senses = np.array([_mean(edges[k][known[k]]) for k in range(2)])
    # Up and down take the same steps and so share their error; the senses do not, unless the bias is zero.
    senses_u = np.array([_mean(us[k][known[k]]) for k in range(2)])
    swept = np.isfinite(senses)
    both = bool(swept.all())
    hysteresis, hysteresis_u = _hysteresis(edges, us)
    value, steps_u = float(senses[swept].mean()), _mean_u(senses_u[swept])
    corner = _corner(rates, counts, dwell, scale_factor, value) if fit_corner else NO_CORNER
    apart = abs(value - corner.rate)
    noise_part = apart if apart > ROUNDING_MATTERS * np.hypot(corner.rate_u, steps_u) else 0.0
    half_hysteresis = 0.0 if np.isnan(hysteresis) else abs(hysteresis) / 2 / np.sqrt(3)
    flags |= DeadBandFlag.HYSTERESIS if abs(hysteresis) > 3 * hysteresis_u else 0
    flags |= (0 if both else DeadBandFlag.ONE_SENSE) | (DeadBandFlag.ROUNDED if noise_part else 0)
    return DeadBand(
        lock_in_rate=value,
        lock_in_rate_u=float(np.sqrt(steps_u**2 + half_hysteresis**2 + noise_part**2)),
        edges=edges,
        edge_half_widths=halves,
        bias_rate=float(senses[0] - senses[1]) / 2 if both else float("nan"),
        bias_rate_u=steps_u if both else float("nan"),
        hysteresis=hysteresis,
        hysteresis_u=hysteresis_u,
        corner_rate=corner.rate,
        corner_rate_u=corner.rate_u,
        random_walk=corner.random_walk,
        random_walk_u=corner.random_walk_u,
        noise_part=noise_part,
        flags=int(flags),
    )


def _checked(
    input_rates: ArrayLike, pulses: ArrayLike, dwell: float, scale_factor: float, least_pulses: int
) -> tuple[Floats, Floats]:
    rates, counts = np.asarray(input_rates, dtype=np.float64), np.asarray(pulses, dtype=np.float64)
    if rates.ndim != 1 or rates.shape != counts.shape:
        raise ValueError(f"rates and pulses must be lists of one length, not {rates.shape} and {counts.shape}")
    if not np.all(np.isfinite(rates)) or not np.all(np.isfinite(counts)) or np.any(counts < 0):
        raise ValueError("rates and pulses must be finite, pulses not negative")
    if not (np.isfinite(dwell) and dwell > 0 and scale_factor > 0 and least_pulses >= 1):
        raise ValueError("dwell, scale_factor and least_pulses must be positive")
    return rates, counts


def _edges(rates: Floats, counts: Floats, least_pulses: int) -> tuple[Floats, Floats, int]:
    """|W| of the edge and half the gap it lies in, (2, 2): positive, negative; rising, falling."""
    edges, halves = np.full((2, 2), np.nan), np.full((2, 2), np.nan)
    flags = 0
    down = falling(rates)
    for k, sense in enumerate((1, -1)):
        for m, direction in enumerate((False, True)):
            branch = (rates * sense > 0) & (down == direction)
            if branch.sum() < 2:
                continue
            order = np.argsort(np.abs(rates[branch]))
            size, moving = np.abs(rates[branch])[order], counts[branch][order] >= least_pulses
            if moving.all() or not moving.any():
                flags |= DeadBandFlag.NO_SILENT_RATE if moving.all() else DeadBandFlag.NO_PULSES
                continue
            first = int(np.argmax(moving))
            if not moving[first:].all():
                flags |= DeadBandFlag.PULSES_INSIDE
            # Below the slowest step swept there is nothing but standstill.
            below = size[first - 1] if first else 0.0
            edges[k, m], halves[k, m] = (size[first] + below) / 2, (size[first] - below) / 2
    return edges, halves, flags


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


def _corner(rates: Floats, pulses: Floats, dwell: float, scale_factor: float, start: float) -> Corner:
    """Lock-in rate, bias and random walk from equation (1), fitted to the steps below 3 WL."""
    from scipy.optimize import least_squares  # costs more to import than all else here

    near = np.abs(rates) < 3 * start
    if near.sum() < FEWEST_FOR_CORNER:
        return NO_CORNER
    kept, place = np.unique(rates[near], return_inverse=True)
    seen, usual_walk = pulses[near], np.sqrt(start / scale_factor)

    def left(point: Floats) -> Floats:
        expected = rounded_pulse_rate(
            kept - float(point[1]) * start,
            scale_factor=scale_factor,
            lock_in_rate=float(point[0]) * start,
            random_walk=float(np.exp(point[2])) * usual_walk,
        )
        return np.asarray(np.abs(expected)[place] * dwell - seen)

    limits = ([0.1, -1.0, np.log(LEAST_WALK)], [3.0, 1.0, np.log(10.0)])
    fit = least_squares(
        left, [1.0, 0.0, np.log(0.02)], bounds=limits, x_scale=[0.01, 0.01, 0.3], diff_step=[1e-5] * 3, max_nfev=80
    )
    jacobian = np.asarray(fit.jac)
    # Slips scatter most at the corner itself: each step's own residual says how much, and a count no less than a
    # count's rounding.
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    spread = np.maximum(fit.fun**2, 1 / 6) * near.sum() / max(int(near.sum()) - 3, 1)
    us = np.sqrt(np.diagonal(inverse @ (jacobian.T * spread) @ jacobian @ inverse))
    walk = float(np.exp(fit.x[2])) * usual_walk
    return Corner(float(fit.x[0]) * start, float(us[0]) * start, walk, walk * float(us[2]))


def rounded_pulse_rate(
    input_rate: ArrayLike, *, scale_factor: float, lock_in_rate: float, random_walk: float
) -> Floats:
    """Mean pulse rate, Hz, with the sign of the rate: equation (1).

    Parameters
    ----------
    input_rate : (...)
        deg/s, bias taken off.
    scale_factor, lock_in_rate : float
        Pulses per degree; deg/s.
    random_walk : float
        N, deg/sqrt(s); 0 for the sharp corner f = K sqrt(W^2 - WL^2).

    Examples
    --------
    At the corner itself noise gives pulses, where there should be none.

    >>> rounded_pulse_rate([0.05, 0.2], scale_factor=2000, lock_in_rate=0.05, random_walk=1e-4).round(2).tolist()
    [8.58, 387.3]
    """
    rate = np.asarray(input_rate, dtype=np.float64)
    if not np.all(np.isfinite(rate)) or not lock_in_rate >= 0 or not random_walk >= 0 or not scale_factor > 0:
        raise ValueError("rates must be finite, lock-in rate and random walk not negative, scale_factor positive")
    sharp = scale_factor * np.sqrt(np.maximum(rate**2 - lock_in_rate**2, 0.0))
    if random_walk == 0:
        return np.asarray(np.sign(rate) * sharp)
    walk = max(random_walk, LEAST_WALK * np.sqrt(lock_in_rate / scale_factor))
    diffusion = (2 * np.pi * scale_factor * walk) ** 2 / 2
    per_rate = 2 * np.pi * scale_factor / diffusion
    turns = _slip_rate(per_rate * np.abs(rate).ravel(), per_rate * lock_in_rate) * diffusion / (2 * np.pi)
    return np.asarray(np.sign(rate) * turns.reshape(rate.shape))


def _slip_rate(drive: Floats, lock: float) -> Floats:
    """<d(phi)/dt>/D for a/D (R,) and b/D, by the continued fraction of the stationary density's harmonics.

    With p_n = <exp(-i n phi)> the density obeys (n + i a/D) p_n = (b/2D)(p_(n-1) - p_(n+1)).
    """
    orders = int(60 + 12 * np.sqrt(lock))
    ratio = np.zeros(drive.shape, dtype=np.complex128)
    for n in range(orders, 0, -1):
        ratio = (lock / 2) / (n + 1j * drive + (lock / 2) * ratio)
    return np.asarray(np.maximum(drive + lock * ratio.imag, 0.0))


def simulate_sweep(
    input_rates: ArrayLike,
    dwell: float,
    *,
    scale_factor: float,
    lock_in_rate: float,
    random_walk: float = 0.0,
    bias_rate: float = 0.0,
    capture_rate: float | None = None,
    seed: int = 0,
) -> Ints:
    """Pulses counted at each step of a sweep, by integrating the equation with its noise.

    Parameters
    ----------
    input_rates : (n,)
        deg/s, signed, in the order in which the table takes them.
    dwell : float
        Seconds at each rate.
    scale_factor, lock_in_rate, random_walk : float
        Pulses per degree; deg/s; deg/sqrt(s).
    bias_rate : float
        deg/s; the gyro sees input rate less bias rate.
    capture_rate : float, optional
        deg/s, where a turning gyro locks as the rate falls, if that is not where a locked one starts.

    Returns
    -------
    (n,) of int
        Pulses of either sense, as a counter shows them.

    Raises
    ------
    ValueError
        Rates that are not finite, a dwell or scale factor that is not positive, negative rates of lock-in.
    """
    rates = np.asarray(input_rates, dtype=np.float64)
    capture = lock_in_rate if capture_rate is None else capture_rate
    if rates.ndim != 1 or not np.all(np.isfinite(rates)):
        raise ValueError("input_rates must be a list of finite rates (deg/s)")
    if not (dwell > 0 and scale_factor > 0 and min(lock_in_rate, capture, random_walk) >= 0):
        raise ValueError("dwell and scale_factor must be positive, lock-in rates and random walk not negative")
    seen = rates - bias_rate
    threshold = np.where(falling(seen), capture, lock_in_rate)
    rng = np.random.default_rng(seed)
    if random_walk == 0:
        turns = scale_factor * np.sqrt(np.maximum(seen**2 - threshold**2, 0.0)) * dwell
    else:
        turns = np.abs(_diffused_turns(seen, threshold, dwell, scale_factor, random_walk, rng))
    # A locked phase that only trembles gives no pulse.
    return np.asarray(np.floor(turns + rng.uniform(0, 1, rates.size)) * (turns > TREMBLE), dtype=np.int64)


def falling(rates: Floats) -> Bools:
    """Steps of a sweep at which |W| is smaller than at the step before; the first one counts as rising."""
    size = np.abs(rates)
    return np.concatenate([[False], np.diff(size) < 0])[: rates.size]


def _diffused_turns(
    rates: Floats,
    threshold: Floats,
    dwell: float,
    scale_factor: float,
    random_walk: float,
    rng: np.random.Generator,
) -> Floats:
    """Turns of the phase in a dwell, all rates side by side: exact steps between kicks of noise."""
    up, down = np.pi * scale_factor * rates, np.pi * scale_factor * threshold
    fastest = 2 * float(np.max(np.abs(up) + down))
    n_steps = int(np.ceil(dwell * fastest / LARGEST_TURN))
    step = dwell / n_steps
    kick = 2 * np.pi * scale_factor * random_walk * np.sqrt(step) / 2  # of the half angle
    square = (up - down) * (up + down)
    root = np.sqrt(np.abs(square)) * step
    even = np.where(square > 0, np.cos(root), np.cosh(root))
    odd = step * np.where(
        root > 0, np.where(square > 0, np.sin(root), np.sinh(root)) / np.maximum(root, 1e-300), 1.0
    )
    half = 0.5 * np.arcsin(np.clip(rates / np.maximum(threshold, 1e-300), -1, 1))
    start = half.copy()
    for _ in range(n_steps):
        sin, cos = np.sin(half), np.cos(half)
        n = even * sin + odd * (up * cos - down * sin)
        d = even * cos + odd * (down * cos - up * sin)
        # The half angle turns by less than a quarter circle in a step, so the arc tangent of the difference is it.
        half = half + np.arctan2(n * cos - d * sin, d * cos + n * sin) + rng.normal(scale=kick, size=half.size)
    return np.asarray((half - start) / np.pi)
