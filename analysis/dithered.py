"""Lock-in rate from records of a dithered gyro: what each turning point of the dither does to the phase.

A body dither swings the rate, W = W0 + W_D cos(w t), far beyond lock-in and through zero twice a period. Only for
microseconds about zero does the coupling act, and there it shifts the phase by some hundredths of a radian,
B sqrt(2 pi/a) cos(psi + b +- pi/4), B = 2 pi K WL, a the acceleration of the phase: steps in a phase that the
record shows to a milliradian. With psi0 the phase of a gyro without lock-in,

    psi(t) = psi0(t) - Im[z int exp(i psi(t')) dt'],     z = 2 pi K WL exp(i b)                       (1)

which is exact; the integral is taken along psi of the round before. psi0 is the integral of a rate whose dither
has a slowly varying complex amplitude (splines) and some harmonics. Least squares on the samples fits it together
with z, in which (1) is linear. The record is that of a receiver,

    V = V0 + A (1 + m) sin(psi) / sqrt(1 + D rate^2) + Re[c exp(2 i psi)],   dm/dt = g (Re[w exp(i psi)] - m)   (2)

with one pole (D; its delay is one of the dither's phase) and a second harmonic (c). The light follows the coupling
up to the gain corner g (2.12): by a tenth where the beat turns over, and that would pass for lock-in. Beams that
are alike have w = z/g; here w is free, and g an unknown with a bound.

The sense of rotation does not show in one detector: psi and pi - psi give the same record, so z and -z* are one
answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Complexes, Floats, Ints, NoFit, Stacked

HARMONICS = 3  # of the dither
KNOTS = 3.0  # of its amplitude in a period
FINER = 8  # steps of the integral in (1) for a sample
LONGEST_STEP, ROUNDS, FOLLOWED = 0.45, 12, 0.3  # beats a sample; Gauss-Newton; rad that tracking may leave
_WINDOWS, _PADDED = 20, 256  # parts of a dither period in which a beat is looked for; samples with zeros
_DITHER_RANGE = np.linspace(0.97, 1.03, 25)  # of the stated dither frequency, in which it is looked for
_STEADY_ROUNDS, _ROUGHLY, _RIDGE = 2, 0.3, 0.03
_SMOOTHED, _BEATS = 26, 1.8  # parts of a dither period over which the phase is averaged; beats that it has to hold
_LAGS, UNLIKELY, SIGNIFICANT = 20, 0.001, 3.3
_LEAST_GAIN, _DESCENTS, _FEWEST = 0.1, 40, 500  # the last: samples of a record
_PICARD, _SETTLED = 12, 1e-4  # rounds of (1), and rad by which the last may change the phase
_PERIODS_TO_SEE = 1.5  # of a dither whose amplitude may change: with fewer its size and the bias are one
_CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 181)), np.sin(np.linspace(0, 2 * np.pi, 181))], axis=-1)
_GAIN_CORNER, _GAIN_CORNER_U = math.log(2 * math.pi * 1e4), 2.0  # ln of rad/s: 1.4 to 74 kHz
_CORNERS = 6.0, 18.0  # of the same: 64 Hz to 10 MHz


class DitherFlag(IntFlag):
    """Bits of `DitheredEstimate.flags`; the lower-case name is the one used in JSON."""

    TOO_SHORT = 1
    """Less than half a dither period: no turning point need be in the record."""
    NOT_FOLLOWED = 2
    """The phase could not be followed: no beat, another dither frequency, or a dither that is not a sinusoid."""
    ALIASED = 4
    """The fastest beats have fewer samples than they need: take a faster time base."""
    MISFIT = 8
    """What the fit leaves is no white noise: vibration, or a dither that changes faster than its splines."""
    NOT_SIGNIFICANT = 16
    """The lock-in rate does not stand out of its uncertainty."""
    GAPS = 32
    """The record has clipped or missing samples."""


@dataclass(frozen=True)
class DitheredEstimate(Stacked):
    """Estimates of n records, nan where one cannot be used.

    lock_in_rate, lock_in_rate_u, lock_in_rate_low_95, lock_in_rate_high_95 : (n,) deg/s, by the noise alone
    coupling : (n,) complex, deg/s, WL exp(i b) of (1); or that of the other sense, -WL exp(-i b)
    coupling_covariance : (n, 2, 2) of its real and imaginary part
    dither_rate, dither_frequency : (n,) deg/s, mean amplitude W_D of the dither, nan in less than 1.5 periods; Hz
    noise_rms : (n,) volts, what the fit leaves
    flags : (n,) bits of `DitherFlag`
    """

    lock_in_rate: Floats
    lock_in_rate_u: Floats
    lock_in_rate_low_95: Floats
    lock_in_rate_high_95: Floats
    coupling: Complexes
    coupling_covariance: Floats
    dither_rate: Floats
    dither_frequency: Floats
    noise_rms: Floats
    flags: Ints


def estimate_dithered(
    volts: ArrayLike,
    sample_interval: float,
    *,
    scale_factor: float,
    dither_frequency: float,
    clipped: ArrayLike | None = None,
) -> DitheredEstimate:
    """Lock-in rate from records of a gyro whose dither is on.

    Parameters
    ----------
    volts : (n, n_samples)
        Some dither periods each, or half of one. The fastest beat needs more than two samples a period.
    sample_interval : float
        Seconds.
    scale_factor : float
        K, pulses per degree.
    dither_frequency : float
        Hz, to 3 %.
    clipped : (n, n_samples) of bool, optional

    Raises
    ------
    ValueError
        A scale factor, dither frequency or sample interval that is not positive, or fewer than 500 samples.
    """
    records = np.asarray(volts, dtype=np.float64)
    if records.ndim != 2 or records.shape[1] < _FEWEST:
        raise ValueError(f"volts must have shape (n, {_FEWEST} or more), not {records.shape}")
    if not (scale_factor > 0 and dither_frequency > 0 and sample_interval > 0):
        raise ValueError("scale_factor, dither_frequency and sample_interval must be positive")
    gaps = np.asarray(~np.isfinite(records).all(axis=-1)).ravel()
    if clipped is not None:
        gaps |= np.asarray(clipped).any(axis=-1)
    found = [
        _Record.failed(DitherFlag.GAPS) if gap else _estimated(one, sample_interval, dither_frequency)
        for one, gap in zip(records, gaps.tolist(), strict=True)
    ]
    per_rate = 2 * np.pi * scale_factor
    z = np.array([one.z for one in found], dtype=np.complex128) / per_rate
    covariance = np.array([one.covariance for one in found]).reshape(-1, 2, 2) / per_rate**2
    size, u, low, high = _size(z, covariance)
    flags = np.array([int(one.flags) for one in found], dtype=np.int64)
    flags |= np.where(size < SIGNIFICANT * u, int(DitherFlag.NOT_SIGNIFICANT), 0)
    return DitheredEstimate(
        size,
        u,
        low,
        high,
        z,
        covariance,
        np.array([one.dither for one in found]) / scale_factor,
        np.array([one.frequency for one in found]),
        np.array([one.noise for one in found]),
        flags,
    )


def combine_dithered(each: DitheredEstimate) -> DitheredEstimate:
    """One value of all records that can be used, whose backscatter phase is one.

    Raises
    ------
    NoFit
        No record that can be used.
    """
    doubtful = int(DitherFlag.TOO_SHORT | DitherFlag.NOT_FOLLOWED | DitherFlag.ALIASED | DitherFlag.GAPS)
    rows = np.flatnonzero((each.flags & (doubtful | int(DitherFlag.MISFIT))) == 0)
    if not rows.size:
        raise NoFit("no record of a dithered gyro that could be used")
    weights = np.asarray(np.linalg.inv(each.coupling_covariance[rows]), dtype=np.float64)
    own = np.stack([each.coupling[rows].real, each.coupling[rows].imag], axis=-1)
    # where the search begins does not matter much: at the clearest records
    tried = [_mixed(begin, own, weights) for begin in own[np.argsort(each.lock_in_rate_u[rows])[:3]]]
    mean, covariance, left = min(tried, key=lambda one: float(_unlikeliness(one[0][np.newaxis], own, weights)[0]))
    freedom, flags, wider = 2 * (rows.size - 1), 0, 1.0
    if freedom and float(scipy.special.chdtrc(freedom, left)) < UNLIKELY:
        wider, flags = left / freedom, int(DitherFlag.MISFIT)
    low, high = _interval(mean, covariance, own, weights, NORMAL_95**2 * wider)
    value, u = min(max(math.hypot(*mean), low), high), (high - low) / (2 * NORMAL_95)
    flags |= int(DitherFlag.NOT_SIGNIFICANT) if value < SIGNIFICANT * u else 0
    whole = each.dither_rate[rows][np.isfinite(each.dither_rate[rows])]
    return DitheredEstimate(
        np.array([value]),
        np.array([u]),
        np.array([low]),
        np.array([high]),
        np.array([complex(*mean)]),
        wider * covariance[np.newaxis],
        np.array([whole.mean() if whole.size else math.nan]),
        np.array([each.dither_frequency[rows].mean()]),
        np.array([math.sqrt(np.mean(each.noise_rms[rows] ** 2))]),
        np.array([flags]),
    )


def dithered_bound(
    coupling: complex,
    dither: complex,
    *,
    scale_factor: float,
    dither_frequency: float,
    sample_interval: float,
    n_samples: int,
    noise: float,
    bias: float = 0.0,
    start: float = 0.0,
    gain_corner: float = 1e4,
) -> float:
    """Smallest standard uncertainty, deg/s, that one record leaves to any estimator of (2) (Cramér and Rao).

    Coupling WL exp(i b), dither in the middle of the record (complex amplitudes) and bias in deg/s; noise rms over
    the amplitude of the beat; phase of the beat at the start, rad; gain corner, Hz, of beams that are alike.
    """
    motion, per_rate = _Motion(n_samples, sample_interval, dither_frequency), 2 * math.pi * scale_factor
    swing = np.repeat([dither.real, -dither.imag], len(motion.splines)) * scale_factor
    moved = np.concatenate([[bias * scale_factor], swing, np.zeros(len(motion.rates) - 1 - swing.size)])
    z, corner = per_rate * coupling, 2 * math.pi * gain_corner
    light = z / corner
    values = np.array([0, 1, start, *moved, z.real, z.imag, 0, 0, light.real, light.imag, 0, math.log(corner)])
    columns = _left(values, np.zeros(n_samples), motion, noise / _GAIN_CORNER_U)[1]
    scale = np.linalg.norm(columns, axis=0)
    way = np.zeros(scale.size)
    way[-8:-6] = np.array([z.real, z.imag]) / abs(z) / scale[-8:-6]
    return float(noise * np.linalg.norm(way @ np.linalg.pinv(columns / scale))) / per_rate


_MIRROR = np.array([-1.0, 1.0])


def _chi_squares(points: Floats, own: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Of n records at points (k, 2): with their answers, and with those of the other sense, (n, k) each."""
    turned = weights * np.outer(_MIRROR, _MIRROR)
    pairs = ((points - own[:, np.newaxis], weights), (points - (own * _MIRROR)[:, np.newaxis], turned))
    first, second = (np.einsum("nki,nij,nkj->nk", apart, weight, apart) for apart, weight in pairs)
    return first, second


