"""The files of a data set: CSV, HDF5, NumPy and Parquet, each a way to keep the one table."""

import base64
import csv
import io
import json
import math
import os
import shutil
import tempfile
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from station.datasets.rows import (
    AT_ONCE,
    COLUMNS,
    NUMBERS,
    OUTPUTS,
    SCHEMA,
    TEXT,
    WHOLE,
    Floats,
    Rows,
    check_schema,
    package,
    rows_with,
)
from station.errors import RunError, StationError, UsageError
from station.files import alive, inert
from station.results.numbers import SCALE_FACTOR


class Table(ABC):
    """A file of a data set."""

    def __init__(self, place: str) -> None:
        self.place = place

    @abstractmethod
    def heads(self) -> Iterator[tuple[str, int]]:
        """Yield what is known of the source of each row, equal ones as one object, and its number there."""

    @abstractmethod
    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Yield rows from `first` up to, but not, `last`: what stands in the columns, and the bytes sent.

        With `numbers` no more than are needed for these, where a file can leave others out.
        """

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to read the same file."""
        return {"place": os.path.abspath(self.place)}


# --------------------
# CSV: a row a record, its codes as decimal numbers


_MARK = f"{SCHEMA['name']} {SCHEMA['version']}"
_FIRST = "schema"
_LONGEST_CELL = 1 << 28  # bytes; a whole recording of a gyro's output may stand in one
_TEXTS = [str(code) for code in range(-128, 128)]
_COMMA, _MINUS, _ZERO = b",-0"


class CsvWriter:
    """Writes one file; arguments as for `ParquetWriter`."""

    # What is known of a source stands in the first of its rows only. What is no row of codes of the common length
    # stands in the column ``payload`` (base64); output of a fibre gyro in its own columns, a blank between
    # numbers.

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
            values = (rows.columns[name][place] for name in COLUMNS)
            cells = [repr(one).replace("nan", "") if isinstance(one, float) else inert(str(one)) for one in values]
            if cells[-1] == self._told:
                cells[-1] = ""
            else:
                self._told = cells[-1]
            payload = base64.b64encode(rows.payloads[place]).decode() if others[place] else ""
            numbers = (
                [""] * len(OUTPUTS)
                if output is None
                else [(" ".join(map(repr, output[name].tolist()))) for name in OUTPUTS]
            )
            seen = nothing if others[place] else ",".join([_TEXTS[level] for level in levels[place].tolist()])
            head = io.StringIO()
            csv.writer(head, lineterminator="").writerow([_MARK, *cells, payload, *numbers])
            self._file.write(f"{head.getvalue()},{seen}\n")

    def close(self) -> None:
        """Write what is held back; the file below stays open."""
        self._file.flush()
        self._file.detach()


class CsvTable(Table):
    """Reads one file. Rows that are asked for in their order are read in one go."""

    def __init__(self, place: str) -> None:
        super().__init__(place)
        self._next, self._going = 0, self._lines()
        for _ in self._lines():
            return
        raise RunError(f"{place}: holds no record")

    def heads(self) -> Iterator[tuple[str, int]]:
        """See `Table`."""
        about = ""
        for row, (cells, _) in enumerate(self._lines()):
            about = cells["source_json"] or about
            try:
                yield about, int(cells["number"])
            except ValueError as error:
                raise self._damaged(f"row {row + 2}: {error}") from None

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """See `Table`."""
        if first < self._next or first == 0:
            self._next, self._going = 0, self._lines()
        while self._next < last:
            cells, codes = next(self._going)
            self._next += 1
            if self._next <= first:
                continue
            row: dict[str, Any] = {name: alive(cells[name]) for name in _TOLD}
            try:
                row["number"] = int(cells["number"])
                if cells.get(OUTPUTS[0]):
                    row["outputs"] = {name: np.array(cells[name].split(), dtype=np.float64) for name in OUTPUTS}
                payload = codes_of(codes) if codes else base64.b64decode(cells["payload"], validate=True)
            except (ValueError, KeyError) as error:
                raise self._damaged(f"row {self._next + 1}: {error}") from None
            yield row, payload

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
    """Return codes that stand as decimal numbers between commas, one signed byte each."""
    # They are taken apart all at once: one by one they would take as long as their estimates, ten times over.
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


