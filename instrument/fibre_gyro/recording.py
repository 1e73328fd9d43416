"""One recording out of frames: its time by counter and host clock, what is missing, its columns."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from instrument.errors import SettingError
from instrument.fibre_gyro.frame_fields import (
    ANGLE_UNITS,
    COUNTS,
    RATE_UNITS,
    STATUS,
    TEMPERATURE,
    CounterRule,
    Field,
    FieldQuantity,
)
from instrument.fibre_gyro.frame_format import FrameFormat
from instrument.fibre_gyro.frame_stream import Damage, Event
from instrument.fibre_gyro.frames import ONE_CHARACTER, STANDS_OUT, Frame, doubts_about

HOST_DELAY_S = 0.5
"""How much sooner than another a frame can come through a USB adapter and the host's own buffers."""


@dataclass(frozen=True)
class Tick:
    """Place of a frame in time."""

    index: int  # intervals since the first frame
    cause: str = ""  # of the gap before the frame; empty if there is none


class CounterClock:
    """Counts intervals from frame to frame, over wraps of the counter and over frames that are missing."""

    def __init__(self, rule: CounterRule | None, interval_s: float) -> None:
        self._rule, self._interval_s = rule, interval_s
        self._last: int | None = None
        self._index = 0
        self._last_host_s = 0.0
        self._lead_s = 0.0  # most that the gyro's time was ahead of the host's since the first frame
        self._first_host_s = 0.0

    def place(self, counter: int | None, *, host_s: float, silent_s: float, damaged: int) -> Tick | None:
        """Place the next frame."""
        if self._last is None:
            self._first_host_s = host_s
            return self._keep(0, counter, host_s, "")
        if self._rule is None or counter is None:
            heard = silent_s < HOST_DELAY_S / 2 + 3 * self._interval_s  # frames often come several at once
            passed = 1 + (damaged if heard else max(damaged, round(silent_s / self._interval_s) - 1))
            return self._keep(passed, counter, host_s, self._without_counter(passed, damaged))
        ticks = (counter - self._last) % self._rule.modulus
        # what was silent, or came damaged, may be more than the counter can tell
        unseen = max(silent_s / self._interval_s, (1 + damaged) if damaged else 0) * self._rule.per_frame
        ticks += max(0, round((unseen - ticks) / self._rule.modulus)) * self._rule.modulus
        if ticks == 0:
            return None
        passed, rest = divmod(ticks, self._rule.per_frame)
        # more than can have been sent since the one before: the counter was set anew
        lead_s = (self._index + passed) * self._interval_s - (host_s - self._first_host_s)
        if rest or (passed > 1 and lead_s > self._lead_s + HOST_DELAY_S):
            passed = max(1, round((host_s - self._last_host_s) / self._interval_s))
            return self._keep(passed, counter, host_s, "counter jump")
        return self._keep(passed, counter, host_s, "frames lost" if passed > 1 else "")

    @staticmethod
    def _without_counter(passed: int, damaged: int) -> str:
        if passed == 1:
            return ""
        return "frames lost" if passed == damaged + 1 else "silence"

    def _keep(self, passed: int, counter: int | None, host_s: float, cause: str) -> Tick:
        self._index += passed
        self._last = -1 if counter is None else counter
        self._last_host_s = host_s
        self._lead_s = max(self._lead_s, self._index * self._interval_s - (host_s - self._first_host_s))
        return Tick(self._index, cause)


_WORST_LAST = ("", "frames lost", "silence", "counter jump")
_APPROXIMATE = ("silence", "counter jump")


