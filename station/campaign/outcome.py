"""How the test of a unit has ended: each step, and all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from station.campaign.plan import CampaignPlan, PlannedStep
from station.errors import EXIT_FAIL, EXIT_INTERRUPTED, EXIT_MARGINAL, EXIT_NO_SIGNAL, EXIT_OK, Failure
from station.results.verdict import ABORTED, ERROR, FAIL, MARGINAL, LimitOutcome, Verdict, worst


@dataclass(frozen=True)
class StepOutcome:
    """How one step has ended."""

    step: PlannedStep
    verdict: Verdict | None  # ``None``: it was measured, and has no limits
    limits: tuple[LimitOutcome, ...] = ()
    document: Mapping[str, Any] = field(default_factory=dict)  # JSON of the result; empty where there is none
    run: Path | None = None  # the run's file
    run_sha256: str = ""  # of that file as the step left it
    failure: Failure | None = None  # what kept it from a result
    # what else is to be known: what was left out, what is doubtful, what was tried again
    remarks: tuple[str, ...] = ()
    started_at: str = ""  # UTC, ISO 8601
    ended_at: str = ""
    elapsed_s: float = 0.0  # by a clock that nobody sets; of the last session
    attempts: int = 1  # how often it was begun anew
    conditions: Mapping[str, float] = field(default_factory=dict)  # what the controllers showed at its beginning

    def lasting(self, seconds: float) -> StepOutcome:
        """Return it with the time that it took."""
        return replace(self, elapsed_s=round(seconds, 3))

    @property
    def message(self) -> str:
        """In one line why the verdict is what it is; empty for PASS."""
        if self.failure is not None:
            return self.failure.message
        return "; ".join(one.sentence for one in self.limits if one.verdict == self.verdict != "PASS")


@dataclass(frozen=True)
class CampaignOutcome:
    """How the test of a unit has ended."""

    plan: CampaignPlan
    operator: str
    note: str
    directory: Path  # of this test: runs, log, journal
    started_at: str
    ended_at: str
    steps: tuple[StepOutcome, ...]  # those that were begun, in the order of the plan
    failure: Failure | None = None  # what ended all of it before its time
    resumed_at: tuple[str, ...] = ()  # when it was gone on with, UTC

    @property
    def verdict(self) -> Verdict | None:
        """The worst of all steps; ABORTED where it was ended from outside; ``None`` without limits."""
        if self.failure is not None:
            return ABORTED if _from_outside(self.failure) else ERROR
        return worst(one.verdict for one in self.steps if one.verdict is not None)

    @property
    def exit_code(self) -> int:
        """0 PASS or no limits, 1 FAIL, 6 MARGINAL; ERROR and ABORTED have the code of what happened."""
        verdict = self.verdict
        if self.failure is not None:
            return self.failure.exit_code
        if verdict in (ERROR, ABORTED):
            failed = next((one.failure for one in self.steps if one.failure is not None), None)
            return EXIT_NO_SIGNAL if failed is None else failed.exit_code
        return EXIT_FAIL if verdict == FAIL else EXIT_MARGINAL if verdict == MARGINAL else EXIT_OK

    @property
    def message(self) -> str:
        """In one line why the verdict is what it is; empty for PASS."""
        if self.failure is not None:
            return self.failure.message
        said = (
            f"{one.step.name}: {one.message}" for one in self.steps if one.verdict == self.verdict and one.message
        )
        return next(said, "")


def _from_outside(failure: Failure) -> bool:
    """Whether a person or the system ended it: a signal, or Ctrl-C."""
    return failure.exit_code >= EXIT_INTERRUPTED - 1
