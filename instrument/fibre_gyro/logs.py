"""Log files of a gyro: dialect, columns and clock found out; one gyro or three axes, whole or in parts."""

from __future__ import annotations

import csv
import datetime
import gzip
import io
import itertools
import os
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from instrument.errors import FileFormatError
from instrument.fibre_gyro.frame_fields import (
    ANGLE_UNITS,
    COUNTER,
    COUNTS,
    DATE,
    EACH,
    STATUS,
    TABLE_ANGLE,
    TEMPERATURE,
    TEMPERATURE_UNITS,
    TIME,
    axis_column,
    default_names,
    is_output,
    is_unit,
    named_columns,
    output_unit,
    seconds_of,
)
from instrument.fibre_gyro.log_clock import (
    LogClock,
    Places,
    clock_of_counter,
    find_clock,
    line_through,
    step_of_clock,
)
from instrument.fibre_gyro.recording import Floats, Gap, Losses, Recording, counts_per_unit
from instrument.text_files import open_plain_file

_MOST_SET = 20  # steps of the clock that are taken out
_DOUBLED = 0.02  # of the rows: more equal time stamps than these are coarse stamps, not doubled rows
_WORDS = (16, 20, 24, 32)  # bits
_LARGEST = 1e50  # that is a number at all


@dataclass(frozen=True)
class LogChoices:
    """What is known of a log besides what it says itself."""

    # names of the columns in their order; "" leaves a column out. None: those of the header, else time, counts,
    # temperature.
    columns: Sequence[str] | None = None
    time_unit: str = ""  # "s", "ms", "us", "min" or "h"; "": what the header says, else s
    units: str = ""  # of the output, one of `OUTPUT_UNITS`; "": what the header says, else counts
    interval_s: float | None = None  # between two outputs; needed where there is no column of the time
    skip_bad_rows: int = 0  # how many rows that cannot be read are left out, named in the losses