class RecordBuilder:
    """Takes events until the time that was asked for is over."""

    def __init__(self, layout: FrameFormat, skip: int, wanted: int, *, paced: bool = False) -> None:
        self._layout, self._skip, self._wanted, self._paced = layout, skip, wanted, paced
        self._clock = CounterClock(layout.counter, layout.interval_s)
        self._arrivals = Arrivals()
        self._places: list[int] = []  # intervals since the begin of the recording
        self._rows: list[tuple[float, ...]] = []
        self._counters: list[int] = []
        self._gaps: list[_Missing] = []
        self._damaged_before, self._silent_s = 0, 0.0  # since the last frame
        self._cause = ""
        self._behind: tuple[list[Event], float] = ([], 0.0)  # came with the last one that was wanted
        self._standing = ""  # what the last status said that takes turns with others
        self._polled_counter: int | None = None
        self._exact = True  # whether all places are exact
        self._damaged = self._unusable = 0
        self._reasons: Counter[str] = Counter()
        self.index = -1
        self.done = False

    def take(self, events: list[Event], *, host_s: float, silent_s: float, polled: int | None = None) -> None:
        """Take what came at `host_s` (s of the gyro's time), or nothing for `silent_s`; or in answer to a poll."""
        self._silent_s += silent_s
        before = self.index
        for number, event in enumerate(events):
            if self.done:
                self._behind = events[number:], host_s
                return
            if isinstance(event, Damage):
                self._damaged_before += event.frames
                if self.index >= self._skip - 1:
                    self._damaged += event.frames
                    self._reasons[event.reason] += event.frames
            elif isinstance(event, Frame):
                self._take_frame(event, host_s, polled)
        if self._paced and self._exact and self.index > before:
            self._arrivals.add(self.index, host_s)

    def pass_over(self, polled: int) -> None:
        """Note that a poll was not answered."""
        self.index = max(self.index, polled)
        self.done = self.index - self._skip >= self._wanted - 1

    def extend(self, wanted: int) -> None:
        """Record more intervals than were asked for first."""
        self._wanted = max(self._wanted, wanted)
        self.done = self.index - self._skip >= self._wanted - 1
        if not self.done:
            (events, host_s), self._behind = self._behind, ([], 0.0)
            self.take(events, host_s=host_s, silent_s=0.0)

    def host_clock(self) -> HostClock | None:
        """The gyro's clock beside the computer's so far."""
        return self._arrivals.clock(self._layout.interval_s) if self._paced else None

    def recording(
        self, discarded_bytes: int, *, output: str = COUNTS, counts_per_dps: float | None = None
    ) -> Recording:
        """What was recorded; call it when it is done."""
        self._close_gap(self._wanted)
        clock = self.host_clock()
        if clock is not None and self._layout.unit in ANGLE_UNITS:
            clock = replace(clock, used=True)  # the interval is a factor of the rate, whatever its error is
        step = clock.interval_s if clock is not None and clock.used else self._layout.interval_s
        columns = columns_of(
            self._layout, self._rows, self._counters, interval_s=step, counts_per_dps=counts_per_dps
        )
        counts, temperature = columns[output], columns.pop(TEMPERATURE, None)
        if len(self._layout.outputs) == 1:
            del columns[output]
        status = columns.pop(STATUS, None)
        if status is not None and not np.all(np.isfinite(status)):
            status = None
        gaps = tuple(
            Gap(gap.after, gap.missing_from * step, gap.missing * step, gap.missing, gap.cause)
            for gap in self._gaps
        )
        missing = sum(gap.missing for gap in gaps)
        by_frames = "counter" if self._layout.has_counter else "frames"
        return Recording(
            times=np.array(self._places, dtype=np.float64) * step,
            counts=counts,
            temperature=temperature,
            status=None if status is None else status.astype(np.int64),
            extra=columns,
            gaps=gaps,
            losses=Losses(
                len(self._rows), missing, self._damaged, self._unusable, discarded_bytes, dict(self._reasons)
            ),
            interval_s=step,
            clock="polls" if self._layout.poll is not None else by_frames,
            host_clock=clock,
            doubts=doubts_about(self._layout, self._rows),
        )

    def _take_frame(self, frame: Frame, host_s: float, polled: int | None) -> None:
        tick: Tick | None
        if polled is not None:
            # asked twice before the gyro had made another output
            again = frame.counter is not None and frame.counter == self._polled_counter
            self._polled_counter = frame.counter
            tick = None if again else Tick(polled, "frames lost" if polled > self.index + 1 else "")
            self.index = polled
        else:
            tick = self._clock.place(
                frame.counter, host_s=host_s, silent_s=self._silent_s, damaged=self._damaged_before
            )
        self._damaged_before, self._silent_s = 0, 0.0
        if tick is not None:
            self.index = tick.index
            self._cause = max(self._cause, tick.cause, key=_WORST_LAST.index)
            self._exact = self._exact and tick.cause not in _APPROXIMATE
        if frame.standing is not None:
            self._standing = frame.standing
        place = self.index - self._skip
        self.done = place >= self._wanted - 1
        if not 0 <= place < self._wanted:
            return
        problem = frame.problem or self._standing if tick is not None else "counter stands still"
        if problem:
            self._unusable += 1
            self._reasons[problem] += 1
            return
        self._close_gap(place)
        self._places.append(place)
        self._rows.append(frame.values)
        if self._layout.turning is not None:
            self._counters.append(frame.counter or 0)

    def _close_gap(self, place: int) -> None:
        """Note the gap between the last output and `place`, if there is one."""
        begin = self._places[-1] + 1 if self._places else 0
        if place > begin:
            after = len(self._places) - 1
            self._gaps.append(_Missing(after, begin, place - begin, self._cause or "frames lost"))
        self._cause = ""


