"""Taking a run: whatever happens, what was taken is kept, and the run says how it ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from instrument import TDS2014, FoundPanel, InstrumentError
from station.errors import Failure, RunError, StationError, describe_failure
from station.provenance import provenance
from station.runs.database import utc_now
from station.runs.facts import LABELS
from station.runs.progress import Progress
from station.runs.store import RunWriter, SavedRun, open_run

T = TypeVar("T")

_PANEL, _LINK = "front_panel", "link"


@dataclass(frozen=True)
class Taken:
    """How the taking of a run ended.

    Attributes
    ----------
    path : Path
        The run's SQLite file; it holds every record that was acknowledged.
    failure : Failure or None
        What stopped it before its time.
    error : BaseException or None
        The same, as it was raised.
    """

    path: Path
    failure: Failure | None
    error: BaseException | None = None

    @property
    def to_tell(self) -> Failure:
        """The failure, with what to do next; only where there is one."""
        if self.failure is None:
            raise ValueError("nothing has failed")
        told = f"{self.failure.message} (go on with --resume {self.path.parent})"
        return Failure(self.failure.kind, told, self.failure.exit_code)


class Session:
    """One taking of records, of a new run or of one that is gone on with: bench, writer, progress.

    Parameters
    ----------
    facts : mapping
        What is known before the bench is opened, or of the run that is gone on with; plain JSON.
    directory : Path
        Of all runs.
    resumed : SavedRun, optional
        The run that is gone on with.
    again : mapping, optional
        Keys of its records that are to be taken again, and why.
    """

    def __init__(
        self,
        facts: Mapping[str, object],
        directory: Path,
        progress: Progress,
        *,
        resumed: SavedRun | None = None,
        again: Mapping[str, str] | None = None,
    ) -> None:
        self.progress = progress
        self.resumed = resumed
        self.writer: RunWriter | None = None
        self.facts: dict[str, Any] = dict(facts)
        self._directory, self._again = directory, dict(again or {})
        self._bench = ExitStack()
        self._scope: TDS2014 | None = None

    def open(self, instruments: AbstractContextManager[T]) -> T:
        """Open instruments; they are closed when the taking ends, before the run is."""
        return self._bench.enter_context(instruments)

    def close_bench(self) -> None:
        """Close the instruments, in the opposite order."""
        self._bench.close()

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

    def watch(self, scope: TDS2014) -> None:
        """Keep with the run how this oscilloscope's front panel was found, and what its link took."""
        self._scope = scope

    def about_scope(self, *, put_back: bool) -> dict[str, object]:
        """Return the facts of the oscilloscope that is watched, of all sessions of the run."""
        if self._scope is None or self._scope.front_panel_found is None:
            return {}
        before = {} if self.resumed is None else self.resumed.facts.get(_LINK, {})
        faults = {name: count + before.get(name, 0) for name, count in asdict(self._scope.link_faults).items()}
        return {_LINK: faults, _PANEL: {**asdict(self._scope.front_panel_found), "put_back": put_back}}

    def begin(self, facts: Mapping[str, object] | None = None) -> RunWriter:
        """Begin the run, or go on with it, when the bench is open: before that a failure leaves no run.

        Parameters
        ----------
        facts : mapping, optional
            What is known now besides; plain JSON.
        """
        scope = self.about_scope(put_back=False)
        if self.resumed is None:
            self.writer = RunWriter.create(self._directory, {**self.facts, **(facts or {}), **scope})
            return self.writer
        self.writer = RunWriter(self.resumed.path)
        known = {name: self.facts[name] for name in (*LABELS, "settings") if self.facts.get(name)}
        self.writer.save_facts({"resumed_at": [*self.resumed.facts.resumed_at, utc_now()], **known, **scope})
        for key, reason in self._again.items():
            self.progress.note(f"{key} is taken again: {reason}")
            self.writer.set_aside(key)
        return self.writer

    def so_far(self) -> SavedRun:
        """Return the run as it stands."""
        if self.writer is None:
            raise RunError("the run has not begun")
        return open_run(self.writer.path)

    def note_left_out(self, left_out: Mapping[str, str]) -> None:
        """Save what is not taken and why, so that the result names it."""
        if self.writer is not None:
            noted = self.so_far().facts.left_out_of_plan | dict(left_out)
            listed = [{"name": name, "reason": reason} for name, reason in noted.items()]
            self.writer.save_facts({"left_out_of_plan": listed})


def facts_of(
    command: str, settings: Mapping[str, Any], *, simulated: bool, labels: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Return what every run knows of itself from the beginning, as plain JSON.

    Parameters
    ----------
    command : str
        Name of the measurement.
    labels : mapping, optional
        ``unit``, ``operator`` and ``note``, those that were given.
    """
    return {
        "command": command,
        "settings": dict(settings),
        "simulated": simulated,
        "provenance": provenance(),
        **(labels or {}),
    }


def take(session: Session, work: Callable[[Session], None]) -> Taken:
    """Take what is wanted and close the run.

    Parameters
    ----------
    work : callable
        Opens the bench, begins the run and saves records; may be called for a run that was cut short.

    Returns
    -------
    Taken
        Also when it was interrupted or the link was lost: the run then holds the records so far.

    Raises
    ------
    InstrumentError, StationError
        If the bench cannot be opened or the run cannot be written: then there is no run.
    """
    failure: Failure | None = None
    stopped_by: BaseException | None = None
    put_back = False
    try:
        try:
            work(session)
        finally:
            session.close_bench()
            put_back = True
    except (InstrumentError, StationError, OSError, KeyboardInterrupt) as error:
        failure, stopped_by = describe_failure(error), error
        if session.writer is None or failure is None:
            raise
    finally:
        session.progress.close()
    writer = session.writer
    if writer is None:
        raise RunError("nothing was taken")
    ending: dict[str, object] = {
        "ended_at": utc_now(),
        "outcome": "complete" if failure is None else failure.as_json(),
    }
    ending |= session.about_scope(put_back=put_back)
    try:
        writer.save_facts(ending)
    except RunError as error:  # a full disk takes no more; the records that it took are there
        failure, stopped_by = failure or describe_failure(error), stopped_by or error
    finally:
        writer.close()
    return Taken(writer.path, failure, stopped_by)
