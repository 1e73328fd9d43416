"""A run as one SQLite file in a directory of its own. A commit is on the disk when it returns."""

from __future__ import annotations

import functools
import hashlib
import json
import math
import os
import shutil
import sqlite3
import stat
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from station.errors import CannotWrite, RunError
from station.runs.signals import undisturbed

if TYPE_CHECKING:
    from instrument import Tally

_LITTLE = 64 * 1024  # bytes free on a disk that is full: SQLite writes a page of 16 KiB and its journal
SUMS = "sums"  # name of the fact that holds the SHA-256 of every other one: records have theirs in their rows


def utc_now() -> str:
    """Return the time of day as ISO 8601, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def new_run_directory(parent: Path) -> Path:
    """Make the directory of a new run below `parent`, named by the time of day; two runs never share one."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
    for count in range(1, 10_000):
        directory = parent / f"{stamp}_{count:03d}"
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            if not parent.is_dir():
                raise RunError(f"{parent}: is not a directory, runs cannot be saved there") from None
            continue
        except OSError as error:
            raise RunError(f"{parent}: runs cannot be saved there ({error.strerror})") from None
        return directory
    raise RunError(f"{parent}: too many runs in one second")


def create_database(path: Path) -> None:
    """Make an empty run; it appears under its name only when it is whole."""
    draft = path.with_name(f".{path.name}")
    try:
        with closing(sqlite3.connect(draft, isolation_level=None)) as db:
            db.execute("PRAGMA page_size = 16384")
            db.execute(f"PRAGMA application_id = {TODAY.application_id}")
            db.execute(f"PRAGMA user_version = {TODAY.version}")
            db.executescript(f"BEGIN; {TABLES} COMMIT;")
        draft.rename(path)
        for folder in (path.parent, path.parent.parent):
            _keep_names(folder)
    except (sqlite3.Error, OSError) as error:
        raise CannotWrite(f"{path}: {_why(error, path)}") from error


_BEING_WRITTEN: set[Path] = set()
"""Runs that this process writes. Whoever opens and closes such a file beside SQLite drops SQLite's lock on it
(POSIX): another process would then take it for the run of a killed program, and fold away its journal."""