# --------------------
# HDF5: each column a data set of its own, codes as int8 (n, n_samples)


_SCHEMA = "gyrolock"
_CHUNK = 128  # rows that are compressed together
_GROUP = "records"


class Hdf5Writer:
    """Writes one file; arguments as for `ParquetWriter`."""

    def __init__(self, file: Any, width: int) -> None:
        h5py = package("h5py")
        self._width = width
        self._file = h5py.File(file, "w")
        self._file.attrs[_SCHEMA] = json.dumps({"schema": SCHEMA})
        group = self._file.create_group(_GROUP)
        text = h5py.string_dtype("utf-8")
        kinds: dict[str, Any] = {**dict.fromkeys(TEXT, text), **dict.fromkeys(WHOLE, np.int64)}
        kinds |= dict.fromkeys(NUMBERS, np.float64)
        packed = {"compression": "gzip", "compression_opts": 1}
        self._columns = {
            name: group.create_dataset(name, (0,), kinds[name], maxshape=(None,), chunks=(AT_ONCE,), **packed)
            for name in COLUMNS
            if name != "source_json"
        }
        self._columns["source_index"] = group.create_dataset(
            "source_index", (0,), np.int64, maxshape=(None,), chunks=(AT_ONCE,), **packed
        )
        self._codes = group.create_dataset(
            "codes", (0, width), np.int8, maxshape=(None, width), chunks=(_CHUNK, width), shuffle=True, **packed
        )
        bytes_of_any_length = h5py.vlen_dtype(np.uint8)
        self._payload = group.create_dataset("payload", (0,), bytes_of_any_length, maxshape=(None,))
        numbers_of_any_length = h5py.vlen_dtype(np.float64)
        self._outputs = {
            name: group.create_dataset(name, (0,), numbers_of_any_length, maxshape=(None,), chunks=(_CHUNK,))
            for name in OUTPUTS
        }
        self._text, self._sources = text, list[str]()

    def write(self, rows: Rows) -> None:
        """Add rows."""
        codes, others = rows.codes(self._width)
        for about in rows.columns["source_json"]:
            if not self._sources or self._sources[-1] != about:
                self._sources.append(about)
        told = {about: place for place, about in enumerate(self._sources)}
        values: dict[str, Any] = {name: rows.columns[name] for name in COLUMNS if name != "source_json"}
        values["source_index"] = [told[about] for about in rows.columns["source_json"]]
        for name, column in self._columns.items():
            _append(column, np.array(values[name], dtype=None if name in TEXT else column.dtype))
        _append(self._codes, codes)
        before = self._payload.shape[0]
        self._payload.resize(before + len(rows), axis=0)
        for place in np.flatnonzero(others).tolist():
            self._payload[before + place] = np.frombuffer(rows.payloads[place], np.uint8)
        for name, column in self._outputs.items():
            column.resize(before + len(rows), axis=0)
            for place, output in enumerate(rows.outputs):
                if output is not None:
                    column[before + place] = output[name]

    def close(self) -> None:
        """Write what is known of the sources, and the end of the file."""
        group = self._file[_GROUP]
        sizes = {"record": self._codes.shape[0], "sample": self._width}
        for name, size in sizes.items():  # netCDF's dimensions, by which xarray opens the group
            group.create_dataset(name, data=np.arange(size)).make_scale(name)
        for column in (*self._columns.values(), self._codes, self._payload, *self._outputs.values()):
            for dimension, name in zip(column.dims, sizes, strict=False):
                dimension.attach_scale(group[name])
        about = np.array(self._sources, dtype=object)
        self._file.create_dataset("source", data=np.arange(about.size)).make_scale("source")
        sources = self._file.create_dataset("source_json", data=about, dtype=self._text)
        sources.dims[0].attach_scale(self._file["source"])
        self._file.close()


