"""Signals that tell their smooth part from their noise: the smooth part needs few looks, the noise no filter.

Any function of time can be a signal; it is then looked at wherever a value is wanted. A signal that has the
attributes of `SmoothAndNoise` is looked at on a coarse grid, from which its values in between follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SIX = 6
"""Values that a polynomial goes through."""

_TO_POLYNOMIAL = np.linalg.inv(np.vander(np.arange(-2.0, 4.0), increasing=True)).T  # six values -> coefficients
_WORTH = 2  # times fewer points on the grid than wanted, from which on it is taken
_FOLLOWS = 0.025  # of the interval: a pole so fast only delays


class SmoothAndNoise(Protocol):
    """A signal with white noise on a smooth part."""

    @property
    def noise_rms(self) -> float:
        """V in each sample, at the converter and at the trigger alike: noise passes every filter."""

    def __call__(self, times: Floats, /) -> Floats:
        """Volts at absolute times in s."""

    def smooth(self, times: Floats, /) -> Floats:
        """Volts without noise."""

    def noise(self, times: Floats, /) -> Floats:
        """Noise alone, V."""

    def interval(self, start: float, stop: float, /) -> float:
        """Distance in s of points between which quintic polynomials give the smooth part; 0: not known."""

    def bounds(self, start: float, stop: float, /) -> tuple[float, float]:
        """Volts that the smooth part does not leave between two times; inf where that is not known."""


class KnownAhead(SmoothAndNoise, Protocol):
    """One that knows what an AC coupling, and an average, make of it: far fewer looks are needed."""

    def above(self, corner_hz: float, start: float, stop: float, /) -> Callable[[Floats], Floats] | None:
        """The smooth part behind a high-pass of one pole, for times between two in s; None where not known."""

    def mean(self, starts: Floats, times: Floats, corner_hz: float, settling_s: float, /) -> Floats | None:
        """Mean over many starts of the smooth part at times behind each, behind a high-pass (0: none); or None."""


def tells_its_noise(signal: Callable[[Floats], Floats]) -> TypeGuard[SmoothAndNoise]:
    """Whether a signal has the attributes of `SmoothAndNoise` (this is asked often: not with all of them)."""
    return hasattr(signal, "noise_rms")


def known_ahead(signal: Callable[[Floats], Floats]) -> TypeGuard[KnownAhead]:
    """Whether a signal is a `KnownAhead`."""
    return hasattr(signal, "above")


def polynomials(values: Floats) -> Floats:
    """Coefficients (..., 6) of the quintic polynomials through six values (..., 6) at the places -2, -1, ... 3."""
    return np.asarray(values @ _TO_POLYNOMIAL)


class Between:
    """Quintic polynomials through values at even steps."""

    def __init__(self, first: float, last: float, values: Floats) -> None:
        self._first, self._pace, self._values = first, (len(values) - 1) / (last - first), values

    def at(self, time: float) -> float:
        """The value at one time in s: as of an array, and faster."""
        place = (time - self._first) * self._pace - 2.0
        around = min(max(int(place), 0), len(self._values) - SIX)
        inside, coefficients = place - around, polynomials(self._values[around : around + SIX]).tolist()
        total: float = coefficients[5]
        for order in (4, 3, 2, 1, 0):
            total = total * inside + coefficients[order]
        return total

    def __call__(self, times: Floats) -> Floats:
        """Values at times in s between the first and the last."""
        places = (times - self._first) * self._pace - 2.0
        around = np.minimum(np.maximum(places.astype(np.intp), 0), len(self._values) - SIX)  # clip is slow
        inside = places - around
        lowest, highest = int(around.min()), int(around.max()) + 1
        around -= lowest
        six = np.stack([self._values[lowest + place : highest + place] for place in range(SIX)])
        coefficients = _TO_POLYNOMIAL.T @ six  # (order, polynomial): rows are gathered faster than columns
        total = coefficients[5].take(around)
        for order in (4, 3, 2, 1, 0):
            total *= inside
            total += coefficients[order].take(around)
        return np.asarray(total)


@dataclass(frozen=True)
class CoarseLook:
    """The smooth part of a signal, from a coarse grid where that is worth it."""

    smooth: Callable[[Floats], Floats]  # absolute times in s -> V
    interval: float  # s, as `SmoothAndNoise.interval` gives it for the times that will be asked for
    delay: float = 0.0  # s by which it comes late

    def __call__(self, times: Floats) -> Floats:
        """Volts at rising absolute times in s."""
        if self.interval <= 0 or times.size == 0:
            return self.smooth(times - self.delay)
        first, last = float(times[0]), float(times[-1])
        grid = self.grid(first, last, times.size)
        if grid is None:
            return self.smooth(times - self.delay)
        return Between(first, last, self.smooth(grid - self.delay))(times)

    def grid(self, first: float, last: float, wanted: int) -> Floats | None:
        """The times in s to look at instead of `wanted` ones; None where that is not worth it.

        They do not leave the times asked for: nobody knows yet what comes after them.
        """
        if self.interval <= 0 or last <= first:
            return None
        cells = max(5, math.ceil((last - first) / self.interval))
        return None if _WORTH * (cells + 1) > wanted else np.linspace(first, last, cells + 1)

    def behind_pole(self, time_constant: float) -> CoarseLook | None:
        """The same behind a pole that is so fast that it only delays; None if it is not."""
        if time_constant > _FOLLOWS * self.interval:
            return None
        return replace(self, delay=self.delay + time_constant)


def look_above(
    signal: Callable[[Floats], Floats], corner_hz: float, start: float, stop: float
) -> CoarseLook | None:
    """What `look` gives, behind a high-pass of one pole that has settled before the start; None: not known."""
    if not known_ahead(signal):
        return None
    above = signal.above(corner_hz, start, stop)
    return None if above is None else CoarseLook(above, signal.interval(start, stop))


def look(signal: Callable[[Floats], Floats], start: float, stop: float) -> Callable[[Floats], Floats]:
    """The signal without its noise, to be asked for absolute times between two."""
    if tells_its_noise(signal):
        return CoarseLook(signal.smooth, signal.interval(start, stop))
    return signal


def noise_of(signal: Callable[[Floats], Floats], times: Floats) -> Floats:
    """The noise that `look` leaves out, V."""
    return signal.noise(times) if tells_its_noise(signal) else np.zeros_like(times)