class DatabaseWriter:
    """Writes one run. What a method returned for survives a killed process."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._sums: dict[str, str] = {}
        self._written = path.resolve()
        with reading(path) as (db, layout):
            self._layout = layout
            with suppress(ValueError):
                self._sums = _sums_of(db)
        try:
            self._db = sqlite3.connect(path, isolation_level=None)  # every BEGIN and COMMIT is written here
            self._db.text_factory = _text
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
        except sqlite3.Error as error:
            raise CannotWrite(f"{path}: {_why(error, path)}") from error
        _BEING_WRITTEN.add(self._written)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def save_facts(self, facts: Mapping[str, object]) -> None:
        """Save or replace what is known about the run, by name, in one commit."""
        texts = {name: json.dumps(value, allow_nan=False) for name, value in facts.items()}
        sums = self._sums | {name: _sum(text) for name, text in texts.items()}
        self._commit("INSERT OR REPLACE INTO run VALUES (?, ?)", [*texts.items(), (SUMS, json.dumps(sums))])
        self._sums = sums

    def close(self) -> None:
        """End the run: afterwards it is one plain file, fit for a read-only or a shared disk."""
        with suppress(sqlite3.Error):  # while a reader looks, the journal stays: the run is complete all the same
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()
        _BEING_WRITTEN.discard(self._written)

    def _commit(self, statement: str, rows: Sequence[Sequence[object] | Mapping[str, object]]) -> None:
        try:
            with undisturbed():
                self._db.execute("BEGIN IMMEDIATE")
                try:
                    self._db.executemany(statement, rows)
                    self._db.execute("COMMIT")
                except BaseException:
                    with suppress(sqlite3.Error):  # a disk that is full has ended the transaction already
                        self._db.execute("ROLLBACK")
                    raise
        except sqlite3.IntegrityError as error:
            raise RunError(f"{self.path}: the run does not take it ({error})") from error
        except sqlite3.Error as error:
            raise CannotWrite(f"{self.path}: {_why(error, self.path)}") from error


@contextmanager
def reading(file: Path, *, fold: bool = True) -> Iterator[tuple[sqlite3.Connection, Layout]]:
    """Open a run to read it, finished or cut short; see :func:`opened`."""
    with told(file), ExitStack() as held:
        yield opened(file, held, fold=fold)


def opened(file: Path, held: ExitStack, *, fold: bool = True) -> tuple[sqlite3.Connection, Layout]:
    """Open a run to read it, finished or cut short; it is closed with `held`."""
    with told(file):
        real = file.resolve()
        if fold and real not in _BEING_WRITTEN:
            if not is_database(file):
                raise RunError(f"{file}: is not a saved run")
            _fold(file)
        db = _connected(real, held)
        db.text_factory = _text
        (application,) = db.execute("PRAGMA application_id").fetchone()
        (version,) = db.execute("PRAGMA user_version").fetchone()
        db.commit()
        try:
            layout = layout_of(application, version)
        except ValueError as error:
            raise RunError(f"{file}: was written by a newer gyrolock ({error}): update this one") from None
        if layout is None:
            raise RunError(f"{file}: is a database, but not a saved run of gyrolock")
        return db, layout


@contextmanager
def told(file: Path) -> Iterator[None]:
    """Turn what goes wrong while a run is read into a sentence about it (RunError)."""
    try:
        yield
    except (sqlite3.Error, ValueError, OverflowError, OSError) as error:
        if isinstance(error, OSError) or getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_IOERR:
            raise RunError(f"{file}: the disk does not give it ({error}): try again, or copy it away") from error
        raise RunError(
            f"{file}: is damaged and cannot be read ({error}): `gyrolock salvage {file}` gets out what can be read"
        ) from error


def _connected(file: Path, held: ExitStack) -> sqlite3.Connection:
    """Open a run to read it, also where nothing may be written: then its journal cannot be used as it lies."""
    name = file.as_uri()
    try:
        db = held.enter_context(closing(sqlite3.connect(f"{name}?mode=ro", uri=True)))
        db.execute("BEGIN")  # else each of the next questions locks the file and looks for a journal again
        db.execute("SELECT count(*) FROM sqlite_master").fetchone()
        return db
    except sqlite3.OperationalError as error:  # IOERR: a full disk has no room for the map of a journal
        unwritable = sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR
        if error.sqlite_errorcode & 0xFF not in unwritable:
            raise
    journal = journal_of(file)
    if not journal.exists():
        return held.enter_context(closing(sqlite3.connect(f"{name}?immutable=1", uri=True)))
    copy = Path(held.enter_context(tempfile.TemporaryDirectory())) / file.name
    shutil.copyfile(file, copy)
    shutil.copyfile(journal, journal_of(copy))
    return held.enter_context(closing(sqlite3.connect(copy)))


def _fold(file: Path) -> None:
    """Make one file of a run whose program was killed; one that is being written stays as it is."""
    journal = journal_of(file)
    with suppress(FileNotFoundError, PermissionError):
        if lost := lost_commits(journal.read_bytes()):
            raise RunError(
                f"{file}: its journal is damaged, {lost} commits cannot be read as they lie: "
                f"`gyrolock salvage {file}` gets out what can be read"
            )
        with suppress(sqlite3.Error), closing(sqlite3.connect(file, isolation_level=None, timeout=0)) as db:
            db.execute("PRAGMA journal_mode = DELETE")


def _text(data: bytes) -> str:
    """Text of a cell; where it is none, the checksum of its record tells."""
    return data.decode("utf-8", errors="replace")


def read_facts(db: sqlite3.Connection) -> tuple[dict[str, Any], dict[str, str], bool]:
    """Return what is known about a run, by name; what of it cannot be used and why; whether damage would show."""
    known: dict[str, Any] = {}
    unusable: dict[str, str] = {}
    try:
        sums = _sums_of(db)
    except ValueError as error:
        sums, unusable[SUMS] = {}, str(error)
    for name, text in db.execute("SELECT name, value FROM run WHERE name <> ?", (SUMS,)):
        try:
            if not isinstance(name, str):
                raise ValueError("has no name")
            if name in sums and sums[name] != _sum(text):
                raise ValueError("is not what was once saved")
            known[name] = checked_fact(name, STRICT_JSON.decode(text))
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            unusable[str(name)] = str(error)
    lost = sums.keys() - known.keys() - unusable.keys()
    return known, unusable | dict.fromkeys(lost, "is not there"), bool(sums)


def _sums_of(db: sqlite3.Connection) -> dict[str, str]:
    """SHA-256 of the facts of a run, by name; an earlier version kept none. ValueError if they are damaged."""
    found = db.execute("SELECT value FROM run WHERE name = ?", (SUMS,)).fetchone()
    try:
        sums = json.loads(found[0]) if found else {}
    except (ValueError, TypeError, RecursionError):
        sums = None
    if not isinstance(sums, dict):
        raise ValueError("cannot be read: whether the other facts are right is not known")
    return sums


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def save_result(path: Path, document: Mapping[str, object]) -> None:
    """Keep what was computed from the records of a run beside them; `document` is plain JSON."""
    try:
        with closing(sqlite3.connect(path)) as db, db:
            db.execute("PRAGMA synchronous = FULL")
            row = (utc_now(), json.dumps(dict(document), allow_nan=False))
            db.execute("INSERT INTO result (computed_at, value) VALUES (?, ?)", row)
    except sqlite3.Error as error:
        raise CannotWrite(f"{path}: the result is not saved: {_why(error, path)}") from error


def is_database(path: Path) -> bool:
    """Tell whether a path looks like a run: a directory, or an SQLite file."""
    kind = path.stat().st_mode
    if not stat.S_ISREG(kind):
        return stat.S_ISDIR(kind)  # reading a FIFO would wait for a writer
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\x00"


def _keep_names(folder: Path) -> None:
    """Put the names in a directory on the disk: a file that is there but has no name is lost."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _why(error: sqlite3.Error | OSError, path: Path) -> str:
    """Say why a disk does not take something, and what to do."""
    room = "make room, then go on"
    if isinstance(error, OSError):
        return f"cannot be written ({error.strerror or error})"
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    with suppress(OSError):
        if code == sqlite3.SQLITE_IOERR and shutil.disk_usage(path.parent).free < _LITTLE:
            code = sqlite3.SQLITE_FULL
    if code == sqlite3.SQLITE_FULL:
        return f"the disk is full: {room}"
    if code == sqlite3.SQLITE_BUSY:
        return "another program is writing this run: wait until it has ended"
    name = getattr(error, "sqlite_errorname", "")
    return f"the disk does not take it ({error}{', ' + name if name else ''})"


