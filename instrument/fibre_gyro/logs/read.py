"""A log file: its columns as recordings, of one gyro or of three axes, whole or in parts."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np

from instrument.errors import FileFormatError
from instrument.fibre_gyro.frame_format import COUNTER, COUNTS, STATUS, TEMPERATURE, is_output
from instrument.fibre_gyro.logs.clock import LogClock, Places, clock_of_counter, find_clock, line_through
from instrument.fibre_gyro.logs.columns import (
    OUTPUT_UNITS,
    TIME,
    axis_column,
    default_names,
    named_columns,
    output_unit,
    seconds_of,
)
from instrument.fibre_gyro.logs.text import Dialect, Table, read_table
from instrument.fibre_gyro.recording import Floats, Gap, Losses, Recording
from instrument.small_files import open_plain_file

_DOUBLED = 0.02  # of the rows: more equal time stamps than these are coarse stamps, not doubled rows
_OFTEN = 0.8


@dataclass(frozen=True)
class LogChoices:
    """What is known of a log besides what it says itself.

    Attributes
    ----------
    columns : sequence of str or None
        Names of the columns in their order; "" leaves a column out. None: those of the header, else time, counts,
        temperature.
    time_unit : str
        "s", "ms", "us", "min" or "h"; "": what the header says, else s.
    units : str
        Of the output, a key of `OUTPUT_UNITS`; "": what the header says, else counts.
    interval_s : float or None
        Between two outputs; needed where there is no column of the time.
    """

    columns: Sequence[str] | None = None
    time_unit: str = ""
    units: str = ""
    interval_s: float | None = None


@dataclass(frozen=True, eq=False)
class GyroLog:
    """A log as it was read.

    Attributes
    ----------
    begin_s : float
        Time of the first row by the file's own column; 0 without one.
    outputs : dict of str to (n,)
        Columns with an output: "counts", "counts_x", ...
    unit : str
        Of all outputs, a key of `OUTPUT_UNITS`.
    rest : Recording
        Times, further columns and gaps; its counts are the first output's.
    """

    begin_s: float
    outputs: dict[str, Floats]
    unit: str
    rest: Recording

    def recording(self, axis: str = "", *, counts_per_dps: float | None = None) -> Recording:
        """Return the output of one axis as a recording.

        Parameters
        ----------
        axis : str
            Which, where the log holds several; the others become further columns of the recording.
        counts_per_dps : float, optional
            Turns an output in deg/s or deg/h into counts.

        Raises
        ------
        FileFormatError
            There is no output of this axis, or it is not in counts and nobody says what a count is.
        """
        scale = 1.0
        if self.unit != COUNTS:
            if counts_per_dps is None:
                raise FileFormatError(f"the output is in {self.unit}: say how many counts 1 deg/s is")
            scale = OUTPUT_UNITS[self.unit] * counts_per_dps
        scaled = {name: scale * values if scale != 1.0 else values for name, values in self.outputs.items()}
        if len(scaled) == 1:
            return replace(self.rest, counts=next(iter(scaled.values())))
        name = axis_column(axis) if axis else ""
        if name not in scaled:
            there = ", ".join(scaled)
            raise FileFormatError(
                f"holds the outputs {there}: name the axis of the log, X, Y or Z"
                if not axis
                else f"holds the outputs {there}, none of axis {axis}"
            )
        return replace(self.rest, counts=scaled[name], extra={**self.rest.extra, **scaled})


def read_log(path: str | os.PathLike[str], choices: LogChoices | None = None) -> GyroLog:
    """Read a log.

    Parameters
    ----------
    path : path-like
        Columns are separated by a comma, semicolon, tab or spaces; lines that begin with ``#``, ``%``, ``!`` or
        ``//``, empty lines and text above the numbers are passed over.

    Raises
    ------
    FileFormatError
        Names the file, the line and what is wrong there.
    OSError
        If it cannot be read.
    """
    file = Path(path)
    try:
        with open_plain_file(file) as stream:
            text = io.TextIOWrapper(stream, encoding="utf-8-sig", errors="replace")
            return _read(text, choices or LogChoices())
    except FileFormatError as error:
        said = str(error)
        raise FileFormatError(said if said.startswith(f"{file}: ") else f"{file}: {said}") from None


def read_gyro_log(
    path: str | os.PathLike[str],
    *,
    columns: Sequence[str] | None = None,
    time_unit: str | None = None,
    interval_s: float | None = None,
    units: str | None = None,
    axis: str = "",
    counts_per_dps: float | None = None,
) -> Recording:
    """Read a log of one gyro, or one axis of it, as a recording.

    Parameters
    ----------
    columns, time_unit, interval_s, units
        As in `LogChoices`.
    axis, counts_per_dps
        As in `GyroLog.recording`.

    Returns
    -------
    Recording
        `times` begin at 0 with the first row.

    Raises
    ------
    FileFormatError
        Names the file, the line and what is wrong there.
    OSError
        If it cannot be read.
    """
    log = read_log(path, LogChoices(columns, time_unit or "", units or "", interval_s))
    try:
        return log.recording(axis, counts_per_dps=counts_per_dps)
    except FileFormatError as error:
        raise FileFormatError(f"{Path(path)}: {error}") from None


def parse_gyro_log(
    text: str,
    *,
    columns: Sequence[str] | None = None,
    time_unit: str | None = None,
    interval_s: float | None = None,
    units: str | None = None,
    axis: str = "",
    counts_per_dps: float | None = None,
) -> Recording:
    """Read the text of a log. Parameters and errors as `read_gyro_log`."""
    stream = io.StringIO(text.removeprefix("\ufeff").replace("\r\n", "\n"))
    log = _read(stream, LogChoices(columns, time_unit or "", units or "", interval_s))
    return log.recording(axis, counts_per_dps=counts_per_dps)


def _read(text: IO[str], choices: LogChoices) -> GyroLog:
    if choices.interval_s is not None and not choices.interval_s > 0:
        raise FileFormatError(f"the interval of the output must be positive, not {choices.interval_s:g} s")
    units: list[str] = []

    def names_of(dialect: Dialect) -> list[str]:
        names, found = _names(dialect, choices)
        units.extend(found)
        return names

    _, names, table = read_table(text, names_of)
    columns = {name: table.values[:, place].copy() for place, name in enumerate(one for one in names if one)}
    unit_of = {name: unit for name, unit in zip(names, units, strict=True) if name}
    outputs = {name: columns.pop(name) for name in list(columns) if is_output(name)}
    unit = _output_unit(outputs, unit_of, choices.units)
    counter, status = columns.pop(COUNTER, None), columns.pop(STATUS, None)
    times = columns.pop(TIME, None)
    if times is not None:
        times = times * seconds_of(choices.time_unit or unit_of[TIME] or "s")
    clock, kind = _clock(times, counter, table, choices.interval_s)
    gaps = _gaps(clock)
    rest = Recording(
        times=np.asarray(clock.interval_s * clock.places if clock.regular or times is None else times - times[0]),
        counts=next(iter(outputs.values())),
        temperature=columns.pop(TEMPERATURE, None),
        status=None if status is None else status.astype(np.int64),
        extra=columns,
        gaps=gaps,
        losses=Losses(good=len(table.lines), missing=sum(gap.missing for gap in gaps)),
        interval_s=clock.interval_s,
        clock=kind,
    )
    return GyroLog(0.0 if times is None else float(times[0]), outputs, unit, rest)


# ---------------------------------------------------------------------- columns


def _names(dialect: Dialect, choices: LogChoices) -> tuple[list[str], list[str]]:
    """Names of the columns and the units that they come with."""
    none = [""] * dialect.width
    header = named_columns(dialect.header) if dialect.header is not None else None
    if choices.columns is not None:
        names, units = named_columns(choices.columns)
        if header is not None and len(names) == len(header[0]):
            units = [own or theirs for own, theirs in zip(units, header[1], strict=True)]
    elif header is not None:
        names, units = header
    else:
        names, units = default_names(dialect.width), none
    _check_names(names, choices)
    return names, units


def _check_names(names: list[str], choices: LogChoices) -> None:
    outputs = [name for name in names if is_output(name)]
    doubled = next((name for name in names if name and names.count(name) > 1), "")
    missing = COUNTS if not outputs else ""
    if TIME not in names and choices.interval_s is None:
        missing = missing or TIME
    if not missing and not doubled:
        return
    more = "" if missing != TIME else ", or give the rate of the output with the option or setting output_rate_hz"
    raise FileFormatError(
        f"there must be one column {missing or doubled!r}, but the columns are "
        f"{', '.join(name for name in names if name) or 'none'}; name them in their order with the option or "
        f"setting columns{more}"
    )


def _output_unit(outputs: dict[str, Floats], unit_of: dict[str, str], given: str) -> str:
    if given:
        return output_unit(given, "the output")
    units = {output_unit(unit_of[name], name) for name in outputs}
    if len(units) > 1:
        raise FileFormatError(f"the outputs stand in {' and '.join(sorted(units))}: they must have one unit")
    return units.pop()


# ---------------------------------------------------------------------- time


def _clock(
    times: Floats | None, counter: Floats | None, table: Table, interval_s: float | None
) -> tuple[LogClock, str]:
    """Place of every row, and what that rests on."""
    if times is not None:
        _check_order(times, table, coarse_allowed=counter is None)
    if table.lines.size < 2 and interval_s is None:
        raise FileFormatError("one row alone does not tell the interval of the output; give it as interval_s")
    if counter is not None and table.lines.size > 1:
        places = _counted(counter, table)
        slope = line_through(places, times) if times is not None else interval_s
        return LogClock(float(slope or 0.0), places, True), "counter"
    if times is None or table.lines.size < 2:
        rows = np.arange(table.lines.size, dtype=np.int64)
        return LogClock(float(interval_s or 0.0), rows, True), "frames" if times is None else "time column"
    if interval_s is not None:
        early = np.flatnonzero(np.diff(times) <= 0.5 * interval_s)
        if early.size > _OFTEN * (times.size - 1):
            raise FileFormatError(
                f"line {table.lines[early[0] + 1]}: the rows do not come every {interval_s:.6g} s; give the "
                "interval of the output as interval_s, or correct the time column"
            )
    return find_clock(times - times[0], interval_s), "time column"


def _check_order(times: Floats, table: Table, *, coarse_allowed: bool) -> None:
    steps = np.diff(times)
    wrong = np.flatnonzero(steps < 0)
    if not wrong.size:
        doubled = np.flatnonzero(steps == 0)
        wrong = doubled if coarse_allowed and 0 < doubled.size <= _DOUBLED * steps.size + 1 else wrong
        if steps.size and doubled.size == steps.size:
            wrong = doubled
    if wrong.size:
        at = int(wrong[0])
        raise FileFormatError(
            f"line {table.lines[at + 1]}: {times[at + 1]:.9g} s comes after {times[at]:.9g} s; "
            "rows are doubled, out of order, or two runs stand in one file"
        )


def _counted(counter: Floats, table: Table) -> Places:
    try:
        return clock_of_counter(counter)
    except ValueError as error:
        raise FileFormatError(
            f"line {table.lines[int(str(error))]}: the counter stands still; rows are doubled"
        ) from None


def _gaps(clock: LogClock) -> tuple[Gap, ...]:
    steps = np.diff(clock.places)
    return tuple(
        Gap(
            int(after),
            float((clock.places[after] + 1) * clock.interval_s),
            float((steps[after] - 1) * clock.interval_s),
            int(steps[after]) - 1,
            "rows missing",
        )
        for after in np.flatnonzero(steps > 1)
    )
