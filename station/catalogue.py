"""The list of all runs below a folder, kept in an index; chosen, sorted, as a table, drawn over time.

The index is a convenience: it is made again when it is missing, damaged, of another version or behind the runs. It
lies in the folder, or in the user's cache where nothing may be written there.
"""

from __future__ import annotations

import csv
import fnmatch
import hashlib
import io
import json
import math
import os
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.arrays import NORMAL_95
from station.errors import NoUsableSignal, RunError, UsageError
from station.files import inert
from station.live.events import Progress
from station.measurements import MEASUREMENTS, measurement
from station.report.figure import ACCENT, INK, SECOND, THIRD, legend_above, write_picture
from station.results.quantity import Value, headline_values
from station.results.result import TextTable
from station.runs.annotations import Remarks, read_remarks, remarks_file
from station.runs.database import COMPLETE, TAKEN, RunFacts, journal_of, read_facts, reading
from station.runs.store import results_of
from station.sources.find import first_time

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INDEX_FILE = ".gyrolock-index.sqlite"
_VERSION = 3
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
        rows = [
            (path, there[path], json.dumps(entry.as_json()) if entry else None) for path, entry in seen.items()
        ]
        _change(directory, "INSERT OR REPLACE INTO run VALUES (?, ?, ?)", rows)
    if gone := [path for path in known if path not in there]:
        _change(directory, "DELETE FROM run WHERE path = ?", [(path,) for path in gone])
    found = [replace(entry, run=str(directory / entry.run)) for entry in entries.values() if entry is not None]
    return sorted(found, key=lambda entry: (entry.started_at, entry.run))


def _looked_at(directory: Path, paths: list[str], progress: Progress | None) -> Iterator[dict[str, Entry | None]]:
    told = progress if progress is not None and len(paths) >= _MANY else Progress()
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
                if not one.is_symlink() or first_time(one.path, entered):
                    waiting.append(one.path)
            elif name.endswith(".sqlite"):
                with suppress(OSError):
                    beside = (name, journal_of(Path(name)).name, remarks_file(Path(name)).name)
                    sizes = [files[one].stat() for one in beside if one in files]
                    # what was written just now may be written again within the same tick of the disk's clock
                    young = any(now - one.st_mtime_ns < _RACY_NS for one in sizes)
                    stamp = " ".join(f"{one.st_size}:{one.st_mtime_ns}" for one in sizes)
                    yield os.path.relpath(one.path, root), (f"{stamp} seen {now}" if young else stamp)


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


# --------------------
# One run in the list of all: what it says of itself, its result, and what is said of it