@dataclass(frozen=True, eq=False)
class GyroLog:
    """A log as it was read."""

    begin_s: float  # time of the first row by the file's own column; 0 without one
    outputs: dict[str, Floats]  # columns with an output: "counts", "counts_x",
    unit: str  # of all outputs, one of `OUTPUT_UNITS`
    each: int  # rows of the file in one output: more than one where it is too long to be held row by row
    rest: Recording  # times, further columns and gaps; its counts are the first output's

    def recording(self, axis: str = "", *, counts_per_dps: float | None = None) -> Recording:
        """Return the output of one axis as a recording.

        Parameters
        ----------
        axis : str
            Which, where the log holds several; the others become further columns of the recording.
        counts_per_dps : float, optional
            Turns an output that is a rate or an angle into counts.

        Raises
        ------
        FileFormatError
            There is no output of this axis, or it is not in counts and nobody says what a count is.
        """
        scale = 1.0
        if self.unit != COUNTS:
            if counts_per_dps is None:
                raise FileFormatError(f"the output is in {self.unit}: say how many counts 1 deg/s is")
            scale = counts_per_unit(self.unit, self.rest.interval_s / self.each, counts_per_dps)  # of a row
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
        with open_plain_file(file) as plain:
            start = plain.read(2)
            plain.seek(0)
            encoding = "utf-16" if start in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
            with gzip.open(plain) if start == b"\x1f\x8b" else nullcontext(plain) as stream:
                text = io.TextIOWrapper(stream, encoding=encoding, errors="replace")
                return _read(text, choices or LogChoices())
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise FileFormatError(f"{file}: is compressed and cannot be unpacked to its end ({error})") from None
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
    skip_bad_rows: int = 0,
    axis: str = "",
    counts_per_dps: float | None = None,
) -> Recording:
    """Read a log of one gyro, or one axis of it, as a recording."""
    log = read_log(path, LogChoices(columns, time_unit or "", units or "", interval_s, skip_bad_rows))
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

    names, table = read_table(text, names_of, choices.skip_bad_rows, choices.interval_s)
    columns = {name: table.values[:, place].copy() for place, name in enumerate(one for one in names if one)}
    unit_of = {name: unit for name, unit in zip(names, units, strict=True) if name}
    outputs = {name: columns.pop(name) for name in list(columns) if is_output(name)}
    unit = _output_unit(outputs, unit_of, choices.units)
    if table.each == 1:
        _check_words(outputs, table.lines)
    if (unit_of_angle := unit_of.get(TABLE_ANGLE, "")) not in ("", "deg", "degree", "degrees", "°"):
        raise FileFormatError(f"the angle of the table must be in deg, not in {unit_of_angle!r}")
    if TEMPERATURE in columns:
        if (unit_of_t := unit_of[TEMPERATURE]) not in TEMPERATURE_UNITS:
            raise FileFormatError(f"the unit of the temperature must be degC, K or degF, not {unit_of_t!r}")
        zero, each = TEMPERATURE_UNITS[unit_of_t]
        columns[TEMPERATURE] = (columns[TEMPERATURE] - zero) / each
    if TIME in columns:
        usual = float(np.median(np.abs(columns[TIME])))
        since_1970 = "s" if usual < 1e11 else "ms" if usual < 1e14 else "us"  # 1e11 s are 3000 years
        seconds = seconds_of(choices.time_unit or unit_of[TIME] or since_1970)
        columns[TIME] = columns[TIME] * seconds
        kept = _in_order(columns[TIME], table, choices.skip_bad_rows, counted=COUNTER in columns)
        table = replace(table, values=table.values[kept], lines=table.lines[kept])
        columns, outputs = ({name: one[kept] for name, one in each.items()} for each in (columns, outputs))
    counter, status, times = (columns.pop(name, None) for name in (COUNTER, STATUS, TIME))
    for name, words in ((COUNTER, counter), (STATUS, status)):
        if words is not None and (large := np.abs(words) > 2.0**53).any():
            raise FileFormatError(f"line {table.lines[large.argmax()]}: the {name} is {words[large.argmax()]:g}")
    stated = choices.interval_s and choices.interval_s * table.each
    clock, kind = _clock(times, counter, table, stated)
    set_at, doubts = None if kind != "time column" or times is None else step_of_clock(times, clock), list[str]()
    while times is not None and set_at is not None and len(doubts) < _MOST_SET:
        row, by = set_at
        doubts.append(
            f"before line {table.lines[row]} the clock of its stamps was set, by {by:+.3g} s and whole rows"
        )
        times[row:] -= by
        clock, _ = _clock(times, counter, table, stated)
        set_at = step_of_clock(times, clock)
    steps = np.diff(clock.places)
    gaps = tuple(
        Gap(
            int(after),
            float((clock.places[after] + 1) * clock.interval_s),
            float((steps[after] - 1) * clock.interval_s),
            int(steps[after]) - 1,
            "rows missing",
        )
        for after in np.flatnonzero(steps > 1)
    )
    missing, bad = sum(gap.missing for gap in gaps), Counter(table.bad)
    rest = Recording(
        times=np.asarray(clock.interval_s * clock.places if clock.regular or times is None else times - times[0]),
        counts=next(iter(outputs.values())),
        temperature=columns.pop(TEMPERATURE, None),
        status=None if status is None else status.astype(np.int64),
        extra=columns,
        gaps=gaps,
        losses=Losses(
            good=len(table.lines), missing=missing + table.put_in, unusable=bad.total(), reasons=dict(bad)
        ),
        interval_s=clock.interval_s,
        clock=kind,
        doubts=tuple(doubts),
    )
    return GyroLog(0.0 if times is None else float(times[0]), outputs, unit, table.each, rest)


# ---------------------------------------------------------------------- columns


def _names(dialect: Dialect, choices: LogChoices) -> tuple[list[str], list[str]]:
    """Names of the columns and the units that they come with."""
    header = named_columns(dialect.header) if dialect.header is not None else None
    if choices.columns is not None:
        names, units = named_columns(choices.columns)
        if header is not None and len(names) == len(header[0]):
            units = [own or theirs for own, theirs in zip(units, header[1], strict=True)]
    elif header is not None:
        names, units = header
        names = [
            "" if nothing and name != TIME and not is_output(name) else name
            for name, nothing in zip(names, dialect.is_empty, strict=True)
        ]
    else:
        dated = dialect.dated and len(dialect.is_empty) > 1
        names = (
            [DATE, *default_names(len(dialect.is_empty) - 1)] if dated else default_names(len(dialect.is_empty))
        )
        units = [""] * len(dialect.is_empty)
    _check_names(names, choices)
    return ["" if name == DATE and TIME not in names else name for name in names], units


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


