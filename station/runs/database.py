"""A run as one SQLite file in a directory of its own. A commit is on the disk when it returns."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sqlite3
import stat
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from station.errors import CannotWrite, RunError
from station.runs.facts import checked_fact
from station.runs.journal import journal_of, lost_commits
from station.runs.layouts import TABLES, TODAY, Layout, layout_of
from station.runs.stop import undisturbed

_LITTLE = 64 * 1024  # bytes free on a disk that is full: SQLite writes a page of 16 KiB and its journal
SUMS = "sums"
"""Name of the fact that holds the SHA-256 of every other one: records have theirs in their rows."""


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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
            raise RunError(
                f"{file}: the disk does not give it ({error}): try again, or copy it to another"
            ) from error
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
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY):
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
            if name in sums and sums[name] != _sum(text):
                raise ValueError("is not what was once saved")
            known[name] = checked_fact(name, json.loads(text))
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
