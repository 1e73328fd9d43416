"""The paper's experiment: find the tilt on a fast table, go to one slow rate or several, keep every record.

What is measured is only saved here; numbers come from the saved run.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from analysis.lock_in_run import PreliminaryLockIn
from analysis.lockin_rate import MAINS_HZ
from analysis.plan import off_mains
from analysis.rotation import earth_rate_on_axis
from instrument import ManualRateTable
from instrument.scpi import DIVISIONS
from station.errors import NoUsableSignal
from station.live.events import Progress
from station.lock_in.evaluate import fast_run_tilt, lock_in_so_far
from station.lock_in.rate_plan import (
    RatePlan,
    RateStep,
    changed_plan,
    rate_plan,
    records_after,
    records_at_each,
    saved_plan,
)
from station.lock_in.settings import Settings, TableSettings, check_scale_factor
from station.results.result import with_prefix
from station.ring_laser.bench import Beats, beats_at, beats_of_other_sense, open_for
from station.ring_laser.records import Bench, acquisition_records, set_up, take_record
from station.ring_laser.settings import DitherSettings
from station.runs.acquisition import Acquisition
from station.runs.store import RunWriter, SavedRecord
from station.scope.autoset import KnobPositions, ScreenShape, find_beat, fit_channel

_EAST = 90.0  # azimuth at which the earth rate on the axis has its vertical part only

_WHY_FAST = "This fast run finds the angle between gyro axis and table axis; then the other sense follows."
_WHY_OTHER_SENSE = "The other sense takes the earth's rotation out; then the slow rates follow."

_FASTER, _CLEAR = 5.0, 3.0
_STEEPEST_DEG = 89.5  # beyond this a tilt is likelier a rate that was typed wrongly
_FAR = 10.0  # fast runs: a table that nobody has stated the highest rate of is not sent farther
"""A fast run in which the gyro is locked, or beats at less than so many expected lock-in rates, is repeated at so
many times its rate: near lock-in the beat stops where the earth turns the other way, and tells little of the
tilt."""


def take(settings: Settings, session: Acquisition) -> None:
    """Do the whole experiment and save it; of a run that was cut short, what is missing."""
    check_scale_factor(settings)
    still = settings.model_copy(update={"dither": DitherSettings()})  # with the dither on: `dithered.py`
    take_on(open_for(session, still), settings, session)


def take_on(bench: Bench, settings: Settings, session: Acquisition) -> None:
    """Do the experiment on a bench that is open already."""
    set_up(bench, settings.scope, _channels(settings), settings.beams)
    writer = session.begin({"identity": asdict(bench.scope.identity)})
    model = bench.scope.identity.model
    session.progress.note(f"{model} ({settings.scope.resource or 'simulated'}), run {writer.path}")
    taking = _Taking(settings, bench, session, writer, session.progress)
    if session.resumed is not None:
        taking.rates = list(session.facts.get("rates", []))
        taking.levels_known = "beam_levels_v" in session.facts
        there = len(session.so_far().taken_for("measure"))
        session.progress.note(f"{there} records are saved already")
    taking.experiment()


def _channels(settings: Settings) -> tuple[str, ...]:
    """The channels of one acquisition: the sine, the cosine if there is a second photodiode, and the beams."""
    scope = settings.scope
    cosine = (scope.quadrature_channel,) if scope.quadrature_channel else ()
    return (scope.channel, *cosine, *settings.beams.channels)


@dataclass
class _Taking:
    """The experiment as it goes along: the knobs of the last rate, and the rates so far."""

    settings: Settings
    bench: Bench
    session: Acquisition
    writer: RunWriter
    progress: Progress
    knobs: KnobPositions | None = None
    rates: list[dict[str, Any]] = field(default_factory=list)
    tilt_deg: float = 0.0
    levels_known: bool = False

    def experiment(self) -> None:
        """Go through the plan; it may change with what the first rates say."""
        if self.bench.table is not None:
            self.tilt_deg = self._find_tilt()
        saved = self.session.facts.get("plan") if self.session.resumed is not None else None
        plan = saved_plan(self.settings, saved) if saved else self._first_plan()
        tried: list[RateStep] = []
        without_beat: dict[RateStep, str] = {}
        self._count(plan, done=len(self._saved("measure")))
        seen: PreliminaryLockIn | None = None
        while (step := next((step for step in plan.steps if step not in tried), None)) is not None:
            tried.append(step)
            if step.again and any(silent.setting == step.setting for silent in without_beat):
                continue
            try:
                self._take_step(step, records_after(plan, step, records_at_each(self.settings, plan)))
                seen = self._clearest(seen, step)
            except NoUsableSignal as error:
                if plan.settings == 1:
                    raise
                # where the search ended in vain, the vertical scale fits no beat: the next one begins anew
                self.knobs = None
                # the other rates may do: which one gave nothing stands in the run and in the result
                without_beat[step] = f"{step.sense * step.over_lock_in:+g} expected lock-in rates: {error}"
                self.progress.note(f"no record at {without_beat[step]}")
                self.writer.save_facts({"rates_without_beat": list(without_beat.values())})
                self._count(plan, without_beat)
            if step.sense == 1 and not step.again and self.settings.rates_are_chosen:
                plan = self._look_again(plan, seen, tried, list(without_beat))
                self._count(plan, without_beat)
        if len(without_beat) == len({step.setting for step in tried}):
            raise NoUsableSignal(next(iter(without_beat.values())))

    def _count(self, plan: RatePlan, without_beat: Iterable[RateStep] = (), done: int = 0) -> None:
        """Tell how many records the whole plan has; in the beginning also how many there are."""
        settings = {step.setting for step in plan.steps} - {step.setting for step in without_beat}
        self.progress.of_all(records_at_each(self.settings, plan) * len(settings), done)

    def _first_plan(self) -> RatePlan:
        """The plan for the expected lock-in rate, or for another one where the fast run shows it already."""
        plan = rate_plan(self.settings, self.tilt_deg)
        self._save_plan(plan)
        if not self.settings.rates_are_chosen:
            return plan
        fast = self._saved("tilt")
        return self._look_again(plan, lock_in_so_far(fast, self.session.so_far(), self.settings), [], [])

    def _look_again(
        self, plan: RatePlan, seen: PreliminaryLockIn | None, tried: list[RateStep], without_beat: list[RateStep]
    ) -> RatePlan:
        """Choose the rates to come anew where the lock-in rate is far from the expected one; a resumed run too."""
        changed = changed_plan(
            self.settings, plan, self.tilt_deg, seen=seen, tried=tried, without_beat=without_beat
        )
        if changed is None:
            return plan
        known = "no beat at the fastest rate"
        if seen is not None:
            known = f"the lock-in rate is about {seen.lock_in_rate:.2g} deg/s"
        to_come = [f"{step.over_lock_in:g}" for step in changed.steps if step.sense == 1 and step not in tried]
        left = ", ".join(to_come) or "those that there are"
        self.progress.note(f"{known}: the rates are chosen anew, {left} times the expected one")
        self._save_plan(changed)
        return changed

    def _save_plan(self, plan: RatePlan) -> None:
        self.writer.save_facts({"plan": plan.as_json()})

    def _clearest(self, seen: PreliminaryLockIn | None, step: RateStep) -> PreliminaryLockIn | None:
        """What the rates so far say of the lock-in rate: the one that can be least off."""
        if step.sense != 1 or not self.settings.rates_are_chosen:
            return seen
        run = self.session.so_far()
        now = lock_in_so_far(self._taken_at(step), run, self.settings)
        candidates = [one for one in (seen, now) if one is not None]
        return min(candidates, key=lambda one: one.spread, default=None)

    def _find_tilt(self) -> float:
        """Turn fast, in both senses if asked for, and find the tilt in deg from the beat frequency."""
        settings, fast = self.settings, self.settings.table.fast_rate_dps
        count = settings.measurement.tilt_records
        taken = self._saved("tilt")
        if taken:
            fast = abs(taken[0].conditions["table_rate_dps"])
        # with the axis along the table's the beat would be as fast as this
        start: KnobPositions | float = settings.gyro.scale_factor_pulses_per_deg * fast
        first: tuple[float, float] | None = None
        for sense in (1, -1) if settings.table.both_senses else (1,):
            there = [one for one in taken if one.conditions["table_rate_dps"] * sense > 0]
            if len(there) >= count:
                continue
            if sense == 1 and not there:
                rate, self.knobs = self._fast_beat(fast)
                fast, first = abs(rate), (rate, self.knobs.beat_frequency)
            else:
                self.progress.note(f"fast run at {sense * fast:+g} deg/s")
                rate = self.bench.turn_table(sense * fast, settings.table.settle_s, _WHY_OTHER_SENSE)
                other = partial(beats_of_other_sense, settings, first=first) if first is not None else None
                self.knobs = self._find_beat(self.knobs or start, other)
                rate = self._confirmed(rate)
            channels = (settings.scope.channel,)
            self._take_records("tilt", f"tilt {sense * fast:+g}", channels, len(there), count, rate)
        tilt = fast_run_tilt(self.session.so_far(), settings)
        self.progress.note(f"tilt {tilt.tilt_deg:.3f}°")
        if tilt.tilt_deg > _STEEPEST_DEG and not settings.simulated and settings.table.known_tilt_deg is None:
            share = math.cos(math.radians(tilt.tilt_deg))
            raise NoUsableSignal(
                f"the fast run gives a tilt of {tilt.tilt_deg:.3f}°: the gyro would see {100 * share:.2g} % of "
                "the table's rate, and the table had to turn dangerously fast. Was the rate typed with its "
                "sign, is the beat that of the gyro? State table.known_tilt_deg if the axis lies so"
            )
        return tilt.tilt_deg

    def _fast_beat(self, fast: float) -> tuple[float, KnobPositions]:
        """Turn fast, and faster where the gyro is locked at that: the table's rate, deg/s, and the knobs."""
        settings = self.settings
        while True:
            self.progress.note(f"fast run at {fast:+g} deg/s")
            rate = self.bench.turn_table(fast, settings.table.settle_s, _WHY_FAST)
            highest = settings.gyro.scale_factor_pulses_per_deg * fast
            faster = min(_FASTER * fast, settings.table.highest_rate_dps)
            is_last = faster <= fast or not settings.rates_are_chosen
            try:
                knobs = self._find_beat(highest, partial(beats_at, settings, tilt_deg=None))
                seen_dps = knobs.beat_frequency / settings.gyro.scale_factor_pulses_per_deg
                if is_last or seen_dps > _CLEAR * settings.gyro.expected_lock_in_rate_dps:
                    return self._confirmed(rate), knobs
                self.progress.note(f"close to lock-in at {fast:g} deg/s, a beat of {knobs.beat_frequency:.4g} Hz")
            except NoUsableSignal as error:
                if is_last:
                    raise
                self.progress.note(f"no record at {fast:g} deg/s: {error}")
            fast = faster

    def _take_step(self, step: RateStep, count: int) -> None:
        """Go to one rate, find the beat and take the records; without a table it turns already."""
        settings, channels = self.settings, _channels(self.settings)
        there = self._taken_at(step)
        if len(there) >= count:
            return
        frequency = settings.gyro.scale_factor_pulses_per_deg * abs(step.rate_dps)
        table_rate = None
        if self.bench.table is None:
            self.progress.note("looking for the beat")
        else:
            # of the earth rate the vertical part is known
            east = float(earth_rate_on_axis(settings.site.latitude_deg, self.tilt_deg, _EAST))
            wanted = (step.rate_dps - east) / math.cos(math.radians(self.tilt_deg))
            wanted = there[0].conditions["table_rate_dps"] if there else wanted
            if abs(wanted) > settings.table.highest_rate_dps:
                raise NoUsableSignal(f"the table turns at most {settings.table.highest_rate_dps:g} deg/s")
            unstated = settings.table.highest_rate_dps == TableSettings.model_fields["highest_rate_dps"].default
            if unstated and not settings.simulated and abs(wanted) > _FAR * settings.table.fast_rate_dps:
                fast = settings.table.fast_rate_dps
                raise NoUsableSignal(
                    f"{wanted:.4g} deg/s is far above the fast run of {fast:g} deg/s: state "
                    "table.highest_rate_dps if the table may turn so"
                )
            self.progress.note(f"slow rate {wanted:.4g} deg/s on the table")
            why = f"Here lock-in shows in the beat. Records that are taken then: {count - len(there)}."
            table_rate = self.bench.turn_table(wanted, settings.table.settle_s, why)
        fits, mains = partial(beats_at, settings, tilt_deg=self.tilt_deg), self._mains
        begin = frequency if self.knobs is None else replace(self.knobs, beat_frequency=frequency)
        self.knobs = self._find_beat(begin, fits, mains)
        table_rate = None if table_rate is None else self._confirmed(table_rate)
        if table_rate is not None and not there and settings.rates_are_chosen:
            table_rate = self._off_mains(step, table_rate, fits, self.knobs)
        if settings.beams.channels and not settings.beams.level_v and not self.levels_known:
            self._find_levels(self.knobs)
        for channel in channels[1:]:
            fit_channel(self.bench.scope, channel, settings.scope, self._shape, self.knobs)
        now = {"scope_setting": asdict(self.knobs), "table_rate_dps": table_rate}
        asked = {"over_lock_in": step.over_lock_in}
        self.rates.append({**asked, **now})
        self.writer.save_facts({"rates": self.rates, **now})
        name = f"rate {step.sense * step.over_lock_in:+g}"
        self._take_records("measure", name, channels, len(there), count, table_rate, asked)

    def _find_levels(self, knobs: KnobPositions) -> None:
        """Measure the DC level of each beam, behind a coupling that lets it through."""
        beams, levels = self.settings.beams, []
        for channel in beams.channels:
            self.bench.scope.set_channel(channel, coupling="DC")
            fit_channel(self.bench.scope, channel, self.settings.scope, self._shape, knobs)
            levels.append(float(np.nanmean(self.bench.scope.acquire(channel).volts)))
            self.bench.scope.set_channel(channel, coupling=beams.coupling)
        self.progress.note(f"single beams: {', '.join(with_prefix(level, 'V') for level in levels)}")
        self.writer.save_facts({"beam_levels_v": levels})
        self.levels_known = True

    @property
    def _shape(self) -> ScreenShape:
        wanted = self.settings.measurement
        return ScreenShape(wanted.fill_levels, wanted.periods_min, wanted.samples_per_period_min)

    @property
    def _mains(self) -> tuple[float, ...]:
        """What beats are to keep off, Hz: the mains as stated; at rates that the program sets itself 50 and 60."""
        if (stated := self.settings.site.mains_hz) is not None:
            return (stated,)
        by_hand = isinstance(self.bench.table, ManualRateTable)
        return MAINS_HZ if self.settings.rates_are_chosen and not by_hand else ()

    def _off_mains(
        self, step: RateStep, table_rate: float, fits: Callable[[float], Beats], knobs: KnobPositions
    ) -> float:
        """The table's rate, moved a little where hum would stand beside a harmonic of the beat."""
        beat, duration = knobs.beat_frequency, DIVISIONS * knobs.seconds_per_division
        gyro = self.settings.gyro
        scale_factor, lock_in_rate = gyro.scale_factor_pulses_per_deg, gyro.expected_lock_in_rate_dps
        faster = step.sense * off_mains(beat, lock_in_rate, scale_factor, duration, self._mains)
        wanted = table_rate + faster / math.cos(math.radians(self.tilt_deg))
        if not faster or abs(wanted) > self.settings.table.highest_rate_dps:
            return table_rate
        self.progress.note(f"{wanted:.4g} deg/s on the table: a beat of {beat:.4g} Hz stands beside the mains")
        why = f"At {beat:.4g} Hz hum of the mains would stand beside a harmonic of the beat."
        moved = self.bench.turn_table(wanted, self.settings.table.settle_s, why)
        self.knobs = self._find_beat(knobs, fits, self._mains)
        return self._confirmed(moved)

    def _find_beat(
        self, start: KnobPositions | float, fits: Callable[[float], Beats] | None, mains: tuple[float, ...] = ()
    ) -> KnobPositions:
        """Find the beat; where an operator has set the table it has to fit the rate, else they are asked again."""
        settings, table = self.settings, self.bench.table
        while True:
            knobs = find_beat(self.bench.scope, settings.scope, self._shape, start, mains)
            if fits is None or not isinstance(table, ManualRateTable):
                return knobs
            beats, frequency = fits(table.rate()), knobs.beat_frequency
            if beats.holds(frequency) or not table.doubt(beats.sentence(frequency)):
                return knobs
            self.bench.sleep(settings.table.settle_s)

    def _confirmed(self, rate: float) -> float:
        """The table's rate after its beat was seen: an operator may have set it right."""
        table = self.bench.table
        return table.rate() if isinstance(table, ManualRateTable) else rate

    def _take_records(
        self,
        purpose: str,
        name: str,
        channels: tuple[str, ...],
        there: int,
        count: int,
        table_rate: float | None,
        known: Mapping[str, object] | None = None,
    ) -> None:
        """Take the records of one rate that are missing; each is on the disk before the next is asked for."""
        self.progress.start("records" if purpose == "measure" else purpose, count - there)
        for number in self.session.free_numbers(f"{name}, ", count - there):
            waveforms, conditions = take_record(self.bench, channels)
            conditions |= {"table_rate_dps": table_rate, **(known or {})}
            self.writer.save_records(
                acquisition_records(
                    purpose, f"{name}, {number}", waveforms, channels, conditions, self.settings.beams.channels
                )
            )
            self.progress.advance()

    def _saved(self, purpose: str) -> tuple[SavedRecord, ...]:
        return self.session.so_far().taken_for(purpose)

    def _taken_at(self, step: RateStep) -> tuple[SavedRecord, ...]:
        """Records that are there already of one rate and sense."""
        return tuple(
            record
            for record in self._saved("measure")
            if (one := record.conditions).get("over_lock_in", step.over_lock_in) == step.over_lock_in
            and (one.get("table_rate_dps") or step.sense) * step.sense > 0
        )
