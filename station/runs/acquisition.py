"""Taking a run: whatever happens, what was taken is kept, and the run says how it ended."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from instrument import FoundPanel, Identity, InstrumentError
from station.errors import Failure, RunError, StationError, describe_failure
from station.files import provenance
from station.live.events import Progress
from station.live.preview import See, Watcher
from station.runs.database import LABELS, TAKEN, utc_now
from station.runs.signals import disturbed, undisturbed
from station.runs.store import Acknowledge, NewRecord, RunWriter, SavedRun, open_run

if TYPE_CHECKING:
    from instrument import TDS2014

T = TypeVar("T")

_PANEL, _LINK = "front_panel", "link"


@dataclass(frozen=True)
class Taken:
    """How the taking of a run ended."""

    path: Path  # the run's SQLite file; it holds every record that was acknowledged
    failure: Failure | None  # what stopped it before its time
    error: BaseException | None = None  # the same, as it was raised

    def run(self, outcome: str | Mapping[str, Any] | None = None) -> SavedRun:
        """Return the run, with another outcome if one is given."""
        run = open_run(self.path)
        return run if outcome is None else replace(run, facts=run.facts.with_outcome(outcome))

    @property
    def to_tell(self) -> Failure:
        """The failure, with what to do next; only where there is one."""
        if self.failure is None:
            raise ValueError("nothing has failed")
        further = f"go on with --resume {self.path.parent}" if open_run(self.path).records else "no record is kept"
        told = f"{self.failure.message} ({further})"
        return Failure(self.failure.kind, told, self.failure.exit_code)


class Acquisition:
    """One taking of records, of a new run or of one that is gone on with: bench, writer, progress."""

    def __init__(
        self,
        facts: Mapping[str, object],
        directory: Path,
        progress: Progress,
        *,
        resumed: SavedRun | None = None,
        again: Mapping[str, str] | None = None,
        acknowledge: Acknowledge | None = None,
        see: See | None = None,
    ) -> None:
        self.progress, self.events = progress, progress.events
        self._acknowledge = acknowledge
        self._see = see
        self._watcher: Watcher | None = None
        self._link_told: dict[str, object] = {}
        self.resumed = resumed
        self.writer: RunWriter | None = None
        self.facts: dict[str, Any] = dict(facts)
        self._directory, self._again = directory, dict(again or {})
        self.bench = ExitStack()
        """What is open; whatever ends the taking is told to it."""
        self._scope: TDS2014 | None = None

    def open(self, instruments: AbstractContextManager[T]) -> T:
        """Open instruments; they are closed when the taking ends, before the run is."""
        return self.bench.enter_context(instruments)

    @property
    def times_resumed(self) -> int:
        """How often the run was gone on with, this time included."""
        return 0 if self.resumed is None else len(self.resumed.facts.resumed_at) + 1

    @property
    def panel_to_put_back(self) -> FoundPanel | None:
        """The oscilloscope's front panel as it was before the run, where an earlier session left it changed."""
        found = {} if self.resumed is None else self.resumed.facts.get(_PANEL, {})
        if not found or found["put_back"]:
            return None
        return FoundPanel(found["setup"], {name: tuple(values) for name, values in found["groups"].items()})

    @property
    def scope_so_far(self) -> Identity | None:
        """The oscilloscope that the run was begun with, where it says so."""
        known = {} if self.resumed is None else self.resumed.facts.get("identity") or {}
        names = [part.name for part in fields(Identity)]
        if not all(isinstance(known.get(name), str) for name in names):
            return None
        return Identity(**{name: str(known[name]) for name in names})

    def watch(self, scope: TDS2014) -> None:
        """Keep with the run how this oscilloscope's front panel was found, and what its link took."""
        self._scope = scope

    def about_scope(self) -> dict[str, object]:
        """Return the facts of the oscilloscope that is watched, of all sessions of the run."""
        if self._scope is None or self._scope.front_panel_found is None:
            return {}
        before = {} if self.resumed is None else self.resumed.facts.get(_LINK, {})
        faults = {name: count + before.get(name, 0) for name, count in asdict(self._scope.link_faults).items()}
        found = asdict(self._scope.front_panel_found)
        return {_LINK: faults, _PANEL: {**found, "put_back": self._scope.front_panel_is_back}}

    def begin(self, facts: Mapping[str, object] | None = None) -> RunWriter:
        """Begin the run, or go on with it, when the bench is open: before that a failure leaves no run."""
        scope = self.about_scope()
        if self.resumed is None:
            with undisturbed():
                self.writer = RunWriter.create(self._directory, {**self.facts, **(facts or {}), **scope})
            self._tell_begun(facts or {})
            return self.writer
        self.writer = RunWriter(self.resumed.path)
        self._tell_begun(facts or {})
        known = {name: self.facts[name] for name in (*LABELS, "settings") if self.facts.get(name)}
        again = {"resumed_at": [*self.resumed.facts.resumed_at, utc_now()], "outcome": None, "ended_at": None}
        self.writer.save_facts({**again, **known, **scope})
        for key, reason in self._again.items():
            self.progress.note(f"{key} is taken again: {reason}")
            self.writer.set_aside(key)
        return self.writer

    def _tell_begun(self, facts: Mapping[str, object]) -> None:
        self.progress.of_all(0, 0)  # what the run before has counted is over
        """Tell those who watch that the run begins, and let them hear of every record."""
        if self.writer is None:
            return
        identity = facts.get("identity") or self.facts.get("identity")
        instrument = identity.get("model") if isinstance(identity, Mapping) else None
        settings = self.facts.get("settings", {})
        self.events.emit(
            "run",
            run=str(self.writer.path),
            measurement=self.facts.get("command"),
            gyro=settings.get("gyro", {}).get("name"),
            instrument=instrument,
            resource=settings.get("scope", {}).get("resource") or settings.get("link", {}).get("port"),
            simulated=self.facts.get("simulated"),
            resumed=self.resumed is not None,
            records=0 if self.resumed is None else len(self.resumed.records),
        )
        if self._see is not None and self.events.wants_values:
            self._watcher = Watcher(self.events, self._see)
        self.writer.acknowledge = self._acknowledged

    def _acknowledged(self, run: Path, records: Sequence[tuple[int, NewRecord]]) -> None:
        """Records are on the disk: tell whoever waits for that, then those who watch."""
        if self._acknowledge is not None:
            self._acknowledge(run, records)
        for number, one in records:
            about = {"key": one.key, "purpose": one.purpose, "conditions": one.conditions}
            self.events.emit("record", run=str(run), number=number, **about)
        if self._watcher is not None:
            self._watcher([record for _, record in records])
        self._tell_link()

    def link_says(self, text: str) -> None:
        """Tell what the link says of itself, and whether it is down."""
        self.progress.note(text)
        self._tell_link()

    def _tell_link(self) -> None:
        if self._scope is None:
            return
        now = {**asdict(self._scope.link_faults), "down": self._scope.link_is_down}
        if now != self._link_told:
            self._link_told = now
            self.events.emit("link", **now, text=str(self._scope.link_faults))

    def end(self, outcome: str) -> None:
        """Tell those who watch that the taking has ended."""
        if self._watcher is not None:
            self._watcher.close()
        if self.writer is not None:
            self._tell_link()
            self.events.emit("run_ended", run=str(self.writer.path), outcome=outcome)

    def so_far(self) -> SavedRun:
        """Return the run as it stands."""
        if self.writer is None:
            raise RunError("the run has not begun")
        return open_run(self.writer.path)

    def free_numbers(self, before: str, count: int) -> list[int]:
        """Return the first numbers, from 1, that no record has behind such a beginning of its key."""
        keys = {record.key for record in self.so_far().records}
        free = (number for number in itertools.count(1) if f"{before}{number}" not in keys)
        return list(itertools.islice(free, max(count, 0)))

    def note_left_out(self, left_out: Mapping[str, str]) -> None:
        """Save what is not taken and why, so that the result names it."""
        if self.writer is not None:
            noted = self.so_far().facts.left_out_of_plan | dict(left_out)
            listed = [{"name": name, "reason": reason} for name, reason in noted.items()]
            self.writer.save_facts({"left_out_of_plan": listed})