class Hdf5Table(Table):
    """Reads one file."""

    def __init__(self, place: str) -> None:
        super().__init__(place)
        with self._opened() as file:
            found = file.attrs.get(_SCHEMA)
            check_schema(json.loads(found)["schema"] if found else None, place)

    def heads(self) -> Iterator[tuple[str, int]]:
        """See `Table`."""
        with self._opened() as file:
            texts = file["source_json"].asstr()[:].tolist()
            indices = file[_GROUP]["source_index"][:].tolist()
            numbers = file[_GROUP]["number"][:].tolist()
        for index, number in zip(indices, numbers, strict=True):
            yield texts[index], number

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """See `Table`."""
        if numbers is not None:
            with self._opened() as file:
                first, last = rows_with(numbers, file[_GROUP]["number"][first:last], first)
        texts = ("key", "taken_at", "purpose", "header", "conditions", "sha256")
        for start in range(first, last, AT_ONCE):
            taken = slice(start, min(start + AT_ONCE, last))
            with self._opened() as file:
                group = file[_GROUP]
                columns = {name: group[name].asstr()[taken].tolist() for name in texts}
                columns["number"] = group["number"][taken].tolist()
                codes, payloads = group["codes"][taken], group["payload"][taken]
                outputs = {name: group[name][taken] for name in OUTPUTS if name in group}
                sizes = group["samples"][taken] * group["bytes_per_sample"][taken]
            for place in range(len(codes)):
                row = {name: column[place] for name, column in columns.items()}
                if outputs and outputs[OUTPUTS[0]][place].size:
                    row["outputs"] = {name: column[place] for name, column in outputs.items()}
                is_codes = sizes[place] == codes.shape[1] and not payloads[place].size
                yield row, codes[place].tobytes() if is_codes else payloads[place].tobytes()

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        try:
            with package("h5py").File(self.place, "r") as file:
                yield file
        except FileNotFoundError:
            raise
        except (OSError, KeyError, ValueError, RuntimeError, TypeError, IndexError) as error:
            raise RunError(
                f"{self.place}: is damaged or no HDF5 file, and cannot be read ({error}): export it again"
            ) from None


def _append(column: Any, values: Any) -> None:
    before = column.shape[0]
    column.resize(before + len(values), axis=0)
    column[before:] = values


# --------------------
# NumPy's ``.npz``: each column an array, codes as int8 (n, n_samples); written without holding the codes


_SHARED = ("source", "header", "source_json")
"""Long texts that most rows share: they stand once, and each row has the place of its own."""


