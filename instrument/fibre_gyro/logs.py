"""Log files of a gyro: dialect, columns and clock found out; one gyro or three axes, whole or in parts."""

from __future__ import annotations

import csv
import datetime
import io
import itertools
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from instrument.errors import FileFormatError
from instrument.fibre_gyro.frame_fields import COUNTER, COUNTS, STATUS, TABLE_ANGLE, TEMPERATURE, is_output
from instrument.fibre_gyro.recording import Floats, Gap, Losses, Recording
from instrument.text_files import open_plain_file

_DOUBLED = 0.02  # of the rows: more equal time stamps than these are coarse stamps, not doubled rows
_OFTEN = 0.8
_WORDS = (16, 20, 24, 32)  # bits


@dataclass(frozen=True)
class LogChoices:
    """What is known of a log besides what it says itself."""

    # names of the columns in their order; "" leaves a column out. None: those of the header, else time, counts,
    # temperature.
    columns: Sequence[str] | None = None
    time_unit: str = ""  # "s", "ms", "us", "min" or "h"; "": what the header says, else s
    units: str = ""  # of the output, a key of `OUTPUT_UNITS`; "": what the header says, else counts
    interval_s: float | None = None  # between two outputs; needed where there is no column of the time


@dataclass(frozen=True, eq=False)
class GyroLog:
    """A log as it was read."""

    begin_s: float  # time of the first row by the file's own column; 0 without one
    outputs: dict[str, Floats]  # columns with an output: "counts", "counts_x",
    unit: str  # of all outputs, a key of `OUTPUT_UNITS`
    rest: Recording  # times, further columns and gaps; its counts are the first output's

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
    """Read a log."""
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
    """Read a log of one gyro, or one axis of it, as a recording."""
    log = read_log(path, LogChoices(columns, time_unit or "", units or "", interval_s))
    try:
        return log.recording(axis, counts_per_dps=counts_per_dps)
    except FileFormatError as error:
        raise FileFormatError(f"{Path(path)}: {error}") from None


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
    _check_words(outputs, table.lines)
    if (unit_of_angle := unit_of.get(TABLE_ANGLE, "")) not in ("", "deg", "degree", "degrees", "°"):
        raise FileFormatError(f"the angle of the table must be in deg, not in {unit_of_angle!r}")
    counter, status = columns.pop(COUNTER, None), columns.pop(STATUS, None)
    times = columns.pop(TIME, None)
    if times is not None:
        times = times * seconds_of(choices.time_unit or unit_of[TIME] or _unit_of_epoch(times))
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


def _unit_of_epoch(times: Floats) -> str:
    """Unit of stamps that do not give it: what would be 3000 years in seconds counts from 1970 in ms or us."""
    largest = float(np.max(np.abs(times), initial=0.0))
    return "s" if largest < 1e11 else "ms" if largest < 1e14 else "us"


