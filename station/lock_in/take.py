"""The paper's experiment: find the tilt on a fast table, go to one slow rate or several, keep every record.

What is measured is only saved here; numbers come from the saved run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from station.errors import NoUsableSignal
from station.lock_in.rate_plan import RateStep, rate_plan
from station.lock_in.read import fast_run_tilt
from station.lock_in.settings import Settings
from station.ring_laser.bench import Bench
from station.ring_laser.open import open_bench
from station.ring_laser.records import acquisition_records, set_up, take_record
from station.runs.progress import Progress
from station.runs.store import RunWriter, SavedRecord
from station.runs.taking import Session
from station.scope.autoset import KnobPositions, find_beat, fit_channel


def take(settings: Settings, session: Session) -> None:
    """Do the whole experiment and save it; of a run that was cut short, what is missing."""
    bench = session.open(open_bench(settings, times_resumed=session.times_resumed))
    set_up(bench, settings.scope, _channels(settings))
    writer = session.begin({"identity": asdict(bench.scope.identity)})
    model = bench.scope.identity.model
    session.progress.note(f"{model} ({settings.scope.resource or 'simulated'}), run {writer.path}")
    taking = _Taking(settings, bench, session, writer, session.progress)
    if session.resumed is not None:
        taking.rates = list(session.facts.get("rates", []))
        there = len(session.so_far().taken_for("measure"))
        session.progress.note(f"{there} records are saved already")
    taking.experiment()


def _channels(settings: Settings) -> tuple[str, ...]:
    """The channels of one acquisition: the sine, and the cosine if there is a second photodiode."""
    scope = settings.scope
    return (scope.channel, scope.quadrature_channel) if scope.quadrature_channel else (scope.channel,)


@dataclass
class _Taking:
    """The experiment as it goes along: the knobs of the last rate, and the rates so far."""

    settings: Settings
    bench: Bench
    session: Session
    writer: RunWriter
    progress: Progress
    knobs: KnobPositions | None = None
    rates: list[dict[str, Any]] = field(default_factory=list)

    def experiment(self) -> None:
        cosine = 1.0
        if self.bench.table is not None:
            cosine = self._find_tilt()
        plan = rate_plan(self.settings)
        without_beat: list[str] = []
        for step in plan:
            try:
                self._take_step(step, step.rate_dps / cosine if self.bench.table is not None else None)
            except NoUsableSignal as error:
                if len(plan) == 1:
                    raise
                # the other rates may do: which one gave nothing stands in the run and in the result
                without_beat.append(f"{step.sense * step.over_lock_in:+g} expected lock-in rates: {error}")
                self.progress.note(f"no record at {without_beat[-1]}")
                self.writer.save_facts({"rates_without_beat": without_beat})
        if len(without_beat) == len(plan):
            raise NoUsableSignal(without_beat[0])

    def _find_tilt(self) -> float:
        """Turn fast, in both senses if asked for, and find the cosine of the tilt from the beat frequency."""
        settings, fast = self.settings, self.settings.table.fast_rate_dps
        count = settings.measurement.tilt_records
        # with the axis along the table's the beat would be as fast as this
        start: KnobPositions | float = settings.gyro.scale_factor_pulses_per_deg * fast
        for wanted in (fast, -fast) if settings.table.both_senses else (fast,):
            there = [one for one in self._saved("tilt") if one.conditions["table_rate_dps"] * wanted > 0]
            if len(there) >= count:
                continue
            self.progress.note(f"fast run at {wanted:+g} deg/s")
            rate = self.bench.turn_table(wanted, settings.table.settle_s)
            self.knobs = start = find_beat(self.bench.scope, settings.scope, settings.measurement, start)
            self._take_records("tilt", f"tilt {wanted:+g}", (settings.scope.channel,), len(there), count, rate)
        tilt = fast_run_tilt(self.session.so_far(), settings)
        self.progress.note(f"tilt {tilt.tilt_deg:.3f}°")
        return math.cos(math.radians(tilt.tilt_deg))

    def _take_step(self, step: RateStep, table_rate: float | None) -> None:
        """Go to one rate, find the beat and take the records; without `table_rate` the table turns already."""
        settings, channels = self.settings, _channels(self.settings)
        there, count = self._taken_at(step), settings.measurement.records
        if there >= count:
            return
        frequency = settings.gyro.scale_factor_pulses_per_deg * abs(step.rate_dps)
        if table_rate is None:
            self.progress.note("looking for the beat")
        else:
            self.progress.note(f"slow rate {table_rate:.4g} deg/s on the table")
            table_rate = self.bench.turn_table(table_rate, settings.table.settle_s)
        begin = frequency if self.knobs is None else _for_frequency(self.knobs, frequency)
        self.knobs = find_beat(self.bench.scope, settings.scope, settings.measurement, begin)
        for channel in channels[1:]:
            fit_channel(self.bench.scope, channel, settings.scope, settings.measurement, self.knobs)
        now = {"scope_setting": asdict(self.knobs), "table_rate_dps": table_rate}
        asked = {"over_lock_in": step.over_lock_in}
        self.rates.append({**asked, **now})
        self.writer.save_facts({"rates": self.rates, **now})
        name = f"rate {step.sense * step.over_lock_in:+g}"
        self._take_records("measure", name, channels, there, count, table_rate, asked)

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
                acquisition_records(purpose, f"{name}, {number}", waveforms, channels, conditions)
            )
            self.progress.advance()

    def _saved(self, purpose: str) -> tuple[SavedRecord, ...]:
        return self.session.so_far().taken_for(purpose)

    def _taken_at(self, step: RateStep) -> int:
        """Records that are there already of one rate and sense."""
        if self.session.resumed is None:
            return 0
        conditions = [record.conditions for record in self._saved("measure")]
        return sum(
            one.get("over_lock_in", step.over_lock_in) == step.over_lock_in
            and (one.get("table_rate_dps") or step.sense) * step.sense > 0
            for one in conditions
        )


def _for_frequency(knobs: KnobPositions, frequency: float) -> KnobPositions:
    return KnobPositions(**{**asdict(knobs), "beat_frequency": frequency})
