"""The rows of a log, read block by block, so that a file of hours needs the memory of its numbers alone."""

from __future__ import annotations

import datetime
import io
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray

from instrument.errors import FileFormatError
from instrument.fibre_gyro.recording import Floats

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
class Table:
    """Numbers of the columns that are wanted, with the line that each row stands on."""

    values: Floats
    lines: NDArray[np.int64]


Names = Callable[[Dialect], list[str]]
"""Gives each column its name, "" to leave it out."""


def read_table(text: IO[str], names_of: Names) -> tuple[Dialect, list[str], Table]:
    """Read all rows."""
    blocks = _blocks(text)
    first = next(blocks, None)
    if first is None:
        raise FileFormatError("there is not one row of numbers; is it the right file?")
    dialect = _dialect(first[1])
    names = names_of(dialect)
    parts, lines = [], []
    for begin, block in _chain(first, blocks):
        numbered = [
            (number, line)
            for number, line in enumerate((one.strip() for one in block), start=begin)
            if line and number >= dialect.first_line and not line.startswith(_COMMENTS)
        ]
        if numbered:
            parts.append(_numbers(numbered, dialect, names))
            lines.append(np.array([number for number, _ in numbered], dtype=np.int64))
    return dialect, names, Table(np.concatenate(parts), np.concatenate(lines))


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


def _chain(first: tuple[int, list[str]], rest: Iterator[tuple[int, list[str]]]) -> Iterator[tuple[int, list[str]]]:
    yield first
    yield from rest


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
