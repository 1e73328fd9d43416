"""The acquisition as a state machine on a clock: ARMED, READY, TRIGGER, AUTO, SAVE, SCAN.

Nothing happens by itself: `update` looks at the clock and catches up. The signal is looked at only for times
that have passed, so it may depend on things that are commanded later (a rate table).

Source: user manual 071-1064-00, pp. 14, 29, 78, 92, 101; programmer manual 071-1075-04, p. 2-239.
"""

import itertools
import math
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from instrument.scpi import DIVISIONS, NO_DATA, POINTS, POINTS_PER_DIVISION
from instrument.simulated.clock import Clock
from instrument.simulated.faults import Faults
from instrument.simulated.front_end.frontend import (
    Codes,
    Floats,
    Signal,
    convert,
    gain,
    ground,
    levels_per_volt,
    mean_shown,
    shown_smooth,
    shown_volts,
    tells_its_noise,
)
from instrument.simulated.front_end.trigger_circuit import TimeSweep, TriggerCircuit
from instrument.simulated.panel.panel import Panel, PanelChannel, TriggerSettings

State = Literal["ARMED", "READY", "TRIGGER", "AUTO", "SAVE", "SCAN"]

DEAD_TIME = 1 / 180  # s between two acquisitions: up to 180 waveforms a second, p. 151
AUTO_WAIT = 0.05  # s that AUTO waits at least for a trigger (a guess)
PEAK_DETECT_FROM = 5e-6  # s/div; faster sweeps sample without saying so, p. 76
_FORGET_WAITS = 0.9  # what one acquisition leaves of the longest wait for a trigger
_MOST_AVERAGED = 128
_FEW = 4  # acquisitions that are looked for one by one
_LONGER = 1.25  # than usual: a wait that is looked for in all of many at once
_SHORTEST_POLL, _LONGEST_POLL = 1e-3, 0.1  # s between two looks for a trigger while somebody waits


@dataclass(frozen=True)
class DigitizedRecord:
    """One completed acquisition: when its samples were taken and with which settings."""

    number: int  # counts all acquisitions since power-on; seeds the noise
    starts: tuple[float, ...]  # absolute times in s of the first sample; several where records are averaged
    xzero: float  # time in s of the first sample relative to the trigger, as the preamble gives it
    seconds_per_division: float  # time base
    mode: str  # SAMPLE, PEAKDETECT or AVERAGE
    channels: Mapping[str, PanelChannel]  # vertical settings of the displayed channels
    until: float = 0.0  # absolute time in s of the end; only rolling records need it
    rolling: bool = False  # true for scan mode

    @property
    def xincr(self) -> float:
        """Sample interval in s."""
        return self.seconds_per_division / POINTS_PER_DIVISION


@dataclass(frozen=True)
class _LeftOut:
    """An acquisition that nobody has asked for yet: when it was ready for its trigger, absolute time in s."""

    ready_at: float


