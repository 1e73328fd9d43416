"""Export: data sets, read back as the sources they came from, and files as an oscilloscope writes them."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from instrument import InstrumentError, Preamble, Waveform
from instrument.tek_files import csv_text
from station.datasets.backends import (
    CsvTable,
    CsvWriter,
    Hdf5Table,
    Hdf5Writer,
    NumpyTable,
    NumpyWriter,
    ParquetTable,
    ParquetWriter,
    Table,
    is_url,
    opened_bytes,
)
from station.datasets.rows import AT_ONCE, Rows, described, joined_rows, package, record_of, rows_of
from station.errors import CannotWrite, RunError, StationError, UsageError, one_line
from station.results.numbers import SCALE_FACTOR
from station.runs.database import RunFacts, checked_fact
from station.runs.store import SavedRecord, SavedRun, damage_of, damaged_facts, missing_records, open_run
from station.sources.batches import NO_RECORD, ExcludedRecord, Source
from station.sources.run import HeldRun, RunSource

PARTS = "part-*.parquet"
_ENDINGS: dict[str, Callable[[str], Table]] = {
    ".parquet": ParquetTable,
    ".h5": Hdf5Table,
    ".hdf5": Hdf5Table,
    ".npz": NumpyTable,
    ".csv": CsvTable,
}


class DatasetSource(Source):
    """A source as it was when it was exported."""

    kind = "data set"

    def __init__(self, place: str, about: dict[str, Any]) -> None:
        self.path, self.name, self.origin = Path(place), str(about["name"]), str(about["kind"])
        self.facts = RunFacts({name: checked_fact(name, value) for name, value in about["facts"].items()})
        self.unusable, self.protected = dict(about["unusable"]), bool(about["protected"])
        self._sha256, self._is_run, self._records = (
            str(about["sha256"]),
            bool(about["is_run"]),
            int(about["records"]),
        )
        self._stretches: list[tuple[Table, range]] = []  # rows of one table, one behind the other
        self._least, self._most = math.inf, -math.inf

    def add(self, table: Table, row: int, number: int) -> None:
        """Take a row to those that are its own."""
        self._least, self._most = min(self._least, number), max(self._most, number)
        before, rows = self._stretches[-1] if self._stretches else (None, range(0))
        if before is table and rows.stop == row:
            self._stretches[-1] = table, range(rows.start, row + 1)
        else:
            self._stretches.append((table, range(row, row + 1)))

    @property
    def span(self) -> tuple[int, int]:
        """Least and largest number of the records; see `Source`."""
        far = self._most - self._least >= 2 * len(self) + AT_ONCE  # a damaged run may hold any number
        return (1, 1) if far else (int(self._least), int(self._most))

    def complete(self) -> None:
        """Say what is missing or damaged, when all rows are there."""
        whole = (self._least, self._most) == (1, len(self))
        numbers = () if whole else sorted({record.number for record in self._records_there() if record.number > 0})
        self.damaged = (*missing_records(numbers), *damaged_facts(self.unusable))

    def __len__(self) -> int:
        return sum(len(rows) for _, rows in self._stretches)

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Read the records one at a time; see `Source`."""
        if len(self) < self._records:
            raise RunError(
                f"{self.path}: holds {len(self)} of {self._records} records of {self.name}: a part is missing"
            )
        yield from self._records_there(numbers)

    def _records_there(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        for table, rows in self._stretches:
            for row, payload in table.rows(rows.start, rows.stop, numbers):
                if numbers is None or int(row["number"]) in numbers:
                    yield record_of(row, payload)

    @property
    def sha256(self) -> str:
        """That of the source that it was exported from; see `Source`."""
        return self._sha256

    @property
    def is_run(self) -> bool:
        """Whether it was taken by a measurement of ours."""
        return self._is_run


def is_dataset(place: str | Path) -> bool:
    """Tell whether something that can be read is a data set: by its name, a CSV by its first line."""
    text = str(place)
    path = Path(text)
    if is_url(text):
        return True
    if path.is_dir():
        return any(path.glob(PARTS))
    ending = path.suffix.lower()
    if ending == ".csv":
        if not path.is_file():  # a pipe would wait for its writer
            return False
        with path.open("rb") as file:
            return file.read(64).removeprefix(b"\xef\xbb\xbf").startswith(b"schema,source,number,")
    return ending in _ENDINGS


def parts_of(place: str | Path) -> list[str]:
    """Return path or URL of each file of a data set."""
    text = str(place)
    if is_url(text):
        if not text.endswith("/"):
            return [text]
        fsspec = package("fsspec", "cluster")
        system, folder = fsspec.core.url_to_fs(text)
        found = sorted(system.glob(f"{folder.rstrip('/')}/{PARTS}"))
        if not found:
            raise RunError(f"{text}: holds no part of a data set ({PARTS})")
        return [system.unstrip_protocol(one) for one in found]
    if Path(text).is_dir():
        return [str(one) for one in sorted(Path(text).glob(PARTS))]
    return [text]


def sources_of(place: str | Path) -> list[DatasetSource]:
    """Return the sources that a data set was exported from, in their order."""
    found: dict[str, DatasetSource] = {}
    seen: dict[int, DatasetSource] = {}  # by the text as one object: it is not taken apart for each row
    for table in map(_table, parts_of(place)):
        texts: list[str] = []
        for row, (about, number) in enumerate(table.heads()):
            source = seen.get(id(about))
            if source is None:
                source = found.get(about)
                if source is None:
                    source = found[about] = DatasetSource(str(place), _taken_apart(about, table.place))
                texts.append(about)  # held, so that no other object gets its id
                seen[id(about)] = source
            source.add(table, row, number)
        seen.clear()
    for source in found.values():
        source.complete()
    return list(found.values())


def whole(source: Source) -> SavedRun:
    """Return the run of a source with all its records in memory."""
    if isinstance(source, HeldRun):
        return source.run
    if isinstance(source, RunSource):
        return open_run(source.path)
    records = tuple(source.records())
    damaged = tuple(damage_of(records, source.unusable))
    return SavedRun(source.path, source.facts, records, None, dict(source.unusable), source.protected, damaged)


def names_of(sources: Sequence[Source]) -> str:
    """Return names of sources for a message, the first few."""
    names = [source.name for source in sources]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _table(place: str) -> Table:
    kind = _ENDINGS.get(Path(place).suffix.lower())
    if kind is None:
        raise RunError(f"{place}: is no data set by its name: they end with {', '.join(_ENDINGS)}")
    return kind(place)


def _taken_apart(about: str, place: str) -> dict[str, Any]:
    try:
        known = json.loads(about)
        wanted = {"name": str, "kind": str, "is_run": bool, "sha256": str, "records": int, "facts": dict}
        wanted |= {"unusable": dict, "protected": bool}
        if not all(isinstance(known[name], kind) for name, kind in wanted.items()):
            raise ValueError("holds something that it never does")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{place}: what it knows of a source is damaged ({error}): export it again") from None
    return dict(known)


# --------------------
# Export: records of many sources into one file, or into parts of about 100 MB


_WRITTEN_ENDINGS = {
    ".parquet": ParquetWriter,
    ".h5": Hdf5Writer,
    ".hdf5": Hdf5Writer,
    ".npz": NumpyWriter,
    ".csv": CsvWriter,
}
ENDINGS = tuple(_WRITTEN_ENDINGS)
RECORDS_OF_PART = 40_000  # 100 MB of codes: what a worker of a cluster takes at once
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
    left_out: list[ExcludedRecord] = field(default_factory=list)  # what could not be read, or holds no record


def check_target(place: str, *, replace: bool) -> None:
    """See that something can be written to a place, before anything is read."""
    path = Path(place)
    if place.endswith("/"):
        there = not is_url(place) and path.is_dir() and any(path.glob("part-*"))
        if there and not replace:
            raise UsageError(f"{place}: holds parts of a data set already: name another folder, or add --replace")
        return
    if path.suffix.lower() not in _WRITTEN_ENDINGS:
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
    left_out: list[ExcludedRecord] | None = None,
    told: Callable[[int], None] = lambda records: None,
) -> Exported:
    """Write all records of sources to a data set."""
    done = Exported(left_out=[] if left_out is None else left_out)
    rows = joined_rows(_all_rows(sources, done))
    first = next(rows, None)
    if first is None:
        why = f" ({done.left_out[0]})" if done.left_out else ""
        raise UsageError(f"there is no record to export{why}")
    sizes = [len(payload) for payload, coded in zip(first.payloads, first.coded, strict=True) if coded]
    width = max(set(sizes), key=sizes.count) if sizes else _USUAL_WIDTH
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
            done.left_out.append(ExcludedRecord(source.name, None, "was named twice"))
            continue
        names.add(source.name)
        try:
            records = len(source)
            if not records:
                done.left_out.append(ExcludedRecord(source.name, None, NO_RECORD))
                continue
            yield from rows_of(source, described(source, records), source.records())
            done.sources += 1
        except (StationError, InstrumentError, OSError) as error:
            done.left_out.append(ExcludedRecord(source.name, None, str(error).removeprefix(f"{source.name}: ")))


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
    kind: Any = ParquetWriter if place.endswith("/") else _WRITTEN_ENDINGS[Path(place).suffix.lower()]
    with opened_bytes(name, "w+b" if kind is Hdf5Writer else "wb") as file:
        writer: Writer = kind(file, width)
        try:
            yield writer
        except BaseException:
            with suppress(Exception):  # what went wrong first is told
                writer.close()
            raise
        writer.close()


