"""CSV: a row for each record, its codes in columns of their own behind what is known of it."""

from __future__ import annotations

import base64
import csv
import io
import math
import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from station.datasets.rows import COLUMNS, NUMBERS, SCHEMA, WHOLE, Rows, check_schema
from station.errors import RunError

_MARK = f"{SCHEMA['name']} {SCHEMA['version']}"
_FIRST = "schema"
_LONGEST_CELL = 1 << 28  # bytes; a whole recording of a gyro's output may stand in one
_NUMBERS = {str(code): code for code in range(-128, 128)}
_TEXTS = [str(code) for code in range(-128, 128)]


class CsvWriter:
    """Writes one file; arguments as for `ParquetWriter`.

    What is known of a source stands in the first of its rows only. What is no row of codes of the common length
    stands in the column ``payload`` (base64).
    """

    def __init__(self, file: Any, width: int) -> None:
        self._file, self._width = io.TextIOWrapper(file, encoding="utf-8", newline=""), width
        self._writer = csv.writer(self._file, lineterminator="\n")
        codes = (f"code_{place}" for place in range(width))
        self._writer.writerow([_FIRST, *COLUMNS, "payload", *codes])
        self._told = ""

    def write(self, rows: Rows) -> None:
        """Add rows."""
        codes, others = rows.codes(self._width)
        nothing = [""] * self._width
        levels = codes.astype(np.int16) + 128
        for place in range(len(rows)):
            cells = [_cell(rows.columns[name][place]) for name in COLUMNS]
            if cells[-1] == self._told:
                cells[-1] = ""
            else:
                self._told = cells[-1]
            if others[place]:
                payload, seen = base64.b64encode(rows.payloads[place]).decode(), nothing
            else:
                payload, seen = "", [_TEXTS[level] for level in levels[place].tolist()]
            self._writer.writerow([_MARK, *cells, payload, *seen])

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
            cells, rest = next(self._going)
            self._next += 1
            if self._next <= first:
                continue
            row: dict[str, Any] = {name: cells[name] for name in COLUMNS if name not in (*WHOLE, *NUMBERS)}
            try:
                row["number"] = int(cells["number"])
                payload = self._payload(rest)
            except (ValueError, KeyError) as error:
                raise self._damaged(f"row {self._next + 1}: {error}") from None
            yield row, payload

    def __getstate__(self) -> dict[str, str]:
        """What another process needs to read the same file."""
        return {"place": os.path.abspath(self.place)}

    def __setstate__(self, state: dict[str, str]) -> None:
        self.__init__(state["place"])  # type: ignore[misc]  # begins to read anew

    @staticmethod
    def _payload(rest: list[str]) -> bytes:
        payload, *codes = rest
        if payload or not codes or not codes[0]:
            return base64.b64decode(payload, validate=True)
        return np.array([_NUMBERS[code] for code in codes], np.int8).tobytes()

    def _lines(self) -> Iterator[tuple[dict[str, str], list[str]]]:
        """Cells by the names of `COLUMNS`, and payload and codes."""
        csv.field_size_limit(max(csv.field_size_limit(), _LONGEST_CELL))
        try:
            with open(self.place, encoding="utf-8-sig", newline="") as file:
                reader = csv.reader(file)
                names = next(reader, [])
                if names[: len(COLUMNS) + 2] != [_FIRST, *COLUMNS, "payload"]:
                    check_schema(_schema_of(next(reader, [""])[0]), self.place)
                    raise self._damaged("its columns are not those that were written")
                for number, line in enumerate(reader, start=2):
                    if not line:
                        continue
                    check_schema(_schema_of(line[0]), self.place)
                    if len(line) != len(names):
                        raise self._damaged(f"row {number} has {len(line)} of {len(names)} cells")
                    cells = dict(zip(COLUMNS, line[1 : len(COLUMNS) + 1], strict=True))
                    yield cells, line[len(COLUMNS) + 1 :]
        except (UnicodeDecodeError, csv.Error) as error:
            raise self._damaged(str(error)) from None

    def _damaged(self, reason: str) -> RunError:
        return RunError(f"{self.place}: is damaged and cannot be read ({reason}): export it again")


def _schema_of(mark: str) -> dict[str, Any] | None:
    name, _, version = mark.rpartition(" ")
    return {"name": name, "version": int(version)} if version.isdecimal() else None


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return str(value)
