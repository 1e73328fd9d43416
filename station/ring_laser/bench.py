"""The bench that the settings describe, real or simulated: opened, looked at, its table set."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from analysis import fit_harmonics
from analysis.rotation import EARTH_RATE_DPS
from instrument import FoundPanel, Identity, InstrumentError, ManualRateTable, RateTable
from station.controllers import open_rate_table, open_surroundings
from station.errors import StationError, one_line
from station.results.result import Check
from station.ring_laser.records import Bench, set_up, take_record
from station.ring_laser.settings import BenchSettings
from station.runs.acquisition import Acquisition
from station.scope.autoset import ScreenShape, find_beat
from station.scope.tools import open_scope
from station.terminal import check_terminal, operator_table


@contextmanager
def open_bench(
    settings: BenchSettings,
    *,
    times_resumed: int = 0,
    tell: Callable[[str], None] | None = None,
    put_back: FoundPanel | None = None,
    same_as: Identity | None = None,
) -> Iterator[Bench]:
    """Open the bench; afterwards the front panel of the oscilloscope is as it was found."""
    said = tell or (lambda text: None)
    if settings.simulated:
        # PyVISA's simulated side and the gyro are not for a real bench
        from station.ring_laser.instruments import open_simulated_bench

        with open_simulated_bench(settings, times_resumed=times_resumed, tell=said) as bench:
            yield bench
        return
    if settings.table.kind == "manual":
        check_terminal()  # before anything is opened
    wanted = settings.scope
    opened = open_scope(
        wanted.resource,
        wanted.baud_rate,
        reconnect_s=wanted.reconnect_s,
        tell=tell,
        put_back=put_back,
        same_as=same_as,
    )
    with (
        opened as scope,
        open_surroundings(settings.controllers, tell=said) as surroundings,
        _table(settings, said) as table,  # the last to be opened is the first to be closed: it is stopped
    ):
        yield Bench(scope, table, surroundings=surroundings)


@contextmanager
def _table(settings: BenchSettings, tell: Callable[[str], None]) -> Iterator[RateTable | None]:
    """The rate table of a real bench; whatever ends this, it is stopped, or the operator is told to do it."""
    named = None if settings.controllers is None else settings.controllers.rate_table
    if settings.table.kind == "controller" and named is not None:
        with open_rate_table(named, tell=tell) as turned:
            yield turned
    elif settings.table.kind == "manual":
        by_hand = operator_table()
        try:
            yield by_hand
        finally:
            if rate := by_hand.rate():
                tell(f"The rate table still turns at {rate:+.6g} deg/s: stop it by hand.")
    else:
        yield None


def open_for(session: Acquisition, settings: BenchSettings) -> Bench:
    """Open the bench for the taking of a run; the run keeps what the link took, and the front panel as found."""
    bench = session.open(
        open_bench(
            settings,
            times_resumed=session.times_resumed,
            tell=session.link_says,
            put_back=session.panel_to_put_back,
            same_as=session.scope_so_far,
        )
    )
    session.watch(bench.scope)
    return bench


# --------------------
# A look at the bench of a ring laser before a campaign: who answers, does the table turn, how is the beat


_QUIET_LEVELS = 0.05
_NOISY_LEVELS = 5.0
_SMALL_LEVELS = 40.0
_RATE_SHARE = 1e-3


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
    knobs = find_beat(bench.scope, settings.scope, ScreenShape(), scale_factor * abs(rate_dps))
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


# --------------------
# What an operator says of the table's rate, against the beat: a wrong knob shows before records are taken


_TOLERANCE = 0.03
"""A display that reads wrong by less is found by the evaluation, which compares beat and table far better."""

_LOCKED_SHARE = 0.745
"""Beat over scale factor times rate at 1.5 lock-in rates, sqrt(1 - 1/1.5^2): no rate is chosen nearer."""


@dataclass(frozen=True)
class Beats:
    """Beat frequencies that fit a rate of the table, Hz."""

    lowest: float
    highest: float

    def holds(self, frequency: float) -> bool:
        """Whether a beat fits."""
        return self.lowest <= frequency <= self.highest

    def sentence(self, frequency: float) -> str:
        """What is seen and what should be."""
        if self.lowest <= 0:
            return f"it has {frequency:.4g} Hz and should have {self.highest:.4g} Hz at most"
        return f"it has {frequency:.4g} Hz and should have {self.lowest:.4g} to {self.highest:.4g} Hz"


def beats_at(settings: BenchSettings, table_rate_dps: float, tilt_deg: float | None) -> Beats:
    """Return the beats that fit a rate of the table."""
    # The earth rate on the axis depends on an azimuth that nobody knows, and how near lock-in is, nobody knows
    # either: both widen what fits. The sense of rotation shows in no single beat.
    scale_factor, latitude = settings.gyro.scale_factor_pulses_per_deg, math.radians(settings.site.latitude_deg)
    if tilt_deg is None:
        return Beats(0.0, scale_factor * (abs(table_rate_dps) * (1 + _TOLERANCE) + EARTH_RATE_DPS))
    tilt = math.radians(tilt_deg)
    vertical, horizontal = abs(math.sin(latitude) * math.cos(tilt)), abs(math.cos(latitude) * math.sin(tilt))
    earth = EARTH_RATE_DPS * (vertical + horizontal)
    on_axis = abs(table_rate_dps) * math.cos(tilt)
    slowest = max(on_axis * (1 - _TOLERANCE) - earth, 0.0)
    return Beats(scale_factor * slowest * _LOCKED_SHARE, scale_factor * (on_axis * (1 + _TOLERANCE) + earth))


def beats_of_other_sense(settings: BenchSettings, table_rate_dps: float, first: tuple[float, float]) -> Beats:
    """Return the beats that fit the fast run in the other sense."""
    scaled = first[1] * abs(table_rate_dps / first[0])
    earth = 2 * EARTH_RATE_DPS * settings.gyro.scale_factor_pulses_per_deg
    return Beats(max(scaled * (1 - _TOLERANCE) - earth, 0.0), scaled * (1 + _TOLERANCE) + earth)
