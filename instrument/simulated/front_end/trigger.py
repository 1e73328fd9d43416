"""Looks for the trigger: the first edge of the real signal through the level, or the first pulse that fits.

The comparator has to see the signal on the far side by the hysteresis before it fires, so that noise-free
rest does not trigger and an amplitude below the sensitivity never does (user manual 071-1064-00, p. 157).
A pulse triggers at its trailing edge, or when it has lasted too long (p. 159).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from instrument.simulated.front_end.frontend import Floats
from instrument.simulated.front_end.smooth import Between
from instrument.simulated.panel.panel import TriggerSettings

HYSTERESIS = 0.3  # divisions (a guess; the sensitivity is given as one division)
_FIRST_CHUNK = 1024
_LONGEST_CHUNK = 16_384
_MOST_POINTS = 60_000  # samples of one search, however long the time
_REFINEMENTS = 3
_MOST_NOISE = 6.5  # standard deviations; a sample of white noise is never further off
_BEND = 0.25  # of the largest second difference: how far a signal may leave the straight line, twice over
_FEWEST_CELLS, _MOST_CELLS = 5, 4096  # of a stretch
_SHORTEST_STRETCH = 1e-9  # s
_PLACES: Floats = np.arange(65.0) / 64
GUARD_BAND = 0.05  # of the width, p. 159
SHORTEST_GUARD_BAND = 16.5e-9  # s
_SAMPLES_A_WIDTH = 16  # of a search for pulses


class Stretch:
    """The smooth part of a trigger signal from one time to another, at even steps.

    Attributes
    ----------
    times, volts : (n,) arrays
        s and V.
    between : callable
        Volts at times between them.
    bend : float
        V by which the signal may leave straight lines through `volts`.
    """

    def __init__(self, smooth: Callable[[Floats], Floats], start: float, stop: float, interval: float) -> None:
        self.times: Floats = np.linspace(start, stop, max(_FEWEST_CELLS, math.ceil((stop - start) / interval)) + 1)
        self.volts = smooth(self.times)
        self.between = Between(start, stop, self.volts)
        self.bend = _BEND * float(np.abs(np.diff(self.volts, 2)).max())


class Comparator:
    """What the trigger comparator sees: volts at absolute times in s (rising).

    Parameters
    ----------
    smooth : callable
        Volts at absolute times in s (rising), all but the noise.
    noise : callable
        What comes on top of it, V.
    noise_rms : float
        V in each sample.
    interval : callable
        Start and stop in s -> distance in s of looks between which the smooth part is smooth; 0: not known.
    """

    def __init__(
        self,
        smooth: Callable[[Floats], Floats],
        noise: Callable[[Floats], Floats] = np.zeros_like,
        noise_rms: float = 0.0,
        interval: Callable[[float, float], float] = lambda start, stop: 0.0,
    ) -> None:
        self.noise, self.noise_rms, self.interval = noise, noise_rms, interval
        self._smooth = smooth
        self._seen: Stretch | None = None

    def __call__(self, times: Floats) -> Floats:
        """Volts with the noise."""
        return self._smooth(times) + self.noise(times)

    def stretch(self, start: float, until: float, now: float) -> Stretch:
        """What is seen from `start` to `now`, or not so far; the last one again if it holds the start.

        Up to `until` looks between which the signal is smooth are known to do.
        """
        seen = self._seen
        if seen is None or not seen.times[0] <= start < seen.times[-1] - _SHORTEST_STRETCH:
            end, interval = now, self.interval(start, now)
            if not interval:  # behind `until` the table changes its rate, or the gyro locks
                end, interval = until, self.interval(start, until)
            end = min(end, start + _MOST_CELLS * interval)
            seen = self._seen = Stretch(self._smooth, start, end, interval)
        return seen


@dataclass
class EdgeSearch:
    """A search that goes on where it stopped.

    Attributes
    ----------
    volts_at : Comparator
        Volts at given absolute times.
    level, hysteresis : float
        In the same volts; negative edges are searched on the negated signal.
    searched_until : float
        Absolute time in s up to which there was no edge.
    """

    volts_at: Comparator
    level: float
    rising: bool
    hysteresis: float
    searched_until: float
    armed: bool = False

    def advance(self, until: float, step: float, now: float) -> float | None:
        """Search on to `until`, not later than `now`, in steps of about `step`; the time of the edge, or None."""
        span = until - self.searched_until
        if span <= 0:
            return None
        step = max(step, span / _MOST_POINTS)
        noise = _MOST_NOISE * self.volts_at.noise_rms
        if noise < self.hysteresis and self.volts_at.interval(self.searched_until, until) > 2 * step:
            return self._advance_coarsely(until, now, step, noise)
        size = _FIRST_CHUNK
        while self.searched_until < until:
            count = min(size, int((until - self.searched_until) / step) + 1)
            times = self.searched_until + step * np.arange(count + 1, dtype=np.float64)
            times[-1] = min(times[-1], until)
            edge = self._edge_in(times)
            if edge is not None:
                return edge
            self.searched_until = float(times[-1])
            size = min(size * 4, _LONGEST_CHUNK)
        return None

    def _advance_coarsely(self, until: float, now: float, step: float, noise: float) -> float | None:
        """The same where looks far apart tell where the edge may be, and `noise` is as far as noise goes."""
        while until - self.searched_until > _SHORTEST_STRETCH:
            stretch = self.volts_at.stretch(self.searched_until, until, now)
            edge = self._edge_along(stretch, until, step, noise)
            if edge is not None:
                return edge
            self.searched_until = min(until, float(stretch.times[-1]))
        return None

    def _edge_along(self, stretch: Stretch, until: float, step: float, noise: float) -> float | None:
        """The edge in what is left of a stretch."""
        first, last = np.searchsorted(stretch.times, (self.searched_until, until), side="right")
        ends = np.array([self.searched_until, min(until, float(stretch.times[-1]))])
        times = np.concatenate([ends[:1], stretch.times[first : last - 1], ends[1:]])
        at_ends = stretch.between(ends)
        volts = np.concatenate([at_ends[:1], stretch.volts[first : last - 1], at_ends[1:]])
        above = self._turned(volts - self.level)
        margin = noise + stretch.bend
        near = np.flatnonzero(np.maximum(above[1:], above[:-1]) >= -margin)  # cells in which it may cross
        begin = 0
        while True:
            if not self.armed:
                below = above[begin:] < -self.hysteresis
                lowest = int(below.argmax())
                if not below[lowest]:
                    return None
                self.armed, begin = True, begin + lowest
            at = int(np.searchsorted(near, begin))
            if at == len(near):
                return None
            end = at
            while end + 1 < len(near) and near[end + 1] == near[end] + 1 and above[near[end] + 1] < margin:
                end += 1
            begin, stop = int(near[at]), int(near[end]) + 1
            edge = self._edge_near(stretch.between, float(times[begin]), float(times[stop]), step, noise)
            if edge is not None:
                return edge
            begin = stop

    def _edge_near(self, between: Between, start: float, stop: float, step: float, noise: float) -> float | None:
        """The first edge in a short time, sample by sample with the noise."""

        def above(times: Floats) -> Floats:
            return self._turned(between(times) + self.volts_at.noise(times) - self.level)

        # not before the smooth signal is so high that noise could do it
        places: Floats = start + (stop - start) * _PLACES
        possible = self._turned(between(places) - self.level) >= -noise
        first = float(places[max(int(possible.argmax()) - 1, 0)])
        size = _FIRST_CHUNK
        while first < stop:
            times = first + step * np.arange(min(size, math.ceil((stop - first) / step)) + 1, dtype=np.float64)
            times[-1] = min(times[-1], stop)
            crossed = above(times) >= 0
            index = int(crossed.argmax())
            if crossed[index]:
                rounds = 1 if noise else _REFINEMENTS
                return refine(above, float(times[max(index - 1, 0)]), float(times[index]), rounds)
            first = float(times[-1])
        return None

    def _turned(self, volts: Floats) -> Floats:
        """Volts with the sign in which the wanted edge rises."""
        return volts if self.rising else -volts

    def _above(self, times: Floats) -> Floats:
        """Signal over the level, turned so that the wanted edge rises."""
        return self._turned(self.volts_at(times) - self.level)

    def _edge_in(self, times: Floats) -> float | None:
        above = self._above(times)
        first = 0
        if not self.armed:
            below = above < -self.hysteresis
            first = int(below.argmax())
            if not below[first]:
                return None
            self.armed = True
        crossed = above[first:] >= 0
        index = int(crossed.argmax())
        if not crossed[index]:
            return None
        index += first
        return self._refine(float(times[max(index - 1, 0)]), float(times[index]))

    def _refine(self, low: float, high: float) -> float:
        return refine(self._above, low, high)


def refine(above: Callable[[Floats], Floats], low: float, high: float, rounds: int = _REFINEMENTS) -> float:
    """Narrow the bracket in which a signal rises through zero by sampling it finely."""
    for _ in range(rounds):
        if high - low <= 1e-13 * max(1.0, abs(high)):
            break
        times = np.linspace(low, high, 33)
        index = int((above(times) >= 0).argmax())
        low, high = float(times[max(index - 1, 0)]), float(times[index])
    return (low + high) / 2


@dataclass
class PulseSearch:
    """A search for a pulse of the wanted width that goes on where it stopped.

    Attributes
    ----------
    trigger : TriggerSettings
        Level, polarity, condition and width.
    volts_at, hysteresis, searched_until
        As of EdgeSearch.
    state : int
        1 within a pulse, -1 outside, 0 as long as that is not known.
    began : float or None
        Absolute time in s of the leading edge of the pulse that is under way.
    """

    trigger: TriggerSettings
    volts_at: Callable[[Floats], Floats]
    hysteresis: float
    searched_until: float
    state: int = 0
    began: float | None = None

    def advance(self, until: float, step: float) -> float | None:
        """Search on to `until` in steps of `step` or finer; the time of the trigger, or None."""
        span = until - self.searched_until
        if span <= 0:
            return None
        step = max(min(step, self.trigger.width / _SAMPLES_A_WIDTH), span / (4 * _MOST_POINTS))
        while self.searched_until < until:
            count = min(_LONGEST_CHUNK, int((until - self.searched_until) / step) + 1)
            times = self.searched_until + step * np.arange(count + 1, dtype=np.float64)
            times[-1] = min(times[-1], until)
            found = self._pulse_in(times)
            if found is not None:
                return found
            self.searched_until = float(times[-1])
        return None

    def _above(self, times: Floats) -> Floats:
        """Signal over the level, turned so that the pulse points up."""
        above = self.volts_at(times) - self.trigger.level
        return above if self.trigger.polarity == "POSITIVE" else -above

    def _pulse_in(self, times: Floats) -> float | None:
        """Follow the edges among these times."""
        above = self._above(times)
        sides = np.where(above > self.hysteresis, 1, np.where(above < -self.hysteresis, -1, 0))
        known = np.flatnonzero(sides)
        previous = np.concatenate([[self.state], sides[known]])
        changes = known[(previous[1:] != previous[:-1]) & (previous[:-1] != 0)]
        for index in changes:
            rising = bool(sides[index] > 0)
            edge = self._edge_before(times, above, int(index), rising=rising)
            if rising:
                self.began = edge
            elif self.began is not None:
                found = self._judge(self.began, edge, ended=True)
                self.began = None
                if found is not None:
                    return found
        if len(known):
            self.state = int(sides[known[-1]])
        return None if self.began is None else self._judge(self.began, float(times[-1]), ended=False)

    def _edge_before(self, times: Floats, above: Floats, index: int, *, rising: bool) -> float:
        """The crossing of the level that led to the other side at `times[index]`."""
        beyond = above[: index + 1] < 0 if rising else above[: index + 1] > 0
        last = int(np.flatnonzero(beyond)[-1]) if beyond.any() else 0
        after = min(last + 1, index)
        sign = 1.0 if rising else -1.0
        return refine(lambda when: sign * self._above(when), float(times[last]), float(times[after]))

    def _judge(self, began: float, until: float, *, ended: bool) -> float | None:
        """The time at which a pulse triggers that has lasted to `until`; None if it does not (yet)."""
        width, lasted = self.trigger.width, until - began
        guard = max(GUARD_BAND * width, SHORTEST_GUARD_BAND)
        match self.trigger.when:
            case "EQUAL":
                return until if ended and abs(lasted - width) <= guard else None
            case "INSIDE":
                return until if ended and lasted < width else None
            case "OUTSIDE":
                return began + width if lasted > width else None
        if lasted > width + guard:
            return began + width + guard
        return until if ended and lasted < width - guard else None
