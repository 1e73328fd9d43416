"""The list of runs as a table for a person, and as CSV."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from station.catalogue.entry import Entry
from station.results.parts import TextTable

SCHEMA = {"name": "gyrolock runs", "version": 1}
_LONGEST_NOTE = 60

COLUMNS = (
    "run", "command", "started_at", "ended_at", "unit", "operator", "gyro", "simulated", "records", "outcome",
    "result_name", "result_of", "result", "result_u", "verdict", "standing", "mark", "tags", "note", "remarks",
    "instrument_serial", "software", "problem",
)  # fmt: skip


def runs_table(entries: Sequence[Entry], directory: Path) -> TextTable:
    """Return the list as a person reads it; a column that nobody fills is left out."""
    rows = [
        (
            entry.started_at[:16].replace("T", " "),
            entry.command,
            entry.unit or "",
            entry.operator or "",
            entry.result_text,
            entry.verdict or "",
            _mark(entry),
            " ".join(entry.tags),
            _shortened(_last_word(entry)),
            _short_name(entry, directory),
        )
        for entry in entries
    ]
    header = ("when (UTC)", "command", "unit", "operator", "result", "verdict", "mark", "tags", "note", "run")
    filled = [place for place, _ in enumerate(header) if place == 0 or any(row[place] for row in rows)]
    return TextTable(
        tuple(header[place] for place in filled), tuple(tuple(row[place] for place in filled) for row in rows)
    )


def runs_csv(entries: Iterable[Entry]) -> str:
    """Return the list as CSV: one line for each value of a result, one for a run without."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    for entry in entries:
        known = {name: "" if value is None else value for name, value in vars(entry).items()}
        known |= {
            "simulated": int(entry.simulated),
            "tags": " ".join(entry.tags),
            "remarks": "; ".join(_signed(one) for one in entry.remarks if one.get("note")),
        }
        values = [
            {
                "result_name": one.name,
                "result_of": one.of,
                "result": "" if math.isnan(one.value) else repr(one.value),
                "result_u": "" if math.isnan(one.u) else repr(one.u),
            }
            for one in entry.values
        ]
        writer.writerows({**known, **value} for value in values or [{}])
    return text.getvalue()


def _mark(entry: Entry) -> str:
    """The mark, who made it and on which day."""
    by = next((one for one in reversed(entry.remarks) if one.get("mark") == entry.mark), None)
    return f"{entry.mark}, {by['by']} {str(by['at'])[:10]}" if entry.mark and by is not None else entry.mark or ""


def _signed(remark: Mapping[str, Any]) -> str:
    return f"{str(remark['at'])[:10]} {remark['by']}: {remark['note']}"


def _last_word(entry: Entry) -> str:
    """What is wrong with it, or the newest note with its day and author, or the operator's own."""
    notes = [_signed(one) for one in entry.remarks if one.get("note")]
    return entry.problem or next(reversed(notes), entry.note or "")


def _shortened(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST_NOTE else f"{line[: _LONGEST_NOTE - 1]}…"


def _short_name(entry: Entry, directory: Path) -> str:
    """Folder of a run below the one that is listed; the file where it is not the only one there."""
    path = Path(os.path.relpath(entry.run, directory))
    return str(path.parent) if path.name in ("run.sqlite", "fog.sqlite") and path.parent.name else str(path)
