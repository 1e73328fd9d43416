"""The sweep through the dead band: its settings, its steps, taking it, and what a record says at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from analysis import earth_rate_on_axis
from analysis.rotation import EARTH_RATE_DPS
from instrument import ManualRateTable, Waveform
from instrument.scpi import SCAN_FROM, TIME_BASES
from station.controllers import ControllersSettings, with_controllers
from station.errors import NoUsableSignal, SettingsError
from station.live.preview import Preview, PreviewValue, See, harmonics_of, trace_of_beat, waveform_of
from station.measurements import limits_of
from station.results.numbers import BEAT_FREQUENCY, BIAS_RATE, DEAD_BAND_WIDTH, LOCK_IN_RATE
from station.ring_laser.bench import Beats, beats_at, open_for
from station.ring_laser.records import Bench, acquisition_records, set_up, take_record
from station.ring_laser.settings import (
    BeamsSettings,
    DitherSettings,
    RingLaserSettings,
    ScopeSettings,
    SimulationSettings,
)
from station.runs.acquisition import Acquisition
from station.runs.store import NewRecord, RunWriter
from station.scope.autoset import KnobPositions, ScreenShape, find_beat, oscilloscope_steps
from station.settings import (
    Finite,
    Limits,
    NotNegative,
    OutputSettings,
    SettingsKind,
    SettingsSection,
    SiteSettings,
)


class SweepTableSettings(SettingsSection):
    """The rate table under the gyro."""

    kind: Literal["simulated", "manual", "controller"]
    settle_s: NotNegative
    tilt_deg: Annotated[float, Field(ge=0, lt=90)]
    north_azimuth_deg: Finite
    rate_u_dps: NotNegative


class SweepSettings(SettingsSection):
    """Rates, how many records at each, and what a record shall look like."""

    highest_over_lock_in: Annotated[float, Field(gt=1, le=1000)]
    steps: Annotated[int, Field(ge=2, le=10_000)]
    rates_over_lock_in: tuple[Annotated[float, Field(gt=0, le=1000)], ...] = ()
    records: Annotated[int, Field(ge=1, le=1000)]
    periods_min: Annotated[float, Field(ge=3, le=500)]
    samples_per_period_min: Annotated[float, Field(ge=5, le=500)]
    fill_levels: Annotated[float, Field(ge=10, le=120)]


class DeadBandSettings(SettingsSection):
    """All settings of a sweep. ``simulation`` is absent on a real bench."""

    gyro: RingLaserSettings
    site: SiteSettings
    table: SweepTableSettings
    scope: ScopeSettings
    sweep: SweepSettings
    output: OutputSettings
    controllers: ControllersSettings | None = None
    simulation: SimulationSettings | None = None
    limits: Limits = Limits()

    @property
    def simulated(self) -> bool:
        """Whether the bench is simulated: no oscilloscope is named."""
        return not self.scope.resource

    @property
    def turning_dps(self) -> float:
        """A simulated table rests at the beginning."""
        return 0.0

    @property
    def beams(self) -> BeamsSettings:
        """A sweep looks at the beat alone."""
        return BeamsSettings()

    @property
    def dither(self) -> DitherSettings:
        """A sweep needs a gyro that does not dither."""
        return DitherSettings()


def _adapt(values: dict[str, Any]) -> None:
    """Let an operator turn the table under a real gyro: a simulated one cannot."""
    scope, table = values.get("scope"), values.get("table")
    if isinstance(scope, dict) and scope.get("resource"):
        values.pop("simulation", None)
        if isinstance(table, dict) and table.get("kind") == "simulated":
            table["kind"] = "manual"


def _check(settings: DeadBandSettings, path: Path) -> DeadBandSettings:
    if settings.simulated and settings.simulation is None:
        raise SettingsError(f"{path}: scope.resource is empty and there is no [simulation]: name the oscilloscope")
    if settings.simulated and settings.table.kind == "manual":
        raise SettingsError(f'{path}: table.kind = "manual": an operator cannot turn a simulated table')
    rates = settings.sweep.rates_over_lock_in
    if rates and max(rates) <= 1:
        raise SettingsError(
            f"{path}: sweep.rates_over_lock_in: the highest, {max(rates):g}, must lie beyond lock-in: above 1"
        )
    if settings.scope.quadrature_channel:
        raise SettingsError(f"{path}: scope.quadrature_channel: a sweep needs one channel only")
    return with_controllers(settings, settings.table.kind, path)


DEAD_BAND = SettingsKind(
    sections=DeadBandSettings,
    limits=lambda: limits_of("deadband"),
    shipped=lambda given: "dead_band",
    adapt=_adapt,
    check=_check,
    knowledge=("limits.*", "table.tilt_deg", "table.north_azimuth_deg", "table.rate_u_dps"),
)


# --------------------
# Step through the rates, up and down, and keep what the oscilloscope shows at each: a beat or none


PURPOSE = "deadband"
_SURELY_BEYOND = 1.5
"""Of the expected lock-in rate, whatever the earth adds: from there on a beat that is too slow, as `beats_at`
says, shows a wrong rate."""

_LARGE = 0.5  # of the beat that the vertical scale was fitted to: what is no noise
_FASTER_THAN_RATE = 2.0  # the bias may add to the first rate, but the gyro sees no more than so many times it


def take(settings: DeadBandSettings, session: Acquisition) -> None:
    """Sweep and save; of a run that was cut short, what is missing."""
    take_on(open_for(session, settings), settings, session)


def take_on(bench: Bench, settings: DeadBandSettings, session: Acquisition) -> None:
    """Sweep on a bench that is open already."""
    set_up(bench, settings.scope, [settings.scope.channel])
    writer = session.begin({"identity": asdict(bench.scope.identity), **truth_of(settings)})
    model = bench.scope.identity.model
    session.progress.note(f"{model} ({settings.scope.resource or 'simulated'}), run {writer.path}")
    there = {record.key for record in session.so_far().taken_for(PURPOSE)}
    if there:
        session.progress.note(f"{len(there)} records are saved already")
    answers = _Answers(bench, settings)
    knobs = _knobs(settings, session, bench, writer, answers)
    bench.scope.set_channel(settings.scope.channel, scale=knobs.volts_per_division, position=knobs.position)
    numbers = range(1, settings.sweep.records + 1)
    left = [[n for n in numbers if step.key(n) not in there] for step in sweep(settings)]
    session.progress.start("records", sum(map(len, left)))
    turned = False
    for _, part in groupby(zip(sweep(settings), left, strict=True), key=lambda one: one[0].direction):
        steps = list(part)
        for place, (step, missing) in enumerate(steps):
            if not missing:
                continue
            if not turned and place:
                # a gyro that comes from rest may be locked where one that comes from a higher rate still turns
                _turn(bench, steps[0][0], settings)
            turned = True
            _take_step(step, missing, settings, session, bench, knobs, writer, answers)


@dataclass
class _Answers:
    """What an operator says of the rate, against the beat; one who insists is not asked again."""

    bench: Bench
    settings: DeadBandSettings
    insists: bool = False

    def doubted(self, step: SweepStep, frequency: float, *, may_lock: bool = False) -> bool:
        """Ask again where the beat does not fit the rate; whether it is to be looked at again."""
        table, expected = self.bench.table, self.settings.gyro.expected_lock_in_rate_dps
        if not isinstance(table, ManualRateTable) or self.insists:
            return False
        beats = beats_at(self.settings, table.rate(), self.settings.table.tilt_deg)
        # the earth rate may bring the axis nearer to lock-in than the table's rate says
        slowest = abs(step.rate_dps) - EARTH_RATE_DPS
        if may_lock or slowest < _SURELY_BEYOND * expected:
            beats = Beats(0.0, beats.highest)
        if beats.holds(frequency):
            return False
        self.insists = not table.doubt(beats.sentence(frequency))
        if not self.insists:
            self.bench.sleep(self.settings.table.settle_s)
        return not self.insists

    def confirmed(self, rate_dps: float) -> float:
        """The rate of the table, deg/s: an operator may have set it right."""
        table = self.bench.table
        return table.rate() if isinstance(table, ManualRateTable) else rate_dps


def truth_of(settings: DeadBandSettings) -> dict[str, dict[str, float]]:
    """Return the fact ``truth`` of a simulated run, what it should find; nothing for a real gyro."""
    if settings.simulation is None:
        return {}
    lock_in, tilt = settings.simulation.lock_in_rate_dps, settings.simulation.tilt_deg
    vertical = float(earth_rate_on_axis(settings.site.latitude_deg, tilt, 90.0))
    return {"truth": {LOCK_IN_RATE.key(): lock_in, DEAD_BAND_WIDTH.key(): 2 * lock_in, BIAS_RATE.key(): -vertical}}


def _knobs(
    settings: DeadBandSettings, session: Acquisition, bench: Bench, writer: RunWriter, answers: _Answers
) -> KnobPositions:
    """Fit the vertical scale to the beat of the first rate, once a run: inside the band there is no beat."""
    if saved := session.facts.get("scope_setting"):
        return KnobPositions(**saved)
    first = sweep(settings)[0]
    session.progress.note(f"looking for the beat at {first.rate_dps:+.4g} deg/s")
    _turn(bench, first, settings)
    fastest = _FASTER_THAN_RATE * settings.gyro.scale_factor_pulses_per_deg * abs(first.rate_dps)
    # few periods: a slower time base would need a trigger, and wait for it
    shape = ScreenShape(settings.sweep.fill_levels, periods_min=5.0)
    try:
        knobs = find_beat(bench.scope, settings.scope, shape, fastest)
        while answers.doubted(first, knobs.beat_frequency):
            knobs = find_beat(bench.scope, settings.scope, shape, fastest)
    except NoUsableSignal as error:
        raise NoUsableSignal(
            f"at {first.rate_dps:+.4g} deg/s, the first rate of the sweep and well beyond the dead band: {error}"
        ) from None
    writer.save_facts({"scope_setting": asdict(knobs)})
    return knobs


def _turn(bench: Bench, step: SweepStep, settings: DeadBandSettings) -> float:
    """Bring the table to a step; the rate that it has then."""
    rate = step.rate_dps / math.cos(math.radians(settings.table.tilt_deg))
    why = f"A step of the sweep ({step.direction}). Records that are taken then: {settings.sweep.records}."
    return bench.turn_table(rate, settings.table.settle_s, why)


def _take_step(
    step: SweepStep,
    missing: list[int],
    settings: DeadBandSettings,
    session: Acquisition,
    bench: Bench,
    knobs: KnobPositions,
    writer: RunWriter,
    answers: _Answers,
) -> None:
    """Go to one rate and take its records; each is on the disk before the next is asked for."""
    rate, channel = _turn(bench, step, settings), settings.scope.channel
    bench.scope.set_timebase(time_base(step, settings), position=0.0)
    # a trigger that comes by itself: inside the band nothing would ever trigger it
    bench.scope.set_trigger(source=channel, level=knobs.trigger_level, slope="RISE", mode="AUTO")
    for number in missing:
        waveforms, conditions = take_record(bench, (channel,))
        while number == missing[0] and answers.doubted(step, _beat_of(waveforms[0], settings), may_lock=True):
            waveforms, conditions = take_record(bench, (channel,))
        rate = answers.confirmed(rate)
        conditions |= {"direction": step.direction, "rate_dps": step.rate_dps, "table_rate_dps": rate}
        conditions["clock_s"] = bench.now()
        writer.save_records(acquisition_records(PURPOSE, step.key(number), waveforms, (channel,), conditions))
        session.progress.advance()


def _beat_of(waveform: Waveform, settings: DeadBandSettings) -> float:
    """Frequency of the beat in a record, Hz; 0 where there is none, or a small one that may be noise."""
    fit = harmonics_of(waveform)
    large = _LARGE * settings.sweep.fill_levels * abs(waveform.preamble.ymult)
    return float(fit.frequency) if fit is not None and abs(complex(fit.amplitudes[0])) > large else 0.0


# --------------------
# The sweep: which rates, in which order, each with a time base that follows from the rate alone


SLOWEST_S = max(step for step in TIME_BASES if step < SCAN_FROM)
"""s/div. A slower one would scan in AUTO, and its records be patched."""

_DIVISIONS = 10  # of a record


@dataclass(frozen=True)
class SweepStep:
    """One rate of the sweep."""

    direction: str  # {"up", "down"}
    rate_dps: float  # on the gyro's axis, without the earth rate

    def key(self, number: int) -> str:
        """Key of one of its records; numbers count from 1."""
        return f"{self.direction} {self.rate_dps:+.9g}, {number}"


def sweep(settings: DeadBandSettings) -> list[SweepStep]:
    """List the steps: from the lowest rate to the highest, and back."""
    lock_in, asked = settings.gyro.expected_lock_in_rate_dps, settings.sweep
    if asked.rates_over_lock_in:
        sizes = sorted({lock_in * size for size in asked.rates_over_lock_in})
        rates = [*(-size for size in reversed(sizes)), *sizes]
    else:
        # a quarter of a step beside zero: the rates of one sense lie halfway between those of the other, so that a
        # gyro without bias does not meet the same error of the steps twice
        one = lock_in * asked.highest_over_lock_in / asked.steps
        rates = [one * (n + 0.25) for n in range(-asked.steps, asked.steps + 1)]
    return [
        *(SweepStep("up", rate) for rate in rates),
        *(SweepStep("down", rate) for rate in reversed(rates[:-1])),
    ]


def time_base(step: SweepStep, settings: DeadBandSettings) -> float:
    """Return the time base of a step, s/div."""
    # A beat is never faster than scale factor times rate. Below the expected lock-in rate there may be none at
    # all: the record is then as long as one at lock-in, and what it shows is taken as it is.
    fastest = settings.gyro.scale_factor_pulses_per_deg * max(
        abs(step.rate_dps), settings.gyro.expected_lock_in_rate_dps
    )
    shape = settings.sweep
    wanted = oscilloscope_steps().time_base(fastest, shape.periods_min, shape.samples_per_period_min)
    return min(wanted, SLOWEST_S)


def seconds(settings: DeadBandSettings) -> float:
    """Return how long a sweep takes at least: its records, and the settling after each change of the rate."""
    steps = sweep(settings)
    records = sum(_DIVISIONS * time_base(step, settings) for step in steps) * settings.sweep.records
    return records + len(steps) * settings.table.settle_s


def fastest_table_rate(settings: DeadBandSettings) -> float:
    """Return the fastest rate of the table in a sweep, deg/s."""
    fastest = max(abs(step.rate_dps) for step in sweep(settings))
    return fastest / math.cos(math.radians(settings.table.tilt_deg))


# --------------------
# What one record of the sweep shows as soon as it is there, a beat or none: for those who watch


_BEAT = 0.25  # of the largest swing so far: less than this is no beat, but noise or the edge of one


def watch(settings: DeadBandSettings) -> See:
    """Return what looks at records of `gyrolock deadband` as they come."""
    return _SweepPreview()


class _SweepPreview:
    def __init__(self) -> None:
        self._largest = 0.0

    def __call__(self, records: Sequence[NewRecord]) -> Preview | None:
        record = records[0]
        waveform = waveform_of(record)
        fit = harmonics_of(waveform)
        amplitude = 0.0 if fit is None else abs(complex(fit.amplitudes[0]))
        self._largest = max(self._largest, amplitude)
        beats = fit is not None and amplitude > _BEAT * self._largest
        frequency = float(fit.frequency) if fit is not None and beats else math.nan
        rate = float(record.conditions["rate_dps"])  # type: ignore[arg-type]  # plain JSON
        values = (
            PreviewValue("rate_dps", rate, math.nan, f"{rate:+.5g} deg/s"),
            PreviewValue(BEAT_FREQUENCY.key(), frequency, math.nan, f"{frequency:.5g} Hz" if beats else "no beat"),
        )
        group = str(record.conditions["direction"])
        return Preview(record.key, group, values, values, trace=trace_of_beat(waveform, fit if beats else None))
