"""Looks for the trigger: the first edge of the real signal through the level, or the first pulse that fits.

The comparator has to see the signal on the far side by the hysteresis before it fires, so that noise-free
rest does not trigger and an amplitude below the sensitivity never does (user manual 071-1064-00, p. 157).
A pulse triggers at its trailing edge, or when it has lasted too long (p. 159).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.simulated.front_end.frontend import SIX, Between, Floats, polynomials
from instrument.simulated.panel.panel import TriggerSettings

# --------------------
# What the trigger comparator sees: the signal with its noise, and a stretch of its smooth part over a level


SHORTEST_STRETCH = 1e-9  # s
BEND = 0.25  # of the largest second difference: how far a signal may leave the straight line, twice over
_FEWEST_CELLS = 5  # of a stretch


class SignalStretch:
    """The smooth part of a trigger signal from one time to another, at even steps."""

    def __init__(self, smooth: Callable[[Floats], Floats], start: float, stop: float, interval: float) -> None:
        self.interval = interval
        self.times: Floats = np.linspace(start, stop, max(_FEWEST_CELLS, math.ceil((stop - start) / interval)) + 1)
        self.volts = smooth(self.times)
        self.between = Between(start, stop, self.volts)
        self.bend = BEND * float(np.abs(np.diff(self.volts, 2)).max())
        self._heights: Heights | None = None

    def heights(self, level: float, rising: bool, hysteresis: float, noise: float) -> Heights:
        """What it is over a level, worked out once; arguments as of EdgeSearch, `noise` in V."""
        asked = level, rising, hysteresis, noise
        if self._heights is None or self._heights.asked != asked:
            above = self.volts - level if rising else -(self.volts - level)
            margin = noise + self.bend
            low = np.flatnonzero(above < -hysteresis).tolist()
            near = np.flatnonzero(np.maximum(above[1:], above[:-1]) >= -margin).tolist()
            self._heights = Heights(asked, above, low, near, margin)
        return self._heights


@dataclass(frozen=True, eq=False)
class Heights:
    """A stretch over a level, turned so that the wanted edge rises."""

    asked: tuple[float, bool, float, float]  # level, sense, hysteresis and noise that it is for
    above: Floats  # (n,): V over the level at each look
    low: list[int]  # looks that are so low that the search is armed
    near: list[int]  # cells, each from a look to the next, in which the signal may cross the level
    margin: float  # V by which noise and bends may lift it


class Part:
    """A part of a stretch between two times: its ends and the looks between them are points, counted from 0."""

    def __init__(
        self, stretch: SignalStretch, heights: Heights, start: float, stop: float, ends: tuple[float, float]
    ) -> None:
        first, last = (int(place) for place in np.searchsorted(stretch.times, (start, stop), side="right"))
        self._times, self._heights, self._ends = stretch.times, heights, ends
        self._start, self._stop = start, stop
        self._before = first - 1  # the look in the place of point 0
        self.last: int = max(last - 1 - first, 0) + 1
        """The last point; as many cells are between all of them."""

    def time(self, point: int) -> float:
        """Of a point, s."""
        if 0 < point < self.last:
            return float(self._times[self._before + point])
        return self._stop if point else self._start

    def above(self, point: int) -> float:
        """V over the level."""
        if 0 < point < self.last:
            return float(self._heights.above[self._before + point])
        return self._ends[1] if point else self._ends[0]

    def low_from(self, point: int, hysteresis: float) -> int | None:
        """The first point from this one on at which the search is armed; None if there is none."""
        if point == 0:
            if self._ends[0] < -hysteresis:
                return 0
            point = 1
        at = bisect_left(self._heights.low, self._before + point)
        if at < len(self._heights.low) and (found := self._heights.low[at] - self._before) < self.last:
            return found
        return self.last if point <= self.last and self._ends[1] < -hysteresis else None

    def near_from(self, cell: int) -> int | None:
        """The first cell from this one on in which the signal may cross; None if there is none."""
        if cell == 0:
            if self._is_near(0):
                return 0
            cell = 1
        at = bisect_left(self._heights.near, self._before + cell)
        if at < len(self._heights.near) and (found := self._heights.near[at] - self._before) < self.last - 1:
            return found
        return self.last - 1 if cell <= self.last - 1 and self._is_near(self.last - 1) else None

    def _is_near(self, cell: int) -> bool:
        return max(self.above(cell + 1), self.above(cell)) >= -self._heights.margin


class Comparator:
    """What the trigger comparator sees: volts at absolute times in s (rising)."""

    def __init__(
        self,
        smooth: Callable[[Floats], Floats],
        noise: Callable[[Floats], Floats] = np.zeros_like,
        noise_rms: float = 0.0,
        interval: Callable[[float, float], float] = lambda start, stop: 0.0,
        bounds: Callable[[float, float], tuple[float, float]] = lambda start, stop: (-math.inf, math.inf),
    ) -> None:
        self.noise, self.noise_rms, self.bounds = noise, noise_rms, bounds
        self.smooth, self._interval = smooth, interval
        self._seen: SignalStretch | None = None

    def __call__(self, times: Floats) -> Floats:
        """Volts with the noise."""
        return self.smooth(times) + self.noise(times)

    def interval(self, start: float, stop: float) -> float:
        """Distance in s of looks between which the smooth part is smooth, between two times; 0: not known."""
        seen = self._seen
        if seen is not None and seen.times[0] <= start and stop <= seen.times[-1]:
            return seen.interval
        return self._interval(start, stop)

    def has_to_look(self, start: float) -> bool:
        """Whether the last stretch does not hold this time."""
        seen = self._seen
        return seen is None or not seen.times[0] <= start < seen.times[-1] - SHORTEST_STRETCH

    def stretch(self, start: float, until: float, now: float, most: int) -> SignalStretch:
        """What is seen from `start` to `now`, or not so far; the last one again if it holds the start."""
        # Up to `until` looks between which the signal is smooth are known to do. A new one has `most` cells at
        # most.
        seen = self._seen
        if seen is None or self.has_to_look(start):
            end, interval = now, self._interval(start, now)
            if not interval:  # behind `until` the table changes its rate, or the gyro locks
                end, interval = until, self._interval(start, until)
            end = min(end, start + most * interval)
            seen = self._seen = SignalStretch(self.smooth, start, end, interval)
        return seen


HYSTERESIS = 0.3  # divisions (a guess; the sensitivity is given as one division)
_FIRST_CHUNK = 1024
_LONGEST_CHUNK = 16_384
_MOST_POINTS = 60_000  # samples of one search, however long the time
_USUAL_SPAN = 0.05  # s that a search takes at most, usually
_LONG = 4096  # samples of a search, from which on it is worth to know whether the level can be reached at all
_REFINEMENTS = 3
_FIRST_CELLS, _MOST_CELLS = (
    96,
    4096,
)  # of a stretch of the smooth part; further ones are longer, if nothing was found
_MOST_NOISE = 6.5  # standard deviations; a sample of white noise is never further off
_PLACES: Floats = np.arange(65.0) / 64
GUARD_BAND = 0.05  # of the width, p. 159
SHORTEST_GUARD_BAND = 16.5e-9  # s
_SAMPLES_A_WIDTH = 16  # of a search for pulses
_LOOKS_A_CELL = 32  # of such a search, between two points that tell all about the smooth part


@dataclass
class EdgeSearch:
    """A search that goes on where it stopped."""

    volts_at: Comparator  # volts at given absolute times
    level: float  # in the same volts; negative edges are searched on the negated signal
    rising: bool
    hysteresis: float
    searched_until: float  # absolute time in s up to which there was no edge
    armed: bool = False
    cells: int = _FIRST_CELLS  # of the next stretch of a smooth part

    def advance(self, until: float, step: float, now: float) -> float | None:
        """Search on to `until`, not later than `now`, in steps of about `step`; the time of the edge, or None."""
        span = until - self.searched_until
        if span <= 0:
            return None
        step = max(step, span / _MOST_POINTS)
        noise = _MOST_NOISE * self.volts_at.noise_rms
        if noise < self.hysteresis and self.volts_at.interval(self.searched_until, until) > 2 * step:
            return self._advance_coarsely(until, now, step, noise)
        if span > _LONG * step and self._passes_by(until, noise):
            return None
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

    def _passes_by(self, until: float, noise: float) -> bool:
        """Go on to a time before which the signal stays far below the level, if that is known."""
        low, high = self.volts_at.bounds(self.searched_until, until)
        nearest = high - self.level if self.rising else self.level - low
        if nearest + noise >= -self.hysteresis:
            return False
        self.searched_until, self.armed = until, True
        return True

    def _advance_coarsely(self, until: float, now: float, step: float, noise: float) -> float | None:
        """The same where looks far apart tell where the edge may be, and `noise` is as far as noise goes."""
        while until - self.searched_until > SHORTEST_STRETCH:
            if self.volts_at.has_to_look(self.searched_until) and self._passes_by(until, noise):
                break
            stretch = self.volts_at.stretch(self.searched_until, until, now, self.cells)
            edge = self._edge_along(stretch, until, step, noise)
            if edge is not None:
                return edge
            self.searched_until = min(until, float(stretch.times[-1]))
            self.cells = min(2 * self.cells, _MOST_CELLS)
        return None

    def _edge_along(self, stretch: SignalStretch, until: float, step: float, noise: float) -> float | None:
        """The edge in what is left of a stretch."""
        start, stop = self.searched_until, min(until, float(stretch.times[-1]))
        heights = stretch.heights(self.level, self.rising, self.hysteresis, noise)
        ends = [stretch.between.at(when) - self.level for when in (start, stop)]
        part = Part(stretch, heights, start, stop, (ends[0], ends[1]) if self.rising else (-ends[0], -ends[1]))
        begin = 0
        while True:
            if not self.armed:
                lowest = part.low_from(begin, self.hysteresis)
                if lowest is None:
                    return None
                self.armed, begin = True, lowest
            cell = part.near_from(begin)
            if cell is None:
                return None
            end = cell
            while part.near_from(end + 1) == end + 1 and part.above(end + 1) < heights.margin:
                end += 1
            begin = end + 1
            edge = self._edge_near(stretch.between, part.time(cell), part.time(begin), step, noise)
            if edge is not None:
                return edge

    def _edge_near(self, between: Between, start: float, stop: float, step: float, noise: float) -> float | None:
        """The first edge in a short time, sample by sample with the noise."""

        def above(times: Floats) -> Floats:
            return self.turned(between(times) + self.volts_at.noise(times) - self.level)

        # not before the smooth signal is so high that noise could do it
        places: Floats = start + (stop - start) * _PLACES
        possible = self.turned(between(places) - self.level) >= -noise
        first = float(places[max(int(possible.argmax()) - 1, 0)])
        size = _FIRST_CHUNK
        while first < stop:
            times = first + step * np.arange(min(size, math.ceil((stop - first) / step)) + 1, dtype=np.float64)
            times[-1] = min(times[-1], stop)
            heights = above(times)
            crossed = heights >= 0
            index = int(crossed.argmax())
            if crossed[index]:
                before = max(index - 1, 0)
                low, high = float(times[before]), float(times[index])
                if not noise:
                    return refine(above, low, high)
                rise = float(heights[index] - heights[before])
                return high - (high - low) * float(heights[index]) / rise if rise > 0 else high
            first = float(times[-1])
        return None

    def turned(self, volts: Floats) -> Floats:
        """Volts with the sign in which the wanted edge rises."""
        return volts if self.rising else -volts

    def _above(self, times: Floats) -> Floats:
        """Signal over the level, turned so that the wanted edge rises."""
        return self.turned(self.volts_at(times) - self.level)

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
        return refine(self._above, float(times[max(index - 1, 0)]), float(times[index]))


def first_edges(search: EdgeSearch, ready: Floats, reach: float, step: float) -> Floats:
    """First edges after each of several times, all at once: what a search from each of them would find."""
    volts_at, noise = search.volts_at, _MOST_NOISE * search.volts_at.noise_rms
    step = max(step, _USUAL_SPAN / _MOST_POINTS)
    edges = np.full(ready.shape, np.nan)
    interval = volts_at.interval(float(ready[0]), float(ready[-1]) + reach)
    if noise >= search.hysteresis or interval <= step:
        return edges
    looks = math.ceil(reach / interval) + SIX
    times = ready[:, np.newaxis] + interval * np.arange(looks, dtype=np.float64)
    above = search.turned(volts_at.smooth(times.ravel()).reshape(times.shape) - search.level)
    margin = noise + BEND * np.abs(np.diff(above, 2)).max()
    places = np.arange(looks)
    low = np.where((above < -search.hysteresis).any(axis=1), (above < -search.hysteresis).argmax(axis=1), looks)
    behind = places > low[:, np.newaxis]
    over = (above >= 0) & behind
    near = (above >= -margin) & behind
    first, begins = over.argmax(axis=1), near.argmax(axis=1)
    clear = over.any(axis=1) & (first - begins < SIX // 2) & (first + SIX // 2 <= looks)
    rows = np.flatnonzero(clear)
    if not rows.size:
        return edges
    around = np.minimum(np.maximum(first[rows] - SIX // 2, 0), looks - SIX)
    six = np.take_along_axis(above[rows], around[:, np.newaxis] + np.arange(SIX), axis=1)
    start = (begins[rows] - 1 - around).astype(np.float64)
    rise = polynomials(six)

    def heights(inside: Floats) -> Floats:
        """V over the level, at places in intervals from the first of the six looks."""
        total = np.broadcast_to(rise[:, SIX - 1, np.newaxis], inside.shape)
        for order in range(SIX - 2, -1, -1):
            total = total * (inside - 2.0) + rise[:, order, np.newaxis]
        return total

    # not before the smooth signal is so high that noise could do it, and as long again behind the level
    cells = (first - begins + 1)[rows].astype(np.float64)
    inside = start[:, np.newaxis] + cells[:, np.newaxis] * _PLACES
    possible = np.maximum((heights(inside) >= -noise).argmax(axis=1) - 1, 0)
    start = np.take_along_axis(inside, possible[:, np.newaxis], axis=1)[:, 0]
    longest = float((first[rows] - around - start).max())
    samples = start[:, np.newaxis] + step / interval * np.arange(math.ceil(2 * longest * interval / step) + 2.0)
    seen = heights(samples) + search.turned(volts_at.noise(samples.ravel()).reshape(samples.shape))
    crossed = seen >= 0
    at = np.maximum(crossed.argmax(axis=1), 1)[:, np.newaxis]
    high, before = np.take_along_axis(seen, at, axis=1), np.take_along_axis(seen, at - 1, axis=1)
    share = high / np.where(high > before, high - before, np.inf)
    found = (np.take_along_axis(samples, at, axis=1) - share * step / interval)[:, 0] + around
    edges[rows] = np.where(crossed.any(axis=1), ready[rows] + interval * found, np.nan)
    return edges


def refine(above: Callable[[Floats], Floats], low: float, high: float, rounds: int = _REFINEMENTS) -> float:
    """Narrow the bracket in which a signal rises through zero by sampling it finely."""
    for _ in range(rounds):
        if high - low <= 1e-13 * max(1.0, abs(high)):
            break
        times = np.linspace(low, high, 33)
        index = int((above(times) >= 0).argmax())
        low, high = float(times[max(index - 1, 0)]), float(times[index])
    return (low + high) / 2


Bracket = tuple[float, float]
Bools = NDArray[np.bool_]


@dataclass
class PulseSearch:
    """A search for a pulse of the wanted width that goes on where it stopped."""

    trigger: TriggerSettings  # level, polarity, condition and width
    volts_at: Comparator  # as of EdgeSearch
    hysteresis: float
    searched_until: float
    state: int = 0  # 1 within a pulse, -1 outside, 0 as long as that is not known
    # absolute times in s between which the leading edge of the pulse that is under way lies
    began: Bracket | None = None
    # absolute times in s between which the signal was below, and above, the level for the last time
    left_below: Bracket = (-math.inf, -math.inf)
    left_above: Bracket = (-math.inf, -math.inf)
    cells: int = _FIRST_CELLS

    def advance(self, until: float, step: float, now: float) -> float | None:
        """Search on to `until`, not later than `now`, in steps of `step` or finer; the time of the trigger."""
        span = until - self.searched_until
        if span <= 0:
            return None
        step = max(min(step, self.trigger.width / _SAMPLES_A_WIDTH), span / (4 * _MOST_POINTS))
        noise = _MOST_NOISE * self.volts_at.noise_rms
        interval = self.volts_at.interval(self.searched_until, until)
        if noise < self.hysteresis and interval > 2 * step:
            return self._advance_coarsely(until, now, max(step, interval / _LOOKS_A_CELL), noise)
        while self.searched_until < until:
            count = min(_LONGEST_CHUNK, int((until - self.searched_until) / step) + 1)
            times = self.searched_until + step * np.arange(count + 1, dtype=np.float64)
            times[-1] = min(times[-1], until)
            found = self._pulse_in(times, self._above(times))
            if found is not None:
                return found
            self.searched_until = float(times[-1])
        return None

    def _advance_coarsely(self, until: float, now: float, step: float, noise: float) -> float | None:
        """The same where looks far apart tell on which side the signal is, and `noise` is as far as noise goes."""
        while until - self.searched_until > SHORTEST_STRETCH:
            stretch = self.volts_at.stretch(self.searched_until, until, now, self.cells)
            times, volts = self._telling_looks(stretch, min(until, float(stretch.times[-1])), step, noise)
            # further off, noise turns no side
            near = np.flatnonzero(np.abs(volts - self.trigger.level) <= self.hysteresis + noise)
            volts[near] += self.volts_at.noise(times[near])
            found = self._pulse_in(times, self._turned(volts))
            if found is not None:
                return found
            self.searched_until = float(times[-1])
            self.cells = min(2 * self.cells, _MOST_CELLS)
        return None

    def _telling_looks(
        self, stretch: SignalStretch, end: float, step: float, noise: float
    ) -> tuple[Floats, Floats]:
        """Times and volts at the looks of a stretch, and more, `step` apart, where the signal may turn about."""
        first, last = np.searchsorted(stretch.times, (self.searched_until, end), side="right")
        looks = slice(first, last - 1)
        times = np.concatenate([[self.searched_until], stretch.times[looks], [end]])
        ends = [[stretch.between.at(float(times[place]))] for place in (0, -1)]
        volts = np.concatenate([ends[0], stretch.volts[looks], ends[1]])
        lengths = np.diff(times)
        unsure = self._may_turn_about(self._turned(volts), noise, stretch.bend)
        counts = np.where(unsure, np.maximum(np.ceil(lengths / step), 1), 1).astype(np.intp)
        if counts.sum() == counts.size:
            return times, volts
        cells = np.repeat(np.arange(len(counts)), counts)
        inside = np.arange(len(cells)) - (np.cumsum(counts) - counts)[cells]
        more = np.flatnonzero(inside)
        times, volts = np.append(times[cells], end), np.append(volts[cells], ends[1])
        times[more] += inside[more] * (lengths / counts)[cells[more]]
        volts[more] = stretch.between(times[more])
        return times, volts

    def _may_turn_about(self, above: Floats, noise: float, bend: float) -> Bools:
        """In which cells between looks the signal may cross the level more than once, or touch it."""
        # Where looks on the way from one side to the other only rise, or only fall, there is one edge, and to know
        # its place to a cell is enough.
        sure = self.hysteresis + noise + bend
        sides = np.where(above > sure, 1, np.where(above < -sure, -1, 0))
        known = np.flatnonzero(sides)
        unsure = np.ones(len(above) - 1, dtype=np.bool_)
        if known.size < 2:
            return unsure
        before, after = known[:-1], known[1:]
        steps = after - before
        rises = np.concatenate([[0], np.cumsum(above[1:] > above[:-1])])
        risen = rises[after] - rises[before]
        steady = (sides[before] == sides[after]) & (steps == 1)
        crosses = (sides[before] != sides[after]) & (risen == np.where(sides[after] > 0, steps, 0))
        crosses &= bend < self.hysteresis - noise  # noise alone cannot take it to the other side and back
        unsure[known[0] : known[-1]] = np.repeat(~(steady | crosses), steps)
        return unsure

    def _turned(self, volts: Floats) -> Floats:
        """Volts over the level, with the sign in which the pulse points up."""
        above = volts - self.trigger.level
        return above if self.trigger.polarity == "POSITIVE" else -above

    def _above(self, times: Floats) -> Floats:
        return self._turned(self.volts_at(times))

    def _pulse_in(self, times: Floats, above: Floats) -> float | None:
        """Follow the edges among these times, at which the signal is so far above the level."""
        sides = np.where(above > self.hysteresis, 1, np.where(above < -self.hysteresis, -1, 0))
        known = np.flatnonzero(sides)
        previous = np.concatenate([[self.state], sides[known]])
        changes = known[(previous[1:] != previous[:-1]) & (previous[:-1] != 0)]
        last_below, last_over = (
            np.maximum.accumulate(np.where(side, np.arange(len(side)), -1)) for side in (above < 0, above > 0)
        )
        if len(changes):
            rising = sides[changes] > 0
            last = np.where(rising, last_below[changes], last_over[changes])
            lows, highs = times[last], times[np.minimum(last + 1, changes)]
            for at in np.flatnonzero(last < 0).tolist():  # it left its side in an earlier stretch
                lows[at], highs[at] = self.left_below if rising[at] else self.left_above
            for at in np.flatnonzero(self._worth_judging(rising, lows, highs)).tolist():
                edge = float(lows[at]), float(highs[at])
                if rising[at]:
                    self.began = edge
                elif self.began is not None:
                    found = self._judge(self.began, edge, ended=True)
                    self.began = None
                    if found is not None:
                        return found
        if len(known):
            self.state = int(sides[known[-1]])
        if (place := int(last_below[-1])) >= 0:
            self.left_below = float(times[place]), float(times[min(place + 1, len(times) - 1)])
        if (place := int(last_over[-1])) >= 0:
            self.left_above = float(times[place]), float(times[min(place + 1, len(times) - 1)])
        end = float(times[-1])
        return None if self.began is None else self._judge(self.began, (end, end), ended=False)

    def _worth_judging(self, rising: Bools, lows: Floats, highs: Floats) -> Bools:
        """Which edges, given by their brackets, are those of a pulse that could trigger, or not of a whole one."""
        possible = ~rising[1:] & self._possible(lows[1:] - highs[:-1], highs[1:] - lows[:-1], ended=True)
        worth = np.zeros(rising.shape, dtype=np.bool_)
        worth[1:] = possible
        worth[:-1] |= possible
        worth[0] |= ~rising[0]
        worth[-1] |= rising[-1]
        return worth

    def _exactly(self, edge: Bracket, *, rising: bool) -> float:
        """The crossing of the level within a bracket."""
        sign = 1.0 if rising else -1.0
        return refine(lambda when: sign * self._above(when), *edge)

    def _judge(self, began: Bracket, until: Bracket, *, ended: bool) -> float | None:
        """The time at which a pulse triggers that has lasted to `until`; None if it does not (yet)."""
        # Its edges are only looked for where the brackets leave it open.
        lasted_between = np.array([until[0] - began[1]]), np.array([until[1] - began[0]])
        if not self._possible(*lasted_between, ended=ended)[0]:
            return None
        start = self._exactly(began, rising=True)
        self.began = start, start
        end = self._exactly(until, rising=False) if ended else until[0]
        width, lasted, guard = self.trigger.width, end - start, self._guard
        match self.trigger.when:
            case "EQUAL":
                return end if ended and abs(lasted - width) <= guard else None
            case "INSIDE":
                return end if ended and lasted < width else None
            case "OUTSIDE":
                return start + width if lasted > width else None
        if lasted > width + guard:
            return start + width + guard
        return end if ended and lasted < width - guard else None

    @property
    def _guard(self) -> float:
        """Seconds around the width that still count as equal."""
        return max(GUARD_BAND * self.trigger.width, SHORTEST_GUARD_BAND)

    def _possible(self, shortest: Floats, longest: Floats, *, ended: bool) -> Bools:
        """Whether pulses could trigger that have lasted at least and at most so long (s)."""
        width, guard = self.trigger.width, self._guard
        match self.trigger.when:
            case "EQUAL":
                found = (longest >= width - guard) & (shortest <= width + guard) & ended
            case "INSIDE":
                found = (shortest < width) & ended
            case "OUTSIDE":
                found = longest > width
            case _:
                found = (longest > width + guard) | ((shortest < width - guard) & ended)
        return np.asarray(found)
