"""Carrying a campaign out: step after step, whatever the bench does, and from where it was cut short."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from instrument import InstrumentError
from station.campaign.bench import Environment, bench_in_use
from station.campaign.journal import (
    CampaignOutcome,
    CampaignPlan,
    Journal,
    PlannedStep,
    StepOutcome,
    Written,
    read_journal,
    step_as_json,
)
from station.campaign.record import file_sha256
from station.errors import (
    EXIT_DEFECT,
    EXIT_NO_SIGNAL,
    CannotWrite,
    Failure,
    NoUsableSignal,
    RunError,
    StationError,
    UsageError,
    describe_failure,
    one_line,
)
from station.live.events import Progress
from station.measurements import measurement, steps_by_name
from station.results.verdict import ABORTED, ERROR, FAIL, judged, worst
from station.runs.acquisition import Taken
from station.runs.database import utc_now
from station.runs.signals import disturbed, undisturbed
from station.runs.store import RUN_FILE, open_run
from station.settings import saved_settings
from station.shell.finish import Evaluated, evaluate_run, keep, resume_run, save_outcome, start_run


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
    if before is not None and before.ended_at and not before.left:
        return before.outcome()  # only its record was not written any more
    with bench_in_use(plan), undisturbed():  # a signal ends what is measured, and nothing of what closes the test
        kept = {} if evaluated is None else evaluated
        return _Conducting(plan, progress, operator, note, before, kept).conduct()


def _as_now(step: PlannedStep) -> PlannedStep:
    """A step of an earlier version, with the settings that this one has beside its own."""
    try:
        settings = saved_settings(measurement(step.measurement).kind, step.settings, step.key)
    except RunError:
        return step
    return replace(step, settings=settings.model_dump(mode="json"))


def to_go_on_with(directory: Path, plan: CampaignPlan) -> Written:
    """Return what a test holds that is to be gone on with by this plan."""
    before = read_journal(directory)
    if before.plan.unit != plan.unit:
        raise UsageError(f"{directory}: is a test of {before.plan.unit}, not of {plan.unit}")
    if tuple(map(_as_now, before.plan.steps)) != plan.steps:
        raise UsageError(
            f"{directory}: cannot be gone on with: {plan.file} has other steps, settings or limits now; "
            f"{directory / 'campaign.toml'} is the campaign that it was begun with"
        )
    if not before.is_unfinished:
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
                ended = {one.verdict for one in self.done.values()} if self.plan.stop_after_failure else set()
                due = step.is_due(self.done.values()) and (step.only_if is not None or not ended & {FAIL, ERROR})
                if step.key in self.done or not due:
                    continue
                wait = Wait(self.progress, skipped=self.plan.simulated)
                # a unit that goes on after a power failure is cold
                again = self.before is not None and not any(
                    one.key not in self.done for one in self.plan.steps[:place]
                )
                self._one(journal, step, surroundings, wait, warm if again else step.warm_up_s)

    @contextmanager
    def _surroundings(self) -> Iterator[Environment]:
        surroundings = Environment(self.plan, self.progress)
        try:
            yield surroundings
        finally:
            if self.plan.switch_off_afterwards:
                surroundings.switch_off()

    def _one(
        self, journal: Journal, step: PlannedStep, surroundings: Environment, wait: Wait, warm_up_s: float
    ) -> None:
        """Carry one step out and write how it has ended."""
        events, of = self.progress.events, len(self.plan.steps)
        number = self.plan.steps.index(step) + 1
        title = measurement(step.measurement).title
        events.emit("step_begun", step=step.key, number=number, of=of, measurement=step.measurement, title=title)
        journal.write("step_begun", key=step.key)
        clock, given = time.monotonic(), {"unit": self.plan.unit, "operator": self.operator, "note": self.note}
        begun, attempts = utc_now(), 0
        if self.before is not None and (before := self.before.begun.get(step.key)):  # it has a first part
            last = self.before.steps.get(step.key)
            begun, attempts = before[0], len(before) if last is None else last.attempts
        try:
            outcome = carry_out(
                step,
                self.plan,
                journal.directory,
                self.progress,
                surroundings,
                wait,
                labels={name: text for name, text in given.items() if text},
                warm_up_s=warm_up_s,
                started_at=begun,
                evaluated=self.evaluated,
                before=self.done.values(),
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
        seconds = time.monotonic() - clock
        if attempts:
            since = datetime.fromisoformat(utc_now()) - datetime.fromisoformat(begun)
            seconds = max(seconds, since.total_seconds())
        outcome = replace(outcome, elapsed_s=round(seconds, 3), attempts=outcome.attempts + attempts)
        self.done[step.key] = outcome
        with undisturbed():
            journal.write("step_ended", **step_as_json(outcome, journal.directory))
        ended = {"verdict": outcome.verdict, "run": outcome.run, "message": outcome.message}
        events.emit("step_ended", step=step.key, number=number, **ended)

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


# --------------------
# One step of a campaign: set its conditions, take its run whatever the bench does, evaluate it, judge it


_LOG = logging.getLogger(__name__)
_KEPT = 50  # evaluated runs in memory


def carry_out(
    step: PlannedStep,
    plan: CampaignPlan,
    directory: Path,
    progress: Progress,
    surroundings: Environment,
    wait: Wait,
    *,
    labels: Mapping[str, str],
    warm_up_s: float,
    started_at: str,
    evaluated: dict[str, Evaluated],
    before: Iterable[StepOutcome],
) -> StepOutcome:
    """Carry out one step of a test."""
    begun = StepOutcome(step, None, started_at=started_at)
    folder = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in step.key)
    attempt = _Attempts(step, plan, directory / "runs" / folder, progress, labels)
    try:
        conditions = surroundings.bring_about(step)
        wait("warm-up", warm_up_s)
        wait("settling", step.settle_s)
        taken = attempt.take(wait)
    except CannotWrite:
        raise
    except Exception as error:
        # a run that the last attempt could not go on with is there all the same
        begun = replace(begun, attempts=attempt.count, remarks=tuple(attempt.remarks), run=attempt.run_so_far())
        return _failed(begun, _described(error, step))
    begun = replace(begun, attempts=attempt.count, conditions=conditions, remarks=tuple(attempt.remarks))
    return _evaluated(begun, taken, plan, evaluated, before)


@dataclass
class _Attempts:
    """Taking a run that the bench may end: it is gone on with as often as the campaign says."""

    step: PlannedStep
    plan: CampaignPlan
    folder: Path
    progress: Progress
    labels: Mapping[str, str]
    count: int = 0

    def __post_init__(self) -> None:
        self.remarks: list[str] = []
        if self.step.only_if is not None and self.step.only_if["instead"]:
            self.remarks.append(f"its verdict counts in the place of that of {self.step.only_if['step']}")

    def take(self, wait: Wait) -> Taken:
        """Take the run; the last failure of the bench is in what it returns, or raised where there is no run."""
        while True:
            self.count += 1
            last = self.count >= self.plan.attempts
            try:
                taken = self._once()
            except _BENCH as error:
                failure = describe_failure(error)
                if last or failure is None:
                    raise
            else:
                if isinstance(taken.error, KeyboardInterrupt | CannotWrite):
                    raise taken.error
                if taken.failure is None or last:
                    return taken
                failure = taken.failure
            said = f"attempt {self.count} of {self.plan.attempts} has failed: {failure.message}"
            self.remarks.append(said)
            self.progress.note(f"{self.step.name}: {said}")
            wait("pause before the next attempt", self.plan.retry_after_s)

    def _once(self) -> Taken:
        kind = measurement(self.step.measurement)
        there = self.run_so_far()
        if there is None:
            values = {**self.step.settings, "output": {"directory": str(self.folder)}}
            return start_run(kind, kind.kind.model.model_validate(values), self.progress, labels=self.labels)
        try:
            return resume_run(there, self.progress, kind=kind, labels=self.labels)
        except UsageError:
            if open_run(there).facts.complete:  # killed after the run had ended, before the journal said so
                return Taken(there, None)
            raise

    def run_so_far(self) -> Path | None:
        """Return the run that an earlier attempt or session has begun."""
        there = sorted(self.folder.glob(f"*/{RUN_FILE}"))
        return there[-1] if there else None


_BENCH = InstrumentError, NoUsableSignal  # what a bench does that may be over in a moment


def _evaluated(
    begun: StepOutcome,
    taken: Taken,
    plan: CampaignPlan,
    known: dict[str, Evaluated],
    before: Iterable[StepOutcome],
) -> StepOutcome:
    """Evaluate a run, keep its result beside it, and judge it."""
    path, failure = taken.path, taken.failure
    begun = replace(begun, run=path)
    try:
        evaluated = evaluate_run(taken.run())
        document, lost = keep(evaluated, report=plan.reports)
        save_outcome(evaluated.run, failure or lost)
    except NoUsableSignal as error:
        failure = failure or describe_failure(error)
        save_outcome(taken.run(), failure)
        return _failed(replace(begun, run_sha256=file_sha256(path)), failure)
    except CannotWrite:
        raise
    except Exception as error:
        return _failed(begun, failure or _described(error, begun.step))
    if len(known) < _KEPT:
        known[begun.step.key] = evaluated
    result = evaluated.result
    said = [*(one.sentence for one in result.left_out), *evaluated.run.damaged]
    remarks = (*begun.remarks, *said, *((lost.message,) if lost is not None else ()))
    begun = replace(begun, document=document, remarks=remarks, run_sha256=file_sha256(path))
    if failure is None and result.problem:
        failure = Failure(NoUsableSignal.kind, result.problem, EXIT_NO_SIGNAL)
    if failure is not None:
        return _failed(begun, failure)
    steps = steps_by_name((one.step.key, one.step.measurement, one.document) for one in before)
    limits = judged(result, document, begun.step.limits, doubtful=begun.step.doubtful, steps=steps)
    return replace(begun, limits=limits, verdict=worst(one.verdict for one in limits), ended_at=utc_now())


def _failed(begun: StepOutcome, failure: Failure | None) -> StepOutcome:
    return replace(begun, verdict=ERROR, failure=failure, ended_at=utc_now())


def _described(error: Exception, step: PlannedStep) -> Failure:
    """Put an error into words; a defect in one step does not take the others with it, and stands in the log."""
    known = describe_failure(error)
    if known is not None:
        return known
    _LOG.exception("a defect of gyrolock in step %s", step.key)
    text = (
        f"{type(error).__name__}: {one_line(error)} (this is a defect of gyrolock; the station's log shows where)"
    )
    return Failure("defect", text, EXIT_DEFECT)


# --------------------
# Letting time pass between steps: by a clock that nobody sets, and so that a signal is heard


_SLICE_S = 0.5


@dataclass(frozen=True)
class Wait:
    """Waits, and says for what."""

    progress: Progress
    skipped: bool = False  # on a simulated bench no time passes

    def __call__(self, what: str, seconds: float) -> None:
        """Wait so many seconds; zero or less returns at once."""
        if seconds <= 0:
            return
        if self.skipped:
            self.progress.note(f"{what}: {seconds:g} s, passed over on a simulated bench")
            return
        self.progress.events.emit("waiting", what=what, seconds=seconds)
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            time.sleep(min(left, _SLICE_S))
