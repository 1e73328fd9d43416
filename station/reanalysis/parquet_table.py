"""A results table as Parquet: columns, in row groups of some ten thousand records."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from station.datasets.rows import package
from station.errors import RunError
from station.reanalysis.table_file import (
    INTEGERS,
    NAME,
    ORDER,
    TEXTS,
    VERSION,
    Key,
    TableFile,
    TableRows,
    joined_columns,
)

pyarrow, compute, parquet = (package(name, "data") for name in ("pyarrow", "pyarrow.compute", "pyarrow.parquet"))

ROW_GROUP = 10_000
_KINDS = {
    **dict.fromkeys(ORDER, pyarrow.float64()),
    **dict.fromkeys(TEXTS, pyarrow.string()),
    **dict.fromkeys(INTEGERS, pyarrow.int64()),
}
SCHEMA = pyarrow.schema(
    [(name, _KINDS[name]) for name in ORDER], {"schema_name": NAME, "schema_version": str(VERSION)}
)


class Parquet(TableFile):
    """New rows go to a draft beside the table, which takes its place at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._writer: Any = None
        self._waiting: list[Any] = []

    def _keys(self) -> Iterator[tuple[str, str, str]]:
        names = ["source", "analysis", "source_sha256"]
        for batch in self._batches(names):
            table = pyarrow.Table.from_batches([batch]).group_by(names).aggregate([])
            yield from zip(*(table.column(name).to_pylist() for name in names), strict=True)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the rows; see `TableFile`."""
        for batch in self._batches(None):
            yield from batch.to_pylist()

    def begin(self) -> None:
        """Open the draft; see `TableFile`."""
        with self._writing():
            self._writer = parquet.ParquetWriter(
                self._draft, SCHEMA, compression="zstd", compression_level=1, use_dictionary=list(TEXTS)
            )

    @staticmethod
    def packed(parts: Sequence[TableRows]) -> bytes:
        """Columns as Arrow lays them out in memory; see `TableFile`."""
        columns = joined_columns(parts)
        arrays = [pyarrow.array(columns[name], _KINDS[name], from_pandas=True) for name in ORDER]
        return bytes(pyarrow.RecordBatch.from_arrays(arrays, schema=SCHEMA).serialize())

    def add(self, packed: bytes) -> None:
        """Collect rows to row groups; see `TableFile`."""
        self._waiting.append(pyarrow.ipc.read_record_batch(pyarrow.py_buffer(packed), SCHEMA))
        if sum(map(len, self._waiting)) >= ROW_GROUP:
            self._flush()

    def end(self, replaced: set[Key]) -> None:
        """Write what stays behind the new rows; see `TableFile`."""
        self._flush()
        if self.path.exists():
            gone = pyarrow.array(
                [f"{source}\n{analysis}" for source, analysis in sorted(replaced)], pyarrow.string()
            )
            for batch in self._batches(None):
                keys = compute.binary_join_element_wise(batch["source"], batch["analysis"], "\n")
                kept = batch.filter(compute.invert(compute.is_in(keys, gone)))
                if len(kept):
                    self._waiting.append(kept.cast(SCHEMA))
                    self._flush()
        with self._writing():
            self._writer.close()
            self._draft.replace(self.path)

    def give_up(self) -> None:
        """Take the draft away; see `TableFile`."""
        with suppress(OSError):  # a disk that is full does not take its end
            if self._writer is not None:
                self._writer.close()
        with suppress(OSError):
            self._draft.unlink()

    def _flush(self) -> None:
        if self._waiting:
            with self._writing():
                table = pyarrow.Table.from_batches(self._waiting, SCHEMA)
                self._writer.write_table(table, row_group_size=2 * ROW_GROUP)
            self._waiting = []

    def _batches(self, names: list[str] | None) -> Iterator[Any]:
        try:
            with parquet.ParquetFile(self.path) as file:
                known = file.schema_arrow.metadata or {}
                ours = known.get(b"schema_name") == NAME.encode()
                version = known.get(b"schema_version", b"").decode(errors="replace")
                self._checked(int(version) if ours and version.isdigit() else None)
                yield from file.iter_batches(ROW_GROUP, columns=names)
        except (pyarrow.ArrowException, OSError) as error:
            raise RunError(
                f"{self.path}: is no Parquet file or is damaged ({str(error).splitlines()[0]})"
            ) from None
