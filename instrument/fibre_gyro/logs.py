"""Logs of a fibre gyro as CSV files: time, counts and, if there are more columns, the temperature and others.

Written by all sorts of programs, so separator, header, comments and decimal comma are found out from the file. The
numbers are not: a row that cannot be read is an error with its line number, never left out.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from instrument.errors import FileFormatError
from instrument.fibre_gyro.frame_format import COUNTS, STATUS, TEMPERATURE
from instrument.fibre_gyro.recording import Floats, Gap, Losses, Recording
from instrument.small_files import read_small_file

TIME = "time"
DEFAULT_COLUMNS = (TIME, COUNTS, TEMPERATURE)
_LARGEST_FILE = 256 << 20  # bytes; a day at 100 Hz has about 200 MB
_COMMENTS = ("#", "%", "!", "//")
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
_SYNONYMS = {
    TIME: ("time", "t", "seconds", "second", "sec", "timestamp"),
    COUNTS: ("counts", "count", "output", "gyro", "n", "f", "lsb", "pulses"),
    TEMPERATURE: ("temperature", "temp", "t_c", "temperature_degc"),
    STATUS: ("status",),
}
_UNIT = re.compile(r"[\[(]\s*(\w+)[^\])]*[\])]\s*$|_(s|ms|us|min)$")
_SAMPLE = 100  # lines from which the separator is found
_SLACK = 0.5  # of an interval by which a row may come late before one counts as missing


@dataclass(frozen=True)
class _Rows:
    """The cells of a file, with the line that each row stands on."""

    header: list[str] | None
    header_line: int
    lines: list[int]
    cells: list[list[str]]


def read_gyro_log(
    path: str | os.PathLike[str],
    *,
    columns: Sequence[str] | None = None,
    time_unit: str | None = None,
    interval_s: float | None = None,
) -> Recording:
    """Read a log.

    Parameters
    ----------
    path : path-like
        Columns are separated by a comma, semicolon, tab or spaces; lines that begin with ``#``, ``%``, ``!`` or
        ``//`` and empty lines are passed over.
    columns : sequence of str, optional
        Names of the columns in their order: "time" and "counts" must be there; "temperature", "status" and any
        other name may. "" leaves a column out. Default: the header's names, else time, counts, temperature.
    time_unit : str, optional
        "s", "ms", "us", "min" or "h". Default: what the header says, else s.
    interval_s : float, optional
        Time between two outputs. Default: the median of the differences.

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
    file = Path(path)
    text = read_small_file(file, _LARGEST_FILE).decode("utf-8-sig", errors="replace")
    try:
        return parse_gyro_log(text, columns=columns, time_unit=time_unit, interval_s=interval_s)
    except FileFormatError as error:
        raise FileFormatError(f"{file}: {error}") from None


def parse_gyro_log(
    text: str,
    *,
    columns: Sequence[str] | None = None,
    time_unit: str | None = None,
    interval_s: float | None = None,
) -> Recording:
    """Read the text of a log. Parameters and errors as `read_gyro_log`."""
    rows, decimal_comma = _split(text)
    names = list(columns) if columns is not None else _names(rows)
    for name in (TIME, COUNTS):
        if names.count(name) != 1:
            raise FileFormatError(
                f"there must be one column {name!r}, but the columns are {', '.join(names) or 'none'}; "
                "name them in their order with the setting or option columns"
            )
    table = _numbers(rows, names, decimal_comma)
    unit = time_unit if time_unit is not None else _unit_in_header(rows, names)
    if unit not in _SECONDS:
        raise FileFormatError(f"the unit of time must be one of {', '.join(_SECONDS)}, not {unit!r}")
    return _recording(table, rows, _SECONDS[unit], interval_s)


def write_gyro_log(path: str | os.PathLike[str], recording: Recording) -> None:
    """Write a recording as a log that `read_gyro_log` reads back exactly."""
    columns: dict[str, Floats] = {"time_s": recording.times, COUNTS: recording.counts}
    if recording.temperature is not None:
        columns[TEMPERATURE] = recording.temperature
    if recording.status is not None:
        columns[STATUS] = recording.status.astype(np.float64)
    columns |= recording.extra
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([repr(int(v)) if v == int(v) else repr(v) for v in row] for row in _as_rows(columns))
    Path(path).write_text(out.getvalue(), "ascii")


def _as_rows(columns: dict[str, Floats]) -> list[list[float]]:
    rows: list[list[float]] = np.column_stack(list(columns.values())).tolist()
    return rows


# ---------------------------------------------------------------------- rows and columns


