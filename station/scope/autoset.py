"""Choose time base and vertical scale from trial records, as an operator would with the knobs."""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from analysis import FATAL, Flag, estimate_lock_in, fit_harmonics
from analysis.lockin_rate import MAINS_HZ
from analysis.plan import OscilloscopeSteps
from instrument import TDS2014, NoTrigger, ScopeEvent, SettingError, Waveform
from instrument.scpi import DIVISIONS, LEVELS_PER_DIVISION, POINTS, SCAN_FROM, TIME_BASES, VERTICAL_SCALES
from station.errors import NoUsableSignal
from station.results.result import with_prefix

_TRIALS_MAX, _VERTICAL_TRIALS_MAX = 30, 6
# The slowest time base, s/div, at which a trial costs next to nothing. Where the beat is not expected to be slow,
# none is looked for beyond it: a trial holds fewer than 3 periods of one below 6 Hz.
_QUICK_S = 0.05
# A beat is looked for that is so many times slower than the one expected: near lock-in it is.
_SLOWER_THAN_EXPECTED = 10.0
# A trial begins with so many periods, at so many samples each at least; a beat shows from 3 periods on.
_TRIAL_PERIODS, _TRIAL_SAMPLES, _PERIODS_SEEN = 5.0, 100.0, 3.0


def oscilloscope_steps(probe: float = 1.0) -> OscilloscopeSteps:
    """What the knobs of the scope allow, behind a probe that divides by ``probe``."""
    scales = tuple(scale * probe for scale in VERTICAL_SCALES)
    return OscilloscopeSteps(TIME_BASES, scales, POINTS, DIVISIONS, LEVELS_PER_DIVISION)


_LOOKED_AT = 2.5e-5, 2.5e-3, 5e-2
"""Time bases, s/div, at which is looked what there is instead of a beat; the fast one first, for aliases."""

_STEPS = oscilloscope_steps()


class ScopeInput(Protocol):
    """Where the signal comes in: channel, and attenuation of its probe."""

    @property
    def channel(self) -> str:
        """``"CH1"`` to ``"CH4"``."""

    @property
    def probe(self) -> int:
        """1, 10, 100 or 1000."""


@dataclass(frozen=True)
class ScreenShape:
    """What a record shall look like."""

    fill_levels: float = 100.0  # that the signal shall reach on both sides of the screen's centre
    periods_min: float = 15.0  # of the beat in a record; the next goes before it
    samples_per_period_min: float = 20.0


@dataclass(frozen=True)
class KnobPositions:
    """How the scope was set to see the beat."""

    seconds_per_division: float
    volts_per_division: float
    position: float  # vertical position, divisions
    trigger_level: float  # V
    beat_frequency: float  # hz, of the last trial record


@dataclass(frozen=True)
class VerticalSetting:
    """Vertical scale in V/div and position in divisions."""

    scale: float
    position: float = 0.0


def next_vertical(
    waveform: Waveform, current: VerticalSetting, fill_levels: float, probe: int
) -> VerticalSetting | None:
    """Choose a better vertical setting, if there is one."""
    low_limit, high_limit = VERTICAL_SCALES[0] * probe, VERTICAL_SCALES[-1] * probe
    valid = np.isfinite(waveform.volts)
    if not valid.any():
        return None
    codes, volts = waveform.codes[valid].astype(int), waveform.volts[valid]
    lowest, highest = int(codes.min()), int(codes.max())
    if waveform.clipped:
        # all of it beyond one edge tells nothing but the side: look from much farther away
        factor = 5 if highest - lowest < 20 else 2
        wider = VerticalSetting(min(current.scale * factor, high_limit), 0.0)
        return None if wider == current else wider
    low, high = float(volts.min()), float(volts.max())
    half_span = max((high - low) / 2, 1.5 * current.scale / LEVELS_PER_DIVISION)
    value = half_span * LEVELS_PER_DIVISION / fill_levels
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    scale = min(max(float(f"{math.ceil(value / step - 1e-9) * step:.6g}"), low_limit), high_limit)
    # the position moves in steps of a level
    position = round(-(low + high) / 2 / scale * LEVELS_PER_DIVISION) / LEVELS_PER_DIVISION
    well_filled = (
        0.85 * fill_levels <= (highest - lowest) / 2 <= 1.05 * fill_levels
        and abs(highest + lowest) / 2 <= 0.1 * fill_levels
    )
    wanted = VerticalSetting(scale, position)
    unchanged = math.isclose(scale, current.scale, rel_tol=0.02) and abs(position - current.position) < 0.1
    return None if well_filled or unchanged else wanted