@dataclass(frozen=True)
class _Missing:
    """A gap in intervals: how long one is, is known at the end."""

    after: int
    missing_from: int
    missing: int
    cause: str


# --------------------
# The output of a fibre gyro over some time: columns, and what is missing in them


Floats = NDArray[np.float64]

_ANOTHER_DIGIT = 3 / 5
"""A flipped bit makes another digit of a digit in 3 cases of 8 and something that is none in 5."""


@dataclass(frozen=True)
class Gap:
    """A place where outputs are missing."""

    after: int  # index of the last output before it, -1 if the first ones are missing
    start_s: float  # time of the first output that is missing, and how long they would have lasted
    duration_s: float
    missing: int  # outputs that are missing
    # "frames lost"; "counter jump": the counter went on where it could not, its length is that of the host's clock
    # and approximate; "silence": frames are not counted, the length is approximate; "rows missing"
    cause: str

    def describe(self) -> str:
        """Say it in a few words."""
        about = "about " if self.cause in ("counter jump", "silence") else ""
        outputs = "1 output" if self.missing == 1 else f"{self.missing} outputs"
        return f"{self.cause}: {about}{outputs} missing {self.start_s:.6g} s after the begin"


@dataclass(frozen=True)
class Losses:
    """What became of the frames of a recording or of a whole session."""

    good: int = 0  # frames that were used
    # frames that the clock says were sent and that were not used; damaged and unusable ones are among them
    missing: int = 0
    damaged: int = 0  # frames that came damaged; in frame lengths where more than one in succession was unreadable
    # frames that came whole, but with a bad status, a value out of range or a counter that stood still
    unusable: int = 0
    discarded_bytes: int = 0  # bytes that belong to no whole frame
    reasons: dict[str, int] = field(default_factory=dict)  # why frames were damaged or unusable

    def __add__(self, other: Losses) -> Losses:
        """The losses of both."""
        return Losses(
            self.good + other.good,
            self.missing + other.missing,
            self.damaged + other.damaged,
            self.unusable + other.unusable,
            self.discarded_bytes + other.discarded_bytes,
            dict(Counter(self.reasons) + Counter(other.reasons)),
        )

    @property
    def unseen_digits(self) -> float:
        """Good lines in which, by what was seen, a digit was changed into another; text without a checksum."""
        changed = _ANOTHER_DIGIT * self.reasons.get(ONE_CHARACTER, 0)
        return max(0.0, changed - self.reasons.get(STANDS_OUT, 0))

    def describe(self) -> str:
        """Say it in one clause."""
        if not (self.missing or self.damaged or self.unusable):
            return f"{self.good} frames, none lost"
        why = ", ".join(f"{count} {reason}" for reason, count in sorted(self.reasons.items()))
        parts = (
            f"{self.good} frames used, {self.missing} missing, {self.damaged} damaged, {self.unusable} unusable"
        )
        return f"{parts} ({why})" if why else parts


