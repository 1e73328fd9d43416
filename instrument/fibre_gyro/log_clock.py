"""When the rows of a log were made: the interval between them, and the rows that are missing.

Time stamps are rounded, to 1 ms or to 10 ms, and come from a host that was late now and then. The interval is
that of a line through all of them, never one of their differences; a row is missing where the stamps behind it
stay behind the line, not where one of them is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.errors import FileFormatError
from instrument.fibre_gyro.recording import Floats

Places = NDArray[np.int64]

_CHUNK = 100  # rows over which a first interval is taken
_FIRST_ROWS = 2000  # whose phase is looked for
_FEW_ROWS = 50
_WIDEST = 0.06  # that the first interval may be off by
_REACH = 512  # rows that are looked at together
_LOCAL = 50  # rows among which the one before a missing one is looked for
_COARSE = 0.05  # of an interval: with stamps rounded by more the places tell the time better
_TOO_COARSE = 0.8  # of an interval: stamps rounded by more have no phase
_STEPS = (1.0, 0.5, 0.2, 0.1)
_LONGEST_STEP = 100_000  # of the stamps' grid, that an interval is looked for among
_NO_CLOCK = (
    "too many rows are missing, or the time stamps are too coarse, to tell the interval of the output: give its "
    "rate with the option or setting output_rate_hz, or a counter beside the output"
)
_BEYOND_STEPS = 2.5  # of the stamps, by which a line through them may miss the stamps
_FEW_STAIRS = 3  # places that are skipped evenly, from which on they are no missing rows
_BESIDE, _APART = 100, 10  # rows that a step of the clock is seen by, and those nearest to it
_LEAST_STEP, _LARGEST_STEP, _COARSEST = 0.2, 0.75, 0.4  # such a step, and stamps with it, in intervals
_NO_CHANCE = 8.0  # logarithm by which a line in where they are exceeds what chance makes


@dataclass(frozen=True)
class LogClock:
    """Place of each row on the gyro's clock."""

    interval_s: float  # between two outputs
    places: Places  # (n,): Intervals since the first row
    regular: bool  # whether the stamps are so coarse that `places` tell the time better than they do


def clock_of_counter(counter: Floats) -> Places:
    """Intervals since the first row by a counter, over its wraps; ValueError at a row where it stands still."""
    numbers = np.round(counter).astype(np.int64)
    steps = np.diff(numbers)
    if np.any(steps < 0):
        largest = int(numbers.max())
        # most wraps go on by one step if the counter begins again behind its largest
        behind, up = np.flatnonzero(steps < 0), steps[steps > 0]
        usual = np.median((numbers[behind + 1] - numbers[behind]) % (largest + 1)) if largest > 0 else 0
        modulus = largest + 1 if up.size and usual == np.median(up) else 1 << largest.bit_length()
        steps = steps % modulus
    if np.any(steps == 0):
        raise ValueError(str(int(np.flatnonzero(steps == 0)[0]) + 1))
    each = int(np.median(steps))
    if each > 1 and not np.any(steps % each):
        steps //= each
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def line_through(places: Places, times: Floats) -> float:
    """Slope of the straight line through the time stamps, s per interval."""
    centred = places - places.mean()
    return float(centred @ (times - times.mean()) / (centred @ centred))


def find_clock(times: Floats, interval_s: float | None) -> LogClock:
    """Find interval and missing rows."""
    rows = np.arange(times.size, dtype=np.int64)
    step = _rounding(times)
    on_grid = _on_a_grid(times, step)
    if on_grid is not None:
        interval, places = on_grid
        each = _rows_apart(interval, interval_s)
        return LogClock(interval / each, each * places, False)
    slope = line_through(rows, times)
    off = float(np.ptp(times - times.mean() - slope * (rows - rows.mean())))
    if off <= 1.1 * step + 1e-9 * slope:  # a saw tooth about the line through it
        each = _rows_apart(slope, interval_s)
        return LogClock(slope / each, each * rows, bool(off > 1e-6 * slope and step > _COARSE * slope))
    found = _first_interval(times)
    each = _rows_apart(found, interval_s)
    if times.size < _FEW_ROWS:
        places = np.concatenate([[0], np.cumsum(np.maximum(np.round(np.diff(times) / (found / each)), 1))])
        return LogClock(line_through(places.astype(np.int64), times), places.astype(np.int64), False)
    if step > _TOO_COARSE * found and abs(found / step - 1) > 1e-3:
        places = _within_bounds(times, step, found)
        interval = line_through(places, times)
        if float(np.ptp(times - interval * places)) > _BEYOND_STEPS * step:
            return _by_stated_rate(times, interval_s)
        return LogClock(interval / each, each * places, True)
    places = _in_phase(times, found / each)
    interval = line_through(places, times)
    late = times - interval * places
    if float(np.median(np.abs(late - np.median(late)))) > 0.5 * (step + interval):
        return _by_stated_rate(times, interval_s)
    clear = step <= _COARSE * interval and float(np.abs(times - interval * places).max()) < 0.25 * interval
    return LogClock(interval, places, not clear)


