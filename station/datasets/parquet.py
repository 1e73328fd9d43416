"""Parquet: codes as bytes of one length, flat columns, row groups of about 2000 records.

Source: the format's own rules for fixed_len_byte_array and key-value metadata (parquet.apache.org/docs).
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from station.datasets.outputs import OUTPUTS, Floats
from station.datasets.packages import package
from station.datasets.rows import AT_ONCE, COLUMNS, NUMBERS, SCHEMA, WHOLE, Rows, check_schema
from station.errors import RunError, StationError, UsageError

_METADATA = b"gyrolock"
_CODED_ALIKE = ("source", "purpose", "channel", "axis", "header", "source_json")  # texts that most rows share

_READ = ("number", "key", "taken_at", "purpose", "header", "conditions", "sha256", "codes", "payload")


class ParquetWriter:
    """Writes one file."""

    def __init__(self, file: Any, width: int) -> None:
        pyarrow, parquet = package("pyarrow"), package("pyarrow.parquet")
        self._width, self._pyarrow = width, pyarrow
        kinds = {**dict.fromkeys(WHOLE, pyarrow.int64()), **dict.fromkeys(NUMBERS, pyarrow.float64())}
        fields = [pyarrow.field(name, kinds.get(name, pyarrow.string())) for name in COLUMNS]
        fields += [pyarrow.field("codes", pyarrow.binary(width)), pyarrow.field("payload", pyarrow.binary())]
        fields += [pyarrow.field(name, pyarrow.list_(pyarrow.float64())) for name in OUTPUTS]
        self._schema = pyarrow.schema(fields, {_METADATA: json.dumps({"schema": SCHEMA}).encode()})
        self._writer = parquet.ParquetWriter(
            file, self._schema, compression="zstd", compression_level=1, use_dictionary=list(_CODED_ALIKE)
        )

    def write(self, rows: Rows) -> None:
        """Add rows as one row group."""
        pyarrow = self._pyarrow
        codes, others = rows.codes(self._width)
        arrays = [
            pyarrow.array(rows.columns[field.name], field.type, from_pandas=True) for field in self._schema
            if field.name in COLUMNS
        ]  # fmt: skip
        mask = pyarrow.array(~others).buffers()[1]
        buffers = [mask, pyarrow.py_buffer(codes)]
        arrays.append(pyarrow.Array.from_buffers(pyarrow.binary(self._width), len(rows), buffers))
        payloads = [payload if other else None for payload, other in zip(rows.payloads, others, strict=True)]
        arrays.append(pyarrow.array(payloads, pyarrow.binary()))
        arrays += [self._lists(rows, name) for name in OUTPUTS]
        self._writer.write_table(pyarrow.Table.from_arrays(arrays, schema=self._schema), row_group_size=AT_ONCE)

    def _lists(self, rows: Rows, name: str) -> Any:
        """One column of the outputs; null where a row holds no output."""
        pyarrow = self._pyarrow
        parts = [None if output is None else output[name] for output in rows.outputs]
        if not any(parts_there := [part is not None for part in parts]):
            return pyarrow.nulls(len(rows), pyarrow.list_(pyarrow.float64()))
        ends = np.cumsum([0, *(0 if part is None else part.size for part in parts)]).astype(np.int32)
        values = np.concatenate([np.empty(0), *(part for part in parts if part is not None)])
        known = pyarrow.array(parts_there).buffers()[1]
        return pyarrow.Array.from_buffers(
            pyarrow.list_(pyarrow.float64()),
            len(rows),
            [known, pyarrow.py_buffer(ends)],
            children=[pyarrow.array(values)],
        )

    def close(self) -> None:
        """Write the end of the file: without it nobody can read it."""
        self._writer.close()


class ParquetTable:
    """Reads one file; path or URL."""

    def __init__(self, place: str) -> None:
        self.place = place
        self._kept: dict[int, Any] = {}
        with self._said(), _opened(place) as file:
            metadata = file.schema_arrow.metadata or {}
            groups = [file.metadata.row_group(one) for one in range(file.num_row_groups)]
            self._sizes = [group.num_rows for group in groups]
            at = file.schema_arrow.names.index(_READ[0]) if _READ[0] in file.schema_arrow.names else 0
            self._numbers = [_least_and_most(group.column(at).statistics) for group in groups]
            names = set(file.schema_arrow.names)
            self._outputs = [name for name in OUTPUTS if name in names]
        found = metadata.get(_METADATA)
        with self._said():
            check_schema(json.loads(found)["schema"] if found else None, place)
        if lost := [name for name in (*COLUMNS, "codes", "payload") if name not in names]:
            raise RunError(f"{place}: the column {lost[0]!r} is not in it: export the records again")

    def heads(self) -> Iterator[tuple[str, int]]:
        """Yield what is known of the source of each row, equal ones as one object, and its number there."""
        with self._said(), _opened(self.place) as file:
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, columns=["source_json", "number"], use_threads=False)
                coded = table.column("source_json").combine_chunks().dictionary_encode()
                texts = coded.dictionary.to_pylist()
                numbers = table.column("number").to_pylist()
                for code, number in zip(coded.indices.to_pylist(), numbers, strict=True):
                    yield texts[code], number

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Yield rows from `first` up to, but not, `last`: what stands in the columns, and the bytes sent.

        With `numbers` row groups in which none of these records can be are not read.
        """
        start = 0
        for group, size in enumerate(self._sizes):
            below, above = max(first - start, 0), min(last - start, size)
            least, most = self._numbers[group]
            if below < above and (numbers is None or (least < numbers.stop and most >= numbers.start)):
                with self._said():
                    table = self._row_group(group)
                    columns = [table.column(name).slice(below, above - below).to_pylist() for name in _READ]
                    outputs = _outputs_of(table.slice(below, above - below), self._outputs)
                for place, (*cells, codes, payload) in enumerate(zip(*columns, strict=True)):
                    row = dict(zip(_READ, cells, strict=False))
                    if outputs and outputs[place] is not None:
                        row["outputs"] = outputs[place]
                    yield row, payload or b"" if codes is None else codes
            start += size

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to read the same file, wherever it runs."""
        place = self.place if is_url(self.place) else os.path.abspath(self.place)
        return {**vars(self), "place": place, "_kept": {}}

    def _row_group(self, group: int) -> Any:
        """One row group; small sources one behind the other share it."""
        if group not in self._kept:
            with _opened(self.place) as file:
                read = [*_READ, *self._outputs]
                self._kept = {group: file.read_row_group(group, columns=read, use_threads=False)}
        return self._kept[group]

    @contextmanager
    def _said(self) -> Iterator[None]:
        """Say what is wrong with a file in one line."""
        pyarrow = package("pyarrow")
        damage = (pyarrow.ArrowException, OSError, ValueError, KeyError, TypeError)
        try:
            yield
        except StationError:
            raise
        except FileNotFoundError:
            raise RunError(f"{self.place}: there is no such file") from None
        except Exception as error:
            reason = str(error).split("\n", maxsplit=1)[0].strip() or type(error).__name__
            if is_url(self.place) and not isinstance(error, pyarrow.ArrowException):
                # each store has errors of its own: no rights, no credentials, no network
                raise RunError(f"{self.place}: the store does not give it ({reason})") from None
            if not isinstance(error, damage) or getattr(error, "errno", None) is not None:
                raise
            raise RunError(
                f"{self.place}: is damaged or no Parquet file, and cannot be read ({reason}): export it again"
            ) from None


def _outputs_of(table: Any, names: list[str]) -> list[dict[str, Floats] | None]:
    """Outputs of each row, ``None`` where it holds none; an empty list where no row does."""
    if not names or table.column(names[0]).null_count == len(table):
        return []
    found: list[dict[str, Floats] | None] = [
        {} if there else None for there in table.column(names[0]).is_valid().to_pylist()
    ]
    for name in names:
        column = table.column(name).combine_chunks()
        for place, row in enumerate(found):
            if row is not None:
                row[name] = column[place].values.to_numpy(zero_copy_only=False)
    return found


def _least_and_most(statistics: Any) -> tuple[float, float]:
    """Smallest and largest value of a column of a row group; anything where the file does not say."""
    if statistics is None or not statistics.has_min_max:
        return -math.inf, math.inf
    return statistics.min, statistics.max


def is_url(place: str) -> bool:
    """Whether a data set lies in an object store: a name such as ``s3://bucket/records.parquet``."""
    return "://" in place


@contextmanager
def _opened(place: str) -> Iterator[Any]:
    parquet = package("pyarrow.parquet")
    with opened_bytes(place, "rb") as file, parquet.ParquetFile(file) as opened:
        yield opened


@contextmanager
def opened_bytes(place: str, mode: str) -> Iterator[Any]:
    """Open a file of this machine, or one of an object store by fsspec."""
    if not is_url(place):
        with Path(place).open(mode) as file:
            yield file
        return
    try:
        remote = package("fsspec", "cluster").open(place, mode)
    except (ValueError, ImportError) as error:
        raise UsageError(f"{place}: cannot be opened ({error})") from None
    with remote as file:
        yield file
