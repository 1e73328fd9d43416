"""How things stand: what a program's events, one after the other, add up to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

from station.events.event import Event

SCHEMA = {"name": "gyrolock status", "version": 1}
_NOTES = 4


@dataclass
class Situation:
    """What a person wants to know of a program that is measuring."""

    at: str = ""
    program: dict[str, Any] = field(default_factory=dict)  # the last event of that kind; empty if there was none
    run: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # the last few
    waiting: dict[str, Any] = field(default_factory=dict)
    # ``what``, ``done``, ``total``, ``left_s`` and ``at``, the time of the count
    counted: dict[str, Any] = field(default_factory=dict)
    records: int = 0  # on the disk, of all runs of this program
    value: dict[str, Any] = field(default_factory=dict)  # the last record's values and trace
    # for each group of records what all of them so far say
    groups: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    link: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] = field(default_factory=dict)
    campaign: dict[str, Any] = field(default_factory=dict)
    # of a campaign: ``step``, ``state`` ("to come", "now" or a verdict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    conditions: dict[str, Any] = field(default_factory=dict)
    ended: dict[str, Any] = field(default_factory=dict)

    def take(self, event: Event) -> None:
        """Add an event."""
        self.at = event.at
        change = getattr(self, f"_{event.kind}", None)
        if change is not None:
            change(dict(event.facts), event.at)

    def as_json(self) -> dict[str, Any]:
        """Return everything as plain JSON."""
        return {"schema": SCHEMA, **asdict(self)}

    @classmethod
    def of_json(cls, document: Mapping[str, Any]) -> Self:
        """Return what :meth:`as_json` gave, of this version or a later one; what is missing is empty."""
        known = cls()
        for one in fields(cls):
            if isinstance(document.get(one.name), type(getattr(known, one.name))):
                setattr(known, one.name, document[one.name])
        return known

    def _program(self, facts: dict[str, Any], at: str) -> None:
        self.program = {**facts, "at": at}

    def _run(self, facts: dict[str, Any], at: str) -> None:
        self.run, self.records = {**facts, "at": at}, int(facts.get("records") or 0)
        self.value, self.groups, self.link, self.result, self.counted = {}, {}, {}, {}, {}

    def _note(self, facts: dict[str, Any], at: str) -> None:
        self.notes = [*self.notes, facts["text"]][-_NOTES:]

    def _waiting(self, facts: dict[str, Any], at: str) -> None:
        self.waiting = {**facts, "at": at}

    def _asked(self, facts: dict[str, Any], at: str) -> None:
        self.waiting = {"what": "an answer of the operator", "at": at}

    def _answered(self, facts: dict[str, Any], at: str) -> None:
        self.waiting = {}

    def _counting(self, facts: dict[str, Any], at: str) -> None:
        self.counted, self.waiting = {**facts, "done": 0, "left_s": None, "at": at}, {}

    def _counted(self, facts: dict[str, Any], at: str) -> None:
        self.counted, self.waiting = {**facts, "at": at}, {}

    def _record(self, facts: dict[str, Any], at: str) -> None:
        self.records += 1

    def _value(self, facts: dict[str, Any], at: str) -> None:
        self.value = facts
        if facts.get("running"):
            self.groups[facts["group"]] = facts["running"]

    def _link(self, facts: dict[str, Any], at: str) -> None:
        self.link = facts

    def _result(self, facts: dict[str, Any], at: str) -> None:
        self.result = facts

    def _campaign_begun(self, facts: dict[str, Any], at: str) -> None:
        self.campaign = {**facts, "at": at}
        self.steps = [{"step": name, "state": "to come"} for name in facts.get("steps", ())]

    def _step_begun(self, facts: dict[str, Any], at: str) -> None:
        self.campaign["now"] = facts
        self._mark(facts, "now")

    def _step_ended(self, facts: dict[str, Any], at: str) -> None:
        self._mark(facts, facts.get("verdict") or "done")

    def _mark(self, facts: dict[str, Any], state: str) -> None:
        place = int(facts.get("number") or 0) - 1
        if 0 <= place < len(self.steps):
            self.steps[place]["state"] = state

    def _conditions(self, facts: dict[str, Any], at: str) -> None:
        self.conditions |= facts

    def _campaign_ended(self, facts: dict[str, Any], at: str) -> None:
        self.campaign |= facts

    def _ended(self, facts: dict[str, Any], at: str) -> None:
        self.ended = {**facts, "at": at}