def _check_words(outputs: dict[str, Floats], lines: NDArray[np.int64]) -> None:
    """FileFormatError where signed words were written as unsigned: negative ones stand at the other end, often."""
    for words in outputs.values():
        for bits in _WORDS:
            highest = float(words.max(initial=0.0))
            if words.min(initial=0.0) < 0 or highest >= 2.0**bits or highest < 0.9 * 2.0**bits:
                continue
            jumps = np.flatnonzero(np.abs(np.diff(words)) > 0.9 * 2.0**bits)
            if jumps.size > 2 and not np.any((words > 0.1 * 2.0**bits) & (words < 0.9 * 2.0**bits)):
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
    unit = units.pop()
    if unit in ANGLE_UNITS and not any(unit_of[name].endswith(EACH) for name in outputs):
        raise FileFormatError(
            f"the unit of the output is {unit}: if that is the angle since the output before, say so with the "
            f"option or setting units ({unit}); an angle since the begin is no output of a rate gyro"
        )
    return unit


# ---------------------------------------------------------------------- time


def _clock(
    times: Floats | None, counter: Floats | None, table: LogTable, interval_s: float | None
) -> tuple[LogClock, str]:
    """Place of every row, and what that rests on."""
    steps = np.diff(times - times[0]) if times is not None else np.zeros(0)
    if times is not None and steps.size and not 0 < steps.sum() < 1e9:
        raise FileFormatError(f"the time goes from {times[0]:.9g} s to {times[-1]:.9g} s: is it the right column?")
    if steps.size and steps.sum() > np.median(steps[steps > 0]) * (100 * steps.size + 1e6):
        raise FileFormatError(
            f"line {table.lines[steps.argmax() + 1]}: the time goes on by {steps.max():.6g} s at once, as in no "
            "log; correct or remove the line, or part the log there"
        )
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
        if early.size > 0.8 * (times.size - 1):
            raise FileFormatError(
                f"line {table.lines[early[0] + 1]}: the rows do not come every {interval_s:.6g} s; give the "
                "interval of the output as interval_s, or correct the time column"
            )
    return find_clock(times - times[0], interval_s), "time column"


def _in_order(times: Floats, table: LogTable, skip: int, *, counted: bool) -> NDArray[np.bool_]:
    """Which rows stay so that time goes on; a clock that was set back is set on again, in `times` itself."""
    kept = np.ones(times.size, dtype=bool)
    while True:
        rows = np.flatnonzero(kept)
        at = _wrong_row(times[rows], table.values[rows], counted)
        if at is None:
            return kept
        row, before = rows[at + 1], rows[at]
        _leave_out(
            table.bad,
            skip,
            f"line {table.lines[row]}: {times[row]:.9g} s comes after {times[before]:.9g} s",
            "rows are doubled, out of order, or two runs stand in one file",
        )
        steps = np.diff(times[rows])
        usual = np.median(steps[steps > 0]) if np.any(steps > 0) else 0.0
        if at and steps[at - 1] > 10 * usual and times[row] > times[rows[at - 1]]:
            kept[before] = False  # it is the one before that leaps
        elif not usual or steps[at] == 0 or at + 2 >= rows.size or times[rows[at + 2]] > times[before]:
            kept[row] = False
        else:
            times[row:] += times[before] - times[row] + usual


def _wrong_row(times: Floats, values: Floats, counted: bool) -> int | None:
    """The row before the first that does not come later than it."""
    steps = np.diff(times)
    wrong = np.flatnonzero(steps < 0)
    if not wrong.size:
        doubled = np.flatnonzero(steps == 0)
        wrong = doubled if not counted and 0 < doubled.size <= _DOUBLED * steps.size + 1 else wrong
        # rows with one time stamp are coarse stamps where their outputs differ, and doubled where nothing does
        equal = np.sum(values[1:] == values[:-1], axis=1) + (steps > 0) == values.shape[1]
        others = np.count_nonzero(equal) - np.count_nonzero(equal[doubled])
        often = 2 * np.count_nonzero(equal[doubled]) > doubled.size and 2 * others < steps.size - doubled.size
        if doubled.size and (doubled.size == steps.size or often):
            wrong = doubled
    return int(wrong[0]) if wrong.size else None