def facts_of(
    command: str, settings: Mapping[str, Any], *, simulated: bool, labels: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Return what every run knows of itself from the beginning, as plain JSON."""
    return {
        "command": command,
        "settings": dict(settings),
        "simulated": simulated,
        "provenance": provenance(),
        **(labels or {}),
    }


def take(session: Acquisition, work: Callable[[Acquisition], None]) -> Taken:
    """Take what is wanted and close the run."""
    with undisturbed():  # a signal ends the work, and nothing of what closes it
        return _take(session, work)


def _take(session: Acquisition, work: Callable[[Acquisition], None]) -> Taken:
    failure: Failure | None = None
    stopped_by: BaseException | None = None
    try:
        with session.bench, disturbed():
            work(session)
    except (InstrumentError, StationError, OSError, KeyboardInterrupt) as error:
        failure, stopped_by = describe_failure(error), error
        if session.writer is None or failure is None:
            raise
    writer = session.writer
    if writer is None:
        raise RunError("nothing was taken")
    session.end(TAKEN if failure is None else failure.message)
    ending: dict[str, object] = {"ended_at": utc_now(), "outcome": TAKEN if failure is None else failure.as_json()}
    ending |= session.about_scope()
    try:
        writer.save_facts(ending)
    except RunError as error:  # a full disk takes no more; the records that it took are there
        failure, stopped_by = failure or describe_failure(error), stopped_by or error
    finally:
        writer.close()
    return Taken(writer.path, failure, stopped_by)
