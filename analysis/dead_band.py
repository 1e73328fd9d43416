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

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats, Indices, Ints

# --------------------
# The corner of the dead band with noise: pulse rate in closed form, and sweeps by integration.
#
# With the noise the phase of the beat obeys
#
#     d(phi)/dt = 2 pi K [W - WL sin(phi)] + noise,    variance of the noise's angle: N^2 t
#
# N is the angle random walk in deg/sqrt(s). Noise lets the phase slip below lock-in; the mean rate of that is
# known in closed form for a particle that diffuses in a tilted periodic potential (Stratonovich, Topics in the
# Theory of Random Noise, vol. 2): with a = 2 pi K W, b = 2 pi K WL and D = (2 pi K N)^2/2,
#
#     <d(phi)/dt> = D (1 - exp(-2 pi a/D)) / integral over 0..2 pi of exp(-a s/D) I0((2 b/D) sin(s/2)) ds      (1)
#
# A continued fraction gives the same to rounding and without the integral's narrow peaks


LARGEST_TURN = 0.4
"""rad, of the phase in one step of the simulation; the steps are exact but for the noise inside them."""

LEAST_WALK = 1e-3
"""In sqrt(WL/K): less noise rounds nothing that a counter could show, and would need endless harmonics."""

TREMBLE = 0.25  # turns


def rounded_pulse_rate(
    input_rate: ArrayLike, *, scale_factor: float, lock_in_rate: ArrayLike, random_walk: ArrayLike
) -> Floats:
    """Mean pulse rate, Hz, with the sign of the rate: equation (1). Arguments broadcast."""
    # At the corner itself noise gives pulses, where there should be none.
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
        drive = per_rate * np.abs(rate[noisy])
        lock = per_rate * lock_in[noisy]
        # With p_n = <exp(-i n phi)> the density obeys (n + i a/D) p_n = (b/2D)(p_(n-1) - p_(n+1)).
        orders = int(60 + 12 * np.sqrt(np.max(lock, initial=0.0)))
        ratio, half, turning = np.zeros(drive.shape, dtype=np.complex128), lock / 2, 1j * drive
        for n in range(orders, 0, -1):
            ratio = half / (n + turning + half * ratio)
        slips = np.asarray(np.maximum(drive + lock * ratio.imag, 0.0))
        turns[noisy] = slips * diffusion / (2 * np.pi)
    return np.asarray(np.sign(rate) * turns)


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


# --------------------
# Lock-in rate, bias, its drift, hysteresis and noise from all steps of a sweep: the corner as a whole


FEWEST_FOR_CORNER = 6
FEWEST_BOTH_WAYS = 4  # steps on the way out and on the way in from which a drift is told from hysteresis

FEWEST_DEGREES = 3.0

COUNTED_U = 6**-0.5  # standard uncertainty of a count of whole pulses: rounding at either end
_NEAR = 3.0  # steps below so many lock-in rates are fitted: beyond, the beat hardly depends on it

# in lock-in rates, but for the logarithm of the walk in sqrt(WL/K): lock-in rate, bias, walk, drift, hysteresis
_START = np.array([1.0, 0.0, np.log(0.02), 0.0, 0.0])
_LOW = np.array([0.1, -1.0, np.log(LEAST_WALK), -1.0, -0.5])
_HIGH = np.array([3.0, 1.0, np.log(10.0), 1.0, 0.5])
_SCALE = np.array([0.01, 0.01, 0.3, 0.01, 0.01])
_NOT_THE_WALK = np.array([True, True, False, True, True])
_STEP = 1e-6


@dataclass(frozen=True)
class Sweep:
    """Steps as they were taken, (n,): deg/s, pulses and their uncertainty, and the time from -1/2 to 1/2."""

    rates: Floats
    pulses: Floats
    pulses_u: Floats
    time: Floats
    dwell: float
    scale_factor: float


@dataclass(frozen=True)
class Corner:
    """Fitted corner: lock-in rate (deg/s), random walk (deg/sqrt(s)) and drift over the sweep (deg/s)."""

    rate: float = float("nan")
    rate_u: float = float("nan")
    random_walk: float = float("nan")
    random_walk_u: float = float("nan")
    drift: float = float("nan")
    drift_u: float = float("nan")