def _unlikeliness(points: Floats, own: Floats, weights: Floats) -> Floats:
    """-2 ln of the likelihood of points (k, 2), where either answer of a record may be the right one: (k,)."""
    first, second = _chi_squares(points, own, weights)
    return np.asarray(-2 * np.sum(np.logaddexp(-first / 2, -second / 2), axis=0))


def _mixed(begin: Floats, own: Floats, weights: Floats) -> tuple[Floats, Floats, float]:
    """Mean and covariance of records whose sense is not known, each answer by its share, and chi-square."""
    mean, turned = begin, weights * np.outer(_MIRROR, _MIRROR)
    for _ in range(_MOST_ROUNDS):
        first, second = (chi[:, 0] for chi in _chi_squares(mean[np.newaxis], own, weights))
        share = scipy.special.expit((second - first) / 2)
        both = share[:, np.newaxis, np.newaxis] * weights, (1 - share)[:, np.newaxis, np.newaxis] * turned
        covariance = np.linalg.inv((both[0] + both[1]).sum(axis=0))
        pulls = np.einsum("nij,nj->i", both[0], own) + np.einsum("nij,nj->i", both[1], own * _MIRROR)
        before, mean = mean, covariance @ pulls
        if np.max(np.abs(mean - before)) < 1e-6 * math.sqrt(float(np.trace(covariance))):
            break
    return np.asarray(mean), covariance, float(np.sum(share * first + (1 - share) * second))