# --------------------
# How a run is laid out in its SQLite file: today's layout, and the three that earlier versions wrote.
#
# Every layout gives the same columns to a reader, so that nothing above knows which one a file has


_RING_LASER = 0x47_59_4C_4B  # "GYLK"; every run today
_FIBRE_GYRO = 0x47_59_4C_46  # "GYLF"; runs of the fibre gyro, once

COLUMNS = ("number", "key", "taken_at", "purpose", "header", "payload", "sha256", "conditions")

NUMBERED = "typeof(number) = 'integer'"  # what every record has: one in a damaged file that has none is missing


@dataclass(frozen=True)
class Layout:
    """One layout."""

    # four letters at the beginning of the file, by which ``file`` and we tell it from other databases
    application_id: int
    version: int
    table: str  # table of the records
    columns: tuple[str, ...]  # SQL that gives each of `COLUMNS`
    # SHA-256 of a record, as this layout makes it; gets its cells by the names of `COLUMNS`
    checksum: Callable[[Mapping[str, Any]], str]

    @property
    def select(self) -> str:
        """SQL that reads all records in the order in which they were taken."""
        return f"SELECT {', '.join(self.columns)} FROM {self.table} WHERE {NUMBERED} ORDER BY number"

    @property
    def select_between(self) -> str:
        """The same for records from one number to another, its two parameters."""
        between = f"WHERE {NUMBERED} AND number BETWEEN ? AND ? ORDER BY number"
        return f"SELECT {', '.join(self.columns)} FROM {self.table} {between}"

    @property
    def insert(self) -> str:
        """SQL that adds one record; its parameters are those of `COLUMNS` that the table holds, by name."""
        held = [(c, name) for c, name in zip(self.columns, COLUMNS, strict=True) if c.isidentifier()]
        names, values = zip(*((c, f":{name}") for c, name in held if name != "number"), strict=True)
        return f"INSERT INTO {self.table} ({', '.join(names)}) VALUES ({', '.join(values)})"