def fit_whole_corner(swept: Sweep, start: float) -> Corner:
    """Fit the steps below three times the lock-in rate `start`, deg/s; all nan where they are too few."""
    # Drift and hysteresis are fitted where the steps go both ways.
    from scipy.optimize import least_squares  # costs more to import than all else here

    near = np.abs(swept.rates) < _NEAR * start
    if near.sum() < FEWEST_FOR_CORNER:
        return Corner()
    inwards = falling(swept.rates)[near]
    both_ways = min(inwards.sum(), (~inwards).sum()) >= FEWEST_BOTH_WAYS
    count = 5 if both_ways and np.any(swept.time) else 3
    seen = swept.pulses[near]

    def expected(points: Floats) -> Floats:
        columns = np.zeros((5, len(points), 1))
        columns[: points.shape[1], :, 0] = points.T
        lock_in, bias, walk, drift, hysteresis = columns
        way = np.where(falling(swept.rates)[near], -0.5, 0.5)
        turning = rounded_pulse_rate(
            swept.rates[near] - (bias + drift * swept.time[near]) * start,
            scale_factor=swept.scale_factor,
            lock_in_rate=np.maximum(lock_in + way * hysteresis, 0.0) * start,
            random_walk=np.exp(walk) * _usual_walk(swept, start),
        )
        return np.asarray(np.abs(turning) * swept.dwell)

    def slopes(point: Floats) -> Floats:
        # all points of the difference at once: the closed form's cost is in its loop, not in its arrays
        aside = point + np.vstack([np.zeros(count), _STEP * np.eye(count)])
        at, *beside = expected(aside)
        return np.asarray((np.stack(beside, axis=-1) - at[:, np.newaxis]) / _STEP)

    def left(point: Floats) -> Floats:
        return np.asarray(expected(point[np.newaxis])[0] - seen)

    fit = least_squares(
        left, _START[:count], jac=slopes, bounds=(_LOW[:count], _HIGH[:count]), x_scale=_SCALE[:count], max_nfev=60
    )
    if np.any(fit.active_mask[_NOT_THE_WALK[:count]]):
        return Corner()  # no such corner: another scale factor, or steps that do not show it
    jacobian = np.asarray(fit.jac)
    # Slips scatter most at the corner itself: each step's own residual says how much, less what the fit took of it
    # (MacKinnon and White, J. Econometrics 29, 305, third estimate), and a count no less than its uncertainty.
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    kept = np.maximum(1 - np.einsum("ni,ij,nj->n", jacobian, inverse, jacobian), 1 / near.sum())
    spread = np.maximum(fit.fun / kept, swept.pulses_u[near]) ** 2
    weights = inverse @ jacobian.T
    # `spread` (n,): variances of the steps.
    # Each of these is that of a single residual, and where slips are strong few steps at the corner count. The sum
    # of their shares then has few degrees of freedom (Satterthwaite; the square of a squared residual is three
    # times that of its mean): the uncertainty is enlarged to what Student's distribution asks for.
    shares = weights**2 * spread
    total = shares.sum(axis=1)
    squares = np.maximum(np.sum(shares**2, axis=1), 1e-300)
    degrees = np.maximum(3 * total**2 / squares, FEWEST_DEGREES)
    student = scipy.special.stdtrit(degrees, 0.975) / scipy.special.ndtri(0.975)
    us = np.asarray(np.sqrt(np.maximum(total, 0.0)) * student)
    walk = float(np.exp(fit.x[2])) * _usual_walk(swept, start)
    drift, drift_u = (float(fit.x[3]), float(us[3])) if count > 3 else (float("nan"), float("nan"))
    return Corner(
        rate=float(fit.x[0]) * start,
        rate_u=float(us[0]) * start,
        random_walk=walk,
        random_walk_u=walk * float(us[2]),
        drift=drift * start,
        drift_u=drift_u * start,
    )


def _usual_walk(swept: Sweep, start: float) -> float:
    return float(np.sqrt(start / swept.scale_factor))


SEEN = 3.29  # standard uncertainties beyond which chance hardly ever goes
WALK_KNOWN = 2.0  # a random walk that does not stand out of so many standard uncertainties says nothing of slips

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
    corner = fit_whole_corner(swept, float(np.nanmean(edges))) if fit_corner else Corner()
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
    u = float(np.sqrt(found.lock_in_rate_u**2 + half_hysteresis**2 + noise_part**2))
    return DeadBand(
        **found._replace(lock_in_rate_u=u)._asdict(),
        edges=edges,
        edge_half_widths=halves,
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
    for branch, rows in _branches(swept):
        size, time, moving = np.abs(swept.rates[rows]), swept.time[rows], swept.pulses[rows] >= least_pulses
        if moving.all() or not moving.any():
            flags |= DeadBandFlag.NO_SILENT_RATE if moving.all() else DeadBandFlag.NO_PULSES
            continue
        first = int(np.argmax(moving))
        if not moving[first:].all():
            flags |= DeadBandFlag.PULSES_INSIDE
        # Below the slowest step swept there is nothing but standstill.
        below = size[first - 1] if first else 0.0
        edges[branch], halves[branch] = (size[first] + below) / 2, (size[first] - below) / 2
        when[branch] = (time[first] + time[max(first - 1, 0)]) / 2
    return edges, halves, when, flags


def _branches(swept: Sweep) -> Iterator[tuple[tuple[int, int], Indices]]:
    """Rows of each branch of two and more, the slowest first: positive, negative; rising, falling."""
    down = falling(swept.rates)
    for k, sense in enumerate((1, -1)):
        for m, direction in enumerate((False, True)):
            rows = np.flatnonzero((swept.rates * sense > 0) & (down == direction))
            if rows.size > 1:
                yield (k, m), rows[np.argsort(np.abs(swept.rates[rows]))]


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
    slips = swept.dwell * np.abs(
        rounded_pulse_rate(
            swept.rates, scale_factor=swept.scale_factor, lock_in_rate=corner.rate, random_walk=corner.random_walk
        )
    )
    for branch, rows in _branches(swept):
        size, silent = np.abs(swept.rates[rows]), np.exp(-slips[rows])
        first = (1 - silent) * np.concatenate([[1.0], np.cumprod(silent)[:-1]])
        edge = (size + np.concatenate([[0.0], size[:-1]])) / 2
        total = max(float(first.sum()), 1e-300)
        middle = float(np.sum(first * edge)) / total
        spread[branch] = np.sqrt(np.sum(first * (edge - middle) ** 2) / total)
    return spread


def _shared(edges: Floats, us: Floats) -> float:
    """Standard uncertainty of the mean of two edges in one sense, or of one."""
    # Where they lie apart, the true one is where both gaps overlap, or else the gaps are two: independent.
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