def _interval(mean: Floats, covariance: Floats, own: Floats, weights: Floats, limit: float) -> tuple[float, float]:
    """Sizes whose likelihood at the best phase is less than `limit` below the largest."""
    size, reach = math.hypot(*mean), _REACH * math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]) * limit)
    sizes = np.linspace(max(size - reach, 0.0), size + reach, _SIZES)
    window = min(reach / size, math.pi / 2) if size > 0 else math.pi / 2
    phases = math.atan2(mean[1], mean[0]) + np.linspace(-window, window, _SIZES)
    circle = np.stack([np.cos(phases), np.sin(phases)], axis=-1)
    unlikely = np.array([np.min(_unlikeliness(one * circle, own, weights)) for one in sizes])
    inside = np.flatnonzero(unlikely - np.min(unlikely) < limit)
    return float(sizes[inside[0]]), float(sizes[inside[-1]])


_MOST_ROUNDS, _SIZES, _REACH = 300, 161, 2.5


# --------------------
# The random walk of dithered counts


@dataclass(frozen=True)
class CountsWalk:
    """Random walk of the angle of a gyro that dithers, by its counts."""

    random_walk: float  # deg/sqrt(s), with its standard uncertainty and 95 % interval
    random_walk_u: float
    random_walk_low_95: float
    random_walk_high_95: float
    walks: bool  # whether it is one: what each gate adds has nothing in common with the gates before