class NumpyWriter:
    """Writes one file; arguments as for `ParquetWriter`."""

    def __init__(self, file: Any, width: int) -> None:
        self._file, self._width = file, width
        self._codes = tempfile.TemporaryFile()  # noqa: SIM115  # closed with the writer
        self._columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
        self._shared: dict[str, dict[str, int]] = {name: {} for name in _SHARED}
        self._payloads: list[bytes] = []
        self._outputs: list[dict[str, Floats] | None] = []

    def write(self, rows: Rows) -> None:
        """Add rows."""
        codes, others = rows.codes(self._width)
        self._codes.write(codes.data)
        self._outputs += rows.outputs
        self._payloads += [payload if other else b"" for payload, other in zip(rows.payloads, others, strict=True)]
        for name, column in rows.columns.items():
            if (texts := self._shared.get(name)) is not None:
                column = [texts.setdefault(one, len(texts)) for one in column]
            self._columns[name] += [one.encode() for one in column] if name in TEXT and texts is None else column

    def close(self) -> None:
        """Put the arrays into the file."""
        count = len(self._payloads)
        kinds = {**dict.fromkeys((*WHOLE, *_SHARED), np.int64), **dict.fromkeys(NUMBERS, np.float64)}
        arrays: dict[str, NDArray[Any]] = {"schema": np.array(json.dumps(SCHEMA))}
        for name, column in self._columns.items():
            array = np.array(column, dtype=kinds.get(name, "S"))
            arrays[f"{name}_index" if name in _SHARED else name] = array
        for name, texts in self._shared.items():
            arrays[name] = np.array([text.encode() for text in texts], dtype="S")
        for name in OUTPUTS:
            columns = [np.empty(0) if output is None else output[name] for output in self._outputs]
            arrays[name] = np.concatenate([np.empty(0), *columns])
            arrays[f"{name}_end"] = np.cumsum([column.size for column in columns], dtype=np.int64)
        arrays["payload"] = np.frombuffer(b"".join(self._payloads), np.uint8)
        arrays["payload_end"] = np.cumsum([len(payload) for payload in self._payloads], dtype=np.int64)
        with zipfile.ZipFile(self._file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as packed:
            for name, array in arrays.items():
                with packed.open(f"{name}.npy", "w", force_zip64=True) as entry:
                    np.lib.format.write_array(entry, array, allow_pickle=False)
            with packed.open(zipfile.ZipInfo("codes.npy"), "w", force_zip64=True) as entry:  # stored as it is
                shape: Any = {"descr": "|i1", "fortran_order": False, "shape": (count, self._width)}
                np.lib.format.write_array_header_1_0(entry, shape)
                self._codes.seek(0)
                shutil.copyfileobj(self._codes, entry, 1 << 20)
        self._codes.close()


class NumpyTable(Table):
    """Reads one file. Its arrays are held in the memory."""

    def __init__(self, place: str) -> None:
        super().__init__(place)
        schema = self._array("schema")
        check_schema(json.loads(str(schema)) if schema.dtype.kind == "U" and schema.ndim == 0 else None, place)

    def heads(self) -> Iterator[tuple[str, int]]:
        """See `Table`."""
        texts = [text.decode() for text in self._array("source_json").tolist()]
        indices, numbers = self._array("source_json_index").tolist(), self._array("number").tolist()
        for index, number in zip(indices, numbers, strict=True):
            yield texts[index], number

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """See `Table`."""
        held = self._held
        if numbers is not None:
            first, last = rows_with(numbers, held["number"][first:last], first)
        ends = held["payload_end"]
        for place in range(first, last):
            row = {
                name: held[name][place].decode() for name in ("key", "taken_at", "purpose", "conditions", "sha256")
            }
            row["header"] = held["header"][held["header_index"][place]].decode()
            row["number"] = int(held["number"][place])
            if (outputs := self._output(place)) is not None:
                row["outputs"] = outputs
            payload = held["payload"][ends[place - 1] if place else 0 : ends[place]]
            yield row, payload.tobytes() if payload.size else self._payload(place)

    def _output(self, place: int) -> dict[str, Floats] | None:
        """Output of a fibre gyro; ``None`` where the row holds none."""
        found = {}
        for name, (values, ends) in self._held_outputs.items():
            found[name] = values[ends[place - 1] if place else 0 : ends[place]]
        return found if found and found[OUTPUTS[0]].size else None

    def _payload(self, place: int) -> bytes:
        """Codes of a record; one that sent nothing has none."""
        held = self._held
        width = held["codes"].shape[1]
        fits = held["samples"][place] * held["bytes_per_sample"][place] == width
        return bytes(held["codes"][place].tobytes()) if fits else b""

    @cached_property
    def _held(self) -> dict[str, NDArray[Any]]:
        names = (
            *("number", "key", "taken_at", "purpose", "conditions", "sha256", "samples", "bytes_per_sample"),
            *("header", "header_index", "codes", "payload", "payload_end"),
        )
        return {name: self._array(name) for name in names}

    @cached_property
    def _held_outputs(self) -> dict[str, tuple[Floats, NDArray[np.int64]]]:
        if json.loads(str(self._array("schema")))["version"] == 1:
            return {}
        return {name: (self._array(name), self._array(f"{name}_end")) for name in OUTPUTS}

    def _array(self, name: str) -> NDArray[Any]:
        try:
            with Path(self.place).open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                array: NDArray[Any] = file[name]
                return array
        except FileNotFoundError:
            raise
        except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise RunError(
                f"{self.place}: is damaged or no data set of NumPy, and cannot be read ({error}): export it again"
            ) from None


# --------------------
# Parquet: codes as lists of int8, timestamps, unit, operator and scale factor as columns; row groups of 2000 rows.
#
# Differences of neighbouring codes are small: DELTA_BINARY_PACKED takes half the bytes. Source of it and of the
# key-value metadata: the format's own rules (parquet.apache.org/docs)


_METADATA = b"gyrolock"
_CODED_ALIKE = ("source", "purpose", "channel", "axis", "header", "source_json")  # texts that most rows share

_READ = ("number", "key", "taken_at", "purpose", "header", "conditions", "sha256", "payload")


class ParquetWriter:
    """Writes one file."""

    def __init__(self, file: Any, width: int) -> None:
        pyarrow, parquet = package("pyarrow"), package("pyarrow.parquet")
        self._width, self._pyarrow = width, pyarrow
        kinds = {**dict.fromkeys(WHOLE, pyarrow.int64()), **dict.fromkeys(NUMBERS, pyarrow.float64())}
        fields = [pyarrow.field(name, kinds.get(name, pyarrow.string())) for name in COLUMNS]
        fields += [pyarrow.field(name, getattr(pyarrow, kind)()) for name, kind in _SAID.items()]
        fields.append(pyarrow.field("taken", pyarrow.timestamp("ms", "UTC")))
        fields.append(pyarrow.field("codes", pyarrow.list_(pyarrow.int8())))
        fields.append(pyarrow.field("payload", pyarrow.binary()))
        fields += [pyarrow.field(name, pyarrow.list_(pyarrow.float64())) for name in OUTPUTS]
        self._schema = pyarrow.schema(fields, {_METADATA: json.dumps({"schema": SCHEMA}).encode()})
        self._writer = parquet.ParquetWriter(
            file,
            self._schema,
            compression="zstd",
            compression_level=1,
            use_dictionary=list(_CODED_ALIKE),
            column_encoding={"codes.list.element": "DELTA_BINARY_PACKED"},
        )

    def write(self, rows: Rows) -> None:
        """Add rows as one row group."""
        pyarrow = self._pyarrow
        codes, others = rows.codes(self._width)
        told = {about: _said_of(about) for about in dict.fromkeys(rows.columns["source_json"])}
        said = zip(*(told[about] for about in rows.columns["source_json"]), strict=True)
        columns = {**rows.columns, **dict(zip(_SAID, map(list, said), strict=True))}
        columns["taken"] = [_time(text) for text in rows.columns["taken_at"]]
        fields = [field for field in self._schema if field.name in columns]
        arrays = [pyarrow.array(columns[field.name], field.type, from_pandas=True) for field in fields]
        seen = [None if other else of for of, other in zip(codes, others, strict=True)]
        arrays.append(self._lists(seen, np.int8))
        payloads = [payload if other else None for payload, other in zip(rows.payloads, others, strict=True)]
        arrays.append(pyarrow.array(payloads, pyarrow.binary()))
        arrays += [
            self._lists([None if output is None else output[name] for output in rows.outputs], np.float64)
            for name in OUTPUTS
        ]
        self._writer.write_table(pyarrow.Table.from_arrays(arrays, schema=self._schema), row_group_size=AT_ONCE)

    def _lists(self, parts: Sequence[NDArray[Any] | None], kind: type) -> Any:
        """One column of lists; null where a row has none."""
        pyarrow = self._pyarrow
        of = pyarrow.list_(pyarrow.from_numpy_dtype(kind))
        if not any(there := [part is not None for part in parts]):
            return pyarrow.nulls(len(parts), of)
        ends = np.cumsum([0, *(0 if part is None else part.size for part in parts)]).astype(np.int32)
        values = np.concatenate([np.empty(0, kind), *(part for part in parts if part is not None)])
        buffers = [pyarrow.array(there).buffers()[1], pyarrow.py_buffer(ends)]
        return pyarrow.Array.from_buffers(of, len(parts), buffers, children=[pyarrow.array(values)])

    def close(self) -> None:
        """Write the end of the file: without it nobody can read it."""
        self._writer.close()


_SAID = {"unit": "string", "operator": "string", SCALE_FACTOR.key(): "float64"}


def _said_of(about: str) -> list[Any]:
    """Unit, operator and scale factor as what is known of a source says them."""
    facts = json.loads(about)["facts"]
    settings = facts.get("settings")
    gyro = settings.get("gyro") if isinstance(settings, dict) else None
    said = {**(gyro if isinstance(gyro, dict) else {}), **facts}
    kinds: dict[str, Any] = {"string": str, "float64": int | float}
    return [one if isinstance(one := said.get(name), kinds[kind]) else None for name, kind in _SAID.items()]


def _time(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError):
        return None


class ParquetTable(Table):
    """Reads one file; path or URL."""

    def __init__(self, place: str) -> None:
        super().__init__(place)
        self._kept: dict[int, Any] = {}
        with self._said(), _opened(place) as file:
            metadata = file.schema_arrow.metadata or {}
            groups = [file.metadata.row_group(one) for one in range(file.num_row_groups)]
            self._sizes = [group.num_rows for group in groups]
            at = file.schema_arrow.names.index(_READ[0]) if _READ[0] in file.schema_arrow.names else 0
            told = [group.column(at).statistics for group in groups]
            # anything where the file does not say
            self._numbers = [(s.min, s.max) if s and s.has_min_max else (-math.inf, math.inf) for s in told]
            names = set(file.schema_arrow.names)
            self._outputs = [name for name in OUTPUTS if name in names]
        found = metadata.get(_METADATA)
        with self._said():
            check_schema(json.loads(found)["schema"] if found else None, place)
        if lost := [name for name in (*COLUMNS, "codes", "payload") if name not in names]:
            raise RunError(f"{place}: the column {lost[0]!r} is not in it: export the records again")

    def heads(self) -> Iterator[tuple[str, int]]:
        """See `Table`."""
        with self._said(), _opened(self.place) as file:
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, columns=["source_json", "number"], use_threads=False)
                coded = table.column("source_json").combine_chunks().dictionary_encode()
                texts = coded.dictionary.to_pylist()
                numbers = table.column("number").to_pylist()
                for code, number in zip(coded.indices.to_pylist(), numbers, strict=True):
                    yield texts[code], number

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """See `Table`."""
        # With `numbers` row groups in which none of these records can be are not read.
        start = 0
        for group, size in enumerate(self._sizes):
            below, above = max(first - start, 0), min(last - start, size)
            least, most = self._numbers[group]
            if below < above and (numbers is None or (least < numbers.stop and most >= numbers.start)):
                with self._said():
                    if group not in self._kept:
                        with _opened(self.place) as file:
                            read = [*_READ, "codes", *self._outputs]
                            self._kept = {group: file.read_row_group(group, columns=read, use_threads=False)}
                    table = self._kept[group]
                    part = table.slice(below, above - below)
                    columns = [part.column(name).to_pylist() for name in _READ]
                    outputs, sent = _outputs_of(part, self._outputs), _codes_in(part.column("codes"))
                for place, (*cells, payload) in enumerate(zip(*columns, strict=True)):
                    row, codes = dict(zip(_READ, cells, strict=False)), sent[place]
                    if outputs and outputs[place] is not None:
                        row["outputs"] = outputs[place]
                    yield row, payload or b"" if codes is None else codes
            start += size

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to read the same file, wherever it runs."""
        place = self.place if is_url(self.place) else os.path.abspath(self.place)
        return {**vars(self), "place": place, "_kept": {}}

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


def _codes_in(column: Any) -> list[bytes | None]:
    """Codes of each row as bytes, ``None`` where it holds none: lists, or of earlier versions bytes."""
    column = column.combine_chunks()
    if not hasattr(column, "offsets"):
        found: list[bytes | None] = column.to_pylist()
        return found
    values, ends = column.values.to_numpy(zero_copy_only=False), column.offsets.to_pylist()
    cells = zip(ends, ends[1:], column.is_valid().to_pylist(), strict=False)
    return [values[begin:end].tobytes() if there else None for begin, end, there in cells]


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
