"""One run in the list of all: what it says of itself, its result, and what is said of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.errors import RunError
from station.results.numbers import with_uncertainty
from station.results.result import UNITS
from station.runs.database import read_facts, reading
from station.runs.facts import COMPLETE, TAKEN, RunFacts
from station.runs.remarks import Remarks, read_remarks

_SHOWN_FIRST = {"witness": "two_pi_voltage_v"}
"""Measurements whose document does not begin with what people ask for."""


@dataclass(frozen=True)
class Value:
    """A number of a result with its standard uncertainty; nan where the run gives none."""

    name: str  # key in the JSON document: with its unit
    value: float
    u: float
    of: str = ""  # what it is of, where there are several: ``"X"``

    @property
    def unit(self) -> str:
        """Unit as a person reads it."""
        before, per, below = self.name.rpartition("_per_")
        last = self.name.rpartition("_")[2]
        if per:
            return f"{before.rpartition('_')[2]}/({UNITS.get(below, below)})"
        return UNITS.get(last, "")

    @property
    def text(self) -> str:
        """Value with its uncertainty and unit."""
        return f"{self.of} {with_uncertainty(self.value, self.u, self.unit)}".strip()


@dataclass(frozen=True)
class Entry:
    """A run as the list of all runs knows it."""

    run: str  # its SQLite file, from the folder that was listed
    command: str = ""
    started_at: str = ""
    ended_at: str | None = None
    unit: str | None = None
    operator: str | None = None
    note: str | None = None
    gyro: str | None = None
    simulated: bool = False
    outcome: str = ""
    records: int = 0  # how many it holds, of every purpose
    values: tuple[Value, ...] = ()  # what the result begins with; empty for a run that was never evaluated
    verdict: str | None = None
    standing: str | None = None  # whether the result holds
    instrument_serial: str | None = None
    software: str | None = None
    mark: str | None = None  # what was said of it afterwards; remarks are plain JSON
    tags: tuple[str, ...] = ()
    remarks: tuple[dict[str, Any], ...] = ()
    problem: str = ""  # why it cannot be read, or what of it is damaged; empty if nothing is wrong

    def as_json(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        values = [
            {"name": one.name, "of": one.of or None, "value": _or_null(one.value), "u": _or_null(one.u)}
            for one in self.values
        ]
        return {**vars(self), "values": values, "tags": list(self.tags), "remarks": list(self.remarks)}

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Entry:
        """Return what :meth:`as_json` made plain."""
        values = tuple(
            Value(one["name"], _or_nan(one["value"]), _or_nan(one["u"]), one["of"] or "")
            for one in saved["values"]
        )
        several = {name: tuple(saved[name]) for name in ("tags", "remarks")}
        return cls(**{**saved, "values": values, **several})

    @property
    def result_text(self) -> str:
        """What the run says, in few words."""
        if self.problem and not self.values:
            return "damaged"
        ended = "not evaluated" if self.outcome in (COMPLETE, TAKEN) else self.outcome
        return ", ".join(one.text for one in self.values) or ended


def read_entry(file: Path, name: str) -> Entry | None:
    """Look at a run without opening a record; ``None`` for a database of somebody else.

    A run that is written at this moment is not disturbed, and what is found is what is on the disk.
    """
    try:
        remarks, problem = read_remarks(file), ""
    except RunError as error:
        remarks, problem = Remarks(), str(error)
    said: dict[str, Any] = {
        "mark": remarks.mark,
        "tags": remarks.tags,
        "remarks": tuple(remark.as_json() for remark in remarks.said),
    }
    try:
        with reading(file, fold=False) as (db, layout):
            known, unusable, _ = read_facts(db)
            (records,) = db.execute(f"SELECT count(*) FROM {layout.table}").fetchone()
            found = db.execute("SELECT value FROM result ORDER BY number DESC LIMIT 1").fetchone()
    except RunError as error:
        if "is a database, but not a saved run" in str(error):
            return None
        return Entry(name, problem=str(error), **said)
    if unusable:
        problem = f"{', '.join(unusable)}: not what was once saved"
    facts, document = RunFacts(known), _document(found)
    identity, made = facts.get("identity") or {}, facts.get("provenance") or {}
    gyro, labels = facts.settings.get("gyro"), facts.labels
    return Entry(
        run=name,
        command=facts.command,
        started_at=facts.started_at,
        ended_at=facts.ended_at,
        unit=labels.get("unit"),
        operator=labels.get("operator"),
        note=labels.get("note"),
        gyro=str(gyro.get("name") or "") or None if isinstance(gyro, dict) else None,
        simulated=facts.simulated,
        outcome=facts.outcome_text,
        records=records,
        values=values_of(document, facts.command),
        verdict=document.get("verdict"),
        standing=document.get("standing"),
        instrument_serial=identity.get("serial"),
        software=made.get("gyrolock"),
        problem=problem,
        **said,
    )


def values_of(document: Mapping[str, Any], command: str) -> tuple[Value, ...]:
    """Return the numbers that a result begins with: the first one that has an uncertainty.

    Where a measurement has several axes, each of them gives one.

    Examples
    --------
    >>> values_of({"records": 3, "lock_in_rate_dps": 0.01, "lock_in_rate_u_dps": 1e-5}, "measure")[0].text
    '0.010000(10) deg/s'
    >>> [one.text for one in values_of({"axes": [{"axis": "X", "tilt_deg": 1.5, "tilt_u_deg": 0.1}]}, "table")]
    ['X 1.50(10) deg']
    """
    first = _SHOWN_FIRST.get(command, "")
    names = [first] if first in document else list(document)
    for name in names:
        if (key := _uncertainty_of(name, document)) is not None:
            return (Value(name, _or_nan(document[name]), _or_nan(document[key])),)
    for several in document.values():
        if not (isinstance(several, list) and several and all(isinstance(one, dict) for one in several)):
            continue
        found = [(one, values_of(one, command)) for one in several]
        if all(values for _, values in found):
            return tuple(
                Value(values[0].name, values[0].value, values[0].u, str(next(iter(one.values()))))
                for one, values in found
            )
    return ()


def _uncertainty_of(name: str, document: Mapping[str, Any]) -> str | None:
    """Key of the standard uncertainty of a number: ``_u`` stands before its unit."""
    if not _is_number(document.get(name)):
        return None
    parts = name.split("_")
    places = (["_".join([*parts[:at], "u", *parts[at:]]) for at in range(len(parts), 0, -1)]) if parts else []
    return next((key for key in places if key in document and _is_number(document[key])), None)


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _document(row: tuple[Any, ...] | None) -> dict[str, Any]:
    with suppress(TypeError, ValueError, RecursionError):
        found = json.loads(row[0]) if row else {}
        return found if isinstance(found, dict) else {}
    return {}


def _or_null(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)