FEWEST_GATES = 200
_LEAST_WALK, _MOST_CELLS, _FEWEST_CELLS = 0.01, 300, 24
_ALONG = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
_WALK_STARTS, _WALK_STEP, _WALK_SETTLED = 8, 0.1, 0.02


def walk_of_counts(counts: ArrayLike, gate_s: float, *, scale_factor: float) -> CountsWalk:
    """Random walk of the counts of a gyro at a steady rate, which may be far less than a count a gate.

    A count says between which pulses the phase stands. The likelihood of all counts is that of a phase that drifts
    and walks through what they leave open, followed exactly on a grid; its maximum is sought over walk and drift.

    Parameters
    ----------
    counts : (n,)
        Pulses of each gate, up less down. Gates of whole dither periods: the swing would hide the walk.
    gate_s : float
        Seconds; one gate begins where the one before ends.
    scale_factor : float
        K, counts per degree.

    Raises
    ------
    ValueError
        Fewer than 200 gates, counts that are no whole numbers, a gate or scale factor that is not positive.
    NoFit
        A walk of less than 0.01 counts a gate.
    """
    from scipy.optimize import minimize  # takes as long to import as all else

    seen = np.asarray(counts, dtype=np.float64)
    if seen.ndim != 1 or seen.size < FEWEST_GATES or not np.all(np.isfinite(seen) & (seen == np.rint(seen))):
        raise ValueError(f"counts must be at least {FEWEST_GATES} whole numbers, one for each gate")
    if not (gate_s > 0 and scale_factor > 0):
        raise ValueError("gate_s and scale_factor must be positive")
    changes, places = np.unique(seen - np.rint(seen.mean()), return_inverse=True)
    drift = float(changes[places].mean())

    def unlikely(values: Floats) -> float:
        return _unlikely_counts(changes, places, math.exp(values[0]), drift + off * values[1])[0]

    off = 1 / seen.size
    tried = np.log(np.geomspace(_LEAST_WALK, max(1.0, 2 * float(seen.std())), _WALK_STARTS))
    begin = min(tried, key=lambda one: unlikely(np.array([one, 0.0])))
    off = max(off, math.exp(begin) / math.sqrt(seen.size))
    simplex = np.array([[begin, 0.0], [begin - 4 * _WALK_STEP, 0.3], [begin, 1.0]])
    ended = minimize(
        unlikely,
        simplex[0],
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": _WALK_SETTLED, "fatol": _WALK_SETTLED, "maxfev": 80},
    )
    best = np.asarray(ended.x, dtype=np.float64)
    before, lowest, after = (unlikely(best + _WALK_STEP * move) for move in _ALONG)
    bent = before - 2 * lowest + after
    if best[0] <= math.log(_LEAST_WALK) or not math.isfinite(bent):
        raise NoFit(f"the counts walk less than {_LEAST_WALK:g} a gate: take longer gates")
    # chi-square is a parabola in the logarithm
    u = _WALK_STEP * math.sqrt(2 / bent) if bent > 0 else math.inf
    walk = math.exp(best[0]) / (scale_factor * math.sqrt(gate_s))
    wider = math.exp(min(NORMAL_95 * u, 100.0))
    steps = _unlikely_counts(changes, places, math.exp(best[0]), drift + off * best[1])[1]
    return CountsWalk(walk, walk * u, walk / wider, walk * wider, _is_white(steps))


