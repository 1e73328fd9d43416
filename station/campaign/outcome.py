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
    """How one step has ended.

    Attributes
    ----------
    verdict : str or None
        ``None``: it was measured, and has no limits.
    limits : tuple of LimitOutcome
    document : mapping
        JSON of the result; empty where there is none.
    run : Path or None
        The run's file.
    run_sha256 : str
        Of that file as the step left it.
    failure : Failure or None
        What kept it from a result.
    remarks : tuple of str
        What else is to be known: what was left out, what is doubtful, what was tried again.
    started_at, ended_at : str
        UTC, ISO 8601.
    elapsed_s : float
        By a clock that nobody sets; of the last session.
    attempts : int
        How often it was begun anew.
    conditions : mapping
        What the controllers showed at its beginning.
    """

    step: PlannedStep
    verdict: Verdict | None
    limits: tuple[LimitOutcome, ...] = ()
    document: Mapping[str, Any] = field(default_factory=dict)
    run: Path | None = None
    run_sha256: str = ""
    failure: Failure | None = None
    remarks: tuple[str, ...] = ()
    started_at: str = ""
    ended_at: str = ""
    elapsed_s: float = 0.0
    attempts: int = 1
    conditions: Mapping[str, float] = field(default_factory=dict)

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
    """How the test of a unit has ended.

    Attributes
    ----------
    directory : Path
        Of this test: runs, log, journal.
    steps : tuple of StepOutcome
        Those that were begun, in the order of the plan.
    failure : Failure or None
        What ended all of it before its time.
    resumed_at : tuple of str
        When it was gone on with, UTC.
    """

    plan: CampaignPlan
    operator: str
    note: str
    directory: Path
    started_at: str
    ended_at: str
    steps: tuple[StepOutcome, ...]
    failure: Failure | None = None
    resumed_at: tuple[str, ...] = ()

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
