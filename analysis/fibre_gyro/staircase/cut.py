"""Where the steps of a staircase stand in a record.

Nothing is assumed here about the heights: a record is cut into equal times, and the cut that leaves the least
scatter within the pieces is the right one. So resets, and a bias square wave on top, do not disturb it.

Positions are in samples; sample i stands for the time from i - 1/2 to i + 1/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Ints
from analysis.fibre_gyro.staircase.rounded_fit import converter_spacing

MINIMUM_PERIOD = 3.0
"""Samples per step; with fewer no sample is surely free of an edge."""

MINIMUM_STEPS = 8
CANDIDATES = 4
_FINALISTS = 3
HARMONICS = 6
_PADDING = 8
_WIDTH = 0.02  # relative half width of the search around a step time that the caller knows


@dataclass(frozen=True)
class Cut:
    """Edges at ``start + k period``, in samples, for all whole k."""

    period: float
    start: float

    def index(self, positions: Floats) -> Ints:
        """Number of the level on which each position lies."""
        return np.floor((positions - self.start) / self.period).astype(np.int64)


def find_cut(volts: Floats, period: float | None) -> Cut:
    """The cut of a record that fits its edges."""
    filled = _filled(volts)
    n = len(filled)
    if period is not None:
        check_period(period, n)
        return _fine_cut(filled, _coarse_cut(filled, period, _WIDTH * period))
    floor = rounding_variance(filled)

    def criterion(cut: Cut) -> float:
        """Schwarz's: more pieces must pay for themselves."""
        return float(n * np.log(_scatter(filled, cut) + floor) + n / cut.period * np.log(n))

    cuts = sorted((_coarse_cut(filled, one, one**2 / n) for one in _candidates(filled)), key=criterion)
    return _without_false_edges(filled, min((_fine_cut(filled, cut) for cut in cuts[:_FINALISTS]), key=criterion))


def check_period(period: float, n: int) -> None:
    """Refuse a step time that a record of `n` samples cannot show. Raises ValueError."""
    if period < MINIMUM_PERIOD:
        raise ValueError(
            f"a step lasts only {period:.3g} samples, {MINIMUM_PERIOD:g} are the least: use a faster time base"
        )
    if n / period < MINIMUM_STEPS:
        raise ValueError(
            f"the record holds only {n / period:.3g} steps, {MINIMUM_STEPS} are the least: use a slower time base"
        )


def piece_means(volts: Floats, number: Ints, usable: Bools) -> tuple[Ints, Floats, Floats]:
    """Numbers, sample counts and mean heights of the pieces, from the samples that may be used."""
    numbers, place = np.unique(number[usable], return_inverse=True)
    counts = np.bincount(place).astype(np.float64)
    return numbers, counts, np.bincount(place, weights=volts[usable]) / counts


# ---------------------------------------------------------------------- period


def _filled(volts: Floats) -> Floats:
    """Missing samples replaced by the one before."""
    good = np.isfinite(volts)
    if good.all():
        return volts
    last = np.maximum.accumulate(np.where(good, np.arange(len(volts)), 0))
    return np.asarray(np.where(np.isfinite(volts[last]), volts[last], np.nanmedian(volts)))


def rounding_variance(volts: Floats) -> float:
    """Variance below which no fit can be better: that of rounding, else next to nothing."""
    spacing = converter_spacing(volts)
    return max(spacing, 1e-6 * float(np.nanmax(volts) - np.nanmin(volts)), 1e-150) ** 2 / 12