@dataclass(frozen=True)
class HostClock:
    """The gyro's clock beside the computer's, over one recording."""

    stated_s: float  # interval between two outputs by the description of the frames, or by the polls
    # by the computer's clock, and its standard uncertainty, that of the computer's clock included
    interval_s: float
    interval_u_s: float
    # whether `interval_s` is that of the recording: it differs by more than its uncertainty lets expect
    used: bool

    @property
    def difference_ppm(self) -> float:
        """How much faster the gyro's clock runs than stated, ppm of the output rate."""
        return 1e6 * (self.stated_s / self.interval_s - 1)

    @property
    def u_ppm(self) -> float:
        """Standard uncertainty of `difference_ppm`."""
        return 1e6 * self.interval_u_s / self.interval_s

    @property
    def output_rate_hz(self) -> float:
        """Outputs per second of the computer's clock."""
        return 1 / self.interval_s

    def __str__(self) -> str:
        """Say it in a few words."""
        rate = math.floor(math.log10(max(self.u_ppm, 1e-3)))
        digits = max(0, 1 - rate)
        return f"{self.difference_ppm:+.{digits}f} ppm (u {self.u_ppm:.{digits}f} ppm)"


@dataclass(frozen=True, eq=False)
class Recording:
    """Outputs of a gyro in the order in which they were made."""

    times: Floats  # s since the begin of the recording by the gyro's own clock, gaps included
    counts: Floats  # the output as the gyro gives it
    temperature: Floats | None  # as the format scales it, usually deg C
    status: NDArray[np.int64] | None
    extra: dict[str, Floats]  # further columns by name
    gaps: tuple[Gap, ...]
    losses: Losses
    interval_s: float  # time between two outputs
    # what `times` rests on: "counter", "frames" (arrival of frames without a counter, gaps approximate), "polls"
    # (the computer asked for each output) or "time column"
    clock: str
    host_clock: HostClock | None = None  # none where nothing was recorded live, or for too short a time
    # what of the numbers shows that the description of the frames may be wrong; sentences
    doubts: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first output to the end of the last in s, gaps included; 0 without any."""
        return float(self.times[-1] - self.times[0]) + self.interval_s if self.times.size else 0.0

    @property
    def complete(self) -> bool:
        """Whether nothing is missing from its begin to its end."""
        return not self.gaps

    def part(self, first: int, end: int) -> Recording:
        """The outputs from one to before another, with the gaps between them; times begin at 0."""
        rows, zero = slice(first, end), float(self.times[first])
        gaps = tuple(
            replace(gap, after=gap.after - first, start_s=gap.start_s - zero)
            for gap in self.gaps
            if first <= gap.after < end - 1
        )
        return replace(
            self,
            times=self.times[rows] - zero,
            counts=self.counts[rows],
            temperature=None if self.temperature is None else self.temperature[rows],
            status=None if self.status is None else self.status[rows],
            extra={name: values[rows] for name, values in self.extra.items()},
            gaps=gaps,
            losses=replace(self.losses, good=self.times[rows].size, missing=sum(gap.missing for gap in gaps)),
        )


# --------------------
# The gyro's clock beside the computer's: when frames came, and what interval they were sent at.
#
# A frame never comes early. A USB adapter, the operating system and this program hold it back, some milliseconds
# as a rule and now and then much longer; so all arrivals lie above the line of those that were not held back. That
# line is the one that no arrival lies below and that is nearest to all of them: an edge of their lower convex
# hull. A stall of the computer, even at the end, only lifts points off it. (S. B. Moon, P. Skelly, D. Towsley,
# "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999.)
#
# What does not show: frames that keep step with an adapter's timer are all held back alike, and drift by a part of
# its period without a trace


NOT_WORTH_PPM = 200.0
"""Differences below this change no result; the stated rate, which belongs to the gyro, is kept."""

WRONG = 0.1  # no oscillator is off by a tenth: then the description of the frames is wrong

HOST_CLOCK_U = 5e-5 / 3**0.5
"""Relative, of the computer's clock: its crystal within 50 ppm, corrected by a time server or not."""