def step_of_clock(times: Floats, clock: LogClock) -> tuple[int, float] | None:
    """The row before which the clock was set, and by what beside whole intervals, s; ``None`` if none is seen."""
    width, rounding = _BESIDE + _APART, _rounding(times)
    if times.size < 4 * width or rounding > _COARSEST * clock.interval_s:
        return None
    late = times - clock.interval_s * clock.places
    sums = np.concatenate([[0.0], np.cumsum(late - late.mean())])
    means = (sums[_BESIDE:] - sums[:-_BESIDE]) / _BESIDE  # of so many rows from each on
    steps = means[width + _APART :] - means[: -width - _APART]
    least = max(
        _LEAST_STEP * clock.interval_s, 1.5 * rounding, _NO_CHANCE * 1.4826 * float(np.median(np.abs(steps)))
    )
    middle = int(np.abs(steps).argmax())
    if abs(steps[middle]) < least:
        return None
    inside = np.arange(middle + _BESIDE, middle + _BESIDE + 2 * _APART + 1)  # the row is one of these
    nearer = np.abs(np.diff(late))[inside[:-1]]
    row, before, behind = (
        int(inside[nearer.argmax()]) + 1,
        late[middle : middle + _BESIDE],
        late[inside[-1] :][:_BESIDE],
    )
    size = float(np.median(behind) - np.median(before))
    # rows that came late for a while are no step, nor is a missing row that is taken for another
    seen = least < abs(size) < _LARGEST_STEP * clock.interval_s and abs(size - steps[middle]) < least / 2
    return (row, size) if seen else None


def _by_stated_rate(times: Floats, interval_s: float | None) -> LogClock:
    """Places by an interval that is stated, where the stamps do not tell it; FileFormatError without one."""
    if interval_s is None:
        raise FileFormatError(_NO_CLOCK)
    rows = np.arange(times.size, dtype=np.int64)
    ahead = np.round(times / interval_s).astype(np.int64) - rows
    return LogClock(interval_s, np.maximum.accumulate(np.maximum(ahead, 0)) + rows, True)


def _rounding(times: Floats) -> float:
    """Step that all time stamps are whole multiples of, s; 0 if they are finer than 1 us."""
    sample = times[:1000]
    for power in range(7):
        for part in _STEPS:
            step = part * 10.0**-power
            if all(np.all(np.abs(some / step - np.round(some / step)) < 1e-3) for some in (sample, times)):
                return step
    return 0.0


def _on_a_grid(times: Floats, step: float) -> tuple[float, Places] | None:
    """Interval and places where all stamps are whole multiples of the interval, and rows are missing."""
    if not step:
        return None
    numbers = np.round(times / step).astype(np.int64)
    steps = np.diff(numbers)
    usual = int(np.bincount(np.clip(steps, 0, _LONGEST_STEP)).argmax())
    if usual < 1 or steps.min() < 1 or np.any(steps % usual) or not np.mean(steps == usual) > 0.5:
        return None
    places = (numbers - numbers[0]) // usual
    # An interval a little longer than the grid skips a place of it now and then, but as evenly as stairs; rows are
    # missing here and there.
    between = np.diff(places[1:][steps > usual])
    even = between.size >= _FEW_STAIRS and np.mean(np.abs(between - np.median(between)) <= 1) > 0.5
    skipped = (steps == 2 * usual).astype(np.float64)  # row by row: a pause is no stair
    lines = np.abs(np.fft.rfft(skipped)[1:]) ** 2 / max(skipped.sum(), 1.0)
    if even or (lines.size and lines.max() > np.log(lines.size) + _NO_CHANCE):
        return None
    return usual * step, places


