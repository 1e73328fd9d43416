"""The record of a test as one JSON document: all that is known of it, and nothing that must be looked up."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from station.campaign.outcome import CampaignOutcome, StepOutcome
from station.campaign.plan import InstrumentCard
from station.errors import StationError
from station.provenance import provenance
from station.record.hashes import CONTENT, canonical, content_sha256, file_sha256, records_sha256
from station.results.as_json import plain
from station.results.verdict import LimitOutcome
from station.runs.store import open_run
from station.shell.evaluated import Evaluated

NAME, VERSION = "gyrolock test record", 1
SCHEMA_FILE = Path(__file__).with_name("test-record-1.schema.json")
"""JSON Schema of this version."""


def record_document(outcome: CampaignOutcome, evaluated: Mapping[str, Evaluated]) -> dict[str, Any]:
    """Return the record of a test as plain JSON."""
    plan = outcome.plan
    settings = plain(plan.settings)
    document = {
        "schema": {"name": NAME, "version": VERSION},
        "unit": {"serial": plan.unit, "type": plan.unit_type, "is_reference": plan.is_reference},
        "operator": outcome.operator or None,
        "note": outcome.note or None,
        "station": {"name": plan.station or None, "host": platform.node() or None},
        "simulated": plan.simulated,
        "started_at": outcome.started_at,
        "ended_at": outcome.ended_at or None,
        "resumed_at": list(outcome.resumed_at),
        "outcome": {
            "verdict": outcome.verdict,
            "exit_code": outcome.exit_code,
            "message": outcome.message or None,
            "failure": None if outcome.failure is None else outcome.failure.as_json(),
        },
        "campaign": {
            "name": plan.name,
            "file": plan.file.name,
            "file_sha256": plan.file_sha256,
            "settings": settings,
            "settings_sha256": _sum_of(settings),
        },
        "instruments": [_instrument(card, outcome.started_at) for card in plan.instruments],
        "software": provenance(),
        "steps": [_step(one, outcome.directory, evaluated.get(one.step.key)) for one in outcome.steps],
        "not_begun": _not_begun(outcome),
    }
    whole: dict[str, Any] = dict(plain(document))
    return {**whole, CONTENT: content_sha256(whole)}


def _sum_of(value: object) -> str:
    import hashlib

    return hashlib.sha256(canonical(value)).hexdigest()


def _instrument(card: InstrumentCard, at: str) -> dict[str, Any]:
    due = card.calibration_due
    return {
        "role": card.role,
        "model": card.model or None,
        "serial": card.serial or None,
        "firmware": card.firmware or None,
        "calibrated_on": _day(card.calibrated_on),
        "calibration_due": _day(due),
        "calibration_valid": None if due is None or not at else at[:10] <= due.isoformat(),
    }


def _day(day: date | None) -> str | None:
    return None if day is None else day.isoformat()


def _not_begun(outcome: CampaignOutcome) -> list[dict[str, Any]]:
    begun = {one.step.key for one in outcome.steps}
    return [
        {"key": step.key, "name": step.name, "number": step.number, "measurement": step.measurement}
        for step in outcome.plan.steps
        if step.key not in begun
    ]


def _step(outcome: StepOutcome, directory: Path, evaluated: Evaluated | None) -> dict[str, Any]:
    step, result = outcome.step, dict(plain(outcome.document))
    return {
        "key": step.key,
        "name": step.name,
        "number": step.number,
        "measurement": step.measurement,
        "repeat": step.repeat,
        "of_repeats": step.of_repeats,
        "verdict": outcome.verdict,
        "message": outcome.message or None,
        "failure": None if outcome.failure is None else outcome.failure.as_json(),
        "remarks": list(outcome.remarks),
        "started_at": outcome.started_at or None,
        "ended_at": outcome.ended_at or None,
        "elapsed_s": outcome.elapsed_s,
        "attempts": outcome.attempts,
        "doubtful": step.doubtful,
        "conditions": {"planned": step.conditions, "found": outcome.conditions},
        "limits": [limit_document(one) for one in outcome.limits],
        "result": result or None,
        "budget": result.get("budget"),
        "records": [] if evaluated is None else [_row(row) for row in evaluated.rows()],
        "run": None if outcome.run is None else _run(outcome.run, directory, outcome.run_sha256, evaluated),
    }


def limit_document(one: LimitOutcome) -> dict[str, Any]:
    """Return a number against its limit as JSON."""
    limit, measured = one.limit, one.measured
    return dict(
        plain(
            {
                "name": one.name,
                "number": limit.number,
                "of": measured.of or None,
                "value": measured.value,
                "low_95": measured.low_95,
                "high_95": measured.high_95,
                "unit": measured.unit or None,
                "at_least": limit.at_least,
                "at_most": limit.at_most,
                "guard_band": limit.rule,
                "acceptance_low": one.acceptance_low,
                "acceptance_high": one.acceptance_high,
                "risk": one.risk,
                "highest_risk": limit.highest_risk if limit.rule == "simple" else None,
                "margin": one.margin,
                "verdict": one.verdict,
                "sentence": one.sentence,
            }
        )
    )


def _row(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of the table of records; the run's path stands in the step."""
    return {name: value for name, value in row.items() if name != "run"}


def _run(path: Path, directory: Path, sha256: str, evaluated: Evaluated | None) -> dict[str, Any]:
    try:
        run = evaluated.run if evaluated is not None else open_run(path)
        records, count = records_sha256(run), len(run.records)
    except StationError:  # what is left of it is not a run
        records, count = None, None
    try:
        now = file_sha256(path)
    except OSError:
        now = None
    return {
        "path": relative(path, directory),
        "sha256": now or sha256 or None,
        "records_sha256": records,
        "records": count,
    }


def relative(path: Path, directory: Path) -> str:
    """Return a path as it is seen from the folder of the test, so that the folder can be moved as a whole."""
    try:
        return Path(os.path.relpath(path, directory)).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()
