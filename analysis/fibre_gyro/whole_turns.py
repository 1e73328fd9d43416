"""Mean output over whole turns of the rate table: the horizontal earth rate averages out.

A gyro whose axis is not exactly along the vertical table axis sees the horizontal earth rate as a sine of one
period a turn. Over a whole number of turns its mean is zero; over 30.15 turns it is not. A window of fixed
length is whole turns at one rate only, so every rate has a window of its own: M 360/Omega.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

_BLOCKS_FOR_SCATTER = 8


@dataclass(frozen=True)
class WindowMean:
    """Sum and mean of the output words of one window.

    Attributes
    ----------
    total, mean : float
        Counts.
    mean_u : float
        Standard uncertainty of the mean, counts, from the scatter of the block means.
    samples : int
        Whole samples; the window may hold a part of one more.
    turns : int
        Whole turns in the window; 0 for a window at rest.
    """

    total: float
    mean: float
    mean_u: float
    samples: int
    duration_s: float
    turns: int


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


def mean_over_turns(
    counts: ArrayLike, sample_interval_s: float, rate_dps: float, *, turns: int, resolution: float = 0.0
) -> WindowMean:
    """Sum and mean of the output over the first `turns` whole turns of a record.

    The window ends within a sample, which counts with the part of it that lies inside: an output word is the mean
    over its sample interval.

    Parameters
    ----------
    counts : (n,)
        Output words at equal intervals.
    resolution : float, optional
        Smallest step of the output word, counts.

    Raises
    ------
    ValueError
        The record is too short, or holds values that are not finite.

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
    # one block a turn: the sine of the horizontal earth rate does not count as scatter
    window = _window(values[:whole], sample_interval_s, turns if turns >= _BLOCKS_FOR_SCATTER else 0, resolution)
    if length > whole and not np.isfinite(values[whole]):
        raise ValueError("the last output word of the window is missing")
    total = window.total + (length - whole) * float(values[whole] if length > whole else 0.0)
    return replace(window, total=total, mean=total / length, duration_s=length * sample_interval_s, turns=turns)


def mean_at_rest(
    counts: ArrayLike, sample_interval_s: float, *, blocks: int = 20, resolution: float = 0.0
) -> WindowMean:
    """Sum and mean of a record at rest; parameters as :func:`mean_over_turns`.

    Parameters
    ----------
    counts : (n,)
    blocks : int, optional
        The uncertainty comes from the scatter of so many block means: slow noise counts in it.

    Raises
    ------
    ValueError
        Fewer than two samples, or values that are not finite.
    """
    values = np.asarray(counts, dtype=np.float64)
    if values.size < 2:
        raise ValueError(f"a mean with an uncertainty needs at least 2 samples, not {values.size}")
    return _window(values, sample_interval_s, blocks if values.size >= 2 * blocks else 0, resolution)


def _window(values: Floats, interval: float, blocks: int, resolution: float) -> WindowMean:
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{int(np.sum(~np.isfinite(values)))} of {values.size} output words are missing")
    mean = float(values.mean())
    if blocks >= 2:
        edges = np.linspace(0, values.size, blocks + 1).round().astype(np.intp)
        means = np.add.reduceat(values - mean, edges[:-1]) / np.diff(edges)
        scatter = float(np.std(means, ddof=1)) / np.sqrt(blocks)
    else:
        scatter = float(np.std(values, ddof=1)) / np.sqrt(values.size)
    # a word that hardly moves has a rounding error that does not average out
    stuck = float(np.std(values)) < 0.3 * resolution
    u = float(np.hypot(scatter, resolution / np.sqrt(12.0) if stuck else 0.0))
    return WindowMean(float(values.sum()), mean, u, values.size, values.size * interval, 0)
