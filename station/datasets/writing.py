"""Export: records of many sources into one file, or into parts of about 100 MB."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from instrument import InstrumentError
from station.datasets.csv_file import CsvWriter
from station.datasets.hdf5 import Hdf5Writer
from station.datasets.numpy_file import NumpyWriter
from station.datasets.parquet import ParquetWriter, is_url, opened_bytes
from station.datasets.rows import Rows, described, joined_rows, rows_of
from station.errors import CannotWrite, StationError, UsageError, one_line
from station.sources.batches import LeftOut
from station.sources.source import Source

_ENDINGS = {
    ".parquet": ParquetWriter,
    ".h5": Hdf5Writer,
    ".hdf5": Hdf5Writer,
    ".npz": NumpyWriter,
    ".csv": CsvWriter,
}
ENDINGS = tuple(_ENDINGS)
RECORDS_OF_PART = 40_000
"""100 MB of codes: what a worker of a cluster takes at once."""
_USUAL_WIDTH = 2500


class Writer(Protocol):
    """Writes one file of a data set."""

    def write(self, rows: Rows) -> None:
        """Add rows."""

    def close(self) -> None:
        """Write the end."""


@dataclass
class Exported:
    """What was written."""

    files: list[str] = field(default_factory=list)
    records: int = 0
    sources: int = 0
    left_out: list[LeftOut] = field(default_factory=list)  # what could not be read, or holds no record


def check_target(place: str, *, replace: bool) -> None:
    """See that something can be written to a place, before anything is read."""
    path = Path(place)
    if place.endswith("/"):
        there = not is_url(place) and path.is_dir() and any(path.glob("part-*"))
        if there and not replace:
            raise UsageError(f"{place}: holds parts of a data set already: name another folder, or add --replace")
        return
    if path.suffix.lower() not in _ENDINGS:
        raise UsageError(f"{place}: a data set's name ends with {', '.join(ENDINGS)}, a folder of parts with /")
    if is_url(place) and path.suffix.lower() != ".parquet":
        raise UsageError(f"{place}: to an object store Parquet is written: a name that ends with .parquet or /")
    if not is_url(place) and path.exists() and not replace:
        raise UsageError(f"{place}: is there already: name another file, or add --replace")


def export(
    sources: Iterable[Source],
    place: str,
    *,
    records_of_part: int = RECORDS_OF_PART,
    left_out: list[LeftOut] | None = None,
    told: Callable[[int], None] = lambda records: None,
) -> Exported:
    """Write all records of sources to a data set."""
    done = Exported(left_out=[] if left_out is None else left_out)
    rows = joined_rows(_all_rows(sources, done))
    first = next(rows, None)
    if first is None:
        why = f" ({done.left_out[0]})" if done.left_out else ""
        raise UsageError(f"there is no record to export{why}")
    width = _width(first)
    waiting: Rows | None = first
    with _kept_whole(place) as draft:
        while waiting is not None:
            name, written = draft(len(done.files)), 0
            with _writing(name, place, width) as writer:
                while waiting is not None and (written < records_of_part or not place.endswith("/")):
                    writer.write(waiting)
                    written += len(waiting)
                    done.records += len(waiting)
                    told(done.records)
                    waiting = next(rows, None)
            done.files.append(name)
    done.files = [_final(name) for name in done.files]
    return done


def _all_rows(sources: Iterable[Source], done: Exported) -> Iterator[Rows]:
    names: set[str] = set()
    for source in sources:
        if source.name in names:
            done.left_out.append(LeftOut(source.name, None, "was named twice"))
            continue
        names.add(source.name)
        try:
            records = len(source)
            if not records:
                done.left_out.append(LeftOut(source.name, None, "holds no record"))
                continue
            yield from rows_of(source, described(source, records), source.records())
            done.sources += 1
        except (StationError, InstrumentError, OSError) as error:
            done.left_out.append(LeftOut(source.name, None, str(error).removeprefix(f"{source.name}: ")))


def _width(rows: Rows) -> int:
    """Bytes of the codes that most of the first records have."""
    sizes = [len(payload) for payload, coded in zip(rows.payloads, rows.coded, strict=True) if coded]
    return max(set(sizes), key=sizes.count) if sizes else _USUAL_WIDTH


@contextmanager
def _kept_whole(place: str) -> Iterator[Callable[[int], str]]:
    """Give names to write to; they become the real ones when everything is there, or nothing is left."""
    drafts: list[Path] = []
    folder = place.endswith("/")

    def draft(number: int) -> str:
        if is_url(place):
            return f"{place}part-{number:05d}.parquet" if folder else place
        path = Path(place) / f"part-{number:05d}.parquet" if folder else Path(place)
        drafts.append(path.with_name(f"{path.name}{_PARTIAL}"))
        return str(drafts[-1])

    try:
        if folder and not is_url(place):
            Path(place).mkdir(parents=True, exist_ok=True)
        yield draft
        if folder and not is_url(place):
            for old in Path(place).glob("part-*.parquet"):
                old.unlink()
        for path in drafts:
            os.replace(path, _final(str(path)))
    except StationError:
        raise
    except OSError as error:
        raise CannotWrite(f"{place}: the data set cannot be written ({error.strerror or error})") from None
    except Exception as error:
        if not is_url(place):
            raise
        # each store has errors of its own: no rights, no credentials, no network
        raise CannotWrite(f"{place}: the store does not take it ({one_line(error)})") from None
    finally:
        for path in drafts:
            with suppress(OSError):
                path.unlink(missing_ok=True)


_PARTIAL = ".partial"


def _final(name: str) -> str:
    return name.removesuffix(_PARTIAL)


@contextmanager
def _writing(name: str, place: str, width: int) -> Iterator[Writer]:
    kind: Any = ParquetWriter if place.endswith("/") else _ENDINGS[Path(place).suffix.lower()]
    with opened_bytes(name, "w+b" if kind is Hdf5Writer else "wb") as file:
        writer: Writer = kind(file, width)
        try:
            yield writer
        except BaseException:
            with suppress(Exception):  # what went wrong first is told
                writer.close()
            raise
        writer.close()
