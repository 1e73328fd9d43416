"""A saved run as a source: read record by record, so that its length costs no memory."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from station.runs.database import read_facts, reading
from station.runs.facts import RunFacts
from station.runs.store import SavedRecord, read_record, run_file
from station.sources.source import Source

MEASUREMENT = ("command", "settings", "truth", "injected", "rates", "rates_without_beat", "logs")
"""Facts that a result may rest on; the others say how the run went."""


class RunSource(Source):
    """One run.

    Parameters
    ----------
    path : Path
        Its SQLite file or its directory.

    Raises
    ------
    RunError
        If there is no run at `path`, or it cannot be read.
    """

    kind = "run"

    def __init__(self, path: Path) -> None:
        self.path = run_file(path)
        self.name = str(self.path)
        with reading(self.path) as (db, layout):
            facts, self.unusable, self.protected = read_facts(db)
            self.numbers = db.execute(f"SELECT min(number), max(number), count(*) FROM {layout.table}").fetchone()
        self.facts = RunFacts(facts)

    def __len__(self) -> int:
        return int(self.numbers[2])

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Read the records one at a time; see `Source`."""
        with reading(self.path) as (db, layout):
            if numbers is None:
                rows = db.execute(layout.select)
            else:
                rows = db.execute(layout.select_between, (numbers.start, numbers.stop - 1))
            for row in rows:
                yield read_record(row, layout)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the measurement; see `Source`."""
        digest = hashlib.sha256()
        for name in MEASUREMENT:
            if name in self.facts:
                text = json.dumps(self.facts[name], sort_keys=True, allow_nan=False)
                digest.update(f"{name} {text}\n".encode())
        with reading(self.path) as (db, layout):
            for number, sum_ in db.execute(f"SELECT number, sha256 FROM {layout.table} ORDER BY number"):
                digest.update(f"{number} {sum_}\n".encode())
        return digest.hexdigest()
