"""The list of measurements, and the skeleton that all of them share."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from station.results.quantity import Quantities, limit_names
from station.settings import SettingsSection

if TYPE_CHECKING:
    from station.live.events import Progress
    from station.live.preview import See
    from station.results.result import Check, FactTable, Result, Section
    from station.runs.acquisition import Acquisition
    from station.runs.store import SavedRun
    from station.settings import SettingsKind
    from station.sources.workers import Workers

S = TypeVar("S", bound=SettingsSection)
F = TypeVar("F")


@dataclass(frozen=True, kw_only=True)
class Measurement(Generic[S, F]):
    """What one kind of measurement knows; everything else is the same for all."""

    name: str  # what a run is marked with
    command: str  # what a user types: ``"gyrolock fog table"``
    title: str  # heading of the report
    kind: SettingsKind[S]
    # its own section of settings that several measurements share, by its name; the others stand with the kind
    section: type[SettingsSection] | None = None
    # gets settings and session: opens the bench, begins the run, saves records. For a run that was cut short it
    # takes what is missing.
    take: Callable[[S, Acquisition], None]
    # gets settings, paths and session: makes a run of files instead
    take_files: Callable[[S, Sequence[Path], Acquisition], None] | None = None
    # gets a run, its settings, the user's choices by name, workers and progress: the one step that computes.
    # Raises NoUsableSignal.
    evaluate: Callable[[SavedRun, S, Mapping[str, Any], Workers, Progress], F]
    streams: bool = False  # whether it reads a long run piece by piece, and needs it in memory at no time
    # gets what was found: which records of such a run are damaged, in sentences
    damage: Callable[[F], tuple[str, ...]] = field(default=lambda found: ())
    choices: tuple[str, ...] = ()  # names of the choices that it takes
    # gets what was found, the run and the settings: numbers and sentences
    result: Callable[[F, SavedRun, S], Result]
    # gets what was found, the run, the settings and the result: figures and tables of the report
    sections: Callable[[F, SavedRun, S, Result], list[Section]]
    # gets what was found, the run and the settings: settings and conditions, for the end of the report
    facts: Callable[[F, SavedRun, S], list[FactTable]]
    # gets what was found: one JSON object for each record, or none
    rows: Callable[[F], Iterable[dict[str, Any]]] = field(default=lambda found: ())
    quantities: Quantities = ()  # its numbers
    # gets names and units, [numbers] of settings or of a saved result: its numbers where these declare them
    declared: Callable[[Mapping[str, str]], Quantities] | None = None
    # gets a run and its settings: keys of records that are to be taken again when it is gone on with, and why
    unusable: Callable[[SavedRun, S], Mapping[str, str]] = field(default=lambda run, settings: {})
    # gets settings: whether the bench that they describe is simulated
    simulated: Callable[[S], bool] = field(default=lambda settings: bool(settings.simulated))
    # gets settings: how long a real bench takes, or ``None`` where nobody knows that beforehand
    seconds: Callable[[S], float | None] = field(default=lambda settings: None)
    # gets settings: opens the bench and says what is there and what is not well
    examine: Callable[[S], list[Check]] | None = None
    # gets settings, and returns what says of each record at once what it says, for those who watch
    watch: Callable[[S], See] | None = None

    @property
    def gives(self) -> tuple[str, ...]:
        """Names of the numbers that limits can be set on."""
        return limit_names(self.quantities)

    def quantities_in(self, document: Mapping[str, Any]) -> Quantities:
        """Numbers of a saved result, or of settings as plain JSON."""
        return self.quantities if self.declared is None else self.declared(document.get("numbers") or {})


# tests of a fibre gyro: `gyrolock fog NAME`, a module of station.fibre_gyro, and what its help says first
FIBRE_GYRO_TESTS = {
    "table": "Rate-table run: whole turns, both senses; K of each axis, earth rate, bias, numbers of small rates.",
    "selfcal": "Self-calibration: inject a staircase for each rate, fit the slope, and say what it can show.",
    "eps": "2π error of the modulator's converter, by injection in open loop.",
    "figures": "Nonlinearity, asymmetry, repeatability, temperature coefficient; bias repeatability and warm-up.",
    "allan": "Noise at rest: Allan deviation and noise model.",
    "threshold": "Threshold, resolution and dead zone, by a ladder of small rates in both senses.",
    "temperature": "Scale factor and bias over a temperature ramp, compensation table. PATH may be a log at rest.",
    "sensitivity": "Sensitivity of bias and K to a field, supply, pressure, ..; bias and K from six positions.",
    "response": "Bandwidth, delay and transfer function, by injected steps; or logs of a table that swings.",
    "range": "Input range: largest rate that the output follows in each sense; recovery from an overload.",
    "witness": "Modulator staircase on an oscilloscope: step, step time, fall at a reset, V_2π, 2π error.",
}
# what a run is marked with: the module that holds MEASUREMENT
MEASUREMENTS = {
    "measure": "station.lock_in.measurement",
    "dither": "station.lock_in.dithered",
    "deadband": "station.dead_band.measurement",
    **{name: f"station.fibre_gyro.{name}" for name in FIBRE_GYRO_TESTS},
    "program": "station.program",
}


def measurement(name: str) -> Measurement[Any, Any]:
    """Return a measurement by the name that its runs are marked with; KeyError if there is none."""
    found: Measurement[Any, Any] = importlib.import_module(MEASUREMENTS[name]).MEASUREMENT
    return found


def steps_by_name(
    steps: Iterable[tuple[str, str, Mapping[str, Any]]],
) -> dict[str, tuple[Mapping[str, Any], Quantities]]:
    """Return results and numbers of the steps of a campaign by name; each is given by key, measurement, result."""
    return {
        key.partition(" ")[2]: (document, measurement(name).quantities_in(document))
        for key, name, document in steps
    }


def limits_of(*names: str) -> tuple[str, ...]:
    """Return what [limits] of settings that some measurements share may name."""
    return tuple(dict.fromkeys(limit for name in names for limit in measurement(name).gives))


def sections_of(*names: str) -> dict[str, type[SettingsSection]]:
    """Return the sections that some measurements have for themselves in the settings that they share."""
    sections = ((name, measurement(name).section) for name in names)
    return {name: section for name, section in sections if section is not None}
