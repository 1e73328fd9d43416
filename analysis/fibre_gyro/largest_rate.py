"""How far the output follows the rate, what it does beyond, and how it comes back from an overload.

A line N = K w + B is laid through the smallest rates w, and then through one more of one sense after the other,

    off = (N - K w - B)/(K w),

as long as the output follows: |off| of all of them is within a tolerance. The range ends between the last rate
that is followed and the first that is not; what each |off| is uncertain by moves these ends. Where the output
stands still beyond, at a level N_s, the range ends at (N_s - B)/K. A loop that a rate beyond pi of Sagnac phase
has pushed away may settle on another fringe, m lambda c/(L D) off; a word that is too short wraps, 2^m counts off.

After an overload the error e = (N - B)/K - w of each output is looked at from where the rate is back in the range:
means of so many outputs that their noise is an eighth of a bound, and the last of them beyond the bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Bools, Floats

Beyond = Literal["", "stands still", "settles on another fringe", "wraps", "bends"]

PPM = 1e6
_FIRST = 2  # smallest rates of each sense that the line begins with
_STILL_U = 4.0  # uncertainties within which levels are one
_STILL = 0.02  # of a level, by which the range may end beside it
_OF_FRINGE = 0.05  # of a fringe, by which an output may be off another one
_OF_WORD = 0.01
_QUIET = 8.0  # by so many times the noise of a mean lies below the bound of a recovery
_SURE = 2.5  # of that noise: what a mean may be off by
_AT_REST = 0.01  # of the range
_FEWEST = 10  # outputs before and behind an overload for a bias


@dataclass(frozen=True)
class RangeEnd:
    """The end of the range in one sense; rates as sizes."""

    value_dps: float  # best known: level of an output that stands still, else the largest rate that is followed
    low_95_dps: float
    high_95_dps: float  # nan where the largest rate that was taken is followed
    beyond: Beyond  # what the output does there; empty where nobody went there
    detail: float  # bits of a word that wraps, or fringes; else nan


@dataclass(frozen=True)
class InputRange:
    """The range in both senses, and each rate against the line."""

    scale_factor: float  # counts per deg/s
    scale_factor_u: float
    bias: float  # counts
    positive: RangeEnd
    negative: RangeEnd
    rate_dps: Floats  # (n,), rising
    mean: Floats  # (n,), counts
    off_ppm: Floats  # (n,): of the rate itself
    off_u_ppm: Floats
    followed: Bools  # (n,)

    @property
    def least(self) -> RangeEnd:
        """The end of the sense that ends first."""
        return min(self.positive, self.negative, key=lambda one: one.value_dps)


def input_range(
    rate_dps: ArrayLike, mean: ArrayLike, mean_u: ArrayLike, *, tolerance_ppm: float, fringe_dps: float
) -> InputRange:
    """Find how far the output follows.

    Parameters
    ----------
    rate_dps, mean, mean_u : (n,)
        Rates in both senses, deg/s; mean outputs and their standard uncertainties, counts.
    fringe_dps : float
        Rate of a whole fringe of Sagnac phase, lambda c/(L D).

    Raises
    ------
    ValueError
        There are fewer than two rates in a sense, or the smallest do not lie on a line.

    Examples
    --------
    >>> w = np.array([-30.0, -20, -10, 10, 20, 30, 40])
    >>> found = input_range(w, np.clip(250 * w, -9000, 6250), 0.01 + 0 * w, tolerance_ppm=1000, fringe_dps=266.0)
    >>> found.positive.beyond, found.positive.value_dps.__round__(6), found.negative.value_dps
    ('stands still', 25.0, 30.0)
    """
    w, n, u = (np.asarray(one, dtype=np.float64) for one in (rate_dps, mean, mean_u))
    order = np.argsort(w)
    w, n, u = w[order], n[order], u[order]
    # places of each rate, a rate of one sense after the other; visits of one rate stand or fall together
    stairs = {
        sense: [np.flatnonzero(sense * w == size) for size in np.unique(np.abs(w[sense * w > 0]))]
        for sense in (1, -1)
    }
    if min(map(len, stairs.values())) < _FIRST:
        raise ValueError("the range needs two rates and more in each sense")
    inside = np.concatenate([place for of in stairs.values() for place in of[:_FIRST]])
    off, off_u, _ = _against_line(w, n, u, inside)
    if np.any(np.abs(off[inside]) - NORMAL_95 * off_u[inside] > tolerance_ppm):
        raise ValueError("the smallest rates of both senses lie on no line: begin with smaller ones")
    followed = dict.fromkeys(stairs, _FIRST)  # how many rates of each sense
    going = set(stairs)
    for size in np.unique(np.abs(w)):
        here = [sense for sense in going if sense * size in w and size > abs(w[stairs[sense][_FIRST - 1][0]])]
        off, *_ = _against_line(w, n, u, inside)
        goes_on = [sense for sense in here if np.abs(off[stairs[sense][followed[sense]]]).max() <= tolerance_ppm]
        # both senses together, else those that the line so far foresees: its bias would take their side
        for senses in (here, goes_on) if here else ():
            wider = np.concatenate([inside, *(stairs[sense][followed[sense]] for sense in senses)])
            off, *_ = _against_line(w, n, u, wider)
            if np.abs(off[wider]).max() <= tolerance_ppm:
                inside, going = wider, going - set(here) | set(senses)
                followed |= {sense: followed[sense] + 1 for sense in senses}
                break
        else:
            going -= set(here)
    # the last before an end may be a little short: it is followed, and not in the line
    counts = {sense: followed[sense] - (_FIRST < followed[sense] < len(of)) for sense, of in stairs.items()}
    of_line = np.concatenate([place for sense, of in stairs.items() for place in of[: counts[sense]]])
    off, off_u, (k, k_u, b) = _against_line(w, n, u, of_line)
    spare = NORMAL_95 * off_u
    ends = []
    for sense, of in stairs.items():
        sizes = np.array([abs(w[places[0]]) for places in of])
        surely = [np.all(np.abs(off[one]) + spare[one] <= tolerance_ppm) for one in of[: followed[sense]]]
        surely_not = [np.any(np.abs(off[one]) - spare[one] > tolerance_ppm) for one in of[followed[sense] :]]
        low = float(sizes[np.flatnonzero(surely)[-1]]) if any(surely) else 0.0
        high = float(sizes[followed[sense] + np.argmax(surely_not)]) if any(surely_not) else float("nan")
        value, detail = float(sizes[followed[sense] - 1]), float("nan")
        beyond: Beyond = ""
        for first in (followed[sense] - 1, followed[sense]) if followed[sense] < len(of) else ():
            places = np.concatenate(of[first:])
            seen, seen_u = sense * (n[places] - b) / k, u[places] / abs(k)
            level = float(np.mean(seen))
            at_end = value * (1 - _STILL) <= level <= sizes[followed[sense]] * (1 + _STILL)
            one = np.ptp(seen) <= _STILL_U * np.hypot.reduce(seen_u) + 1e-9 * abs(level)
            if at_end and one and first + 1 < len(of):
                # the level is the same whatever the table does: it scatters by noise alone, and K counts
                spread = NORMAL_95 * float(np.hypot(np.ptp(seen), k_u / k * level))
                beyond, value, low, high = "stands still", level, level - spread, level + spread
                break
        else:
            if followed[sense] < len(of):
                beyond, detail = _beyond(float(sizes[followed[sense]]), float(seen[0]), k, fringe_dps)
        ends.append(RangeEnd(value, low, high, beyond, detail))
    return InputRange(k, k_u, b, ends[0], ends[1], w, n, off, off_u, np.isin(np.arange(w.size), inside))


def _against_line(w: Floats, n: Floats, u: Floats, inside: ArrayLike) -> tuple[Floats, Floats, tuple[float, ...]]:
    """Each output off the line through some of them, ppm of its rate, its u; the line."""
    design, part = np.column_stack([w, np.ones(w.size)]), np.asarray(inside, dtype=np.intp)
    weight = 1 / u[part]
    factors = np.linalg.pinv(design[part] * weight[:, np.newaxis]) * weight
    line, covariance = factors @ n[part], (factors * u[part] ** 2) @ factors.T
    own = design @ factors
    of_line = np.einsum("ij,jk,ik->i", design, covariance, design)
    shared = np.zeros(w.size)
    shared[part] = u[part] ** 2 * own[part, np.arange(part.size)]  # a point of the line moves with it
    scale = np.where(w == 0, np.nan, line[0] * w) / PPM
    variance = np.maximum(u**2 + of_line - 2 * shared, 0.0)
    return (n - design @ line) / scale, np.sqrt(variance) / np.abs(scale), (
        float(line[0]), float(np.sqrt(covariance[0, 0])), float(line[1])
    )  # fmt: skip


def _beyond(rate: float, seen: float, k: float, fringe_dps: float) -> tuple[Beyond, float]:
    """What the output does at the first rate that it does not follow; fringes, or the bits of its word."""
    missing = rate - seen
    fringes, bits = missing / fringe_dps, np.log2(max(abs(k * missing), 1.0))
    if round(fringes) and abs(fringes - round(fringes)) < _OF_FRINGE:
        return "settles on another fringe", round(fringes)
    if missing > rate / 2 and abs(2.0 ** (bits - round(bits)) - 1) < _OF_WORD:
        return "wraps", round(bits)
    return "bends", float("nan")


@dataclass(frozen=True)
class Recovery:
    """How the output came back from a rate beyond the range; times from where the rate was back in it."""

    overload_dps: float  # with its sign
    recovery_s: float  # nan: sooner than `high_95_s`; or it did not come back
    low_95_s: float
    high_95_s: float  # nan: it did not come back within the record
    left_dps: float  # mean error at the end of the record
    bias_change_dps: float  # mean error behind less that before; nan where too little was taken, as its u
    bias_change_u_dps: float
    bound_dps: float
    since_s: Floats  # (n,): end of each mean, for a picture
    error_dps: Floats  # (n,)


def recovery(
    rate_dps: ArrayLike,
    words: ArrayLike,
    interval_s: float,
    line: tuple[float, float],
    range_dps: float,
    bound_dps: float,
) -> Recovery:
    """Find how long the output takes to come back.

    Parameters
    ----------
    rate_dps, words : (n,)
        Mean rate of the table over each output, deg/s, and the outputs, counts; nan where one is missing.
    line : (K, B)
        Counts per deg/s, and counts.
    range_dps : float
        Size of the largest rate that is followed.

    Raises
    ------
    ValueError
        The rate was never beyond the range, or never back in it for ten outputs.
    """
    w, n = (np.asarray(one, dtype=np.float64) for one in (rate_dps, words))
    beyond = np.flatnonzero(np.abs(w) > range_dps)
    if not beyond.size:
        raise ValueError(
            f"the table turned at {np.nanmax(np.abs(w)):.4g} deg/s at most, which is no overload: the output "
            f"follows up to {range_dps:.4g} deg/s"
        )
    begin = int(beyond[-1]) + 1
    error = (n - line[1]) / line[0] - w
    behind = error[begin:]
    if np.count_nonzero(np.isfinite(behind)) < _FEWEST:
        raise ValueError("the log ends before the table is back in the range for ten outputs")
    tail = behind[behind.size // 2 :]
    steps = np.diff(tail)
    noise = 1.4826 * float(np.nanmedian(np.abs(steps - np.nanmedian(steps)))) / np.sqrt(2)
    each = max(1, int(np.ceil((_QUIET * noise / bound_dps) ** 2)))
    count, long = behind.size // each, each * interval_s
    if count < _FEWEST:
        raise ValueError(
            f"the noise of the output hides {bound_dps:.3g} deg/s for {_FEWEST * long:.3g} s: rest longer behind "
            "the overload, or take a larger range.tolerance_ppm"
        )
    blocks = behind[: count * each].reshape(count, each)
    there = np.isfinite(blocks).sum(axis=1)
    known, ends = there > 0, long * (np.arange(count) + 1.0)
    # what is missing is as what is beside it
    means = np.interp(ends, ends[known], np.nansum(blocks[known], axis=1) / there[known])
    spare = _SURE * noise / np.sqrt(np.maximum(there, 1))
    last, surely, perhaps = (
        int(np.flatnonzero(np.abs(means) > bound)[-1:].sum() if np.any(np.abs(means) > bound) else -1)
        for bound in (bound_dps, bound_dps + spare, bound_dps - spare)
    )
    came = perhaps < count - 1
    # where within an output the rate came back nobody knows; the mean behind the last may hold a part of it
    low, high = max(surely, 0) * long, (perhaps + 2) * long + interval_s
    rests, places = np.isfinite(error) & (np.abs(w) < _AT_REST * range_dps), np.arange(w.size)
    before, after = error[rests & (places < beyond[0])], error[rests & (places >= begin + behind.size // 2)]
    change, change_u = float("nan"), float("nan")
    if came and min(before.size, after.size) >= _FEWEST:
        change = float(after.mean() - before.mean())
        change_u = float(np.hypot(*(np.std(one, ddof=1) / np.sqrt(one.size) for one in (before, after))))
    return Recovery(
        float(w[beyond][np.nanargmax(np.abs(w[beyond]))]),
        min(max((last + 1) * long, low), high) if came and last >= 0 else float("nan"),
        low if came else behind.size * interval_s,
        high if came else float("nan"),
        float(np.mean(means[-max(count // 10, 1) :])),
        change,
        change_u,
        bound_dps,
        np.asarray(ends, dtype=np.float64),
        np.asarray(means, dtype=np.float64),
    )
