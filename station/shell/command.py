"""A command that takes records: a new run, one that is gone on with, a saved one, or files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.acknowledgement import Acknowledgement
from station.shell.ending import finish
from station.shell.options import overrides

if TYPE_CHECKING:
    from station.runs.progress import Progress
    from station.runs.taking import Taken

_PLACES = {"seed": "simulation.seed", "out": "output.directory"}
_LABELS = ("unit", "operator", "note")


def run_measurement(
    name: str,
    given: Mapping[str, Any],
    *,
    places: Mapping[str, str],
    paths: tuple[Path, ...] = (),
    known: Mapping[str, object] | None = None,
    for_files: Mapping[str, str] | None = None,
    choices: Mapping[str, object] | None = None,
) -> int:
    """Carry out a command that takes records, from its options to its exit code."""
    from station.measurements import measurement
    from station.shell.running import saved_run

    report, as_json, lines = given["report"], given["as_json"], given["jsonl"]
    read_as = [option for option in for_files or {} if given.get(option) is not None]
    if not hold_a_run(paths):
        if read_as and not paths:
            raise click.UsageError(f"--{read_as[0].replace('_', '-')} says how files are read: name them too")
        chosen = overrides(given, for_files or {})
        with shown_for(name, given) as progress:
            taken = take_measurement(name, given, progress, places=places, paths=paths, known=known, chosen=chosen)
            code = finish(taken, report=report, as_json=as_json, quiet=lines, events=progress.events)
            progress.end(code)
            return code
    _exclude(given, {**places, **(for_files or {})}, paths)
    if len(paths) > 1:
        raise click.UsageError("give one saved run, or files to make one of")
    if lines:
        raise click.UsageError("--jsonl acknowledges records as they are taken; these are saved already")
    taken = saved_run(paths[0], measurement(name))
    how = {"saved": True, "config": given["config"], "choices": choices}
    return finish(taken, report=report, as_json=as_json, **how)


def hold_a_run(paths: Iterable[Path]) -> bool:
    """Whether one of the paths is a saved run, and they are no files to make one of."""
    from station.runs.database import is_database

    return any(path.exists() and is_database(path) for path in paths)


@contextmanager
def shown_for(name: str, given: Mapping[str, Any]) -> Iterator[Progress]:
    """Show what happens while a measurement is taken, as the options want it."""
    from station.display.opening import shown
    from station.measurements import measurement

    command = measurement(name).command.removeprefix("gyrolock ")
    with shown(given, command, **{label: given[label] for label in _LABELS}) as progress:
        yield progress


def take_measurement(
    name: str,
    given: Mapping[str, Any],
    progress: Progress,
    *,
    places: Mapping[str, str],
    paths: tuple[Path, ...] = (),
    known: Mapping[str, object] | None = None,
    chosen: Mapping[str, Mapping[str, object]] | None = None,
) -> Taken:
    """Take a new run, make one of files or go on with one; arguments as :func:`run_measurement`."""
    if not given["jsonl"]:
        return _taken(name, given, progress, places, paths, known, chosen or {}, None)
    acknowledgement = Acknowledgement()
    try:
        return _taken(name, given, progress, places, paths, known, chosen or {}, acknowledgement)
    finally:
        acknowledgement.rest()


def _taken(
    name: str,
    given: Mapping[str, Any],
    progress: Progress,
    places: Mapping[str, str],
    paths: tuple[Path, ...],
    known: Mapping[str, object] | None,
    further: Mapping[str, Mapping[str, object]],
    told: Acknowledgement | None,
) -> Taken:
    from station.measurements import measurement
    from station.settings.load import load
    from station.shell.running import resume_run, start_run

    kind, config = measurement(name), given["config"]
    labels = {label: given[label] for label in _LABELS if given[label] is not None}
    chosen = {**overrides(given, {**_PLACES, **places}), **further}
    _exclude(given, places, paths)
    if given["resume"] is not None:
        changes = {"config": config, "overrides": chosen, "labels": labels}
        return resume_run(given["resume"], progress, kind=kind, **changes, acknowledge=told)
    settings = load(kind.kind, config, chosen)
    if given["seed"] is not None and not kind.simulated(settings):
        raise click.UsageError("--seed belongs to a simulated bench; a real one has none")
    return start_run(kind, settings, progress, labels=labels, paths=paths, known=known, acknowledge=told)


def _exclude(given: Mapping[str, Any], places: Mapping[str, str], paths: tuple[Path, ...]) -> None:
    """Refuse options that contradict each other."""
    if given["resume"] is not None and paths:
        raise click.UsageError("--resume goes on with a run: give it without a saved run or files")
    live = [name for name in (*places, "seed") if given.get(name) is not None]
    if paths and live:
        raise click.UsageError(f"saved records and --{live[0].replace('_', '-')} exclude each other")