def _unlikely_counts(changes: Floats, places: Ints, walk: float, drift: float) -> tuple[float, Floats]:
    """-2 ln of the likelihood of counts `changes[places]`, and by how much each gate moves the mean phase."""
    cells = int(np.clip(math.ceil(3 / walk), _FEWEST_CELLS, _MOST_CELLS))
    inside = (np.arange(cells) + 0.5) / cells
    ways = np.arange(1 - cells, cells) / cells
    density = np.exp(-0.5 * ((ways + changes[:, np.newaxis] - drift) / walk) ** 2)
    density /= walk * cells * math.sqrt(2 * math.pi)
    phase, total, means = np.full(cells, 1 / cells), 0.0, np.empty(places.size + 1)
    means[0] = 0.5
    for number, place in enumerate(places.tolist(), start=1):
        phase = np.convolve(density[place], phase, "valid")
        share = float(phase.sum())
        if not share > 0:
            return math.inf, means[1:]
        phase /= share
        total += math.log(share)
        means[number] = inside @ phase
    return -2 * total, changes[places] + np.diff(means) - drift


def lock_in_of_random_walk(random_walk: float, *, scale_factor: float, dither_rate: float) -> float:
    """Lock-in rate, deg/s, of a random walk of dithered counts in deg/sqrt(s): N = WL/sqrt(2 pi K W_D), (2.13).

    An average over the phase of the coupling, for dither amplitudes that vary so that every turning point finds
    another phase; what else makes the counts walk adds to it.
    """
    return random_walk * math.sqrt(2 * math.pi * scale_factor * dither_rate)