class AcquisitionSystem:
    """Takes records from the signals with the settings of the panel."""

    def __init__(
        self, panel: Panel, signals: Mapping[int, Signal], clock: Clock, faults: Faults, seed: int
    ) -> None:
        self._panel, self._clock, self._faults = panel, clock, faults
        self._signals = dict(signals)
        self._jitter = np.random.default_rng([seed, 0x7161])
        self._numbers = itertools.count(1)
        self._circuit = TriggerCircuit(panel, self.signal)
        self._record: DigitizedRecord | None = None
        self._swept: deque[float | _LeftOut] = deque(
            maxlen=_MOST_AVERAGED
        )  # the latest acquisitions, by their start
        self._newest: Mapping[str, PanelChannel] | None = None  # channels of an acquisition that is no record yet
        self._number = 0  # of that one
        self._completed = 0.0, 0.0  # ready and triggered, s: the latest acquisition that was not left out
        self._left_out_since: float | None = None  # absolute time in s; None: nothing is left out
        self._caught_up = 0.0  # absolute time in s up to which all is known
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
    def record(self) -> DigitizedRecord | None:
        """The newest; what was left out for it is caught up with now."""
        if self._newest is not None:
            self._record, self._newest = self._made(self._newest), None
        return self._record

    @record.setter
    def record(self, record: DigitizedRecord | None) -> None:
        self._record, self._newest = record, None

    @property
    def awaited(self) -> bool:
        """True while a record with all displayed channels is bound to come but is not there yet."""
        auto = self._panel.text("TRIGGER:MAIN:MODE") == "AUTO"
        if not self.running or not auto or self._panel.scanning:
            return False
        shown = {name for name in self._panel.displayed if name in self._panel.model.channel_names}
        taken = self._newest if self._newest is not None else self._record.channels if self._record else None
        return bool(shown) and (taken is None or not shown <= taken.keys())

    def state(self) -> State:
        """The word of TRIGger:STATE?."""
        self.update()
        now = self._clock.now()
        if not self.running or not self._displayed_channels():
            return "SAVE"
        if self._panel.scanning:
            return "SCAN"
        sweep = self._sweep
        if now < sweep.ready_at:
            return "ARMED"
        if sweep.triggered_at is not None:
            return "AUTO" if sweep.forced else "TRIGGER"
        late, before = now > sweep.ready_at + self._usual_wait, self._swept[-1] if self._swept else None
        if late and isinstance(before, _LeftOut):  # had the acquisition that was left out a trigger?
            self._swept.pop()
            triggered = self._edge_after(before.ready_at, self._panel.trigger())
            if triggered is not None:
                at, self._untriggered = triggered
                self._swept.append(self._start(at))
        return "AUTO" if self._untriggered else "READY"

    def next_change(self) -> float:
        """Clock time in s at which it is worth to look again."""
        now = self._clock.now()
        if not self.running or not self._displayed_channels():
            return now + _LONGEST_POLL
        if self._panel.scanning:
            return now + self._panel.seconds_per_division
        sweep = self._sweep
        if sweep.completes_at is not None:
            return max(sweep.completes_at, now)
        if now < (usually := sweep.ready_at + self._usual_wait):
            return usually
        poll = max(
            _SHORTEST_POLL, self._panel.seconds_per_division, min((now - sweep.ready_at) / 10, _LONGEST_POLL)
        )
        return min(now + poll, sweep.auto_at) if now < sweep.auto_at else now + poll

    def latest(self) -> DigitizedRecord:
        """The record that CURVe? would send now; one without data if there was no trigger yet."""
        self.update()
        if self.running and self._panel.scanning and self._displayed_channels():
            return self._rolling_record(self._clock.now())
        if self.record is not None:
            return self.record
        scale = self._panel.seconds_per_division
        xzero = self._panel.horizontal_position - DIVISIONS / 2 * scale
        return DigitizedRecord(0, (), xzero, scale, self._panel.text("ACQUIRE:MODE"), {})

    # What the rest of the instrument does

    def restart(self) -> None:
        """Begin anew with the settings of now (a setting changed, or STATE RUN)."""
        self._swept.clear()
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
        if self.state() not in ("READY", "AUTO") or self._sweep.triggered_at is not None:
            return False
        self._trigger(self._clock.now(), forced=True)
        return True

    def update(self) -> None:
        """Catch up with the clock."""
        if not self.running or not (shown := self._displayed_channels()):
            return
        now = self._caught_up = self._clock.now()
        if self._panel.scanning:  # a single sequence ends when the screen is full
            full = self._sweep.began + DIVISIONS * self._panel.seconds_per_division
            if self.single and now >= full:
                self.record = self._rolling_record(full)
                self._panel.values["ACQUIRE:STATE"] = 0
            return
        trigger = self._panel.trigger()
        if trigger.mode == "AUTO" and self._sweep.triggered_at is None and self.acquisitions:
            self._leave_out(self._sweep.began, now)
        while self.running:
            sweep = self._sweep
            if sweep.completes_at is None and now >= sweep.ready_at:
                self._look_for_trigger(trigger, now)
            if sweep.completes_at is None or sweep.completes_at > now:
                return
            self._complete(sweep.completes_at, now, shown)

    def settle(self) -> None:
        """Catch up with everything before a setting changes: what was taken was taken with the old one."""
        self.update()
        _ = self.record

    def trigger_signal(self, trigger: TriggerSettings, times: Floats) -> Floats:
        """Volts that the trigger comparator sees at absolute times in s."""
        return self._circuit.comparator(trigger)(times)

    def signal(self, name: str) -> Signal:
        """Signal at the input of `CH1` and so on; 0 is the EXT TRIG input."""
        return self._signals.get(int(name[2:]) if name.startswith("CH") else 0, ground)

    # Inside

    def _displayed_channels(self) -> dict[str, PanelChannel]:
        return self._panel.displayed_channels()

    def _arm(self, at: float) -> None:
        """Begin to fill the part before the trigger."""
        self._sweep = self._armed(at + self._before)

    def _armed(self, ready_at: float) -> TimeSweep:
        auto = self._panel.text("TRIGGER:MAIN:MODE") == "AUTO"
        wait = max(AUTO_WAIT, DIVISIONS * self._panel.seconds_per_division) if auto else math.inf
        return TimeSweep(ready_at - self._before, ready_at, ready_at + wait)

    @property
    def _before(self) -> float:
        """Seconds of a record before its trigger."""
        return max(0.0, DIVISIONS / 2 * self._panel.seconds_per_division - self._panel.horizontal_position)

    @property
    def _after(self) -> float:
        """Seconds from the trigger to the end of the record."""
        return max(0.0, DIVISIONS / 2 * self._panel.seconds_per_division + self._panel.horizontal_position)

    @property
    def _cycle(self) -> float:
        """Seconds from one acquisition to the next where no trigger is waited for."""
        return self._before + self._after + max(DEAD_TIME, self._panel.trigger().holdoff)

    @property
    def _count(self) -> int:
        """Acquisitions that a record is made of."""
        averages = self._panel.text("ACQUIRE:MODE") == "AVERAGE"
        return int(self._panel.number("ACQUIRE:NUMAVG")) if averages else 1

    def _leave_out(self, at: float, now: float) -> bool:
        """Arm for the acquisition that is under way now, if one at `at` was several ago; else do nothing."""
        # Those between them are looked for when somebody asks for a record that is made of them.
        usual = min(self._cycle + AUTO_WAIT, self._cycle + self._usual_wait)
        count = int((now - at) / usual) - 1
        if count < 1 or self.single:
            return False
        self._arm(now - usual * self._jitter.random())
        ready = self._sweep.ready_at
        self._swept.extend(_LeftOut(ready - usual * ago) for ago in range(min(count, self._count), 0, -1))
        self.acquisitions += count
        self._newest, self._number = self._displayed_channels(), next(self._numbers)
        self._left_out_since = at
        return True

    def _look_for_trigger(self, trigger: TriggerSettings, now: float) -> None:
        sweep = self._sweep
        edge = None if self._faults.no_trigger else self._circuit.edge(sweep, trigger, now)
        if edge is not None:
            self._trigger(edge, forced=False)
        elif now >= sweep.auto_at:
            self._trigger(sweep.auto_at, forced=True)

    def _trigger(self, at: float, *, forced: bool) -> None:
        self._sweep.triggered_at, self._sweep.forced = at, forced
        self._sweep.completes_at = at + self._after

    def _complete(self, at: float, now: float, shown: Mapping[str, PanelChannel]) -> None:
        """Keep the acquisition; stop after a sequence, else arm again."""
        sweep = self._sweep
        triggered_at = sweep.ready_at if sweep.triggered_at is None else sweep.triggered_at
        self._completed = sweep.ready_at, triggered_at
        self._swept.append(self._start(triggered_at))
        self.acquisitions += 1
        self._untriggered = sweep.forced
        self._newest, self._number = shown, next(self._numbers)
        if self.single and self.acquisitions >= self._count:
            self._panel.values["ACQUIRE:STATE"] = 0
            return
        waited = triggered_at - sweep.ready_at
        self._usual_wait = max(waited, _FORGET_WAITS * self._usual_wait)
        again = at + self._cycle - self._before - self._after
        often = waited < self._cycle + AUTO_WAIT  # a trigger that is rarer is not left out
        if not (often and self._leave_out(again, now)):
            self._arm(again)

    def _start(self, triggered_at: float) -> float:
        """Absolute time in s of the first sample: the converter's clock does not know the trigger."""
        step = self._panel.seconds_per_division / POINTS_PER_DIVISION
        return triggered_at + self._xzero + self._jitter.uniform(-0.5, 0.5) * step

    @property
    def _xzero(self) -> float:
        return self._panel.horizontal_position - DIVISIONS / 2 * self._panel.seconds_per_division

    def _made(self, shown: Mapping[str, PanelChannel]) -> DigitizedRecord | None:
        """The record of the newest acquisitions; the one before if none of them had a trigger."""
        panel, mode = self._panel, self._panel.text("ACQUIRE:MODE")
        if mode == "PEAKDETECT" and panel.seconds_per_division < PEAK_DETECT_FROM * (1 - 1e-9):
            mode = "SAMPLE"
        starts = self._latest_starts() or self._starts_before_the_silence()
        self._left_out_since = None
        if not starts:
            return self._record
        scale = panel.seconds_per_division
        return DigitizedRecord(self._number, starts, self._xzero, scale, mode, shown)

    def _latest_starts(self) -> tuple[float, ...]:
        """Starts of the acquisitions that a record is made of; those that were left out are looked for now."""
        latest = list(self._swept)[-self._count :]
        owed = np.array([sweep.ready_at for sweep in latest if isinstance(sweep, _LeftOut)])
        if not owed.size:
            return tuple(sweep for sweep in latest if not isinstance(sweep, _LeftOut))
        trigger = self._panel.trigger()
        edges = np.full(owed.shape, np.nan)
        if owed.size > _FEW and not self._faults.no_trigger:
            edges = self._circuit.edges(owed, self._usual_wait * _LONGER, trigger)
            edges[edges + self._after > self._caught_up] = np.nan
        one_by_one = bool(np.isnan(edges).all())
        found = iter(zip(owed.tolist(), edges.tolist(), strict=True))
        starts: list[float] = []
        first, again, dead = math.nan, -math.inf, self._cycle - self._before - self._after
        for sweep in latest:
            if isinstance(sweep, _LeftOut):
                ready_at, edge = next(found)
                if one_by_one and again > -math.inf:
                    ready_at = again
                triggered = self._edge_after(ready_at, trigger) if math.isnan(edge) else (edge, False)
                if triggered is not None and triggered[0] >= again - dead:  # no two at the same time
                    at, self._untriggered = triggered
                    first = first if starts else ready_at
                    starts.append(self._start(at))
                    again = at + self._cycle
            else:
                starts.append(sweep)
                again = -math.inf
        # where the last ones are not over, or have no trigger any more, as many come before all others
        usual, since = self._cycle + self._usual_wait, self._left_out_since or 0.0
        for _ in range(len(latest) - len(starts) if starts else 0):
            first -= usual
            if first > since and (triggered := self._edge_after(first, trigger)) is not None:
                starts.insert(0, self._start(triggered[0]))
        self._swept = deque(starts, maxlen=_MOST_AVERAGED)
        return tuple(starts)

    def _starts_before_the_silence(self) -> tuple[float, ...]:
        """Starts of the last acquisitions of a signal that ended while nobody asked: NORMAL keeps them."""
        if self._left_out_since is None or self._faults.no_trigger:
            return ()
        ready_at, edge = self._last_trigger(self._left_out_since)
        self._caught_up = edge + self._after
        usual = self._cycle + self._usual_wait
        count = min(self._count, 1 + int((edge - self._completed[1]) / usual))
        self._swept.extend(_LeftOut(ready_at - usual * ago) for ago in range(count - 1, -1, -1))
        return self._latest_starts()

    def _last_trigger(self, since: float) -> tuple[float, float]:
        """When the last of the acquisitions that were left out was ready, and its trigger; absolute times in s."""
        trigger, last = self._panel.trigger(), self._completed
        earliest, latest = since + self._before, self._caught_up
        while True:  # one that is ready at the latest finds no trigger
            ready_at = earliest if last == self._completed else (earliest + latest) / 2
            until = min(latest + self._cycle, self._caught_up)
            edge = self._circuit.edge(self._armed(ready_at), trigger, until)
            if edge is not None and edge + self._after <= self._caught_up:
                last, earliest = (ready_at, edge), edge + self._cycle
            else:
                latest = ready_at
            if latest - earliest < self._cycle:
                return last

    def _edge_after(self, ready_at: float, trigger: TriggerSettings) -> tuple[float, bool] | None:
        """When an acquisition that is over by now was triggered, and whether by AUTO; None: not at all."""
        for _ in range(_FEW):
            sweep = self._armed(ready_at)
            edge = None if self._faults.no_trigger else self._circuit.edge(sweep, trigger, self._caught_up)
            at = sweep.auto_at if edge is None else edge
            if at + self._after <= self._caught_up:
                return at, edge is None
            ready_at -= min(at + self._after - self._caught_up, self._cycle + AUTO_WAIT)
        return None

    def _rolling_record(self, until: float) -> DigitizedRecord:
        return DigitizedRecord(
            number=self._scan_number,
            starts=(self._sweep.began,),
            xzero=0.0,
            seconds_per_division=self._panel.seconds_per_division,
            mode=self._panel.text("ACQUIRE:MODE"),
            channels=self._displayed_channels(),
            until=until,
            rolling=True,
        )