def _of(*names: str, lengths: bool = False) -> Callable[[Mapping[str, Any]], str]:
    """SHA-256 of some cells one behind the other, with `lengths` each behind its own length."""

    def checksum(cells: Mapping[str, Any]) -> str:
        digest = hashlib.sha256()
        for name in names:
            cell = cells[name]
            data = cell if isinstance(cell, bytes) else cell.encode()
            digest.update(b"%d " % len(data) + data if lengths else data)
        return digest.hexdigest()

    return checksum


_EVERYTHING = ("key", "taken_at", "purpose", "header", "payload", "conditions")
TODAY = Layout(_RING_LASER, 3, "record", COLUMNS, _of(*_EVERYTHING, lengths=True))
TABLES = """
CREATE TABLE run (
    name  TEXT PRIMARY KEY,       -- command, settings, provenance, truth, started_at, ended_at, outcome, ...
    value TEXT NOT NULL           -- JSON
) WITHOUT ROWID;
CREATE TABLE result (             -- computed from the records; never the truth
    number      INTEGER PRIMARY KEY,
    computed_at TEXT NOT NULL,
    value       TEXT NOT NULL     -- JSON
);
CREATE TABLE record (
    number     INTEGER PRIMARY KEY,
    key        TEXT NOT NULL UNIQUE,  -- what it is: a run cut short goes on with the keys that are missing
    taken_at   TEXT NOT NULL,         -- UTC, ISO 8601
    purpose    TEXT NOT NULL,         -- which part of which measurement it was taken for
    header     TEXT NOT NULL,         -- preamble as the scope sent it, or JSON on the columns of an output
    payload    BLOB NOT NULL,         -- codes as the scope sent them, or the columns of an output (zlib)
    sha256     TEXT NOT NULL,         -- of all the others but the number
    conditions TEXT NOT NULL          -- JSON
);
"""
_RING_LASER_1 = Layout(
    _RING_LASER,
    1,
    "record",
    ("number", "purpose || ' ' || number", "taken_at", "purpose", "preamble", "codes", "sha256", "conditions"),
    _of("payload", "header"),
)
_RING_LASER_2 = Layout(_RING_LASER, 2, "record", COLUMNS, _of("payload", "header", "conditions"))
_FIBRE_GYRO_1 = Layout(
    _FIBRE_GYRO,
    1,
    "segment",
    (
        "number", "key", "taken_at",
        "CASE WHEN json_valid(conditions) THEN json_extract(conditions, '$.purpose') END",
        "recording", "samples", "sha256", "conditions",
    ),
    _of("payload", "conditions", "header"),
)  # fmt: skip
LAYOUTS = (TODAY, _RING_LASER_2, _RING_LASER_1, _FIBRE_GYRO_1)


def layout_of(application_id: int, version: int) -> Layout | None:
    """Return the layout of a file, ``None`` if it is no run of ours."""
    ours = [layout for layout in LAYOUTS if layout.application_id == application_id]
    if not ours:
        return None
    for layout in ours:
        if layout.version == version:
            return layout
    raise ValueError(f"layout {version}")


# --------------------
# What is known of a run beside its records


COMPLETE = "complete"
TAKEN = "taken, but not evaluated to its end"
"""Outcomes of a run of which everything was taken: with result and wanted report, and before they are there."""


_KINDS: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("command", "started_at", "unit", "operator", "note"), str),
    **dict.fromkeys(("settings", "provenance", "identity", "truth", "scope_setting", "injected"), dict),
    **dict.fromkeys(("resumed_at", "left_out_of_plan", "logs", "rates", "rates_without_beat"), list),
    "simulated": (bool, int),
    "ended_at": str,
    "outcome": (str, dict),
}