def _candidates(volts: Floats) -> list[float]:
    """Periods at which changes of the signal repeat, the most likely first."""
    change = np.abs(np.diff(volts))
    # Logarithm: a reset is a hundred times a step, and there are few of them.
    scale = max(float(np.mean(np.minimum(change, np.quantile(change, 0.9)))), 1e-12 * float(change.max()), 1e-300)
    activity = np.log1p(change / scale)
    activity -= activity.mean()
    size = _PADDING * len(volts)
    spectrum = np.abs(np.fft.rfft(activity, size))
    bins = np.arange(int(MINIMUM_STEPS * _PADDING * 0.8), int(size / MINIMUM_PERIOD * 1.02))
    score = np.zeros(len(bins))
    for m in range(1, HARMONICS + 1):
        inside = m * bins < len(spectrum)
        # Harmonics above half the sampling rate do not count against a fast staircase.
        score[inside] += spectrum[m * bins[inside]]
    score /= np.sqrt(np.minimum(HARMONICS, (len(spectrum) - 1) // bins))
    found: list[float] = []
    for best in np.argsort(score)[::-1]:
        period = size / bins[best]
        if all(abs(period / other - 1) > 1.5 * period / len(volts) for other in found):
            found.append(float(period))
        if len(found) == CANDIDATES:
            break
    longest = len(volts) / MINIMUM_STEPS
    related = [period * m for period in found for m in (2, 3)] + [period / 2 for period in found]
    for period in related:
        is_new = all(abs(period / other - 1) > 0.5 * period / len(volts) for other in found)
        if is_new and MINIMUM_PERIOD <= period <= longest:
            found.append(period)
    return found


def _scatter(volts: Floats, cut: Cut) -> float:
    """Variance about the pieces of a cut, of the nine tenths of samples that lie nearest.

    The rest may hold samples on the wrong side of an edge, each of which would outweigh all others.
    """
    number = cut.index(np.arange(len(volts), dtype=np.float64))
    numbers, _, heights = piece_means(volts, number, np.ones(len(volts), bool))
    squares = (volts - heights[np.searchsorted(numbers, number)]) ** 2
    return float(np.mean(np.sort(squares)[: int(0.9 * len(squares))]))


def _coarse_cut(volts: Floats, period: float, half_width: float) -> Cut:
    """The cut with the least scatter within its pieces, on a coarse grid of periods and starts."""
    n, sums = len(volts), _sums(volts)
    pitch = _pitch(period)
    step = pitch / 2 * period / n  # so that the last edge moves by half a pitch
    periods = np.arange(max(period - half_width, 0.98 * MINIMUM_PERIOD), period + half_width, step)
    tried = [_best_start(sums, n, trial, np.arange(0.0, trial, pitch)) for trial in periods]
    return Cut(*max(tried)[1:])


def _fine_cut(volts: Floats, cut: Cut) -> Cut:
    """The best cut near another: one sample on the wrong side of a reset outweighs all noise."""
    n, sums = len(volts), _sums(volts)
    pitch = _pitch(cut.period)
    step = pitch / 2 * cut.period / n
    best = (-np.inf, cut.period, cut.start)
    for _ in range(3):
        _, period, start = best
        middle = n // (2 * period)
        for trial in period + np.linspace(-1, 1, 17) * step:
            # Turn about the middle of the record, so that period and start hardly depend on each other.
            starts = start + middle * (period - trial) + np.linspace(-1, 1, 17) * pitch
            best = max(best, _best_start(sums, n, trial, starts))
        step, pitch = step / 4, pitch / 4
    return Cut(*best[1:])


def _pitch(period: float) -> float:
    """Distance of the starts on the coarse grid."""
    return max(0.5, period / 64)


def _sums(volts: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(volts - volts.mean())])


def _best_start(sums: Floats, n: int, period: float, starts: Floats) -> tuple[float, float, float]:
    """Sum of squares that the best of some starts explains; period; that start."""
    explained = _explained(sums, n, period, starts)
    # Many starts between two samples are equally good; the middle of them is the best guess.
    equal = np.flatnonzero(explained >= explained.max() * (1 - 1e-12))
    return float(explained.max()), float(period), float(starts[equal[len(equal) // 2]])


def _explained(sums: Floats, n: int, period: float, starts: Floats) -> Floats:
    """Sum of squares between the pieces, for each start; (S,)."""
    numbers = np.arange(-1, int(n / period) + 3)
    edges = np.clip(np.ceil(starts[:, np.newaxis] + period * numbers), 0, n).astype(np.int64)
    pieces = np.diff(sums[edges], axis=-1)
    lengths = np.diff(edges, axis=-1)
    return np.asarray(np.sum(pieces**2 / np.maximum(lengths, 1), axis=-1))


def _without_false_edges(volts: Floats, cut: Cut) -> Cut:
    """A slow settling looks like further edges: take out those whose jumps only follow the jumps before them."""
    for parts in (6, 5, 4, 3, 2):
        if len(volts) / (parts * cut.period) >= MINIMUM_STEPS:
            true = _true_edges(*_jumps(volts, cut), parts)
            if true is not None:
                return Cut(cut.period * parts, cut.start + true * cut.period)
    return cut


def _jumps(volts: Floats, cut: Cut) -> tuple[Ints, Floats, float]:
    """Number of each edge, the jump there, and its noise."""
    number = cut.index(np.arange(len(volts), dtype=np.float64))
    numbers, counts, heights = piece_means(volts, number, np.ones(len(volts), bool))
    residual = volts - heights[np.searchsorted(numbers, number)]
    noise = 1.5 * float(np.median(np.abs(residual))) * np.sqrt(2 / float(np.median(counts)))
    return numbers[1:], np.diff(heights), max(noise, float(np.sqrt(rounding_variance(volts))))


def _true_edges(edges: Ints, jumps: Floats, noise: float, parts: int) -> int | None:
    """Which of `parts` interleaved sets of edges holds all real ones, None if none does."""
    size = [float(np.median(np.abs(jumps[edges % parts == part]))) for part in range(parts)]
    true = int(np.argmax(size))
    rest = max(size[:true] + size[true + 1 :])
    largest = float(np.abs(jumps[edges % parts == true]).max())
    others = edges % parts != true
    if size[true] < 4 * rest or np.abs(jumps[others]).max() > 0.3 * largest:
        return None
    # A false jump is the same part of the real one before it each time, and of the one behind it if a sample of
    # that lies on the wrong side; a step with a bias on top is not.
    for later in range(1, parts):
        here = np.flatnonzero(edges % parts == (true + later) % parts)
        here = here[(here >= later) & (here + parts - later < len(jumps))]
        false = jumps[here]
        real = np.stack([jumps[here - later], jumps[here + parts - later]], axis=-1)
        shares = np.linalg.lstsq(real, false, rcond=None)[0]
        if shares[1] < 0:  # no sample on the wrong side does that, but resets at even intervals can
            shares = np.array([np.sum(real[:, 0] * false) / np.sum(real[:, 0] ** 2), 0.0])
        left = false - real @ shares
        if np.mean(left**2) > 0.25 * np.mean(false**2) + (3 * noise) ** 2:
            return None
    return true
