"""A look at the bench of a ring laser before a campaign: who answers, does the table turn, how is the beat."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from analysis import fit_harmonics
from instrument import InstrumentError, ManualRateTable
from station.errors import StationError, one_line
from station.results.check import Check
from station.ring_laser.bench import Bench
from station.ring_laser.open import open_bench
from station.ring_laser.records import set_up, take_record
from station.ring_laser.settings import BenchSettings
from station.scope.autoset import find_beat

_QUIET_LEVELS = 0.05
_NOISY_LEVELS = 5.0
_SMALL_LEVELS = 40.0
_RATE_SHARE = 1e-3


@dataclass(frozen=True)
class _TrialShape:
    fill_levels: float = 100.0
    periods_min: float = 15.0
    samples_per_period_min: float = 20.0


def examine(settings: BenchSettings, rate_dps: float) -> list[Check]:
    """Open the bench, turn the table and look at the beat."""
    told: list[str] = []
    checks: list[Check] = []
    try:
        with open_bench(settings, tell=told.append) as bench:
            checks += _looked_at(bench, settings, rate_dps)
    except (InstrumentError, StationError, OSError) as error:
        checks.append(Check("bench", "bad", one_line(error)))
    return [*checks, *(Check("bench", "note", text) for text in told)]


def _looked_at(bench: Bench, settings: BenchSettings, rate_dps: float) -> Iterator[Check]:
    yield Check(
        "oscilloscope", "ok", f"{bench.scope.identity.text} at {settings.scope.resource or 'the simulated bench'}"
    )
    if read := bench.surroundings():
        yield Check("surroundings", "ok", ", ".join(f"{name} {value:g}" for name, value in read.items()))
    table = bench.table
    if table is None:
        yield Check("rate table", "note", "turns already, as the settings say; nobody can look whether it does")
    elif isinstance(table, ManualRateTable):
        yield Check("rate table", "note", "is set by hand: the beat is looked at as the table turns now")
    else:
        yield _turned(bench, rate_dps)
    yield from _beat(bench, settings, rate_dps)


def _turned(bench: Bench, rate_dps: float) -> Check:
    try:
        before, rate = bench.azimuth(), bench.turn_table(rate_dps, 0.5)
    except (InstrumentError, ValueError) as error:
        return Check("rate table", "bad", f"{error}; look at drive, cable and template")
    after = bench.azimuth()
    if abs(rate - rate_dps) > _RATE_SHARE * abs(rate_dps):
        return Check("rate table", "bad", f"was set to {rate_dps:g} deg/s, reads {rate:g} deg/s: look at per_dps")
    if before is not None and before == after:
        return Check("rate table", "bad", f"reads {rate:g} deg/s, its angle stays at {after:g} deg: is it locked?")
    return Check("rate table", "ok", f"turns at {rate:g} deg/s")


def _beat(bench: Bench, settings: BenchSettings, rate_dps: float) -> Iterator[Check]:
    scale_factor, channel = settings.gyro.scale_factor_pulses_per_deg, settings.scope.channel
    if not scale_factor:
        yield Check("beat", "bad", "the scale factor is not given: gyro.scale_factor_pulses_per_deg")
        return
    set_up(bench, settings.scope, [channel])
    knobs = find_beat(bench.scope, settings.scope, _TrialShape(), scale_factor * abs(rate_dps))
    (waveform, *_), _ = take_record(bench, (channel,))
    base = knobs.seconds_per_division
    yield Check("trigger", "ok", f"{channel} triggers at {knobs.trigger_level:.3g} V, time base {base:g} s/div")
    fit = fit_harmonics(waveform.volts, waveform.sample_interval)
    step = abs(waveform.preamble.ymult)
    level, noise = abs(complex(fit.amplitudes[0])) / step, float(fit.noise_rms) / step
    seen = f"the beat of {float(fit.frequency):.4g} Hz fills {level:.0f} of 127 levels"
    if level >= _SMALL_LEVELS:
        yield Check("level", "ok", seen)
    else:
        yield Check("level", "bad", f"{seen}, too few on the smallest scale: look at detector, cable and probe")
    if noise > _NOISY_LEVELS:
        yield Check("noise", "bad", f"{noise:.1f} levels rms: look at grounding, light and the detector's supply")
    elif noise < _QUIET_LEVELS:
        yield Check("noise", "note", f"{noise:.2f} levels rms, less than any converter has: is it a generator?")
    else:
        yield Check("noise", "ok", f"{noise:.2f} levels rms")
