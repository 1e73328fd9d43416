"""HDF5: each column a data set of its own, codes as int8 (n, n_samples)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from station.datasets.outputs import OUTPUTS
from station.datasets.packages import package
from station.datasets.rows import AT_ONCE, COLUMNS, NUMBERS, SCHEMA, TEXT, WHOLE, Rows, check_schema, rows_with
from station.errors import RunError

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
        self._file.create_dataset("source_json", data=np.array(self._sources, dtype=object), dtype=self._text)
        self._file.close()


class Hdf5Table:
    """Reads one file; see `ParquetTable`."""

    def __init__(self, place: str) -> None:
        self.place = place
        with self._opened() as file:
            found = file.attrs.get(_SCHEMA)
            check_schema(json.loads(found)["schema"] if found else None, place)

    def heads(self) -> Iterator[tuple[str, int]]:
        """Yield what is known of the source of each row, equal ones as one object, and its number there."""
        with self._opened() as file:
            texts = file["source_json"].asstr()[:].tolist()
            indices = file[_GROUP]["source_index"][:].tolist()
            numbers = file[_GROUP]["number"][:].tolist()
        for index, number in zip(indices, numbers, strict=True):
            yield texts[index], number

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Yield rows from `first` up to, but not, `last`; with `numbers` no more than are needed."""
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

    def __getstate__(self) -> dict[str, str]:
        """What another process needs to read the same file."""
        return {"place": os.path.abspath(self.place)}

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