def _check_words(outputs: dict[str, Floats], lines: NDArray[np.int64]) -> None:
    """FileFormatError where signed words were written as unsigned ones: negative ones stand at the other end."""
    for words in outputs.values():
        for bits in _WORDS:
            highest = float(words.max(initial=0.0))
            if words.min(initial=0.0) < 0 or highest >= 2.0**bits or highest < 0.9 * 2.0**bits:
                continue
            jumps = np.flatnonzero(np.abs(np.diff(words)) > 0.9 * 2.0**bits)
            if jumps.size and not np.any((words > 0.1 * 2.0**bits) & (words < 0.9 * 2.0**bits)):
                at = int(jumps[0])
                raise FileFormatError(
                    f"line {lines[at + 1]}: the output goes from {words[at]:.0f} to {words[at + 1]:.0f}: signed "
                    f"words of {bits} bits were written without their sign; take 2^{bits} from those above "
                    f"2^{bits - 1}"
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
    times: Floats | None, counter: Floats | None, table: LogTable, interval_s: float | None
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


def _check_order(times: Floats, table: LogTable, *, coarse_allowed: bool) -> None:
    steps = np.diff(times)
    wrong = np.flatnonzero(steps < 0)
    if not wrong.size:
        doubled = np.flatnonzero(steps == 0)
        wrong = doubled if coarse_allowed and 0 < doubled.size <= _DOUBLED * steps.size + 1 else wrong
        # rows with one time stamp are coarse stamps where their outputs differ, and doubled where nothing does
        equal = np.sum(table.values[1:] == table.values[:-1], axis=1) + (steps > 0) == table.values.shape[1]
        others = np.count_nonzero(equal) - np.count_nonzero(equal[doubled])
        often = 2 * np.count_nonzero(equal[doubled]) > doubled.size and 2 * others < steps.size - doubled.size
        if doubled.size and (doubled.size == steps.size or often):
            wrong = doubled
    if wrong.size:
        at = int(wrong[0])
        raise FileFormatError(
            f"line {table.lines[at + 1]}: {times[at + 1]:.9g} s comes after {times[at]:.9g} s; "
            "rows are doubled, out of order, or two runs stand in one file"
        )


def _counted(counter: Floats, table: LogTable) -> Places:
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


# --------------------
# The rows of a log, read block by block, so that a file of hours needs the memory of its numbers alone


_COMMENTS = ("#", "%", "!", "//")
_BLOCK = 1 << 21  # characters read at once
_SAMPLE = 400  # lines that tell the separator


@dataclass(frozen=True)
class Dialect:
    """How the numbers of a file are written."""

    separator: str | None  # none for any number of blanks
    decimal_comma: bool
    header: list[str] | None  # cells of the line above the numbers that has as many columns
    first_line: int  # line of the first row
    width: int  # columns


@dataclass(frozen=True)
class LogTable:
    """Numbers of the columns that are wanted, with the line that each row stands on."""

    values: Floats
    lines: NDArray[np.int64]


Names = Callable[[Dialect], list[str]]  # gives each column its name, "" to leave it out


def read_table(text: IO[str], names_of: Names) -> tuple[Dialect, list[str], LogTable]:
    """Read all rows."""
    blocks = _blocks(text)
    first = next(blocks, None)
    if first is None:
        raise FileFormatError("there is not one row of numbers; is it the right file?")
    dialect = _dialect(first[1])
    names = names_of(dialect)
    parts, lines = [], []
    for begin, block in itertools.chain([first], blocks):
        numbered = [
            (number, line)
            for number, line in enumerate((one.strip() for one in block), start=begin)
            if line and number >= dialect.first_line and not line.startswith(_COMMENTS)
        ]
        if numbered:
            parts.append(_numbers(numbered, dialect, names))
            lines.append(np.array([number for number, _ in numbered], dtype=np.int64))
    return dialect, names, LogTable(np.concatenate(parts), np.concatenate(lines))


def seconds_of_day(cell: str) -> float:
    """Seconds of a clock time such as 12:30:01.25, or of a date with one; ValueError if it is neither."""
    if "-" in cell[1:] or "/" in cell:
        moment = datetime.datetime.fromisoformat(cell.replace("/", "-").replace("Z", "+00:00"))
        return (moment.replace(tzinfo=None) - datetime.datetime(2000, 1, 1)).total_seconds()
    parts = cell.split(":")
    if not 2 <= len(parts) <= 3:
        raise ValueError(cell)
    hours, minutes, seconds = (float(part) for part in (*parts, "0")[:3])
    return 3600.0 * hours + 60.0 * minutes + seconds


def _blocks(text: IO[str]) -> Iterator[tuple[int, list[str]]]:
    """Number of the first line of each block, and its lines; the first block holds a row if there is one."""
    begin, held = 1, []
    while lines := text.readlines(_BLOCK):
        held += lines
        if any(line.strip() and not line.lstrip().startswith(_COMMENTS) for line in held):
            yield begin, held
            begin, held = begin + len(held), []


def _dialect(block: list[str]) -> Dialect:
    lines = [
        (number, line.strip())
        for number, line in enumerate(block[: 50 * _SAMPLE], start=1)
        if line.strip() and not line.strip().startswith(_COMMENTS)
    ][: 10 * _SAMPLE]
    sample = [line for _, line in lines[:: max(1, len(lines) // _SAMPLE)]]
    separator = next(
        (mark for mark in (";", "\t", ",") if 2 * sum(mark in line for line in sample) > len(sample)), None
    )
    width = Counter(len(split_row(line, separator)) for line in sample).most_common(1)[0][0]
    comma = separator != ","
    header = None
    for number, line in lines:
        cells = split_row(line, separator)
        numeric = [_is_number(cell, comma) for cell in cells]
        if len(cells) == width and (numeric[0] or 2 * sum(numeric) > width):
            decimal_comma = comma and any("," in other for at, other in lines if at >= number)
            return Dialect(separator, decimal_comma, header, number, width)
        if len(cells) != width and any(numeric) and all(numeric):
            return Dialect(separator, False, header, number, width)
        if len(cells) == width:
            header = cells
    raise FileFormatError("there is a header, but not one row of numbers below it")


def split_row(line: str, separator: str | None) -> list[str]:
    """Cells of a line; a row may end with a separator other than a comma."""
    cells = [cell.strip().strip('"') for cell in line.split(separator)]
    if separator not in (",", None) and len(cells) > 1 and cells[-1] == "":
        cells.pop()
    return cells


def _is_number(cell: str, decimal_comma: bool) -> bool:
    try:
        _value(cell, decimal_comma)
    except ValueError:
        return False
    return True


def _value(cell: str, decimal_comma: bool) -> float:
    plain = cell.replace(",", ".") if decimal_comma else cell
    return seconds_of_day(plain) if ":" in plain else float(plain)


def _numbers(rows: list[tuple[int, str]], dialect: Dialect, names: list[str]) -> Floats:
    """Numbers of the wanted columns: by NumPy where they are plain, else cell by cell to name what is wrong."""
    wanted = [place for place, name in enumerate(names) if name]
    lines = [line for _, line in rows]
    if dialect.separator is None or all(line.count(dialect.separator) == len(names) - 1 for line in lines):
        text = "\n".join(lines).replace('"', "")
        if dialect.decimal_comma:
            text = text.replace(",", ".")
        if ":" not in text and "#" not in text:
            try:
                columns = wanted if len(wanted) < len(names) else None
                values = np.loadtxt(
                    io.StringIO(text), delimiter=dialect.separator, ndmin=2, comments=None, usecols=columns
                )
            except ValueError:
                values = np.empty((0, 0))
            if values.shape == (len(rows), len(wanted)) and np.all(np.isfinite(values)):
                return values
    return _one_by_one(rows, dialect, names, wanted)


def _one_by_one(rows: list[tuple[int, str]], dialect: Dialect, names: list[str], wanted: list[int]) -> Floats:
    table = np.empty((len(rows), len(wanted)))
    for row, (line, text) in enumerate(rows):
        cells = split_row(text, dialect.separator)
        if len(cells) != len(names):
            raise FileFormatError(
                f"line {line} has {len(cells)} columns where {len(names)} ({', '.join(names)}) are expected; "
                "correct or remove it"
            )
        for column, place in enumerate(wanted):
            table[row, column] = _number(cells[place], line, names[place], dialect.decimal_comma)
    return table


def _number(cell: str, line: int, name: str, decimal_comma: bool) -> float:
    try:
        value = _value(cell, decimal_comma)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise FileFormatError(
            f"line {line}: the {name} is {cell[:40]!r}, no number; correct or remove the line, or leave the "
            "column out with the option or setting columns"
        )
    return value


# --------------------
# When the rows of a log were made: the interval between them, and the rows that are missing.
#
# Time stamps are rounded, to 1 ms or to 10 ms, and come from a host that was late now and then. The interval is
# that of a line through all of them, never one of their differences; a row is missing where the stamps behind it
# stay behind the line, not where one of them is


Places = NDArray[np.int64]

_CHUNK = 100  # rows over which a first interval is taken
_FIRST_ROWS = 2000  # whose phase is looked for
_FEW_ROWS = 50
_WIDEST = 0.06  # that the first interval may be off by
_REACH = 512  # rows that are looked at together
_LOCAL = 50  # rows among which the one before a missing one is looked for
_COARSE = 0.05  # of an interval: with stamps rounded by more the places tell the time better
_TOO_COARSE = 0.8  # of an interval: stamps rounded by more have no phase
_STEPS = (1.0, 0.5, 0.2, 0.1)
_LONGEST_STEP = 100_000  # of the stamps' grid, that an interval is looked for among
_NO_CLOCK = (
    "too many rows are missing, or the time stamps are too coarse, to tell the interval of the output: give its "
    "rate with the option or setting output_rate_hz, or a counter beside the output"
)
_BEYOND_STEPS = 2.5  # of the stamps, by which a line through them may miss the stamps
_FEW_STAIRS = 3  # places that are skipped evenly, from which on they are no missing rows
_NO_CHANCE = 8.0  # logarithm by which a line in where they are exceeds what chance makes


@dataclass(frozen=True)
class LogClock:
    """Place of each row on the gyro's clock."""

    interval_s: float  # between two outputs
    places: Places  # (n,): Intervals since the first row
    regular: bool  # whether the stamps are so coarse that `places` tell the time better than they do


def clock_of_counter(counter: Floats) -> Places:
    """Intervals since the first row by a counter, over its wraps; ValueError with the row where it stands still.

    >>> clock_of_counter(np.array([126.0, 127.0, 0.0, 3.0])).tolist()
    [0, 1, 2, 5]
    """
    numbers = np.round(counter).astype(np.int64)
    steps = np.diff(numbers)
    if np.any(steps < 0):
        largest = int(numbers.max())
        modulus = largest + 1 if _wraps_at(numbers, steps, largest + 1) else 1 << largest.bit_length()
        steps = steps % modulus
    if np.any(steps == 0):
        raise ValueError(str(int(np.flatnonzero(steps == 0)[0]) + 1))
    each = int(np.median(steps))
    if each > 1 and not np.any(steps % each):
        steps //= each
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _wraps_at(numbers: Places, steps: Places, modulus: int) -> bool:
    """Whether most wraps go on by one step if the counter begins again at `modulus`."""
    behind = np.flatnonzero(steps < 0)
    return bool(np.median((numbers[behind + 1] - numbers[behind]) % modulus) == np.median(steps[steps > 0]))


def line_through(places: Places, times: Floats) -> float:
    """Slope of the straight line through the time stamps, s per interval."""
    centred = places - places.mean()
    return float(centred @ (times - times.mean()) / (centred @ centred))


def find_clock(times: Floats, interval_s: float | None) -> LogClock:
    """Find interval and missing rows."""
    rows = np.arange(times.size, dtype=np.int64)
    step = _rounding(times)
    on_grid = _on_a_grid(times, step)
    if on_grid is not None:
        interval, places = on_grid
        each = _rows_apart(interval, interval_s)
        return LogClock(interval / each, each * places, False)
    slope = line_through(rows, times)
    off = float(np.ptp(times - times.mean() - slope * (rows - rows.mean())))
    if off <= 1.1 * step + 1e-9 * slope:  # a saw tooth about the line through it
        each = _rows_apart(slope, interval_s)
        return LogClock(slope / each, each * rows, bool(off > 1e-6 * slope and step > _COARSE * slope))
    found = _first_interval(times)
    each = _rows_apart(found, interval_s)
    if times.size < _FEW_ROWS:
        places = np.concatenate([[0], np.cumsum(np.maximum(np.round(np.diff(times) / (found / each)), 1))])
        return LogClock(line_through(places.astype(np.int64), times), places.astype(np.int64), False)
    if step > _TOO_COARSE * found and abs(found / step - 1) > 1e-3:
        places = _within_bounds(times, step, found)
        interval = line_through(places, times)
        if float(np.ptp(times - interval * places)) > _BEYOND_STEPS * step:
            return _by_stated_rate(times, interval_s)
        return LogClock(interval / each, each * places, True)
    places = _in_phase(times, found / each)
    interval = line_through(places, times)
    late = times - interval * places
    if float(np.median(np.abs(late - np.median(late)))) > 0.5 * (step + interval):
        return _by_stated_rate(times, interval_s)
    clear = step <= _COARSE * interval and float(np.abs(times - interval * places).max()) < 0.25 * interval
    return LogClock(interval, places, not clear)


def _by_stated_rate(times: Floats, interval_s: float | None) -> LogClock:
    """Places by an interval that is stated, where the stamps do not tell it; FileFormatError without one."""
    if interval_s is None:
        raise FileFormatError(_NO_CLOCK)
    rows = np.arange(times.size, dtype=np.int64)
    ahead = np.round(times / interval_s).astype(np.int64) - rows
    return LogClock(interval_s, np.maximum.accumulate(np.maximum(ahead, 0)) + rows, True)


def _rounding(times: Floats) -> float:
    """Step that all time stamps are whole multiples of, s; 0 if they are finer than 1 us."""
    sample = times[:1000]
    for power in range(7):
        for part in _STEPS:
            step = part * 10.0**-power
            if all(np.all(np.abs(some / step - np.round(some / step)) < 1e-3) for some in (sample, times)):
                return step
    return 0.0


def _on_a_grid(times: Floats, step: float) -> tuple[float, Places] | None:
    """Interval and places where all stamps are whole multiples of the interval, and rows are missing."""
    if not step:
        return None
    numbers = np.round(times / step).astype(np.int64)
    steps = np.diff(numbers)
    usual = int(np.bincount(np.clip(steps, 0, _LONGEST_STEP)).argmax())
    if usual < 1 or steps.min() < 1 or np.any(steps % usual) or not np.mean(steps == usual) > 0.5:
        return None
    places = (numbers - numbers[0]) // usual
    # An interval a little longer than the grid skips a place of it now and then, but as evenly as stairs; rows are
    # missing here and there.
    between = np.diff(places[1:][steps > usual])
    even = between.size >= _FEW_STAIRS and np.mean(np.abs(between - np.median(between)) <= 1) > 0.5
    skipped = np.ones(int(places[-1]) + 1)
    skipped[places] = 0.0
    lines = np.abs(np.fft.rfft(skipped)[1:]) ** 2 / max(skipped.sum(), 1.0)
    if even or (lines.size and lines.max() > np.log(lines.size) + _NO_CHANCE):
        return None
    return usual * step, places


def _first_interval(times: Floats) -> float:
    """Interval to a few per cent, from rows so far apart that their rounding counts little."""
    if times.size < _FEW_ROWS:
        return float(np.median(np.diff(times)))
    count = min(_CHUNK, times.size // 4)
    spans = np.sort((times[count:] - times[:-count]) / count)
    # missing rows make a span longer, so the shorter half is nearer to the truth
    return float(spans[: max(1, spans.size // 2)].mean())


def _rows_apart(found: float, stated: float | None) -> int:
    """Intervals from row to row: more than one where the output is stated to come more often than the rows do."""
    times = round(found / stated) if stated is not None else 1
    return times if stated is not None and times >= 2 and abs(found / stated / times - 1) < 0.05 else 1


def _in_phase(times: Floats, interval: float) -> Places:
    """Places by the phase of the stamps, which no missing row shifts: first a few of them, then ever more."""
    count = min(_FIRST_ROWS, times.size)
    some = times[:count]
    trials = 1 / interval * (1 + np.arange(-_WIDEST, _WIDEST, 0.2 * interval / max(float(some[-1]), interval)))
    strength = np.array([abs(np.exp(2j * np.pi * trial * some).sum()) for trial in trials])
    frequency = float(trials[int(np.argmax(strength))])
    phase = float(np.angle(np.exp(2j * np.pi * frequency * some).sum())) / (2 * np.pi)
    while True:
        turns = frequency * times[:count] - phase
        places = np.round(turns).astype(np.int64)
        rows = np.arange(count)
        # a stamp that came late is followed by one in time
        missing = np.minimum.accumulate((places - rows)[::-1])[::-1]
        places = np.maximum.accumulate(missing) + rows
        on_time = np.abs(turns - places) < 0.5
        slope = line_through(places[on_time], times[:count][on_time])
        first = float(times[:count][on_time].mean() - slope * places[on_time].mean())
        frequency, phase = 1 / slope, first / slope
        if count == times.size:
            return np.asarray(places - places[0], dtype=np.int64)
        count = min(4 * count, times.size)


def _within_bounds(times: Floats, step: float, first: float) -> Places:
    """Places where stamps are rounded to more than their interval: they keep within one step of a line."""
    interval = _quiet_slope(times, step, first)
    missing = np.zeros(times.size, dtype=np.int64)
    late = times - interval * np.arange(times.size)
    allowed = 1.02 * step + 1e-3 * interval
    begin = 0
    # each row that is missing puts all behind it a step back; more of them than there is time for is no clock
    most = int(np.ptp(times) / max(interval, step)) + times.size
    while begin < times.size - 1 and missing.sum() < most:
        part = late[begin : begin + _REACH]
        above = part - np.minimum.accumulate(part) > allowed
        if not above.any():
            begin += max(1, min(_REACH // 2, part.size))
            continue
        last = begin + int(np.argmax(above))
        before = max(begin + 1, last - _LOCAL)
        around = late[max(0, before - _LOCAL) : last + _LOCAL]
        rows = np.arange(max(0, before - _LOCAL), max(0, before - _LOCAL) + around.size)
        spreads = [float(np.ptp(around - interval * (rows >= at))) for at in range(before, last + 1)]
        at = before + int(np.argmin(spreads))
        missing[at] += 1
        late[at:] -= interval
    return np.arange(times.size) + np.cumsum(missing)


def _quiet_slope(times: Floats, step: float, first: float) -> float:
    """Interval from the longest stretches in which no row is missing."""
    for length in (8192, 2048, 512, 128):
        slopes = []
        for begin in range(0, times.size - length + 1, length):
            part, rows = times[begin : begin + length], np.arange(length, dtype=np.int64)
            slope = line_through(rows, part)
            if np.ptp(part - slope * rows) <= 1.05 * step:
                slopes.append(slope)
        if slopes:
            return float(np.median(slopes))
    return first


# --------------------
# What the columns of a log are called, and in which units they stand


TIME = "time"
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
OUTPUT_UNITS = {"counts": 0.0, "deg/s": 1.0, "deg/h": 1 / 3600.0, "rad/s": 180 / 3.141592653589793}
"""Units of the output, and how many deg/s one of each is; counts are none."""

_DEFAULT = {1: (COUNTS,), 2: (TIME, COUNTS)}
_LONG_DEFAULT = (TIME, COUNTS, TEMPERATURE)
_SYNONYMS = {
    TIME: ("time", "t", "seconds", "second", "sec", "timestamp", "time_stamp"),
    COUNTS: ("counts", "count", "output", "gyro", "n", "f", "lsb", "pulses", "rate", "fog"),
    TEMPERATURE: ("temperature", "temp", "t_c", "temperature_degc"),
    STATUS: ("status",),
    TABLE_ANGLE: ("table_deg", "table_angle", "table_position", "encoder_deg", "encoder_angle"),
    COUNTER: ("counter", "frame", "frame_number", "seq", "sequence", "index", "sample"),
}
_AXIS = re.compile(
    r"(?:counts?|gyro|g|w|omega|rate|n|f|output|fog|axis)?_?([xyz])(?:_?(?:axis|counts?|gyro|rate))?"
)
_SUFFIX = re.compile(r"(?:^|_)(s|ms|us|min|dps|dph|deg_s|deg_h|degps|degph)$")
_BRACKET = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_UNIT_WORDS = {
    "counts": ("counts", "count", "lsb", "pulses", "pulse", "codes", "code", "digits", ""),
    "deg/s": ("deg/s", "dps", "deg_s", "degps", "°/s", "deg/sec"),
    "deg/h": ("deg/h", "dph", "deg_h", "degph", "°/h", "deg/hr", "deg/hour"),
    "rad/s": ("rad/s", "rps", "rad/sec"),
}


def axis_column(axis: str) -> str:
    """Name of the column with the output of one axis.

    >>> axis_column("Z")
    'counts_z'
    """
    return f"{COUNTS}_{axis.lower()}"


def default_names(width: int) -> list[str]:
    """Names of the columns of a file without a header."""
    known = _DEFAULT.get(width, _LONG_DEFAULT)
    return [*known, *(f"column_{number}" for number in range(len(known) + 1, width + 1))]


def named_columns(header: Sequence[str]) -> tuple[list[str], list[str]]:
    """Our names of the columns of a header, and the units that it gives ("" where it gives none).

    >>> named_columns(["Time [ms]", "Gyro X (deg/h)", "T_C", "hot"])
    (['time', 'counts_x', 'temperature', 'hot'], ['ms', 'deg/h', '', ''])
    """
    pairs = [_named(cell.strip()) for cell in header]
    return [name for name, _ in pairs], [unit for _, unit in pairs]


def _named(cell: str) -> tuple[str, str]:
    word, unit = cell, ""
    if found := _BRACKET.search(cell):
        word, unit = cell[: found.start()], found[1].strip().lower()
    word = re.sub(r"[\s.-]+", "_", word.strip().lower())
    for name, synonyms in _SYNONYMS.items():
        if word in synonyms:
            return name, unit
    if not unit and (suffix := _SUFFIX.search(word)) and suffix.start() > 0:
        stem = word[: suffix.start()]
        for name, synonyms in _SYNONYMS.items():
            if stem in synonyms and name in (TIME, COUNTS):
                return name, suffix[1]
        if axis := _AXIS.fullmatch(stem):
            return axis_column(axis[1]), suffix[1]
    if axis := _AXIS.fullmatch(word):
        return axis_column(axis[1]), unit
    return word, unit


def seconds_of(unit: str) -> float:
    """Seconds in one unit of time; FileFormatError if there is no such unit."""
    if unit not in SECONDS:
        raise FileFormatError(f"the unit of time must be one of {', '.join(SECONDS)}, not {unit!r}")
    return SECONDS[unit]


def output_unit(unit: str, name: str) -> str:
    """Unit of an output as `OUTPUT_UNITS` has it; FileFormatError if it is none of them."""
    for known, words in _UNIT_WORDS.items():
        if unit.lower() in words:
            return known
    raise FileFormatError(
        f"the unit of {name} is {unit!r}; it must be one of {', '.join(OUTPUT_UNITS)}: say which with the "
        "option or setting units"
    )


# --------------------
# A recording as a log


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
    writer.writerows(
        [repr(int(v)) if v == int(v) else repr(v) for v in row]
        for row in zip(*map(np.ndarray.tolist, columns.values()), strict=True)
    )
    Path(path).write_text(out.getvalue(), "ascii")
