"""One run of a measurement from beginning to end: new, made of files, or gone on with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from station.errors import RunError, UsageError
from station.events.seen import See
from station.measurements import MEASUREMENTS, Measurement, measurement
from station.runs.database import SUMS
from station.runs.progress import Progress
from station.runs.store import Acknowledge, SavedRun, open_run
from station.runs.taking import Session, Taken, facts_of, take
from station.settings.load import Values, saved_settings, settings_to_resume


def start_run(
    kind: Measurement[Any, Any],
    settings: Any,
    progress: Progress,
    *,
    labels: Mapping[str, str] | None = None,
    paths: Sequence[Path] = (),
    known: Mapping[str, object] | None = None,
    acknowledge: Acknowledge | None = None,
) -> Taken:
    """Take a new run on the bench, or make it of files."""
    simulated = kind.simulated(settings) and not paths
    facts = facts_of(kind.name, settings.model_dump(mode="json"), simulated=simulated, labels=labels)
    facts |= known or {}
    directory, see = Path(settings.output.directory), _see(kind, settings, progress)
    session = Session(facts, directory, progress, acknowledge=acknowledge, see=see)
    if not paths:
        return take(session, lambda of: kind.take(settings, of))
    make = kind.take_files
    if make is None:
        raise UsageError(f"`{kind.command}` makes no run of files: `gyrolock analyze` reads them")
    return take(session, lambda of: make(settings, paths, of))


def resume_run(
    path: Path,
    progress: Progress,
    *,
    kind: Measurement[Any, Any],
    config: Path | None = None,
    overrides: Values | None = None,
    labels: Mapping[str, str] | None = None,
    acknowledge: Acknowledge | None = None,
) -> Taken:
    """Go on with a run that was cut short, with the settings that are saved with it."""
    run = open_run(path)
    check_kind(run, kind)
    if run.facts.sources:
        raise UsageError(f"{path}: was made of saved files, there is nothing to go on with")
    saved = saved_settings(kind.kind, run.facts.settings, str(run.path))
    settings = settings_to_resume(kind.kind, saved, config, overrides, path)
    if lost := [name for name in ("settings", SUMS) if name in run.unusable]:
        raise RunError(f"{path}: cannot be gone on with: its {lost[0]} {run.unusable[lost[0]]}")
    damaged = {record.key: "it is damaged" for record in run.records if not (record.intact or record.aside)}
    again = {**damaged, **kind.unusable(run, settings)}
    if run.facts.complete and not again:
        raise UsageError(
            f"{path}: is finished, there is nothing to go on with; `gyrolock analyze {path}` reads it"
        )

    facts = {**run.facts, **(labels or {}), "settings": settings.model_dump(mode="json")}
    see = _see(kind, settings, progress)
    session = Session(facts, run.path.parent, progress, resumed=run, again=again, acknowledge=acknowledge, see=see)
    return take(session, lambda of: kind.take(settings, of))


def _see(kind: Measurement[Any, Any], settings: Any, progress: Progress) -> See | None:
    """What fits records as they come; nothing where nobody wants to see them."""
    return None if kind.watch is None or not progress.events.wants_values else kind.watch(settings)


def saved_run(path: Path, kind: Measurement[Any, Any]) -> Taken:
    """Return a saved run of one measurement as if it had just been taken; UsageError if it is another's."""
    run = open_run(path)
    check_kind(run, kind)
    return Taken(run.path, None)


def check_kind(run: SavedRun, kind: Measurement[Any, Any]) -> None:
    """See that a run is of one measurement; UsageError names the other."""
    if run.facts.command != kind.name:
        raise UsageError(f"{run.path}: is a run of `{command_of(run)}`, not of `{kind.command}`")


def command_of(run: SavedRun) -> str:
    """Return what a user types for the measurement that a run is of."""
    name = run.facts.command
    return measurement(name).command if name in MEASUREMENTS else name
