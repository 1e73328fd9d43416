"""The trigger circuit: what its comparator sees, by source and coupling; video; where an acquisition triggers.

Source: user manual 071-1064-00, pp. 101 and 157.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from instrument.scpi import POINTS_PER_DIVISION
from instrument.simulated.front_end.frontend import (
    Floats,
    Signal,
    gain,
    ground,
    shown_noise,
    shown_smooth,
    tells_its_noise,
)
from instrument.simulated.front_end.trigger import (
    HYSTERESIS,
    Comparator,
    EdgeSearch,
    PulseSearch,
    first_edges,
    refine,
)
from instrument.simulated.panel.panel import Panel, PanelChannel, TriggerSettings

# --------------------
# Looks for the sync pulses of a composite video signal: any line, one line, any field, the odd or the even one.
#
# A sync pulse points down (with POLARITY INVERT up) below the picture. Short ones begin lines, the first broad one
# begins a field; it comes a whole number of lines after the last line's pulse in the odd field, and half a line
# more in the even one, in both standards. Source: ITU-R BT.1700 (525 and 625 lines)


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


HIGH_FREQUENCY_REJECT = 1 / (2 * math.pi * 80e3)  # s, p. 101
LOW_FREQUENCY_REJECT = 1 / (2 * math.pi * 300e3)  # s
MAINS_FREQUENCY = 50.0  # Hz, of the trigger source AC LINE
_LONGEST_SEARCH_STEP = 20e-6  # s; the comparator is faster than the samples of a slow sweep
_FURTHER = 3.0  # times as far, where others were found
_EXTERNAL = PanelChannel(1.0, 0.0, "DC", 1.0, limited=False, inverted=False)


@dataclass
class TimeSweep:
    """One acquisition, from when it is armed to its last sample; absolute times in s."""

    began: float  # armed, and filled as far as the trigger
    ready_at: float
    auto_at: float  # when AUTO waits no longer; inf in mode NORMAL
    triggered_at: float | None = None  # as far as that is known
    completes_at: float | None = None
    forced: bool = False  # without a trigger
    search: EdgeSearch | PulseSearch | VideoSearch | None = None  # for the trigger, as far as it has come


class TriggerCircuit:
    """Finds the triggers in the signals, with the settings of the panel."""

    def __init__(self, panel: Panel, signal: Callable[[str], Signal]) -> None:
        self._panel, self._signal = panel, signal
        self._compared: tuple[tuple[str, str, PanelChannel], Comparator] | None = None
        self._cells = 0  # of a stretch that the last search has looked at

    def edge(self, sweep: TimeSweep, trigger: TriggerSettings, now: float) -> float | None:
        """Time of the trigger of an acquisition, if it has come by now."""
        until = min(now, sweep.auto_at)
        if trigger.kind == "VIDEO":
            return self._video_search(sweep, trigger).advance(until)
        is_new = sweep.search is None
        search = (
            self._pulse_search(sweep, trigger) if trigger.kind == "PULSE" else self._edge_search(sweep, trigger)
        )
        if is_new:
            search.cells = max(search.cells, self._cells // 2)  # it may have to look as far as the one before
        edge = search.advance(until, self._step, now)
        self._cells = search.cells
        return edge

    def edges(self, ready: Floats, reach: float, trigger: TriggerSettings) -> Floats:
        """Times of the triggers of several acquisitions that are not yet looked for, by when they were ready."""
        # nan where none is found within some `reach` (s), or where only `edge` finds it.
        if trigger.kind != "EDGE":
            return np.full(ready.shape, np.nan)
        search = self._edge_search(TimeSweep(0.0, 0.0, math.inf), trigger)
        edges = first_edges(search, ready, reach, self._step)
        missing = np.isnan(edges)
        if 0 < np.count_nonzero(missing) < len(edges):
            edges[missing] = first_edges(search, ready[missing], _FURTHER * reach, self._step)
        return edges

    @property
    def _step(self) -> float:
        """Seconds between two looks of a search."""
        return min(self._panel.seconds_per_division / POINTS_PER_DIVISION, _LONGEST_SEARCH_STEP)

    def comparator(self, trigger: TriggerSettings) -> Comparator:
        """The trigger signal; the same one as long as nothing changes it, so that it can keep what it has seen."""
        channel = _EXTERNAL
        if trigger.source in self._panel.model.channel_names:
            channel = self._panel.channel(trigger.source)
        key = (trigger.source, trigger.coupling, channel)
        if self._compared is None or self._compared[0] != key:
            self._compared = key, self._new_comparator(*key)
        return self._compared[1]

    def _new_comparator(self, source: str, coupling: str, channel: PanelChannel) -> Comparator:
        if source in ("AC LINE", "LINE"):
            return Comparator(lambda times: np.sin(2 * math.pi * MAINS_FREQUENCY * times))
        signal = self._signal(source)
        shown = partial(shown_smooth, signal, channel)
        alternating = replace(channel, coupling="AC")

        def smooth(times: Floats) -> Floats:
            match coupling:
                case "HFREJ":
                    return shown(times, HIGH_FREQUENCY_REJECT)
                case "LFREJ":
                    return shown(times) - shown(times, LOW_FREQUENCY_REJECT)
                case "AC" if channel.coupling == "DC":
                    return shown_smooth(signal, alternating, times)
            return shown(times)

        if not tells_its_noise(signal) or channel.coupling == "GND":
            return Comparator(smooth)
        noise = partial(shown_noise, signal, channel)
        without_mean = channel.coupling == "AC" or coupling in ("AC", "LFREJ")

        def bounds(start: float, stop: float) -> tuple[float, float]:
            low, high = signal.bounds(start, stop)
            swing = high - low
            if coupling == "LFREJ" and (interval := signal.interval(start, stop)) > LOW_FREQUENCY_REJECT:
                swing *= LOW_FREQUENCY_REJECT / interval  # of a signal with six looks a period: twice its slope
            ends = (-swing, swing) if without_mean else (low, high)  # a mean taken away lies between them
            first, last = (gain(channel) * end for end in ends)
            return min(first, last), max(first, last)

        rms = abs(gain(channel)) * signal.noise_rms
        return Comparator(smooth, noise, rms, signal.interval, bounds)

    def _edge_search(self, sweep: TimeSweep, trigger: TriggerSettings) -> EdgeSearch:
        """The search of an acquisition, with the level of now."""
        search = sweep.search
        if not isinstance(search, EdgeSearch):
            search = sweep.search = EdgeSearch(Comparator(ground), 0.0, True, 0.0, sweep.ready_at)
        search.volts_at = self.comparator(trigger)
        search.level, search.rising = trigger.level, trigger.slope == "RISE"
        search.hysteresis = self._hysteresis(trigger)
        return search

    def _pulse_search(self, sweep: TimeSweep, trigger: TriggerSettings) -> PulseSearch:
        """The search of an acquisition for a pulse, with the settings of now."""
        search = sweep.search
        if not isinstance(search, PulseSearch):
            search = sweep.search = PulseSearch(trigger, Comparator(ground), 0.0, sweep.ready_at)
        search.trigger, search.hysteresis = trigger, self._hysteresis(trigger)
        search.volts_at = self.comparator(trigger)
        return search

    def _video_search(self, sweep: TimeSweep, trigger: TriggerSettings) -> VideoSearch:
        """The search of an acquisition for a sync pulse, with the settings of now."""
        search = sweep.search
        if not isinstance(search, VideoSearch) or search.trigger != trigger:
            since = search.searched_until if search is not None else sweep.ready_at
            search = sweep.search = VideoSearch(trigger, Comparator(ground), 0.0, since)
        search.smallest = 2 * self._hysteresis(trigger)
        direct = replace(trigger, coupling="DC")  # the coupling belongs to the edge trigger
        search.volts_at = self.comparator(direct)
        return search

    def _hysteresis(self, trigger: TriggerSettings) -> float:
        """Volts by which the signal has to leave the level; noise reject doubles them."""
        scale = 0.2  # V, external inputs
        if trigger.source in self._panel.model.channel_names:
            scale = self._panel.number(f"{trigger.source}:SCALE")
        return HYSTERESIS * scale * (2 if trigger.coupling == "NOISEREJ" else 1)
