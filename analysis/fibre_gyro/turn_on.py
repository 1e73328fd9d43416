"""How the output settles after switching on, and how well the bias comes back from one switching on to the next.

    B(t) = B_end + sum_i A_i exp(-t/tau_i)          no, one or two exponentials                            (a)

The warm-up time is that after which B(t) stays within a bound of B_end. The time constants are laid over a grid,
up to half the record: what is slower is not told from a drift. For each the rest is linear. What the data allow of
models and time constants is weighed with its likelihood, and values are drawn from it: so a transient that has not
ended within the record gives a wide interval, and one that hides in the noise an interval that begins at zero.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Floats

_TIME_CONSTANTS, _OF_TWO = 40, 16
_LEVELS = 6
_LIKELY = 12.0
_TIMES = 300
_SLOWEST, _SLOW = 0.5, 0.4  # of the record
_DRAWS = 4000
_SEED = 20_160_952


@dataclass(frozen=True)
class TurnOn:
    """Transient after switching on."""

    exponentials: int  # in the likeliest model
    final: float  # B_end, unit of the values; with its uncertainty
    final_u: float
    transient: float  # B(0) - B_end
    transient_u: float
    transient_low_95: float
    transient_high_95: float
    time_constants_s: tuple[float, ...]  # of the likeliest model
    bound: float  # that the warm-up time is for; unit of the values
    warm_up_s: float  # 0: within the bound from the begin on. Infinite: the record does not show its end.
    warm_up_low_95_s: float
    warm_up_high_95_s: float
    ends: bool  # whether the transient ends within the record, for all that it shows
    noise_u: float  # of one value
    at_s: Floats  # (n,): what was fitted, and the likeliest model, which ends at `curve_end`
    values: Floats
    curve: Floats
    curve_end: float


def turn_on_transient(at_s: ArrayLike, values: ArrayLike, bound: float) -> TurnOn:
    """Fit the transient.

    Parameters
    ----------
    at_s : (n,)
        Middle of each value after switching on, s; rising, at equal distances.
    values : (n,)
        Means of the output over equal times; nan where there is none.
    bound : float
        In the unit of the values, positive.

    Raises
    ------
    ValueError
        Fewer than 12 values, or a bound that is not positive.

    Examples
    --------
    5 exp(-t/100) is within 0.5 after 100 ln 10 = 230 s.

    >>> t = np.arange(5.0, 1000.0, 10.0)
    >>> noise = np.random.default_rng(1).normal(0, 0.05, t.size)
    >>> found = turn_on_transient(t, 5 * np.exp(-t / 100) + noise, 0.5)
    >>> found.exponentials, bool(abs(found.warm_up_s - 230.3) < 10)
    (1, True)
    """
    when, value = np.asarray(at_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    there = np.isfinite(value)
    when, value = when[there], value[there]
    if value.size < 12:
        raise ValueError(f"a transient needs 12 values in time, not {value.size}: record longer")
    if not bound > 0:
        raise ValueError(f"the bound of the warm-up must be positive, not {bound:g}")
    end = float(when[-1])
    range_s = float(np.diff(when).min()), _SLOWEST * end
    grids = [_refined_grid(when, value, count, range_s) for count in range(3)]
    scatter = float(np.sum((value - value.mean()) ** 2))
    alike = _alike(min(grids, key=lambda one: float(one.square.min())), when, value)
    best_square = min(float(one.square.min()) for one in grids)
    scores = [_log_weight(one, value.size / alike, best_square, scatter, grids[0]) for one in grids]
    largest = max(float(one.max()) for one in scores)
    weights = [np.exp(one - largest) for one in scores]
    total = sum(float(one.sum()) for one in weights)
    rng = np.random.default_rng(_SEED)
    drawn = rng.multinomial(_DRAWS, [float(one.sum()) / total for one in weights])
    final, transient, warm_up, slow = [], [], [], 0.0
    for grid, weight, count in zip(grids, weights, drawn, strict=True):
        if count == 0:
            continue  # where the noise is next to nothing, all its weights are
        places = rng.choice(weight.size, count, p=weight / weight.sum())
        # amplitudes that the data allow there: Student's t about the fitted ones
        size = 1 + grid.taus.shape[1]
        freedom = max((value.size - 2 * size + 1) / alike, 1.0)
        scale = np.sqrt(grid.square[places] / rng.chisquare(freedom, places.size))
        normal = rng.standard_normal((places.size, size))
        spread = np.einsum("mij,mj->mi", grid.root[places], normal)
        amplitudes = np.asarray(grid.amplitudes[places] + scale[:, np.newaxis] * spread, dtype=np.float64)
        final.append(amplitudes[:, 0])
        transient.append(amplitudes[:, 1:].sum(axis=1))
        warm_up.append(_last_outside(amplitudes[:, 1:], grid.taus[places], bound, 20 * end))
        slow += float(weight[grid.taus.max(axis=1, initial=0.0) > _SLOW * end].sum()) / total
    finals, transients = np.concatenate(final), np.concatenate(transient)
    low, middle, high = (float(v) for v in np.quantile(np.concatenate(warm_up), (0.025, 0.5, 0.975)))
    ends = high < end and slow < 0.5
    best = grids[int(np.argmax([float(one.sum()) for one in weights]))]
    place = int(np.argmin(best.square))
    return TurnOn(
        exponentials=best.taus.shape[1],
        final=float(np.mean(finals)),
        final_u=float(np.std(finals)),
        transient=float(np.mean(transients)),
        transient_u=float(np.std(transients)),
        transient_low_95=float(np.quantile(transients, 0.025)),
        transient_high_95=float(np.quantile(transients, 0.975)),
        time_constants_s=tuple(best.taus[place].tolist()),
        bound=bound,
        warm_up_s=middle,
        warm_up_low_95_s=low,
        warm_up_high_95_s=high if ends else math.inf,
        ends=ends,
        noise_u=math.sqrt(float(best.square[place]) / (value.size - 1 - 2 * best.taus.shape[1])),
        at_s=when,
        values=value,
        curve=best.curve(place, when),
        curve_end=float(best.amplitudes[place, 0]),
    )


@dataclass(frozen=True)
class _Grid:
    """Linear fits for time constants on a grid."""

    taus: Floats  # (m, k)
    amplitudes: Floats  # (m, 1 + k): B_end, A_1, ..
    root: Floats  # (m, 1 + k, 1 + k): Square root of the covariance of the amplitudes, for noise of one
    square: Floats  # (m,): Sum of squares that is left
    share: float  # of the whole range of time constants, in the logarithm, that one point stands for

    def curve(self, place: int, when: Floats) -> Floats:
        """Model of one point of the grid."""
        return np.asarray(
            _designs(when, self.taus[place : place + 1])[0] @ self.amplitudes[place], dtype=np.float64
        )


def _designs(when: Floats, taus: Floats) -> Floats:
    """Columns 1, exp(-t/tau_1), ... as means over the times of the values, for each row of time constants."""
    half = float(np.diff(when).min()) / 2
    decays = np.exp(-when[np.newaxis, :, np.newaxis] / taus[:, np.newaxis, :])
    decays = decays * (np.sinh(half / taus) / (half / taus))[:, np.newaxis, :]
    return np.concatenate([np.ones((taus.shape[0], when.size, 1)), decays], axis=2)


def _refined_grid(when: Floats, value: Floats, count: int, range_s: tuple[float, float]) -> _Grid:
    """Fit on a grid of `count` time constants that is made finer where the data put them."""
    low, high = (np.full(count, math.log(one)) for one in range_s)
    whole = (high - low)[:1].prod() ** count
    points = {0: 1, 1: _TIME_CONSTANTS, 2: _OF_TWO}[count]
    for level in range(_LEVELS):
        step = (high - low) / points
        axes = [first + one * (np.arange(points) + 0.5) for first, one in zip(low, step, strict=True)]
        logs = (
            np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, count) if count else np.zeros((1, 0))
        )
        if count == 2:
            logs = logs[logs[:, 1] > logs[:, 0] + math.log(2)]
        taus = np.exp(logs)
        share = float(step.prod()) / whole
        designs = _designs(when, taus)
        q, r = np.linalg.qr(designs)
        root = np.linalg.inv(r)
        amplitudes = np.einsum("mij,mnj,n->mi", root, q, value)
        left = value - np.einsum("mni,mi->mn", designs, amplitudes)
        grid = _Grid(taus, amplitudes, root, np.maximum(np.sum(left**2, axis=1), 1e-300), share)
        likely = value.size / 2 * np.log(grid.square / grid.square.min()) < _LIKELY
        kept = logs[likely]
        new = np.maximum(kept.min(axis=0) - step, low), np.minimum(kept.max(axis=0) + step, high)
        if level == _LEVELS - 1 or np.all(new[1] - new[0] > 0.7 * (high - low)):
            break
        low, high = new
    return grid


def _alike(best: _Grid, when: Floats, value: Floats) -> float:
    """How many values count as one, since neighbours lie off together (noise with a memory of one value)."""
    left = value - best.curve(int(np.argmin(best.square)), when)
    together = float(left[1:] @ left[:-1]) / max(float(left @ left), 1e-300)
    together = min(together, 0.9) if together > 2 / math.sqrt(left.size) else 0.0
    return (1 + together) / (1 - together)


def _log_weight(grid: _Grid, count: float, best_square: float, scatter: float, constant: _Grid) -> Floats:
    """Ln of the probability of each point: even over the range of time constants, amplitudes up to the scatter."""
    exponentials = grid.taus.shape[1]
    noise, widest = best_square / count, 4 * math.sqrt(max(scatter, best_square) / count)
    # the amplitudes are integrated over, against a prior as wide as the values spread
    volume = np.linalg.slogdet(grid.root)[1] - np.linalg.slogdet(constant.root)[1]
    occam = volume + exponentials * (0.5 * math.log(2 * math.pi * noise) - math.log(2 * widest))
    return np.asarray(-(count - 1) / 2 * np.log(grid.square) + occam + math.log(grid.share), dtype=np.float64)


def _last_outside(amplitudes: Floats, taus: Floats, bound: float, longest: float) -> Floats:
    """Last time at which each transient is beyond the bound; 0 if never."""
    if taus.shape[1] == 0:
        return np.zeros(amplitudes.shape[0])
    if taus.shape[1] == 1:
        return np.asarray(taus[:, 0] * np.log(np.maximum(np.abs(amplitudes[:, 0]) / bound, 1.0)), dtype=np.float64)
    times = np.concatenate([[0.0], np.geomspace(1e-3 * longest, longest, _TIMES)])
    deviation = np.abs(np.einsum("mk,mkt->mt", amplitudes, np.exp(-times / taus[:, :, np.newaxis])))
    outside = deviation > bound
    last = np.minimum(times.size - 2, times.size - 1 - np.argmax(outside[:, ::-1], axis=1))
    rows = np.arange(last.size)
    # between two times the deviation dies away like an exponential
    before, after = deviation[rows, last], np.maximum(deviation[rows, last + 1], 1e-300)
    part = np.log(np.maximum(before / bound, 1.0)) / np.maximum(np.log(np.maximum(before / after, 1.0)), 1e-12)
    crossing = times[last] + np.clip(part, 0, 1) * (times[last + 1] - times[last])
    return np.where(outside.any(axis=1), crossing, 0.0)


@dataclass(frozen=True)
class Repeatability:
    """Standard deviation from one switching on to the next."""

    value: float  # standard deviation of the values as they are, Q - 1 in the denominator
    low_95: float  # interval of what is left of it without the noise of each value; 0 where that alone may be all
    high_95: float
    noise_u: float  # mean noise of a value
    count: int


def repeatability(values: ArrayLike, values_u: ArrayLike, perhaps_u: float = 0.0) -> Repeatability:
    """Repeatability of a quantity over several switchings on, with its interval.

    Parameters
    ----------
    values, values_u : (q,)
        And the standard uncertainty of each by its noise, as if all had the mean of their variances.
    perhaps_u : float, optional
        A further one that may scatter from value to value or not: it makes the interval begin lower.

    Raises
    ------
    ValueError
        Fewer than two values.

    Examples
    --------
    >>> found = repeatability([1.0, 2.0, 3.0], [0.0, 0.0, 0.0])
    >>> found.value, round(found.low_95, 3), round(found.high_95, 2)
    (1.0, 0.521, 6.28)
    """
    value, u = np.asarray(values, dtype=np.float64), np.asarray(values_u, dtype=np.float64)
    if value.size < 2:
        raise ValueError("repeatability needs at least two switchings on")
    freedom = value.size - 1
    square = float(np.var(value, ddof=1))
    noise = float(np.mean(u**2))
    low, high = (
        max(freedom * square / float(scipy.special.chdtri(freedom, part)) - without, 0.0)
        for part, without in ((0.025, noise + perhaps_u**2), (0.975, noise))
    )
    return Repeatability(math.sqrt(square), math.sqrt(low), math.sqrt(high), math.sqrt(noise), value.size)
