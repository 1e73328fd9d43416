"""The list of measurements, and the skeleton that all of them share."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from station.events.seen import See
from station.results.check import Check
from station.results.parts import FactTable, Section
from station.results.result import Result
from station.runs.progress import Progress
from station.runs.store import SavedRun
from station.runs.taking import Session
from station.settings.load import SettingsKind
from station.settings.parts import SettingsSection
from station.sources.source import Source
from station.sources.workers import Workers

S = TypeVar("S", bound=SettingsSection)
F = TypeVar("F")


def _nothing_unusable(run: SavedRun, settings: Any) -> Mapping[str, str]:
    return {}


def _no_rows(found: Any) -> list[dict[str, Any]]:
    return []


@dataclass(frozen=True, kw_only=True)
class Measurement(Generic[S, F]):
    """What one kind of measurement knows; everything else is the same for all.

    Attributes
    ----------
    name : str
        What a run is marked with.
    command : str
        What a user types: ``"gyrolock fog table"``.
    title : str
        Heading of the report.
    take : callable
        Gets settings and session: opens the bench, begins the run, saves records. For a run that was cut short it
        takes what is missing.
    take_files : callable or None
        Gets settings, paths and session: makes a run of files instead.
    evaluate : callable
        Gets a run, its settings and the user's choices by name: the one step that computes. Raises NoUsableSignal.
    evaluate_source : callable or None
        Gets a source, its settings, the choices, workers and progress: the same without holding the samples of a
        long run, and which records are damaged, in sentences. It gives ``None`` where it cannot.
    choices : tuple of str
        Names of the choices that it takes.
    result : callable
        Gets what was found, the run and the settings: numbers and sentences.
    sections : callable
        Gets what was found, the run, the settings and the result: figures and tables of the report.
    facts : callable
        Gets what was found, the run and the settings: settings and conditions, for the end of the report.
    rows : callable
        Gets what was found: one JSON object for each record, or none.
    gives : tuple of str
        Names of the numbers that limits can be set on.
    unusable : callable
        Gets a run and its settings: keys of records that are to be taken again when it is gone on with, and why.
    simulated : callable
        Gets settings: whether the bench that they describe is simulated.
    seconds : callable
        Gets settings: how long a real bench takes, or ``None`` where nobody knows that beforehand.
    examine : callable or None
        Gets settings: opens the bench and says what is there and what is not well.
    watch : callable or None
        Gets settings, and returns what says of each record at once what it says, for those who watch.
    """

    name: str
    command: str
    title: str
    kind: SettingsKind[S]
    take: Callable[[S, Session], None]
    take_files: Callable[[S, Sequence[Path], Session], None] | None = None
    evaluate: Callable[[SavedRun, S, Mapping[str, Any]], F]
    evaluate_source: (
        Callable[[Source, S, Mapping[str, Any], Workers, Progress], tuple[F, tuple[str, ...]] | None] | None
    ) = None
    choices: tuple[str, ...] = ()
    result: Callable[[F, SavedRun, S], Result]
    sections: Callable[[F, SavedRun, S, Result], list[Section]]
    facts: Callable[[F, SavedRun, S], list[FactTable]]
    rows: Callable[[F], Iterable[dict[str, Any]]] = field(default=_no_rows)
    gives: tuple[str, ...] = ()
    unusable: Callable[[SavedRun, S], Mapping[str, str]] = field(default=_nothing_unusable)
    simulated: Callable[[S], bool] = field(default=lambda settings: bool(settings.simulated))
    seconds: Callable[[S], float | None] = field(default=lambda settings: None)
    examine: Callable[[S], list[Check]] | None = None
    watch: Callable[[S], See] | None = None


# what a run is marked with: the module that holds MEASUREMENT
MEASUREMENTS = {
    "measure": "station.lock_in.measurement",
    "deadband": "station.dead_band.measurement",
    "table": "station.fibre_gyro.table.measurement",
    "selfcal": "station.fibre_gyro.selfcal.measurement",
    "eps": "station.fibre_gyro.eps.measurement",
    "figures": "station.fibre_gyro.merit.measurement",
    "allan": "station.fibre_gyro.allan.measurement",
    "witness": "station.fibre_gyro.witness.measurement",
}


def measurement(name: str) -> Measurement[Any, Any]:
    """Return a measurement by the name that its runs are marked with; KeyError if there is none."""
    found: Measurement[Any, Any] = importlib.import_module(MEASUREMENTS[name]).MEASUREMENT
    return found
