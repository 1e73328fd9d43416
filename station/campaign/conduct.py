"""Carrying a campaign out: step after step, whatever the bench does, and from where it was cut short."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from station.campaign.bench.in_use import bench_in_use
from station.campaign.bench.surroundings import Surroundings
from station.campaign.journal import Journal, Written, read_journal, step_as_json
from station.campaign.outcome import CampaignOutcome, StepOutcome
from station.campaign.plan import CampaignPlan, PlannedStep
from station.campaign.step import carry_out
from station.campaign.waiting import Wait
from station.errors import Failure, StationError, UsageError, describe_failure
from station.measurements import measurement
from station.results.verdict import ABORTED
from station.runs.database import utc_now
from station.runs.progress import Progress
from station.runs.stop import disturbed, undisturbed
from station.shell.evaluated import Evaluated


def conduct(
    plan: CampaignPlan,
    progress: Progress,
    *,
    operator: str = "",
    note: str = "",
    resumed: Path | None = None,
    evaluated: dict[str, Evaluated] | None = None,
) -> CampaignOutcome:
    """Test one unit."""
    before = None if resumed is None else to_go_on_with(resumed, plan)
    with bench_in_use(plan), undisturbed():  # a signal ends what is measured, and nothing of what closes the test
        kept = {} if evaluated is None else evaluated
        return _Conducting(plan, progress, operator, note, before, kept).conduct()


def to_go_on_with(directory: Path, plan: CampaignPlan) -> Written:
    """Return what a test holds that is to be gone on with by this plan."""
    before = read_journal(directory)
    if before.plan.unit != plan.unit:
        raise UsageError(f"{directory}: is a test of {before.plan.unit}, not of {plan.unit}")
    if before.plan.steps != plan.steps:
        raise UsageError(
            f"{directory}: cannot be gone on with: {plan.file} has other steps, settings or limits now; "
            f"{directory / 'campaign.toml'} is the campaign that it was begun with"
        )
    if not before.left:
        raise UsageError(f"{directory}: has come to its end, there is nothing to go on with")
    return before


@dataclass
class _Conducting:
    """One session of a test."""

    plan: CampaignPlan
    progress: Progress
    operator: str
    note: str
    before: Written | None
    evaluated: dict[str, Evaluated]
    done: dict[str, StepOutcome] = field(default_factory=dict)

    def conduct(self) -> CampaignOutcome:
        journal, began = self._open()
        events = self.progress.events
        names = [step.key for step in self.plan.steps]
        about = {"campaign": self.plan.name, "unit": self.plan.unit, "steps": names, "of": len(names)}
        events.emit("campaign_begun", **about, seconds=None, resumed=self.before is not None)
        failure: Failure | None = None
        try:
            with disturbed():
                self._go_through(journal)
        except (StationError, OSError, KeyboardInterrupt) as error:
            failure = describe_failure(error)
        outcome = self._outcome(journal, began, failure)
        try:
            journal.write("ended", failure=None if failure is None else failure.as_json(), verdict=outcome.verdict)
        except StationError as error:  # a full disk; what it took is there, and the test can be gone on with
            outcome = self._outcome(journal, began, failure or describe_failure(error))
        finally:
            journal.close()
        ending = {"verdict": outcome.verdict, "exit_code": outcome.exit_code, "message": outcome.message}
        events.emit("campaign_ended", **ending)
        return outcome

    def _open(self) -> tuple[Journal, str]:
        if self.before is None:
            return Journal.begin(self.plan, self.operator, self.note), utc_now()
        journal = Journal(self.before.directory)
        journal.open()
        journal.write("resumed")
        left = {step.key for step in self.before.left}
        self.done = {key: one for key, one in self.before.steps.items() if key not in left}
        self.operator, self.note = self.operator or self.before.operator, self.note or self.before.note
        return journal, self.before.started_at

    def _go_through(self, journal: Journal) -> None:
        warm = 0.0
        with self._surroundings() as surroundings:
            for place, step in enumerate(self.plan.steps):
                warm = max(warm, step.warm_up_s)
                if step.key in self.done:
                    continue
                wait = Wait(self.progress, skipped=self.plan.simulated)
                # a unit that goes on after a power failure is cold
                again = self.before is not None and not any(
                    one.key not in self.done for one in self.plan.steps[:place]
                )
                self._one(journal, step, surroundings, wait, warm if again else step.warm_up_s)

    @contextmanager
    def _surroundings(self) -> Iterator[Surroundings]:
        surroundings = Surroundings(self.plan, self.progress)
        try:
            yield surroundings
        finally:
            if self.plan.switch_off_afterwards:
                surroundings.switch_off()

    def _one(
        self, journal: Journal, step: PlannedStep, surroundings: Surroundings, wait: Wait, warm_up_s: float
    ) -> None:
        """Carry one step out and write how it has ended."""
        events, of = self.progress.events, len(self.plan.steps)
        number = self.plan.steps.index(step) + 1
        title = measurement(step.measurement).title
        events.emit("step_begun", step=step.key, number=number, of=of, measurement=step.measurement, title=title)
        journal.write("step_begun", key=step.key)
        begun, clock = utc_now(), time.monotonic()
        try:
            outcome = carry_out(
                step,
                self.plan,
                journal.directory,
                self.progress,
                surroundings,
                wait,
                labels=self._labels(),
                warm_up_s=warm_up_s,
                started_at=begun,
                evaluated=self.evaluated,
            )
        except KeyboardInterrupt as error:
            stopped = StepOutcome(
                step, ABORTED, failure=describe_failure(error), started_at=begun, ended_at=utc_now()
            )
            self.done[step.key] = stopped
            events.emit(
                "step_ended", step=step.key, number=number, verdict=ABORTED, run=None, message=stopped.message
            )
            raise
        outcome = outcome.lasting(time.monotonic() - clock)
        self.done[step.key] = outcome
        with undisturbed():
            journal.write("step_ended", **step_as_json(outcome, journal.directory))
        ended = {"verdict": outcome.verdict, "run": outcome.run, "message": outcome.message}
        events.emit("step_ended", step=step.key, number=number, **ended)

    def _labels(self) -> dict[str, str]:
        given = {"unit": self.plan.unit, "operator": self.operator, "note": self.note}
        return {name: text for name, text in given.items() if text}

    def _outcome(self, journal: Journal, began: str, failure: Failure | None) -> CampaignOutcome:
        resumed: tuple[str, ...] = ()
        if self.before is not None:
            resumed = read_journal(journal.directory).resumed_at
        return CampaignOutcome(
            self.plan,
            self.operator,
            self.note,
            journal.directory,
            began,
            utc_now(),
            tuple(self.done[step.key] for step in self.plan.steps if step.key in self.done),
            failure,
            resumed,
        )