def _first_interval(times: Floats) -> float:
    """Interval to a few per cent, from rows so far apart that their rounding counts little."""
    if times.size < _FEW_ROWS:
        steps = np.diff(times)
        return float(np.median(steps[steps > 0]))
    count = min(_CHUNK, times.size // 4)
    spans = np.sort((times[count:] - times[:-count]) / count)
    # missing rows make a span longer, so the shorter half is nearer to the truth
    return float(spans[: max(1, spans.size // 2)].mean())


def _rows_apart(found: float, stated: float | None) -> int:
    """Intervals from row to row: more than one where the output is stated to come more often than the rows do."""
    times = round(found / stated) if stated is not None else 1
    return times if stated is not None and times >= 2 and abs(found / stated / times - 1) < 0.05 else 1


def _in_phase(times: Floats, interval: float) -> Places:
    """Places by the phase of the stamps, which no missing row shifts: first a few of them, then ever more."""
    # those before a long pause: there are as many trials as intervals
    count = max(min(_FIRST_ROWS, int(np.searchsorted(times, 10 * _FIRST_ROWS * interval))), _FEW_ROWS)
    some = times[:count]
    if some[-1] > 20 * _FIRST_ROWS * interval:
        raise FileFormatError(_NO_CLOCK)
    trials = 1 / interval * (1 + np.arange(-_WIDEST, _WIDEST, 0.2 * interval / max(float(some[-1]), interval)))
    strength = np.array([abs(np.exp(2j * np.pi * trial * some).sum()) for trial in trials])
    frequency = float(trials[int(np.argmax(strength))])
    phase = float(np.angle(np.exp(2j * np.pi * frequency * some).sum())) / (2 * np.pi)
    while True:
        turns = frequency * times[:count] - phase
        places = np.round(turns).astype(np.int64)
        rows = np.arange(count)
        # a stamp that came late is followed by one in time
        missing = np.minimum.accumulate((places - rows)[::-1])[::-1]
        places = np.maximum.accumulate(missing) + rows
        on_time = np.abs(turns - places) < 0.5
        slope = line_through(places[on_time], times[:count][on_time])
        first = float(times[:count][on_time].mean() - slope * places[on_time].mean())
        frequency, phase = 1 / slope, first / slope
        if count == times.size:
            return np.asarray(places - places[0], dtype=np.int64)
        count = min(4 * count, times.size)


def _within_bounds(times: Floats, step: float, first: float) -> Places:
    """Places where stamps are rounded to more than their interval: they keep within one step of a line."""
    interval = _quiet_slope(times, step, first)
    missing = np.zeros(times.size, dtype=np.int64)
    late = times - interval * np.arange(times.size)
    allowed = 1.02 * step + 1e-3 * interval
    begin = 0
    # what is missing puts all behind it a step back; more such places than rows are no clock
    tries = 2 * times.size if interval > 0 else 0
    while begin < times.size - 1 and tries:
        tries -= 1
        part = late[begin : begin + _REACH]
        late_by = part - np.minimum.accumulate(part) - allowed
        above = late_by > 0
        if not above.any():
            begin += max(1, min(_REACH // 2, part.size))
            continue
        last = begin + int(np.argmax(above))
        before = max(begin + 1, last - _LOCAL)
        around = late[max(0, before - _LOCAL) : last + _LOCAL]
        rows = np.arange(max(0, before - _LOCAL), max(0, before - _LOCAL) + around.size)
        spreads = [float(np.ptp(around - interval * (rows >= at))) for at in range(before, last + 1)]
        at = before + int(np.argmin(spreads))
        number = max(1, int(late_by[last - begin] // interval))
        missing[at] += number
        late[at:] -= number * interval
    return np.arange(times.size) + np.cumsum(missing)


def _quiet_slope(times: Floats, step: float, first: float) -> float:
    """Interval from the longest stretches in which no row is missing."""
    for length in (8192, 2048, 512, 128):
        slopes = []
        for begin in range(0, times.size - length + 1, length):
            part, rows = times[begin : begin + length], np.arange(length, dtype=np.int64)
            slope = line_through(rows, part)
            if np.ptp(part - slope * rows) <= 1.05 * step:
                slopes.append(slope)
        if slopes:
            return float(np.median(slopes))
    return first