# --------------------
# Export as the oscilloscope does it: a CSV file for each record, in the folders that its SAVE ALL makes


_BESIDE = ("quadrature", "beam 1", "beam 2")  # of the same acquisition as the record before it
_SIDE_FILE = "gyrolock.toml"


def write_tek_files(
    sources: Iterable[Source], folder: Path, *, replace: bool, left_out: list[ExcludedRecord] | None = None
) -> Exported:
    """Write the records of sources as files ``ALL0000/F0000CH1.CSV``."""
    # Several sources, or records of several purposes, get folders of their own. Beside them stands what such files
    # do not hold: ``gyrolock.toml`` with the scale factor of the gyro.
    done = Exported(left_out=[] if left_out is None else left_out)
    if not replace and folder.is_dir() and any(folder.iterdir()):
        raise UsageError(f"{folder}: holds files already: name another folder, or add --replace")
    every, taken = list(sources), Counter[Path]()
    try:
        for place, source in zip(_places(folder, every), every, strict=True):
            before = done.records
            _write(source, place, done, taken)
            done.sources += done.records > before
    except OSError as error:
        raise CannotWrite(f"{folder}: the files cannot be written ({error.strerror or error})") from None
    if not done.records:
        why = f" ({done.left_out[0]})" if done.left_out else ""
        raise UsageError(f"there is no record of an oscilloscope to export{why}")
    return done