def _leave_out(bad: list[str], skip: int, said: str, remedy: str) -> None:
    """Note a row that is left out; FileFormatError where no more of them may be."""
    if len(bad) < skip:
        bad.append(said)
        return
    more = f"after {skip} that were left out, " if skip else ""
    raise FileFormatError(
        f"{more}{said}; {remedy}, or leave such rows out with the option or setting skip_bad_rows"
    )


def _counted(counter: Floats, table: LogTable) -> Places:
    try:
        return clock_of_counter(counter)
    except ValueError as error:
        raise FileFormatError(
            f"line {table.lines[int(str(error))]}: the counter stands still; rows are doubled"
        ) from None


# --------------------
# The rows of a log, read block by block, so that a file of hours needs the memory of its numbers alone


_COMMENTS = ("#", "%", "!", "//")
_BLOCK = 1 << 21  # characters read at once
_SAMPLE = 400  # lines that tell the separator
MOST_ROWS = 2_000_000  # that are held
_EVEN = 1024
_SHORT_PAUSE = 64  # rows in a row that are put in
_NEAR = 5000  # rows on either side that say about what: so many that their own noise is not counted twice


@dataclass(frozen=True)
class Dialect:
    """How the numbers of a file are written."""

    separator: str | None  # none for any number of blanks
    decimal_comma: bool
    header: list[str] | None  # cells of the line above the numbers that has as many columns, with their units
    first_line: int  # line of the first row
    is_empty: list[bool]  # of each column, whether nothing stands there
    dated: bool  # whether the first row begins with a date alone, and whether it has a clock time
    clock: bool


@dataclass(frozen=True)
class LogTable:
    """Numbers of the columns that are wanted, with the line that each row stands on."""

    values: Floats
    lines: NDArray[np.int64]
    bad: list[str]  # rows that were left out: line, and what is wrong with it
    each: int = 1  # rows of the file whose mean is one row here
    put_in: int = 0  # rows that were missing in those means


Names = Callable[[Dialect], list[str]]  # gives each column its name, "" to leave it out


def read_table(
    text: IO[str], names_of: Names, skip: int = 0, interval_s: float | None = None
) -> tuple[list[str], LogTable]:
    """Read all rows; a column of dates beside that of clock times goes into it."""
    blocks = _blocks(text)
    first = next(blocks, None)
    if first is None:
        raise FileFormatError("there is not one row of numbers; is it the right file?")
    dialect = _dialect(first[1])
    names = names_of(dialect)
    rows, bad = _Rows([name for name in names if name not in ("", DATE)], interval_s), list[str]()
    days: dict[str, int] = {}
    for begin, block in itertools.chain([first], blocks):
        numbered = [
            (number, line)
            for number, line in enumerate((one.strip() for one in block), start=begin)
            if line and number >= dialect.first_line and not line.startswith(_COMMENTS)
        ]
        if numbered:
            numbers, kept = _numbers(numbered, dialect, names, days, bad, skip)
            rows.add(numbers, np.array(kept, dtype=np.int64), clock_only=list(days) == [""])
    values, lines = rows.all()
    if not values.size:
        raise FileFormatError(f"no row can be read: {bad[0]}")
    if days:
        at = sum(name not in ("", DATE) for name in names[: names.index(TIME)])
        values[:, at] = _since_2000(values[:, at], list(days))
    table = LogTable(values, lines, bad, rows.each, rows.put_in)
    return ["" if name == DATE else name for name in names], table