@dataclass(frozen=True)
class Entry:
    """A run as the list of all runs knows it."""

    run: str  # its SQLite file, from the folder that was listed
    command: str = ""
    started_at: str = ""
    ended_at: str | None = None
    unit: str | None = None
    operator: str | None = None
    note: str | None = None
    gyro: str | None = None
    simulated: bool = False
    outcome: str = ""
    records: int = 0  # how many it holds, of every purpose
    values: tuple[Value, ...] = ()  # what the result begins with; empty for a run that was never evaluated
    verdict: str | None = None
    standing: str | None = None  # whether the result holds
    limits: dict[str, float] = field(default_factory=dict)  # what it was judged by, by name of the number
    instrument_serial: str | None = None
    software: str | None = None
    mark: str | None = None  # what was said of it afterwards; remarks are plain JSON
    tags: tuple[str, ...] = ()
    remarks: tuple[dict[str, Any], ...] = ()
    problem: str = ""  # why it cannot be read, or what of it is damaged; empty if nothing is wrong

    def as_json(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        values = [one.as_json() for one in self.values]
        return {**vars(self), "values": values, "tags": list(self.tags), "remarks": list(self.remarks)}

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Entry:
        """Return what :meth:`as_json` made plain."""
        values = tuple(map(Value.from_json, saved["values"]))
        several = {name: tuple(saved[name]) for name in ("tags", "remarks")}
        return cls(**{**saved, "values": values, **several})

    @property
    def result_text(self) -> str:
        """What the run says, in few words."""
        if self.problem and not self.values:
            return "damaged"
        ended = "not evaluated" if self.outcome in (COMPLETE, TAKEN) else self.outcome
        return ", ".join(one.text for one in self.values) or ended


def read_entry(file: Path, name: str) -> Entry | None:
    """Look at a run without opening a record; ``None`` for a database of somebody else."""
    # A run that is written at this moment is not disturbed, and what is found is what is on the disk.
    try:
        remarks, problem = read_remarks(file), ""
    except RunError as error:
        remarks, problem = Remarks(), str(error)
    said: dict[str, Any] = {
        "mark": remarks.mark,
        "tags": remarks.tags,
        "remarks": tuple(remark.as_json() for remark in remarks.said),
    }
    try:
        with reading(file, fold=False) as (db, layout):
            known, unusable, _ = read_facts(db)
            (records,) = db.execute(f"SELECT count(*) FROM {layout.table}").fetchone()
            found = db.execute("SELECT value FROM result ORDER BY number DESC LIMIT 1").fetchone()
    except RunError as error:
        if "is a database, but not a saved run" in str(error):
            return None
        return Entry(name, problem=str(error), **said)
    if unusable:
        problem = f"{', '.join(unusable)}: not what was once saved"
    facts, document = RunFacts(known), results_of(found) or {}
    identity, made = facts.get("identity") or {}, facts.get("provenance") or {}
    gyro, labels, tested = facts.settings.get("gyro"), facts.labels, document.get("limits")
    return Entry(
        run=name,
        command=facts.command,
        started_at=facts.started_at,
        ended_at=facts.ended_at,
        unit=labels.get("unit"),
        operator=labels.get("operator"),
        note=labels.get("note"),
        gyro=str(gyro.get("name") or "") or None if isinstance(gyro, dict) else None,
        simulated=facts.simulated,
        outcome=facts.outcome_text,
        records=records,
        values=(
            headline_values(document, measurement(facts.command).quantities_in(document))
            if facts.command in MEASUREMENTS
            else ()
        ),
        verdict=document.get("verdict"),
        standing=document.get("standing"),
        limits={
            str(one.get("name")): one["limit"]
            for one in (tested if isinstance(tested, list) else ())
            if isinstance(one, dict) and isinstance(one.get("limit"), int | float)
        },
        instrument_serial=identity.get("serial"),
        software=made.get("gyrolock"),
        problem=problem,
        **said,
    )


# --------------------
# Which runs of the list are wanted, and in which order


NO_LIMITS = "none"  # asks for runs without a verdict, or without a mark


@dataclass(frozen=True)
class RunFilter:
    """What a run must be to be listed; what is empty or ``None`` asks for nothing."""

    command: str = ""  # patterns with ``*`` and ``?``; capital letters do not count
    unit: str = ""
    operator: str = ""
    gyro: str = ""
    verdict: str = ""  # {"PASS", "FAIL", "none", ""}
    mark: str = ""  # {"good", "bad", "none", ""}
    tags: tuple[str, ...] = ()  # all of them
    text: str = ""  # stands in a note, whoever wrote it
    since: str = ""  # UTC, ISO 8601, from its beginning: ``"2026-11"`` is the whole month in both
    until: str = ""

    def admits(self, entry: Entry) -> bool:
        """Whether a run is wanted."""
        pairs = [(getattr(entry, of) or "", getattr(self, of)) for of in ("command", "unit", "operator", "gyro")]
        notes = [entry.note or "", *(str(one.get("note", "")) for one in entry.remarks)]
        return (
            all(fnmatch.fnmatchcase(text.casefold(), (wanted or "*").casefold()) for text, wanted in pairs)
            and self.verdict in ("", entry.verdict or NO_LIMITS)
            and self.mark in ("", entry.mark or NO_LIMITS)
            and set(self.tags) <= set(entry.tags)
            and (not self.text or any(self.text.casefold() in note.casefold() for note in notes))
            and entry.started_at >= self.since
            and (not self.until or entry.started_at[: len(self.until)] <= self.until)
        )


def chosen(entries: Iterable[Entry], wanted: RunFilter, sort: Sequence[str] = ()) -> list[Entry]:
    """Return the runs that are wanted, in the order that is wanted."""
    found = [entry for entry in entries if wanted.admits(entry)]
    for name in reversed(sort):
        key = name.removeprefix("-")
        if key not in ORDERS:
            raise UsageError(f"runs cannot be sorted by {key!r}, only by {', '.join(ORDERS)}")
        found.sort(key=ORDERS[key], reverse=name.startswith("-"))
    return found


def _result(entry: Entry) -> tuple[str, float]:
    """Results of one kind together; what is none comes last."""
    first = next(iter(entry.values), None)
    return ("~", math.inf) if first is None or math.isnan(first.value) else (first.name, first.value)


ORDERS: dict[str, Callable[[Entry], Any]] = {
    "when": lambda entry: entry.started_at,
    "command": lambda entry: entry.command,
    "unit": lambda entry: entry.unit or "",
    "operator": lambda entry: entry.operator or "",
    "result": _result,
    "records": lambda entry: entry.records,
    "verdict": lambda entry: entry.verdict or "~",
    "mark": lambda entry: entry.mark or "~",
}


# --------------------
# The list of runs as a table for a person, and as CSV


SCHEMA = {"name": "gyrolock runs", "version": 1}
_LONGEST_RESULT, _LONGEST_LINE, _SHORTEST_NOTE = 30, 120, 12  # letters
QUALITY = {"stands": "good", "doubtful": "DOUBTFUL", "fails": "FAILS"}
"""What a list says of a result in one word, by its standing."""

COLUMNS = (
    "run", "command", "started_at", "ended_at", "unit", "operator", "gyro", "simulated", "records", "outcome",
    "result_name", "result_of", "result", "result_u", "verdict", "standing", "mark", "tags", "note", "remarks",
    "instrument_serial", "software", "problem",
)  # fmt: skip


def runs_table(entries: Sequence[Entry], directory: Path) -> TextTable:
    """Return the list as a person reads it; a column that nobody fills is left out."""
    # the year is told where there is more than one
    when = 5 if len({entry.started_at[:4] for entry in entries}) == 1 else 0
    rows: list[tuple[str, ...]] = [
        (
            entry.started_at[when:16].replace("T", " "),
            entry.command,
            entry.unit or "",
            entry.operator or "",
            _shortened(entry.result_text, _LONGEST_RESULT),
            QUALITY.get(entry.standing or "", "") if entry.values else "",
            entry.verdict or "",
            _mark(entry),
            _shortened(" ".join(entry.tags), 2 * _SHORTEST_NOTE),
            entry.problem
            or next((_signed(one) for one in reversed(entry.remarks) if one.get("note")), entry.note or ""),
            _short_name(entry, directory),
        )
        for entry in entries
    ]
    header = (
        "when (UTC)", "command", "unit", "operator", "result (95 %)", "quality", "verdict", "mark", "tags", "note",
        "run",
    )  # fmt: skip
    filled = [place for place, _ in enumerate(header) if place == 0 or any(row[place] for row in rows)]
    note = header.index("note")
    widths = (max(len(row[place]) for row in (header, *rows)) + 2 for place in filled if place != note)
    room = max(_LONGEST_LINE - sum(widths), _SHORTEST_NOTE)
    rows = [(*row[:note], _shortened(row[note], room), *row[note + 1 :]) for row in rows]
    return TextTable(
        tuple(header[place] for place in filled), tuple(tuple(row[place] for place in filled) for row in rows)
    )


def runs_csv(entries: Iterable[Entry]) -> str:
    """Return the list as CSV: one line for each value of a result, one for a run without."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    for entry in entries:
        known = {name: "" if value is None else value for name, value in vars(entry).items()}
        known |= {
            "simulated": int(entry.simulated),
            "tags": " ".join(entry.tags),
            "remarks": "; ".join(_signed(one) for one in entry.remarks if one.get("note")),
        }
        values = [
            {
                "result_name": one.name,
                "result_of": one.of,
                "result": "" if math.isnan(one.value) else repr(one.value),
                "result_u": "" if math.isnan(one.u) else repr(one.u),
            }
            for one in entry.values
        ]
        rows = ({**known, **value} for value in values or [{}])
        writer.writerows({name: inert(f"{cell}") for name, cell in row.items()} for row in rows)
    return text.getvalue()


def _mark(entry: Entry) -> str:
    """The mark, who made it and on which day."""
    by = next((one for one in reversed(entry.remarks) if one.get("mark") == entry.mark), None)
    return f"{entry.mark}, {by['by']} {str(by['at'])[:10]}" if entry.mark and by is not None else entry.mark or ""


def _signed(remark: Mapping[str, Any]) -> str:
    return f"{str(remark['at'])[:10]} {remark['by']}: {remark['note']}"


def _shortened(text: str, longest: int) -> str:
    line = " ".join(text.split())
    return line if len(line) <= longest else f"{line[: longest - 1]}…"


def _short_name(entry: Entry, directory: Path) -> str:
    """Folder of a run below the one that is listed; the file where it is not the only one there."""
    path = Path(os.path.relpath(entry.run, directory))
    return str(path.parent) if path.name in ("run.sqlite", "fog.sqlite") and path.parent.name else str(path)


# --------------------
# Results of many runs over time, each unit in its own colour


_COLOURS = (ACCENT, SECOND, THIRD, "#8a4f9e", "#b08a1e", "#3f8f9b", "#a23b4a", "#5b6875")
_MARKERS = "osD^vP<>"
_WIDTH, _HEIGHT, _MOST_PANELS = 9.5, 3.0, 8
Series = dict[str, dict[str, list[tuple[Entry, Value]]]]  # values by what they are, and by unit


def write_trend(path: Path, entries: Sequence[Entry]) -> int:
    """Draw the results of runs over time into a file, and return how many."""
    series = series_of(entries)
    write_picture(path, "trend", trend_size(series), lambda figure: draw_trend(figure, series))
    return sum(len(values) for units in series.values() for values in units.values())


def draw_trend(figure: Figure, series: Series) -> None:
    """Draw one panel for each number, most often measured first; with 95 % of what every input does to it."""
    shown = sorted(series.items(), key=lambda one: -sum(map(len, one[1].values())))[:_MOST_PANELS]
    panels: Any = figure.subplots(len(shown), squeeze=False, sharex=True)
    for (name, units), axes in zip(shown, panels[:, 0], strict=True):
        for place, (unit, values) in enumerate(sorted(units.items())):
            colour = _COLOURS[place % len(_COLOURS)]
            marker = _MARKERS[place // len(_COLOURS) % len(_MARKERS)]
            times = [datetime.fromisoformat(entry.started_at) for entry, _ in values]
            numbers = [value.value for _, value in values]
            bars = [0.0 if value.u != value.u else NORMAL_95 * value.u for _, value in values]
            axes.errorbar(
                times, numbers, bars, color=colour, lw=0.7, elinewidth=0.8, alpha=0.9, label=unit, zorder=2
            )
            for entry, when, number in zip([entry for entry, _ in values], times, numbers, strict=True):
                fill = "white" if entry.mark == "bad" or entry.standing == "fails" else colour
                axes.plot([when], [number], marker, ms=4.5, mfc=fill, mec=colour, zorder=3)
                if entry.verdict == "FAIL":
                    axes.plot([when], [number], "x", ms=9, color=INK, zorder=4)
        _draw_limits(axes, [one for values in units.values() for one in values])
        axes.set_ylabel(name)
        axes.ticklabel_format(axis="y", useOffset=False)
        legend_above(axes, columns=6)
    panels[-1, 0].set_xlabel(
        "when the run began, UTC (bars: 95 %; hollow: marked bad or fails its checks; x: FAIL)"
    )


def _draw_limits(axes: Any, values: Sequence[tuple[Entry, Value]]) -> None:
    """Draw what the runs were judged by; a limit far from all values is told in words and flattens nothing."""
    judged = [
        (entry.limits[value.limit_name], value) for entry, value in values if value.limit_name in entry.limits
    ]
    signed = any(min(value.value, value.low_95) < 0 for _, value in judged)  # limits are on sizes
    low, high = axes.get_ylim()
    for limit in sorted({limit for limit, _ in judged}):
        ends = [
            end
            for end in ((limit, -limit) if signed else (limit,))
            if abs(end - (low + high) / 2) < 2 * (high - low)
        ]
        label = f"limit {limit:g}" + (
            "" if ends else ", above the picture" if limit > high else ", below the picture"
        )
        for end in ends or [math.nan]:
            axes.axhline(end, color=INK, lw=1.0, ls=(0, (5, 3)), label=label, zorder=1)
            label = ""


def trend_size(series: Series) -> tuple[float, float]:
    """Width and height of the figure, inches."""
    return _WIDTH, _HEIGHT * min(len(series), _MOST_PANELS) + 0.3


def series_of(entries: Sequence[Entry]) -> Series:
    """Sort results by what they are and by unit."""
    found: Series = {}
    for entry in entries:
        for value in entry.values:
            if value.value == value.value and entry.started_at:
                label = f"{value.quantity.words} {value.of}".strip() + (f"\n{value.unit}" if value.unit else "")
                unit = entry.unit or entry.gyro or "no unit named"
                found.setdefault(label, {}).setdefault(unit, []).append((entry, value))
    if not found:
        raise NoUsableSignal("none of the runs has a result that could be drawn")
    return found
