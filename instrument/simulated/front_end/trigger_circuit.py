"""The trigger circuit: what its comparator sees, by source and coupling, and where an acquisition triggers.

Source: user manual 071-1064-00, pp. 101 and 157.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from instrument.facts import POINTS_PER_DIVISION
from instrument.simulated.front_end.comparator import Comparator
from instrument.simulated.front_end.frontend import Floats, Signal, gain, ground, shown_noise, shown_smooth
from instrument.simulated.front_end.smooth import tells_its_noise
from instrument.simulated.front_end.trigger import HYSTERESIS, EdgeSearch, PulseSearch, first_edges
from instrument.simulated.front_end.video_trigger import VideoSearch
from instrument.simulated.panel.panel import ChannelSettings, Panel, TriggerSettings

HIGH_FREQUENCY_REJECT = 1 / (2 * math.pi * 80e3)  # s, p. 101
LOW_FREQUENCY_REJECT = 1 / (2 * math.pi * 300e3)  # s
MAINS_FREQUENCY = 50.0  # Hz, of the trigger source AC LINE
_LONGEST_SEARCH_STEP = 20e-6  # s; the comparator is faster than the samples of a slow sweep
_FURTHER = 3.0  # times as far, where others were found
_EXTERNAL = ChannelSettings(1.0, 0.0, "DC", 1.0, limited=False, inverted=False)


@dataclass
class Sweep:
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
        self._compared: tuple[tuple[str, str, ChannelSettings], Comparator] | None = None
        self._cells = 0  # of a stretch that the last search has looked at

    def edge(self, sweep: Sweep, trigger: TriggerSettings, now: float) -> float | None:
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
        """Times of the triggers of several acquisitions that are not yet looked for, by when they were ready.

        nan where none is found within some `reach` (s), or where only `edge` finds it.
        """
        if trigger.kind != "EDGE":
            return np.full(ready.shape, np.nan)
        search = self._edge_search(Sweep(0.0, 0.0, math.inf), trigger)
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

    def _new_comparator(self, source: str, coupling: str, channel: ChannelSettings) -> Comparator:
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

    def _edge_search(self, sweep: Sweep, trigger: TriggerSettings) -> EdgeSearch:
        """The search of an acquisition, with the level of now."""
        search = sweep.search
        if not isinstance(search, EdgeSearch):
            search = sweep.search = EdgeSearch(Comparator(ground), 0.0, True, 0.0, sweep.ready_at)
        search.volts_at = self.comparator(trigger)
        search.level, search.rising = trigger.level, trigger.slope == "RISE"
        search.hysteresis = self._hysteresis(trigger)
        return search

    def _pulse_search(self, sweep: Sweep, trigger: TriggerSettings) -> PulseSearch:
        """The search of an acquisition for a pulse, with the settings of now."""
        search = sweep.search
        if not isinstance(search, PulseSearch):
            search = sweep.search = PulseSearch(trigger, Comparator(ground), 0.0, sweep.ready_at)
        search.trigger, search.hysteresis = trigger, self._hysteresis(trigger)
        search.volts_at = self.comparator(trigger)
        return search

    def _video_search(self, sweep: Sweep, trigger: TriggerSettings) -> VideoSearch:
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
