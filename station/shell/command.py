"""A command that takes records: a new run, one that is gone on with, a saved one, or files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from station.shell.ending import finish
from station.shell.options import overrides

if TYPE_CHECKING:
    from station.measurements import Measurement

_PLACES = {"seed": "simulation.seed", "out": "output.directory"}
_LABELS = ("unit", "operator", "note")


def run_measurement(
    name: str,
    given: Mapping[str, Any],
    *,
    places: Mapping[str, str] | None = None,
    paths: tuple[Path, ...] = (),
    known: Mapping[str, object] | None = None,
) -> int:
    """Carry out a command that takes records, from its options to its exit code.

    Parameters
    ----------
    name : str
        Of the measurement.
    given : mapping
        Values of :func:`station.shell.options.run_options`, ``report``, and of the options in `places`.
    places : mapping, optional
        Options of this command alone, and where they stand in the settings.
    paths : tuple of Path, optional
        A saved run, or files to make one of.
    known : mapping, optional
        Further facts of a new run, plain JSON.

    Returns
    -------
    int
        Exit code.
    """
    from station.measurements import measurement
    from station.runs.database import is_database
    from station.runs.progress import Progress
    from station.runs.taking import Taken
    from station.shell.running import resume_run, saved_run

    kind, config = measurement(name), given["config"]
    labels = {label: given[label] for label in _LABELS if given[label] is not None}
    chosen = overrides(given, {**_PLACES, **(places or {})})
    _exclude(given, places or {}, paths)
    if given["resume"] is not None:
        progress = Progress()
        taken = resume_run(given["resume"], progress, kind=kind, config=config, overrides=chosen, labels=labels)
        return finish(taken, report=given["report"], as_json=given["as_json"])
    if any(path.exists() and is_database(path) for path in paths):
        if len(paths) > 1:
            raise click.UsageError("give one saved run, or files to make one of")
        taken = Taken(saved_run(paths[0], kind), None)
        return finish(taken, report=given["report"], as_json=given["as_json"], saved=True, config=config)
    taken = _new_run(kind, given, chosen, labels, paths, known)
    return finish(taken, report=given["report"], as_json=given["as_json"])


def _new_run(
    kind: Measurement[Any, Any],
    given: Mapping[str, Any],
    chosen: Mapping[str, Mapping[str, object]],
    labels: Mapping[str, str],
    paths: tuple[Path, ...],
    known: Mapping[str, object] | None,
) -> Any:
    from station.runs.progress import Progress
    from station.settings.load import load
    from station.shell.running import start_run

    settings = load(kind.kind, given["config"], chosen)
    if given["seed"] is not None and not kind.simulated(settings):
        raise click.UsageError("--seed belongs to a simulated bench; a real one has none")
    return start_run(kind, settings, Progress(), labels=labels, paths=paths, known=known)


def _exclude(given: Mapping[str, Any], places: Mapping[str, str], paths: tuple[Path, ...]) -> None:
    """Refuse options that contradict each other."""
    if given["resume"] is not None and paths:
        raise click.UsageError("--resume goes on with a run: give it without a saved run or files")
    live = [name for name in (*places, "seed") if given.get(name) is not None]
    if paths and live:
        raise click.UsageError(f"saved records and --{live[0].replace('_', '-')} exclude each other")
