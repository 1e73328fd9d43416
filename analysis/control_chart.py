"""Control chart of single values: individuals and moving range, with the rules of Western Electric.

Western Electric, Statistical Quality Control Handbook (1956), pp. 25-28; ISO 7870-2 (2013).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Floats

_D2 = 1.128379167  # mean moving range of two normal values, in standard deviations: 2/sqrt(pi)
_D4 = 3.267  # upper limit of the moving range of two, in mean moving ranges
FEWEST = 8  # fewer values than this give no limits: the mean of seven moving ranges is good to a third of itself

RULES = {
    1: "beyond 3 sigma",
    2: "2 of 3 in a row beyond 2 sigma, on one side",
    3: "4 of 5 in a row beyond 1 sigma, on one side",
    4: "8 in a row on one side of the centre",
    5: "moving range above its limit: a jump",
}
"""Rules 1 to 4 look at the values, 5 at their moving range."""


@dataclass(frozen=True)
class Signal:
    """A value that does not look like the others: its place, and the rule of :data:`RULES` that says so."""

    place: int
    rule: int


@dataclass(frozen=True)
class ControlChart:
    """Values in the order in which they were found, against what those of the baseline do by chance."""

    values: Floats  # (n,) the second is the distance from the value before, nan for the first
    moving_range: Floats
    centre: float  # of the baseline: mean, and mean moving range over 1.128; nan with fewer than eight values
    sigma: float
    range_limit: float  # upper limit of the moving range
    baseline: int  # how many values, from the first, the limits rest on
    signals: tuple[Signal, ...]  # in the order of their places; each value at most once for each rule

    @property
    def has_limits(self) -> bool:
        """Whether there were enough values, and they differ."""
        return bool(np.isfinite(self.sigma) and self.sigma > 0)

    @property
    def last_is_in_control(self) -> bool:
        """Whether nothing speaks against the last value."""
        return not any(one.place == self.values.size - 1 for one in self.signals)


def control_chart(values: ArrayLike, *, baseline: int = 25) -> ControlChart:
    """Draw up the chart of values in the order of time."""
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or not np.isfinite(x).all():
        raise ValueError("a control chart needs one row of finite values")
    if baseline < FEWEST:
        raise ValueError(f"a baseline needs {FEWEST} values or more")
    moving = np.concatenate([np.full(min(x.size, 1), np.nan), np.abs(np.diff(x))])
    first = x[:baseline]
    if first.size < FEWEST:
        return ControlChart(x, moving, np.nan, np.nan, np.nan, first.size, ())
    mean_range = float(np.mean(moving[1 : first.size]))
    centre, sigma = float(first.mean()), mean_range / _D2
    found: tuple[Signal, ...] = ()
    if sigma > 0:
        found = tuple(
            sorted(_signals((x - centre) / sigma, moving / mean_range), key=lambda one: (one.place, one.rule))
        )
    return ControlChart(x, moving, centre, sigma, _D4 * mean_range, first.size, found)


def _signals(z: Floats, ranges: Floats) -> Iterator[Signal]:
    """Signals of values in sigma from the centre, and of moving ranges in mean ranges."""
    yield from (Signal(int(place), 1) for place in np.flatnonzero(np.abs(z) > 3))
    for rule, count, of, beyond in ((2, 2, 3, 2.0), (3, 4, 5, 1.0), (4, 8, 8, 0.0)):
        for sign in (1, -1):
            out = sign * z > beyond
            for place in range(of - 1, z.size):
                # the value itself must be one of them: else it is not its fault
                if out[place] and out[place - of + 1 : place + 1].sum() >= count:
                    yield Signal(place, rule)
    yield from (Signal(int(place), 5) for place in np.flatnonzero(ranges > _D4))


@dataclass(frozen=True)
class Trend:
    """How fast a number changes, with the 95 % interval."""

    per_day: float
    low_95: float
    high_95: float
    days: float  # from the first to the last value
    values: int


def trend(at_days: ArrayLike, values: ArrayLike, u: ArrayLike, of: ArrayLike) -> Trend | None:
    """Slope of values (n,) of one or more things, each with a level of its own; None where nothing tells it.

    What they scatter beyond their uncertainties (nan: unknown): Paule and Mandel, J. Res. NBS 87, 1982.
    """
    t, y, known = (np.asarray(one, dtype=np.float64) for one in (at_days, values, u))
    names, which = np.unique(np.asarray(of), return_inverse=True)
    freedom = y.size - names.size - 1
    design = np.column_stack([np.eye(names.size)[which], t - t.mean()]) if y.size else np.empty((0, 1))
    if freedom < 2 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    variance = np.nan_to_num(known) ** 2
    plain = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    floor = 1e-24 * float(np.ptp(y)) ** 2 + 1e-300

    def solved(scatter: float) -> tuple[float, float, float]:
        weight = 1 / np.sqrt(variance + scatter + floor)
        factors = np.linalg.pinv(design * weight[:, np.newaxis])
        left = weight * y - design * weight[:, np.newaxis] @ (factors @ (weight * y))
        return float(factors[-1] @ (weight * y)), float(np.linalg.norm(factors[-1])), float(left @ left) - freedom

    most = float(plain @ plain) + float(variance.max())
    beyond = solved(0.0)[2] > 0
    scatter = 0.0
    if beyond:
        from scipy.optimize import brentq  # takes longer to import than all else here

        scatter = float(brentq(lambda one: solved(one)[2], 0.0, most))
    slope, slope_u, _ = solved(scatter)
    half = slope_u * float(scipy.special.stdtrit(freedom, 0.975) if beyond else scipy.special.ndtri(0.975))
    return Trend(slope, slope - half, slope + half, float(np.ptp(t)), y.size)
