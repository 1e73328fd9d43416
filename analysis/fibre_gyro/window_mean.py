"""Mean of the output words of a window, over whole turns or at rest, with some words missing or far off.

With every word there the mean is the sum over the number of words. With some missing, mean and the sine of the
horizontal earth rate are fitted to those that are there: their mean alone would hold a part of the sine.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Complexes, Floats
from analysis.fibre_gyro.scatter import outliers

_TURNS_FOR_SCATTER = 8
_BLOCKS = 12  # of a window with fewer turns
_FEWEST_BLOCKS = 4
_RARE = 1e-3
_MOST_MISSING = 0.2  # of the words of a window


@dataclass(frozen=True)
class WindowMean:
    """Sum and mean of the output words of one window."""

    total: float  # counts; where words are missing the sum is that of all, with the missing ones as fitted
    mean: float
    mean_u: float  # standard uncertainty of the mean, counts, from the scatter of the block means
    samples: int  # whole samples that the window spans; it may hold a part of one more
    duration_s: float
    turns: int  # whole turns in the window; 0 for a window that is no whole turns
    missing: int = 0  # words that are not there, and words that were left out since they lie far off all others
    outliers: int = 0
    freedom: int = 0  # degrees of freedom of the uncertainty
    worst: float = 0.0  # largest distance of an outlier from the mean, counts
    # once-per-turn part c: the output holds Re[c exp(i angle)], angle the turn since the begin of the window
    sine: complex = 0j
    sine_u: float = float("nan")  # standard uncertainty of each of its two parts; nan without whole turns
    sine_freedom: int = 0  # degrees of freedom of that uncertainty


def mean_over_turns(
    counts: ArrayLike, sample_interval_s: float, rate_dps: float, *, turns: int, resolution: float = 0.0
) -> WindowMean:
    """Sum and mean of the output over the first `turns` whole turns of a record.

    The window ends within a sample, which counts with the part of it that lies inside: an output word is the mean
    over its sample interval.

    Parameters
    ----------
    counts : (n,)
        Output words at equal intervals; nan where one is missing.
    resolution : float, optional
        Smallest step of the output word, counts.

    Raises
    ------
    ValueError
        The record is too short, or too many words are missing.

    Examples
    --------
    One turn at 80 deg/s is 4.5 s: four words and half of the fifth.

    >>> mean_over_turns([1.0, 1.0, 1.0, 1.0, 10.0], 1.0, 80.0, turns=1).mean
    2.0
    """
    values = np.asarray(counts, dtype=np.float64)
    wanted = turns * turn_time(rate_dps)
    length = round(wanted / sample_interval_s, 6)
    if turns < 1 or length < 2 or length - values.size >= 1:
        raise ValueError(
            f"{turns} turns at {abs(rate_dps):g} deg/s take {wanted:.6g} s; the record has "
            f"{values.size * sample_interval_s:.6g} s: record longer or use fewer turns"
        )
    length = min(length, float(values.size))
    whole = int(length)
    part = length - whole
    words = values[: whole + (part > 0)]
    words, far = _without_outliers(words)
    weight = np.ones(words.size)
    if part > 0:
        weight[-1] = part
    wave = np.exp(2j * np.pi * turns * (np.arange(words.size) + 0.5) / length)
    gone = np.isnan(words)
    if gone.any():
        _refuse_too_many(gone)
        # as mean and once-per-turn sine of the others have them
        there = ~np.isnan(words)
        design = np.column_stack([np.ones(words.size), wave.real, wave.imag])
        root = np.sqrt(weight[there])
        level = float(words[there].mean())
        fitted, *_ = np.linalg.lstsq(
            design[there] * root[:, np.newaxis], (words[there] - level) * root, rcond=None
        )
        words = np.where(there, words, level + design @ fitted)
        total = float(words @ weight)
    else:
        total = float(words[:whole].sum()) + (part * float(words[whole]) if part > 0 else 0.0)
    mean = total / length
    sine, sine_u = _sine(words[:whole], wave[:whole], mean, turns)
    if turns >= _TURNS_FOR_SCATTER:
        # one block a turn: the sine of the horizontal earth rate does not count as scatter
        scatter, freedom = _scatter(words[:whole], turns, 0)
    else:
        scatter, freedom = _scatter(words[:whole] - (sine * wave[:whole]).real, _BLOCKS, 2)
    scatter *= float(np.sqrt(words.size / max(words.size - gone.sum(), 1)))
    missing = int(gone.sum()) - int(far.sum())
    worst = float(np.abs(values[: words.size][far] - mean).max()) if far.any() else 0.0
    u = _with_resolution(scatter, words[:whole], resolution)
    return WindowMean(
        total, mean, u, whole, length * sample_interval_s, turns, missing, int(far.sum()), freedom, worst,
        sine, *((sine_u, 2 * (turns - 1)) if np.isfinite(sine_u) else (float(np.sqrt(2.0)) * scatter, freedom)),
    )  # fmt: skip


def mean_at_rest(
    counts: ArrayLike, sample_interval_s: float, *, blocks: int = 20, resolution: float = 0.0
) -> WindowMean:
    """Sum and mean of a record that is no whole turns; parameters as :func:`mean_over_turns`."""
    values = np.asarray(counts, dtype=np.float64)
    if values.size < 2:
        raise ValueError(f"a mean with an uncertainty needs at least 2 samples, not {values.size}")
    words, far = _without_outliers(values)
    gone = np.isnan(words)
    if gone.any():
        _refuse_too_many(gone)
        words = np.where(gone, float(words[~gone].mean()), words)
    mean = float(words.mean())
    worst = float(np.abs(values[far] - mean).max()) if far.any() else 0.0
    scatter, freedom = _scatter(words, blocks, 0)
    scatter *= float(np.sqrt(words.size / (words.size - gone.sum())))
    u = _with_resolution(scatter, words, resolution)
    missing = int(gone.sum()) - int(far.sum())
    duration = values.size * sample_interval_s
    return WindowMean(
        float(words.sum()), mean, u, values.size, duration, 0, missing, int(far.sum()), freedom, worst
    )


def pooled_noise(means: Sequence[WindowMean]) -> Floats:
    """Standard uncertainty of each mean by the noise of all: each alone knows it badly, from a few blocks."""
    # One whose own noise is far beyond that of the others (once in a thousand times) keeps its own.
    u = np.array([one.mean_u for one in means], dtype=np.float64)
    duration = np.array([one.duration_s for one in means], dtype=np.float64)
    freedom = np.array([max(one.freedom, 1) for one in means], dtype=np.float64)
    density = float(np.median(u**2 * duration))
    limit = np.asarray(scipy.special.chdtri(freedom, _RARE), dtype=np.float64) / freedom
    alike = np.ones(u.size, dtype=np.bool_)
    for _ in range(3):
        alike = u**2 * duration <= density * limit
        if alike.any():
            density = float(np.sum((freedom * u**2 * duration)[alike]) / np.sum(freedom[alike]))
    return np.where(alike, np.sqrt(density / duration), u)


def noise_of_means(means: Sequence[WindowMean], expected_u: ArrayLike | None = None) -> tuple[Floats, bool]:
    """Standard uncertainty of each mean by the noise within the windows: by a noise model, or as it is."""
    floor = np.array([1e-12 * abs(one.mean) + 1e-12 for one in means])
    seen = np.maximum(pooled_noise(means), floor)
    if expected_u is None:
        return seen, False
    expected = np.maximum(np.asarray(expected_u, dtype=np.float64), floor)
    freedom = float(sum(max(one.freedom, 1) for one in means))
    if float(np.mean((seen / expected) ** 2)) > float(scipy.special.chdtri(freedom, _RARE)) / freedom:
        return seen, False
    return expected, True


def _without_outliers(values: Floats) -> tuple[Floats, Bools]:
    far = outliers(values)
    return (np.where(far, np.nan, values) if far.any() else values), far


def _refuse_too_many(gone: Bools) -> None:
    missing = int(gone.sum())
    if missing > _MOST_MISSING * gone.size or missing > gone.size - 2:
        raise ValueError(f"{missing} of {gone.size} output words are missing")


def _sine(words: Floats, wave: Complexes, mean: float, turns: int) -> tuple[complex, float]:
    """Once-per-turn part, and the standard uncertainty of each of its parts from its scatter over the turns."""
    products = 2 * np.conj(wave) * (words - mean)
    if turns < _TURNS_FOR_SCATTER or words.size < 4 * turns:
        return complex(products.mean()), float("nan")
    edges = np.linspace(0, words.size, turns + 1).round().astype(np.intp)
    each = np.add.reduceat(products, edges[:-1]) / np.diff(edges)
    variance = float(np.mean(np.abs(each - each.mean()) ** 2)) * turns / (turns - 1) / 2
    return complex(products.mean()), float(np.sqrt(variance / turns))


def _scatter(words: Floats, blocks: int, taken: int) -> tuple[float, int]:
    """Standard deviation of the mean, from so many block means; `taken` degrees of freedom are used up already."""
    blocks = min(blocks, words.size // 2)
    if blocks - taken < _FEWEST_BLOCKS:
        return float(np.std(words, ddof=1)) / np.sqrt(words.size), words.size - 1
    edges = np.linspace(0, words.size, blocks + 1).round().astype(np.intp)
    means = np.add.reduceat(words - words.mean(), edges[:-1]) / np.diff(edges)
    freedom = blocks - 1 - taken
    variance = float(np.sum((means - means.mean()) ** 2)) / freedom
    return float(np.sqrt(variance / blocks)), freedom


def _with_resolution(scatter: float, words: Floats, resolution: float) -> float:
    # a word that hardly moves has a rounding error that does not average out
    stuck = float(np.std(words)) < 0.3 * resolution
    return float(np.hypot(scatter, resolution / np.sqrt(12.0) if stuck else 0.0))


# --------------------
# Windows of whole turns of the rate table: the horizontal earth rate averages out.
#
# A gyro whose axis is not exactly along the vertical table axis sees the horizontal earth rate as a sine of one
# period a turn. Over a whole number of turns its mean is zero; over 30.15 turns it is not. A window of fixed
# length is whole turns at one rate only, so every rate has a window of its own: M 360/Omega


def turn_time(rate_dps: float) -> float:
    """Time of one turn of the table in s, either sense.

    Raises
    ------
    ValueError
        The table does not turn.

    Examples
    --------
    >>> turn_time(-20.0)
    18.0
    """
    if not abs(rate_dps) > 0 or not np.isfinite(rate_dps):
        raise ValueError(f"a table at {rate_dps:g} deg/s makes no turns: give a rate other than zero")
    return 360.0 / abs(rate_dps)


def whole_turns_in(duration_s: float, rate_dps: float, *, tolerance_s: float = 0.0) -> int:
    """Largest number of whole turns that fits into a record of `duration_s`.

    Parameters
    ----------
    tolerance_s : float, optional
        So much may be missing at the end: usually one sample interval.

    Raises
    ------
    ValueError
        Not one turn fits.

    Examples
    --------
    >>> whole_turns_in(540.0, 20.0), whole_turns_in(540.0, 21.0)
    (30, 31)
    """
    turn = turn_time(rate_dps)
    turns = int(np.floor((duration_s + tolerance_s) / turn * (1 + 1e-12)))
    if turns < 1:
        raise ValueError(
            f"{duration_s:.6g} s at {abs(rate_dps):g} deg/s is {duration_s / turn:.3f} of a turn: "
            f"record at least {turn:.6g} s"
        )
    return turns


def check_whole_turns(duration_s: float, rate_dps: float, *, tolerance_s: float) -> int:
    """Number of turns of a window that was chosen by its length; refuses one that is not whole turns.

    Parameters
    ----------
    tolerance_s : float
        A window may be off by so much: usually one sample interval.

    Raises
    ------
    ValueError
        With the two windows that are whole turns.

    Examples
    --------
    >>> check_whole_turns(540.0, 20.0, tolerance_s=0.01)
    30
    """
    turn = turn_time(rate_dps)
    turns = round(duration_s / turn)
    if turns >= 1 and abs(duration_s - turns * turn) <= tolerance_s * (1 + 1e-9):
        return turns
    below = int(duration_s / turn)
    choices = [f"{count} turns = {count * turn:.3f} s" for count in (below, below + 1) if count >= 1]
    raise ValueError(
        f"a window of {duration_s:.6g} s at {abs(rate_dps):g} deg/s is {duration_s / turn:.3f} turns, not a whole "
        f"number: use {' or '.join(choices)}"
    )


@dataclass(frozen=True)
class TurnOfTable:
    """Whole turns of a table at a steady rate, as its encoder saw them."""

    first: int  # row with which they begin
    end: int  # behind the row in which they end
    turns: int
    rate_dps: float  # signed mean over them


_MARKS = 12  # of the angle in one turn
_SMOOTHED = 400  # parts of a log that are taken together: the steps of the encoder do not matter
_FEWEST_ROWS = 16
_UNSTEADY = 20.0, 3e-4  # small changes of the time of a turn, and share of it, that a steady table keeps within


def turn_by_encoder(times_s: ArrayLike, angle_deg: ArrayLike, rate_dps: float) -> TurnOfTable:
    """Whole turns in the longest stretch in which a table turns steadily, by its encoder.

    Parameters
    ----------
    times_s, angle_deg : (n,)
        Rows of a log; the angle may begin again at any multiple of 360 deg.
    rate_dps : float
        Signed rate, roughly: between two rows the table turns by less than half a turn more or less.

    Raises
    ------
    ValueError
        Too few rows, too fast a table, or not one whole turn.

    Examples
    --------
    >>> times = np.arange(1000) * 0.1
    >>> turn = turn_by_encoder(times, np.minimum(times, 80.0) * 10.001 % 360, 10.0)
    >>> turn.turns, round(turn.rate_dps, 6)
    (2, 10.001)
    """
    times, angle = np.asarray(times_s, dtype=np.float64), np.asarray(angle_deg, dtype=np.float64)
    if times.size < _FEWEST_ROWS or not np.all(np.isfinite(angle)):
        raise ValueError(f"{np.isfinite(angle).sum()} rows of the table's angle are too few to tell its rate")
    if abs(rate_dps) * float(np.median(np.diff(times))) > 170.0:
        raise ValueError("the table makes half a turn or more between two rows: its angle does not tell its rate")
    ahead = np.unwrap(angle - rate_dps * times, period=360.0)
    mean = np.ones(2 * (times.size // (2 * _SMOOTHED)) + 1)
    at = np.convolve(times, mean / mean.size, "valid")
    turned = np.convolve(ahead, mean / mean.size, "valid") + rate_dps * at
    sense = 1.0 if turned[-1] > turned[0] else -1.0
    turned = np.maximum.accumulate(sense * (turned - turned[0]))
    marks = np.interp(np.arange(0.0, turned[-1] * (1 + 1e-12), 360.0 / _MARKS), turned, at)
    # A ripple, and an encoder that sits off its axis, return with each turn: the time of a turn is free of them.
    of_turn = marks[_MARKS:] - marks[:-_MARKS]
    if not of_turn.size:
        raise ValueError(f"the table turns by {turned[-1]:.1f} deg by its encoder: record a whole turn")
    ordered, quarter = np.sort(of_turn), (of_turn.size + 3) // 4
    densest = int((ordered[quarter - 1 :] - ordered[: ordered.size - quarter + 1]).argmin())
    usual = float(np.median(ordered[densest : densest + quarter]))
    changes = np.abs(np.diff(of_turn, append=of_turn[-1]))
    unsteady = np.abs(of_turn - usual) > max(
        _UNSTEADY[0] * float(np.quantile(changes, 0.25)), _UNSTEADY[1] * usual
    )
    bounds = np.concatenate([[-1], np.flatnonzero(unsteady), [of_turn.size]])
    longest = int(np.diff(bounds).argmax())
    turns, spare = divmod(int(bounds[longest + 1] - bounds[longest]) - 2 + _MARKS, _MARKS)
    begin = int(bounds[longest]) + 1 + spare // 2
    start_s, stop_s = float(marks[begin]), float(marks[begin + turns * _MARKS])
    first, end = (int(row) for row in np.searchsorted(times, (start_s, stop_s)))
    return TurnOfTable(first, min(end + 1, times.size), turns, sense * 360.0 * turns / (stop_s - start_s))
