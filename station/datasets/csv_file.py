"""CSV: a row for each record, its codes in columns of their own behind what is known of it."""

from __future__ import annotations

import base64
import csv
import io
import math
import os
from collections.abc import Iterator
from typing import IO, Any

import numpy as np

from station.datasets.outputs import OUTPUTS, Floats
from station.datasets.rows import COLUMNS, NUMBERS, SCHEMA, WHOLE, Rows, check_schema
from station.errors import RunError

_MARK = f"{SCHEMA['name']} {SCHEMA['version']}"
_FIRST = "schema"
_LONGEST_CELL = 1 << 28  # bytes; a whole recording of a gyro's output may stand in one
_TEXTS = [str(code) for code in range(-128, 128)]
_COMMA, _MINUS, _ZERO = b",-0"


class CsvWriter:
    """Writes one file; arguments as for `ParquetWriter`.

    What is known of a source stands in the first of its rows only. What is no row of codes of the common length
    stands in the column ``payload`` (base64); output of a fibre gyro in its own columns, a blank between numbers.
    """

    def __init__(self, file: Any, width: int) -> None:
        self._file, self._width = io.TextIOWrapper(file, encoding="utf-8", newline=""), width
        self._writer = csv.writer(self._file, lineterminator="\n")
        codes = (f"code_{place}" for place in range(width))
        self._writer.writerow([_FIRST, *COLUMNS, "payload", *OUTPUTS, *codes])
        self._told = ""

    def write(self, rows: Rows) -> None:
        """Add rows."""
        codes, others = rows.codes(self._width)
        nothing = "," * (self._width - 1)
        levels = codes.astype(np.int16) + 128
        for place, output in enumerate(rows.outputs):
            cells = [_cell(rows.columns[name][place]) for name in COLUMNS]
            if cells[-1] == self._told:
                cells[-1] = ""
            else:
                self._told = cells[-1]
            payload = base64.b64encode(rows.payloads[place]).decode() if others[place] else ""
            numbers = [""] * len(OUTPUTS) if output is None else [_numbers_cell(output[name]) for name in OUTPUTS]
            seen = nothing if others[place] else ",".join([_TEXTS[level] for level in levels[place].tolist()])
            head = io.StringIO()
            csv.writer(head, lineterminator="").writerow([_MARK, *cells, payload, *numbers])
            self._file.write(f"{head.getvalue()},{seen}\n")

    def close(self) -> None:
        """Write what is held back; the file below stays open."""
        self._file.flush()
        self._file.detach()


