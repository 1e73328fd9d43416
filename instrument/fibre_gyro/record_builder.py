"""Makes one recording out of what the stream gives: its time by the counter of the frames, and what is missing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from instrument.fibre_gyro.columns import ANGLES, columns_of
from instrument.fibre_gyro.frame_format import COUNTS, STATUS, TEMPERATURE, FrameFormat
from instrument.fibre_gyro.frame_format.fields import CounterRule
from instrument.fibre_gyro.frame_stream import Damage, Event
from instrument.fibre_gyro.frames import Frame
from instrument.fibre_gyro.host_clock import Arrivals
from instrument.fibre_gyro.meaning import doubts_about
from instrument.fibre_gyro.recording import Gap, HostClock, Losses, Recording

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
        if rest or self._is_ahead(passed, host_s):
            passed = max(1, round((host_s - self._last_host_s) / self._interval_s))
            return self._keep(passed, counter, host_s, "counter jump")
        return self._keep(passed, counter, host_s, "frames lost" if passed > 1 else "")

    @staticmethod
    def _without_counter(passed: int, damaged: int) -> str:
        if passed == 1:
            return ""
        return "frames lost" if passed == damaged + 1 else "silence"

    def _is_ahead(self, passed: int, host_s: float) -> bool:
        """Whether that many frames cannot have been sent since the one before: the counter was set anew."""
        lead_s = (self._index + passed) * self._interval_s - (host_s - self._first_host_s)
        return passed > 1 and lead_s > self._lead_s + HOST_DELAY_S

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
                self._take_damage(event)
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
        if clock is not None and self._layout.unit in ANGLES:
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
            clock=self._kind_of_clock(),
            host_clock=clock,
            doubts=doubts_about(self._layout, self._rows),
        )

    def _kind_of_clock(self) -> str:
        if self._layout.poll is not None:
            return "polls"
        return "counter" if self._layout.has_counter else "frames"

    def _in_window(self) -> bool:
        return self.index >= self._skip - 1

    def _take_damage(self, damage: Damage) -> None:
        self._damaged_before += damage.frames
        if self._in_window():
            self._damaged += damage.frames
            self._reasons[damage.reason] += damage.frames

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
