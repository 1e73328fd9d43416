"""Step through the rates, up and down, and keep what the oscilloscope shows at each: a beat or none."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import groupby

from analysis import earth_rate_on_axis
from analysis.rotation import EARTH_RATE_DPS
from instrument import ManualRateTable, Waveform
from station.dead_band.settings import DeadBandSettings
from station.dead_band.sweep import Step, sweep, time_base
from station.errors import NoUsableSignal
from station.ring_laser.at_once import harmonics_of
from station.ring_laser.bench import Bench
from station.ring_laser.open import open_for
from station.ring_laser.records import acquisition_records, set_up, take_record
from station.ring_laser.table_answer import Beats, beats_at
from station.runs.store import RunWriter
from station.runs.taking import Session
from station.scope.autoset import KnobPositions, find_beat

PURPOSE = "deadband"
_SURELY_BEYOND = 1.5
"""Of the expected lock-in rate, whatever the earth adds: from there on a beat that is too slow, as `beats_at`
says, shows a wrong rate."""

_LARGE = 0.5  # of the beat that the vertical scale was fitted to: what is no noise
_FASTER_THAN_RATE = 2.0  # the bias may add to the first rate, but the gyro sees no more than so many times it


@dataclass(frozen=True)
class _TrialShape:
    """Trial records of few periods: a slower time base would need a trigger, and wait for it."""

    fill_levels: float
    periods_min: float = 5.0
    samples_per_period_min: float = 20.0


def take(settings: DeadBandSettings, session: Session) -> None:
    """Sweep and save; of a run that was cut short, what is missing."""
    take_on(open_for(session, settings), settings, session)


def take_on(bench: Bench, settings: DeadBandSettings, session: Session) -> None:
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

    def doubted(self, step: Step, frequency: float, *, may_lock: bool = False) -> bool:
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
    return {"truth": {"lock_in_rate_dps": lock_in, "dead_band_dps": 2 * lock_in, "bias_rate_dps": -vertical}}


def _knobs(
    settings: DeadBandSettings, session: Session, bench: Bench, writer: RunWriter, answers: _Answers
) -> KnobPositions:
    """Fit the vertical scale to the beat of the first rate, once a run: inside the band there is no beat."""
    if saved := session.facts.get("scope_setting"):
        return KnobPositions(**saved)
    first = sweep(settings)[0]
    session.progress.note(f"looking for the beat at {first.rate_dps:+.4g} deg/s")
    _turn(bench, first, settings)
    fastest = _FASTER_THAN_RATE * settings.gyro.scale_factor_pulses_per_deg * abs(first.rate_dps)
    shape = _TrialShape(settings.sweep.fill_levels)
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


def _turn(bench: Bench, step: Step, settings: DeadBandSettings) -> float:
    """Bring the table to a step; the rate that it has then."""
    rate = step.rate_dps / math.cos(math.radians(settings.table.tilt_deg))
    why = f"A step of the sweep ({step.direction}). Records that are taken then: {settings.sweep.records}."
    return bench.turn_table(rate, settings.table.settle_s, why)


def _take_step(
    step: Step,
    missing: list[int],
    settings: DeadBandSettings,
    session: Session,
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