def _places(folder: Path, sources: list[Source]) -> Iterator[Path]:
    """A folder for each run, one for all files; names that are the same get numbers."""
    runs = sum(source.is_run for source in sources)
    seen: dict[str, int] = {}
    for source in sources:
        if not source.is_run:
            yield folder if not runs else folder / "files"
            continue
        path = Path(source.name)
        name = path.parent.name if path.name in ("run.sqlite", "fog.sqlite") else path.stem
        seen[name] = seen.get(name, 0) + 1
        again = f"_{seen[name]}" if seen[name] > 1 else ""
        yield folder if len(sources) == 1 else folder / f"{name or 'run'}{again}"


def _write(source: Source, folder: Path, done: Exported, taken: Counter[Path]) -> None:
    """Write the records of one source; `taken` says how many acquisitions a folder holds."""
    try:
        records = [record for record in source.records() if not record.aside]
    except (StationError, InstrumentError) as error:
        done.left_out.append(ExcludedRecord(source.name, None, str(error).removeprefix(f"{source.name}: ")))
        return
    if not records:
        done.left_out.append(ExcludedRecord(source.name, None, NO_RECORD))
    keys = _keys(source.facts)
    purposes = dict.fromkeys(record.purpose for record in records if record.purpose not in _BESIDE)
    below = folder
    for record in records:
        if record.purpose not in _BESIDE:  # which belongs to the acquisition before it
            below = folder / record.purpose if len(purposes) > 1 else folder
            taken[below] += 1
        number = max(taken[below] - 1, 0)
        try:
            if not record.intact:
                raise InstrumentError("is damaged")
            if record.header.startswith("{"):
                raise InstrumentError("is the output of a fibre gyro, not a record of an oscilloscope")
            preamble = Preamble.parse(record.header)
            kind: Any = np.int8 if preamble.byt_nr == 1 else ">i2"
            wave = Waveform(np.frombuffer(record.payload, kind), preamble)
            text = csv_text(wave, keys)
        except InstrumentError as error:
            done.left_out.append(
                ExcludedRecord(source.name, record.key, f"{record.number} ({record.key}) {error}")
            )
            continue
        channel = wave.preamble.wfid.split(",")[0].upper() or "CH1"
        file = below / f"ALL{number:04d}" / f"F{number:04d}{channel}.CSV"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode("ascii"))
        done.files.append(str(file))
        done.records += 1
    known = source.facts.settings.get("gyro", {}).get(SCALE_FACTOR.key())
    for one in dict.fromkeys(folder / purpose if len(purposes) > 1 else folder for purpose in purposes):
        if isinstance(known, int | float) and one.is_dir():
            text = f"# of the gyro whose records these are\n[gyro]\nscale_factor_pulses_per_deg = {known!r}\n"
            (one / _SIDE_FILE).write_text(text, encoding="utf-8")


def _keys(facts: RunFacts) -> Mapping[str, str]:
    """The last key rows: what is known of the oscilloscope."""
    identity, scope = facts.get("identity") or {}, facts.settings.get("scope") or {}
    keys = {}
    if isinstance(probe := scope.get("probe"), int | float):
        keys["Probe Atten"] = f"{float(probe):e}"
    model, serial, firmware = (str(identity.get(name) or "") for name in ("model", "serial", "firmware"))
    if model.endswith(("B", "C")):  # the plain models do not write theirs
        keys |= {"Model Number": model.replace(" ", ""), "Serial Number": serial}
    version = "FV:" + firmware.rpartition("FV:")[2].split(" ")[0]
    return keys | ({"Firmware Version": version} if firmware else {})