def find_beat(
    scope: TDS2014,
    settings: ScopeInput,
    measurement: ScreenShape,
    start: KnobPositions | float,
    mains: Sequence[float] = (),
) -> KnobPositions:
    """Set the scope so that a record shows the beat well, and what the mains (Hz) do beside its harmonics."""
    search = _BeatSearch(scope, settings, measurement)
    highest = start.beat_frequency if isinstance(start, KnobPositions) else start
    slowest = max(_QUICK_S, _PERIODS_SEEN * _SLOWER_THAN_EXPECTED / highest / DIVISIONS)
    # begin with few periods: at 500 samples a period nothing can be aliased
    first = _STEPS.time_base(highest, _TRIAL_PERIODS, _TRIAL_SAMPLES)
    if isinstance(start, KnobPositions):
        search.vertical = VerticalSetting(start.volts_per_division, start.position)
    else:
        shown = search.fit_vertical(max(first, _LOOKED_AT[1]))
        if shown is not None and slowest <= _QUICK_S and _is_flat(shown):
            raise search.no_beat(shown)
    search.set_time_base(first)
    for _ in range(_TRIALS_MAX):
        waveform = search.trial()
        seen = None if waveform is None else _beat_frequency(waveform)
        if waveform is not None and (seen is not None or waveform.clipped) and search.improve_vertical(waveform):
            continue
        if seen is None:
            slower = next((step for step in TIME_BASES if step >= search.base * 4), math.inf)
            if search.base >= slowest or not math.isfinite(slower):
                raise search.no_beat(waveform)
            last = next(step for step in TIME_BASES if step >= min(slowest, TIME_BASES[-1]))
            search.set_time_base(min(slower, last))
            continue
        wanted = _STEPS.time_base(seen, measurement.periods_min, measurement.samples_per_period_min, mains)
        if math.isclose(wanted, search.base, rel_tol=1e-3):
            return search.found(seen)
        search.set_time_base(wanted)
    raise NoUsableSignal(
        f"no steady beat on {settings.channel} after {_TRIALS_MAX} trial records ({search.what_is_there(None)}): "
        "is the gyro running and the table turning?"
    )


def fit_channel(
    scope: TDS2014, channel: str, settings: ScopeInput, measurement: ScreenShape, setting: KnobPositions
) -> VerticalSetting:
    """Fit the vertical scale of a second channel; time base and trigger stay as they are."""
    begin = VerticalSetting(setting.volts_per_division, setting.position)
    vertical = _set_vertical(scope, settings, begin, channel)
    for _ in range(_TRIALS_MAX):
        better = next_vertical(scope.acquire(channel), vertical, measurement.fill_levels, settings.probe)
        chosen = vertical if better is None else _set_vertical(scope, settings, better, channel)
        if chosen == vertical:
            break
        vertical = chosen
    return vertical


def look_at_channels(scope: TDS2014, settings: Callable[[str], ScopeInput]) -> Iterator[tuple[str, str, bool]]:
    """Channel after channel: its name, in words what stands on it, and whether that is periodic."""
    for name in scope.channels:
        scope.set_channel(name, displayed=True, coupling="DC", probe=settings(name).probe)
        search = _BeatSearch(scope, settings(name), ScreenShape())
        shown = search.fit_vertical(_LOOKED_AT[1])
        text, periodic = search.seen_on((name,), shown).get(name, (f"{name}: nothing triggers", False))
        yield name, text, periodic


