"""The tests of a folder, and the numbers of each that are followed over time."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.record.document import NAME
from station.record.write import PAGE_FILE, RECORD_FILE

_FOLLOWED = (
    "lock_in_rate_dps",
    "dead_band_dps",
    "scale_factor_counts_per_dps",
    "scale_factor_self_counts_per_dps",
)
"""Numbers that are followed though no limit is set on them; the fibre gyro's for each axis."""


@dataclass(frozen=True)
class Followed:
    """A number of a test."""

    name: str  # of the step and of the number: ``"lock-in rate: lock_in_rate_dps"``
    value: float
    u: float  # standard uncertainty; nan where nobody knows it


@dataclass(frozen=True)
class PastTest:
    """A test of a unit, as its record says."""

    path: Path
    unit: str
    unit_type: str
    is_reference: bool
    at: str  # when it began, UTC
    campaign: str
    verdict: str | None
    message: str
    simulated: bool
    operator: str
    numbers: tuple[Followed, ...]

    @property
    def page(self) -> Path:
        """The record as a page, beside the JSON."""
        return self.path.with_name(PAGE_FILE)


def read_tests(directory: Path) -> tuple[list[PastTest], list[Path]]:
    """Return the tests below a folder in the order of time, and the records that cannot be read."""
    found, unreadable = [], []
    for path in sorted(directory.rglob(RECORD_FILE)):
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            if document["schema"]["name"] == NAME:
                found.append(_test(path, document))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            unreadable.append(path)
    return sorted(found, key=lambda one: one.at), unreadable


def _test(path: Path, record: Mapping[str, Any]) -> PastTest:
    unit, outcome = record["unit"], record["outcome"]
    numbers: dict[str, Followed] = {}
    for step in record["steps"]:
        for one in _numbers(step):
            numbers.setdefault(one.name, one)
    return PastTest(
        path,
        str(unit["serial"]),
        str(unit["type"]),
        bool(unit["is_reference"]),
        str(record["started_at"]),
        str(record["campaign"]["name"]),
        outcome["verdict"],
        outcome["message"] or "",
        bool(record["simulated"]),
        record["operator"] or "",
        tuple(numbers.values()),
    )


def _numbers(step: Mapping[str, Any]) -> Iterator[Followed]:
    """Numbers of a step: its lock-in rate and scale factors, and whatever a limit is set on."""
    name, result = str(step["name"]), step["result"] or {}
    repeat = f", {step['repeat']} of {step['of_repeats']}" if step["of_repeats"] > 1 else ""
    for number in _FOLLOWED:
        yield from _one(f"{name}{repeat}: {number}", result, number)
    for axis in result.get("axes") or ():
        for number in _FOLLOWED:
            yield from _one(f"{name}{repeat}: {number} of {axis.get('axis')}", axis, number)
    for check in (result.get("table_check") or {}).get("scale_factors") or ():
        number = "scale_factor_pulses_per_deg"
        yield from _one(f"{name}{repeat}: {number} by the {check.get('by')}", check, number)
    for limit in step["limits"]:
        if isinstance(limit["value"], int | float):
            ends = limit["low_95"], limit["high_95"]
            u = math.nan if None in ends else (ends[1] - ends[0]) / 3.92
            yield Followed(f"{name}{repeat}: {limit['name']}", float(limit["value"]), u)


def _one(name: str, holder: Mapping[str, Any], number: str) -> Iterator[Followed]:
    value = holder.get(number)
    if isinstance(value, int | float) and math.isfinite(value):
        stem, _, unit = number.rpartition("_")
        for place in ("_dps", "_counts_per_dps", "_pulses_per_deg"):
            if number.endswith(place):
                stem, unit = number.removesuffix(place), place[1:]
        u = holder.get(f"{stem}_u_{unit}")
        yield Followed(name, float(value), float(u) if isinstance(u, int | float) else math.nan)
