"""The lock-in equation of a ring laser gyro: its exact solution and its exact inverses.

    d(phi)/dt = 2 pi K [ W - WL sin(phi + beta) ]                                        (1)

K scale factor in pulses per degree, W input rate and WL lock-in rate in deg/s, beta the backscatter
phase (Zhan et al., Acta Opt. Sin. 29, 960 (2009), equation (1)). With x = WL/W and

    r = tan(asin(x)/2)                                                                   (2)

the beat A sin(phi + delta) above lock-in is one geometric series of harmonics, A_(n+1)/A_n = r.

The solution used here is the one of the half angle: with tan((phi + beta)/2) = N/D the equation becomes
linear, d(N, D)/dt = M (N, D) with M = pi K [[-WL, W], [-W, WL]] and M^2 = (pi K)^2 (WL^2 - W^2) I. Its
matrix exponential is one formula for a gyro that turns either way, is locked or sits on the edge.
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

Relation = Literal["exact", "paper-13", "paper-10"]


def beat_signal(
    times: ArrayLike,
    *,
    scale_factor: ArrayLike,
    input_rate: ArrayLike,
    lock_in_rate: ArrayLike,
    amplitude: ArrayLike = 1.0,
    initial_phase: ArrayLike = 0.0,
    backscatter_phase: ArrayLike = 0.0,
    readout_phase: ArrayLike = 0.0,
) -> Floats:
    """Detector signal A sin(phi(t) + delta) of a ring laser gyro at constant rate, in closed form.

    Valid for |W| above, at and below the lock-in rate and for either sense of rotation.

    Parameters
    ----------
    times : (..., n_samples)
        Seconds; phi = initial_phase at time 0. Negative times are allowed.
    scale_factor, input_rate, lock_in_rate : (...)
        Pulses per degree; deg/s; deg/s. Each parameter broadcasts over the leading axes of `times`.
    amplitude : (...)
        A, in the unit wanted for the result.
    initial_phase, backscatter_phase, readout_phase : (...)
        phi(0), beta and delta, rad.

    Returns
    -------
    (..., n_samples)
        The signal, in the unit of `amplitude`.

    Raises
    ------
    ValueError
        A negative lock-in rate, a scale factor that is not positive, or a parameter that is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(5) / 2000.0
    >>> beat_signal(t, scale_factor=2000, input_rate=0.125, lock_in_rate=0.0).round(6).tolist()
    [0.0, 0.707107, 1.0, 0.707107, 0.0]
    """
    t = np.asarray(times, dtype=np.float64)
    names = ("scale_factor", "input_rate", "lock_in_rate", "amplitude", "initial_phase", "backscatter_phase")
    values = (scale_factor, input_rate, lock_in_rate, amplitude, initial_phase, backscatter_phase)
    checked = [_parameter(name, value) for name, value in zip(names, values, strict=True)]
    k, w, wl, a, phi0, beta = checked
    delta = _parameter("readout_phase", readout_phase)
    if np.any(wl < 0):
        raise ValueError("lock_in_rate must not be negative")
    if np.any(k <= 0):
        raise ValueError("scale_factor must be positive (pulses per degree)")

    even, odd = _half_angle_propagator(t, np.pi * k * w, np.pi * k * wl)
    half = (phi0 + beta) / 2
    n0, d0 = np.sin(half), np.cos(half)
    n = even * n0 + odd * (np.pi * k * (w * d0 - wl * n0))
    d = even * d0 + odd * (np.pi * k * (wl * d0 - w * n0))
    return _detected(n, d, a, delta - beta)


def _parameter(name: str, value: ArrayLike) -> Floats:
    """A parameter as an array with a last axis of one, to broadcast over the samples."""
    array = np.asarray(value, dtype=np.float64)[..., np.newaxis]
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be finite")
    return array


def _detected(n: Floats, d: Floats, amplitude: Floats, turn: Floats) -> Floats:
    """A sin(chi + turn) with tan(chi/2) = n/d."""
    signal = 2 * n * d * np.cos(turn) + (d - n) * (d + n) * np.sin(turn)
    return np.asarray(amplitude * signal / (n * n + d * d), dtype=np.float64)


def _half_angle_propagator(t: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Coefficients of I and of M in exp(M t), up to a common positive factor; a = pi K W, b = pi K WL."""
    # The common factor cancels in N/D. Dividing by cosh keeps a locked gyro finite for any time.
    square = (a - b) * (a + b)
    root = np.sqrt(np.abs(square))
    angle = root * t
    beating, locked = square > 0, square < 0
    even = np.where(beating, np.cos(angle), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        odd = np.where(locked, np.tanh(angle), np.sin(angle)) / root
    return even, np.where(beating | locked, odd, t)


def rate_varying_beat(
    input_rates: ArrayLike,
    sample_interval: float,
    *,
    scale_factor: float,
    lock_in_rate: ArrayLike,
    amplitude: ArrayLike = 1.0,
    initial_phase: ArrayLike = 0.0,
    backscatter_phase: ArrayLike = 0.0,
    readout_phase: ArrayLike = 0.0,
) -> Floats:
    """Detector signal while the input rate changes, by exact Moebius steps.

    Within a step the rate is constant and the step is exact, whatever its length: nothing can become
    unstable, and a rate given at mid-step makes the whole of second order in the step.

    Parameters
    ----------
    input_rates : (..., n_samples - 1)
        deg/s, the mean rate between consecutive samples.
    sample_interval : float
        Seconds between samples.
    scale_factor, lock_in_rate, amplitude, initial_phase, backscatter_phase, readout_phase
        As in `beat_signal`.

    Returns
    -------
    (..., n_samples)
        The signal; its first sample has phi = initial_phase.
    """
    rates = np.asarray(input_rates, dtype=np.float64)
    wl, a, phi0, beta, delta = (
        np.asarray(p, dtype=np.float64)
        for p in (lock_in_rate, amplitude, initial_phase, backscatter_phase, readout_phase)
    )
    up, down = np.pi * scale_factor * rates, np.pi * scale_factor * wl[..., np.newaxis]
    up = np.broadcast_to(up, np.broadcast_shapes(up.shape, down.shape))
    even, odd = _half_angle_propagator(np.asarray(sample_interval), up, np.broadcast_to(down, up.shape))
    half = (phi0 + beta) / 2
    n, d = _chained(even, odd * down, odd * up, np.sin(half), np.cos(half))
    return _detected(n, d, a[..., np.newaxis], (delta - beta)[..., np.newaxis])


def _chained(even: Floats, down: Floats, up: Floats, n0: Floats, d0: Floats) -> tuple[Floats, Floats]:
    """(N, D) after each of a chain of steps [[even - down, up], [-up, even + down]], and before the first."""
    # The chain is cut into runs. All runs are multiplied out at the same time, step by step; then they are joined.
    n_steps = up.shape[-1]
    length = math.isqrt(max(n_steps - 1, 0)) + 1
    products = _products_in_runs(even, down, up, length)
    runs = products.shape[-1]
    n, d = (np.empty((*up.shape[:-1], runs * length + 1)) for _ in range(2))
    n[..., 0], d[..., 0] = n0, d0
    for run in range(runs):
        start = run * length
        p, q, r, s = np.moveaxis(products[..., run], 1, -1)
        n_now, d_now = n[..., start : start + 1], d[..., start : start + 1]
        size = np.hypot(n_now, d_now)
        after = slice(start + 1, start + length + 1)
        n[..., after] = (p * n_now + q * d_now) / size
        d[..., after] = (r * n_now + s * d_now) / size
    return n[..., : n_steps + 1], d[..., : n_steps + 1]


def _products_in_runs(even: Floats, down: Floats, up: Floats, length: int) -> Floats:
    """Products of a run's steps up to each place in it, up to a positive factor; (4, length, ..., runs)."""
    n_steps = up.shape[-1]
    runs = -(-n_steps // length)
    # Each step is scaled, so that a locked gyro does not overflow. Steps of identity fill the last run.
    scale = np.maximum(np.abs(even) + np.abs(down), np.abs(up))
    padded = np.zeros((3, *up.shape[:-1], runs * length))
    padded[0, ..., n_steps:] = 1.0
    for place, values in zip(padded, (even, down, up), strict=True):
        place[..., :n_steps] = values / scale
    # The place in the run comes first, so that one step of all runs lies together in memory.
    e, w, u = np.moveaxis(padded.reshape(3, *up.shape[:-1], runs, length), -1, 1).copy()
    products = np.empty((4, *e.shape))
    products[:, 0] = e[0] - w[0], u[0], -u[0], e[0] + w[0]
    for j in range(1, length):
        p, q, r, s = products[:, j - 1]
        less, more = e[j] - w[j], e[j] + w[j]
        products[:, j] = less * p + u[j] * r, less * q + u[j] * s, more * r - u[j] * p, more * s - u[j] * q
    return products


def harmonic_ratio(rate_ratio: ArrayLike) -> Floats:
    """r = A2/A1 for x = WL/W, 0 <= x <= 1: r = tan(asin(x)/2), written to keep all digits at small x.

    Examples
    --------
    >>> [round(float(harmonic_ratio(x)), 10) for x in (0.5, 0.6, 0.8)]
    [0.2679491924, 0.3333333333, 0.5]
    """
    x = np.asarray(rate_ratio, dtype=np.float64)
    return np.asarray(x / (1 + np.sqrt((1 - x) * (1 + x))), dtype=np.float64)


def beat_frequency(scale_factor: ArrayLike, input_rate: ArrayLike, lock_in_rate: ArrayLike) -> Floats:
    """f = K sqrt(W^2 - WL^2) in Hz; 0 inside lock-in (Zhan et al., equation (11))."""
    w, wl = np.asarray(input_rate, dtype=np.float64), np.asarray(lock_in_rate, dtype=np.float64)
    return np.asarray(scale_factor * np.sqrt(np.maximum((w - wl) * (w + wl), 0.0)), dtype=np.float64)


def lock_in_from_rate(ratio: ArrayLike, input_rate: ArrayLike, relation: Relation = "exact") -> Floats:
    """Lock-in rate from r = A2/A1 and the input rate, deg/s.

    "exact": WL = |W| 2r/(1+r^2), the inverse of (2). "paper-10" and "paper-13" are equations (10) and (13)
    of Zhan et al., kept for comparison: they are high and low by x^2/4 to leading order.
    """
    r, w = np.asarray(ratio, dtype=np.float64), np.abs(np.asarray(input_rate, dtype=np.float64))
    if relation == "exact":
        return np.asarray(w * 2 * r / (1 + r * r))
    if relation == "paper-13":
        return np.asarray(w * 2 * r / np.sqrt(1 + 4 * r * r))
    if relation == "paper-10":
        return np.asarray(w * 2 * r)
    raise ValueError(f"relation {relation!r} is none of 'exact', 'paper-13', 'paper-10'")


def lock_in_from_beat(ratio: ArrayLike, beat_rate: ArrayLike) -> Floats:
    """Lock-in rate from r and f/K alone (deg/s): WL = (f/K) 2r/(1-r^2). No rate table is needed."""
    r = np.asarray(ratio, dtype=np.float64)
    return np.asarray(np.asarray(beat_rate, dtype=np.float64) * 2 * r / (1 - r * r))


def input_rate_from_beat(ratio: ArrayLike, beat_rate: ArrayLike) -> Floats:
    """|W| in deg/s that goes with r and f/K of one record: W = (f/K) (1+r^2)/(1-r^2)."""
    r = np.asarray(ratio, dtype=np.float64)
    return np.asarray(np.asarray(beat_rate, dtype=np.float64) * (1 + r * r) / (1 - r * r))