class _BeatSearch:
    """The knobs as they stand while the beat is looked for."""

    def __init__(self, scope: TDS2014, settings: ScopeInput, measurement: ScreenShape) -> None:
        self._scope, self._settings, self._measurement = scope, settings, measurement
        self.vertical = VerticalSetting(1.0 * settings.probe)
        self.base = _QUICK_S
        self._by_mains = True

    def fit_vertical(self, quick: float) -> Waveform | None:
        """Fit the vertical scale; the last record, None if no scale is found."""
        # Roughly where a trial is short, then where the beat shows its whole height. An alias that stands still
        # looks flat at one scale and clipped at the next: that has no end.
        self.vertical = _set_vertical(self._scope, self._settings, self.vertical)
        waveform = None
        for base in dict.fromkeys((quick, max(quick, _QUICK_S))):
            self.set_time_base(base)
            for _ in range(_VERTICAL_TRIALS_MAX):
                waveform = self.trial()
                if waveform is None or not self.improve_vertical(waveform):
                    break
            else:
                return None
        return waveform

    def trial(self) -> Waveform | None:
        """Take a trial record; ``None`` if nothing triggered it, as a slow time base may without the mains."""
        try:
            return self._scope.acquire(self._settings.channel)
        except NoTrigger:
            return None

    def improve_vertical(self, waveform: Waveform) -> bool:
        """Change the vertical setting if the record shows a better one; tell whether it was changed."""
        fill, probe = self._measurement.fill_levels, self._settings.probe
        better = next_vertical(waveform, self.vertical, fill, probe)
        if better is None:
            return False
        chosen = _set_vertical(self._scope, self._settings, better)
        changed, self.vertical = chosen != self.vertical, chosen
        self._set_trigger()
        return changed

    def set_time_base(self, base: float) -> None:
        """Set the time base, and a trigger that suits it."""
        self.base = self._scope.set_timebase(base, position=0.0)
        self._set_trigger()

    def no_beat(self, shown: Waveform | None) -> NoUsableSignal:
        """What to say where a record shows none, and none at any other time base."""
        return NoUsableSignal(
            f"no beat on the scope at any time base ({self.what_is_there(shown)}): "
            "is the gyro running, the table turning, the cable on this channel?"
        )

    def what_is_there(self, shown: Waveform | None) -> str:
        """In words what stands on the channel, and on the others that are displayed, at three time bases."""
        channel, scope = self._settings.channel.upper(), self._scope
        others = [name for name in scope.channels if name != channel and scope.channel_settings(name).displayed]
        seen = self.seen_on((channel, *others), shown)
        hint = next(
            (f" ({name} may be it: --channel {name})" for name in others if seen.get(name, ("", 0))[1]), ""
        )
        return f"{'; '.join(text for text, _ in seen.values())}{hint}"

    def seen_on(self, names: tuple[str, ...], shown: Waveform | None) -> dict[str, tuple[str, bool]]:
        """In words what stands on these channels, at three time bases, and whether it is periodic."""
        seen: dict[str, tuple[str, bool]] = {}
        for base in _LOOKED_AT:
            if base == _LOOKED_AT[-1] and shown is not None and len(names) == 1:
                waveforms: Sequence[Waveform] = (shown,)  # it was looked just now
            else:
                self.set_time_base(base)
                try:
                    waveforms = self._scope.acquire(names)
                except NoTrigger:
                    continue
            for name, waveform in zip(names, waveforms, strict=True):
                if not seen.get(name, ("", False))[1]:
                    seen[name] = signal_words(name, waveform)
            if all(periodic for _, periodic in seen.values()):
                break
        return seen

    def found(self, frequency: float) -> KnobPositions:
        """Return the knobs as they stand now."""
        return KnobPositions(
            self.base, self.vertical.scale, self.vertical.position, _level(self.vertical), frequency
        )

    def _set_trigger(self) -> None:
        """Trigger on the beat, at a slow time base on the mains."""
        # There AUTO would scan, and its records be patched; and a trigger on a beat that is locked, or lies beside
        # the level, would be waited for in vain. A record that begins anywhere is as good. A scope that runs on
        # batteries knows no mains.
        if self.base < SCAN_FROM or not self._by_mains:
            mode = "AUTO" if self.base < SCAN_FROM else "NORMAL"
            level = _level(self.vertical)
            self._scope.set_trigger(source=self._settings.channel, level=level, slope="RISE", mode=mode)
            return
        for word in ("LINE", "AC LINE"):  # which of them a model knows, its manuals disagree about
            with contextlib.suppress(SettingError, ScopeEvent):
                self._scope.set_trigger(source=word, mode="NORMAL")
                return
        self._by_mains = False
        self._set_trigger()


