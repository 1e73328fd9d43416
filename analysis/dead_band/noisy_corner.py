"""The corner of the dead band with noise: pulse rate in closed form, and sweeps by integration.

With the noise the phase of the beat obeys

    d(phi)/dt = 2 pi K [W - WL sin(phi)] + noise,    variance of the noise's angle: N^2 t

N is the angle random walk in deg/sqrt(s). Noise lets the phase slip below lock-in; the mean rate of that is known
in closed form for a particle that diffuses in a tilted periodic potential (Stratonovich, Topics in the Theory of
Random Noise, vol. 2): with a = 2 pi K W, b = 2 pi K WL and D = (2 pi K N)^2/2,

    <d(phi)/dt> = D (1 - exp(-2 pi a/D)) / integral over 0..2 pi of exp(-a s/D) I0((2 b/D) sin(s/2)) ds      (1)

A continued fraction gives the same to rounding and without the integral's narrow peaks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats, Ints

LARGEST_TURN = 0.4
"""rad, of the phase in one step of the simulation; the steps are exact but for the noise inside them."""

LEAST_WALK = 1e-3
"""In sqrt(WL/K): less noise rounds nothing that a counter could show, and would need endless harmonics."""

TREMBLE = 0.25
"""Turns."""


def rounded_pulse_rate(
    input_rate: ArrayLike, *, scale_factor: float, lock_in_rate: ArrayLike, random_walk: ArrayLike
) -> Floats:
    """Mean pulse rate, Hz, with the sign of the rate: equation (1). Arguments broadcast.

    Examples
    --------
    At the corner itself noise gives pulses, where there should be none.

    >>> rounded_pulse_rate([0.05, 0.2], scale_factor=2000, lock_in_rate=0.05, random_walk=1e-4).round(2).tolist()
    [8.58, 387.3]
    """
    given = (np.asarray(v, dtype=np.float64) for v in (input_rate, lock_in_rate, random_walk))
    rate, lock_in, walk = np.broadcast_arrays(*given)
    possible = np.all(np.isfinite(rate)) and np.all(lock_in >= 0) and np.all(walk >= 0) and scale_factor > 0
    if not possible:
        raise ValueError("rates must be finite, lock-in rate and random walk not negative, scale_factor positive")
    turns = np.asarray(scale_factor * np.sqrt(np.maximum(rate**2 - lock_in**2, 0.0)))
    noisy = walk > 0
    if noisy.any():
        least = LEAST_WALK * np.sqrt(lock_in[noisy] / scale_factor)
        diffusion = (2 * np.pi * scale_factor * np.maximum(walk[noisy], least)) ** 2 / 2
        per_rate = 2 * np.pi * scale_factor / diffusion
        slips = _slip_rate(per_rate * np.abs(rate[noisy]), per_rate * lock_in[noisy])
        turns[noisy] = slips * diffusion / (2 * np.pi)
    return np.asarray(np.sign(rate) * turns)


def _slip_rate(drive: Floats, lock: Floats) -> Floats:
    """<d(phi)/dt>/D for a/D and b/D (R,), by the continued fraction of the stationary density's harmonics.

    With p_n = <exp(-i n phi)> the density obeys (n + i a/D) p_n = (b/2D)(p_(n-1) - p_(n+1)).
    """
    orders = int(60 + 12 * np.sqrt(np.max(lock, initial=0.0)))
    ratio, half, turning = np.zeros(drive.shape, dtype=np.complex128), lock / 2, 1j * drive
    for n in range(orders, 0, -1):
        ratio = half / (n + turning + half * ratio)
    return np.asarray(np.maximum(drive + lock * ratio.imag, 0.0))


def simulate_sweep(
    input_rates: ArrayLike,
    dwell: float,
    *,
    scale_factor: float,
    lock_in_rate: float,
    random_walk: float = 0.0,
    bias_rate: ArrayLike = 0.0,
    capture_rate: float | None = None,
    seed: int = 0,
) -> Ints:
    """Pulses counted at each step of a sweep, by integrating the equation with its noise.

    Parameters
    ----------
    input_rates : (..., n)
        deg/s, signed, in the order in which the table takes them.
    dwell : float
        Seconds at each rate.
    scale_factor, lock_in_rate, random_walk : float
        Pulses per degree; deg/s; deg/sqrt(s).
    bias_rate : float or (..., n)
        deg/s; the gyro sees input rate less bias rate.
    capture_rate : float, optional
        deg/s, where a turning gyro locks as the rate falls, if that is not where a locked one starts.

    Returns
    -------
    (..., n) of int
        Pulses of either sense, as a counter shows them.

    Raises
    ------
    ValueError
        Rates that are not finite, a dwell or scale factor that is not positive, negative rates of lock-in.
    """
    rates = np.asarray(input_rates, dtype=np.float64)
    capture = lock_in_rate if capture_rate is None else capture_rate
    if rates.ndim < 1 or not np.all(np.isfinite(rates)):
        raise ValueError("input_rates must be a list of finite rates (deg/s)")
    if not (dwell > 0 and scale_factor > 0 and min(lock_in_rate, capture, random_walk) >= 0):
        raise ValueError("dwell and scale_factor must be positive, lock-in rates and random walk not negative")
    seen = rates - np.asarray(bias_rate, dtype=np.float64)
    threshold = np.where(falling(seen), capture, lock_in_rate)
    rng = np.random.default_rng(seed)
    if random_walk == 0:
        turns = scale_factor * np.sqrt(np.maximum(seen**2 - threshold**2, 0.0)) * dwell
    else:
        turns = np.abs(_diffused_turns(seen, threshold, dwell, scale_factor, random_walk, rng))
    # A locked phase that only trembles gives no pulse.
    return np.asarray(np.floor(turns + rng.uniform(0, 1, seen.shape)) * (turns > TREMBLE), dtype=np.int64)


def falling(rates: Floats) -> Bools:
    """Steps of a sweep at which |W| is smaller than at the step before; the first one counts as rising."""
    size = np.abs(rates)
    return np.asarray(np.diff(size, axis=-1, prepend=size[..., :1]) < 0)


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
        half = half + np.arctan2(n * cos - d * sin, d * cos + n * sin) + rng.normal(scale=kick, size=half.shape)
    return np.asarray((half - start) / np.pi)
