"""The list of all runs below a folder, kept in an index: only runs that have changed are looked at again.

The index is a convenience: it is made again when it is missing, damaged, of another version or behind the runs. It
lies in the folder, or in the user's cache where nothing may be written there.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

from station.catalogue.entry import Entry, read_entry
from station.errors import UsageError
from station.runs.journal import journal_of
from station.runs.progress import Progress
from station.runs.remarks import remarks_file

INDEX_FILE = ".gyrolock-index.sqlite"
_VERSION = 1
_APPLICATION = 0x47_59_4C_49  # "GYLI"
_MANY = 200  # runs: so many are looked at before anybody asks what takes so long
_AT_ONCE = 500  # looked at between two commits: what was seen is kept when the look is interrupted
_RACY_NS = 2_000_000_000  # a file that is younger than this when it is looked at may change without a new time
_TABLE = """
CREATE TABLE run (
    path  TEXT PRIMARY KEY,      -- of its SQLite file, from the folder of the index
    stamp TEXT NOT NULL,         -- sizes and times of its files when it was looked at
    entry TEXT                   -- JSON; NULL: a database of somebody else
) WITHOUT ROWID;
"""

Stamps = dict[str, str]


def list_runs(directory: Path, *, progress: Progress | None = None) -> list[Entry]:
    """Return all runs below a folder, the oldest first."""
    if not directory.is_dir():
        raise UsageError(f"{directory}: there is no such folder of runs")
    there = dict(_stamps(directory))
    known = _known(directory)
    unchanged = {path: known[path][1] for path, stamp in there.items() if known.get(path, ("",))[0] == stamp}
    entries = dict(unchanged)
    for seen in _looked_at(directory, [path for path in there if path not in unchanged], progress):
        entries |= seen
        _remember(directory, {path: there[path] for path in seen}, seen)
    if gone := [path for path in known if path not in there]:
        _forget(directory, gone)
    found = [replace(entry, run=str(directory / entry.run)) for entry in entries.values() if entry is not None]
    return sorted(found, key=lambda entry: (entry.started_at, entry.run))


def _looked_at(directory: Path, paths: list[str], progress: Progress | None) -> Iterator[dict[str, Entry | None]]:
    told = progress if progress is not None and len(paths) >= _MANY else Progress(quiet=True)
    told.start("looking at runs", len(paths))
    for first in range(0, len(paths), _AT_ONCE):
        seen = {}
        for path in paths[first : first + _AT_ONCE]:
            seen[path] = read_entry(directory / path, path)
            told.advance()
        yield seen


# ---------------------------------------------------------------------- what lies in the folder


def _stamps(directory: Path) -> Iterator[tuple[str, str]]:
    """Every file below a folder that may be a run, and by what a change of it shows."""
    now = time.time_ns()
    root = os.fspath(directory)
    waiting, entered = [root], {os.path.realpath(root)}
    while waiting:
        folder = waiting.pop()
        try:
            with os.scandir(folder) as found:
                files = {one.name: one for one in found}
        except OSError:  # a folder that may not be read, or that was removed meanwhile
            continue
        for name, one in sorted(files.items(), reverse=True):
            if name.startswith("."):
                continue
            if one.is_dir():
                if not one.is_symlink() or _first_time(one.path, entered):
                    waiting.append(one.path)
            elif name.endswith(".sqlite"):
                with suppress(OSError):
                    yield os.path.relpath(one.path, root), _stamp(files, name, now)


def _first_time(path: str, entered: set[str]) -> bool:
    """Whether a link leads to where nobody has been: a link to a folder above would never end."""
    target = os.path.realpath(path)
    if any(target == one or one.startswith(f"{target}{os.sep}") for one in entered):
        return False
    entered.add(target)
    return True


def _stamp(files: Mapping[str, os.DirEntry[str]], name: str, now: int) -> str:
    beside = (name, journal_of(Path(name)).name, remarks_file(Path(name)).name)
    sizes = [files[one].stat() for one in beside if one in files]
    # a file that was written just now may be written again within the same tick of the disk's clock
    young = any(now - one.st_mtime_ns < _RACY_NS for one in sizes)
    stamp = " ".join(f"{one.st_size}:{one.st_mtime_ns}" for one in sizes)
    return f"{stamp} seen {now}" if young else stamp


# ---------------------------------------------------------------------- the index itself


def _places(directory: Path) -> tuple[Path, Path]:
    """Where the index of a folder may lie: in it, or in the user's cache."""
    cache = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    home = Path(cache) if cache else Path("~/.cache").expanduser()
    name = hashlib.sha256(os.fsencode(directory.resolve())).hexdigest()[:16]
    return directory / INDEX_FILE, home / "gyrolock" / f"runs-{name}.sqlite"


def _known(directory: Path) -> dict[str, tuple[str, Entry | None]]:
    """What the index says: stamp and entry of each run; nothing where it cannot be used."""
    for place in _places(directory):
        if not place.is_file():
            continue
        with suppress(sqlite3.Error, OSError, ValueError, TypeError, KeyError):
            with closing(sqlite3.connect(f"{place.resolve().as_uri()}?mode=ro", uri=True, timeout=10)) as db:
                if db.execute("PRAGMA user_version").fetchone() != (_VERSION,):
                    continue
                rows = db.execute("SELECT path, stamp, entry FROM run").fetchall()
            return {
                path: (stamp, None if entry is None else Entry.from_json(json.loads(entry)))
                for path, stamp, entry in rows
            }
    return {}


def _remember(directory: Path, stamps: Stamps, entries: Mapping[str, Entry | None]) -> None:
    rows = [
        (path, stamps[path], None if entry is None else json.dumps(entry.as_json()))
        for path, entry in entries.items()
    ]
    _change(directory, "INSERT OR REPLACE INTO run VALUES (?, ?, ?)", rows)


def _forget(directory: Path, gone: list[str]) -> None:
    _change(directory, "DELETE FROM run WHERE path = ?", [(path,) for path in gone])


def _change(directory: Path, statement: str, rows: Sequence[tuple[str | None, ...]]) -> None:
    """Write to the index, in the first place that takes it; where none does, the next list takes longer."""
    for place in _places(directory):
        for _ in range(2):  # one that is damaged or of another version is made anew
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                with closing(sqlite3.connect(place, timeout=10)) as db, db:
                    _prepare(db)
                    db.executemany(statement, rows)
                return
            except sqlite3.OperationalError:
                break  # it may not be written, or another program writes it for longer than one waits
            except (sqlite3.DatabaseError, ValueError):
                with suppress(OSError):
                    place.unlink()
            except OSError:
                break


def _prepare(db: sqlite3.Connection) -> None:
    (version,) = db.execute("PRAGMA user_version").fetchone()
    (application,) = db.execute("PRAGMA application_id").fetchone()
    if (application, version) == (_APPLICATION, _VERSION):
        return
    if application or version:
        raise ValueError("an index of another version")
    db.execute("PRAGMA synchronous = OFF")
    db.executescript(f"{_TABLE} PRAGMA application_id = {_APPLICATION}; PRAGMA user_version = {_VERSION};")