def _beat_frequency(waveform: Waveform) -> float | None:
    """Beat frequency of a trial record in Hz; ``None`` if it holds too little of a beat."""
    estimate = estimate_lock_in(waveform.volts, waveform.sample_interval, scale_factor=1.0, nan_policy="omit")
    if int(estimate.flags) & int(FATAL | Flag.FEW_PERIODS) or not np.isfinite(estimate.beat_frequency):
        return None
    return float(estimate.beat_frequency)


def signal_words(name: str, waveform: Waveform) -> tuple[str, bool]:
    """What stands on a channel, and whether it is periodic: at least three periods of one frequency."""
    volts = waveform.volts[np.isfinite(waveform.volts)]
    span = float(np.ptp(volts)) if volts.size else 0.0
    if _is_flat(waveform):
        level = abs(waveform.preamble.ymult)
        at = round(float(volts.mean()) / level) * level if volts.size else 0.0
        return f"{name}: flat at {with_prefix(at, 'V')}", False
    size = f"{'over ' if waveform.clipped else ''}{with_prefix(span, 'V')} peak to peak"
    fit = fit_harmonics(waveform.volts, waveform.sample_interval, nan_policy="omit")
    frequency, (first, second, third) = float(fit.frequency), np.abs(fit.amplitudes).tolist()
    periods = frequency * waveform.sample_interval * len(waveform)
    if not (periods >= 3 and first**2 > np.var(volts)):  # half of the power and more
        return f"{name}: {size}, no steady frequency", False
    text = f"{name}: {size} at {with_prefix(frequency, 'Hz')}"
    if third > 0.2 * first and second < 0.1 * first:
        text += ", odd harmonics only: a logic output?"
    elif any(abs(frequency - order * mains) < 0.01 * frequency for mains in MAINS_HZ for order in (1, 2)):
        text += ": hum of the mains?"
    return text, True


def _is_flat(waveform: Waveform) -> bool:
    """Whether all of it lies within five levels."""
    volts = waveform.volts[np.isfinite(waveform.volts)]
    return not volts.size or float(np.ptp(volts)) < 5 * abs(waveform.preamble.ymult)


def _set_vertical(
    scope: TDS2014, settings: ScopeInput, wanted: VerticalSetting, channel: str = ""
) -> VerticalSetting:
    """Set scale and position; a scope without fine steps gets the next coarse one above."""
    name = channel or settings.channel
    steps = (scale * settings.probe for scale in VERTICAL_SCALES)
    coarse = next((scale for scale in steps if scale >= wanted.scale * 0.999), wanted.scale)
    try:
        taken = scope.set_channel(name, scale=wanted.scale, position=wanted.position)
    except SettingError:
        if math.isclose(coarse, wanted.scale):
            raise
        position = round(wanted.position * wanted.scale / coarse * LEVELS_PER_DIVISION) / LEVELS_PER_DIVISION
        taken = scope.set_channel(name, scale=coarse, position=position)
    return VerticalSetting(taken.scale, taken.position)


def _level(vertical: VerticalSetting) -> float:
    """Trigger level in V at the centre of the screen."""
    return -vertical.position * vertical.scale
