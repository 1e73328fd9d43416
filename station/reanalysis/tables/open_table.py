"""Which kind of file a results table is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from station.errors import UsageError
from station.reanalysis.tables.sqlite import Sqlite
from station.reanalysis.tables.table import TableFile
from station.reanalysis.tables.text_tables import Csv, JsonLines


def _parquet(path: Path) -> TableFile:
    try:
        from station.reanalysis.tables.parquet import Parquet
    except ImportError:
        raise UsageError(
            f"{path}: Parquet needs the package pyarrow: pip install 'gyrolock[data]', or name a .sqlite file"
        ) from None
    return Parquet(path)


KINDS: dict[str, Callable[[Path], TableFile]] = {
    ".parquet": _parquet,
    ".sqlite": Sqlite,
    ".csv": Csv,
    ".jsonl": JsonLines,
}


def table_file(path: Path) -> TableFile:
    """Return the table of a file by the ending of its name."""
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        raise UsageError(f"{path}: a results table ends in {', '.join(KINDS)}")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder, not a results table: name a file in it")
    return kind(path)
