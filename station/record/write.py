"""Writing the record of a test: JSON, JUnit XML, CSV and a page, beside the runs that it was made of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.campaign.outcome import CampaignOutcome
from station.errors import CannotWrite, StationError, one_line
from station.record.document import record_document
from station.record.junit import junit_xml
from station.record.page import render_record
from station.record.tables import limits_csv, records_csv
from station.report.page import write_page
from station.results.verdict import ABORTED
from station.runs.store import open_run
from station.shell.evaluated import Evaluated, evaluate_run

RECORD_FILE = "record.json"
JUNIT_FILE, LIMITS_FILE, RECORDS_FILE, PAGE_FILE = "junit.xml", "limits.csv", "records.csv", "record.html"


@dataclass(frozen=True)
class RecordFiles:
    """A record, and the files that it was written to."""

    document: Mapping[str, Any]
    json: Path
    junit: Path
    limits: Path
    records: Path
    page: Path


def write_record(outcome: CampaignOutcome, *, evaluated: Mapping[str, Evaluated] | None = None) -> RecordFiles:
    """Write the record of a test into its folder; each file appears whole or not at all."""
    known = dict(evaluated or {})
    if outcome.verdict != ABORTED:
        for step in outcome.steps:
            if step.step.key not in known and step.run is not None and step.document:
                again = _evaluated(step.run)
                if again is not None:
                    known[step.step.key] = again
    document = record_document(outcome, known)
    folder = outcome.directory
    texts = {
        RECORD_FILE: json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n",
        JUNIT_FILE: junit_xml(document),
        LIMITS_FILE: limits_csv(document),
        RECORDS_FILE: records_csv(document),
        PAGE_FILE: render_record(document, outcome, known),
    }
    try:
        paths = [write_page(folder / name, text) for name, text in texts.items()]
    except OSError as error:
        raise CannotWrite(f"{folder}: the record of the test cannot be written ({one_line(error)})") from None
    return RecordFiles(document, *paths)


def _evaluated(path: Path) -> Evaluated | None:
    """A run evaluated again; ``None`` where it cannot be: what the step says of it stands in the record."""
    try:
        return evaluate_run(open_run(path))
    except StationError:
        return None
