"""What the tests of a fibre gyro have in common: segments are taken on the bench, or logs stand for them.

A test says which segments it plans, and what the rows of a list of logs are; the rest is the same for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from instrument import InstrumentError
from station.errors import StationError, one_line
from station.fibre_gyro.at_once import watch
from station.fibre_gyro.common import output_facts, truth_of, with_link_remarks
from station.fibre_gyro.logs import LogRow, is_list, read_logs, read_whole_logs
from station.fibre_gyro.segments import PlannedSegment, seconds_of, take_logs, take_segments, unusable_segments
from station.fibre_gyro.serial_bench import open_fog_bench
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.measurements import Measurement
from station.results.check import Check
from station.results.parts import Section
from station.results.result import Result
from station.runs.store import SavedRun
from station.runs.taking import Session

F = TypeVar("F")
NamedSegment = tuple[str, dict[str, Any]]
"""Name and conditions."""
Take = Callable[[FogSettings, Session], None]
TakeFiles = Callable[[FogSettings, Sequence[Path], Session], None]

_LOOK_S = 2.0


def planned_segments(
    plan: Callable[[FogSettings], Sequence[PlannedSegment]],
    left_out: Callable[[FogSettings], Mapping[str, str]] = lambda settings: {},
) -> Take:
    """Return what takes on the bench the segments that are planned."""

    def take(settings: FogSettings, session: Session) -> None:
        bench, facts = open_fog_bench(settings), truth_of(settings)
        take_segments(settings, session, bench, [lambda run: plan(settings)], facts, left_out(settings))

    return take


def listed_logs(
    purpose: str,
    columns: Sequence[str],
    named: Callable[[Sequence[LogRow], FogSettings], Sequence[NamedSegment]],
    *,
    whole: bool = False,
) -> TakeFiles:
    """Return what makes a run of the logs that lists name."""

    def take(settings: FogSettings, paths: Sequence[Path], session: Session) -> None:
        lists = [path for path in paths if not whole or is_list(path)]
        logs = read_whole_logs([path for path in paths if path not in lists], purpose, settings)
        if lists:
            logs += read_logs(lists, purpose, columns, lambda rows: named(rows, settings), settings)
        take_logs(session, paths, logs)

    return take


def gyro_measurement(
    name: str,
    title: str,
    *,
    take: Take,
    take_files: TakeFiles,
    evaluate: Callable[[SavedRun, FogSettings, Mapping[str, Any]], F],
    result: Callable[[F, SavedRun, FogSettings], Result],
    sections: Callable[[F, SavedRun, FogSettings, Result], list[Section]],
    gives: tuple[str, ...],
    plan: Callable[[FogSettings], Sequence[PlannedSegment]] | None = None,
    purposes: Sequence[str] = (),
    unusable: Callable[[SavedRun, FogSettings], Mapping[str, str]] | None = None,
    choices: tuple[str, ...] = (),
) -> Measurement[FogSettings, F]:
    """Return the measurement ``gyrolock fog NAME``; see :class:`station.measurements.Measurement`."""
    return Measurement(
        name=name,
        command=f"gyrolock fog {name}",
        title=title,
        kind=FIBRE_GYRO,
        take=take,
        take_files=take_files,
        evaluate=evaluate,
        result=with_link_remarks(result),
        sections=sections,
        facts=output_facts,
        gives=gives,
        watch=watch,
        examine=examine,
        unusable=unusable or (lambda run, settings: unusable_segments(run, settings, purposes or (name,))),
        choices=choices,
        seconds=lambda settings: None if plan is None else seconds_of(plan(settings)),
    )


def examine(settings: FogSettings) -> list[Check]:
    """Look at the bench before a campaign: does it send frames at rest, and without losses."""
    told: list[str] = []
    try:
        with open_fog_bench(settings, tell=told.append) as bench:
            planned = PlannedSegment("look", _LOOK_S, 0.0, {"purpose": "look", "rate_dps": 0.0})
            recording = bench.record(planned, lambda seconds: None)
    except (InstrumentError, StationError, OSError) as error:
        return [Check("fibre gyro", "bad", one_line(error))]
    at = settings.link.port or "the simulated bench"
    losses, clock = recording.losses, recording.host_clock
    text = f"{losses.good} frames in {_LOOK_S:g} s at {at}, {losses.missing} missing"
    state: list[Check] = [Check("fibre gyro", "note" if losses.missing else "ok", text)]
    if clock is not None and clock.used:
        said = f"{clock} against the computer's: it is measured and allowed for"
        state.append(Check("gyro's clock", "note", said))
    state += [Check("frame format", "bad", doubt) for doubt in recording.doubts]
    return [*state, *(Check("bench", "note", one) for one in told)]
