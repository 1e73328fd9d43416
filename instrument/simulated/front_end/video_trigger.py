"""Looks for the sync pulses of a composite video signal: any line, one line, any field, the odd or the even one.

A sync pulse points down (with POLARITY INVERT up) below the picture. Short ones begin lines, the first broad one
begins a field; it comes a whole number of lines after the last line's pulse in the odd field, and half a line more
in the even one, in both standards. Source: ITU-R BT.1700 (525 and 625 lines).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from instrument.simulated.front_end.comparator import Comparator
from instrument.simulated.front_end.frontend import Floats
from instrument.simulated.front_end.trigger import refine
from instrument.simulated.panel.panel import TriggerSettings

LINE_TIMES = {"NTSC": 1.001 / 15_750, "PAL": 64e-6}  # s
LINES = {"NTSC": 525, "PAL": 625}
FIRST_BROAD_LINE = {"NTSC": 4, "PAL": 1}  # number of the line that begins with the odd field's first broad pulse
SYNC_PART = 0.15  # of the whole height, where the sync is cut off: half of its 0.3
BROAD, EQUALISING = 12e-6, 3.5e-6  # s; line pulses have 4.7 us, equalising ones 2.35 us, broad ones 27 us
_STEP = 0.4e-6  # s
_CHUNK = 25_000  # samples, 10 ms: half a field shows the height of the signal
_LONGEST_LOOK = 0.09  # s: two frames and more; of a longer time only the end is looked at


@dataclass
class VideoSearch:
    """A search that goes on where it stopped."""

    trigger: TriggerSettings  # sync, polarity, line and standard
    volts_at: Comparator  # volts of the source at given absolute times (rising)
    smallest: float  # height in V below which there is no video signal
    searched_until: float  # absolute time in s up to which there was nothing
    _began: float | None = None  # start of the pulse that is under way
    _last_start: float = -np.inf  # of any short pulse that begins a line or half of one
    _last_line: float = -np.inf  # of the last pulse as wide as those of lines
    _in_broad: bool = False
    _wanted_at: float = field(default=np.inf)  # time of the wanted line, counted from the odd field

    def advance(self, until: float) -> float | None:
        """Search on to `until`; the time of the edge of the wanted sync pulse, or None."""
        self.searched_until = max(self.searched_until, until - _LONGEST_LOOK)
        if until > self.searched_until and self.volts_at.interval(self.searched_until, until) > BROAD:
            self.searched_until = until  # so smooth a signal has no sync pulses
            return None
        while self.searched_until < until:
            count = min(_CHUNK, int((until - self.searched_until) / _STEP) + 1)
            times = self.searched_until + _STEP * np.arange(count + 1, dtype=np.float64)
            times[-1] = min(times[-1], until)
            found = self._sync_in(times)
            if found is not None:
                return found
            self.searched_until = float(times[-1])
        return None

    def _upright(self, times: Floats) -> Floats:
        volts = self.volts_at(times)
        return -volts if self.trigger.video_inverted else volts

    def _sync_in(self, times: Floats) -> float | None:
        volts = self._upright(times)
        low, high = float(volts.min()), float(volts.max())
        if high - low < self.smallest:
            self._began = None
            return None
        level = low + SYNC_PART * (high - low)
        below = volts < level
        for index in np.flatnonzero(np.diff(below.astype(np.int8))):
            falls = bool(below[index + 1])
            edge = self._crossing(float(times[index]), float(times[index + 1]), level, falls=falls)
            if falls:
                self._began = edge
            elif self._began is not None:
                found = self._pulse(self._began, edge - self._began)
                self._began = None
                if found is not None:
                    return found
        return None

    def _crossing(self, before: float, after: float, level: float, *, falls: bool) -> float:
        sign = 1.0 if falls else -1.0
        return refine(lambda when: sign * (level - self._upright(when)), before, after)

    def _pulse(self, start: float, width: float) -> float | None:
        """One sync pulse: its start if it is the wanted one."""
        line_time = LINE_TIMES[self.trigger.standard]
        if width > BROAD:
            first, self._in_broad = not self._in_broad, True
            return self._field(start, line_time) if first else None
        self._in_broad = False
        begins_line = start - self._last_start > 0.75 * line_time
        self._last_start = start
        if width > EQUALISING:
            self._last_line = start
        if self.trigger.sync == "LINE":
            return start if begins_line else None
        if abs(start - self._wanted_at) < 0.2 * line_time:
            self._wanted_at = np.inf
            return start
        return None

    def _field(self, start: float, line_time: float) -> float | None:
        """The first broad pulse of a field."""
        lines = (start - self._last_line) / line_time
        if not np.isfinite(lines):
            return start if self.trigger.sync == "FIELD" else None
        odd = abs(lines - round(lines)) < 0.25
        if odd and self.trigger.sync == "LINENUM":
            standard = self.trigger.standard
            number = (self.trigger.line - FIRST_BROAD_LINE[standard]) % LINES[standard]
            self._wanted_at = start + number * line_time
            return start if number == 0 else None
        wanted = {"FIELD": True, "ODD": odd, "EVEN": not odd}.get(self.trigger.sync, False)
        return start if wanted else None