# --------------------
# The codes of a record: samples each channel of a completed acquisition when somebody asks for it


_PEAK_RATE = 100e6  # S/s at which Peak Detect looks for the smallest and the largest sample
_PEAK_TIME_CONSTANT = 1 / (2 * math.pi * 75e6)  # s, bandwidth of Peak Detect, user manual p. 151
_MOST_PEAK_SAMPLES = 64  # a pair
_LINES = 8  # straight ones between two points that tell all about the smooth part
_FEW_NEW = 3  # acquisitions of an average that are added to the mean of the others
_KEPT = 16  # records by channel


class Digitizer:
    """Turns records into codes; the same record gives the same codes every time."""

    def __init__(self, signal: Callable[[str], Signal], noise_levels: float, seed: int) -> None:
        self._signal, self._noise_levels, self._seed = signal, noise_levels, seed
        self._averaged: dict[str, tuple[tuple[float, PanelChannel], dict[float, Floats]]] = {}
        self._means: dict[str, tuple[tuple[float, PanelChannel, int], tuple[float, ...], Floats]] = {}
        self._kept: OrderedDict[tuple[int, float, str], Codes] = OrderedDict()

    def codes(self, record: DigitizedRecord, name: str) -> Codes:
        """Codes of one channel of a record."""
        channel = record.channels.get(name)
        if channel is None:
            return np.full(POINTS, NO_DATA, dtype=np.int8)
        key = (record.number, record.until, name)
        codes = self._kept.get(key)
        if codes is None:
            codes = self._kept[key] = self._digitize(record, name, channel)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return codes

    def _digitize(self, record: DigitizedRecord, name: str, channel: PanelChannel) -> Codes:
        if record.rolling:
            return self._scan(record, name, channel)
        if record.mode == "PEAKDETECT":
            return self._peaks(record, name, channel)
        count = len(record.starts)
        noise = self._noise(record.number, name, POINTS) / np.sqrt(count)
        if count > 1:
            signal = self._signal(name)
            mean = self._smooth_mean(record, name, channel)
            if mean is not None and tells_its_noise(signal):
                # the noise of the signal and that of the scope in one
                levels = signal.noise_rms * abs(gain(channel)) * levels_per_volt(channel) / np.sqrt(count)
                noise = noise + levels * self._rng(record.number, name, 1).standard_normal(POINTS)
                return convert(mean, channel, noise)
        return convert(self._mean(record, name, channel), channel, noise)

    def _smooth_mean(self, record: DigitizedRecord, name: str, channel: PanelChannel) -> Floats | None:
        """Mean volts of the acquisitions of a record without noise: that of before, and what is new of it."""
        # None where it takes a look at each of them.
        times = record.xincr * np.arange(POINTS, dtype=np.float64)
        signal, settings = self._signal(name), (record.xincr, channel, len(record.starts))
        before = self._means.get(name)
        if before is not None and before[0] == settings:
            come = set(record.starts).difference(before[1])
            gone = set(before[1]).difference(record.starts)
            if len(come) <= _FEW_NEW:

                def look(start: float) -> Floats:
                    return shown_smooth(signal, channel, start + times)

                change = sum(map(look, come)) - sum(map(look, gone))
                mean = before[2] + change / len(record.starts)
                self._means[name] = settings, record.starts, mean
                return mean
        found = mean_shown(signal, channel, np.array(record.starts), times)
        if found is not None:
            self._means[name] = settings, record.starts, found
        return found

    def _mean(self, record: DigitizedRecord, name: str, channel: PanelChannel) -> Floats:
        """Mean volts of the acquisitions of a record; those that the last average had, too, are kept."""
        times = record.xincr * np.arange(POINTS, dtype=np.float64)
        signal = self._signal(name)
        if len(record.starts) == 1:
            return shown_volts(signal, channel, record.starts[0] + times)
        settings = (record.xincr, channel)
        known, looks = self._averaged.get(name, (settings, {}))
        if known != settings:
            looks = {}
        looks = {
            start: looks[start] if start in looks else shown_volts(signal, channel, start + times)
            for start in record.starts
        }
        self._averaged[name] = settings, looks
        return np.asarray(np.mean(list(looks.values()), axis=0))

    def _peaks(self, record: DigitizedRecord, name: str, channel: PanelChannel) -> Codes:
        """Pairs of the smallest and the largest sample of two intervals, p. 2-250."""
        samples = min(_MOST_PEAK_SAMPLES, max(2, round(2 * record.xincr * _PEAK_RATE)))
        count = POINTS // 2 * samples
        slower = replace(channel, time_constant=max(channel.time_constant, _PEAK_TIME_CONSTANT))
        # irregular sampling, so that no frequency hides between the samples of a slow sweep
        rng = np.random.default_rng([self._seed, record.number])
        irregular = rng.random(count, dtype=np.float32)
        step = 2 * record.xincr / samples
        signal = self._signal(name)
        start, smooth = record.starts[-1], 0.0
        if tells_its_noise(signal) and (smooth := signal.interval(start, start + count * step)) > step:
            # nothing hides: straight lines, and both noises in one
            divisors = (many for many in range(1, samples + 1) if samples % many == 0)
            together = max(many for many in divisors if many == 1 or many * _LINES <= smooth / step)
            edges = shown_smooth(signal, slower, start + together * step * np.arange(count // together + 1.0))
            edges = edges.astype(np.float32)
            places = (irregular.reshape(-1, together) + np.arange(together, dtype=np.float32)) / together
            volts = (edges[:-1, np.newaxis] + np.diff(edges)[:, np.newaxis] * places).ravel()
            rms = float(
                np.hypot(self._noise_levels, signal.noise_rms * abs(gain(channel)) * levels_per_volt(channel))
            )
            noise = np.float32(rms) * self._rng(record.number, name).standard_normal(count, dtype=np.float32)
        else:
            volts = shown_volts(signal, slower, start + step * (np.arange(count, dtype=np.float64) + irregular))
            noise = self._noise(record.number, name, count)
        levels = (volts * levels_per_volt(channel) + noise).reshape(-1, samples)
        ends = np.stack([levels.min(axis=1), levels.max(axis=1)], axis=1).ravel()
        return convert(ends / levels_per_volt(channel), channel)

    def _scan(self, record: DigitizedRecord, name: str, channel: PanelChannel) -> Codes:
        """The rolling record at one moment: new samples up to the blank, old ones behind it."""
        codes = np.full(POINTS, NO_DATA, dtype=np.int8)
        taken = int((record.until - record.starts[0]) / record.xincr)  # samples since the scan began
        if taken <= 0:
            return codes
        first = max(0, taken - POINTS)
        indices = np.arange(first, taken)
        times = record.starts[0] + record.xincr * indices.astype(np.float64)
        volts = shown_volts(self._signal(name), channel, times)
        sweeps = [self._noise(record.number, name, POINTS, s) for s in (first // POINTS, first // POINTS + 1)]
        noise = np.concatenate(sweeps)[first % POINTS :][: len(indices)]
        codes[indices % POINTS] = convert(volts, channel, noise)
        if taken % POINTS or taken < POINTS:
            codes[np.arange(taken, taken + POINTS_PER_DIVISION) % POINTS] = NO_DATA
        return codes

    def _noise(self, number: int, name: str, count: int, sweep: int = 0) -> Floats:
        return self._noise_levels * self._rng(number, name, sweep).standard_normal(count)

    def _rng(self, number: int, name: str, sweep: int = 0) -> np.random.Generator:
        return np.random.default_rng([self._seed, number, int(name.removeprefix("CH")), sweep])