class CsvTable:
    """Reads one file; see `ParquetTable`. Rows that are asked for in their order are read in one go."""

    def __init__(self, place: str) -> None:
        self.place = place
        self._next, self._going = 0, self._lines()
        for _ in self._lines():
            return
        raise RunError(f"{place}: holds no record")

    def heads(self) -> Iterator[tuple[str, int]]:
        """Yield what is known of the source of each row, equal ones as one object, and its number there."""
        about = ""
        for row, (cells, _) in enumerate(self._lines()):
            about = cells["source_json"] or about
            try:
                yield about, int(cells["number"])
            except ValueError as error:
                raise self._damaged(f"row {row + 2}: {error}") from None

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Yield rows from `first` up to, but not, `last`; all of them, whatever `numbers` are wanted."""
        if first < self._next or first == 0:
            self._next, self._going = 0, self._lines()
        while self._next < last:
            cells, codes = next(self._going)
            self._next += 1
            if self._next <= first:
                continue
            row: dict[str, Any] = {name: cells[name] for name in _TOLD}
            try:
                row["number"] = int(cells["number"])
                if cells.get(OUTPUTS[0]):
                    row["outputs"] = {name: np.array(cells[name].split(), dtype=np.float64) for name in OUTPUTS}
                payload = codes_of(codes) if codes else base64.b64decode(cells["payload"], validate=True)
            except (ValueError, KeyError) as error:
                raise self._damaged(f"row {self._next + 1}: {error}") from None
            yield row, payload

    def __getstate__(self) -> dict[str, str]:
        """What another process needs to read the same file."""
        return {"place": os.path.abspath(self.place)}

    def __setstate__(self, state: dict[str, str]) -> None:
        self.__init__(state["place"])  # type: ignore[misc]  # begins to read anew

    def _lines(self) -> Iterator[tuple[dict[str, str], bytes]]:
        """Cells before the codes by their names, and the codes as they stand there; nothing for a row without."""
        csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))
        try:
            with open(self.place, "rb") as file:
                names = next(csv.reader([file.readline().removeprefix(b"\xef\xbb\xbf").decode()]), [])
                width = sum(name.startswith("code_") for name in names)
                head = names[: len(names) - width]
                if head not in ([_FIRST, *COLUMNS, "payload"], [_FIRST, *COLUMNS, "payload", *OUTPUTS]):
                    check_schema(_schema_of(_first_cell(file.readline())), self.place)
                    raise self._damaged("its columns are not those that were written")
                for number, line in enumerate(_whole_lines(file), start=2):
                    if not line.strip():
                        continue
                    check_schema(_schema_of(_first_cell(line)), self.place)
                    before, codes = _cut(line, width)
                    cells = next(csv.reader([before.decode()]), [])
                    if len(cells) != len(head):
                        raise self._damaged(f"row {number} has {len(cells)} of {len(head)} cells before its codes")
                    yield dict(zip(head, cells, strict=True)), codes.strip(b",")
        except (UnicodeDecodeError, csv.Error) as error:
            raise self._damaged(str(error)) from None

    def _damaged(self, reason: str) -> RunError:
        return RunError(f"{self.place}: is damaged and cannot be read ({reason}): export it again")


_TOLD = tuple(name for name in COLUMNS if name not in (*WHOLE, *NUMBERS))


def _whole_lines(file: IO[bytes]) -> Iterator[bytes]:
    """Lines, without their ends; one that ends within quotes goes on in the next."""
    held = b""
    for line in file:
        held += line
        if held.count(b'"') % 2 == 0:
            yield held.rstrip(b"\r\n")
            held = b""
    if held:
        yield held.rstrip(b"\r\n")


def _cut(line: bytes, width: int) -> tuple[bytes, bytes]:
    """What stands before the last `width` cells, none of which is quoted, and these cells."""
    begin = line.rfind(b'"') + 1
    at = begin - 1
    for _ in range(line.count(b",", begin) - width + 1):
        at = line.index(b",", at + 1)
    return (line[:at], line[at + 1 :]) if at >= begin else (line, b"")


def _first_cell(line: bytes) -> str:
    return line.partition(b",")[0].decode(errors="replace")


def codes_of(cells: bytes) -> bytes:
    """Return codes that stand as decimal numbers between commas, one signed byte each.

    They are taken apart all at once: one by one they would take as long as their estimates, ten times over.

    Examples
    --------
    >>> np.frombuffer(codes_of(b"-128,0,7,127"), np.int8).tolist()
    [-128, 0, 7, 127]
    """
    text = np.frombuffer(b"," + cells + b",", np.uint8)
    commas = np.flatnonzero(text == _COMMA)
    first, last = commas[:-1] + 1, commas[1:] - 1
    minus = text[first] == _MINUS
    digits = last - first + 1 - minus
    values = text.astype(np.int16) - _ZERO
    others = (values < 0) | (values > 9)
    others[commas] = others[first[minus]] = False
    if others.any() or digits.min() < 1 or digits.max() > 3:
        raise ValueError("a code is no number")
    ones, tens, hundreds = values[last], values[last - 1], values[last - 2]
    found = ones + np.where(digits > 1, 10 * tens, 0) + np.where(digits > 2, 100 * hundreds, 0)
    found = np.where(minus, -found, found)
    if found.min() < -128 or found.max() > 127 or (found[minus] == 0).any():
        raise ValueError("a code is no signed byte")
    if (values[first + minus] == 0)[digits > 1].any():
        raise ValueError("a code begins with 0")
    return bytes(found.astype(np.int8).tobytes())


def _schema_of(mark: str) -> dict[str, Any] | None:
    name, _, version = mark.rpartition(" ")
    return {"name": name, "version": int(version)} if version.isdecimal() else None


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return str(value)


def _numbers_cell(values: Floats) -> str:
    return " ".join(map(repr, values.tolist()))