def checked_fact(name: str, value: Any) -> Any:
    """Return a fact as it was read; ValueError if it is of a kind that it never is."""
    kind = _KINDS.get(name)
    if kind is not None and value is not None and not isinstance(value, kind):
        raise ValueError(f"holds {type(value).__name__}, which it never does")
    if name == "truth" and not _are_numbers((value or {}).values()):
        raise ValueError("holds what is no number")
    return value


def conditions_of(cell: str | bytes) -> dict[str, Any] | None:
    """Return what was noted beside a record; ``None`` if it is of a kind that it never is."""
    try:
        found = STRICT_JSON.decode(cell if isinstance(cell, str) else cell.decode())
        truth = found.get("truth") or {}
        plain = (value for name, value in found.items() if name != "truth" and not isinstance(value, str))
        return found if _are_numbers(truth.values()) and _are_numbers(plain) else None
    except (TypeError, ValueError, AttributeError, RecursionError):
        return None


def _are_numbers(values: Iterable[Any]) -> bool:
    return all(value is None or isinstance(value, int | float) for value in values)


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("holds a number that is none")
    return value


STRICT_JSON = json.JSONDecoder(
    parse_float=_number, parse_int=lambda text: int(text) if _number(text) else 0, parse_constant=_number
)
"""JSON as it was written: without infinities."""


class RunFacts(Mapping[str, Any]):
    """Facts of a run by name, and the common ones as attributes."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = dict(values)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def command(self) -> str:
        """Name of the measurement; the first layout was written by one measurement only and does not say."""
        return str(self._values.get("command") or "measure")

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that the run was taken with; empty where none are saved."""
        return dict(self._values.get("settings") or {})

    @property
    def simulated(self) -> bool:
        """Whether the bench was simulated."""
        return bool(self._values.get("simulated", False))

    @property
    def started_at(self) -> str:
        """UTC, ISO 8601; empty if it is not known."""
        return str(self._values.get("started_at") or "")

    @property
    def ended_at(self) -> str | None:
        """UTC, ISO 8601; ``None`` for a run whose program was killed."""
        return self._values.get("ended_at")

    @property
    def resumed_at(self) -> tuple[str, ...]:
        """When the run was gone on with, UTC, ISO 8601."""
        return tuple(self._values.get("resumed_at") or ())

    @property
    def complete(self) -> bool:
        """Whether everything was taken that was wanted, and the result is there."""
        return self._values.get("outcome") == COMPLETE

    @property
    def outcome_text(self) -> str:
        """How the run ended, in words."""
        outcome = self._values.get("outcome") or "cut short: the program was killed"
        return outcome if isinstance(outcome, str) else str(outcome.get("message", "unknown"))

    def with_outcome(self, outcome: str | Mapping[str, Any]) -> RunFacts:
        """Return the facts with another outcome: as it will be, or could not be saved."""
        return RunFacts({**self._values, "outcome": outcome})

    @property
    def truth(self) -> dict[str, float] | None:
        """True values of a simulated run, where the whole run has one truth."""
        return self._values.get("truth")

    @property
    def link_faults(self) -> Tally | None:
        """What it took to keep the link to the oscilloscope; ``None`` where nobody counted."""
        from instrument import Tally  # with PyVISA: a list of runs must not wait for it

        return Tally(**self._values["link"]) if "link" in self._values else None

    @property
    def labels(self) -> dict[str, str]:
        """What the operator said of the run: ``unit``, ``operator`` and ``note``, those that were given."""
        return {name: str(self._values[name]) for name in LABELS if self._values.get(name)}

    @property
    def left_out_of_plan(self) -> dict[str, str]:
        """What was not taken at all, and why."""
        return {one["name"]: one["reason"] for one in self._values.get("left_out_of_plan", ())}

    @property
    def sources(self) -> tuple[str, ...]:
        """Files that the run was made of; empty if it was taken on a bench."""
        return tuple(self._values.get("logs", ()))


