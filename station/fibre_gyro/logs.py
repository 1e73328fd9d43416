"""A test of a fibre gyro on the bench or from logs: lists of logs, segments, and what one says at once.

A test says which segments it plans, and what the rows of a list of logs are; the rest is the same for all.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from instrument import FileFormatError, InstrumentError
from instrument.fibre_gyro import GyroLog, LogChoices, Recording, read_log
from instrument.text_files import open_plain_file, read_small_file
from station.errors import StationError, UsageError, one_line
from station.fibre_gyro.bench import open_fog_bench
from station.fibre_gyro.common import output_facts, truth_of, with_link_remarks
from station.fibre_gyro.segments import (
    PlannedSegment,
    recording_of,
    seconds_of,
    take_logs,
    take_segments,
    unusable_segments,
)
from station.fibre_gyro.settings import FIBRE_GYRO, FogSettings
from station.live.preview import Preview, PreviewTrace, PreviewValue
from station.measurements import Measurement
from station.results.quantity import Quantities
from station.results.result import Check, Result, Section, with_uncertainty
from station.runs.acquisition import Acquisition
from station.runs.store import NewRecord, SavedRun
from station.settings import SettingsSection

F = TypeVar("F")
NamedSegment = tuple[str, dict[str, Any]]  # name and conditions
Take = Callable[[FogSettings, Acquisition], None]
TakeFiles = Callable[[FogSettings, Sequence[Path], Acquisition], None]

_LOOK_S = 2.0


def planned_segments(
    plan: Callable[[FogSettings], Sequence[PlannedSegment]],
    left_out: Callable[[FogSettings], Mapping[str, str]] = lambda settings: {},
) -> Take:
    """Return what takes on the bench the segments that are planned."""

    def take(settings: FogSettings, session: Acquisition) -> None:
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

    def take(settings: FogSettings, paths: Sequence[Path], session: Acquisition) -> None:
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
    quantities: Quantities,
    plan: Callable[[FogSettings], Sequence[PlannedSegment]] | None = None,
    purposes: Sequence[str] = (),
    unusable: Callable[[SavedRun, FogSettings], Mapping[str, str]] | None = None,
    choices: tuple[str, ...] = (),
    section: type[SettingsSection] | None = None,
) -> Measurement[FogSettings, F]:
    """Return the measurement ``gyrolock fog NAME``; see :class:`station.measurements.Measurement`."""
    return Measurement(
        name=name,
        command=f"gyrolock fog {name}",
        title=title,
        kind=FIBRE_GYRO,
        section=section,
        take=take,
        take_files=take_files,
        evaluate=lambda run, settings, choices, workers, progress: evaluate(run, settings, choices),
        result=with_link_remarks(result),
        sections=sections,
        facts=output_facts,
        quantities=quantities,
        watch=lambda settings: _seen,
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


# --------------------
# Saved logs as a run: a list in CSV says which file was taken under which conditions.
#
# The list has one line for each stretch of output and a header with the names of its columns:
#
#     file               CSV of the gyro's output (time, counts, temperature), beside the list
#     start_s, stop_s    optional: the part of the file, by its own times; for a table rate it must be whole turns
#     axis, rate_dps     table and figures: which axis, at which signed rate of the table; 0 at rest; in a file
# with
#                        the outputs of three axes it also says which of them is meant
#     table_rate_dps     optional: the rate that the table really had
#     base_dps           optional, threshold: the rate about which a change was made, for the resolution
#     overload_dps       range: largest rate of a log in which the table turns too fast and stops; with table_deg
#     end_up             optional: -1 where the axis pointed down
#     stands_for_dps     selfcal: the rate that the injected step stands for, 0 at rest
#     number             selfcal: the injected step in counts, 0 at rest
#     number_u           optional, selfcal: its standard uncertainty, how well it stands for the rate
#     step_codes         eps: the injected step in codes
#     run, temperature_c optional, figures: name of the run and its temperature
#     stimulus           sensitivity: value of the stimulus; or
#     position           which of +x, -x, +y, -y, +z, -z of a fixture the input axis had
#     since_on_s         optional, figures: 0 for the output from switching on, for the transient


_LARGEST_LIST = 8_000_000  # bytes
_NUMBERS = (
    "start_s",
    "stop_s",
    "rate_dps",
    "table_rate_dps",
    "base_dps",
    "overload_dps",
    "since_on_s",
    "stands_for_dps",
    "number",
    "number_u",
    "step_codes",
    "temperature_c",
    "stimulus",
)
_COLUMNS = ("file", "axis", "end_up", "run", "position", *_NUMBERS)

LogRow = dict[str, Any]
Named = Callable[[Sequence[LogRow]], Sequence[tuple[str, dict[str, Any]]]]
"""Gives each row of a list the name and the conditions of its segment."""


def read_logs(
    lists: Sequence[Path], purpose: str, needed: Sequence[str], named: Named, settings: FogSettings
) -> list[tuple[str, dict[str, Any], Recording]]:
    """Read every log that the lists name: key, conditions and recording of its segment."""
    rows = [row for path in lists for row in read_list(path, purpose, needed)]
    logs = []
    taken: set[str] = set()
    read: tuple[Path, GyroLog] | None = None
    for row, (name, conditions) in zip(rows, named(rows), strict=True):
        if read is None or read[0] != row["path"]:
            read = row["path"], read_log(row["path"], choices_of(settings))
        key, count = f"{name} ({row['file']})", 1
        while key in taken:
            count += 1
            key = f"{name} ({row['file']}, {count})"
        taken.add(key)
        logs.append(
            (
                key,
                {
                    "purpose": purpose,
                    "source": str(row["path"]),
                    **_unit(read[1]),
                    # of a log whose times begin at 0, like those of all, nothing is said
                    **({"begin_s": begin} if (begin := float(row.get("start_s", read[1].begin_s))) else {}),
                    **conditions,
                },
                _recording(read[1], row, settings.nominal_scale_factor),
            )
        )
    return logs


def is_list(path: Path) -> bool:
    """Whether a file is a list of logs, not a log itself: its header has a column ``file``."""
    with open_plain_file(path) as file, io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace") as text:
        for line in text:
            if line.strip() and not line.lstrip().startswith("#"):
                return "file" in [cell.strip() for cell in line.replace(";", ",").split(",")]
    return False


def read_whole_logs(
    paths: Sequence[Path], purpose: str, settings: FogSettings
) -> list[tuple[str, dict[str, Any], Recording]]:
    """Read logs that no list names, at rest: one segment for each axis that they hold; errors as for lists."""
    found = []
    for path in paths:
        log = read_log(path, choices_of(settings))
        axes = [name.removeprefix("counts_").upper() for name in log.outputs] if len(log.outputs) > 1 else [""]
        for axis in axes:
            conditions = {
                "purpose": purpose,
                "source": str(path),
                "rate_dps": 0.0,
                **_unit(log),
                **({"axis": axis} if axis else {}),
            }
            recording = log.recording(axis, counts_per_dps=settings.nominal_scale_factor)
            found.append((f"{axis} {path.name}".strip(), conditions, recording))
    return found


def choices_of(settings: FogSettings) -> LogChoices:
    """Return what the settings say of logs."""
    given = settings.logs
    return LogChoices(
        columns=given.columns or None,
        time_unit=given.time_unit,
        units=given.units,
        interval_s=1 / given.output_rate_hz if given.output_rate_hz else None,
        skip_bad_rows=given.skip_bad_rows,
    )


def read_list(path: Path, purpose: str, needed: Sequence[str]) -> list[LogRow]:
    """Read one list; errors as :func:`read_logs`."""
    try:
        text = read_small_file(path, _LARGEST_LIST).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UsageError(f"{path}: is neither a saved run nor a list of logs (not a text file)") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise UsageError(f"{path}: is empty; a list of logs has a header and one line for each log")
    reader = csv.DictReader(lines, delimiter=";" if ";" in lines[0] else ",", skipinitialspace=True)
    header = [name.strip() for name in reader.fieldnames or []]
    reader.fieldnames = header
    for name in ("file", *needed):
        if name not in header:
            raise UsageError(f"{path}: its header has no column {name}, which {purpose} needs")
    if unknown := [name for name in header if name not in _COLUMNS]:
        raise UsageError(f"{path}: no such column: {', '.join(unknown)}; known are {', '.join(_COLUMNS)}")
    rows = [_row(path, number, entry, needed) for number, entry in enumerate(reader, start=1)]
    if not rows:
        raise UsageError(f"{path}: has a header but names no log")
    return rows


def _row(path: Path, number: int, entry: dict[str, str | None], needed: Sequence[str]) -> LogRow:
    place = f"{path}, log {number}"
    row: LogRow = {"place": place}
    for name, value in entry.items():
        text = (value or "").strip() if isinstance(value, str | None) else ""
        if name is None or name == "" or not text:
            continue
        row[name] = _number(text, f"{place}, {name}") if name in _NUMBERS else text
    if missing := [name for name in ("file", *needed) if name not in row]:
        raise UsageError(f"{place}: {', '.join(missing)} is missing")
    if row.setdefault("end_up", "1") not in ("1", "+1", "-1"):
        raise UsageError(f"{place}, end_up: 1 or -1, not {row['end_up']}")
    row["end_up"] = int(row["end_up"])
    if row.get("stop_s", math.inf) <= row.get("start_s", -math.inf):
        raise UsageError(f"{place}, stop_s: {row['stop_s']:g} s must be later than start_s, {row['start_s']:g} s")
    row["path"] = path.parent / row["file"]
    return row


def _number(text: str, place: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{place}: {text!r} is not a number")
    return value


def _unit(log: GyroLog) -> dict[str, Any]:
    """Unit of an output that is turned into counts by the scale factor by design; rows that one output is of."""
    averaged = {"rows_averaged": log.each} if log.each > 1 else {}
    return averaged if log.unit == "counts" else {"output_unit": log.unit, **averaged}


def _recording(log: GyroLog, row: LogRow, counts_per_dps: float) -> Recording:
    try:
        whole = log.recording(row.get("axis", ""), counts_per_dps=counts_per_dps)
    except FileFormatError as error:
        raise UsageError(f"{row['place']}, axis: {row['path']} {error}") from None
    return _part(whole, log.begin_s, row.get("start_s"), row.get("stop_s"), row["place"])


def _part(
    recording: Recording, begin_s: float, start_s: float | None, stop_s: float | None, place: str
) -> Recording:
    """Cut out a part, by the times of the log's own column, with the gaps that lie in it."""
    if start_s is None and stop_s is None:
        return recording
    first = -math.inf if start_s is None else start_s - begin_s
    last = math.inf if stop_s is None else stop_s - begin_s
    half = recording.interval_s / 2
    kept = np.flatnonzero((recording.times >= first - half) & (recording.times < last - half))
    if kept.size < 2:
        end_s = begin_s + recording.duration_s
        raise UsageError(
            f"{place}: from {first + begin_s:g} s to {last + begin_s:g} s the log holds no output; its times go "
            f"from {begin_s:.9g} s to {end_s:.9g} s"
        )
    return recording.part(int(kept[0]), int(kept[-1]) + 1)