_FEWEST = 16  # arrivals
_BLOCKS = 512  # of which the earliest arrival is kept
_GROUPS = 16  # that say how far from the line the earliest arrivals lie
_WORST_U = 0.05  # of the interval; a line that says less says nothing
_SIGNIFICANT = 4.0  # standard uncertainties
_BEAT_S = 0.018  # frames beat with the reads of 20 ms and an adapter's 16 ms, by so much or one interval at most
_ADAPTER_S = 0.016  # a USB adapter hands over what it has so often
_PLACES = 20_000  # frames whose places in that period are looked at
_BEATS = 100  # arrivals in which a beat shows as what it is; in fewer it may look like a slope


class Arrivals:
    """When the last frame of each piece came that was read."""

    def __init__(self) -> None:
        self._index: list[int] = []
        self._host_s: list[float] = []

    def add(self, index: int, host_s: float) -> None:
        """Note that the frame `index` intervals after the first came by `host_s`, s."""
        self._index.append(index)
        self._host_s.append(host_s)

    def clock(self, stated_s: float) -> HostClock | None:
        """The clocks compared; None if too few frames came, or over too short a time."""
        if len(self._index) < _FEWEST or self._index[-1] == self._index[0]:
            return None
        index, host = np.array(self._index, dtype=np.float64), np.array(self._host_s)
        interval, u = _earliest_line(index - index[0], host - host[0])
        if not (np.isfinite(u) and interval > 0 and u < _WORST_U * interval):
            return None
        u = float(np.hypot(u, HOST_CLOCK_U * interval))
        off = abs(stated_s / interval - 1)
        used = bool(off > 1e-6 * NOT_WORTH_PPM and off > _SIGNIFICANT * u / interval)
        return HostClock(stated_s, interval, u, used)