LABELS = ("unit", "operator", "note")


# --------------------
# The journal (WAL) beside a run that is being written, or whose program was killed.
#
# SQLite passes over everything behind the first frame that is damaged, without a word. Before a journal is folded
# into its run it is therefore looked at: a commit behind a damaged frame means that records were lost there.
#
# Source: SQLite's file format, section 4 (sqlite.org/fileformat2.html)


_HEADER, _FRAME = 32, 24
_MAGIC = 0x377F0682  # and the same with its lowest bit, for sums of big-endian words


def journal_of(file: Path) -> Path:
    """Return where the journal of a run lies."""
    return file.with_name(f"{file.name}-wal")


def lost_commits(content: bytes) -> int:
    """Return how many commits lie behind a damaged frame, where SQLite does not look."""
    if len(content) < _HEADER:
        return 0
    magic, _, page_size, _, salt_1, salt_2 = struct.unpack(">6I", content[:24])
    frames = enumerate(_frames(content, page_size))
    commits = [place for place, (size, salts) in frames if size and salts == (salt_1, salt_2)]
    if magic & ~1 != _MAGIC:
        return len(commits)
    good = _good_frames(content, page_size)
    return sum(place >= good for place in commits)


def frames_of(content: bytes, page_size: int) -> Iterator[tuple[int, bytes]]:
    """Walk through the pages that a journal holds, the newest last, damaged ones among them: number and page."""
    for start in range(_HEADER, len(content) - _FRAME - page_size + 1, _FRAME + page_size):
        page = start + _FRAME
        yield int.from_bytes(content[start : start + 4], "big"), content[page : page + page_size]


def _frames(content: bytes, page_size: int) -> Iterator[tuple[int, tuple[int, int]]]:
    """Size of the database after the commit (0: it is not the last frame of one) and salts of each frame."""
    if not 512 <= page_size <= 65_536:
        return
    for start in range(_HEADER, len(content) - _FRAME - page_size + 1, _FRAME + page_size):
        size, salt_1, salt_2 = struct.unpack(">3I", content[start + 4 : start + 16])
        yield size, (salt_1, salt_2)


def _good_frames(content: bytes, page_size: int) -> int:
    """How many frames from the first on have the sums that they were written with."""
    order = ">" if content[3] & 1 else "<"
    sums = _summed(content[:24], (0, 0), order)
    if sums != struct.unpack(">2I", content[24:32]):
        return 0
    salts, count = content[16:24], 0
    for start in range(_HEADER, len(content) - _FRAME - page_size + 1, _FRAME + page_size):
        head, page = content[start : start + _FRAME], content[start + _FRAME : start + _FRAME + page_size]
        sums = _summed(head[:8] + page, sums, order)
        if head[8:16] != salts or sums != struct.unpack(">2I", head[16:24]):
            break
        count += 1
    return count


def _summed(data: bytes, sums: tuple[int, int], order: str) -> tuple[int, int]:
    """SQLite's running sums s0 += x[i] + s1, s1 += x[i+1] + s0, modulo 2^32."""
    # Each sum is a word and the two sums before it: a word weighs in a later sum as the Fibonacci number of their
    # distance.
    words = np.frombuffer(data, dtype=f"{order}u4").astype(np.uint32)
    weights, count = _fibonacci(words.size + 1), words.size
    first = int(words[:-1] @ weights[count - 2 :: -1]) + sums[0] * int(weights[count - 2])
    second = int(words @ weights[count - 1 :: -1]) + sums[0] * int(weights[count - 1])
    first += sums[1] * int(weights[count - 1])
    second += sums[1] * int(weights[count])
    return first & 0xFFFFFFFF, second & 0xFFFFFFFF


@functools.cache
def _fibonacci(count: int) -> NDArray[np.uint32]:
    """The first Fibonacci numbers 1, 1, 2, 3, ... modulo 2^32."""
    numbers = [1, 1]
    while len(numbers) < count:
        numbers.append((numbers[-1] + numbers[-2]) & 0xFFFFFFFF)
    return np.array(numbers[:count], dtype=np.uint32)