def _split(text: str) -> tuple[_Rows, bool]:
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.strip().startswith(_COMMENTS)
    ]
    if not lines:
        raise FileFormatError("there is not one row of numbers; is it the right file?")
    sample = [line for _, line in lines[:: max(1, len(lines) // _SAMPLE)]]
    separator = next(
        (mark for mark in (";", "\t", ",") if 2 * sum(mark in line for line in sample) > len(sample)), None
    )
    cells = [[cell.strip().strip('"') for cell in line.split(separator)] for _, line in lines]
    if separator != "," and separator is not None:
        # A row may end with a separator.
        cells = [row[:-1] if len(row) > 1 and row[-1] == "" else row for row in cells]
    decimal_comma = separator != "," and any("," in line for line in sample)
    header = None
    if not any(_is_number(cell, decimal_comma) for cell in cells[0]):
        header, cells, first = cells[0], cells[1:], lines[0][0]
        lines = lines[1:]
    else:
        first = 0
    if not cells:
        raise FileFormatError("there is a header, but not one row of numbers below it")
    return _Rows(header, first, [number for number, _ in lines], cells), decimal_comma


def _is_number(cell: str, decimal_comma: bool) -> bool:
    try:
        float(cell.replace(",", ".") if decimal_comma else cell)
    except ValueError:
        return False
    return True


def _names(rows: _Rows) -> list[str]:
    if rows.header is None:
        width = len(rows.cells[0])
        return [*DEFAULT_COLUMNS[:width], *(f"column_{number}" for number in range(4, width + 1))]
    return [_plain_name(cell) for cell in rows.header]


def _plain_name(cell: str) -> str:
    """Our name of a column, by what a header calls it; the unit behind it is left out."""
    word = _UNIT.sub("", cell.strip()).strip().lower().replace(" ", "_")
    for name, synonyms in _SYNONYMS.items():
        if word in synonyms:
            return name
    return word


def _unit_in_header(rows: _Rows, names: list[str]) -> str:
    if rows.header is None:
        return "s"
    place = names.index(TIME)
    found = _UNIT.search(rows.header[place].strip()) if place < len(rows.header) else None
    return (found[1] or found[2]).lower() if found else "s"


def _numbers(rows: _Rows, names: list[str], decimal_comma: bool) -> dict[str, Floats]:
    wanted = [place for place, name in enumerate(names) if name]
    table = np.empty((len(rows.cells), len(wanted)))
    for row, (line, cells) in enumerate(zip(rows.lines, rows.cells, strict=True)):
        if len(cells) != len(names):
            raise FileFormatError(
                f"line {line} has {len(cells)} columns where {len(names)} ({', '.join(names)}) are expected; "
                "correct or remove it"
            )
        for column, place in enumerate(wanted):
            table[row, column] = _number(cells[place], line, names[place], decimal_comma)
    return {names[place]: table[:, column].copy() for column, place in enumerate(wanted)}


def _number(cell: str, line: int, name: str, decimal_comma: bool) -> float:
    try:
        value = float(cell.replace(",", ".") if decimal_comma else cell)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise FileFormatError(f"line {line}: the {name} is {cell[:40]!r}, no number; correct or remove the line")
    return value


# ---------------------------------------------------------------------- time


def _recording(table: dict[str, Floats], rows: _Rows, unit: float, interval_s: float | None) -> Recording:
    times = table.pop(TIME) * unit
    backward = np.flatnonzero(np.diff(times) <= 0)
    if backward.size:
        line = rows.lines[int(backward[0]) + 1]
        raise FileFormatError(
            f"line {line}: {times[backward[0] + 1]:.9g} s comes after {times[backward[0]]:.9g} s; "
            "rows are doubled, out of order, or two runs stand in one file"
        )
    if interval_s is None:
        if times.size < 2:
            raise FileFormatError("one row alone does not tell the interval of the output; give it as interval_s")
        interval_s = float(np.median(np.diff(times)))
    elif not interval_s > 0:
        raise FileFormatError(f"the interval of the output must be positive, not {interval_s:g} s")
    times = times - times[0]
    gaps = _gaps(times, interval_s, rows)
    counts, temperature, status = table.pop(COUNTS), table.pop(TEMPERATURE, None), table.pop(STATUS, None)
    return Recording(
        times=times,
        counts=counts,
        temperature=temperature,
        status=None if status is None else status.astype(np.int64),
        extra=table,
        gaps=gaps,
        losses=Losses(good=len(times), missing=sum(gap.missing for gap in gaps)),
        interval_s=interval_s,
        clock="time column",
    )


def _gaps(times: Floats, interval_s: float, rows: _Rows) -> tuple[Gap, ...]:
    steps = np.diff(times) / interval_s
    early = np.flatnonzero(steps <= 1 - _SLACK)
    if early.size > 0.01 * steps.size:
        line = rows.lines[int(early[0]) + 1]
        raise FileFormatError(
            f"line {line}: the rows do not come every {interval_s:.6g} s; give the interval of the output as "
            "interval_s, or correct the time column"
        )
    return tuple(
        Gap(
            int(after),
            float(times[after] + interval_s),
            float(times[after + 1] - times[after] - interval_s),
            round(float(steps[after])) - 1,
            "rows missing",
        )
        for after in np.flatnonzero(steps > 1 + _SLACK)
    )
