"""An unattended test station as a call: for scripts, and for test frameworks of others."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from station.campaign.conduct import conduct
from station.campaign.file import read_campaign
from station.campaign.outcome import CampaignOutcome
from station.campaign.plan import CampaignPlan
from station.display.opening import shown
from station.notebook.show import html_table
from station.record.verify import Check, verify
from station.record.write import RecordFiles, write_record
from station.results.verdict import Limit, LimitOutcome, Verdict
from station.runs.stop import ending_signals

PathLike = str | os.PathLike[str]


class Station:
    """A bench and the campaign that units are tested by. The same as the command ``gyrolock station``.

    Parameters
    ----------
    campaign : path
        TOML file.
    quiet : bool, optional
        Show no progress on stderr.

    Examples
    --------
    ::

        station = gyrolock.Station("campaign.toml")
        tested = station.test("RLG-001", operator="B. Bauer")
        tested.verdict, tested.exit_code, tested.files.json
    """

    def __init__(self, campaign: PathLike, *, quiet: bool = False) -> None:
        self.campaign, self._quiet = Path(campaign), quiet

    def plan(self, unit: str) -> CampaignPlan:
        """Return what would be done with a unit; SettingsError names every mistake of the file."""
        return read_campaign(self.campaign, unit)

    def limits(self, unit: str) -> dict[str, Limit]:
        """Return the limits that a unit has to keep to: by the key of the step and the name of the number."""
        return {f"{step.key}: {limit.number}": limit for step in self.plan(unit).steps for limit in step.limits}

    def test(self, unit: str, *, operator: str = "", note: str = "", resume: PathLike | None = None) -> TestedUnit:
        """Test one unit, and write the record of the test beside its runs.

        Parameters
        ----------
        unit : str
            Serial number.
        resume : path, optional
            Folder of a test that was cut short: it goes on.

        Returns
        -------
        TestedUnit
            Also when the bench has failed or the test was stopped: `verdict` says so.

        Raises
        ------
        SettingsError, StationError
            The test cannot begin, or its record cannot be written.
        """
        plan = self.plan(unit)
        about = {"unit": unit, "operator": operator or None, "note": note or None}
        with ending_signals(second_ends=False), shown({"quiet": self._quiet}, "station", **about) as progress:
            before = None if resume is None else Path(resume)
            outcome = conduct(plan, progress, operator=operator, note=note, resumed=before)
            files = write_record(outcome)
            progress.end(outcome.exit_code, outcome.message)
        return TestedUnit(outcome, files)

    def __repr__(self) -> str:
        return f"<Station of {self.campaign}>"


class TestedUnit:
    """How the test of a unit has ended."""

    __test__ = False  # pytest takes whatever begins with Test for one of its own

    def __init__(self, outcome: CampaignOutcome, files: RecordFiles) -> None:
        self.outcome, self.files = outcome, files

    @property
    def verdict(self) -> Verdict | None:
        """``"PASS"``, ``"MARGINAL"``, ``"FAIL"``, ``"ERROR"``, ``"ABORTED"``; ``None`` without limits."""
        return self.outcome.verdict

    @property
    def exit_code(self) -> int:
        """What the command would have ended with."""
        return self.outcome.exit_code

    @property
    def message(self) -> str:
        """In one line why; empty for PASS."""
        return self.outcome.message

    @property
    def limits(self) -> dict[str, LimitOutcome]:
        """Every number against its limit: by the key of the step and the name of the number."""
        return {f"{step.step.key}: {one.name}": one for step in self.outcome.steps for one in step.limits}

    @property
    def record(self) -> Mapping[str, Any]:
        """The record of the test as JSON."""
        return self.files.document

    def verify(self) -> list[Check]:
        """Prove that record and raw runs belong together, and compute the result again."""
        return verify(self.files.json)

    def __repr__(self) -> str:
        why = f": {self.message}" if self.message else ""
        return f"<TestedUnit {self.outcome.plan.unit}: {self.verdict or 'measured'}{why}>"

    def _repr_html_(self) -> str:
        rows = [(name, one.sentence) for name, one in self.limits.items()]
        return html_table(f"{self.outcome.plan.unit}: {self.verdict or 'measured'}", rows)