class _Rows:
    """Rows as they come; where they are more than memory should hold, means of two, of four, .. of them."""

    # A mean of rows is what the gyro itself would have sent at a lower rate: no noise model changes. Rows that are
    # missing are put in as their neighbours are and as they scatter; a pause stays one.

    def __init__(self, names: list[str], interval_s: float | None) -> None:
        self.each, self.put_in, self._clock_only = 1, 0, False
        self._names, self._interval_s = names, interval_s
        self._outputs = [place for place, name in enumerate(names) if is_output(name)]
        self._fresh: list[tuple[Floats, NDArray[np.int64]]] = []
        # held in one piece, since many that come and go would leave holes in the memory
        self._means, self._lines, self._count = np.empty((0, len(names))), np.empty(0, dtype=np.int64), 0
        self._left = np.empty((0, len(names))), np.empty(0, dtype=np.int64)  # too few for a mean
        self._last: tuple[Floats, NDArray[np.int64]] | None = None  # row, by which the next ones are placed
        self._counted = 0
        self._rng = np.random.default_rng(0)

    def add(self, values: Floats, lines: NDArray[np.int64], *, clock_only: bool) -> None:
        """Take the next rows."""
        self._fresh.append((values, lines))
        most = MOST_ROWS if self.each == 1 else MOST_ROWS // 2
        self._clock_only = clock_only
        if sum(rows.size for _, rows in self._fresh) > most and TABLE_ANGLE not in self._names:
            self._shorten(_EVEN)

    def all(self) -> tuple[Floats, NDArray[np.int64]]:
        """Return all rows; of means those that are whole."""
        if self.each > 1:
            self._shorten(1)
            values, lines = self._means[: self._count], self._lines[: self._count]
        else:
            values, lines = map(np.concatenate, zip(*self._fresh, strict=True))
        there = np.isfinite(values).all(axis=1)
        return values[there], lines[there]

    def _shorten(self, even: int) -> None:
        parts = [self._left]
        if self._fresh:
            parts.append(self._with_missing_rows(*map(np.concatenate, zip(*self._fresh, strict=True))))
        values, lines = map(np.concatenate, zip(*parts, strict=True))
        self.each = max(self.each, 2)
        count = lines.size // (even * self.each) * even * self.each  # the number of means can be halved often
        self._left, self._fresh = (values[count:].copy(), lines[count:].copy()), []
        self._keep(self._count, values[:count], lines[:count], self.each)
        while self._count > MOST_ROWS:
            self.each *= 2
            whole = self._count // 2 * 2
            self._keep(0, self._means[:whole], self._lines[:whole], 2)

    def _keep(self, at: int, values: Floats, lines: NDArray[np.int64], number: int) -> None:
        """Hold the means of so many rows each from a place on."""
        parts = values.reshape(-1, number, values.shape[1])
        means = parts.mean(axis=1)
        for place, name in enumerate(self._names):
            if name in (COUNTER, STATUS):
                means[:, place] = parts[:, 0, place] if name == COUNTER else parts[:, :, place].max(axis=1)
        self._count = at + len(means)
        if (short := self._count - self._lines.size) > 0:
            more = short + 2 * MOST_ROWS
            self._means = np.concatenate([self._means, np.empty((more, len(self._names)))])
            self._lines = np.concatenate([self._lines, np.empty(more, dtype=np.int64)])
        self._means[at : self._count], self._lines[at : self._count] = means, lines[::number].copy()

    def _with_missing_rows(self, values: Floats, lines: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
        """Rows at equal intervals behind those before; nan in a pause."""
        _check_words({self._names[at]: values[:, at] for at in self._outputs}, lines)
        if self._last is not None:
            values, lines = np.concatenate([self._last[0], values]), np.concatenate([self._last[1], lines])
        begun, self._last = self._last is not None, (values[-1:].copy(), lines[-1:])
        places = np.arange(lines.size)
        if COUNTER in self._names:
            places = clock_of_counter(values[:, self._names.index(COUNTER)])
        elif TIME in self._names:
            times = values[:, self._names.index(TIME)]
            if self._clock_only:
                times += 86400.0 * np.concatenate([[0], np.cumsum(np.diff(times) < -43200.0)])
            if np.any(np.diff(times) < 0):
                at = lines[int(np.argmax(np.diff(times) < 0)) + 1]
                raise FileFormatError(
                    f"line {at}: the time goes back; in a log so long it must not: part it there"
                )
            places = find_clock(times - times[0], self._interval_s).places
        steps = np.diff(places)
        if steps.sum() > 2 * lines.size:
            at = lines[int(np.argmax(steps)) + 1]
            raise FileFormatError(f"line {at}: more time without rows than with them: part the log there")
        whole = np.full((int(places[-1]) + 1, values.shape[1]), np.nan)
        whole[places] = values
        row = np.searchsorted(places, np.arange(len(whole)), side="right") - 1  # the one before
        at = np.flatnonzero(np.isnan(whole[:, 0]) & (np.concatenate([steps, [1]])[row] <= _SHORT_PAUSE))
        self.put_in += at.size
        for place, name in enumerate(self._names):
            level = values[:, place]
            whole[at, place] = np.interp(at, places, level)
            if name == COUNTER:
                whole[:, place] = self._counted + np.arange(len(whole))
                self._counted += len(whole) - 1
            elif place in self._outputs:
                scatter = float(np.median(np.abs(np.diff(level)))) / 0.954
                total = np.concatenate([[0.0], np.cumsum(level - level[0])])
                first, last = np.maximum(row[at] - _NEAR, 0), np.minimum(row[at] + _NEAR, level.size)
                near = level[0] + (total[last] - total[first]) / (last - first)
                whole[at, place] = near + scatter * self._rng.standard_normal(at.size)
        return whole[begun:], lines[row][begun:]


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
    for place, (number, line) in enumerate(lines):
        cells = split_row(line, separator)
        numeric = [_is_number(cell, comma) for cell in cells]
        dated = _DATE.fullmatch(cells[0]) is not None
        if len(cells) == width and (numeric[0] or dated or 2 * sum(numeric) > width):
            rows = [split_row(other, separator) for _, other in lines[place : place + _SAMPLE]]
            columns = zip(*(row for row in rows if len(row) == width), strict=True)
            is_empty = [not any(cells) for cells in columns]
            decimal_comma = comma and any("," in other for _, other in lines[place:])
            clock = any(":" in cell for cell in cells)
            return Dialect(separator, decimal_comma, header, number, is_empty, dated, clock)
        if len(cells) != width and any(numeric) and all(numeric):
            return Dialect(separator, False, header, number, [False] * width, False, False)
        if len(cells) == width:
            units = [cell.strip("[]() ") for cell in cells]
            if header is not None and any(units) and all(map(is_unit, units)):
                header = [f"{name} [{unit}]" for name, unit in zip(header, units, strict=True)]
            else:
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
        _value(cell, decimal_comma, {} if ":" in cell else None)
    except ValueError:
        return False
    return True


def _value(cell: str, decimal_comma: bool, days: dict[str, int] | None) -> float:
    """A number, or where `days` are given a clock time."""
    plain = (cell.replace(",", ".") if decimal_comma else cell).replace("_", "?")  # Python reads 1_000
    return float(plain) if days is None else _clock_time(plain, days)


def _numbers(
    rows: list[tuple[int, str]],
    dialect: Dialect,
    names: list[str],
    days: dict[str, int],
    bad: list[str],
    skip: int,
) -> tuple[Floats, list[int]]:
    """Numbers of the wanted columns and their lines: by NumPy where they are plain, else cell by cell."""
    wanted = [place for place, name in enumerate(names) if name not in ("", DATE)]
    try:
        values = _plain_numbers([line for _, line in rows], dialect, names, wanted, days)
    except ValueError:
        values = np.empty((0, 0))
    if values.shape == (len(rows), len(wanted)) and np.all(np.abs(values) < _LARGEST):
        return values, [line for line, _ in rows]
    table, kept = np.empty((len(rows), len(wanted))), list[int]()
    for line, row in rows:
        cells = split_row(row, dialect.separator)
        if len(cells) != len(names):
            said = f"line {line} has {len(cells)} columns where {len(names)} ({', '.join(names)}) are expected"
            _leave_out(bad, skip, said, "correct or remove it")
            continue
        if DATE in names and dialect.clock:
            cells[names.index(TIME)] = f"{cells[names.index(DATE)]} {cells[names.index(TIME)]}"
        try:
            for column, place in enumerate(wanted):
                its_days = days if dialect.clock and names[place] == TIME else None
                table[len(kept), column] = _value(cells[place], dialect.decimal_comma, its_days)
                if not abs(table[len(kept), column]) < _LARGEST:
                    raise ValueError
        except ValueError:
            said = f"line {line}: the {names[place]} is {cells[place][:40]!r}, no number"
            more = "leave the column out with the option or setting columns"
            _leave_out(bad, skip, said, f"correct or remove the line, {more}")
            continue
        kept.append(line)
    return table[: len(kept)], kept


def _plain_numbers(
    lines: list[str], dialect: Dialect, names: list[str], wanted: list[int], days: dict[str, int]
) -> Floats:
    """Numbers of the wanted columns where all rows are written alike; ValueError or another shape where not."""
    text = "\n".join(lines).replace('"', "")
    if dialect.decimal_comma:
        text = text.replace(",", ".")
    separator = dialect.separator
    if "#" in text or (separator and any(line.count(separator) != len(names) - 1 for line in lines)):
        raise ValueError
    if not dialect.clock:
        columns = wanted if len(wanted) < len(names) else None
        return np.loadtxt(io.StringIO(text), delimiter=separator, ndmin=2, comments=None, usecols=columns)
    cells = list(zip(*(line.split(separator) for line in text.split("\n")), strict=True))
    if len(cells) != len(names):
        raise ValueError
    if DATE in names:
        at = names.index(TIME)
        cells[at] = tuple(map(" ".join, zip(cells[names.index(DATE)], cells[at], strict=True)))
    return np.stack(
        [
            _clock_times(cells[at], days) if names[at] == TIME else np.array(cells[at], dtype=float)
            for at in wanted
        ],
        axis=1,
    )


# Clock times such as 12:30:01.25, or with a date; which day it was is told from all dates of the file.

_DATE = re.compile(r"(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})")
_PADDED = re.compile(r"[0-9]{2}:[0-9]{2}(:[0-9]{2}(\.[0-9]+)?)?")
_CLOCK = re.compile(r"([01]?[0-9]|2[0-3]):([0-5]?[0-9])(?::([0-5]?[0-9](?:\.[0-9]*)?))?(?:Z|[+-]\d\d:?\d\d)?")


def _clock_time(cell: str, days: dict[str, int]) -> float:
    """Seconds of a clock time, with the place of its date among `days` as whole days; or ValueError."""
    date, _, clock = cell.replace("T", " ").rpartition(" ")
    found = _CLOCK.fullmatch(clock)
    if found is None or (date and not _DATE.fullmatch(date)):
        raise ValueError(cell)
    seconds = 3600.0 * int(found[1]) + 60.0 * int(found[2]) + float(found[3] or 0)
    return 86400.0 * days.setdefault(date, len(days)) + seconds


def _clock_times(cells: Sequence[str], days: dict[str, int]) -> Floats:
    """The same of many that are written alike; ValueError where one is not."""
    dates, _, clocks = zip(*(cell.strip().replace("T", " ").rpartition(" ") for cell in cells), strict=True)
    if not all(map(_PADDED.fullmatch, clocks)) or not all(map(_DATE.fullmatch, filter(None, set(dates)))):
        raise ValueError
    clock = np.array([f"2000-01-01T{clock}" for clock in clocks], dtype="datetime64[ns]")
    day = np.array([days.setdefault(date, len(days)) for date in dates])
    return 86400.0 * day + (clock - np.datetime64("2000-01-01", "ns")).astype(np.float64) / 1e9


def _since_2000(numbered: Floats, dates: list[str]) -> Floats:
    """Seconds since 2000 by date and clock; without dates it is a new day where the clock goes back to 0."""
    day, clock = np.divmod(numbered, 86400.0)
    if dates == [""]:
        return numbered + 86400.0 * np.concatenate([[0], np.cumsum(np.diff(numbered) < -43200.0)])
    # 03/04 may be a day in March or in April: a log goes on, so it is the order in which its days lie together
    orders = [days for order in ("ymd", "mdy", "dmy") if (days := _days(dates, order)) is not None]
    if not orders:
        raise FileFormatError(f"{dates[0]!r} and the dates below are none that can be read: write 2026-03-31")
    return 86400.0 * np.array(min(orders, key=np.ptp))[day.astype(np.int64)] + clock


def _days(dates: list[str], order: str) -> list[int] | None:
    """Days since 2000 of dates in one order; None where one of them cannot be."""
    found = []
    for date in dates:
        parts = _DATE.fullmatch(date)
        if parts is None or (len(parts[1]) == 4) != (order == "ymd") or ("." in date and order == "mdy"):
            return None
        of = dict(zip(order, map(int, parts.groups()), strict=True))
        try:
            found.append((datetime.date(of["y"], of["m"], of["d"]) - datetime.date(2000, 1, 1)).days)
        except ValueError:
            return None
    return found


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