def table_conditions(row: LogRow) -> dict[str, Any]:
    """What a log at a rate of the table may say of its own: the true rate, and the window that was cut out."""
    found = {"table_rate_dps": row["table_rate_dps"]} if "table_rate_dps" in row else {}
    if "start_s" in row and "stop_s" in row and row["rate_dps"]:
        found["window_s"] = row["stop_s"] - row["start_s"]
    return found


# --------------------
# What one stretch of output says as soon as it is there, its mean and its course: for those who watch


_POINTS = 240


def _seen(records: Sequence[NewRecord]) -> Preview | None:
    record = records[0]
    recording = recording_of(record)
    counts = recording.counts
    if counts.size == 0:
        return Preview(record.key, record.purpose, (), flags=("empty",))
    mean, u = float(counts.mean()), float(counts.std() / math.sqrt(counts.size)) if counts.size > 1 else math.nan
    values = (PreviewValue("output_counts", mean, u, with_uncertainty(mean, u, "counts"), counts.size),)
    # neighbours are taken together: of a long stretch the mean of each part is shown
    parts = np.array_split(counts, min(_POINTS, counts.size))
    samples = [float(f"{part.mean():.6g}") for part in parts]
    flags = () if recording.complete else ("gaps",)
    trace = PreviewTrace(recording.duration_s, "counts", samples)
    return Preview(record.key, record.key, values, values, flags=flags, trace=trace)