def _earliest_line(index: Floats, host: Floats) -> tuple[float, float]:
    """Slope of the line below all arrivals that is nearest to them, and its standard uncertainty."""
    slope = float(np.polyfit(index, host, 1)[0])
    late = host - slope * index
    edges = np.unique(np.linspace(0, index.size, min(_BLOCKS, index.size) + 1).astype(np.intp))[:-1]
    ends = np.append(edges[1:], index.size)
    first = np.array([a + int(np.argmin(late[a:b])) for a, b in zip(edges, ends, strict=True)])
    x, y = index[first], late[first]
    hull = _lower_hull(x, y)
    middle = float(index.mean())
    right = min(max(int(np.searchsorted(x[hull], middle)), 1), len(hull) - 1)
    a, b = hull[right - 1], hull[right]
    edge = float((y[b] - y[a]) / (x[b] - x[a]))
    above = y - y[a] - edge * (x - x[a])
    # as far from the line as the earliest arrivals of a stretch lie, the line itself may be off at its ends
    groups = [part.min() for part in np.array_split(above, min(_GROUPS, above.size // 2))]
    off = float(np.median(groups)) + float(np.ptp(np.sort(groups)[: max(2, len(groups) // 2)]))
    span = float(index[-1] - index[0])
    off = max(off, min(_BEAT_S, slope) * min(1.0, _BEATS / index.size))
    # hidden is the widest part of the adapter's period in which no frame comes: all may drift by anything up to it
    places = np.sort(np.mod((slope + edge) * np.arange(min(int(span), _PLACES)), _ADAPTER_S))
    hidden = float(np.max(np.diff(places, append=places[0] + _ADAPTER_S))) / np.sqrt(3.0)
    return slope + edge, float(np.hypot(2 * off, hidden)) / span


def _lower_hull(x: Floats, y: Floats) -> list[int]:
    """Places of the points of the lower convex hull, from left to right; `x` rises."""
    hull: list[int] = []
    for place in range(x.size):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[place] - x[a]) < (y[place] - y[a]) * (x[b] - x[a]):
                break
            hull.pop()
        if not hull or x[place] > x[hull[-1]]:
            hull.append(place)
        elif y[place] < y[hull[-1]]:
            hull[-1] = place
    return hull


# --------------------
# From the numbers of frames to the columns of a recording: outputs in counts, and what came with them


def columns_of(
    layout: FrameFormat,
    rows: Sequence[tuple[float, ...]],
    counters: Sequence[int],
    *,
    interval_s: float,
    counts_per_dps: float | None,
) -> dict[str, Floats]:
    """All columns by name, outputs in counts; quantities that take turns hold until they come again."""
    table = np.array(rows, dtype=np.float64).reshape(-1, len(layout.names))
    columns: dict[str, Floats] = dict(zip(layout.names, table.T.copy(), strict=True))
    turning = layout.turning
    if turning is not None:
        raw = columns.pop(turning.name)
        for quantity in turning.quantities:
            columns[quantity.name] = _in_turn(turning, quantity, raw, np.array(counters, dtype=np.int64))
    scale = counts_per_unit(layout.unit, interval_s, counts_per_dps)
    if scale != 1.0:
        for name in layout.outputs:
            columns[name] *= scale
    return columns


def counts_per_unit(unit: str, interval_s: float, counts_per_dps: float | None) -> float:
    """Counts for one unit of the output; parameters and errors as `columns_of`."""
    if unit == COUNTS:
        return 1.0
    if counts_per_dps is None:
        raise SettingError(f"the output is in {unit}: say how many counts 1 deg/s is")
    return counts_per_dps * (RATE_UNITS[unit] if unit in RATE_UNITS else ANGLE_UNITS[unit] / interval_s)


def _in_turn(turning: Field, quantity: FieldQuantity, raw: Floats, counters: NDArray[np.int64]) -> Floats:
    """A quantity at every row: the last one that came whole, before the first the first."""
    turn, phase = np.divmod(counters, turning.cycle)
    turn = np.cumsum(np.concatenate([[0], np.diff(turn) != 0])) if turn.size else turn
    size = turning.size
    parts = [
        dict(zip(turn[phase == one].tolist(), np.flatnonzero(phase == one).tolist(), strict=True))
        for one in quantity.phases
    ]
    whole = sorted(set(parts[0]).intersection(*parts[1:]))
    found = np.full(raw.size, np.nan)
    for number in whole:
        places = [part[number] for part in parts]
        value = sum(int(raw[place]) << (8 * size * rank) for rank, place in enumerate(places))
        found[max(places)] = _number(value, 8 * size * len(parts), quantity)
    known = np.flatnonzero(np.isfinite(found))
    if known.size == 0:
        return found
    held = known[np.maximum(np.searchsorted(known, np.arange(raw.size), side="right") - 1, 0)]
    return np.asarray(found[held])


def _number(value: int, bits: int, quantity: FieldQuantity) -> float:
    if quantity.kind == "float":
        number = float(np.array(value, dtype=np.uint32).view(np.float32))
    elif quantity.kind == "signed" and value >> (bits - 1):
        number = float(value - (1 << bits))
    else:
        number = float(value)
    return number * quantity.scale + quantity.offset
