"""The acquisition as a state machine on a clock: ARMED, READY, TRIGGER, AUTO, SAVE, SCAN.

Nothing happens by itself: `update` looks at the clock and catches up. The signal is looked at only for times
that have passed, so it may depend on things that are commanded later (a rate table).

Source: user manual 071-1064-00, pp. 14, 29, 78, 92, 101; programmer manual 071-1075-04, p. 2-239.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from instrument.facts import DIVISIONS, POINTS_PER_DIVISION
from instrument.simulated.clock import Clock
from instrument.simulated.faults import Faults
from instrument.simulated.front_end.comparator import Comparator
from instrument.simulated.front_end.frontend import (
    Floats,
    Signal,
    gain,
    ground,
    shown_noise,
    shown_smooth,
    slow_part,
)
from instrument.simulated.front_end.smooth import tells_its_noise
from instrument.simulated.front_end.trigger import HYSTERESIS, EdgeSearch, PulseSearch
from instrument.simulated.front_end.video_trigger import VideoSearch
from instrument.simulated.panel.panel import (
    ChannelSettings,
    Panel,
    TriggerSettings,
)

State = Literal["ARMED", "READY", "TRIGGER", "AUTO", "SAVE", "SCAN"]

DEAD_TIME = 1 / 180  # s between two acquisitions: up to 180 waveforms a second, p. 151
AUTO_WAIT = 0.05  # s that AUTO waits at least for a trigger (a guess)
PEAK_DETECT_FROM = 5e-6  # s/div; faster sweeps sample without saying so, p. 76
HIGH_FREQUENCY_REJECT = 1 / (2 * math.pi * 80e3)  # s, p. 101
LOW_FREQUENCY_REJECT = 1 / (2 * math.pi * 300e3)  # s
MAINS_FREQUENCY = 50.0  # Hz, of the trigger source AC LINE
_FORGET_WAITS = 0.9  # what one acquisition leaves of the longest wait for a trigger
_FORGET_AFTER = 1  # acquisition times; of a longer silence only the end is simulated
_LONGEST_SEARCH_STEP = 20e-6  # s; the comparator is faster than the samples of a slow sweep
_EXTERNAL = ChannelSettings(1.0, 0.0, "DC", 1.0, limited=False, inverted=False)
_SHORTEST_POLL, _LONGEST_POLL = 1e-3, 0.1  # s between two looks for a trigger while somebody waits


@dataclass(frozen=True)
class Record:
    """One completed acquisition: when its samples were taken and with which settings.

    Attributes
    ----------
    number : int
        Counts all acquisitions since power-on; seeds the noise.
    starts : tuple of float
        Absolute times in s of the first sample; several where records are averaged.
    xzero : float
        Time in s of the first sample relative to the trigger, as the preamble gives it.
    seconds_per_division : float
        Time base.
    mode : str
        SAMPLE, PEAKDETECT or AVERAGE.
    channels : mapping
        Vertical settings of the displayed channels.
    until : float
        Absolute time in s of the end; only rolling records need it.
    rolling : bool
        True for scan mode.
    """

    number: int
    starts: tuple[float, ...]
    xzero: float
    seconds_per_division: float
    mode: str
    channels: Mapping[str, ChannelSettings]
    until: float = 0.0
    rolling: bool = False

    @property
    def xincr(self) -> float:
        """Sample interval in s."""
        return self.seconds_per_division / POINTS_PER_DIVISION


class Acquisition:
    """Takes records from the signals with the settings of the panel."""

    def __init__(
        self, panel: Panel, signals: Mapping[int, Signal], clock: Clock, faults: Faults, seed: int
    ) -> None:
        self._panel, self._clock, self._faults = panel, clock, faults
        self._signals = dict(signals)
        self._jitter = np.random.default_rng([seed, 0x7161])
        self._numbers = itertools.count(1)
        self._compared: tuple[tuple[str, str, ChannelSettings], Comparator] | None = None
        self.record: Record | None = None
        self.acquisitions = 0  # ACQuire:NUMACq?
        self.restart()

    # What the rest of the instrument asks

    @property
    def running(self) -> bool:
        """True while ACQuire:STATE is 1."""
        return self._panel.flag("ACQUIRE:STATE")

    @property
    def single(self) -> bool:
        """True while a single sequence is under way (what BUSY? reports)."""
        return self.running and self._panel.text("ACQUIRE:STOPAFTER") == "SEQUENCE"

    @property
    def awaited(self) -> bool:
        """True while a record with all displayed channels is bound to come but is not there yet."""
        auto = self._panel.text("TRIGGER:MAIN:MODE") == "AUTO"
        if not self.running or not auto or self._panel.scanning:
            return False
        shown = {name for name in self._panel.displayed if name in self._panel.model.channel_names}
        return bool(shown) and (self.record is None or not shown <= self.record.channels.keys())

    def state(self) -> State:
        """The word of TRIGger:STATE?."""
        self.update()
        now = self._clock.now()
        if not self.running or not self._displayed_channels():
            return "SAVE"
        if self._panel.scanning:
            return "SCAN"
        if now < self._ready_at:
            return "ARMED"
        if self._triggered_at is not None:
            return "AUTO" if self._forced else "TRIGGER"
        return "AUTO" if self._untriggered else "READY"

    def next_change(self) -> float:
        """Clock time in s at which it is worth to look again."""
        now = self._clock.now()
        if not self.running or not self._displayed_channels():
            return now + _LONGEST_POLL
        if self._panel.scanning:
            return now + self._panel.seconds_per_division
        if self._completes_at is not None:
            return max(self._completes_at, now)
        if now < self._ready_at:
            return self._ready_at
        waited = now - self._ready_at
        poll = max(_SHORTEST_POLL, self._panel.seconds_per_division, min(waited / 10, _LONGEST_POLL))
        return min(now + poll, self._auto_at) if now < self._auto_at else now + poll

    def latest(self) -> Record:
        """The record that CURVe? would send now; one without data if there was no trigger yet."""
        self.update()
        if self.running and self._panel.scanning and self._displayed_channels():
            return self._rolling_record(self._clock.now())
        if self.record is not None:
            return self.record
        scale = self._panel.seconds_per_division
        xzero = self._panel.horizontal_position - DIVISIONS / 2 * scale
        return Record(0, (), xzero, scale, self._panel.text("ACQUIRE:MODE"), {})

    # What the rest of the instrument does

    def restart(self) -> None:
        """Begin anew with the settings of now (a setting changed, or STATE RUN)."""
        self._averaged: deque[float] = deque(maxlen=128)
        self._usual_wait = 0.0
        self._untriggered = False
        self.acquisitions = 0
        self._scan_number = next(self._numbers)
        self._arm(self._clock.now())

    def stop(self) -> None:
        """STATE OFF: the screen keeps what it shows."""
        if self.running and self._panel.scanning and self._displayed_channels():
            self.record = self._rolling_record(self._clock.now())
        self._panel.values["ACQUIRE:STATE"] = 0

    def force_trigger(self) -> bool:
        """TRIGger FORCe: completes the acquisition in READY, else nothing."""
        if self.state() not in ("READY", "AUTO") or self._triggered_at is not None:
            return False
        self._trigger(self._clock.now(), forced=True)
        return True

    def update(self) -> None:
        """Catch up with the clock."""
        if not self.running or not (shown := self._displayed_channels()):
            return
        now = self._clock.now()
        if self._panel.scanning:
            self._update_scan(now)
            return
        trigger = self._panel.trigger()
        while self.running:
            if self._completes_at is None:
                self._look_for_trigger(trigger, now)
            if self._completes_at is None or self._triggered_at is None or self._completes_at > now:
                return
            self._complete(self._triggered_at, self._completes_at, now, trigger, shown)

    def trigger_signal(self, trigger: TriggerSettings, times: Floats) -> Floats:
        """Volts that the trigger comparator sees at absolute times in s."""
        return self._comparator(trigger)(times)

    def signal(self, name: str) -> Signal:
        """Signal at the input of `CH1` and so on; 0 is the EXT TRIG input."""
        return self._signals.get(int(name[2:]) if name.startswith("CH") else 0, ground)

    # Inside

    def _displayed_channels(self) -> dict[str, ChannelSettings]:
        return self._panel.displayed_channels()

    def _arm(self, at: float) -> None:
        """Begin to fill the part before the trigger."""
        scale, position = self._panel.seconds_per_division, self._panel.horizontal_position
        self._began = at
        self._ready_at = at + max(0.0, DIVISIONS / 2 * scale - position)
        self._auto_at = self._ready_at + max(AUTO_WAIT, DIVISIONS * scale)
        if self._panel.text("TRIGGER:MAIN:MODE") != "AUTO":
            self._auto_at = math.inf
        self._triggered_at: float | None = None
        self._completes_at: float | None = None
        self._forced = False
        self._search: EdgeSearch | PulseSearch | VideoSearch | None = None

    def _arm_again(self, at: float, now: float, waited: float) -> None:
        """Arm after a record; of hours without a question only the last acquisitions are simulated.

        A trigger that was `waited` for longer than an acquisition takes is rare: then nothing is left out.
        """
        sweep = DIVISIONS * self._panel.seconds_per_division + DEAD_TIME
        cycle = sweep + AUTO_WAIT
        self._usual_wait = max(waited, _FORGET_WAITS * self._usual_wait)
        wanted = _FORGET_AFTER
        if self._panel.text("ACQUIRE:MODE") == "AVERAGE":
            wanted += int(self._panel.number("ACQUIRE:NUMAVG"))
        usual = min(cycle, sweep + self._usual_wait)
        skipped = now - wanted * usual - at
        if skipped > usual and waited < cycle and not self.single:
            self.acquisitions += int(skipped / usual)
            at += skipped
        self._arm(at)

    def _look_for_trigger(self, trigger: TriggerSettings, now: float) -> None:
        if now < self._ready_at:
            return
        edge = None
        if not self._faults.no_trigger:
            step = min(self._step(), _LONGEST_SEARCH_STEP)
            until = min(now, self._auto_at)
            match trigger.kind:
                case "EDGE":
                    edge = self._edge_search(trigger).advance(until, step, now)
                case "PULSE":
                    edge = self._pulse_search(trigger).advance(until, step, now)
                case "VIDEO":
                    edge = self._video_search(trigger).advance(until)
        if edge is not None:
            self._trigger(edge, forced=False)
        elif now >= self._auto_at:
            self._trigger(self._auto_at, forced=True)

    def _step(self) -> float:
        return self._panel.seconds_per_division / POINTS_PER_DIVISION

    def _comparator(self, trigger: TriggerSettings) -> Comparator:
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
        signal = self.signal(source)
        shown = partial(shown_smooth, signal, channel)

        def smooth(times: Floats) -> Floats:
            match coupling:
                case "HFREJ":
                    return shown(times, HIGH_FREQUENCY_REJECT)
                case "LFREJ":
                    return shown(times) - shown(times, LOW_FREQUENCY_REJECT)
                case "AC" if channel.coupling == "DC":
                    return shown(times) - gain(channel) * slow_part(signal, times)
            return shown(times)

        if not tells_its_noise(signal) or channel.coupling == "GND":
            return Comparator(smooth)
        noise = partial(shown_noise, signal, channel)
        alternating = channel.coupling == "AC" or coupling in ("AC", "LFREJ")

        def bounds(start: float, stop: float) -> tuple[float, float]:
            low, high = signal.bounds(start, stop)
            swing = high - low
            ends = (-swing, swing) if alternating else (low, high)  # a mean taken away lies between them
            first, last = (gain(channel) * end for end in ends)
            return min(first, last), max(first, last)

        rms = abs(gain(channel)) * signal.noise_rms
        return Comparator(smooth, noise, rms, signal.interval, bounds)

    def _edge_search(self, trigger: TriggerSettings) -> EdgeSearch:
        """The search of this acquisition, with the level of now."""
        search = self._search
        if not isinstance(search, EdgeSearch):
            search = self._search = EdgeSearch(Comparator(ground), 0.0, True, 0.0, self._ready_at)
        search.volts_at = self._comparator(trigger)
        search.level, search.rising = trigger.level, trigger.slope == "RISE"
        search.hysteresis = self._hysteresis(trigger)
        return search

    def _pulse_search(self, trigger: TriggerSettings) -> PulseSearch:
        """The search of this acquisition for a pulse, with the settings of now."""
        search = self._search
        if not isinstance(search, PulseSearch):
            search = self._search = PulseSearch(trigger, Comparator(ground), 0.0, self._ready_at)
        search.trigger, search.hysteresis = trigger, self._hysteresis(trigger)
        search.volts_at = self._comparator(trigger)
        return search

    def _video_search(self, trigger: TriggerSettings) -> VideoSearch:
        """The search of this acquisition for a sync pulse, with the settings of now."""
        search = self._search
        if not isinstance(search, VideoSearch) or search.trigger != trigger:
            since = search.searched_until if search is not None else self._ready_at
            search = self._search = VideoSearch(trigger, Comparator(ground), 0.0, since)
        search.smallest = 2 * self._hysteresis(trigger)
        direct = replace(trigger, coupling="DC")  # the coupling belongs to the edge trigger
        search.volts_at = self._comparator(direct)
        return search

    def _hysteresis(self, trigger: TriggerSettings) -> float:
        """Volts by which the signal has to leave the level; noise reject doubles them."""
        scale = 0.2  # V, external inputs
        if trigger.source in self._panel.model.channel_names:
            scale = self._panel.number(f"{trigger.source}:SCALE")
        return HYSTERESIS * scale * (2 if trigger.coupling == "NOISEREJ" else 1)

    def _trigger(self, at: float, *, forced: bool) -> None:
        after = DIVISIONS / 2 * self._panel.seconds_per_division + self._panel.horizontal_position
        self._triggered_at, self._forced = at, forced
        self._completes_at = at + max(0.0, after)

    def _complete(
        self,
        triggered_at: float,
        at: float,
        now: float,
        trigger: TriggerSettings,
        shown: Mapping[str, ChannelSettings],
    ) -> None:
        """Keep the record; stop after a sequence, else arm again."""
        panel = self._panel
        jitter = self._jitter.uniform(-0.5, 0.5) * self._step()
        xzero = panel.horizontal_position - DIVISIONS / 2 * panel.seconds_per_division
        self._averaged.append(triggered_at + xzero + jitter)
        self.acquisitions += 1
        self._untriggered = self._forced
        mode = panel.text("ACQUIRE:MODE")
        if mode == "PEAKDETECT" and panel.seconds_per_division < PEAK_DETECT_FROM * (1 - 1e-9):
            mode = "SAMPLE"
        count = int(panel.number("ACQUIRE:NUMAVG")) if mode == "AVERAGE" else 1
        self.record = Record(
            number=next(self._numbers),
            starts=tuple(self._averaged)[-count:],
            xzero=xzero,
            seconds_per_division=panel.seconds_per_division,
            mode=mode,
            channels=shown,
        )
        if self.single and self.acquisitions >= count:
            panel.values["ACQUIRE:STATE"] = 0
            return
        waited = triggered_at - self._ready_at
        self._arm_again(at + max(DEAD_TIME, trigger.holdoff), now, waited)

    def _update_scan(self, now: float) -> None:
        """A single sequence in scan mode ends when the screen is full."""
        full = self._began + DIVISIONS * self._panel.seconds_per_division
        if self.single and now >= full:
            self.record = self._rolling_record(full)
            self._panel.values["ACQUIRE:STATE"] = 0

    def _rolling_record(self, until: float) -> Record:
        return Record(
            number=self._scan_number,
            starts=(self._began,),
            xzero=0.0,
            seconds_per_division=self._panel.seconds_per_division,
            mode=self._panel.text("ACQUIRE:MODE"),
            channels=self._displayed_channels(),
            until=until,
            rolling=True,
        )