def _size(z: Complexes, covariance: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """|z| freed of the bias that noise gives it, its u and 95 % interval, (n,) each."""
    # of the sizes that chi-square leaves at any phase: the ellipse of z is long where one turning point was seen
    with np.errstate(invalid="ignore", divide="ignore"):
        across = np.stack([-z.imag, z.real], axis=-1) / np.abs(z)[:, np.newaxis]
        bias = np.einsum("ni,nij,nj->n", across, covariance, across)
        axes, ways = np.linalg.eigh(np.where(np.isfinite(covariance), covariance, 0.0))
        lengths = NORMAL_95 * np.sqrt(np.maximum(axes, 0.0))
        own = np.einsum("nji,nj->ni", ways, np.stack([z.real, z.imag], axis=-1))
        edge = own[:, np.newaxis] + lengths[:, np.newaxis] * _CIRCLE
        sizes = np.linalg.norm(edge, axis=-1)
        holds_zero = np.sum((own / lengths) ** 2, axis=-1) < 1
        low, high = np.where(holds_zero, 0.0, sizes.min(axis=-1)), sizes.max(axis=-1)
        value, low = np.sqrt(np.maximum(np.abs(z) ** 2 - bias, 0.0)), np.sqrt(np.maximum(low**2 - bias, 0.0))
        return value, (high - low) / (2 * NORMAL_95), low, high


# --------------------
# One record


@dataclass(frozen=True)
class _Record:
    """What one record says: z in rad/s with its covariance, dither in Hz of beat."""

    z: complex
    covariance: Floats
    dither: float
    frequency: float
    noise: float
    flags: DitherFlag

    @staticmethod
    def failed(flag: DitherFlag) -> _Record:
        """A record without a number."""
        return _Record(complex(math.nan, math.nan), np.full((2, 2), np.nan), math.nan, math.nan, math.nan, flag)


class _Motion:
    """The beat without lock-in as a function of its parameters, at `FINER` times for every sample."""

    def __init__(self, n_samples: int, sample_interval: float, dither: float) -> None:
        from scipy.interpolate import BSpline  # few programs need it

        self.step = sample_interval / FINER
        self.samples = np.arange(n_samples) * FINER
        times = (np.arange(n_samples * FINER) / FINER - (n_samples - 1) / 2) * sample_interval
        reach = n_samples * sample_interval / 2
        inner = np.linspace(-reach, reach, max(1, math.ceil(KNOTS * 2 * reach * dither)) + 1)
        knots = np.concatenate([inner[:1].repeat(3), inner, inner[-1:].repeat(3)])
        self.splines = BSpline.design_matrix(np.clip(times, inner[0], inner[-1]), knots, 3).toarray().T
        turns = 2 * np.pi * dither * times
        first = np.concatenate([self.splines * np.cos(turns), self.splines * np.sin(turns)])
        higher = [wave(order * turns) for order in range(2, HARMONICS + 1) for wave in (np.cos, np.sin)]
        self.rates = np.concatenate([np.ones((1, times.size)), first, np.array(higher)])
        self.phases = 2 * np.pi * self.integral(self.rates)

    def integral(self, values: Floats) -> Floats:
        """Integral from the beginning on, of the same shape."""
        from scipy.integrate import cumulative_trapezoid

        return np.asarray(cumulative_trapezoid(values, dx=self.step, initial=0))

    def decaying(self, values: Complexes, corner: float, turning: float) -> Complexes:
        """Values behind a low-pass with a corner in rad/s; they turned so fast (rad/s) before."""
        from scipy.signal import lfilter

        kept = math.exp(-corner * self.step)
        share = (1 - kept) / 2
        before = values[0] * (corner / (corner + 1j * turning) - share)
        return np.asarray(lfilter([share, share], [1.0, -kept], values, zi=[before])[0])

    def amplitude(self, parameters: Floats) -> float:
        """Mean amplitude of the dither."""
        count = len(self.splines)
        both = parameters[1 : 1 + count] - 1j * parameters[1 + count : 1 + 2 * count]
        return float(np.mean(np.abs(both @ self.splines)))


def _estimated(volts: Floats, sample_interval: float, dither: float) -> _Record:
    """Follow the phase roughly, then fit the samples."""
    if volts.size * sample_interval * dither < 0.5:
        return _Record.failed(DitherFlag.TOO_SHORT)
    if not np.ptp(volts) > 0:
        return _Record.failed(DitherFlag.NOT_FOLLOWED)
    (dither, bias, amplitude, phase), (times, frequency) = _by_beats(volts, sample_interval, dither)
    motion = _Motion(volts.size, sample_interval, dither)
    count = len(motion.splines)
    parameters = np.zeros(len(motion.rates))
    parameters[0] = bias
    parameters[1 : 1 + count] = amplitude * math.cos(phase)
    parameters[1 + count : 1 + 2 * count] = -amplitude * math.sin(phase)
    # of a dither whose amplitude changes the beats tell that too, though roughly
    columns = motion.rates[:, np.rint((times / sample_interval + (volts.size - 1) / 2) * FINER).astype(np.intp)]
    for _ in range(_STEADY_ROUNDS):
        rate = parameters @ columns
        off = np.sign(rate) * frequency - rate
        near = np.abs(off) < _ROUGHLY * np.abs(rate)
        rows = np.concatenate([columns[:, near].T, _RIDGE * math.sqrt(times.size) * np.eye(parameters.size)])
        wanted = np.concatenate([off[near], np.zeros(parameters.size)])
        parameters = parameters + np.linalg.lstsq(rows, wanted, rcond=None)[0]
    parameters, start, left = _followed(volts - volts.mean(), motion, parameters, sample_interval, dither)
    if not left < FOLLOWED:
        return _Record.failed(DitherFlag.NOT_FOLLOWED)
    if np.max(np.abs(parameters @ motion.rates)) * sample_interval > LONGEST_STEP:
        return _Record.failed(DitherFlag.ALIASED)
    return _fitted(volts, motion, parameters, start, dither)


def _part(periods_a_sample: float, parts: int, most: int) -> int:
    """Samples of a part of a dither period."""
    return int(np.clip(1 / periods_a_sample / parts, 12, most))


def _by_beats(
    volts: Floats, sample_interval: float, dither: float
) -> tuple[tuple[float, float, float, float], tuple[Floats, Floats]]:
    """Dither frequency, bias, amplitude (Hz of beat), phase; times and frequencies of the beat in short pieces."""
    long = _part(dither * sample_interval, _WINDOWS, 64)
    begins = np.arange(0, volts.size - long + 1, long // 4)
    pieces = volts[begins[:, np.newaxis] + np.arange(long)]
    pieces = (pieces - pieces.mean(axis=-1, keepdims=True)) * np.hanning(long + 2)[1:-1]
    sizes = np.abs(np.fft.rfft(pieces, _PADDED))
    sizes[:, : 6 * 64 // long] = 0
    place = np.clip(sizes.argmax(axis=-1), 1, sizes.shape[1] - 2)
    before, top, after = (
        np.log(np.take_along_axis(sizes, (place + k)[:, np.newaxis], 1)[:, 0] + 1e-300) for k in (-1, 0, 1)
    )
    curved = before - 2 * top + after
    offset = 0.5 * (before - after) / np.where(curved < 0, curved, -1.0)
    frequency = (place + offset) / (_PADDED * sample_interval)
    times = (begins + (long - volts.size) / 2) * sample_interval
    clear = top > np.median(top) - math.log(2)

    def squared(share: float) -> tuple[float, Floats]:
        """What f^2, which is linear in the waves of the dither and of twice its frequency, leaves; their sizes."""
        turns = 2 * np.pi * share * dither * times[clear]
        waves = np.stack(
            [np.ones_like(turns), *(wave(n * turns) for n in (1, 2) for wave in (np.cos, np.sin))], -1
        )
        values = np.linalg.lstsq(waves, frequency[clear] ** 2, rcond=None)[0]
        return float(np.sum((waves @ values - frequency[clear] ** 2) ** 2)), values

    costs = np.array([squared(share)[0] for share in _DITHER_RANGE])
    best = int(np.clip(costs.argmin(), 1, costs.size - 2))
    first, middle, last = costs[best - 1 : best + 2]
    bend = first - 2 * middle + last
    share = _DITHER_RANGE[best] + (0.5 * (first - last) / bend if bend > 0 else 0.0) * np.ptp(_DITHER_RANGE[:2])
    share = float(np.clip(share, _DITHER_RANGE[0], _DITHER_RANGE[-1]))
    values, dither = squared(share)[1], share * dither
    amplitude = max(math.sqrt(2 * math.hypot(values[3], values[4])), 1e-300)
    phase = 0.5 * math.atan2(-values[4], values[3])
    bias = (values[1] * math.cos(phase) - values[2] * math.sin(phase)) / (2 * amplitude)
    return (dither, float(bias), amplitude, phase), (times[clear], frequency[clear])


def _followed(
    volts: Floats, motion: _Motion, parameters: Floats, sample_interval: float, dither: float
) -> tuple[Floats, float, float]:
    """Parameters by the phase where the beat is fast, that of the beginning, and rad that are left."""
    smooth = _part(dither * sample_interval, _SMOOTHED, 48)
    weights = np.hanning(smooth + 2)[1:-1]
    inside = np.zeros(volts.size, dtype=bool)
    inside[smooth : -smooth : max(smooth // 6, 1)] = True
    start = left = math.nan
    # a dither of one amplitude first: it cannot bend where nothing is seen
    steady = np.zeros((3, parameters.size))
    steady[0, 0], steady[1, 1 : 1 + len(motion.splines)] = 1.0, 1.0
    steady[2, 1 + len(motion.splines) : 1 + 2 * len(motion.splines)] = 1.0
    for number in range(ROUNDS):
        rate = (parameters @ motion.rates)[motion.samples]
        turned = volts * np.exp(-1j * (parameters @ motion.phases)[motion.samples])
        rows = np.flatnonzero(inside & (np.abs(rate) * smooth * sample_interval > _BEATS))
        lost = not np.max(np.abs(rate)) * sample_interval < 1.0
        if lost or rows.size < 2 * parameters.size:
            return parameters, math.nan, math.inf
        phase = np.unwrap(np.angle(np.convolve(turned, weights, "same")[rows]))
        ways = steady if number < _STEADY_ROUNDS else np.eye(parameters.size)
        columns = np.column_stack([(ways @ motion.phases[:, motion.samples[rows]]).T, np.ones(rows.size)])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)  # a spline may have no sample there
        change = np.linalg.lstsq(columns / scale, phase, rcond=1e-9)[0] / scale
        left = float(np.std(phase - columns @ change))
        parameters, start = parameters + change[:-1] @ ways, float(change[-1])
        if number >= _STEADY_ROUNDS and np.std(phase) < 2 * left:
            break
    return parameters, start + math.pi / 2, left


def _fitted(volts: Floats, motion: _Motion, parameters: Floats, start: float, dither: float) -> _Record:
    """Fit the samples: with light and receiver that follow at once first, then with those of (2)."""
    count, size = volts.size, parameters.size
    begin = [volts.mean(), math.sqrt(2) * volts.std(), start, *parameters, *np.zeros(7), _GAIN_CORNER]
    values, left, _ = _descended(np.array(begin), len(begin) - 4, volts, motion, 0.0)
    values, left, covariance = _descended(values, len(begin), volts, motion, float(left.std()) / _GAIN_CORNER_U)
    noise = math.sqrt(float(left[:count] @ left[:count]) / (count - values.size))
    if noise > FOLLOWED * abs(values[1]):
        return _Record.failed(DitherFlag.NOT_FOLLOWED)
    whole = count * motion.step * FINER * dither >= _PERIODS_TO_SEE
    return _Record(
        complex(*values[-8:-6]),
        noise**2 * covariance[-8:-6, -8:-6],
        motion.amplitude(values[3 : 3 + size]) if whole else math.nan,
        dither,
        noise,
        DitherFlag(0) if _is_white(left[:count]) else DitherFlag.MISFIT,
    )


def _descended(
    values: Floats, free: int, volts: Floats, motion: _Motion, bound: float
) -> tuple[Floats, Floats, Floats]:
    """Levenberg and Marquardt with the first `free` parameters: values, residuals, covariance for noise 1."""
    left, columns = _left(values, volts, motion, bound)
    damping = 1e-6
    for _ in range(_DESCENTS):
        scale = np.maximum(np.linalg.norm(columns[:, :free], axis=0), 1e-300)
        u, singular, vt = np.linalg.svd(columns[:, :free] / scale, full_matrices=False)
        along, cost = u.T @ left, float(left @ left)
        if float(np.max(np.abs(along))) < 1e-3 * math.sqrt(cost / left.size):
            break
        while damping < 1.0:
            trial = values.copy()
            trial[:free] += vt.T @ (along * singular / (singular**2 + damping)) / scale
            with np.errstate(over="ignore", invalid="ignore"):  # a trial may be far from anything
                trial_left, trial_columns = _left(trial, volts, motion, bound)
                better = bool(trial_left @ trial_left < cost)
            if better:
                break
            damping *= 30.0
        else:
            break
        values, left, columns, damping = trial, trial_left, trial_columns, max(damping / 100, 1e-14)
    return values, left, (vt.T / np.maximum(singular, 1e-9) ** 2) @ vt / np.outer(scale, scale)


def _left(values: Floats, volts: Floats, motion: _Motion, bound: float) -> tuple[Floats, Floats]:
    """What (2) leaves of the samples, and its derivatives; in the last row g beside its bound."""
    at, moved = motion.samples, values[3:-8]
    z, second, follows = (complex(*pair) for pair in values[-8:-2].reshape(3, 2))
    offset, amplitude, start, pole, corner = (
        *values[:3],
        values[-2],
        min(max(values[-1], _CORNERS[0]), _CORNERS[1]),
    )
    free = moved @ motion.phases + start
    phase = free
    for _ in range(_PICARD):
        fringe = np.exp(1j * phase)
        walk = motion.integral(fringe)
        before, phase = phase, free - (z * walk).imag
        if not np.max(np.abs(phase - before)) > _SETTLED:
            break
    rate = (moved @ motion.rates)[at]
    place = (rate / np.max(np.abs(rate))) ** 2
    gain = 1 / np.sqrt(np.maximum(1 + pole * place, _LEAST_GAIN))
    light = motion.decaying(fringe, math.exp(corner), 2 * np.pi * rate[0])
    later = motion.decaying(light, math.exp(corner), 2 * np.pi * rate[0])[at]
    lag = np.sign(rate) * np.sqrt(np.maximum(pole * place, 0.0))
    walk, phase, light = walk[at], phase[at] + lag - np.arctan(lag), light[at]
    sine, twice = amplitude * gain * np.sin(phase), second * np.exp(2j * phase)
    swing = 1 + (follows * light).real
    slope = amplitude * gain * swing * np.cos(phase) - 2 * twice.imag
    columns = np.zeros((volts.size + 1, values.size))
    columns[:-1, 0], columns[:-1, 1], columns[:-1, 2] = 1.0, gain * swing * np.sin(phase), slope
    columns[:-1, 3:-8] = (slope * motion.phases[:, at]).T
    columns[:-1, -8], columns[:-1, -7] = -slope * walk.imag, -slope * walk.real
    columns[:-1, -6], columns[:-1, -5] = np.cos(2 * phase), -np.sin(2 * phase)
    columns[:-1, -4], columns[:-1, -3] = sine * light.real, -sine * light.imag
    columns[:-1, -2] = 0.5 * place * (slope * lag / (1 + lag**2) - sine * swing * gain**2)
    columns[:-1, -1] = sine * (follows * (light - later)).real
    columns[-1, -1] = bound
    left = volts - offset - sine * swing - twice.real
    return np.append(left, bound * (_GAIN_CORNER - corner)), columns


def _is_white(left: Floats) -> bool:
    """Whether neighbouring residuals have nothing in common (Ljung and Box)."""
    count, power = left.size, float(left @ left)
    shares = np.array([float(left[lag:] @ left[:-lag]) / power for lag in range(1, _LAGS + 1)])
    chi_square = count * (count + 2) * float(np.sum(shares**2 / (count - np.arange(1, _LAGS + 1))))
    return float(scipy.special.chdtrc(_LAGS, chi_square)) > UNLIKELY
