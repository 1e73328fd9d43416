"""NumPy's ``.npz``: each column an array, codes as int8 (n, n_samples); written without holding the codes."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.datasets.outputs import OUTPUTS, Floats
from station.datasets.rows import COLUMNS, NUMBERS, SCHEMA, TEXT, WHOLE, Rows, check_schema, rows_with
from station.errors import RunError

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


class NumpyTable:
    """Reads one file; see `ParquetTable`. Its arrays are held in the memory."""

    def __init__(self, place: str) -> None:
        self.place = place
        schema = self._array("schema")
        check_schema(json.loads(str(schema)) if schema.dtype.kind == "U" and schema.ndim == 0 else None, place)

    def heads(self) -> Iterator[tuple[str, int]]:
        """Yield what is known of the source of each row, equal ones as one object, and its number there."""
        texts = [text.decode() for text in self._array("source_json").tolist()]
        indices, numbers = self._array("source_json_index").tolist(), self._array("number").tolist()
        for index, number in zip(indices, numbers, strict=True):
            yield texts[index], number

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Yield rows from `first` up to, but not, `last`; with `numbers` no more than are needed."""
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

    def __getstate__(self) -> dict[str, str]:
        """What another process needs to read the same file."""
        return {"place": os.path.abspath(self.place)}

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
