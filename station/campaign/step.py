"""One step of a campaign: set its conditions, take its run whatever the bench does, evaluate it, judge it."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from station.campaign.bench.surroundings import Surroundings
from station.campaign.file import RESULT
from station.campaign.outcome import StepOutcome
from station.campaign.plan import CampaignPlan, PlannedStep
from station.campaign.waiting import Wait
from station.errors import (
    EXIT_DEFECT,
    EXIT_NO_SIGNAL,
    CannotWrite,
    Failure,
    NoUsableSignal,
    UsageError,
    describe_failure,
    one_line,
)
from station.measurements import Measurement, measurement
from station.results.result import Result
from station.results.values import values_of
from station.results.verdict import ERROR, FAIL, MARGINAL, PASS, LimitOutcome, Value, Verdict, decide, worst
from station.runs.database import utc_now
from station.runs.progress import Progress
from station.runs.store import RUN_FILE, open_run
from station.runs.taking import Taken
from station.shell.ending import keep, save_outcome
from station.shell.evaluated import Evaluated, evaluate_run
from station.shell.running import resume_run, start_run

_LOG = logging.getLogger(__name__)
_DECIDED = (PASS, FAIL)
_KEPT = 50  # evaluated runs in memory


def carry_out(
    step: PlannedStep,
    plan: CampaignPlan,
    directory: Path,
    progress: Progress,
    surroundings: Surroundings,
    wait: Wait,
    *,
    labels: Mapping[str, str],
    warm_up_s: float,
    started_at: str,
    evaluated: dict[str, Evaluated],
) -> StepOutcome:
    """Carry out one step of a test."""
    begun = StepOutcome(step, None, started_at=started_at)
    attempt = _Attempts(step, plan, directory / "runs" / _folder(step.key), progress, labels)
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
    return _evaluated(begun, taken, plan, evaluated)


def _folder(key: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in key)


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
            return start_run(kind, self._settings(kind), self.progress, labels=self.labels)
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

    def _settings(self, kind: Measurement[Any, Any]) -> Any:
        values = {**self.step.settings, "output": {"directory": str(self.folder)}}
        return kind.kind.model.model_validate(values)


def _bench_errors() -> tuple[type[Exception], ...]:
    from instrument import InstrumentError

    return InstrumentError, NoUsableSignal


_BENCH = _bench_errors()
"""What a bench does that may be over in a moment."""


def _evaluated(begun: StepOutcome, taken: Taken, plan: CampaignPlan, known: dict[str, Evaluated]) -> StepOutcome:
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
        return _failed(replace(begun, run_sha256=_sha256(path)), failure)
    except CannotWrite:
        raise
    except Exception as error:
        return _failed(begun, failure or _described(error, begun.step))
    if len(known) < _KEPT:
        known[begun.step.key] = evaluated
    result = evaluated.result
    remarks = (*begun.remarks, *_remarks(evaluated), *((lost.message,) if lost is not None else ()))
    begun = replace(begun, document=document, remarks=remarks, run_sha256=_sha256(path))
    if failure is None and result.problem:
        failure = Failure(NoUsableSignal.kind, result.problem, EXIT_NO_SIGNAL)
    if failure is not None:
        return _failed(begun, failure)
    limits = judged(begun.step, result, document)
    return replace(begun, limits=limits, verdict=worst(one.verdict for one in limits), ended_at=utc_now())


def _remarks(evaluated: Evaluated) -> list[str]:
    return [*(one.sentence for one in evaluated.result.left_out), *evaluated.run.damaged]


def judged(step: PlannedStep, result: Result, document: Mapping[str, Any]) -> tuple[LimitOutcome, ...]:
    """Judge the numbers of a result by the limits of a step; one that does not stand decides nothing."""
    outcomes = []
    for limit in step.limits:
        values = values_of(result, document, limit.number, RESULT) or [Value(float("nan"), "")]
        outcomes += [decide(limit, value) for value in values]
    standing = result.standing
    if standing.state == "fails":
        return tuple(_instead(one, ERROR, "the result does not hold", standing.reasons) for one in outcomes)
    if standing.state == "doubtful" and step.doubtful == "marginal":
        why = "the result is doubtful"
        # what is decided without its uncertainty is not touched by what rules the uncertainty
        return tuple(
            one if one.limit.rule == "none" else _instead(one, MARGINAL, why, standing.reasons) for one in outcomes
        )
    return tuple(outcomes)


def _instead(outcome: LimitOutcome, verdict: Verdict, why: str, reasons: Sequence[str]) -> LimitOutcome:
    """Put another verdict where the value alone would have decided."""
    if outcome.verdict not in _DECIDED:
        return outcome
    sentence = outcome.sentence.replace(outcome.verdict, verdict, 1)
    return replace(outcome, verdict=verdict, sentence=f"{sentence}; {why}: {'; '.join(reasons)}")


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


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
